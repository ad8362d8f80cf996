"""All the vehicles that a file allows: each number as it stands there, or anywhere within its spread."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from firmware_model.config.files import read_document, validate
from firmware_model.config.spreads import Spread, iter_spreads, substitute_spreads, take_nominal
from firmware_model.config.vehicle import VEHICLES, Vehicle, check_body, load_vehicle


@dataclass(frozen=True, kw_only=True)
class VehicleSet:
    """A vehicle file with its spreads.

    Examples
    --------
    >>> from gustproof import load_vehicle_set
    >>> vehicles = load_vehicle_set("paper")
    >>> list(vehicles.spreads)[:2]
    ['inertia_B.x', 'inertia_B.y']
    """

    document: Mapping[str, Any]
    """What the file says, units there."""

    @cached_property
    def spreads(self) -> dict[str, Spread]:
        """Each spread by the name of its number, in the file's order: `actuator_lag`, `inertia_B.x`, `gyro.snr_db`."""
        return dict(iter_spreads(self.document))

    @cached_property
    def nominal(self) -> Vehicle:
        """The vehicle with all numbers nominal."""
        return validate(Vehicle, take_nominal(self.document, self._source), self._source)

    @cached_property
    def _spread(self) -> dict[str, Any]:
        """What the file says under keys with a spread in them."""
        keys = {name.partition(".")[0] for name in self.spreads}
        return {key: item for key, item in self.document.items() if key in keys}

    @cached_property
    def _certain(self) -> dict[str, Any]:
        """What is the same in all the vehicles, checked once."""
        names = [field.name for field in fields(Vehicle) if field.name not in self._spread]
        return {name: getattr(self.nominal, name) for name in names}

    @property
    def _source(self) -> str:
        return f"vehicle '{self.document['name']}'"

    def at(self, delta: Mapping[str, float]) -> Vehicle:
        """Return the vehicle at normalised values in [-1, 1] by name; those that are left out are 0, nominal.

        Raises
        ------
        ValueError
            If a name is unknown.
        ConfigError
            If there can be no such vehicle.
        """
        if unknown := sorted(set(delta) - set(self.spreads)):
            raise ValueError(f"unknown spread '{unknown[0]}', there are {', '.join(self.spreads) or 'none'}")
        values = {name: spread.value(delta.get(name, 0.0)) for name, spread in self.spreads.items()}
        return validate(Vehicle, {**self._certain, **substitute_spreads(self._spread, values)}, self._source)


def make_vehicle_set(document: Mapping[str, Any], source: str) -> VehicleSet:
    """Return the set that a document says, each mistake told with its `source`.

    Raises
    ------
    ConfigError
        If a key or value is not allowed, or an end of a spread is not; or no rigid body has an inertia there.
    """
    validate(Vehicle, take_nominal(document, source), source)
    vehicles = VehicleSet(document=dict(document))
    for name in vehicles.spreads:
        for end in (-1.0, 1.0):
            vehicles.at({name: end})
    inertias = [name for name in vehicles.spreads if name.startswith("inertia_B.")]
    low, high = (vehicles.at(dict.fromkeys(inertias, end)).inertia_B for end in (-1.0, 1.0))
    check_body(low, high, source)
    return vehicles


def load_vehicle_set(name_or_path: str | Path) -> VehicleSet:
    """Read a vehicle file, or a shipped one by its name, with its spreads.

    Raises
    ------
    ConfigError
        If there is no such file, or a key or value is not allowed, or an end of a spread is not.

    Examples
    --------
    >>> from gustproof import load_vehicle_set
    >>> load_vehicle_set("paper").nominal.mass
    10.0
    """
    name = load_vehicle(name_or_path).name
    path = Path(name_or_path) if Path(name_or_path).suffix == ".toml" else VEHICLES / f"{name_or_path}.toml"
    return make_vehicle_set({"name": name, **read_document(path)}, str(path))
