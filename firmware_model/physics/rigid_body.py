"""The airframe in motion: rigid body in six degrees of freedom with first-order actuators, and its RK4 step.

Translation is free or held (the paper's test stand: it turns about its centre of mass and does not move).
All rotors share one lag, and torques and thrust are fixed sums of the rotors' thrusts, so each of them has that lag.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.rotations import conjugate, normalize, rotate
from firmware_model.types import Vector


class Body(NamedTuple):
    """State."""

    north: float  # [m]
    east: float
    down: float
    v_north: float  # [m/s]
    v_east: float
    v_down: float
    qw: float  # q_NB
    qx: float
    qy: float
    qz: float
    p: float  # [rad/s] B
    q: float
    r: float
    roll: float  # [N*m] B, what the actuators give
    pitch: float
    yaw: float
    thrust: float  # [N] up, along -z of B


class BodyParams(NamedTuple):
    """Constants of the airframe, divided out beforehand: a division costs more than all else in a step."""

    inverse_mass: float  # [1/kg]
    k1: float  # [-] (I_y - I_z) / I_x
    k2: float  # [-] (I_z - I_x) / I_y
    k3: float  # [-] (I_x - I_y) / I_z
    inverse_I_x: float  # [1/(kg*m^2)]
    inverse_I_y: float
    inverse_I_z: float
    damping: float  # [1/s] moment against the rate relative to the air, per inertia
    bandwidth: float  # [1/s] of the actuators, one over their time constant
    free: float  # 1 free, 0 held in translation


class BodyInputs(NamedTuple):
    """What acts from outside, constant over a step."""

    roll_command: float  # [N*m] B, asked of the actuators, within their limits
    pitch_command: float
    yaw_command: float
    L: float  # [N*m] B, disturbance moment
    M: float
    N: float
    p_gust: float  # [rad/s] B, angular gust
    q_gust: float
    r_gust: float
    F_x: float  # [N] B, all forces but gravity and thrust
    F_y: float
    F_z: float
    thrust_command: float  # [N] asked of the actuators


def body_params(vehicle: Vehicle, *, free: bool) -> BodyParams:
    """Return the constants of a vehicle, `free` or held in translation."""
    I_x, I_y, I_z = vehicle.inertia_B
    return BodyParams(
        1.0 / vehicle.mass, (I_y - I_z) / I_x, (I_z - I_x) / I_y, (I_x - I_y) / I_z, 1.0 / I_x, 1.0 / I_y, 1.0 / I_z,
        vehicle.rate_damping, 1.0 / vehicle.actuator_lag, float(free),
    )  # fmt: skip


@kernel
def attitude_derivative(params: BodyParams, body: Body, inputs: BodyInputs) -> Body:
    """Return the time derivative of the state, in a `Body`, of a vehicle that is held in translation.

    Euler's equations with principal inertia, quaternion kinematics `q' = q omega / 2`.
    The yaw equation has N / I_z, where the paper's (2) prints L / I_z.
    """
    p, q, r = body.p, body.q, body.r
    return Body(
        north=0.0,
        east=0.0,
        down=0.0,
        v_north=0.0,
        v_east=0.0,
        v_down=0.0,
        qw=-0.5 * (body.qx * p + body.qy * q + body.qz * r),
        qx=0.5 * (body.qw * p + body.qy * r - body.qz * q),
        qy=0.5 * (body.qw * q + body.qz * p - body.qx * r),
        qz=0.5 * (body.qw * r + body.qx * q - body.qy * p),
        p=params.k1 * q * r + (body.roll + inputs.L) * params.inverse_I_x - params.damping * (p - inputs.p_gust),
        q=params.k2 * r * p + (body.pitch + inputs.M) * params.inverse_I_y - params.damping * (q - inputs.q_gust),
        r=params.k3 * p * q + (body.yaw + inputs.N) * params.inverse_I_z - params.damping * (r - inputs.r_gust),
        roll=params.bandwidth * (inputs.roll_command - body.roll),
        pitch=params.bandwidth * (inputs.pitch_command - body.pitch),
        yaw=params.bandwidth * (inputs.yaw_command - body.yaw),
        thrust=params.bandwidth * (inputs.thrust_command - body.thrust),
    )


@kernel
def derivative(params: BodyParams, body: Body, inputs: BodyInputs) -> Body:
    """Return the time derivative of the state, in a `Body`: that of `attitude_derivative`, and Newton's law in N."""
    q_NB = (body.qw, body.qx, body.qy, body.qz)
    F_N = rotate(q_NB, (inputs.F_x, inputs.F_y, inputs.F_z - body.thrust))
    turn = attitude_derivative(params, body, inputs)
    return Body(
        params.free * body.v_north,
        params.free * body.v_east,
        params.free * body.v_down,
        params.free * params.inverse_mass * F_N[0],
        params.free * params.inverse_mass * F_N[1],
        params.free * (params.inverse_mass * F_N[2] + GRAVITY),
        turn.qw, turn.qx, turn.qy, turn.qz, turn.p, turn.q, turn.r, turn.roll, turn.pitch, turn.yaw, turn.thrust,
    )  # fmt: skip


@kernel
def _integrate_attitude(body: Body, h: float, rate: Body) -> Body:
    """Return the body moved by `h` times a derivative, of one that is held: where it is stays as it is."""
    return Body(
        body.north,
        body.east,
        body.down,
        body.v_north,
        body.v_east,
        body.v_down,
        body.qw + h * rate.qw,
        body.qx + h * rate.qx,
        body.qy + h * rate.qy,
        body.qz + h * rate.qz,
        body.p + h * rate.p,
        body.q + h * rate.q,
        body.r + h * rate.r,
        body.roll + h * rate.roll,
        body.pitch + h * rate.pitch,
        body.yaw + h * rate.yaw,
        body.thrust + h * rate.thrust,
    )


@kernel
def _integrate(body: Body, h: float, rate: Body) -> Body:
    """Return the body moved by `h` times a derivative."""
    turned = _integrate_attitude(body, h, rate)
    return Body(
        body.north + h * rate.north,
        body.east + h * rate.east,
        body.down + h * rate.down,
        body.v_north + h * rate.v_north,
        body.v_east + h * rate.v_east,
        body.v_down + h * rate.v_down,
        turned.qw, turned.qx, turned.qy, turned.qz, turned.p, turned.q, turned.r,
        turned.roll, turned.pitch, turned.yaw, turned.thrust,
    )  # fmt: skip


Params = TypeVar("Params")
Inputs = TypeVar("Inputs")


def runge_kutta(
    rate: Callable[[Params, Body, Inputs], Body], along: Callable[[Body, float, Body], Body] = _integrate
) -> Callable[[Params, Body, Inputs, float], Body]:
    """Return the kernel `step(params, body, inputs, dt)` of the classical method for the time derivative `rate`.

    `along(body, h, rate)` is the body moved by `h` times a derivative. The error falls with `dt` [s] to the fourth.
    """

    @kernel
    def step(params: Params, body: Body, inputs: Inputs, dt: float) -> Body:
        # What is done with a derivative is done at once, so that few numbers have to be kept.
        a = rate(params, body, inputs)
        end, middle = along(body, dt / 6.0, a), along(body, 0.5 * dt, a)
        b = rate(params, middle, inputs)
        end, middle = along(end, dt / 3.0, b), along(body, 0.5 * dt, b)
        c = rate(params, middle, inputs)
        end, last = along(end, dt / 3.0, c), along(body, dt, c)
        end = along(end, dt / 6.0, rate(params, last, inputs))
        qw, qx, qy, qz = normalize((end.qw, end.qx, end.qy, end.qz))
        return Body(
            end.north, end.east, end.down, end.v_north, end.v_east, end.v_down,
            qw, qx, qy, qz, end.p, end.q, end.r, end.roll, end.pitch, end.yaw, end.thrust,
        )  # fmt: skip

    return step


step, step_attitude = runge_kutta(derivative), runge_kutta(attitude_derivative, _integrate_attitude)
"""The vehicle as its parameters say, and one that is held: the same to the bit, in less time."""


@kernel
def at_rest(pose: Body, actuators: Body) -> Body:
    """Return the body at rest in a pose, with the actuators of another state."""
    return Body(
        pose.north, pose.east, pose.down, 0.0, 0.0, 0.0, pose.qw, pose.qx, pose.qy, pose.qz, 0.0, 0.0, 0.0,
        actuators.roll, actuators.pitch, actuators.yaw, actuators.thrust,
    )  # fmt: skip


@kernel
def specific_force(params: BodyParams, body: Body, inputs: BodyInputs) -> Vector:
    """Return acceleration less gravity [m/s^2] B, what an accelerometer at the centre of mass feels.

    Held, the stand carries the weight: minus gravity, whatever the forces.
    """
    up = rotate(conjugate((body.qw, body.qx, body.qy, body.qz)), (0.0, 0.0, -GRAVITY))
    held = 1.0 - params.free
    return (
        params.free * params.inverse_mass * inputs.F_x + held * up[0],
        params.free * params.inverse_mass * inputs.F_y + held * up[1],
        params.free * params.inverse_mass * (inputs.F_z - body.thrust) + held * up[2],
    )
