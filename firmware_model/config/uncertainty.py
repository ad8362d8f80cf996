"""Set of all vehicles that a file allows: each number fixed, or anywhere within its spread."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from firmware_model.config.files import read_document, validate
from firmware_model.config.spreads import Spread, iter_spreads, substitute_spreads, take_nominal
from firmware_model.config.units import check_units
from firmware_model.config.vehicle import VEHICLES, Vehicle, check_body, load_vehicle

_LEAST_LAG = 0.1
"""[-] of the nominal lag, left where lag and delay together may be less than the nominal delay."""


@dataclass(frozen=True, kw_only=True)
class VehicleSet:
    """Vehicle file with its spreads.

    Examples
    --------
    >>> from gustproof import load_vehicle_set
    >>> vehicles = load_vehicle_set("paper")
    >>> list(vehicles.spreads)[:2]
    ['inertia_B.x', 'inertia_B.y']
    """

    document: Mapping[str, Any]
    """Content of the file, with its units."""

    @cached_property
    def spreads(self) -> dict[str, Spread]:
        """Spreads by the name of their number, in the file's order: `actuator_lag`, `inertia_B.x`, `gyro.snr_db`."""
        return dict(iter_spreads(self.document))

    @cached_property
    def nominal(self) -> Vehicle:
        """Vehicle with all numbers nominal."""
        return validate(Vehicle, take_nominal(self.document, self._source), self._source)

    @property
    def lag_range(self) -> tuple[float, float] | None:
        """[s] least and largest actuator lag that a loop has to stand at the nominal delay; `None` for a known one.

        A log shows lag and delay as a sum. Its range stands in the file as that of the delay at the nominal lag. Then
        the lag has the range of the sum, which is narrower than that of lag and delay each for itself.
        """
        delay, lag = self.spreads.get("command.delay"), self.nominal.actuator_lag
        if delay is not None:
            return max(lag + delay.low - delay.nominal, _LEAST_LAG * lag), lag + delay.high - delay.nominal
        own = self.spreads.get("actuator_lag")
        return None if own is None else (own.value(-1.0), own.value(1.0))

    @cached_property
    def _uncertain_fields(self) -> dict[str, Any]:
        """Part of the file under keys that contain a spread."""
        keys = {name.partition(".")[0] for name in self.spreads}
        return {key: item for key, item in self.document.items() if key in keys}

    @cached_property
    def _fixed_fields(self) -> dict[str, Any]:
        """Fields that are the same in all vehicles, validated once."""
        names = [field.name for field in fields(Vehicle) if field.name not in self._uncertain_fields]
        return {name: getattr(self.nominal, name) for name in names}

    @property
    def _source(self) -> str:
        return f"vehicle '{self.document['name']}'"

    def vehicle_at(self, delta: Mapping[str, float]) -> Vehicle:
        """Return the vehicle at normalised values in [-1, 1], by name; omitted ones are 0, the nominal.

        Raises
        ------
        ValueError
            If a name is unknown.
        ConfigError
            If no such vehicle is possible.
        """
        if unknown := sorted(set(delta) - set(self.spreads)):
            raise ValueError(f"unknown spread '{unknown[0]}', there are {', '.join(self.spreads) or 'none'}")
        values = {name: spread.value(delta.get(name, 0.0)) for name, spread in self.spreads.items()}
        return validate(
            Vehicle, {**self._fixed_fields, **substitute_spreads(self._uncertain_fields, values)}, self._source
        )


def make_vehicle_set(document: Mapping[str, Any], source: str) -> VehicleSet:
    """Return the vehicle set of a document.

    Raises
    ------
    ConfigError
        If a key, a value or an end of a spread is not allowed, or no rigid body has such an inertia. The error names
        `source`.
    """
    validate(Vehicle, take_nominal(document, source), source)
    vehicles = VehicleSet(document=dict(document))
    for name in vehicles.spreads:
        for end in (-1.0, 1.0):
            check_units(vehicles.vehicle_at({name: end}), source)
    inertias = [name for name in vehicles.spreads if name.startswith("inertia_B.")]
    low, high = (vehicles.vehicle_at(dict.fromkeys(inertias, end)).inertia_B for end in (-1.0, 1.0))
    check_body(low, high, source)
    return vehicles


def load_vehicle_set(name_or_path: str | Path) -> VehicleSet:
    """Return the vehicle set of a file, or of a shipped one by its name.

    Raises
    ------
    ConfigError
        If there is no such file, or a key, a value or an end of a spread is not allowed.

    Examples
    --------
    >>> from gustproof import load_vehicle_set
    >>> load_vehicle_set("paper").nominal.mass
    10.0
    """
    name = load_vehicle(name_or_path).name
    path = Path(name_or_path) if Path(name_or_path).suffix == ".toml" else VEHICLES / f"{name_or_path}.toml"
    return make_vehicle_set({"name": name, **read_document(path)}, str(path))
