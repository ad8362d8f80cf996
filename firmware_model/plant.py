"""One sample of the world: the air and the sensors at the sample rate, the rigid body at the physics rate.

The gust is sampled with the gyro and held from sample to sample, so that one journal record holds all that acted.
"""

import math
from typing import Any

from firmware_model import free_flight, rigid_body, world
from firmware_model.actuators import ActuatorParams, given
from firmware_model.compiled import compiled, kernel
from firmware_model.disturbances import Disturbance, disturbance
from firmware_model.elementary import normals
from firmware_model.free_flight import Air, AirParams, FreeInputs, FreeParams
from firmware_model.ground import GroundParams
from firmware_model.gusts import DrydenParams, DrydenState, dryden_gust, dryden_step, gust_moment
from firmware_model.journal import RECORD
from firmware_model.mean_wind import MeanWindParams, mean_wind
from firmware_model.position import (
    Holding,
    PositionParams,
    forget_heading,
    guide,
    keep_heading,
    lean,
    lift,
    nothing_held,
    toward,
)
from firmware_model.rigid_body import Body, BodyInputs, BodyParams, still
from firmware_model.rotations import conjugate, rotate
from firmware_model.rotors import RotorParams, allocate, rotor_thrusts
from firmware_model.rows import loader, storer
from firmware_model.sensors import AccelerometerParams, GyroParams, accelerometer, gyro
from firmware_model.signals import Quaternion, Vector
from firmware_model.stabilizer import (
    Estimate,
    StabilizerParams,
    aligned,
    attitude_rates,
    rate_torque,
    rest,
    set_attitude,
    strapdown,
)
from firmware_model.world import (
    ACCELEROMETER_STREAM,
    FREE,
    GUST_SCALE,
    GUST_STREAM,
    GYRO_STREAM,
    STEPS,
    WEIGHT,
    X_BODY,
    X_CHANGE,
    X_DIRECT,
    X_DRYDEN,
    X_ESTIMATE,
    X_HOLDING,
    X_LOAD,
    Array,
)

# What a set-point asks for: its first number; the others follow.
TRIM, TORQUE, RATES, ATTITUDE, LEVEL, GUIDANCE, OFF = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0
SETPOINT = 9
"""Length of a set-point: kind; then torque fractions (3), or rates (3) [rad/s], or q_NB (4) and rates (3), or position
(3) [m] N, yaw [rad] and v_down [m/s] or NaN; and at `THRUST`, a fraction of the largest, NaN to hold the height."""
THRUST = 8
_TOUCH = 0.1  # [-] of the weight on the ground, from which on a descent has touched it
_TOUCHING_THRUST = 0.3  # [-] of the weight

_load_body_params, _load_dryden_params = loader(BodyParams), loader(DrydenParams)
_load_gyro_params, _load_stabilizer_params = loader(GyroParams), loader(StabilizerParams)
_load_position_params, _load_rotor_params = loader(PositionParams), loader(RotorParams)
_load_air_params, _load_ground_params = loader(AirParams), loader(GroundParams)
_load_mean_wind_params, _load_actuator_params = loader(MeanWindParams), loader(ActuatorParams)
_load_accelerometer_params = loader(AccelerometerParams)
_load_body, _load_dryden = loader(Body), loader(DrydenState)
_load_estimate, _load_holding = loader(Estimate), loader(Holding)
_store_body, _store_dryden = storer(Body), storer(DrydenState)
_store_estimate, _store_holding = storer(Estimate), storer(Holding)

# Where a field of the journal's record starts, counted in numbers.
_AT = {name: RECORD.fields[name][1] // 8 for name in RECORD.names or ()}  # type: ignore[index]
_TIME, _GYRO_B, _FORCE_B = _AT["time_us"], _AT["gyro_B"], _AT["specific_force_B"]
_TORQUE_COMMAND, _OMEGA_COMMAND, _TORQUE = _AT["torque_command_B"], _AT["omega_command_B"], _AT["torque_B"]
_POSITION, _VELOCITY, _Q_NB, _OMEGA = _AT["position_N"], _AT["velocity_N"], _AT["q_NB"], _AT["omega_B"]
_GUST, _GUST_OMEGA, _MOMENT, _WIND = _AT["gust_B"], _AT["gust_omega_B"], _AT["moment_B"], _AT["wind_N"]
_THRUST_COMMAND, _THRUST, _ROTORS = _AT["thrust_z_command"], _AT["thrust_z"], _AT["rotors"]


@kernel
def _q_NB(body: Body) -> Quaternion:
    return body.qw, body.qx, body.qy, body.qz


@kernel
def _free_params(params: Array) -> FreeParams:
    return FreeParams(
        _load_body_params(params, world.BODY),
        _load_air_params(params, world.AIR),
        _load_ground_params(params, world.GROUND),
    )


@kernel
def _write(record: Array, at: int, value: Vector) -> None:
    record[at], record[at + 1], record[at + 2] = value[0], value[1], value[2]


@kernel
def observe_kernel(params: Array, state: Array, waves: Array, replay: Array, changes: Array, seed: int, sample: int,
                   sample_us: int, record: Array) -> None:  # fmt: skip
    """Write to `record` the truth at a sample, what acts from it on, and what the sensors measure."""
    _change(params, state, changes, sample)
    body = _load_body(state, X_BODY)
    time_us = sample * sample_us
    time = time_us * 1e-6
    record[_TIME] = time_us
    direct = _write_air(params, state, disturbance(waves, replay, sample, time), record)
    force, moment, state[X_LOAD] = _felt(params, body, direct, record)
    _write(state, X_DIRECT, direct)
    noise = normals(seed, GYRO_STREAM, sample, 0)
    rate = gyro(_load_gyro_params(params, world.GYRO), (body.p, body.q, body.r), noise, time)
    _write(record, _GYRO_B, rate)
    noise = normals(seed, ACCELEROMETER_STREAM, sample, 0)
    _write(record, _FORCE_B, accelerometer(_load_accelerometer_params(params, world.ACCELEROMETER), force, noise))
    _write(record, _MOMENT, (moment[0] + direct[0], moment[1] + direct[1], moment[2] + direct[2]))
    _write(record, _POSITION, (body.north, body.east, body.down))
    _write(record, _VELOCITY, (body.v_north, body.v_east, body.v_down))
    _write(record, _OMEGA, (body.p, body.q, body.r))
    for i in range(4):
        record[_Q_NB + i] = _q_NB(body)[i]
    _write_rotors(params, body, record)
    stabilizer = _load_stabilizer_params(params, world.STABILIZER)
    estimate = strapdown(stabilizer, _load_estimate(state, X_ESTIMATE), rate)
    if params[FREE] != 0.0:
        estimate = aligned(stabilizer, estimate, _q_NB(body))
    _store_estimate(state, X_ESTIMATE, estimate)


@kernel
def _change(params: Array, state: Array, changes: Array, sample: int) -> None:
    """Change the constants that events change at a sample, or have changed since the last one that was observed."""
    i = int(state[X_CHANGE])
    while i < changes.shape[0] and changes[i, 0] <= sample:
        params[int(changes[i, 1])] = changes[i, 2]
        i += 1
    state[X_CHANGE] = i


@kernel
def _write_air(params: Array, state: Array, scripted: Disturbance, record: Array) -> Vector:
    """Write gust and wind, and return the direct moment [N*m] B; what is scripted in N is turned into B."""
    body = _load_body(state, X_BODY)
    gust_B, gust_N, moment_B, moment_N = scripted
    to_B = conjugate(_q_NB(body))
    turned, turned_moment = rotate(to_B, gust_N), rotate(to_B, moment_N)
    turbulence, turning = dryden_gust(_load_dryden_params(params, world.DRYDEN), _load_dryden(state, X_DRYDEN))
    wind = mean_wind(_load_mean_wind_params(params, world.MEAN_WIND), -body.down)
    scale = params[GUST_SCALE]
    for i in range(3):
        record[_GUST + i] = scale * (turbulence[i] + gust_B[i] + turned[i])
        record[_GUST_OMEGA + i] = scale * turning[i]
        record[_WIND + i] = wind[i]
    return moment_B[0] + turned_moment[0], moment_B[1] + turned_moment[1], moment_B[2] + turned_moment[2]


@kernel
def _felt(params: Array, body: Body, direct: Vector, record: Array) -> tuple[Vector, Vector, float]:
    """Return specific force [m/s^2] B, the air's moment [N*m] B, and the load that the ground carries [N]."""
    gust = (record[_GUST], record[_GUST + 1], record[_GUST + 2])
    if params[FREE] == 0.0:
        nothing = BodyInputs(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        force = rigid_body.specific_force(_load_body_params(params, world.BODY), body, nothing)
        air_params = _load_air_params(params, world.AIR)
        return force, gust_moment(air_params.gust_gain, air_params.gust_yaw_ratio, gust), 0.0
    return free_flight.felt(
        _free_params(params), body, FreeInputs(_acting(record, direct, (0.0, 0.0, 0.0), 0.0), _air(record))
    )


@kernel
def _acting(record: Array, moment: Vector, torque: Vector, thrust: float) -> BodyInputs:
    """Return what acts on the body from the record's sample on, under commands [N*m] B and [N]."""
    return BodyInputs(
        torque[0], torque[1], torque[2], moment[0], moment[1], moment[2],
        record[_GUST_OMEGA], record[_GUST_OMEGA + 1], record[_GUST_OMEGA + 2], 0.0, 0.0, 0.0, thrust,
    )  # fmt: skip


@kernel
def _air(record: Array) -> Air:
    return Air(record[_GUST], record[_GUST + 1], record[_GUST + 2], record[_WIND], record[_WIND + 1], record[_WIND + 2])


@kernel
def _write_rotors(params: Array, body: Body, record: Array) -> None:
    """Write what the actuators give; on the stand the rotors are what the allocation makes of it at that thrust."""
    torque = (body.roll, body.pitch, body.yaw)
    _write(record, _TORQUE, torque)
    record[_THRUST] = -body.thrust
    rotors = _load_rotor_params(params, world.ROTORS)
    thrust = body.thrust
    if params[FREE] == 0.0:
        torque, thrust = allocate(rotors, torque, thrust)
    thrusts = rotor_thrusts(rotors, torque, thrust)
    for i in range(4):
        record[_ROTORS + i] = thrusts[i]


@kernel
def advance_kernel(params: Array, state: Array, seed: int, sample: int, sample_us: int, setpoint: Array,
                   record: Array) -> None:  # fmt: skip
    """Move the world from a sample to the next under `setpoint`, and write to `record` what was commanded."""
    touches = setpoint[0] == GUIDANCE and not math.isnan(setpoint[5]) and state[X_LOAD] > _TOUCH * params[WEIGHT]
    q_NB, thrust = _aim(params, state, setpoint, touches)
    torque = _track(params, state, setpoint, q_NB, touches, record)
    if params[FREE] != 0.0:
        torque, thrust = allocate(_load_rotor_params(params, world.ROTORS), torque, thrust)
    _write(record, _TORQUE_COMMAND, torque)
    record[_THRUST_COMMAND] = -thrust
    torque = given(_load_actuator_params(params, world.ACTUATORS), torque)
    _move(params, state, sample_us, torque, thrust, setpoint[0] == OFF, record)
    a, b = normals(seed, GUST_STREAM, sample, 0), normals(seed, GUST_STREAM, sample, 1)
    noise = (a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3])
    air = dryden_step(_load_dryden_params(params, world.DRYDEN), _load_dryden(state, X_DRYDEN), noise)
    _store_dryden(state, X_DRYDEN, air)


@kernel
def _aim(params: Array, state: Array, setpoint: Array, touches: bool) -> tuple[Quaternion, float]:
    """Return the attitude to track, if one is, and the thrust [N] to be asked for; on the stand it is the weight.

    Where a descent touches the ground, that gets the better part of the weight and levels the vehicle: loops that went
    on holding place and attitude against the ground would wind up and throw it over.
    """
    kind = setpoint[0]
    q_NB = (setpoint[1], setpoint[2], setpoint[3], setpoint[4]) if kind == ATTITUDE else (1.0, 0.0, 0.0, 0.0)
    if kind == OFF:
        _store_holding(state, X_HOLDING, nothing_held())
        return q_NB, 0.0
    if params[FREE] == 0.0:
        return q_NB, params[WEIGHT]
    gains, body = _load_position_params(params, world.POSITION), _load_body(state, X_BODY)
    holding, estimate = _load_holding(state, X_HOLDING), _load_estimate(state, X_ESTIMATE)
    present_q_NB = (estimate.qw, estimate.qx, estimate.qy, estimate.qz)
    if touches:
        holding, q_NB, thrust = nothing_held(), present_q_NB, _TOUCHING_THRUST * params[WEIGHT]
    elif kind == GUIDANCE:
        place = (setpoint[1], setpoint[2], setpoint[3])
        holding, acceleration, thrust = guide(gains, holding, body, place, setpoint[5])
        q_NB = lean(acceleration, toward(present_q_NB, setpoint[4]))
    else:
        holding, thrust = lift(gains, holding, body, 4.0 * params[world.ROTORS] * setpoint[THRUST])
        if kind == LEVEL:
            holding = keep_heading(holding, present_q_NB)
            q_NB = lean((0.0, 0.0, 0.0), toward(present_q_NB, holding.yaw))
        else:
            holding = forget_heading(holding)
    _store_holding(state, X_HOLDING, holding)
    return q_NB, thrust


@kernel
def _track(params: Array, state: Array, setpoint: Array, target_q_NB: Quaternion, touches: bool,
           record: Array) -> Vector:  # fmt: skip
    """Return the torque [N*m] B that is asked for, and write the rates that are."""
    stabilizer = _load_stabilizer_params(params, world.STABILIZER)
    estimate = _load_estimate(state, X_ESTIMATE)
    kind = setpoint[0]
    rates = (math.nan, math.nan, math.nan)
    torque = (0.0, 0.0, 0.0)
    if kind == TORQUE:
        torque = (
            setpoint[1] * stabilizer.limit_roll,
            setpoint[2] * stabilizer.limit_pitch,
            setpoint[3] * stabilizer.limit_yaw,
        )
        estimate = rest(estimate)
    elif kind == RATES:
        rates = (setpoint[1], setpoint[2], setpoint[3])
        estimate, torque = rate_torque(stabilizer, estimate, rates)
    elif kind == OFF:
        estimate = rest(estimate)
    elif kind != TRIM:
        turn = attitude_rates(stabilizer, estimate, target_q_NB)
        estimate = rest(estimate) if touches else estimate
        ahead = (setpoint[5], setpoint[6], setpoint[7]) if kind == ATTITUDE else (0.0, 0.0, 0.0)
        rates = (turn[0] + ahead[0], turn[1] + ahead[1], turn[2] + ahead[2])
        estimate, torque = rate_torque(stabilizer, estimate, rates)
    _store_estimate(state, X_ESTIMATE, estimate)
    _write(record, _OMEGA_COMMAND, rates)
    return torque


@kernel
def _move(params: Array, state: Array, sample_us: int, torque: Vector, thrust: float, clamped: bool,
          record: Array) -> None:  # fmt: skip
    """Move the body to the next sample under commands [N*m] B and [N]; `clamped` holds it on the stand."""
    body = _load_body(state, X_BODY)
    steps = int(params[STEPS])
    dt = sample_us * 1e-6 / steps
    if params[FREE] != 0.0:
        direct = (state[X_DIRECT], state[X_DIRECT + 1], state[X_DIRECT + 2])
        flight, inputs = _free_params(params), FreeInputs(_acting(record, direct, torque, thrust), _air(record))
        for _ in range(steps):
            body = free_flight.step(flight, body, inputs, dt)
    else:
        start, body_params = body, _load_body_params(params, world.BODY)
        moment = (record[_MOMENT], record[_MOMENT + 1], record[_MOMENT + 2])
        acting = _acting(record, moment, torque, thrust)
        for _ in range(steps):
            body = rigid_body.step(body_params, body, acting, dt)
        if clamped:
            body = still(start, body)
            estimate = set_attitude(_load_estimate(state, X_ESTIMATE), _q_NB(body))
            _store_estimate(state, X_ESTIMATE, estimate)
    _store_body(state, X_BODY, body)


@compiled
def observe(params: Array, state: Array, waves: Array, replay: Array, changes: Array, seed: int, sample: int,
            sample_us: int, record: Array) -> None:  # fmt: skip
    """Write a sample to `record`, see `observe_kernel`; to be called once a sample."""
    observe_kernel(params, state, waves, replay, changes, seed, sample, sample_us, record)


@compiled
def advance(params: Array, state: Array, seed: int, sample: int, sample_us: int, setpoint: Array,
            record: Array) -> None:  # fmt: skip
    """Move the world from a sample to the next, see `advance_kernel`."""
    advance_kernel(params, state, seed, sample, sample_us, setpoint, record)


def estimate_q_NB(state: Array) -> Any:
    """Return the on-board strapdown attitude (4,) of a world's state."""
    return state[X_ESTIMATE : X_ESTIMATE + 4]
