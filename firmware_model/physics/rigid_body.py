"""Rigid body in six degrees of freedom with first-order actuators, and its RK4 step.

Translation is free or held: on the paper's test stand the vehicle rotates about its centre of mass and does not move.
All rotors share one lag. Torques and thrust are fixed sums of the rotors' thrusts, so each of them has that lag.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from firmware_model.config.vehicle import GRAVITY, Vehicle
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
    bandwidth: float  # [1/s] of the actuators, one over their time constant
    free: float  # 1 free, 0 held in translation


class BodyInputs(NamedTuple):
    """External inputs, constant over a step."""

    torque_command_B: Vector
    """[N*m] B, commanded, within the actuators' limits."""
    moment_B: Vector
    """[N*m] B, disturbance moment."""
    gust_omega_B: Vector
    """[rad/s] B, angular gust."""
    force_B: Vector
    """[N] B, all forces but gravity and thrust."""
    thrust_command: float
    """[N] commanded."""


def body_params(vehicle: Vehicle, *, free: bool) -> BodyParams:
    """Return the constants of a vehicle, `free` or held in translation."""
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
        bandwidth=1.0 / vehicle.actuator_lag,
        free=float(free),
    )


@kernel
def attitude_derivative(params: BodyParams, body: Body, inputs: BodyInputs) -> Body:
    """Return the time derivative of the state, in a `Body`, for a vehicle held in translation.

    Euler's equations with principal inertia, and quaternion kinematics `q' = q omega / 2`. The yaw equation has
    N / I_z, where the paper's (2) prints L / I_z.
    """
    w, x, y, z = body.q_NB
    p, q, r = body.omega_B
    L, M, N = inputs.moment_B
    p_gust, q_gust, r_gust = inputs.gust_omega_B
    roll, pitch, yaw = body.torque_B
    roll_command, pitch_command, yaw_command = inputs.torque_command_B
    omega_rate = (
        params.k1 * q * r + (roll + L) * params.inverse_I_x - params.damping_x * (p - p_gust),
        params.k2 * r * p + (pitch + M) * params.inverse_I_y - params.damping_y * (q - q_gust),
        params.k3 * p * q + (yaw + N) * params.inverse_I_z - params.damping_z * (r - r_gust),
    )
    rate = params.bandwidth
    return Body(
        _ZERO,
        _ZERO,
        (
            -0.5 * (x * p + y * q + z * r),
            0.5 * (w * p + y * r - z * q),
            0.5 * (w * q + z * p - x * r),
            0.5 * (w * r + x * q - y * p),
        ),
        omega_rate,
        (rate * (roll_command - roll), rate * (pitch_command - pitch), rate * (yaw_command - yaw)),
        rate * (inputs.thrust_command - body.thrust),
    )


@kernel
def derivative(params: BodyParams, body: Body, inputs: BodyInputs) -> Body:
    """Return the time derivative of the state, in a `Body`: `attitude_derivative` with Newton's law in N."""
    F_x, F_y, F_z = inputs.force_B
    F_N = rotate(body.q_NB, (F_x, F_y, F_z - body.thrust))
    free, free_inverse_mass = params.free, params.free * params.inverse_mass
    v_north, v_east, v_down = body.velocity_N
    down_rate = free * (params.inverse_mass * F_N[2] + GRAVITY)
    rate = attitude_derivative(params, body, inputs)
    return Body(
        (free * v_north, free * v_east, free * v_down),
        (free_inverse_mass * F_N[0], free_inverse_mass * F_N[1], down_rate),
        rate.q_NB,
        rate.omega_B,
        rate.torque_B,
        rate.thrust,
    )


@kernel
def _move(a: Vector, h: float, rate: Vector) -> Vector:
    return a[0] + h * rate[0], a[1] + h * rate[1], a[2] + h * rate[2]


@kernel
def _integrate_attitude(body: Body, h: float, rate: Body) -> Body:
    """Return the body moved by `h` times a derivative, with its translation held."""
    (w, x, y, z), dq = body.q_NB, rate.q_NB
    q_NB = (w + h * dq[0], x + h * dq[1], y + h * dq[2], z + h * dq[3])
    omega_B, torque_B = _move(body.omega_B, h, rate.omega_B), _move(body.torque_B, h, rate.torque_B)
    return Body(body.position_N, body.velocity_N, q_NB, omega_B, torque_B, body.thrust + h * rate.thrust)


@kernel
def _integrate(body: Body, h: float, rate: Body) -> Body:
    """Return the body moved by `h` times a derivative."""
    position_N, velocity_N = _move(body.position_N, h, rate.position_N), _move(body.velocity_N, h, rate.velocity_N)
    turned = _integrate_attitude(body, h, rate)
    return Body(position_N, velocity_N, turned.q_NB, turned.omega_B, turned.torque_B, turned.thrust)


Params = TypeVar("Params")
Inputs = TypeVar("Inputs")


def runge_kutta(
    rate: Callable[[Params, Body, Inputs], Body], integrate: Callable[[Body, float, Body], Body] = _integrate
) -> Callable[[Params, Body, Inputs, float], Body]:
    """Return the kernel `step(params, body, inputs, dt)` of the classical method for the time derivative `rate`.

    `integrate(body, h, rate)` returns the body moved by `h` times a derivative. The error falls with `dt` [s] to the
    fourth power.
    """

    @kernel
    def step(params: Params, body: Body, inputs: Inputs, dt: float) -> Body:
        # Each derivative is used up at once, so that few numbers have to be kept.
        a = rate(params, body, inputs)
        end, middle = integrate(body, dt / 6.0, a), integrate(body, 0.5 * dt, a)
        b = rate(params, middle, inputs)
        end, middle = integrate(end, dt / 3.0, b), integrate(body, 0.5 * dt, b)
        c = rate(params, middle, inputs)
        end, last = integrate(end, dt / 3.0, c), integrate(body, dt, c)
        end = integrate(end, dt / 6.0, rate(params, last, inputs))
        q_NB = normalize(end.q_NB)
        return Body(end.position_N, end.velocity_N, q_NB, end.omega_B, end.torque_B, end.thrust)

    return step


step, step_attitude = runge_kutta(derivative), runge_kutta(attitude_derivative, _integrate_attitude)
"""Step any vehicle, and only one held in translation: for that the same bits, in less time."""


@kernel
def at_rest(pose: Body, actuators: Body) -> Body:
    """Return the body at rest in a pose, with the actuators of another state."""
    return Body(pose.position_N, _ZERO, pose.q_NB, _ZERO, actuators.torque_B, actuators.thrust)


@kernel
def specific_force(params: BodyParams, body: Body, inputs: BodyInputs) -> Vector:
    """Return acceleration less gravity [m/s^2] B, the reading of an accelerometer at the centre of mass.

    On the stand it is minus gravity under all forces, because the stand carries the weight.
    """
    up = rotate(conjugate(body.q_NB), (0.0, 0.0, -GRAVITY))
    held, free_inverse_mass = 1.0 - params.free, params.free * params.inverse_mass
    F_x, F_y, F_z = inputs.force_B
    return (
        free_inverse_mass * F_x + held * up[0],
        free_inverse_mass * F_y + held * up[1],
        free_inverse_mass * (F_z - body.thrust) + held * up[2],
    )
