"""Gains of the nonlinear entries: shipped for three vehicles, tuned by the same procedure for any other.

The procedure is that of the linear laws. Near level an entry is linear; of the structure that it is there, `tune` finds
the gains of least error in the turbulence of `paper-turbulence`. Limits are a sensitivity peak of `SENSITIVITY_PEAK`,
a torque slew of `default_slew`, and off nominal 1.7 times that peak, as `gustproof tune` tries first.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from firmware_model.config.files import parse_json, read_text
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import Vehicle, list_vehicles, load_vehicle
from gustproof.law.cascade import AxisLaw
from gustproof.performance.covariance import AxisModel
from gustproof.synthesis.pid.tuning import (
    SLOWER,
    SPREADS,
    AxisModels,
    TuningLimits,
    corner_vehicles,
    loop_speed,
    models_of_axes,
    tune,
)
from gustproof.synthesis.tune import SENSITIVITY_PEAK, default_slew

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

DATA = Path(__file__).parent / "data"
SHIPPED = ("paper", "octo", "iris")
"""Vehicles whose gains are shipped."""
_CORNER_PEAK = 1.7 * SENSITIVITY_PEAK
"""[-] largest sensitivity peak at the corners of inertia and lag."""
_NEAR = 1.5
"""[-] largest ratio of inertia or lag to those of the shipped vehicle of that name: beyond it, another vehicle."""
_TUNED: dict[tuple[str, Vehicle], Sequence[Any]] = {}
"""Gains tuned in this process, by entry and vehicle."""


Record = TypeVar("Record", bound="DataclassInstance")


@cache
def tuning_scenario() -> Scenario:
    """Return the scenario that gives turbulence, sample time and delay."""
    return load_scenario("paper-turbulence")


def tuning_limits(vehicle: Vehicle) -> TuningLimits:
    """Return the price at which entries are tuned."""
    slew = default_slew(vehicle, tuning_scenario())
    return TuningLimits(sensitivity_peak=SENSITIVITY_PEAK, slew=slew, corner_peak=_CORNER_PEAK)


def start_speeds(vehicle: Vehicle) -> list[float]:
    """Return the speeds [-] of the starts of a search, see `synthesis.pid.tuning`."""
    return [slower * loop_speed(vehicle, tuning_scenario()) for slower in SLOWER]


def tuning_models(vehicle: Vehicle) -> list[AxisModels]:
    """Return roll, pitch and yaw, each nominal and then at the corners of inertia and lag."""
    return models_of_axes(vehicle, corner_vehicles(vehicle, SPREADS), tuning_scenario())


def tune_axes(
    vehicle: Vehicle, axis: Callable[[Record, AxisModel], AxisLaw], starts: Sequence[Record], name: str
) -> list[Record]:
    """Return the gains of roll, pitch and yaw of least error for an entry that near level is `axis`.

    Raises
    ------
    DesignError
        If no gains are within the limits; its text calls the entry `name`.
    """
    return tune(tuning_models(vehicle), axis, starts, name, tuning_limits(vehicle))


def design_vehicle(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle whose numbers an entry may know: the shipped nominal one of that name, if near; else itself.

    So an entry in a campaign over spreads knows the nominal vehicle, like a law file.
    """
    if vehicle.name not in list_vehicles():
        return vehicle
    nominal = load_vehicle(vehicle.name)
    ours, theirs = (*nominal.inertia_B, nominal.actuator_lag), (*vehicle.inertia_B, vehicle.actuator_lag)
    is_near = all(abs(math.log(a / b)) <= math.log(_NEAR) for a, b in zip(ours, theirs, strict=True))
    return nominal if is_near else vehicle


def is_shipped(vehicle: Vehicle) -> bool:
    """Return whether gains are shipped for a vehicle."""
    return vehicle.name in SHIPPED and vehicle == load_vehicle(vehicle.name)


def find_gains(
    name: str, vehicle: Vehicle, tune_entry: Callable[[Vehicle], Sequence[Record]], kind: type[Record]
) -> list[Record]:
    """Return the gains of roll, pitch and yaw in an entry's data file; for a vehicle that is not in it, tuned now.

    Raises
    ------
    DesignError
        If no gains are within the limits.
    """
    if is_shipped(vehicle):
        return [kind(**axis) for axis in parse_json(read_text(DATA / f"{name}.json"))[vehicle.name]]
    if (name, vehicle) not in _TUNED:
        _TUNED[name, vehicle] = tune_entry(vehicle)
    return list(_TUNED[name, vehicle])
