"""Flat, level ground at the height of home: contact of feet and rotors, friction, and rest.

In motion each contact point is a spring and damper, critically damped for the whole vehicle. Its Coulomb friction is
proportional to speed below `_FRICTION_SPEED`. At rest friction is a condition, not a law of motion. While the feet can
carry all forces nothing moves at all, so there is neither jitter nor drift.
"""

import math
from typing import NamedTuple

from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.rotations import conjugate, rotate
from firmware_model.physics.rigid_body import Body
from firmware_model.types import Vector

_FRICTION_SPEED = 0.05  # [m/s] sliding speed of full friction
_REST_SPEED = 0.02  # [m/s] and [rad/s]: below, a vehicle held by its feet is at rest
_REST_LOAD_SHARE = 0.5  # [-] least share of the weight on the feet at rest; with less, the springs lift off gently
_MARGIN = 0.01  # [m] path of an acceleration of 5 km/s^2 within the longest step, 2 ms


class GroundParams(NamedTuple):
    """Contact points of a vehicle, and their stiffness, damping and friction."""

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


class _ContactSum(NamedTuple):
    """Sum over the contact points."""

    F_north: float  # [N] N
    F_east: float
    F_down: float
    M_north: float  # [N*m] N
    M_east: float
    M_down: float
    load: float  # [N]


def ground_params(vehicle: Vehicle) -> GroundParams:
    """Return a vehicle's contact constants; the springs yield by `sag` under its weight."""
    gear = vehicle.gear
    x, y, z = (max(abs(position[i]) for position in vehicle.rotors.position_B) for i in range(3))
    foot = (gear.half_length, gear.half_width, gear.height)
    reach = max(math.hypot(*foot), math.hypot(x, y, z))
    weight = vehicle.mass * GRAVITY
    stiffness, damping = weight / (4.0 * gear.sag), 0.5 * vehicle.mass * math.sqrt(GRAVITY / gear.sag)
    return GroundParams(*foot, x, y, -z, reach, weight, stiffness, damping, gear.friction)


def standing_height(vehicle: Vehicle) -> float:
    """Return the height [m] of the centre of mass above ground, for a vehicle on its feet."""
    return vehicle.gear.height - vehicle.gear.sag


@kernel
def can_touch_ground(params: GroundParams, body: Body, dt: float) -> bool:
    """Return whether any point may touch the ground within a step of `dt` [s]; if not, contact may be skipped."""
    return body.down + params.reach + dt * abs(body.v_down) > -_MARGIN


@kernel
def _add_point(params: GroundParams, body: Body, omega_N: Vector, arm_N: Vector, total: _ContactSum) -> _ContactSum:
    """Return the sum with the contact at the end of an arm [m] N, on a vehicle with body rates [rad/s] N."""
    x, y, z = arm_N
    v_north = body.v_north + omega_N[1] * z - omega_N[2] * y
    v_east = body.v_east + omega_N[2] * x - omega_N[0] * z
    v_down = body.v_down + omega_N[0] * y - omega_N[1] * x
    depth = body.down + z
    push = max(params.stiffness * depth + params.damping * v_down, 0.0) if depth > 0.0 else 0.0
    rub = -params.friction * push / max(math.sqrt(v_north * v_north + v_east * v_east), _FRICTION_SPEED)
    north, east, down = rub * v_north, rub * v_east, -push
    return _ContactSum(
        F_north=total.F_north + north,
        F_east=total.F_east + east,
        F_down=total.F_down + down,
        M_north=total.M_north + y * down - z * east,
        M_east=total.M_east + z * north - x * down,
        M_down=total.M_down + x * east - y * north,
        load=total.load + push,
    )


@kernel
def _add_corners(params: GroundParams, body: Body, corner_B: Vector, total: _ContactSum) -> _ContactSum:
    """Return the sum with the contacts at four corners (+-x, +-y, z), of which one is `corner_B` [m] B."""
    q_NB = (body.qw, body.qx, body.qy, body.qz)
    omega_N = rotate(q_NB, (body.p, body.q, body.r))
    a, b = rotate(q_NB, (corner_B[0], 0.0, corner_B[2])), rotate(q_NB, (-corner_B[0], 0.0, corner_B[2]))
    c = rotate(q_NB, (0.0, corner_B[1], 0.0))
    total = _add_point(params, body, omega_N, (a[0] + c[0], a[1] + c[1], a[2] + c[2]), total)
    total = _add_point(params, body, omega_N, (a[0] - c[0], a[1] - c[1], a[2] - c[2]), total)
    total = _add_point(params, body, omega_N, (b[0] + c[0], b[1] + c[1], b[2] + c[2]), total)
    return _add_point(params, body, omega_N, (b[0] - c[0], b[1] - c[1], b[2] - c[2]), total)


@kernel
def ground_wrench(params: GroundParams, body: Body) -> tuple[Vector, Vector, float]:
    """Return force [N] B and moment [N*m] B of the ground, and the load on it [N].

    The points are written out: a loop over them, inside the loop over flights, would keep the compiler from SIMD.
    """
    total = _ContactSum(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    total = _add_corners(params, body, (params.foot_x, params.foot_y, params.foot_z), total)
    total = _add_corners(params, body, (params.rotor_x, params.rotor_y, params.rotor_z), total)
    to_B = conjugate((body.qw, body.qx, body.qy, body.qz))
    force_B = rotate(to_B, (total.F_north, total.F_east, total.F_down))
    return force_B, rotate(to_B, (total.M_north, total.M_east, total.M_down)), total.load


@kernel
def is_at_rest(params: GroundParams, body: Body, force_B: Vector, moment_B: Vector) -> bool:
    """Return whether a vehicle stands still, and stays so on all four feet under thrust, air and torques.

    The feet must carry enough of the weight, friction must hold force and yaw together, and the vehicle must not tip.
    """
    speed = body.v_north * body.v_north + body.v_east * body.v_east + body.v_down * body.v_down
    rate = body.p * body.p + body.q * body.q + body.r * body.r
    q_NB = (body.qw, body.qx, body.qy, body.qz)
    ahead, right = rotate(q_NB, (params.foot_x, 0.0, 0.0))[2], rotate(q_NB, (0.0, params.foot_y, 0.0))[2]
    highest = body.down + rotate(q_NB, (0.0, 0.0, params.foot_z))[2] - abs(ahead) - abs(right)
    F_N = rotate(q_NB, force_B)
    load = params.weight + F_N[2]
    pull = math.sqrt(F_N[0] * F_N[0] + F_N[1] * F_N[1])
    arm = math.sqrt(params.foot_x * params.foot_x + params.foot_y * params.foot_y)
    return (
        (speed <= _REST_SPEED * _REST_SPEED)
        & (rate <= _REST_SPEED * _REST_SPEED)
        & (highest > 0.0)
        & (load >= _REST_LOAD_SHARE * params.weight)
        & (pull + abs(moment_B[2]) / arm <= params.friction * load)
        & (abs(moment_B[0]) + params.foot_z * abs(force_B[1]) <= params.foot_y * load)
        & (abs(moment_B[1]) + params.foot_z * abs(force_B[0]) <= params.foot_x * load)
    )
