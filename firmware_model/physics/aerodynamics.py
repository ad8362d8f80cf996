"""Free flight: the rigid body in moving air, with drag, and on the ground.

The force of the air and its moment have one cause, the air's velocity relative to the vehicle: each rotor drags along
with the air through its plane, at a height above the centre of mass (see `gust_moment`), and so does the body.
"""

import math
from typing import NamedTuple

from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.rotations import conjugate, rotate
from firmware_model.physics.dryden import gust_moment
from firmware_model.physics.ground import GroundParams, can_touch_ground, ground_params, ground_wrench, is_at_rest
from firmware_model.physics.rigid_body import (
    Body,
    BodyInputs,
    BodyParams,
    at_rest,
    body_params,
    derivative,
    runge_kutta,
    specific_force,
)
from firmware_model.types import Vector

AIR_DENSITY = 1.225
"""[kg/m^3] ICAO standard atmosphere at sea level."""


class AirParams(NamedTuple):
    """What the air does to a vehicle."""

    inverse_weight: float  # [1/N]
    rotor_drag: float  # [N/(m/s)] all rotors in hover, in their plane
    heave_drag: float  # [N/(m/s)] all rotors in hover, along their axis
    body_drag: float  # [N/(m/s)^2]
    gust_gain: float  # [N*m/(m/s)]
    gust_yaw_ratio: float  # [-]


class Air(NamedTuple):
    """How the air moves, constant over a sample."""

    u: float  # [m/s] B, gust, blowing toward
    v: float
    w: float
    north: float  # [m/s] N, mean wind, blowing toward
    east: float
    down: float


class FreeParams(NamedTuple):
    """A vehicle in free flight."""

    body: BodyParams
    """Airframe, its units beside each number."""
    air: AirParams
    """Drag, its units beside each number."""
    ground: GroundParams
    """Feet, their units beside each number."""


class FreeInputs(NamedTuple):
    """What acts from outside, constant over a sample."""

    body: BodyInputs
    """Commands, direct moments, angular gusts, units beside each number; no forces."""
    air: Air
    """Gust and wind, units beside each number."""
    low: bool
    """Whether the ground may be near; if not, it is not asked about."""


def air_params(vehicle: Vehicle) -> AirParams:
    """Return what the air does to a vehicle."""
    return AirParams(
        1.0 / (vehicle.mass * GRAVITY), vehicle.rotor_drag, vehicle.heave_drag, 0.5 * AIR_DENSITY * vehicle.drag_area,
        vehicle.gust_gain, vehicle.gust_yaw_ratio,
    )  # fmt: skip


def free_params(vehicle: Vehicle) -> FreeParams:
    """Return the constants of a vehicle in free flight."""
    return FreeParams(body_params(vehicle, free=True), air_params(vehicle), ground_params(vehicle))


@kernel
def air_wrench(params: AirParams, body: Body, air: Air) -> tuple[Vector, Vector]:
    """Return force [N] B and moment [N*m] B of the air.

    Rotors: in proportion to the relative air and to the rotors' speed, which goes with the root of the thrust and is 1
    in hover. Body: in proportion to the square, in all directions alike. Yaw comes of gusts alone: what passes all
    rotors alike turns none of them more than another.
    """
    past = (air.north - body.v_north, air.east - body.v_east, air.down - body.v_down)
    mean = rotate(conjugate((body.qw, body.qx, body.qy, body.qz)), past)
    v_B = (air.u + mean[0], air.v + mean[1], air.w + mean[2])
    spin = math.sqrt(max(body.thrust, 0.0) * params.inverse_weight)
    square = params.body_drag * math.sqrt(v_B[0] * v_B[0] + v_B[1] * v_B[1] + v_B[2] * v_B[2])
    plane, axis = spin * params.rotor_drag + square, spin * params.heave_drag + square
    moment = gust_moment(spin * params.gust_gain, params.gust_yaw_ratio, (v_B[0], v_B[1], air.w))
    return (plane * v_B[0], plane * v_B[1], axis * v_B[2]), moment


@kernel
def sum_inputs(params: FreeParams, body: Body, inputs: FreeInputs) -> tuple[BodyInputs, bool, float]:
    """Return the inputs with all forces and moments but gravity, whether the vehicle rests, and the ground's load [N].

    At rest the ground's force is not of the springs but what it must be; it is then not among the forces.
    """
    outside = inputs.body
    force, moment = air_wrench(params.air, body, inputs.air)
    L, M, N = moment[0] + outside.L, moment[1] + outside.M, moment[2] + outside.N
    ground_force, ground_moment, load, resting = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, False
    if inputs.low:
        ground_force, ground_moment, load = ground_wrench(params.ground, body)
        push, twist = (force[0], force[1], force[2] - body.thrust), (L + body.roll, M + body.pitch, N + body.yaw)
        resting = (load > 0.0) & is_at_rest(params.ground, body, push, twist)
    return (
        BodyInputs(
            outside.roll_command, outside.pitch_command, outside.yaw_command,
            L + ground_moment[0], M + ground_moment[1], N + ground_moment[2],
            outside.p_gust, outside.q_gust, outside.r_gust,
            force[0] + ground_force[0], force[1] + ground_force[1], force[2] + ground_force[2],
            outside.thrust_command,
        ),
        resting,
        load,
    )  # fmt: skip


@kernel
def _derivative(params: FreeParams, body: Body, inputs: FreeInputs) -> Body:
    return derivative(params.body, body, sum_inputs(params, body, inputs)[0])


_integrate = runge_kutta(_derivative)


@kernel
def step(params: FreeParams, body: Body, inputs: FreeInputs, dt: float) -> Body:
    """Return the state after `dt` [s]: a Runge-Kutta step, or the actuators' alone where the vehicle rests."""
    inputs = FreeInputs(inputs.body, inputs.air, inputs.low and can_touch_ground(params.ground, body, dt))
    moved = _integrate(params, body, inputs, dt)
    return at_rest(body, moved) if sum_inputs(params, body, inputs)[1] else moved


@kernel
def sensor_wrench(params: FreeParams, body: Body, inputs: FreeInputs) -> tuple[Vector, Vector, float]:
    """Return specific force [m/s^2] B, the moment of the air [N*m] B, and the load that the ground carries [N].

    The specific force is acceleration less gravity, what an accelerometer at the centre of mass feels.
    """
    inputs = FreeInputs(inputs.body, inputs.air, inputs.low and can_touch_ground(params.ground, body, 0.0))
    forces, resting, load = sum_inputs(params, body, inputs)
    moment = air_wrench(params.air, body, inputs.air)[1]
    if resting:
        up = rotate(conjugate((body.qw, body.qx, body.qy, body.qz)), (0.0, 0.0, -GRAVITY))
        return up, moment, load
    return specific_force(params.body, body, forces), moment, load
