"""On-board altitude and position loops: P to velocity, PI to acceleration, acceleration to attitude and thrust.

Navigation is ideal: position and velocity are the true ones.

A controller outside may take the place of the attitude loop. Then `hold_place` gives the roll and pitch that it has to
track, as PX4's position control does to its attitude control. The height stays with the loop on board.
"""

import math
from typing import NamedTuple

from firmware_model.config.vehicle import GRAVITY, PositionLoop, Vehicle
from firmware_model.exact import tangent
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.elementary import arctan2, sin_cos
from firmware_model.numerics.rotations import from_euler, rotate, to_euler
from firmware_model.physics.rigid_body import Body
from firmware_model.physics.sensors import float32
from firmware_model.types import Quaternion, Vector

_THRUST_MIN, _THRUST_MAX = 0.1, 0.9  # [-] of the weight, of the largest thrust; the margins are for torques
_MIN_TILT_COSINE = 0.5  # [-] cosine of the tilt above which thrust compensates no further
_MAX_HEADING_STEP = 0.2  # [rad] largest difference between heading command and present heading
_UPRIGHT = 1e-9  # [-] least level part of the forward axis that has a heading


class PositionState(NamedTuple):
    """State of the altitude and position loops."""

    i_north: float  # [m/s^2] integrated velocity errors
    i_east: float
    i_down: float
    down: float  # [m] N, latched height of altitude hold; NaN: none
    yaw: float  # [rad] latched heading; NaN: none


class PlaceState(NamedTuple):
    """State of the loop that holds the place around a controller outside, and what it asks for."""

    i_north: float  # [m/s^2] integrated velocity errors
    i_east: float
    roll: float  # [deg] attitude set-point at the sample, float32 as on the wire
    pitch: float


class PositionParams(NamedTuple):
    """Gains, limits, sample time."""

    xy_p: float  # [1/s]
    xy_velocity_p: float  # [1/s]
    xy_velocity_i: float  # [1/s^2]
    xy_velocity_max: float  # [m/s]
    z_p: float  # [1/s]
    z_velocity_p: float  # [1/s]
    z_velocity_i: float  # [1/s^2]
    z_velocity_max_up: float  # [m/s]
    z_velocity_max_down: float  # [m/s]
    slope_max: float  # [-] tangent of the largest tilt
    mass: float  # [kg]
    thrust_min: float  # [N]
    thrust_max: float  # [N]
    dt: float  # [s]


def position_params(vehicle: Vehicle, gains: PositionLoop, dt: float) -> PositionParams:
    """Return gains for a vehicle and the sample time `dt` [s]."""
    return PositionParams(
        xy_p=gains.xy_p,
        xy_velocity_p=gains.xy_velocity_p,
        xy_velocity_i=gains.xy_velocity_i,
        xy_velocity_max=gains.xy_velocity_max,
        z_p=gains.z_p,
        z_velocity_p=gains.z_velocity_p,
        z_velocity_i=gains.z_velocity_i,
        z_velocity_max_up=gains.z_velocity_max_up,
        z_velocity_max_down=gains.z_velocity_max_down,
        slope_max=tangent(gains.tilt_max),
        mass=vehicle.mass,
        thrust_min=_THRUST_MIN * vehicle.mass * GRAVITY,
        thrust_max=_THRUST_MAX * vehicle.rotors.total_thrust,
        dt=dt,
    )


@kernel
def initial_position_state() -> PositionState:
    """Return the state with no height and no heading latched, and empty integrals."""
    return PositionState(0.0, 0.0, 0.0, math.nan, math.nan)


@kernel
def climb_thrust(params: PositionParams, x: PositionState, body: Body, v_down: float) -> tuple[PositionState, float]:
    """Return the next state and the thrust [N] for a vertical velocity [m/s] down, compensated for tilt."""
    wanted = min(max(v_down, -params.z_velocity_max_up), params.z_velocity_max_down)
    error = wanted - body.velocity_N[2]
    up = -rotate(body.q_NB, (0.0, 0.0, -1.0))[2]
    thrust = params.mass * (GRAVITY - params.z_velocity_p * error - x.i_down) / max(up, _MIN_TILT_COSINE)
    within = min(max(thrust, params.thrust_min), params.thrust_max)
    # Anti-windup: at a limit the integral may only move back.
    holds = (thrust > within and error < 0.0) or (thrust < within and error > 0.0)
    i_down = x.i_down if holds else x.i_down + params.dt * params.z_velocity_i * error
    return PositionState(x.i_north, x.i_east, i_down, x.down, x.yaw), within


@kernel
def _horizontal_acceleration(
    params: PositionParams, x: PositionState, body: Body, north: float, east: float
) -> tuple[PositionState, Vector]:
    """Return the next state and the horizontal acceleration [m/s^2] N toward a position [m] N."""
    v_north, v_east = params.xy_p * (north - body.position_N[0]), params.xy_p * (east - body.position_N[1])
    slow = params.xy_velocity_max / max(math.sqrt(v_north * v_north + v_east * v_east), params.xy_velocity_max)
    e_north, e_east = slow * v_north - body.velocity_N[0], slow * v_east - body.velocity_N[1]
    a_north = params.xy_velocity_p * e_north + x.i_north
    a_east = params.xy_velocity_p * e_east + x.i_east
    size, most = math.sqrt(a_north * a_north + a_east * a_east), GRAVITY * params.slope_max
    i_north, i_east = x.i_north, x.i_east
    if size <= most:
        i_north += params.dt * params.xy_velocity_i * e_north
        i_east += params.dt * params.xy_velocity_i * e_east
    fit = most / max(size, most)
    return PositionState(i_north, i_east, x.i_down, x.down, x.yaw), (fit * a_north, fit * a_east, 0.0)


@kernel
def attitude_for_acceleration(acceleration_N: Vector, yaw: float) -> Quaternion:
    """Return the attitude for a horizontal acceleration [m/s^2] N at a heading [rad], if thrust carries the weight."""
    sine, cosine = sin_cos(yaw)
    phi, theta = _tilt_for_acceleration(acceleration_N, sine, cosine)
    return from_euler(phi, theta, yaw)


@kernel
def _tilt_for_acceleration(acceleration_N: Vector, sine: float, cosine: float) -> tuple[float, float]:
    """Return roll and pitch [rad] for a horizontal acceleration [m/s^2] N at the heading of a sine and cosine [-]."""
    ahead = acceleration_N[0] * cosine + acceleration_N[1] * sine
    right = acceleration_N[1] * cosine - acceleration_N[0] * sine
    theta = arctan2(-ahead, GRAVITY)
    return arctan2(right, math.sqrt(GRAVITY * GRAVITY + ahead * ahead)), theta


@kernel
def hold_place(params: PositionParams, x: PlaceState, body: Body) -> PlaceState:
    """Return the next state, with roll and pitch [deg] that lead back to north 0 and east 0 at the present heading."""
    loop = PositionState(x.i_north, x.i_east, 0.0, math.nan, math.nan)
    loop, acceleration_N = _horizontal_acceleration(params, loop, body, 0.0, 0.0)
    q_w, q_x, q_y, q_z = body.q_NB
    ahead, aside = 1.0 - 2.0 * (q_y * q_y + q_z * q_z), 2.0 * (q_x * q_y + q_w * q_z)
    level = max(math.sqrt(ahead * ahead + aside * aside), _UPRIGHT)
    phi, theta = _tilt_for_acceleration(acceleration_N, aside / level, ahead / level)
    degrees = 180.0 / math.pi
    return PlaceState(loop.i_north, loop.i_east, float32(degrees * phi), float32(degrees * theta))


@kernel
def position_hold(
    params: PositionParams, x: PositionState, body: Body, position_N: Vector, v_down: float
) -> tuple[PositionState, Vector, float]:
    """Return the next state, the acceleration [m/s^2] N and the thrust [N] toward a position [m] N.

    A `v_down` [m/s] other than NaN is the vertical velocity, and the height of the position is unused.
    """
    x = PositionState(x.i_north, x.i_east, x.i_down, math.nan, math.nan)
    x, acceleration_N = _horizontal_acceleration(params, x, body, position_N[0], position_N[1])
    sink = params.z_p * (position_N[2] - body.position_N[2]) if math.isnan(v_down) else v_down
    x, thrust = climb_thrust(params, x, body, sink)
    return x, acceleration_N, thrust


@kernel
def altitude_hold(params: PositionParams, x: PositionState, body: Body, thrust: float) -> tuple[PositionState, float]:
    """Return the next state and the thrust [N]: the commanded one or, if that is NaN, what holds the height.

    The height is that of the first call with NaN.
    """
    if not math.isnan(thrust):
        return PositionState(0.0, 0.0, 0.0, math.nan, x.yaw), thrust
    fresh = math.isnan(x.down)
    x = PositionState(0.0, 0.0, 0.0 if fresh else x.i_down, body.position_N[2] if fresh else x.down, x.yaw)
    return climb_thrust(params, x, body, params.z_p * (x.down - body.position_N[2]))


@kernel
def slew_heading(q_NB: Quaternion, yaw: float) -> float:
    """Return the next heading command [rad] from the heading of `q_NB` toward `yaw`, by the shorter way.

    It stays near the present heading, because a large step in heading would also swing the tilt about.
    """
    present = to_euler(q_NB)[2]
    sine, cosine = sin_cos(yaw - present)
    return present + min(max(arctan2(sine, cosine), -_MAX_HEADING_STEP), _MAX_HEADING_STEP)


@kernel
def latch_heading(x: PositionState, q_NB: Quaternion) -> PositionState:
    """Return the state with the heading of `q_NB` latched, unless one is latched already."""
    yaw = to_euler(q_NB)[2] if math.isnan(x.yaw) else x.yaw
    return PositionState(x.i_north, x.i_east, x.i_down, x.down, yaw)


@kernel
def clear_heading(x: PositionState) -> PositionState:
    """Return the state with no heading latched."""
    return PositionState(x.i_north, x.i_east, x.i_down, x.down, math.nan)
