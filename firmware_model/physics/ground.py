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
_ACCELERATION = 5000.0  # [m/s^2] no vehicle reaches this


class GroundParams(NamedTuple):
    """Contact points of a vehicle, and their stiffness, damping and friction."""

    foot_B: Vector
    """[m] B, feet at plus and minus x and y of this."""
    rotor_B: Vector
    """[m] B, rotor hubs at plus and minus x and y of this."""
    reach: float
    """[m] from the centre of mass to the farthest of these points."""
    weight: float
    """[N]."""
    stiffness: float
    """[N/m] of one point."""
    damping: float
    """[N*s/m] of one point."""
    friction: float
    """[-]."""


class _ContactSum(NamedTuple):
    """Sum over the contact points."""

    force_N: Vector  # [N]
    moment_N: Vector  # [N*m]
    load: float  # [N]


def ground_params(vehicle: Vehicle) -> GroundParams:
    """Return a vehicle's contact constants; the springs yield by `sag` under its weight."""
    gear = vehicle.gear
    x, y, z = (max(abs(position[i]) for position in vehicle.rotors.position_B) for i in range(3))
    foot = (gear.half_length, gear.half_width, gear.height)
    reach = max(math.hypot(*foot), math.hypot(x, y, z))
    weight = vehicle.mass * GRAVITY
    stiffness, damping = weight / (4.0 * gear.sag), 0.5 * vehicle.mass * math.sqrt(GRAVITY / gear.sag)
    return GroundParams(foot, (x, y, -z), reach, weight, stiffness, damping, gear.friction)


def standing_height(vehicle: Vehicle) -> float:
    """Return the height [m] of the centre of mass above ground, for a vehicle on its feet."""
    return vehicle.gear.height - vehicle.gear.sag


@kernel
def can_touch_ground(params: GroundParams, body: Body, dt: float) -> bool:
    """Return whether any point may touch the ground within `dt` [s]; if not, contact may be skipped."""
    path = dt * (abs(body.velocity_N[2]) + 0.5 * dt * _ACCELERATION)
    return body.position_N[2] + params.reach + path > 0.0


@kernel
def _add_point(params: GroundParams, body: Body, omega_N: Vector, arm_N: Vector, total: _ContactSum) -> _ContactSum:
    """Return the sum with the contact at the end of an arm [m] N, on a vehicle with body rates [rad/s] N."""
    x, y, z = arm_N
    v_north = body.velocity_N[0] + omega_N[1] * z - omega_N[2] * y
    v_east = body.velocity_N[1] + omega_N[2] * x - omega_N[0] * z
    v_down = body.velocity_N[2] + omega_N[0] * y - omega_N[1] * x
    depth = body.position_N[2] + z
    push = max(params.stiffness * depth + params.damping * v_down, 0.0) if depth > 0.0 else 0.0
    rub = -params.friction * push / max(math.sqrt(v_north * v_north + v_east * v_east), _FRICTION_SPEED)
    north, east, down = rub * v_north, rub * v_east, -push
    F, M = total.force_N, total.moment_N
    moment_N = (M[0] + y * down - z * east, M[1] + z * north - x * down, M[2] + x * east - y * north)
    return _ContactSum((F[0] + north, F[1] + east, F[2] + down), moment_N, total.load + push)


@kernel
def _add_corners(params: GroundParams, body: Body, corner_B: Vector, total: _ContactSum) -> _ContactSum:
    """Return the sum with the contacts at four corners (+-x, +-y, z), of which one is `corner_B` [m] B."""
    q_NB = body.q_NB
    omega_N = rotate(q_NB, body.omega_B)
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
    total = _ContactSum((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    total = _add_corners(params, body, params.foot_B, total)
    total = _add_corners(params, body, params.rotor_B, total)
    to_B = conjugate(body.q_NB)
    return rotate(to_B, total.force_N), rotate(to_B, total.moment_N), total.load


@kernel
def is_at_rest(params: GroundParams, body: Body, force_B: Vector, moment_B: Vector) -> bool:
    """Return whether a vehicle stands still, and stays so on all four feet under thrust, air and torques.

    The feet must carry enough of the weight, friction must hold force and yaw together, and the vehicle must not tip.
    """
    v_north, v_east, v_down = body.velocity_N
    p, q, r = body.omega_B
    speed, rate = v_north * v_north + v_east * v_east + v_down * v_down, p * p + q * q + r * r
    q_NB, (foot_x, foot_y, foot_z) = body.q_NB, params.foot_B
    ahead, right = rotate(q_NB, (foot_x, 0.0, 0.0))[2], rotate(q_NB, (0.0, foot_y, 0.0))[2]
    highest = body.position_N[2] + rotate(q_NB, (0.0, 0.0, foot_z))[2] - abs(ahead) - abs(right)
    F_N = rotate(q_NB, force_B)
    load = params.weight + F_N[2]
    pull = math.sqrt(F_N[0] * F_N[0] + F_N[1] * F_N[1])
    arm = math.sqrt(foot_x * foot_x + foot_y * foot_y)
    return (
        (speed <= _REST_SPEED * _REST_SPEED)
        & (rate <= _REST_SPEED * _REST_SPEED)
        & (highest > 0.0)
        & (load >= _REST_LOAD_SHARE * params.weight)
        & (pull + abs(moment_B[2]) / arm <= params.friction * load)
        & (abs(moment_B[0]) + foot_z * abs(force_B[1]) <= foot_y * load)
        & (abs(moment_B[1]) + foot_z * abs(force_B[0]) <= foot_x * load)
    )
