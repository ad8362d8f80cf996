"""Limit the torque of faulty actuators; sound ones give the whole command, after their lag."""

import math
from typing import NamedTuple

from firmware_model.numerics.compiled import kernel
from firmware_model.types import Vector


class ActuatorParams(NamedTuple):
    """Effectiveness and limit of each axis."""

    share_roll: float = 1.0  # [-] of the command
    share_pitch: float = 1.0
    share_yaw: float = 1.0
    limit_roll: float = math.inf  # [N*m]
    limit_pitch: float = math.inf
    limit_yaw: float = math.inf


@kernel
def _limit_axis(torque: float, share: float, limit: float) -> float:
    return min(max(share * torque, -limit), limit)


@kernel
def apply_actuator_faults(params: ActuatorParams, torque: Vector) -> Vector:
    """Return the torque [N*m] B that faulty actuators give for a commanded one, once their lag has passed."""
    return (
        _limit_axis(torque[0], params.share_roll, params.limit_roll),
        _limit_axis(torque[1], params.share_pitch, params.limit_pitch),
        _limit_axis(torque[2], params.share_yaw, params.limit_yaw),
    )
