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


class Motion(NamedTuple):
    """State of the airframe."""

    position_N: Vector
    """[m] N."""
    velocity_N: Vector
    """[m/s] N."""
    q_NB: Quaternion
    """Attitude."""
    omega_B: Vector
    """[rad/s] B."""


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
def _torque_rate(bandwidth: float, torque: Vector, command: Vector) -> Vector:
    """Return the rate [N*m/s] B of the actuators' torque [N*m] B under a command."""
    return (
        bandwidth * (command[0] - torque[0]),
        bandwidth * (command[1] - torque[1]),
        bandwidth * (command[2] - torque[2]),
    )


@kernel
def _thrust_rate(bandwidth: float, thrust: float, command: float) -> float:
    return bandwidth * (command - thrust)


@kernel
def _omega_rate(acting: tuple[BodyParams, Vector, Vector], omega_B: Vector, torque_B: Vector) -> Vector:
    """Return the angular acceleration [rad/s^2] B: Euler's equations with principal inertia.

    `acting` holds the constants, the moment [N*m] B and the angular gust [rad/s] B. The yaw equation has N / I_z, where
    the paper's (2) prints L / I_z.
    """
    params, (L, M, N), (p_gust, q_gust, r_gust) = acting
    p, q, r = omega_B
    roll, pitch, yaw = torque_B
    return (
        params.k1 * q * r + (roll + L) * params.inverse_I_x - params.damping_x * (p - p_gust),
        params.k2 * r * p + (pitch + M) * params.inverse_I_y - params.damping_y * (q - q_gust),
        params.k3 * p * q + (yaw + N) * params.inverse_I_z - params.damping_z * (r - r_gust),
    )


@kernel
def _turn_rate(_: float, q_NB: Quaternion, omega_B: Vector) -> Quaternion:
    """Return twice the rate of the attitude, `2 q' = q omega`."""
    w, x, y, z = q_NB
    p, q, r = omega_B
    return -(x * p + y * q + z * r), w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p


@kernel
def free_derivative(params: BodyParams, body: Body, inputs: BodyInputs) -> Motion:
    """Return the time derivative of the airframe's state in free flight, in a `Motion`; that of the attitude twice."""
    F_x, F_y, F_z = inputs.force_B
    north, east, down = rotate(body.q_NB, (F_x, F_y, F_z - body.thrust))
    acting = (params, inputs.moment_B, inputs.gust_omega_B)
    return Motion(
        body.velocity_N,
        (params.inverse_mass * north, params.inverse_mass * east, params.inverse_mass * down + GRAVITY),
        _turn_rate(0.0, body.q_NB, body.omega_B),
        _omega_rate(acting, body.omega_B, body.torque_B),
    )


@kernel
def _move(a: Vector, h: float, rate: Vector) -> Vector:
    return a[0] + h * rate[0], a[1] + h * rate[1], a[2] + h * rate[2]


@kernel
def _move_float(a: float, h: float, rate: float) -> float:
    return a + h * rate


@kernel
def _move_quaternion(q: Quaternion, h: float, rate: Quaternion) -> Quaternion:
    """Return the attitude moved by half of `h` times twice its rate: one product less than with the rate itself."""
    half = 0.5 * h
    return q[0] + half * rate[0], q[1] + half * rate[1], q[2] + half * rate[2], q[3] + half * rate[3]


@kernel
def get_motion(body: Body) -> Motion:
    """Return the airframe's part of a state."""
    return Motion(body.position_N, body.velocity_N, body.q_NB, body.omega_B)


@kernel
def join(motion: Motion, torque_B: Vector, thrust: float) -> Body:
    """Return the state of airframe and actuators, whose torques are in [N*m] B and thrust in [N]."""
    return Body(motion.position_N, motion.velocity_N, motion.q_NB, motion.omega_B, torque_B, thrust)


@kernel
def move_motion(motion: Motion, h: float, rate: Motion) -> Motion:
    """Return the airframe's state moved by `h` times a derivative."""
    return Motion(
        _move(motion.position_N, h, rate.position_N),
        _move(motion.velocity_N, h, rate.velocity_N),
        _move_quaternion(motion.q_NB, h, rate.q_NB),
        _move(motion.omega_B, h, rate.omega_B),
    )


@kernel
def with_unit_length(motion: Motion) -> Motion:
    """Return the airframe's state with its attitude at unit length."""
    return Motion(motion.position_N, motion.velocity_N, normalize(motion.q_NB), motion.omega_B)


Params = TypeVar("Params")
Inputs = TypeVar("Inputs")
State = TypeVar("State")


def make_stages(
    rate: Callable[[Params, State, Inputs], State], move: Callable[[State, float, State], State]
) -> Callable[[Params, State, tuple[Inputs, ...], float], tuple[tuple[State, ...], State]]:
    """Return the kernel `stages(params, x, inputs, dt)`, a step of the classical method for the time derivative `rate`.

    `inputs` holds those of each of the four stages, `move(x, h, rate)` returns the state moved by `h` times a
    derivative. The kernel returns the states of the stages, and that after `dt` [s].
    """

    @kernel
    def stages(params: Params, x: State, inputs: tuple[Inputs, ...], dt: float) -> tuple[tuple[State, ...], State]:
        # Each derivative is used up at once, so that few numbers have to be kept.
        a = rate(params, x, inputs[0])
        end, second = move(x, dt / 6.0, a), move(x, 0.5 * dt, a)
        b = rate(params, second, inputs[1])
        end, third = move(end, dt / 3.0, b), move(x, 0.5 * dt, b)
        c = rate(params, third, inputs[2])
        end, fourth = move(end, dt / 3.0, c), move(x, dt, c)
        return (x, second, third, fourth), move(end, dt / 6.0, rate(params, fourth, inputs[3]))

    return stages


_torque_stages, _thrust_stages = make_stages(_torque_rate, _move), make_stages(_thrust_rate, _move_float)
_omega_stages, _turn_stages = make_stages(_omega_rate, _move), make_stages(_turn_rate, _move_quaternion)


@kernel
def step_actuators(
    params: BodyParams, body: Body, inputs: BodyInputs, dt: float
) -> tuple[tuple[Vector, ...], Vector, tuple[float, ...], float]:
    """Return torques [N*m] B of the actuators at each stage, and after `dt` [s]; then the thrusts [N]."""
    command, lift = inputs.torque_command_B, inputs.thrust_command
    torques, torque_B = _torque_stages(params.bandwidth, body.torque_B, (command, command, command, command), dt)
    thrusts, thrust = _thrust_stages(params.bandwidth, body.thrust, (lift, lift, lift, lift), dt)
    return torques, torque_B, thrusts, thrust


@kernel
def step_attitude(params: BodyParams, body: Body, inputs: BodyInputs, dt: float) -> Body:
    """Step a vehicle held in translation by the classical method, whose error falls with `dt` [s] to the fourth power.

    Torque, rates and attitude follow each other: each needs only the stages of the one before. One after the other,
    they need hardly more numbers at once than a processor has registers.
    """
    torques, torque_B, _, thrust = step_actuators(params, body, inputs, dt)
    acting = (params, inputs.moment_B, inputs.gust_omega_B)
    omegas, omega_B = _omega_stages(acting, body.omega_B, torques, dt)
    q_NB = normalize(_turn_stages(0.0, body.q_NB, omegas, dt)[1])
    return Body(body.position_N, body.velocity_N, q_NB, omega_B, torque_B, thrust)


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
