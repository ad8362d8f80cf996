"""Rigid body in six degrees of freedom with first-order actuators, and its RK4 step.

Translation is free or held: on the paper's test stand the vehicle rotates about its centre of mass and does not move.
All rotors share one lag. Torques and thrust are fixed sums of the rotors' thrusts, so each of them has that lag.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.rotations import conjugate, normalize, rotate
from firmware_model.types import Vector


class Body(NamedTuple):
    """State of airframe and actuators."""

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
    roll: float  # [N*m] B, torque of the actuators
    pitch: float
    yaw: float
    thrust: float  # [N] up, along -z of B


class BodyParams(NamedTuple):
    """Constants of the airframe, divided in advance: a division costs more than all else in a step."""

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
    """External inputs, constant over a step."""

    roll_command: float  # [N*m] B, commanded, within the actuators' limits
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
    thrust_command: float  # [N] commanded


def body_params(vehicle: Vehicle, *, free: bool) -> BodyParams:
    """Return the constants of a vehicle, `free` or held in translation."""
    I_x, I_y, I_z = vehicle.inertia_B
    return BodyParams(
        inverse_mass=1.0 / vehicle.mass,
        k1=(I_y - I_z) / I_x,
        k2=(I_z - I_x) / I_y,
        k3=(I_x - I_y) / I_z,
        inverse_I_x=1.0 / I_x,
        inverse_I_y=1.0 / I_y,
        inverse_I_z=1.0 / I_z,
        damping=vehicle.rate_damping,
        bandwidth=1.0 / vehicle.actuator_lag,
        free=float(free),
    )


@kernel
def attitude_derivative(params: BodyParams, body: Body, inputs: BodyInputs) -> Body:
    """Return the time derivative of the state, in a `Body`, for a vehicle held in translation.

    Euler's equations with principal inertia, and quaternion kinematics `q' = q omega / 2`. The yaw equation has
    N / I_z, where the paper's (2) prints L / I_z.
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
    """Return the time derivative of the state, in a `Body`: `attitude_derivative` with Newton's law in N."""
    q_NB = (body.qw, body.qx, body.qy, body.qz)
    F_N = rotate(q_NB, (inputs.F_x, inputs.F_y, inputs.F_z - body.thrust))
    north, east, down = params.free * body.v_north, params.free * body.v_east, params.free * body.v_down
    v_north = params.free * params.inverse_mass * F_N[0]
    v_east = params.free * params.inverse_mass * F_N[1]
    v_down = params.free * (params.inverse_mass * F_N[2] + GRAVITY)
    _, _, _, _, _, _, qw, qx, qy, qz, p, q, r, roll, pitch, yaw, thrust = attitude_derivative(params, body, inputs)
    return Body(north, east, down, v_north, v_east, v_down, qw, qx, qy, qz, p, q, r, roll, pitch, yaw, thrust)


@kernel
def _integrate_attitude(body: Body, h: float, rate: Body) -> Body:
    """Return the body moved by `h` times a derivative, with its translation held."""
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
    north, east, down = body.north + h * rate.north, body.east + h * rate.east, body.down + h * rate.down
    v_north, v_east = body.v_north + h * rate.v_north, body.v_east + h * rate.v_east
    v_down = body.v_down + h * rate.v_down
    _, _, _, _, _, _, qw, qx, qy, qz, p, q, r, roll, pitch, yaw, thrust = _integrate_attitude(body, h, rate)
    return Body(north, east, down, v_north, v_east, v_down, qw, qx, qy, qz, p, q, r, roll, pitch, yaw, thrust)


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
        north, east, down, v_north, v_east, v_down, qw, qx, qy, qz, p, q, r, roll, pitch, yaw, thrust = end
        qw, qx, qy, qz = normalize((qw, qx, qy, qz))
        return Body(north, east, down, v_north, v_east, v_down, qw, qx, qy, qz, p, q, r, roll, pitch, yaw, thrust)

    return step


step, step_attitude = runge_kutta(derivative), runge_kutta(attitude_derivative, _integrate_attitude)
"""Step any vehicle, and only one held in translation: for that the same bits, in less time."""


@kernel
def at_rest(pose: Body, actuators: Body) -> Body:
    """Return the body at rest in a pose, with the actuators of another state."""
    north, east, down, _, _, _, qw, qx, qy, qz, _, _, _, _, _, _, _ = pose
    roll, pitch, yaw, thrust = actuators.roll, actuators.pitch, actuators.yaw, actuators.thrust
    return Body(north, east, down, 0.0, 0.0, 0.0, qw, qx, qy, qz, 0.0, 0.0, 0.0, roll, pitch, yaw, thrust)


@kernel
def specific_force(params: BodyParams, body: Body, inputs: BodyInputs) -> Vector:
    """Return acceleration less gravity [m/s^2] B, the reading of an accelerometer at the centre of mass.

    On the stand it is minus gravity under all forces, because the stand carries the weight.
    """
    up = rotate(conjugate((body.qw, body.qx, body.qy, body.qz)), (0.0, 0.0, -GRAVITY))
    held = 1.0 - params.free
    return (
        params.free * params.inverse_mass * inputs.F_x + held * up[0],
        params.free * params.inverse_mass * inputs.F_y + held * up[1],
        params.free * params.inverse_mass * (inputs.F_z - body.thrust) + held * up[2],
    )
