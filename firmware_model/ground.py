"""Flat, level ground at the height of home: feet and rotors touch it, friction holds, and a vehicle at rest is at rest.

Moving, each point that touches is a spring and damper at the critical damping of the whole vehicle, with Coulomb
friction that a speed below `_CREEP` makes proportional. At rest friction is a condition, not a law of motion: while
the feet can carry what acts, nothing moves at all, so that there is neither jitter nor drift.
"""

import math
from typing import NamedTuple

from firmware_model.compiled import kernel
from firmware_model.rigid_body import Body
from firmware_model.rotations import conjugate, rotate
from firmware_model.signals import Vector
from firmware_model.vehicle import GRAVITY, Vehicle

_CREEP = 0.05  # [m/s] sliding speed from which on friction has its full value
_SLOW = 0.02  # [m/s] and [rad/s]: below, a vehicle whose feet hold it is at rest
_CARRIED = 0.5  # [-] of the weight on the feet, at least, at rest: less, and the springs lift it off gently
_POINTS = 8  # feet, then rotors, each at the corners of a rectangle


class GroundParams(NamedTuple):
    """Where the vehicle touches, and how stiffly."""

    foot_x: float  # [m] B, feet at plus and minus this
    foot_y: float
    foot_z: float
    rotor_x: float  # [m] B, rotor hubs at plus and minus this
    rotor_y: float
    rotor_z: float
    reach: float  # [m] from the centre of mass to the farthest of these points
    weight: float  # [N]
    stiffness: float  # [N/m] of one point
    damping: float  # [N*s/m] of one point
    friction: float  # [-]


def ground_params(vehicle: Vehicle) -> GroundParams:
    """Return where a vehicle touches the ground; the springs yield by `sag` under its weight."""
    gear = vehicle.gear
    x, y, z = (max(abs(position[i]) for position in vehicle.rotors.position_B) for i in range(3))
    foot = (gear.half_length, gear.half_width, gear.height)
    weight = vehicle.mass * GRAVITY
    return GroundParams(
        *foot, x, y, -z, max(math.hypot(*foot), math.hypot(x, y, z)), weight, weight / (4.0 * gear.sag),
        0.5 * vehicle.mass * math.sqrt(GRAVITY / gear.sag), gear.friction,
    )  # fmt: skip


def standing_height(vehicle: Vehicle) -> float:
    """Return the height [m] of the centre of mass above ground of a vehicle that stands on its feet."""
    return vehicle.gear.height - vehicle.gear.sag


@kernel
def _point(params: GroundParams, i: int) -> Vector:
    """Return the i-th point that can touch the ground [m] B."""
    ahead, right = (1.0 if i & 1 else -1.0), (1.0 if i & 2 else -1.0)
    if i < 4:
        return ahead * params.foot_x, right * params.foot_y, params.foot_z
    return ahead * params.rotor_x, right * params.rotor_y, params.rotor_z


@kernel
def ground_wrench(params: GroundParams, body: Body) -> tuple[Vector, Vector, float]:
    """Return force [N] B and moment [N*m] B of the ground, and the load that it carries [N]."""
    F_x, F_y, F_z, L, M, N, load = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if body.down + params.reach > 0.0:
        q_NB = (body.qw, body.qx, body.qy, body.qz)
        for i in range(_POINTS):
            x, y, z = _point(params, i)
            depth = body.down + rotate(q_NB, (x, y, z))[2]
            if depth > 0.0:
                turning = (body.q * z - body.r * y, body.r * x - body.p * z, body.p * y - body.q * x)
                v = rotate(q_NB, turning)
                v_north, v_east, v_down = body.v_north + v[0], body.v_east + v[1], body.v_down + v[2]
                push = max(params.stiffness * depth + params.damping * v_down, 0.0)
                rub = -params.friction * push / max(math.sqrt(v_north * v_north + v_east * v_east), _CREEP)
                f_x, f_y, f_z = rotate(conjugate(q_NB), (rub * v_north, rub * v_east, -push))
                F_x, F_y, F_z = F_x + f_x, F_y + f_y, F_z + f_z
                L, M, N = L + y * f_z - z * f_y, M + z * f_x - x * f_z, N + x * f_y - y * f_x
                load += push
    return (F_x, F_y, F_z), (L, M, N), load


@kernel
def rests(params: GroundParams, body: Body, force_B: Vector, moment_B: Vector) -> bool:
    """Whether a vehicle stands still and stays so, on all four feet, under thrust, air and torques.

    The feet must carry enough of the weight, friction must hold force and yaw together, and the vehicle must not tip.
    """
    speed = body.v_north * body.v_north + body.v_east * body.v_east + body.v_down * body.v_down
    rate = body.p * body.p + body.q * body.q + body.r * body.r
    if body.down + params.foot_z <= -params.reach or speed > _SLOW * _SLOW or rate > _SLOW * _SLOW:
        return False
    q_NB = (body.qw, body.qx, body.qy, body.qz)
    for i in range(4):
        if body.down + rotate(q_NB, _point(params, i))[2] <= 0.0:
            return False
    F_N = rotate(q_NB, force_B)
    load = params.weight + F_N[2]
    pull = math.sqrt(F_N[0] * F_N[0] + F_N[1] * F_N[1])
    arm = math.sqrt(params.foot_x * params.foot_x + params.foot_y * params.foot_y)
    return (
        load >= _CARRIED * params.weight
        and pull + abs(moment_B[2]) / arm <= params.friction * load
        and abs(moment_B[0]) + params.foot_z * abs(force_B[1]) <= params.foot_y * load
        and abs(moment_B[1]) + params.foot_z * abs(force_B[0]) <= params.foot_x * load
    )
