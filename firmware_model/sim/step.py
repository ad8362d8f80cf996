"""Step the simulation by one sample: air and sensors at the sample rate, the rigid body at the physics rate.

The gust is sampled with the gyro and held until the next sample, so that one journal record holds all inputs.
"""

from typing import Any

from firmware_model.autopilot import attitude_loop
from firmware_model.autopilot.attitude_loop import StabilizerParams, StabilizerState
from firmware_model.numerics.compiled import compiled, kernel
from firmware_model.numerics.elementary import mixed_normals
from firmware_model.numerics.random import ACCELEROMETER_STREAM, GUST_STREAM, GYRO_STREAM
from firmware_model.numerics.rotations import conjugate, rotate
from firmware_model.numerics.soa import (
    Lane,
    field_offset,
    get,
    get_vector,
    loader,
    offsets,
    put,
    put_vector,
    single,
    storer,
)
from firmware_model.physics import aerodynamics, rigid_body
from firmware_model.physics.actuators import ActuatorParams, apply_actuator_faults
from firmware_model.physics.aerodynamics import Air, AirParams, FreeInputs, FreeParams, Stream
from firmware_model.physics.battery import BatteryParams, BatteryState, step_battery
from firmware_model.physics.disturbances import Disturbance, disturbance
from firmware_model.physics.dryden import DrydenParams, DrydenState, dryden_gust, dryden_step, gust_moment
from firmware_model.physics.ground import GroundParams, can_touch_ground
from firmware_model.physics.mean_wind import MeanWindParams, mean_wind
from firmware_model.physics.rigid_body import Body, BodyInputs, BodyParams, Motion, at_rest
from firmware_model.physics.rotors import Float4, LossParams, allocate, given_by_rotors, put_rotor_thrusts, sum_lift
from firmware_model.physics.sensors import AccelerometerParams, GyroParams, measure_accelerometer, measure_gyro
from firmware_model.recording import journal
from firmware_model.sim import layout
from firmware_model.sim.inner_loop import CLAMPED, OFF, WRENCH, get_command, limit_command, track_setpoint
from firmware_model.sim.layout import X_BATTERY, X_BODY, X_DIRECT, X_DRYDEN, X_LOAD, X_NEXT_CHANGE, X_SAG, X_STABILIZER
from firmware_model.sim.state import Array
from firmware_model.types import Quaternion, Vector

_ZERO = (0.0, 0.0, 0.0)
_load_body_params, _load_dryden_params = loader(BodyParams), loader(DrydenParams)
_load_gyro_params, _load_stabilizer_params = loader(GyroParams), loader(StabilizerParams)
_load_loss_params = loader(LossParams)
_load_air_params, _load_ground_params = loader(AirParams), loader(GroundParams)
_load_mean_wind_params, _load_actuator_params = loader(MeanWindParams), loader(ActuatorParams)
_load_accelerometer_params = loader(AccelerometerParams)
_load_battery_params = loader(BatteryParams)
_load_battery, _store_battery = loader(BatteryState), storer(BatteryState)
_load_body, _load_dryden = loader(Body), loader(DrydenState)
_load_stabilizer_state, _store_stabilizer_state = loader(StabilizerState), storer(StabilizerState)
_store_body, _store_dryden = storer(Body), storer(DrydenState)
_load_motion, _store_motion = loader(Motion), storer(Motion)
_load_stream, _store_stream = loader(Stream), storer(Stream)
_X_TORQUE, _X_THRUST = (X_BODY + field_offset(Body, name) for name in ("torque_B", "thrust"))
_VELOCITY, _Q_NB, _OMEGA = (field_offset(Motion, name) for name in ("velocity_N", "q_NB", "omega_B"))
_NOW, _END, _STREAM, _ACTUATORS = offsets([Motion, Motion, Stream])
_COMMAND = _ACTUATORS + 16
STAGE_ROWS = _COMMAND + 4
"""Numbers of a flight between the stages of a step."""


@kernel
def observe_kernel(
    params: Array,
    state: Array,
    waves: Array,
    replay: Array,
    changes: Array,
    mix: Array,
    sample: int,
    sample_us: int,
    record: Array,
) -> None:
    """Write to `record` the true state at a sample, the inputs from then on, and the measurements; once a sample.

    `mix` (n, 3) is that of `mixed_normals`.
    """
    one, x = single(params), single(state)
    apply_changes(params, x, changes, sample)
    time_us = sample * sample_us
    scripted, free = disturbance(waves, replay, sample, time_us * 1e-6), get(one, layout.FREE) != 0.0
    gyro_noise = mixed_normals(mix, GYRO_STREAM, sample, 0)
    force_noise = mixed_normals(mix, ACCELEROMETER_STREAM, sample, 0)
    if get(one, layout.BATTERY) != 0.0:
        drain_battery(one, x)
    measure(one, x, free, True, True, scripted, gyro_noise, time_us, single(record))
    measure_force(one, x, free, True, force_noise, single(record))
    _write_rotors(one, x, free, single(record))


@kernel
def advance_kernel(
    params: Array, state: Array, mix: Array, sample: int, sample_us: int, setpoint: Array, record: Array
) -> None:
    """Step from a sample to the next under `setpoint`, and write the actuator command to `record`."""
    one, x, row = single(params), single(state), single(record)
    kind, free, steps = setpoint[0], get(one, layout.FREE) != 0.0, int(get(one, layout.STEPS))
    dt = sample_us * 1e-6 / steps
    track_setpoint(one, x, free, kind, single(setpoint), row)
    if free and kind != WRENCH:
        limit_command(one, int(get(one, layout.ROTOR_COUNT)), row)
    start = _load_body(x, X_BODY)
    body = start
    for _ in range(steps):
        body = integrate_body(one, x, free, body, dt, row)
    if not free and (kind == OFF or (kind == WRENCH and setpoint[CLAMPED] != 0.0)):
        body = at_rest(start, body)
        estimate = attitude_loop.set_attitude(_load_stabilizer_state(x, X_STABILIZER), body.q_NB)
        _store_stabilizer_state(x, X_STABILIZER, estimate)
    _store_body(x, X_BODY, body)
    step_turbulence(one, x, mixed_normals(mix, GUST_STREAM, sample, 0), mixed_normals(mix, GUST_STREAM, sample, 1))


@kernel
def apply_changes(params: Array, state: Lane, changes: Array, sample: int) -> None:
    """Apply the changes by events that are due at a sample and not applied yet."""
    i = int(get(state, X_NEXT_CHANGE))
    while i < changes.shape[0] and changes[i, 0] <= sample:
        params[int(changes[i, 1])] = changes[i, 2]
        i += 1
    put(state, X_NEXT_CHANGE, i)


@kernel
def drain_battery(params: Lane, state: Lane) -> None:
    """Step the battery at a sample under the thrusts of its rotors; without a battery, change nothing that counts."""
    body, count = _load_body(state, X_BODY), int(get(params, layout.ROTOR_COUNT))
    lift = sum_lift(params, layout.ROTORS, count, body.torque_B, body.thrust)
    battery = step_battery(_load_battery_params(params, layout.BATTERY), _load_battery(state, X_BATTERY), lift)
    _store_battery(state, X_BATTERY, battery)


@kernel
def measure(
    params: Lane,
    state: Lane,
    free: bool,
    full: bool,
    acts: bool,
    scripted: Disturbance,
    noise: Float4,
    time_us: int,
    record: Lane,
) -> None:
    """Write to `record` the fields of `observe_kernel` except those of `measure_force` and the rotors.

    The noise of the gyro is standard normal. Unless `full`, leave out the on-board attitude, fields that are only
    recorded and, on the stand, the wind. Torque and rate laws and the metrics need none of them. Unless any table
    `acts`, all of `scripted` is 0, and skipped.
    """
    body, time = _load_body(state, X_BODY), time_us * 1e-6
    direct = _write_air(params, state, full or free, acts, scripted, record)
    rate = measure_gyro(_load_gyro_params(params, layout.GYRO), body.omega_B, noise, time)
    put_vector(record, journal.GYRO_B, rate)
    put_vector(record, journal.OMEGA, body.omega_B)
    _put_float4(record, journal.Q_NB, body.q_NB)
    stabilizer = _load_stabilizer_params(params, layout.STABILIZER)
    estimate = _load_stabilizer_state(state, X_STABILIZER)
    if full:
        estimate = attitude_loop.update_attitude(stabilizer, estimate, rate)
        if free:
            estimate = attitude_loop.align_attitude(stabilizer, estimate, body.q_NB)
    else:
        estimate = attitude_loop.update_rates(stabilizer, estimate, rate)
    _store_stabilizer_state(state, X_STABILIZER, estimate)
    if full or free:
        put_vector(state, X_DIRECT, direct)
        put_vector(record, journal.POSITION, body.position_N)
    if not free:
        air = _load_air_params(params, layout.AIR)
        moment = gust_moment(air.gust_gain, air.gust_yaw_ratio, get_vector(record, journal.GUST))
        _put_moment(record, moment, direct)
    if full:
        put(record, journal.TIME, time_us)
        put_vector(record, journal.VELOCITY, body.velocity_N)
        given = given_by_rotors(_load_loss_params(params, layout.LOSS), body)
        put_vector(record, journal.TORQUE_B, given.torque_B)
        put(record, journal.THRUST, -given.thrust)


@kernel
def measure_force(params: Lane, state: Lane, free: bool, unusual: bool, noise: Float4, record: Lane) -> None:
    """Write to `record` the specific force and, in free flight, the moment of the air; to `state` the ground's load.

    It follows `measure`. The noise is standard normal. Unless `unusual`, skip contact and failed rotors.
    """
    body, load = _load_body(state, X_BODY), 0.0
    if free:
        direct = get_vector(state, X_DIRECT)
        inputs = FreeInputs(_body_inputs(record, direct, _ZERO, 0.0), _read_air(record), unusual, unusual)
        force, moment, load = aerodynamics.sensor_wrench(_free_params(params), body, inputs)
        _put_moment(record, moment, direct)
    else:
        no_inputs = BodyInputs(_ZERO, _ZERO, _ZERO, _ZERO, 0.0)
        force = rigid_body.specific_force(_load_body_params(params, layout.BODY), body, no_inputs)
    accelerometer = _load_accelerometer_params(params, layout.ACCELEROMETER)
    put_vector(record, journal.FORCE_B, measure_accelerometer(accelerometer, force, noise))
    put(state, X_LOAD, load)


@kernel
def _put_moment(record: Lane, a: Vector, b: Vector) -> None:
    put_vector(record, journal.MOMENT, (a[0] + b[0], a[1] + b[1], a[2] + b[2]))


@kernel
def _put_float4(lane: Lane, row: int, value: Quaternion) -> None:
    for i in range(4):
        put(lane, row + i, value[i])


@kernel
def _free_params(params: Lane) -> FreeParams:
    return FreeParams(
        _load_body_params(params, layout.BODY),
        _load_air_params(params, layout.AIR),
        _load_ground_params(params, layout.GROUND),
        _load_loss_params(params, layout.LOSS),
    )


@kernel
def _write_air(params: Lane, state: Lane, windy: bool, acts: bool, scripted: Disturbance, record: Lane) -> Vector:
    """Write gust and wind, and return the direct moment [N*m] B; scripted vectors in N are rotated into B."""
    body = _load_body(state, X_BODY)
    gust_B, gust_N, moment_B, moment_N = scripted
    rotated_gust, rotated_moment = _ZERO, _ZERO
    if acts:
        to_B = conjugate(body.q_NB)
        rotated_gust, rotated_moment = rotate(to_B, gust_N), rotate(to_B, moment_N)
    turbulence, angular_gust = dryden_gust(_load_dryden_params(params, layout.DRYDEN), _load_dryden(state, X_DRYDEN))
    scale = get(params, layout.GUST_SCALE)
    for i in range(3):
        put(record, journal.GUST + i, scale * (turbulence[i] + gust_B[i] + rotated_gust[i]))
        put(record, journal.GUST_OMEGA + i, scale * angular_gust[i])
    if windy:
        winds = _load_mean_wind_params(params, layout.MEAN_WIND)
        put_vector(record, journal.WIND, mean_wind(winds, -body.position_N[2]))
    return moment_B[0] + rotated_moment[0], moment_B[1] + rotated_moment[1], moment_B[2] + rotated_moment[2]


@kernel
def _body_inputs(record: Lane, moment: Vector, torque: Vector, thrust: float) -> BodyInputs:
    """Return the inputs of the body from the record's sample on, under commands [N*m] B and [N]."""
    return BodyInputs(torque, moment, get_vector(record, journal.GUST_OMEGA), _ZERO, thrust)


@kernel
def _read_air(record: Lane) -> Air:
    return Air(get_vector(record, journal.GUST), get_vector(record, journal.WIND))


@kernel
def _write_rotors(params: Lane, state: Lane, free: bool, record: Lane) -> None:
    """Write the rotor thrusts; on the stand they are those that the allocation gives at that thrust."""
    body = _load_body(state, X_BODY)
    torque, thrust = body.torque_B, body.thrust
    count = int(get(params, layout.ROTOR_COUNT))
    if not free:
        torque, thrust = allocate(params, layout.ROTORS, count, torque, thrust)
    at = journal.ROTORS if count == 4 else journal.WIDTH  # see `journal.record_type`
    put_rotor_thrusts(params, layout.ROTORS, count, torque, thrust, record, at)


@kernel
def integrate_body(params: Lane, state: Lane, free: bool, body: Body, dt: float, record: Lane) -> Body:
    """Return the body after a step of `dt` [s] under the inputs and commands of the record's sample."""
    if free:
        return aerodynamics.step(_free_params(params), body, _free_inputs(params, state, True, record), dt)
    torque, thrust = _read_command(params, record)
    held = _body_inputs(record, get_vector(record, journal.MOMENT), torque, thrust)
    return rigid_body.step_attitude(_load_body_params(params, layout.BODY), body, held, dt)


@kernel
def _read_command(params: Lane, record: Lane) -> tuple[Vector, float]:
    """Return the torque [N*m] B and thrust [N] that the actuators give for the record's command."""
    actuators = _load_actuator_params(params, layout.ACTUATORS)
    torque, thrust = get_command(record)
    return apply_actuator_faults(actuators, torque), thrust


@kernel
def _free_inputs(params: Lane, state: Lane, unusual: bool, record: Lane) -> FreeInputs:
    sag, (torque, thrust) = get(state, X_SAG), _read_command(params, record)
    torque, thrust = (sag * torque[0], sag * torque[1], sag * torque[2]), sag * thrust
    forces = _body_inputs(record, get_vector(state, X_DIRECT), torque, thrust)
    return FreeInputs(forces, _read_air(record), unusual, unusual)


@kernel
def step_body(params: Lane, state: Lane, free: bool, dt: float, record: Lane) -> None:
    """Step the body once, see `integrate_body`."""
    _store_body(state, X_BODY, integrate_body(params, state, free, _load_body(state, X_BODY), dt, record))


@kernel
def begin_steps(params: Lane, state: Lane, record: Lane, work: Lane) -> None:
    """Write what the actuators give for the record's command, for `begin_stages` in all steps of a sample."""
    given = _free_inputs(params, state, False, record).body
    put_vector(work, _COMMAND, given.torque_command_B)
    put(work, _COMMAND + 3, given.thrust_command)


@kernel
def begin_stages(params: Lane, state: Lane, dt: float, record: Lane, work: Lane) -> None:
    """Begin to step the body as `step_body` does one in free flight that is not unusual, with the same bits.

    `meet_air` and `step_stage` follow for each of the four stages, each in a loop of its own over flights. A whole step
    is a chain so long that a processor finds nothing else to do while it waits for a root.
    """
    constants, body = _load_body_params(params, layout.BODY), _load_body(state, X_BODY)
    inputs = _body_inputs(record, _ZERO, get_vector(work, _COMMAND), get(work, _COMMAND + 3))
    T, torque_B, F, thrust = rigid_body.step_actuators(constants, body, inputs, dt)
    for i in range(4):
        put_vector(work, _ACTUATORS + 4 * i, T[i])
        put(work, _ACTUATORS + 4 * i + 3, F[i])
    put_vector(state, _X_TORQUE, torque_B)
    put(state, _X_THRUST, thrust)


@kernel
def meet_air(stage: int, params: Lane, state: Lane, record: Lane, work: Lane) -> None:
    """Meet the air of a stage, 0 to 3: all its roots."""
    motion = _load_motion(state, X_BODY) if stage == 0 else _load_motion(work, _NOW)
    thrust, air = get(work, _ACTUATORS + 4 * stage + 3), _load_air_params(params, layout.AIR)
    _store_stream(work, _STREAM, aerodynamics.meet_air(air, motion, thrust, _read_air(record)))


@kernel
def step_stage(stage: int, share: float, h: float, params: Lane, state: Lane, record: Lane, work: Lane) -> None:
    """Do a stage, 0 to 3: its derivative adds `share` [s] to the end of the step, and `h` [s] to the next stage."""
    constants, inputs = _free_params(params), _free_inputs(params, state, False, record)
    start, at = _load_motion(state, X_BODY), _ACTUATORS + 4 * stage
    now = start if stage == 0 else _load_motion(work, _NOW)
    end = start if stage == 0 else _load_motion(work, _END)
    body, stream = rigid_body.join(now, get_vector(work, at), get(work, at + 3)), _load_stream(work, _STREAM)
    rate = aerodynamics.motion_rate(constants, body, stream, inputs)
    end = rigid_body.move_motion(end, share, rate)
    if stage == 3:
        _store_motion(state, X_BODY, rigid_body.with_unit_length(end))
    else:
        now = rigid_body.move_motion(start, h, rate)
        _store_motion(work, _END, end)
        put_vector(work, _NOW + _VELOCITY, now.velocity_N)  # away from the ground no stage needs its position
        _put_float4(work, _NOW + _Q_NB, now.q_NB)
        put_vector(work, _NOW + _OMEGA, now.omega_B)


@kernel
def is_unusual(params: Lane, state: Lane, dt: float) -> bool:
    """Return whether a vehicle in free flight may touch the ground within a step of `dt` [s], or lacks a rotor."""
    low = can_touch_ground(_load_ground_params(params, layout.GROUND), _load_body(state, X_BODY), dt)
    return low | (get(params, layout.LOSS) != 0.0)


@kernel
def step_turbulence(params: Lane, state: Lane, a: Float4, b: Float4) -> None:
    """Step the turbulence to the next sample with eight standard normal numbers."""
    noise = (a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3])
    turbulence = dryden_step(_load_dryden_params(params, layout.DRYDEN), _load_dryden(state, X_DRYDEN), noise)
    _store_dryden(state, X_DRYDEN, turbulence)


observe, advance = compiled(observe_kernel), compiled(advance_kernel)
"""The same for calls from Python."""


def estimate_q_NB(state: Array) -> Any:
    """Return the on-board strapdown attitude (4,) of a state."""
    return state[X_STABILIZER : X_STABILIZER + 4]
