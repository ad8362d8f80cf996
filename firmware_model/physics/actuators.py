"""Limit the torque of faulty actuators; sound ones give the whole command, after their lag."""

import math
from typing import NamedTuple

from firmware_model.numerics.compiled import kernel
from firmware_model.types import Vector


class ActuatorParams(NamedTuple):
    """Effectiveness and limit of each axis."""

    share: Vector = (1.0, 1.0, 1.0)
    """[-] B, of the command."""
    limit: Vector = (math.inf, math.inf, math.inf)
    """[N*m] B."""


@kernel
def _limit_axis(torque: float, share: float, limit: float) -> float:
    return min(max(share * torque, -limit), limit)


@kernel
def apply_actuator_faults(params: ActuatorParams, torque: Vector) -> Vector:
    """Return the torque [N*m] B that faulty actuators give for a commanded one, once their lag has passed."""
    (roll, pitch, yaw), share, limit = torque, params.share, params.limit
    return (
        _limit_axis(roll, share[0], limit[0]),
        _limit_axis(pitch, share[1], limit[1]),
        _limit_axis(yaw, share[2], limit[2]),
    )
