"""On-board gains as parameters that may be changed in flight, under PX4's names and in its units.

PX4's rate gains give a fraction of the largest torque per rate error. The vehicle's give an angular acceleration.
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
    """One number of the on-board loops, as a parameter."""

    field: str
    """Name of the field in the loop."""
    axis: int | None
    """Index in a field of three; `None` for a scalar field."""
    scale: float
    """[`unit` / field's unit] factor from the field to the displayed value."""
    unit: str
    """Displayed unit."""
    minimum: float
    """[`unit`] smallest allowed value."""
    maximum: float
    """[`unit`] largest allowed value."""
    meaning: str
    """One line of documentation."""

    def display_value(self, loop: Stabilizer | PositionLoop) -> float:
        """Return the number of a loop in `unit`."""
        value = getattr(loop, self.field)
        return float(self.scale * (value if self.axis is None else value[self.axis]))


def stabilizer_gains(vehicle: Vehicle) -> dict[str, TunableGain]:
    """Return the gains of the attitude and rate loops by parameter name."""
    gains = {
        "GP_ATT_P": TunableGain("angle_p", None, 1.0, "1/s", 0.1, 20.0, "Rate command per attitude error, all axes"),
        "GP_RATE_MAX": TunableGain(
            "rate_limit", None, _DEGREES, "deg/s", 10.0, 1800.0, "Largest rate command of the attitude loop, all axes"
        ),
        "IMU_DGYRO_CUTOFF": TunableGain(
            "derivative_cutoff", None, 1.0, "Hz", 1.0, 100.0, "Low pass of the rate's derivative"
        ),
    }
    ratios = (inertia / limit for inertia, limit in zip(vehicle.inertia_B, vehicle.torque_limit, strict=True))
    for axis, (word, ratio) in enumerate(zip(_AXES, ratios, strict=True)):
        share = f"Fraction of the largest {word.lower()} torque"
        gains |= {
            f"MC_{word}RATE_P": TunableGain("rate_p", axis, ratio, "s/rad", 0.001, 10.0, f"{share} per rate error"),
            f"MC_{word}RATE_I": TunableGain(
                "rate_i", axis, ratio, "1/rad", 0.0, 10.0, f"{share} per integrated rate error"
            ),
            f"MC_{word}RATE_D": TunableGain(
                "rate_d", axis, ratio, "s^2/rad", 0.0, 1.0, f"{share} against angular acceleration"
            ),
        }
    return gains


POSITION_GAINS = {
    "MPC_XY_P": TunableGain("xy_p", None, 1.0, "1/s", 0.05, 5.0, "Velocity command per position error"),
    "MPC_XY_VEL_P_ACC": TunableGain("xy_velocity_p", None, 1.0, "1/s", 0.1, 20.0, "Acceleration per velocity error"),
    "MPC_XY_VEL_I_ACC": TunableGain(
        "xy_velocity_i", None, 1.0, "1/s^2", 0.0, 20.0, "Acceleration per integrated velocity error"
    ),
    "MPC_XY_VEL_MAX": TunableGain(
        "xy_velocity_max", None, 1.0, "m/s", 0.5, 20.0, "Largest horizontal velocity command"
    ),
    "MPC_Z_P": TunableGain("z_p", None, 1.0, "1/s", 0.05, 5.0, "Climb rate command per height error"),
    "MPC_Z_VEL_P_ACC": TunableGain("z_velocity_p", None, 1.0, "1/s", 0.1, 20.0, "Acceleration per climb rate error"),
    "MPC_Z_VEL_I_ACC": TunableGain(
        "z_velocity_i", None, 1.0, "1/s^2", 0.0, 20.0, "Acceleration per integrated climb rate error"
    ),
    "MPC_Z_VEL_MAX_UP": TunableGain("z_velocity_max_up", None, 1.0, "m/s", 0.2, 10.0, "Fastest climb"),
    "MPC_Z_VEL_MAX_DN": TunableGain("z_velocity_max_down", None, 1.0, "m/s", 0.2, 4.0, "Fastest descent"),
    "MPC_TILTMAX_AIR": TunableGain("tilt_max", None, _DEGREES, "deg", 5.0, 60.0, "Largest tilt command"),
}
"""Gains and limits of the altitude and position loops by parameter name."""


def replace_gains(loop: _Loop, gains: Mapping[str, TunableGain], values: Mapping[str, float]) -> _Loop:
    """Return a loop with some numbers replaced, by parameter name and in displayed units."""
    for name, value in values.items():
        loop = replace(loop, **{gains[name].field: _field_value(loop, gains[name], value)})
    return loop


def _field_value(loop: Stabilizer | PositionLoop, gain: TunableGain, value: float) -> Any:
    new = value / gain.scale
    if gain.axis is None:
        return new
    old = getattr(loop, gain.field)
    return (*old[: gain.axis], new, *old[gain.axis + 1 :])
