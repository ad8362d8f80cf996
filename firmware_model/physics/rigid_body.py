"""Rigid body in six degrees of freedom with first-order actuators, and its RK4 step.

Translation is free or held: on the paper's test stand the vehicle rotates about its centre of mass and does not move.
All rotors share one lag. Torques and thrust are fixed sums of the rotors' thrusts, so each of them has that lag.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.exact import exp
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.rotations import conjugate, normalize, rotate
from firmware_model.types import Quaternion, Vector

_ZERO = (0.0, 0.0, 0.0)


class Body(NamedTuple):
    """State of airframe and actuators."""

    position_N: Vector
    """[m] N."""
    velocity_N: Vector
    """[m/s] N."""
    q_NB: Quaternion
    """Attitude."""
    omega_B: Vector
    """[rad/s] B."""
    torque_B: Vector
    """[N*m] B, of the actuators."""
    thrust: float
    """[N] up, along -z of B."""


class Motion(NamedTuple):
    """Motion of the airframe past the air around it."""

    flow_B: Vector
    """[m/s] B, velocity of the mean wind relative to the vehicle; no gust."""
    q_NB: Quaternion
    """Attitude."""
    omega_B: Vector
    """[rad/s] B."""


class Wrench(NamedTuple):
    """Torques and thrust that actuators give, or are to give."""

    torque_B: Vector
    """[N*m] B."""
    thrust: float
    """[N] up, along -z of B."""


class BodyParams(NamedTuple):
    """Constants of the airframe, divided in advance: a division costs more than all else in a step."""

    inverse_mass: float  # [1/kg]
    k1: float  # [-] (I_y - I_z) / I_x
    k2: float  # [-] (I_z - I_x) / I_y
    k3: float  # [-] (I_x - I_y) / I_z
    inverse_I_x: float  # [1/(kg*m^2)]
    inverse_I_y: float
    inverse_I_z: float
    damping_x: float  # [1/s] moment against the rate relative to the air, per inertia
    damping_y: float
    damping_z: float
    lag: float  # [-] share of the way to a command that actuators still have to go after half a step


def body_params(vehicle: Vehicle, dt: float) -> BodyParams:
    """Return the constants of a vehicle for steps of `dt` [s]."""
    I_x, I_y, I_z = vehicle.inertia_B
    damping_x, damping_y, damping_z = vehicle.rate_damping_B
    return BodyParams(
        inverse_mass=1.0 / vehicle.mass,
        k1=(I_y - I_z) / I_x,
        k2=(I_z - I_x) / I_y,
        k3=(I_x - I_y) / I_z,
        inverse_I_x=1.0 / I_x,
        inverse_I_y=1.0 / I_y,
        inverse_I_z=1.0 / I_z,
        damping_x=damping_x,
        damping_y=damping_y,
        damping_z=damping_z,
        lag=exp(-0.5 * dt / vehicle.actuator_lag),
    )


@kernel
def _approach(lag: float, produced: float, command: float) -> float:
    return command + lag * (produced - command)


@kernel
def _move_actuators(lag: float, produced: Wrench, command: Wrench) -> Wrench:
    (a, b, c), (L, M, N) = produced.torque_B, command.torque_B
    torque_B = (_approach(lag, a, L), _approach(lag, b, M), _approach(lag, c, N))
    return Wrench(torque_B, _approach(lag, produced.thrust, command.thrust))


@kernel
def step_actuators(params: BodyParams, produced: Wrench, command: Wrench) -> tuple[Wrench, Wrench]:
    """Return what the actuators give in the middle of a step and at its end, exactly, under a constant command."""
    middle = _move_actuators(params.lag, produced, command)
    return middle, _move_actuators(params.lag, middle, command)


@kernel
def get_wrench(body: Body) -> Wrench:
    """Return the actuators' part of a state."""
    return Wrench(body.torque_B, body.thrust)


@kernel
def turn_from_outside(params: BodyParams, moment_B: Vector, gust_omega_B: Vector) -> Vector:
    """Return the angular acceleration [rad/s^2] B by a moment [N*m] B and an angular gust [rad/s] B."""
    damping = (params.damping_x, params.damping_y, params.damping_z)
    by_gust = (damping[0] * gust_omega_B[0], damping[1] * gust_omega_B[1], damping[2] * gust_omega_B[2])
    return add_moment(params, by_gust, moment_B)


@kernel
def add_moment(params: BodyParams, turn_B: Vector, moment_B: Vector) -> Vector:
    """Return an angular acceleration [rad/s^2] B and that by a moment [N*m] B."""
    return (
        turn_B[0] + moment_B[0] * params.inverse_I_x,
        turn_B[1] + moment_B[1] * params.inverse_I_y,
        turn_B[2] + moment_B[2] * params.inverse_I_z,
    )


@kernel
def _omega_rate(params: BodyParams, omega_B: Vector, turn_B: Vector) -> Vector:
    """Return the angular acceleration [rad/s^2] B: Euler's equations with principal inertia.

    `turn_B` [rad/s^2] B is the part by all moments, angular gusts among them. The yaw equation has N / I_z, where the
    paper's (2) prints L / I_z.
    """
    p, q, r = omega_B
    return (
        params.k1 * q * r + (turn_B[0] - params.damping_x * p),
        params.k2 * r * p + (turn_B[1] - params.damping_y * q),
        params.k3 * p * q + (turn_B[2] - params.damping_z * r),
    )


@kernel
def _turn_rate(_: float, q_NB: Quaternion, omega_B: Vector) -> Quaternion:
    """Return twice the rate of the attitude, `2 q' = q omega`."""
    w, x, y, z = q_NB
    p, q, r = omega_B
    return -(x * p + y * q + z * r), w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p


@kernel
def _fall(q_NB: Quaternion) -> Vector:
    """Return the acceleration [m/s^2] B of gravity."""
    w, x, y, z = q_NB
    twice_w, twice_z = 2.0 * GRAVITY * w, 2.0 * GRAVITY * z
    return x * twice_z - y * twice_w, y * twice_z + x * twice_w, GRAVITY - 2.0 * GRAVITY * (x * x + y * y)


@kernel
def motion_rate(params: BodyParams, motion: Motion, push_B: Vector, turn_B: Vector) -> Motion:
    """Return the time derivative of a motion in free flight, in a `Motion`; that of the attitude twice.

    `push_B` [m/s^2] B is the acceleration by all forces but gravity, `turn_B` [rad/s^2] B that by all moments. In B the
    air's velocity also changes because B turns: `flow' = -push - gravity - omega x flow`.
    """
    (x, y, z), (p, q, r), fall = motion.flow_B, motion.omega_B, _fall(motion.q_NB)
    flow_rate = (
        (r * y - q * z) - (push_B[0] + fall[0]),
        (p * z - r * x) - (push_B[1] + fall[1]),
        (q * x - p * y) - (push_B[2] + fall[2]),
    )
    return Motion(flow_rate, _turn_rate(0.0, motion.q_NB, motion.omega_B), _omega_rate(params, motion.omega_B, turn_B))


@kernel
def scale(h: float, a: Vector) -> Vector:
    """Return `h` times a vector."""
    return h * a[0], h * a[1], h * a[2]


@kernel
def add(a: Vector, b: Vector) -> Vector:
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def _scale_quaternion(h: float, q: Quaternion) -> Quaternion:
    return h * q[0], h * q[1], h * q[2], h * q[3]


@kernel
def _rotation(h: float, rate: Quaternion) -> Quaternion:
    """Return the change of attitude in `h` [s], of twice its rate: the half is taken of one number, not of four."""
    return _scale_quaternion(0.5 * h, rate)


@kernel
def _add_quaternions(a: Quaternion, b: Quaternion) -> Quaternion:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]


@kernel
def change_motion(h: float, rate: Motion) -> Motion:
    """Return the change of a motion in `h` [s] at a time derivative."""
    return Motion(scale(h, rate.flow_B), _rotation(h, rate.q_NB), scale(h, rate.omega_B))


@kernel
def add_motions(a: Motion, b: Motion) -> Motion:
    """Return the sum of two motions or changes."""
    return Motion(add(a.flow_B, b.flow_B), _add_quaternions(a.q_NB, b.q_NB), add(a.omega_B, b.omega_B))


@kernel
def scale_motion(h: float, a: Motion) -> Motion:
    """Return `h` times a motion."""
    return Motion(scale(h, a.flow_B), _scale_quaternion(h, a.q_NB), scale(h, a.omega_B))


@kernel
def with_unit_length(motion: Motion) -> Motion:
    """Return a motion with its attitude at unit length."""
    return Motion(motion.flow_B, normalize(motion.q_NB), motion.omega_B)


Params = TypeVar("Params")
Inputs = TypeVar("Inputs")
State = TypeVar("State")


def make_stages(
    rate: Callable[[Params, State, Inputs], State],
    change: Callable[[float, State], State],
    add: Callable[[State, State], State],
    scale: Callable[[float, State], State],
) -> Callable[[Params, State, tuple[Inputs, ...], float], tuple[tuple[State, ...], State]]:
    """Return the kernel `stages(params, x, inputs, dt)`: a step of the classical Runge-Kutta method of order 4.

    `rate` is the time derivative of the state, and `inputs` holds the inputs of each of the four stages.
    `change(h, derivative)` returns the change of the state in `h` [s]; `add` and `scale` work on states. The kernel
    returns the states of the stages, and that after `dt` [s].
    """

    @kernel
    def stages(params: Params, x: State, inputs: tuple[Inputs, ...], dt: float) -> tuple[tuple[State, ...], State]:
        a = change(0.5 * dt, rate(params, x, inputs[0]))
        second = add(x, a)
        b = change(0.5 * dt, rate(params, second, inputs[1]))
        third = add(x, b)
        c = change(dt, rate(params, third, inputs[2]))
        fourth = add(x, c)
        d = change(0.5 * dt, rate(params, fourth, inputs[3]))
        return (x, second, third, fourth), add(x, scale(1.0 / 3.0, add(add(add(a, add(b, b)), c), d)))

    return stages


_omega_stages = make_stages(_omega_rate, scale, add, scale)
_turn_stages = make_stages(_turn_rate, _rotation, _add_quaternions, _scale_quaternion)


@kernel
def step_attitude(params: BodyParams, body: Body, command: Wrench, outside_B: Vector, dt: float) -> Body:
    """Step a vehicle held in translation by the classical method, whose error falls with `dt` [s] to the fourth power.

    `outside_B` [rad/s^2] B is that of `turn_from_outside`. Torque, rates and attitude follow each other: each needs but
    the stages of the one before. One after the other, they need hardly more numbers at once than a processor has
    registers.
    """
    middle, end = step_actuators(params, get_wrench(body), command)
    first, last = add_moment(params, outside_B, body.torque_B), add_moment(params, outside_B, end.torque_B)
    between = add_moment(params, outside_B, middle.torque_B)
    omegas, omega_B = _omega_stages(params, body.omega_B, (first, between, between, last), dt)
    q_NB = normalize(_turn_stages(0.0, body.q_NB, omegas, dt)[1])
    return Body(body.position_N, body.velocity_N, q_NB, omega_B, end.torque_B, end.thrust)


@kernel
def at_rest(pose: Body, actuators: Body) -> Body:
    """Return the body at rest in a pose, with the actuators of another state."""
    return Body(pose.position_N, _ZERO, pose.q_NB, _ZERO, actuators.torque_B, actuators.thrust)


@kernel
def held_force(q_NB: Quaternion) -> Vector:
    """Return the specific force [m/s^2] B on the stand, which carries the weight: minus gravity under all forces."""
    return rotate(conjugate(q_NB), (0.0, 0.0, -GRAVITY))
