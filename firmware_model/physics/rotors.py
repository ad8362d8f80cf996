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

    Rotor i gives `share_i` of the thrust. A torque acts on it like `roll_i` (`pitch_i`, `yaw_i`) times that in thrust.
    """

    thrust_max: float  # [N] of one rotor
    share_1: float  # [-]
    share_2: float
    share_3: float
    share_4: float
    reach_1: float  # [N] collective thrust that takes the rotor to its limit without torques
    reach_2: float
    reach_3: float
    reach_4: float
    roll_1: float  # [1/m]
    roll_2: float
    roll_3: float
    roll_4: float
    pitch_1: float  # [1/m]
    pitch_2: float
    pitch_3: float
    pitch_4: float
    yaw_1: float  # [1/m]
    yaw_2: float
    yaw_3: float
    yaw_4: float


def rotor_params(vehicle: Vehicle) -> RotorParams:
    """Return the shares of a vehicle's rotors."""
    return _rotor_params(vehicle.rotors)


@lru_cache(maxsize=64)
def _rotor_params(rotors: Rotors) -> RotorParams:
    inverse = np.linalg.inv(rotors.wrench)
    share = inverse[:, 3]
    torques = (inverse[:, :3].T / share).ravel()
    numbers = np.concatenate([[rotors.thrust_max], share, rotors.thrust_max / share, torques])
    return RotorParams._make(numbers.tolist())


@kernel
def allocate(params: RotorParams, torque_B: Vector, thrust: float) -> tuple[Vector, float]:
    """Return the torques [N*m] B and the thrust [N] that the rotors can give of a demand.

    No rotor leaves 0..`thrust_max`. Where the demand is too much, roll and pitch come first, both scaled by one factor
    if they alone exceed the limits. The thrust then moves to the nearest value that leaves room for them, and yaw gets
    the rest. Each stage ignores the later ones, as in PX4: a yaw that would make room for tilt is not counted on.
    """
    L, M, N = torque_B
    tilt = (
        params.roll_1 * L + params.pitch_1 * M,
        params.roll_2 * L + params.pitch_2 * M,
        params.roll_3 * L + params.pitch_3 * M,
        params.roll_4 * L + params.pitch_4 * M,
    )
    yaw_share = (params.yaw_1 * N, params.yaw_2 * N, params.yaw_3 * N, params.yaw_4 * N)
    reach = (params.reach_1, params.reach_2, params.reach_3, params.reach_4)
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
    L, M, N = torque_B
    return (
        params.share_1 * (params.roll_1 * L + params.pitch_1 * M + params.yaw_1 * N + thrust),
        params.share_2 * (params.roll_2 * L + params.pitch_2 * M + params.yaw_2 * N + thrust),
        params.share_3 * (params.roll_3 * L + params.pitch_3 * M + params.yaw_3 * N + thrust),
        params.share_4 * (params.roll_4 * L + params.pitch_4 * M + params.yaw_4 * N + thrust),
    )
