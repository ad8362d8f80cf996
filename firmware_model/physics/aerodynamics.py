"""Free flight: the rigid body in moving air, with drag, and on the ground.

Force and moment of the air have one cause, the air's velocity relative to the vehicle. Each rotor drags along with the
air through its plane, at a height above the centre of mass (see `gust_moment`), and so does the body.
"""

import math
from typing import NamedTuple

from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.rotations import conjugate, rotate
from firmware_model.physics import rigid_body
from firmware_model.physics.dryden import gust_moment
from firmware_model.physics.ground import GroundParams, can_touch_ground, ground_wrench, is_at_rest
from firmware_model.physics.rigid_body import (
    Body,
    BodyInputs,
    BodyParams,
    Motion,
    at_rest,
    get_motion,
    join,
    move_motion,
    with_unit_length,
)
from firmware_model.physics.rotors import LossParams, given_by_rotors, lost_wrench
from firmware_model.types import Vector

AIR_DENSITY = 1.225
"""[kg/m^3] ICAO standard atmosphere at sea level."""


class AirParams(NamedTuple):
    """Drag and moment coefficients of a vehicle."""

    inverse_weight: float  # [1/N]
    rotor_drag: float  # [N/(m/s)] all rotors in hover, in their plane
    heave_drag: float  # [N/(m/s)] all rotors in hover, along their axis
    body_drag: float  # [N/(m/s)^2]
    gust_gain: float  # [N*m/(m/s)]
    gust_yaw_ratio: float  # [-]


class Air(NamedTuple):
    """Motion of the air, constant over a sample."""

    gust_B: Vector
    """[m/s] B, gust, blowing toward."""
    wind_N: Vector
    """[m/s] N, mean wind, blowing toward."""


class Stream(NamedTuple):
    """Air as a vehicle meets it: all roots of a step's stage, so that SIMD can take them well before it needs them."""

    velocity_B: Vector
    """[m/s] B, of the air relative to the vehicle."""
    body_drag: float
    """[N/(m/s)]."""
    spin: float
    """[-] rotor speed, 1 in hover."""


class FreeParams(NamedTuple):
    """Constants of a vehicle in free flight."""

    body: BodyParams
    """Airframe, its units beside each number."""
    air: AirParams
    """Drag, its units beside each number."""
    ground: GroundParams
    """Feet, their units beside each number."""
    loss: LossParams = LossParams()
    """Failed rotors, units beside each number."""


class FreeInputs(NamedTuple):
    """External inputs, constant over a sample."""

    body: BodyInputs
    """Commands, direct moments, angular gusts, units beside each number; no forces."""
    air: Air
    """Gust and wind, units beside each number."""
    near_ground: bool
    """True if the ground may be near; otherwise contact is skipped."""
    failed: bool = False
    """True if a rotor may have failed; otherwise all are sound."""


def air_params(vehicle: Vehicle) -> AirParams:
    """Return a vehicle's coefficients in the air."""
    return AirParams(
        inverse_weight=1.0 / (vehicle.mass * GRAVITY),
        rotor_drag=vehicle.rotor_drag,
        heave_drag=vehicle.heave_drag,
        body_drag=0.5 * AIR_DENSITY * vehicle.drag_area,
        gust_gain=vehicle.gust_gain,
        gust_yaw_ratio=vehicle.gust_yaw_ratio,
    )


@kernel
def meet_air(params: AirParams, motion: Motion, thrust: float, air: Air) -> Stream:
    """Return the air as a vehicle meets it whose rotors give a thrust [N]."""
    (north, east, down), (v_north, v_east, v_down) = air.wind_N, motion.velocity_N
    mean = rotate(conjugate(motion.q_NB), (north - v_north, east - v_east, down - v_down))
    gust = air.gust_B
    v_B = (gust[0] + mean[0], gust[1] + mean[1], gust[2] + mean[2])
    square = params.body_drag * math.sqrt(v_B[0] * v_B[0] + v_B[1] * v_B[1] + v_B[2] * v_B[2])
    return Stream(v_B, square, math.sqrt(max(thrust, 0.0) * params.inverse_weight))


@kernel
def air_wrench(params: AirParams, stream: Stream, air: Air) -> tuple[Vector, Vector]:
    """Return force [N] B and moment [N*m] B of the air.

    Rotor drag is proportional to the relative air velocity and to rotor speed, which goes with the root of the thrust
    and is 1 in hover. Body drag is quadratic, the same in all directions. Only gusts yaw the vehicle: a uniform
    stream acts on all rotors equally.
    """
    v_B, square, spin = stream
    plane, axis = spin * params.rotor_drag + square, spin * params.heave_drag + square
    moment = gust_moment(spin * params.gust_gain, params.gust_yaw_ratio, (v_B[0], v_B[1], air.gust_B[2]))
    return (plane * v_B[0], plane * v_B[1], axis * v_B[2]), moment


@kernel
def _add(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def sum_inputs(params: FreeParams, body: Body, inputs: FreeInputs) -> tuple[BodyInputs, bool, float]:
    """Return the inputs with all forces and moments but gravity, whether the vehicle rests, and the ground's load [N].

    Among them is what failed rotors don't give, as an opposite force and moment. At rest the ground's force balances
    all others; the springs' force among those returned is then not the real one.
    """
    return _sum_inputs(params, body, _meet_air(params, body, inputs), inputs)


@kernel
def _meet_air(params: FreeParams, body: Body, inputs: FreeInputs) -> Stream:
    return meet_air(params.air, get_motion(body), _given(params, body, inputs).thrust, inputs.air)


@kernel
def _sum_inputs(params: FreeParams, body: Body, stream: Stream, inputs: FreeInputs) -> tuple[BodyInputs, bool, float]:
    outside, given = inputs.body, _given(params, body, inputs)
    force, moment = air_wrench(params.air, stream, inputs.air)
    moment, load, resting = _add(moment, outside.moment_B), 0.0, False
    if inputs.near_ground:
        ground_force, ground_moment, load = ground_wrench(params.ground, body)
        push = (force[0], force[1], force[2] - given.thrust)
        resting = (load > 0.0) & is_at_rest(params.ground, body, push, _add(moment, given.torque_B))
        moment, force = _add(moment, ground_moment), _add(force, ground_force)
    if inputs.failed and params.loss.failed != 0.0:
        (L, M, N), lift = lost_wrench(params.loss, body)
        moment, force = (moment[0] - L, moment[1] - M, moment[2] - N), (force[0], force[1], force[2] + lift)
    forces = BodyInputs(outside.torque_command_B, moment, outside.gust_omega_B, force, outside.thrust_command)
    return forces, resting, load


@kernel
def _given(params: FreeParams, body: Body, inputs: FreeInputs) -> Body:
    """Return the state with the torques and the thrust that its rotors give."""
    return given_by_rotors(params.loss, body) if inputs.failed else body


@kernel
def motion_rate(params: FreeParams, body: Body, stream: Stream, inputs: FreeInputs) -> Motion:
    """Return the time derivative of the airframe's state, in a `Motion`."""
    return rigid_body.free_derivative(params.body, body, _sum_inputs(params, body, stream, inputs)[0])


@kernel
def _stage_rate(params: FreeParams, motion: Motion, acting: tuple[FreeInputs, Vector, float]) -> Motion:
    inputs, torque_B, thrust = acting
    body = join(motion, torque_B, thrust)
    return motion_rate(params, body, _meet_air(params, body, inputs), inputs)


_stages = rigid_body.make_stages(_stage_rate, move_motion)


@kernel
def _integrate(params: FreeParams, body: Body, inputs: FreeInputs, dt: float) -> Body:
    T, torque_B, F, thrust = rigid_body.step_actuators(params.body, body, inputs.body, dt)
    acting = ((inputs, T[0], F[0]), (inputs, T[1], F[1]), (inputs, T[2], F[2]), (inputs, T[3], F[3]))
    end = _stages(params, get_motion(body), acting, dt)[1]
    return join(with_unit_length(end), torque_B, thrust)


@kernel
def step(params: FreeParams, body: Body, inputs: FreeInputs, dt: float) -> Body:
    """Return the state after `dt` [s]: a Runge-Kutta step; at rest only the actuators move."""
    near_ground = inputs.near_ground and can_touch_ground(params.ground, body, dt)
    inputs = FreeInputs(inputs.body, inputs.air, near_ground, inputs.failed)
    next_body = _integrate(params, body, inputs, dt)
    return at_rest(body, next_body) if sum_inputs(params, body, inputs)[1] else next_body


@kernel
def sensor_wrench(params: FreeParams, body: Body, inputs: FreeInputs) -> tuple[Vector, Vector, float]:
    """Return specific force [m/s^2] B, the moment of the air [N*m] B, and the load on the ground [N].

    Specific force is acceleration less gravity, the reading of an accelerometer at the centre of mass.
    """
    near_ground = inputs.near_ground and can_touch_ground(params.ground, body, 0.0)
    inputs = FreeInputs(inputs.body, inputs.air, near_ground, inputs.failed)
    stream = _meet_air(params, body, inputs)
    forces, resting, load = _sum_inputs(params, body, stream, inputs)
    moment = air_wrench(params.air, stream, inputs.air)[1]
    if resting:
        up = rotate(conjugate(body.q_NB), (0.0, 0.0, -GRAVITY))
        return up, moment, load
    return rigid_body.specific_force(params.body, body, forces), moment, load
