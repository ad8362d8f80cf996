"""Four rotors: torques and thrust shared out among them, and what of it they can give.

Rotor i at `position_B` gives the thrust T_i within 0..`thrust_max` along -z of B and the drag torque
`spin * drag_ratio * T_i` about z, so that

    roll = -sum y_i T_i    pitch = sum x_i T_i    yaw = drag_ratio sum spin_i T_i    thrust = sum T_i

is inverted exactly. A rotor that turns counter-clockwise, seen from above, turns the nose to the right: spin 1.
"""

from typing import NamedTuple

import numpy as np

from firmware_model.compiled import kernel
from firmware_model.signals import Vector
from firmware_model.vehicle import Vehicle

Four = tuple[float, float, float, float]


class RotorParams(NamedTuple):
    """Each rotor's share of a wrench, and its limit."""

    thrust_max: float  # [N] of one rotor
    roll_1: float  # [1/m] thrust of rotor 1 per roll torque
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
    thrust_1: float  # [-] of the collective thrust
    thrust_2: float
    thrust_3: float
    thrust_4: float


def rotor_params(vehicle: Vehicle) -> RotorParams:
    """Return the shares of a vehicle's rotors.

    Raises
    ------
    ValueError
        If the geometry can't give each torque by itself, or a rotor carries nothing of a pure thrust.
    """
    rotors = vehicle.rotors
    x, y, _ = np.array(rotors.position_B).T
    wrench = np.array([-y, x, rotors.drag_ratio * np.array(rotors.spin), np.ones(4)])
    if np.linalg.cond(wrench) > 1e6:
        raise ValueError(f"rotors of '{vehicle.name}': position_B and spin don't give each torque by itself")
    shares = np.linalg.inv(wrench)
    if np.min(shares[:, 3]) <= 0.0:
        raise ValueError(f"rotors of '{vehicle.name}': the centre of mass is not between them")
    return RotorParams(rotors.thrust_max, *shares.T.ravel().tolist())


@kernel
def allocate(params: RotorParams, torque_B: Vector, thrust: float) -> tuple[Vector, float]:
    """Return the torques [N*m] B and the thrust [N] that the rotors can give of those asked for.

    Where they can't give all: roll and pitch first, both scaled alike if even they are too much; then the thrust, moved
    to the nearest that leaves room for them; then what yaw there is room for. No rotor leaves 0..`thrust_max`.
    """
    share = (params.thrust_1, params.thrust_2, params.thrust_3, params.thrust_4)
    turn = (params.yaw_1, params.yaw_2, params.yaw_3, params.yaw_4)
    limit = params.thrust_max
    # For each rotor: minus the collective thrust that would just let it stop; and the range of thrust up to its limit.
    tilt = (
        (params.roll_1 * torque_B[0] + params.pitch_1 * torque_B[1]) / share[0],
        (params.roll_2 * torque_B[0] + params.pitch_2 * torque_B[1]) / share[1],
        (params.roll_3 * torque_B[0] + params.pitch_3 * torque_B[1]) / share[2],
        (params.roll_4 * torque_B[0] + params.pitch_4 * torque_B[1]) / share[3],
    )
    reach = (limit / share[0], limit / share[1], limit / share[2], limit / share[3])
    least = min(min(tilt[0], tilt[1]), min(tilt[2], tilt[3]))
    scale = 1.0
    for i in range(4):
        if scale * (tilt[i] - least) > reach[i]:
            scale = reach[i] / (tilt[i] - least)
    high = reach[0] - scale * tilt[0]
    for i in range(1, 4):
        high = min(high, reach[i] - scale * tilt[i])
    given = max(min(thrust, high), -scale * least)
    yaw = 1.0
    for i in range(4):
        used = share[i] * (scale * tilt[i] + given)
        asked = turn[i] * torque_B[2]
        room = limit - used if asked > 0.0 else used
        if yaw * abs(asked) > room:
            yaw = max(room, 0.0) / abs(asked)
    return (scale * torque_B[0], scale * torque_B[1], yaw * torque_B[2]), given


@kernel
def rotor_thrusts(params: RotorParams, torque_B: Vector, thrust: float) -> Four:
    """Return the thrust [N] of each rotor that makes up torques [N*m] B and a thrust [N]."""
    L, M, N = torque_B
    return (
        params.roll_1 * L + params.pitch_1 * M + params.yaw_1 * N + params.thrust_1 * thrust,
        params.roll_2 * L + params.pitch_2 * M + params.yaw_2 * N + params.thrust_2 * thrust,
        params.roll_3 * L + params.pitch_3 * M + params.yaw_3 * N + params.thrust_3 * thrust,
        params.roll_4 * L + params.pitch_4 * M + params.yaw_4 * N + params.thrust_4 * thrust,
    )
