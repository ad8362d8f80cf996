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
    cutoff, rate_max = "Low pass of the rate's derivative", "Largest rate command of the attitude loop, all axes"
    gains = {
        "GP_ATT_P": _scalar("angle_p", "1/s", 0.1, 20.0, "Rate command per attitude error, all axes"),
        "GP_RATE_MAX": _scalar("rate_limit", "deg/s", 10.0, 1800.0, rate_max),
        "IMU_DGYRO_CUTOFF": _scalar("derivative_cutoff", "Hz", 1.0, 100.0, cutoff),
    }
    effects = {
        "P": ("s/rad", 0.001, 10.0, "per rate error"),
        "I": ("1/rad", 0.0, 10.0, "per integrated rate error"),
        "D": ("s^2/rad", 0.0, 1.0, "against angular acceleration"),
    }
    ratios = (inertia / limit for inertia, limit in zip(vehicle.inertia_B, vehicle.torque_limit, strict=True))
    for axis, (word, ratio) in enumerate(zip(_AXES, ratios, strict=True)):
        for letter, (unit, low, high, effect) in effects.items():
            meaning = f"Fraction of the largest {word.lower()} torque {effect}"
            gain = TunableGain(f"rate_{letter.lower()}", axis, ratio, unit, low, high, meaning)
            gains[f"MC_{word}RATE_{letter}"] = gain
    return gains


def _scalar(field: str, unit: str, minimum: float, maximum: float, meaning: str) -> TunableGain:
    scale = _DEGREES if unit.startswith("deg") else 1.0
    return TunableGain(field, None, scale, unit, minimum, maximum, meaning)


POSITION_GAINS = {
    "MPC_XY_P": _scalar("xy_p", "1/s", 0.05, 5.0, "Velocity command per position error"),
    "MPC_XY_VEL_P_ACC": _scalar("xy_velocity_p", "1/s", 0.1, 20.0, "Acceleration per velocity error"),
    "MPC_XY_VEL_I_ACC": _scalar("xy_velocity_i", "1/s^2", 0.0, 20.0, "Acceleration per integrated velocity error"),
    "MPC_XY_VEL_MAX": _scalar("xy_velocity_max", "m/s", 0.5, 20.0, "Largest horizontal velocity command"),
    "MPC_Z_P": _scalar("z_p", "1/s", 0.05, 5.0, "Climb rate command per height error"),
    "MPC_Z_VEL_P_ACC": _scalar("z_velocity_p", "1/s", 0.1, 20.0, "Acceleration per climb rate error"),
    "MPC_Z_VEL_I_ACC": _scalar("z_velocity_i", "1/s^2", 0.0, 20.0, "Acceleration per integrated climb rate error"),
    "MPC_Z_VEL_MAX_UP": _scalar("z_velocity_max_up", "m/s", 0.2, 10.0, "Fastest climb"),
    "MPC_Z_VEL_MAX_DN": _scalar("z_velocity_max_down", "m/s", 0.2, 4.0, "Fastest descent"),
    "MPC_TILTMAX_AIR": _scalar("tilt_max", "deg", 5.0, 60.0, "Largest tilt command"),
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
