"""Free flight: the rigid body in moving air, with drag, and on the ground.

Force and moment of the air have one cause, the air's velocity relative to the vehicle. Each rotor drags along with the
air through its plane, at a height above the centre of mass (see `gust_moment`), and so does the body. So the steps of a
sample follow the air past the vehicle, in B, and no vector has to be rotated for a force. Position and velocity in N
are found at the end of the sample; near the ground, at each stage of each step.
"""

import math
from typing import NamedTuple

from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.rotations import Matrix, rotation_matrix, to_B, to_N
from firmware_model.physics import rigid_body
from firmware_model.physics.dryden import gust_moment
from firmware_model.physics.ground import GroundParams, can_touch_ground, ground_wrench, is_at_rest
from firmware_model.physics.rigid_body import (
    Body,
    BodyParams,
    Motion,
    Wrench,
    add,
    add_moment,
    add_motions,
    at_rest,
    change_motion,
    get_wrench,
    make_stages,
    scale,
    scale_motion,
    with_unit_length,
)
from firmware_model.physics.rotors import LossParams, given_by_rotors
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


class Derivatives(NamedTuple):
    """Acceleration by the rotors per velocity of the air relative to the vehicle, at one speed of the rotors."""

    X_u: float
    """[1/s] in the rotors' plane, along x and y alike."""
    Z_w: float
    """[1/s] along their axis."""
    L_v: float
    """[rad/(s*m)] roll by air along y."""
    M_u: float
    """[rad/(s*m)] pitch by air along x."""


class ExternalLoads(NamedTuple):
    """Drag and moments from outside, divided by mass and inertia; constant over a sample."""

    hover: Derivatives
    """In hover, units beside each number."""
    body_drag: float
    """[1/m] acceleration by the body per velocity of the air squared."""
    gust_yaw: float
    """[rad/s^2] by the vertical gust in hover."""
    turn_B: Vector
    """[rad/s^2] B, by moments from outside and angular gusts."""


class StageLoads(NamedTuple):
    """Accelerations at one time of a step that do not depend on the motion then, so that two stages may share them."""

    lift: float
    """[m/s^2] by the thrust."""
    rotors: Derivatives
    """At their speed, units beside each number."""
    turn_B: Vector
    """[rad/s^2] B, by all moments but those of the relative air."""


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

    command: Wrench
    """Within the actuators' limits, units beside each number."""
    outside: ExternalLoads
    """Drag, moments and angular gusts, units beside each number."""
    air: Air
    """Gust and wind, units beside each number."""
    near_ground: bool
    """True if the ground may be near; otherwise contact is skipped."""
    failed: bool = False
    """True if a rotor may have failed; otherwise all are sound."""


class _NearGround(NamedTuple):
    """State that the stages of a step near the ground integrate."""

    position_N: Vector  # [m] N
    motion: Motion


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
def surround(body: BodyParams, air: AirParams, gust_z: float, turn_B: Vector) -> ExternalLoads:
    """Return drag and moments in a vertical gust [m/s], with an angular acceleration [rad/s^2] B from outside."""
    L, M, N = gust_moment(air.gust_gain, air.gust_yaw_ratio, (1.0, 1.0, gust_z))
    hover = Derivatives(
        air.rotor_drag * body.inverse_mass,
        air.heave_drag * body.inverse_mass,
        L * body.inverse_I_x,
        M * body.inverse_I_y,
    )
    return ExternalLoads(hover, air.body_drag * body.inverse_mass, N * body.inverse_I_z, turn_B)


@kernel
def _rotor_speed(params: AirParams, thrust: float) -> float:
    """Return the speed of rotors that give a thrust [N], 1 in hover."""
    return math.sqrt(max(thrust, 0.0) * params.inverse_weight)


@kernel
def _stage_loads(params: FreeParams, produced: Wrench, inputs: FreeInputs) -> StageLoads:
    """Return the accelerations while sound rotors would give that much."""
    produced = given_by_rotors(params.loss, produced) if inputs.failed else produced
    speed, hover = _rotor_speed(params.air, produced.thrust), inputs.outside.hover
    p, q, r = inputs.outside.turn_B
    return StageLoads(
        params.body.inverse_mass * produced.thrust,
        Derivatives(speed * hover.X_u, speed * hover.Z_w, speed * hover.L_v, speed * hover.M_u),
        add_moment(params.body, (p, q, r + speed * inputs.outside.gust_yaw), produced.torque_B),
    )


@kernel
def _relative_airspeed(motion: Motion, air: Air) -> Vector:
    """Return the velocity [m/s] B of the air relative to the vehicle."""
    return add(motion.flow_B, air.gust_B)


@kernel
def _specific_force(loads: StageLoads, outside: ExternalLoads, v_B: Vector) -> Vector:
    """Return the acceleration [m/s^2] B by thrust and relative air [m/s] B.

    Rotor drag is proportional to the air's velocity and to rotor speed. Body drag is quadratic, the same in all
    directions.
    """
    u, v, w = v_B
    body = outside.body_drag * math.sqrt(u * u + v * v + w * w)
    plane, axis = loads.rotors.X_u + body, loads.rotors.Z_w + body
    return plane * u, plane * v, axis * w - loads.lift


@kernel
def _angular_acceleration(loads: StageLoads, v_B: Vector) -> Vector:
    """Return the angular acceleration [rad/s^2] B by all moments, in relative air [m/s] B.

    Only gusts yaw the vehicle: a uniform stream acts on all rotors equally.
    """
    p, q, r = loads.turn_B
    return p + loads.rotors.L_v * v_B[1], q + loads.rotors.M_u * v_B[0], r


@kernel
def motion_rate(params: FreeParams, motion: Motion, given: tuple[FreeInputs, StageLoads]) -> Motion:
    """Return the time derivative of a motion away from the ground, see `rigid_body.motion_rate`."""
    inputs, loads = given
    v_B = _relative_airspeed(motion, inputs.air)
    return rigid_body.motion_rate(
        params.body, motion, _specific_force(loads, inputs.outside, v_B), _angular_acceleration(loads, v_B)
    )


@kernel
def _near_rate(params: FreeParams, x: _NearGround, given: tuple[FreeInputs, StageLoads]) -> _NearGround:
    (inputs, loads), motion = given, x.motion
    v_B, velocity_N = (
        _relative_airspeed(motion, inputs.air),
        _velocity(rotation_matrix(motion.q_NB), motion, inputs.air),
    )
    pose = Body(x.position_N, velocity_N, motion.q_NB, motion.omega_B, (0.0, 0.0, 0.0), 0.0)
    force, moment, _ = ground_wrench(params.ground, pose)
    push = add(_specific_force(loads, inputs.outside, v_B), scale(params.body.inverse_mass, force))
    turn = add_moment(params.body, _angular_acceleration(loads, v_B), moment)
    return _NearGround(velocity_N, rigid_body.motion_rate(params.body, motion, push, turn))


@kernel
def _change_near(h: float, rate: _NearGround) -> _NearGround:
    return _NearGround(scale(h, rate.position_N), change_motion(h, rate.motion))


@kernel
def _add_near(a: _NearGround, b: _NearGround) -> _NearGround:
    return _NearGround(add(a.position_N, b.position_N), add_motions(a.motion, b.motion))


@kernel
def _scale_near(h: float, a: _NearGround) -> _NearGround:
    return _NearGround(scale(h, a.position_N), scale_motion(h, a.motion))


_stages = make_stages(motion_rate, change_motion, add_motions, scale_motion)
_near_stages = make_stages(_near_rate, _change_near, _add_near, _scale_near)


@kernel
def _get_motion(R_NB: Matrix, body: Body, air: Air) -> Motion:
    """Return the motion of a state past the air; `R_NB` is its attitude as a matrix."""
    (north, east, down), (v_north, v_east, v_down) = air.wind_N, body.velocity_N
    return Motion(to_B(R_NB, (north - v_north, east - v_east, down - v_down)), body.q_NB, body.omega_B)


@kernel
def _velocity(R_NB: Matrix, motion: Motion, air: Air) -> Vector:
    """Return the velocity [m/s] N of a motion."""
    (north, east, down), flow = air.wind_N, to_N(R_NB, motion.flow_B)
    return north - flow[0], east - flow[1], down - flow[2]


@kernel
def _half_path(
    R_NB: Matrix, motion: Motion, velocity_N: Vector, given: tuple[FreeInputs, StageLoads], h: float
) -> Vector:
    """Return the part [m] N of a path of `h` [s] that its start decides; for `-h`, minus the part that its end decides.

    The velocity along the path is the cubic through velocity and acceleration at both ends (Hermite). Its error falls
    with `h` to the fourth power. Gravity is the same at both, and cancels.
    """
    inputs, loads = given
    push = to_N(R_NB, _specific_force(loads, inputs.outside, _relative_airspeed(motion, inputs.air)))
    return add(scale(0.5 * h, velocity_N), scale(h * h / 12.0, push))


@kernel
def begin_sample(params: FreeParams, body: Body, inputs: FreeInputs, h: float) -> tuple[Motion, StageLoads, Vector]:
    """Return motion, accelerations and position [m] N at the start of a sample of `h` [s].

    The position holds a part of the sample's path already; `end_sample` adds the other.
    """
    R_NB, loads = rotation_matrix(body.q_NB), _stage_loads(params, get_wrench(body), inputs)
    motion = _get_motion(R_NB, body, inputs.air)
    path = _half_path(R_NB, motion, body.velocity_N, (inputs, loads), h)
    return motion, loads, add(body.position_N, path)


@kernel
def end_sample(
    position_N: Vector, motion: Motion, loads: StageLoads, inputs: FreeInputs, h: float
) -> tuple[Vector, Vector]:
    """Return position [m] and velocity [m/s] N at the end of a sample of `h` [s], from `begin_sample`'s position."""
    R_NB = rotation_matrix(motion.q_NB)
    velocity_N = _velocity(R_NB, motion, inputs.air)
    back = _half_path(R_NB, motion, velocity_N, (inputs, loads), -h)
    return (position_N[0] - back[0], position_N[1] - back[1], position_N[2] - back[2]), velocity_N


@kernel
def step_actuators(params: FreeParams, produced: Wrench, inputs: FreeInputs) -> tuple[StageLoads, Wrench, StageLoads]:
    """Return accelerations in the middle of a step, what sound rotors give at its end, and accelerations then."""
    middle, last = rigid_body.step_actuators(params.body, produced, inputs.command)
    return _stage_loads(params, middle, inputs), last, _stage_loads(params, last, inputs)


@kernel
def fly(params: FreeParams, body: Body, inputs: FreeInputs, dt: float, steps: int) -> Body:
    """Return the state after a sample of `steps` Runge-Kutta steps of `dt` [s]."""
    h = steps * dt
    if inputs.near_ground and can_touch_ground(params.ground, body, h):
        for _ in range(steps):
            body = step_near_ground(params, body, inputs, dt)
        return body
    motion, loads, position_N = begin_sample(params, body, inputs, h)
    produced = get_wrench(body)
    for _ in range(steps):
        middle, produced, last = step_actuators(params, produced, inputs)
        stages = ((inputs, loads), (inputs, middle), (inputs, middle), (inputs, last))
        motion, loads = _stages(params, motion, stages, dt)[1], last
    motion = with_unit_length(motion)
    position_N, velocity_N = end_sample(position_N, motion, loads, inputs, h)
    return Body(position_N, velocity_N, motion.q_NB, motion.omega_B, produced.torque_B, produced.thrust)


@kernel
def step_near_ground(params: FreeParams, body: Body, inputs: FreeInputs, dt: float) -> Body:
    """Return the state after a step of `dt` [s] with the ground near; at rest only the actuators move."""
    motion, first = (
        _get_motion(rotation_matrix(body.q_NB), body, inputs.air),
        _stage_loads(params, get_wrench(body), inputs),
    )
    rests = _rests(params, body, first, inputs.outside, _relative_airspeed(motion, inputs.air))
    middle, produced, last = step_actuators(params, get_wrench(body), inputs)
    stages = ((inputs, first), (inputs, middle), (inputs, middle), (inputs, last))
    position_N, end = _near_stages(params, _NearGround(body.position_N, motion), stages, dt)[1]
    end = with_unit_length(end)
    velocity_N = _velocity(rotation_matrix(end.q_NB), end, inputs.air)
    after = Body(position_N, velocity_N, end.q_NB, end.omega_B, produced.torque_B, produced.thrust)
    return at_rest(body, after) if rests else after


@kernel
def _rests(params: FreeParams, body: Body, loads: StageLoads, outside: ExternalLoads, v_B: Vector) -> bool:
    """Return whether a vehicle stays at rest on the ground, whose force then balances all others.

    `v_B` [m/s] B is the velocity of the air relative to the vehicle.
    """
    (p, q, r), constants = _angular_acceleration(loads, v_B), params.body
    force = scale(1.0 / constants.inverse_mass, _specific_force(loads, outside, v_B))
    moment = (p / constants.inverse_I_x, q / constants.inverse_I_y, r / constants.inverse_I_z)
    return (ground_wrench(params.ground, body)[2] > 0.0) & is_at_rest(params.ground, body, force, moment)


@kernel
def sensor_wrench(params: FreeParams, body: Body, inputs: FreeInputs) -> tuple[Vector, Vector, float]:
    """Return specific force [m/s^2] B, the moment of the air [N*m] B, and the load on the ground [N].

    Specific force is acceleration less gravity, the reading of an accelerometer at the centre of mass. At rest the
    ground carries the weight; the springs' force is then not the real one.
    """
    produced, load = get_wrench(body), 0.0
    loads = _stage_loads(params, produced, inputs)
    v_B = _relative_airspeed(_get_motion(rotation_matrix(body.q_NB), body, inputs.air), inputs.air)
    force = _specific_force(loads, inputs.outside, v_B)
    if inputs.near_ground and can_touch_ground(params.ground, body, 0.0):
        ground, _, load = ground_wrench(params.ground, body)
        force = add(force, scale(params.body.inverse_mass, ground))
        rests = _rests(params, body, loads, inputs.outside, v_B)
        force = rigid_body.held_force(body.q_NB) if rests else force
    produced = given_by_rotors(params.loss, produced) if inputs.failed else produced
    gain = _rotor_speed(params.air, produced.thrust) * params.air.gust_gain
    return force, gust_moment(gain, params.air.gust_yaw_ratio, (v_B[0], v_B[1], inputs.air.gust_B[2])), load
