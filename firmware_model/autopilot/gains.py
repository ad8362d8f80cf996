"""The vehicle's on-board gains as numbers that people may change in flight, under PX4's names and in its units.

PX4's rate gains give a fraction of the largest torque per rate error; the vehicle's give an angular acceleration.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

from firmware_model.config.vehicle import PositionLoop, Stabilizer, Vehicle

_Loop = TypeVar("_Loop", Stabilizer, PositionLoop)
_AXES = ("ROLL", "PITCH", "YAW")
_DEGREES = math.degrees(1.0)


class TunableGain(NamedTuple):
    """One number of the on-board loops."""

    field: str
    """Name of the field."""
    axis: int | None
    """Its place in a field of three."""
    scale: float
    """[people's unit / ours] what people are told is so many times the field."""
    unit: str
    """Unit as shown to people."""
    minimum: float
    """[`unit`] smallest value that may be set."""
    maximum: float
    """[`unit`] largest value that may be set."""
    meaning: str
    """One line for people."""

    def told(self, loop: Stabilizer | PositionLoop) -> float:
        """Return the number of a loop in people's unit."""
        value = getattr(loop, self.field)
        return float(self.scale * (value if self.axis is None else value[self.axis]))


def stabilizer_gains(vehicle: Vehicle) -> dict[str, TunableGain]:
    """Return the gains of the attitude and rate loops by their names."""
    gains = {
        "GP_ATT_P": TunableGain("angle_p", None, 1.0, "1/s", 0.1, 20.0, "Rate asked for per attitude error, all axes"),
        "GP_RATE_MAX": TunableGain("rate_limit", None, _DEGREES, "deg/s", 10.0, 1800.0,
                            "Largest rate that the attitude loop asks for, all axes"),
        "IMU_DGYRO_CUTOFF": TunableGain("derivative_cutoff", None, 1.0, "Hz", 1.0, 100.0, "Low pass of the rate's derivative"),
    }  # fmt: skip
    ratios = (inertia / limit for inertia, limit in zip(vehicle.inertia_B, vehicle.torque_limit, strict=True))
    for axis, (word, ratio) in enumerate(zip(_AXES, ratios, strict=True)):
        what = f"Part of the largest {word.lower()} torque"
        gains |= {
            f"MC_{word}RATE_P": TunableGain("rate_p", axis, ratio, "s/rad", 0.001, 10.0, f"{what} per rate error"),
            f"MC_{word}RATE_I": TunableGain("rate_i", axis, ratio, "1/rad", 0.0, 10.0, f"{what} per integral of that"),
            f"MC_{word}RATE_D": TunableGain(
                "rate_d", axis, ratio, "s^2/rad", 0.0, 1.0, f"{what} against the acceleration"
            ),
        }
    return gains


POSITION_GAINS = {
    "MPC_XY_P": TunableGain("xy_p", None, 1.0, "1/s", 0.05, 5.0, "Velocity asked for per position error"),
    "MPC_XY_VEL_P_ACC": TunableGain("xy_velocity_p", None, 1.0, "1/s", 0.1, 20.0, "Acceleration per velocity error"),
    "MPC_XY_VEL_I_ACC": TunableGain(
        "xy_velocity_i", None, 1.0, "1/s^2", 0.0, 20.0, "Acceleration per integral of that"
    ),
    "MPC_XY_VEL_MAX": TunableGain(
        "xy_velocity_max", None, 1.0, "m/s", 0.5, 20.0, "Largest horizontal velocity asked for"
    ),
    "MPC_Z_P": TunableGain("z_p", None, 1.0, "1/s", 0.05, 5.0, "Climb asked for per height error"),
    "MPC_Z_VEL_P_ACC": TunableGain("z_velocity_p", None, 1.0, "1/s", 0.1, 20.0, "Acceleration per climb error"),
    "MPC_Z_VEL_I_ACC": TunableGain("z_velocity_i", None, 1.0, "1/s^2", 0.0, 20.0, "Acceleration per integral of that"),
    "MPC_Z_VEL_MAX_UP": TunableGain("z_velocity_max_up", None, 1.0, "m/s", 0.2, 10.0, "Fastest climb"),
    "MPC_Z_VEL_MAX_DN": TunableGain("z_velocity_max_down", None, 1.0, "m/s", 0.2, 4.0, "Fastest descent"),
    "MPC_TILTMAX_AIR": TunableGain("tilt_max", None, _DEGREES, "deg", 5.0, 60.0, "Largest tilt asked for"),
}
"""Gains and limits of the height and position loops by their names."""


def replace_gains(loop: _Loop, gains: Mapping[str, TunableGain], told: Mapping[str, float]) -> _Loop:
    """Return a loop with the numbers of `told` in their places, by name and in people's units."""
    for name, value in told.items():
        loop = replace(loop, **{gains[name].field: _field_value(loop, gains[name], value)})
    return loop


def _field_value(loop: Stabilizer | PositionLoop, gain: TunableGain, value: float) -> Any:
    new = value / gain.scale
    if gain.axis is None:
        return new
    old = getattr(loop, gain.field)
    return (*old[: gain.axis], new, *old[gain.axis + 1 :])
