"""Allocate torques and thrust to four rotors, within their limits.

Rotor i at `position_B` gives the thrust T_i within 0..`thrust_max` along -z of B, and the drag torque
`spin * drag_ratio * T_i` about z:

    roll = -sum y_i T_i    pitch = sum x_i T_i    yaw = drag_ratio sum spin_i T_i    thrust = sum T_i

The inverse is exact. A rotor that turns counter-clockwise, seen from above, turns the nose to the right: spin 1.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from firmware_model.config.vehicle import Rotors, Vehicle
from firmware_model.numerics.compiled import kernel
from firmware_model.types import Vector

Float4 = tuple[float, float, float, float]


class RotorParams(NamedTuple):
    """Each rotor's share of a wrench, and its limit.

    A rotor gives its `share` of the thrust. A torque acts on it like `roll` (`pitch`, `yaw`) times that in thrust.
    """

    thrust_max: float
    """[N] of one rotor."""
    share: Float4
    """[-] of the thrust."""
    reach: Float4
    """[N] collective thrust that takes the rotor to its limit without torques."""
    roll: Float4
    """[1/m] thrust per torque."""
    pitch: Float4
    """[1/m] thrust per torque."""
    yaw: Float4
    """[1/m] thrust per torque."""


def rotor_params(vehicle: Vehicle) -> RotorParams:
    """Return the shares of a vehicle's rotors."""
    return _rotor_params(vehicle.rotors)


@lru_cache(maxsize=64)
def _rotor_params(rotors: Rotors) -> RotorParams:
    inverse = np.linalg.inv(rotors.wrench)
    share = inverse[:, 3]
    rows = (share, rotors.thrust_max / share, *(inverse[:, :3].T / share))
    return RotorParams(rotors.thrust_max, *(tuple(row.tolist()) for row in rows))


@kernel
def allocate(params: RotorParams, torque_B: Vector, thrust: float) -> tuple[Vector, float]:
    """Return the torques [N*m] B and the thrust [N] that the rotors can give of a demand.

    No rotor leaves 0..`thrust_max`. Where the demand is too much, roll and pitch come first, both scaled by one factor
    if they alone exceed the limits. The thrust then moves to the nearest value that leaves room for them, and yaw gets
    the rest. Each stage ignores the later ones, as in PX4: a yaw that would make room for tilt is not counted on.
    """
    L, M, N = torque_B
    roll, pitch, reach = params.roll, params.pitch, params.reach
    tilt = (
        roll[0] * L + pitch[0] * M,
        roll[1] * L + pitch[1] * M,
        roll[2] * L + pitch[2] * M,
        roll[3] * L + pitch[3] * M,
    )
    yaw_share = (params.yaw[0] * N, params.yaw[1] * N, params.yaw[2] * N, params.yaw[3] * N)
    # In collective thrust: rotor i stops at -scale * tilt[i], and is at its limit reach[i] above that.
    least = min(min(tilt[0], tilt[1]), min(tilt[2], tilt[3]))
    scale = 1.0
    for i in range(4):
        if scale * (tilt[i] - least) > reach[i]:
            scale = reach[i] / (tilt[i] - least)
    high = reach[0] - scale * tilt[0]
    for i in range(1, 4):
        high = min(high, reach[i] - scale * tilt[i])
    collective = max(min(thrust, high), -scale * least)
    yaw = 1.0
    for i in range(4):
        used = scale * tilt[i] + collective
        room = reach[i] - used if yaw_share[i] > 0.0 else used
        if yaw * abs(yaw_share[i]) > room:
            yaw = max(room, 0.0) / abs(yaw_share[i])
    return (scale * L, scale * M, yaw * N), collective


@kernel
def rotor_thrusts(params: RotorParams, torque_B: Vector, thrust: float) -> Float4:
    """Return the thrust [N] of each rotor for torques [N*m] B and a thrust [N]."""
    (L, M, N), share = torque_B, params.share
    roll, pitch, yaw = params.roll, params.pitch, params.yaw
    return (
        share[0] * (roll[0] * L + pitch[0] * M + yaw[0] * N + thrust),
        share[1] * (roll[1] * L + pitch[1] * M + yaw[1] * N + thrust),
        share[2] * (roll[2] * L + pitch[2] * M + yaw[2] * N + thrust),
        share[3] * (roll[3] * L + pitch[3] * M + yaw[3] * N + thrust),
    )
