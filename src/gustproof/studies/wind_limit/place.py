"""The position loop around a law, where drift is judged: its numbers, and whether the law can follow it."""

import math
from dataclasses import asdict
from typing import Any, NamedTuple

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import PositionLoop, Vehicle
from firmware_model.errors import ConfigError
from gustproof.airframe.place_loop import GOOD_PEAK, place_peak, slow_down
from gustproof.law.form import Law


class PlaceLoop(NamedTuple):
    """Position loop of a vehicle file, around a law."""

    gains: PositionLoop
    """`[position]` of the file."""
    peak: float | None
    """[-] largest sensitivity of the loop at hover; `None` where no linear model knows it."""
    slower: PositionLoop | None
    """Gains with a peak of 2 at most, if this one is larger and there are any."""

    @property
    def text(self) -> str:
        """Its numbers in a line."""
        gains, peak = self.gains, "" if self.peak is None else f"; Ms {self.peak:.3g} around this law"
        tilt = f"tilt up to {math.degrees(gains.tilt_max):.3g} deg"
        better = "" if self.slower is None else f", at most {GOOD_PEAK:g} with {_horizontal(self.slower)}"
        return f"{_horizontal(gains)}, {tilt}, from the true position{peak}{better}"

    def to_dict(self) -> dict[str, Any]:
        """Return its numbers as JSON values."""
        return {**asdict(self.gains), "Ms": self.peak}


def find_place_loop(law: Law, vehicle: Vehicle, base: Scenario) -> PlaceLoop:
    """Return the loop that holds the position of a vehicle around a law, at the delay of `base`.

    Raises
    ------
    ConfigError
        If the law reads no set-points, or the loop is unstable by the linear model at hover.
    """
    if not law.takes_references:
        raise ConfigError(
            f"--keep: drift needs a position loop, and law '{law.name}' has no set-points to follow it by"
        )
    peak = place_peak(law, vehicle, base, vehicle.position)
    slower = slow_down(law, vehicle, base) if peak is not None and peak > GOOD_PEAK else None
    if peak == math.inf:
        way = "it is with none that is slower" if slower is None else f"stable with {_horizontal(slower)} there"
        raise ConfigError(
            f"--keep: drift needs a position loop: [position] of vehicle '{vehicle.name}' is unstable around law "
            f"'{law.name}'; {way}"
        )
    return PlaceLoop(vehicle.position, peak, slower)


def _horizontal(gains: PositionLoop) -> str:
    values = {name: getattr(gains, name) for name in ("xy_p", "xy_velocity_p", "xy_velocity_i")}
    return ", ".join(f"{name} = {value:g}" for name, value in values.items())
