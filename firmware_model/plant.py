"""One sample of the world: the air and the sensors at the sample rate, the rigid body at the physics rate.

The gust is sampled with the gyro and held from sample to sample, so that one journal record holds all that acted.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_model import rigid_body
from firmware_model.compiled import compiled, kernel
from firmware_model.elementary import normals
from firmware_model.gusts import (
    SINE,
    SQUARE,
    STEP,
    DrydenParams,
    DrydenState,
    direct_moment,
    discrete_gust,
    dryden_filters,
    dryden_gust,
    dryden_spectrum,
    dryden_step,
    gust_moment,
)
from firmware_model.journal import RECORD
from firmware_model.rigid_body import Body, BodyInputs, BodyParams
from firmware_model.rows import loader, starts, storer
from firmware_model.scenario import Dryden, Moment, OneMinusCosine, Scenario, Square, Step
from firmware_model.sensors import GyroParams, accelerometer, gyro
from firmware_model.stabilizer import (
    Estimate,
    StabilizerParams,
    attitude_rates,
    rate_torque,
    rest,
    stabilizer_params,
    strapdown,
)
from firmware_model.vehicle import NoiseModel, Vehicle

Array = NDArray[np.float64]

# One stream of random numbers for each purpose, so that a new sensor leaves every gust as it was.
GUST_STREAM, GYRO_STREAM = 1, 2

# What a set-point asks for: its first number; the others follow.
IDLE, TORQUE, RATES, ATTITUDE = 0.0, 1.0, 2.0, 3.0
SETPOINT = 8
"""Length of a set-point: kind, then torque fractions (3), or rates (3) [rad/s], or q_NB (4) and rates (3)."""

_BODY, _DRYDEN, _GYRO, _STABILIZER, _AIR = starts([BodyParams, DrydenParams, GyroParams, StabilizerParams])
_X_BODY, _X_DRYDEN, _X_ESTIMATE, _X_END = starts([Body, DrydenState, Estimate])
_GAIN, _YAW_RATIO, _STEPS, _PARAMS_END = _AIR, _AIR + 1, _AIR + 2, _AIR + 3

_load_body_params, _load_dryden_params = loader(BodyParams), loader(DrydenParams)
_load_gyro_params, _load_stabilizer_params = loader(GyroParams), loader(StabilizerParams)
_load_body, _load_dryden, _load_estimate = loader(Body), loader(DrydenState), loader(Estimate)
_store_body, _store_dryden, _store_estimate = storer(Body), storer(DrydenState), storer(Estimate)

# Where a field of the journal's record starts, counted in numbers.
_TIME, _GYRO_B, _FORCE_B, _TORQUE_COMMAND, _OMEGA_COMMAND, _TORQUE, _POSITION, _VELOCITY = (
    RECORD.fields[name][1] // 8  # type: ignore[index]
    for name in ("time_us", "gyro_B", "specific_force_B", "torque_command_B", "omega_command_B", "torque_B",
                 "position_N", "velocity_N")
)  # fmt: skip
_Q_NB, _OMEGA, _GUST, _GUST_OMEGA, _MOMENT = (
    RECORD.fields[name][1] // 8  # type: ignore[index]
    for name in ("q_NB", "omega_B", "gust_B", "gust_omega_B", "moment_B")
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """Everything that a flight computes with, as arrays that the kernels take."""

    params: Array
    """(n,) constants, each NamedTuple in a row with its own units."""
    state: Array
    """(n,) body, air and on-board loop, each NamedTuple in a row with its own units; moved on by the kernels."""
    gusts: Array
    """(n, 5) discrete gusts: amplitude [m/s] B, start [s], length [s]."""
    moments: Array
    """(n, 6) direct moments: amplitude [N*m] B, then rate [rad/s] and phase [rad], or start [s]; and the kind."""
    seed: int
    """Seed of all that is random."""


def new_world(vehicle: Vehicle, scenario: Scenario, seed: int) -> World:
    """Return a vehicle at rest and level at the scenario's height, in stationary air.

    Raises
    ------
    ValueError
        If the seed is not in [0, 2^32).
    """
    if not 0 <= seed < 2**32:
        raise ValueError(f"seed is {seed}, must be in [0, 2^32)")
    dryden = next((item for item in scenario.wind if isinstance(item, Dryden)), None)
    dryden_params, dryden_state = _air(vehicle, scenario, dryden, seed)
    estimate = Estimate(1.0, *[0.0] * 12)
    body = Body(0.0, 0.0, -scenario.altitude_m, 0.0, 0.0, 0.0, 1.0, *[0.0] * 9)
    params = np.concatenate(
        [
            rigid_body.body_params(vehicle, free=False),
            dryden_params,
            _gyro_params(vehicle, scenario),
            stabilizer_params(vehicle, scenario.dt),
            [vehicle.gust_gain, vehicle.gust_yaw_ratio, scenario.physics_rate_hz // scenario.control_rate_hz],
        ]
    )
    gusts = [
        (*item.amplitude_mps, item.start_s, item.length_s) for item in scenario.wind if isinstance(item, OneMinusCosine)
    ]
    return World(
        params=params,
        state=np.concatenate([body, dryden_state, estimate]),
        gusts=np.array(gusts, dtype=np.float64).reshape(-1, 5),
        moments=np.array([_row(item) for item in scenario.moment], dtype=np.float64).reshape(-1, 6),
        seed=seed,
    )


def _row(moment: Moment) -> tuple[float, ...]:
    if isinstance(moment, Step):
        return (*moment.amplitude_nm, moment.start_s, 0.0, STEP)
    kind = SQUARE if isinstance(moment, Square) else SINE
    return (*moment.amplitude_nm, moment.rate_rad_s, moment.phase_rad, kind)


def _gyro_params(vehicle: Vehicle, scenario: Scenario) -> GyroParams:
    """Noise is stated for 250 Hz; as a density it grows with the root of the sample rate."""
    instrument = vehicle.gyro
    ratio = instrument.noise_ratio * math.sqrt(scenario.control_rate_hz / 250.0) * scenario.gyro.noise
    steady = instrument.noise_model is NoiseModel.CONSTANT
    b_x, b_y, b_z = (b + fault for b, fault in zip(instrument.bias_B, scenario.gyro.bias_rad_s, strict=True))
    sigma = ratio * instrument.reference_rate if steady else 0.0
    return GyroParams(sigma, 0.0 if steady else ratio, b_x, b_y, b_z, instrument.range)


def _air(vehicle: Vehicle, scenario: Scenario, dryden: Dryden | None, seed: int) -> tuple[DrydenParams, DrydenState]:
    if dryden is None:
        return DrydenParams(*[0.0] * len(DrydenParams._fields)), DrydenState(*[0.0] * 8)
    spectrum = dryden_spectrum(dryden, scenario.altitude_m, vehicle.span)
    params, factor = dryden_filters(spectrum, vehicle.span, scenario.dt)
    # Blocks 0 and 1 of sample 0 drive its step, 2 and 3 are its initial state.
    draw = np.array([*_normals(seed, GUST_STREAM, 0, 2), *_normals(seed, GUST_STREAM, 0, 3)])
    return params, DrydenState(*(factor @ draw).tolist())


@compiled
def _normals(seed: int, stream: int, sample: int, block: int) -> tuple[float, float, float, float]:
    return normals(seed, stream, sample, block)


@kernel
def observe_kernel(params: Array, state: Array, gusts: Array, moments: Array, seed: int, sample: int,
                   sample_us: int, record: Array) -> None:  # fmt: skip
    """Write to `record` the truth at a sample, what acts from it on, and what the sensors measure."""
    body = _load_body(state, _X_BODY)
    body_params = _load_body_params(params, _BODY)
    time_us = sample * sample_us
    time = time_us * 1e-6
    turbulence, gust_omega = dryden_gust(_load_dryden_params(params, _DRYDEN), _load_dryden(state, _X_DRYDEN))
    discrete = discrete_gust(gusts, time)
    direct = direct_moment(moments, time)
    gust = (turbulence[0] + discrete[0], turbulence[1] + discrete[1], turbulence[2] + discrete[2])
    moment = gust_moment(params[_GAIN], params[_YAW_RATIO], gust)
    rate = gyro(_load_gyro_params(params, _GYRO), (body.p, body.q, body.r), normals(seed, GYRO_STREAM, sample, 0))
    nothing = BodyInputs(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    force = accelerometer(rigid_body.specific_force(body_params, body, nothing))
    record[_TIME] = time_us
    for i in range(3):
        record[_GYRO_B + i] = rate[i]
        record[_FORCE_B + i] = force[i]
        record[_GUST + i] = gust[i]
        record[_GUST_OMEGA + i] = gust_omega[i]
        record[_MOMENT + i] = moment[i] + direct[i]
    record[_POSITION], record[_POSITION + 1], record[_POSITION + 2] = body.north, body.east, body.down
    record[_VELOCITY], record[_VELOCITY + 1], record[_VELOCITY + 2] = body.v_north, body.v_east, body.v_down
    record[_Q_NB], record[_Q_NB + 1], record[_Q_NB + 2], record[_Q_NB + 3] = (
        body.qw,
        body.qx,
        body.qy,
        body.qz,
    )
    record[_OMEGA], record[_OMEGA + 1], record[_OMEGA + 2] = body.p, body.q, body.r
    record[_TORQUE], record[_TORQUE + 1], record[_TORQUE + 2] = body.roll, body.pitch, body.yaw
    estimate = _load_estimate(state, _X_ESTIMATE)
    _store_estimate(state, _X_ESTIMATE, strapdown(_load_stabilizer_params(params, _STABILIZER), estimate, rate))


@kernel
def advance_kernel(params: Array, state: Array, seed: int, sample: int, sample_us: int, setpoint: Array,
                   record: Array) -> None:  # fmt: skip
    """Move the world from a sample to the next under `setpoint`, and write to `record` what was commanded."""
    stabilizer = _load_stabilizer_params(params, _STABILIZER)
    estimate = _load_estimate(state, _X_ESTIMATE)
    rates = (math.nan, math.nan, math.nan)
    torque = (0.0, 0.0, 0.0)
    if setpoint[0] == TORQUE:
        torque = (
            setpoint[1] * stabilizer.limit_roll,
            setpoint[2] * stabilizer.limit_pitch,
            setpoint[3] * stabilizer.limit_yaw,
        )
        estimate = rest(estimate)
    elif setpoint[0] == RATES:
        rates = (setpoint[1], setpoint[2], setpoint[3])
        estimate, torque = rate_torque(stabilizer, estimate, rates)
    elif setpoint[0] == ATTITUDE:
        turn = attitude_rates(stabilizer, estimate, (setpoint[1], setpoint[2], setpoint[3], setpoint[4]))
        rates = (turn[0] + setpoint[5], turn[1] + setpoint[6], turn[2] + setpoint[7])
        estimate, torque = rate_torque(stabilizer, estimate, rates)
    _store_estimate(state, _X_ESTIMATE, estimate)
    for i in range(3):
        record[_TORQUE_COMMAND + i] = torque[i]
        record[_OMEGA_COMMAND + i] = rates[i]
    inputs = BodyInputs(
        torque[0], torque[1], torque[2], record[_MOMENT], record[_MOMENT + 1], record[_MOMENT + 2],
        record[_GUST_OMEGA], record[_GUST_OMEGA + 1], record[_GUST_OMEGA + 2], 0.0, 0.0, 0.0,
    )  # fmt: skip
    body = _load_body(state, _X_BODY)
    body_params = _load_body_params(params, _BODY)
    steps = int(params[_STEPS])
    dt = sample_us * 1e-6 / steps
    for _ in range(steps):
        body = rigid_body.step(body_params, body, inputs, dt)
    _store_body(state, _X_BODY, body)
    a, b = normals(seed, GUST_STREAM, sample, 0), normals(seed, GUST_STREAM, sample, 1)
    noise = (a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3])
    air = dryden_step(_load_dryden_params(params, _DRYDEN), _load_dryden(state, _X_DRYDEN), noise)
    _store_dryden(state, _X_DRYDEN, air)


@compiled
def observe(params: Array, state: Array, gusts: Array, moments: Array, seed: int, sample: int, sample_us: int,
            record: Array) -> None:  # fmt: skip
    """Write a sample to `record`, see `observe_kernel`; to be called once a sample."""
    observe_kernel(params, state, gusts, moments, seed, sample, sample_us, record)


@compiled
def advance(params: Array, state: Array, seed: int, sample: int, sample_us: int, setpoint: Array,
            record: Array) -> None:  # fmt: skip
    """Move the world from a sample to the next, see `advance_kernel`."""
    advance_kernel(params, state, seed, sample, sample_us, setpoint, record)


def estimate_q_NB(state: Array) -> Any:
    """Return the on-board strapdown attitude (4,) of a world's state."""
    return state[_X_ESTIMATE : _X_ESTIMATE + 4]
