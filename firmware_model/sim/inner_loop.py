"""Cascade from set-point to actuator command: position, altitude, attitude and rate loops, with saturation."""

import math

from firmware_model.autopilot.attitude_loop import (
    StabilizerParams,
    StabilizerState,
    attitude_rates,
    follow_torque,
    rate_torque,
    reset_integrators,
)
from firmware_model.autopilot.position_loop import (
    PlaceState,
    PositionParams,
    PositionState,
    altitude_hold,
    attitude_for_acceleration,
    clear_heading,
    hold_place,
    initial_position_state,
    latch_heading,
    position_hold,
    slew_heading,
)
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.soa import Lane, get, get_vector, loader, put, put_vector, storer
from firmware_model.physics.rigid_body import Body
from firmware_model.physics.rotors import allocate, can_give
from firmware_model.recording import journal
from firmware_model.sim import layout
from firmware_model.sim.layout import WEIGHT, X_BODY, X_LOAD, X_PLACE, X_POSITION, X_STABILIZER
from firmware_model.types import Quaternion, Vector

# Kinds of set-points: the first number of each.
TRIM, TORQUE, RATES, ATTITUDE, LEVEL, POSITION_TARGET, OFF, WRENCH = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0
SETPOINT_WIDTH = 9
"""Length of a set-point.

The kind comes first. Then follow torque fractions (3), or rates (3) [rad/s], or q_NB (4) and rates (3), or position (3)
[m] N, yaw [rad] and v_down [m/s] or NaN. At `THRUST` stands a fraction of the largest thrust, or NaN for altitude hold.
A wrench is a torque (3) [N*m] and a thrust [N] that rotors give; then comes 1 if the vehicle is clamped, else 0.
"""
CLAMPED, THRUST = 5, 8
_TOUCHDOWN_LOAD = 0.1  # [-] of the weight on the ground, above which it carries the vehicle
_TOUCHDOWN_THRUST = 0.3  # [-] of the weight, given after touchdown

_load_position_params = loader(PositionParams)
_load_stabilizer_params, _load_body = loader(StabilizerParams), loader(Body)
_load_stabilizer_state, _store_stabilizer_state = loader(StabilizerState), storer(StabilizerState)
_load_position_state, _store_position_state = loader(PositionState), storer(PositionState)
_load_place, _store_place = loader(PlaceState), storer(PlaceState)


@kernel
def track_setpoint(params: Lane, state: Lane, free: bool, kind: float, setpoint: Lane, record: Lane) -> None:
    """Step the loops under a set-point of that kind, and write the actuator command to `record`.

    In free flight `limit_command` follows, but for a wrench.
    """
    if kind == WRENCH:
        _put_command(record, get_vector(setpoint, 1), get(setpoint, 4))
        put_vector(record, journal.OMEGA_COMMAND, (math.nan, math.nan, math.nan))
        return
    on_ground = get(state, X_LOAD) > _TOUCHDOWN_LOAD * get(params, WEIGHT)
    touches_down = kind == POSITION_TARGET and not math.isnan(get(setpoint, 5)) and on_ground
    q_NB, thrust = _track_position(params, state, free, kind, setpoint, touches_down)
    torque = _track_attitude(params, state, kind, setpoint, q_NB, on_ground, record)
    _put_command(record, torque, thrust)


@kernel
def seek_place(params: Lane, state: Lane) -> None:
    """Step the loop that holds the place around a controller outside, at a sample; its set-point is in `state`."""
    gains, body = _load_position_params(params, layout.POSITION), _load_body(state, X_BODY)
    _store_place(state, X_PLACE, hold_place(gains, _load_place(state, X_PLACE), body))


@kernel
def get_command(record: Lane) -> tuple[Vector, float]:
    """Return torque [N*m] B and thrust [N] of the actuator command in `record`."""
    return get_vector(record, journal.TORQUE_COMMAND), -get(record, journal.THRUST_COMMAND)


@kernel
def _put_command(record: Lane, torque_B: Vector, thrust: float) -> None:
    put_vector(record, journal.TORQUE_COMMAND, torque_B)
    put(record, journal.THRUST_COMMAND, -thrust)


@kernel
def limit_command(params: Lane, rotors: int, record: Lane) -> None:
    """Clip the command in `record` to what `rotors` rotors can produce; branch-free if that is a constant."""
    torque, thrust = get_command(record)
    torque, thrust = allocate(params, layout.ROTORS, rotors, torque, thrust)
    _put_command(record, torque, thrust)


@kernel
def is_within_limits(params: Lane, rotors: int, record: Lane) -> bool:
    """Return whether `limit_command` would change nothing."""
    torque, thrust = get_command(record)
    return can_give(params, layout.ROTORS, rotors, torque, thrust)


@kernel
def _track_position(
    params: Lane, state: Lane, free: bool, kind: float, setpoint: Lane, touches_down: bool
) -> tuple[Quaternion, float]:
    """Return the attitude to track, if the kind has one, and the commanded thrust [N]: the weight on the stand.

    After touchdown most of the weight stands on the ground, which levels the vehicle. Loops that went on holding
    position and attitude against the ground would wind up and throw it over.
    """
    q_NB = (1.0, 0.0, 0.0, 0.0)
    if kind == ATTITUDE:
        q_NB = (get(setpoint, 1), get(setpoint, 2), get(setpoint, 3), get(setpoint, 4))
    if kind == OFF:
        _store_position_state(state, X_POSITION, initial_position_state())
        return q_NB, 0.0
    if not free:
        return q_NB, get(params, WEIGHT)
    gains, body = _load_position_params(params, layout.POSITION), _load_body(state, X_BODY)
    holding, estimate = _load_position_state(state, X_POSITION), _load_stabilizer_state(state, X_STABILIZER)
    present_q_NB = (estimate.qw, estimate.qx, estimate.qy, estimate.qz)
    if touches_down:
        holding, q_NB, thrust = initial_position_state(), present_q_NB, _TOUCHDOWN_THRUST * get(params, WEIGHT)
    elif kind == POSITION_TARGET:
        holding, acceleration, thrust = position_hold(gains, holding, body, get_vector(setpoint, 1), get(setpoint, 5))
        q_NB = attitude_for_acceleration(acceleration, slew_heading(present_q_NB, get(setpoint, 4)))
    else:
        given = get(params, layout.TOTAL_THRUST) * get(setpoint, THRUST)
        given = math.nan if get(params, layout.HOLDS_PLACE) != 0.0 else given
        holding, thrust = altitude_hold(gains, holding, body, given)
        if kind == LEVEL:
            holding = latch_heading(holding, present_q_NB)
            q_NB = attitude_for_acceleration((0.0, 0.0, 0.0), slew_heading(present_q_NB, holding.yaw))
        else:
            holding = clear_heading(holding)
    _store_position_state(state, X_POSITION, holding)
    return q_NB, thrust


@kernel
def _track_attitude(
    params: Lane, state: Lane, kind: float, setpoint: Lane, target_q_NB: Quaternion, on_ground: bool, record: Lane
) -> Vector:
    """Return the torque [N*m] B that tracks attitude or rates, and write the target rates.

    While the ground carries the vehicle the integrals stay empty: nothing turns, so they would grow to the limit and
    throw it over as it lifts off.
    """
    stabilizer = _load_stabilizer_params(params, layout.STABILIZER)
    estimate = _load_stabilizer_state(state, X_STABILIZER)
    estimate = reset_integrators(estimate) if on_ground else estimate
    rates = (math.nan, math.nan, math.nan)
    torque = (0.0, 0.0, 0.0)
    if kind == TORQUE:
        share = get_vector(setpoint, 1)
        torque = (
            share[0] * stabilizer.limit_roll,
            share[1] * stabilizer.limit_pitch,
            share[2] * stabilizer.limit_yaw,
        )
        estimate = follow_torque(stabilizer, estimate, torque)
    elif kind == RATES:
        rates = get_vector(setpoint, 1)
        estimate, torque = rate_torque(stabilizer, estimate, rates)
    elif kind == OFF:
        estimate = reset_integrators(estimate)
    elif kind != TRIM:
        feedback_rates = attitude_rates(stabilizer, estimate, target_q_NB)
        ahead = get_vector(setpoint, 5) if kind == ATTITUDE else (0.0, 0.0, 0.0)
        rates = (feedback_rates[0] + ahead[0], feedback_rates[1] + ahead[1], feedback_rates[2] + ahead[2])
        estimate, torque = rate_torque(stabilizer, estimate, rates)
    _store_stabilizer_state(state, X_STABILIZER, estimate)
    put_vector(record, journal.OMEGA_COMMAND, rates)
    return torque
