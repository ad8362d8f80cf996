"""Numbers of a vehicle file that are in another unit than the file's: no multirotor has them.

The bounds are ten to a hundred times beyond those of multirotors of 20 g to 500 kg. A number in mm, deg/s or N mm that
passed them would fly without a word, and its verdict would be of another vehicle.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from firmware_model.errors import ConfigError

if TYPE_CHECKING:
    from firmware_model.config.vehicle import Vehicle

_FASTEST, _LATEST = 200.0, 5.0
"""[rad/s] and [s] beyond any gyro's range or commanded rate, and beyond any rotor's lag."""
_SWIFTEST = 100.0
"""[m/s] beyond any multirotor's commanded speed."""
_SPEEDS, _LENGTHS = (
    ("xy_velocity_max", "z_velocity_max_up", "z_velocity_max_down"),
    ("half_length", "half_width", "height"),
)
"""Speeds of the position loop, lengths of the gear."""
_LIFTS, _TORQUES = 100.0, 100.0
"""[-] most thrust of the rotors over the weight, most torque over what they give."""
_SPANS = 10.0
"""[-] most of the span over the distance of the farthest rotors, and of that over the span."""
_DRAG = 2.0
"""[-] most drag torque of a rotor over its thrust times the span: a twentieth or a tenth is usual."""
_GYRATION = 10.0
"""[-] most of an inertia over mass times span squared."""


def check_units(vehicle: "Vehicle", source: str) -> None:
    """Reject a vehicle with a number that only another unit explains.

    Raises
    ------
    ConfigError
        If there is one; the error names `source`, the key and the unit that is due.
    """
    for key, value, most, unit in _numbers(vehicle):
        if value > most:
            raise ConfigError(
                f"{source}: {key}: {value:.4g} is beyond {most:.3g} {unit}, of any multirotor: see its unit"
            )


def _numbers(vehicle: "Vehicle") -> list[tuple[str, float, float, str]]:
    """Return key, value, largest value and unit of what is looked at."""
    rotors = vehicle.rotors
    across = 2.0 * max(math.hypot(x, y) for x, y, _ in rotors.position_B)
    arms = np.abs(rotors.wrench[:3]).sum(axis=1).tolist()
    found = [
        ("gyro.range", vehicle.gyro.range, _FASTEST, "rad/s"),
        ("stabilizer.rate_limit", vehicle.stabilizer.rate_limit, _FASTEST, "rad/s"),
        ("actuator_lag", vehicle.actuator_lag, _LATEST, "s"),
        ("rotors.thrust_max", rotors.thrust_max, _LIFTS * 9.81 * vehicle.mass / rotors.count, "N"),
        ("rotors.drag_ratio", rotors.drag_ratio, _DRAG * vehicle.span, "m"),
        ("span", vehicle.span, _SPANS * across, "m"),
        ("rotors.position_B", across, _SPANS * vehicle.span, "m"),
        ("rotors.position_B", max(abs(z) for _, _, z in rotors.position_B), _SPANS * vehicle.span, "m"),
        *((f"gear.{key}", getattr(vehicle.gear, key), _SPANS * vehicle.span, "m") for key in _LENGTHS),
        ("gear.sag", vehicle.gear.sag, vehicle.span, "m"),
        ("drag_area", vehicle.drag_area, _SPANS * vehicle.span * vehicle.span, "m^2"),
        *((f"position.{key}", getattr(vehicle.position, key), _SWIFTEST, "m/s") for key in _SPEEDS),
        ("inertia_B", max(vehicle.inertia_B), _GYRATION * vehicle.mass * vehicle.span * vehicle.span, "kg m^2"),
    ]
    if vehicle.command is None:  # the log of a flight says otherwise what a command gives; its rotors are assumed
        found += [
            (f"torque_limit.{axis}", limit, _TORQUES * 0.5 * rotors.thrust_max * arm, "N m")
            for axis, (limit, arm) in enumerate(zip(vehicle.torque_limit, arms, strict=True))
        ]
    return found
