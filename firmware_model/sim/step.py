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
from firmware_model.physics.aerodynamics import Air, AirParams, ExternalLoads, FreeInputs, FreeParams, StageLoads
from firmware_model.physics.battery import BatteryParams, BatteryState, step_battery
from firmware_model.physics.disturbances import Disturbance, disturbance
from firmware_model.physics.dryden import dryden_gust, dryden_step, gust_moment
from firmware_model.physics.ground import GroundParams, can_touch_ground, ground_wrench
from firmware_model.physics.gust_filters import DrydenParams, DrydenState
from firmware_model.physics.mean_wind import MeanWindParams, mean_wind
from firmware_model.physics.rigid_body import (
    Body,
    BodyParams,
    Motion,
    Wrench,
    add,
    add_motions,
    at_rest,
    change_motion,
    get_wrench,
    scale,
    scale_motion,
    turn_from_outside,
    with_unit_length,
)
from firmware_model.physics.rotors import Float4, LossParams, allocate, given_by_rotors, put_rotor_thrusts, sum_lift
from firmware_model.physics.sensors import AccelerometerParams, GyroParams, measure_accelerometer, measure_gyro
from firmware_model.physics.von_karman import KarmanParams, KarmanState, karman_step, show_gust
from firmware_model.recording import journal
from firmware_model.sim import layout
from firmware_model.sim.inner_loop import CLAMPED, OFF, WRENCH, get_command, limit_command, seek_place, track_setpoint
from firmware_model.sim.layout import X_BATTERY, X_BODY, X_DIRECT, X_DRYDEN, X_LOAD, X_NEXT_CHANGE, X_SAG, X_STABILIZER
from firmware_model.sim.state import Array, SimState
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
_load_karman_params, _load_karman, _store_karman = loader(KarmanParams), loader(KarmanState), storer(KarmanState)
_load_motion, _store_motion = loader(Motion), storer(Motion)
_load_stage_loads, _store_stage_loads = loader(StageLoads), storer(StageLoads)
_load_external_loads, _store_external_loads = loader(ExternalLoads), storer(ExternalLoads)
_load_wrench, _store_wrench = loader(Wrench), storer(Wrench)
_X_WRENCH, _X_VELOCITY, _X_Q_NB, _X_OMEGA = (
    X_BODY + field_offset(Body, name) for name in ("torque_B", "velocity_N", "q_NB", "omega_B")
)
MIDDLE, END, _START, _NOW, _CHANGE, _OUTSIDE, _COMMAND, _NEAR, _IS_NEAR = offsets(
    [StageLoads, StageLoads, Motion, Motion, Motion, ExternalLoads, Wrench, Body]
)
"""Rows of work space for the accelerations in the middle of a step and at its end."""
WORK_ROWS = _IS_NEAR + 1
"""Numbers of a flight between the stages of a step."""


@kernel
def observe_kernel(sim: SimState, sample: int, record: Array) -> None:
    """Write to `record` the true state at a sample, the inputs from then on, and the measurements; once a sample."""
    one, x = single(sim.params), single(sim.state)
    apply_changes(sim.params, x, sim.changes, sample)
    time_us = sample * sim.sample_us
    scripted, free = disturbance(sim.waves, sim.replay, sample, time_us * 1e-6), get(one, layout.FREE) != 0.0
    gyro_noise = mixed_normals(sim.mix, GYRO_STREAM, sample, 0)
    force_noise = mixed_normals(sim.mix, ACCELEROMETER_STREAM, sample, 0)
    if get(one, layout.BATTERY) != 0.0:
        drain_battery(one, x)
    measure(one, x, free, True, True, scripted, gyro_noise, time_us, single(record))
    measure_force(one, x, free, True, force_noise, single(record))
    _write_rotors(one, x, free, single(record))
    if get(one, layout.HOLDS_PLACE) != 0.0:
        seek_place(one, x)


@kernel
def advance_kernel(sim: SimState, sample: int, setpoint: Array, record: Array) -> None:
    """Step from a sample to the next under `setpoint`, and write the actuator command to `record`."""
    one, x, row = single(sim.params), single(sim.state), single(record)
    kind, free, steps = setpoint[0], get(one, layout.FREE) != 0.0, int(get(one, layout.STEPS))
    dt = sim.sample_us * 1e-6 / steps
    track_setpoint(one, x, free, kind, single(setpoint), row)
    if free and kind != WRENCH:
        limit_command(one, int(get(one, layout.ROTOR_COUNT)), row)
    start = _load_body(x, X_BODY)
    body = start
    if free:
        body = aerodynamics.fly(_free_params(one), start, _free_inputs(one, x, True, True, row), dt, steps)
    else:
        for _ in range(steps):
            body = _step_held(one, body, dt, row)
    if not free and (kind == OFF or (kind == WRENCH and setpoint[CLAMPED] != 0.0)):
        body = at_rest(start, body)
        estimate = attitude_loop.set_attitude(_load_stabilizer_state(x, X_STABILIZER), body.q_NB)
        _store_stabilizer_state(x, X_STABILIZER, estimate)
    _store_body(x, X_BODY, body)
    a, b = mixed_normals(sim.mix, GUST_STREAM, sample, 0), mixed_normals(sim.mix, GUST_STREAM, sample, 1)
    if get(one, layout.VON_KARMAN) != 0.0:
        step_von_karman(one, x, a, b)
    else:
        step_turbulence(one, x, a, b)


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
        put_vector(record, journal.MOMENT, add(moment, direct))
    if full:
        put(record, journal.TIME, time_us)
        put_vector(record, journal.VELOCITY, body.velocity_N)
        produced = given_by_rotors(_load_loss_params(params, layout.LOSS), get_wrench(body))
        put_vector(record, journal.TORQUE_B, produced.torque_B)
        put(record, journal.THRUST, -produced.thrust)


@kernel
def measure_force(params: Lane, state: Lane, free: bool, unusual: bool, noise: Float4, record: Lane) -> None:
    """Write to `record` the specific force and, in free flight, the moment of the air; to `state` the ground's load.

    It follows `measure`. The noise is standard normal. Unless `unusual`, skip contact and failed rotors.
    """
    body, load = _load_body(state, X_BODY), 0.0
    if free:
        inputs = _free_inputs(params, state, unusual, unusual, record)
        force, moment, load = aerodynamics.sensor_wrench(_free_params(params), body, inputs)
        put_vector(record, journal.MOMENT, add(moment, get_vector(state, X_DIRECT)))
    else:
        force = rigid_body.held_force(body.q_NB)
    accelerometer = _load_accelerometer_params(params, layout.ACCELEROMETER)
    put_vector(record, journal.FORCE_B, measure_accelerometer(accelerometer, force, noise))
    put(state, X_LOAD, load)


@kernel
def measure_load(params: Lane, state: Lane) -> None:
    """Write to `state` the ground's load that `measure_force` would, for a law that feels no force."""
    body, ground = _load_body(state, X_BODY), _load_ground_params(params, layout.GROUND)
    touches = can_touch_ground(ground, body, 0.0)
    put(state, X_LOAD, ground_wrench(ground, body)[2] if touches else 0.0)


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
    strength = get(params, layout.GUST_SCALE)
    for i in range(3):
        put(record, journal.GUST + i, strength * (turbulence[i] + gust_B[i] + rotated_gust[i]))
        put(record, journal.GUST_OMEGA + i, strength * angular_gust[i])
    if windy:
        winds = _load_mean_wind_params(params, layout.MEAN_WIND)
        put_vector(record, journal.WIND, mean_wind(winds, -body.position_N[2]))
    return add(moment_B, rotated_moment)


@kernel
def _turn_from_outside(params: Lane, moment: Vector, record: Lane) -> Vector:
    """Return the angular acceleration [rad/s^2] B by a moment [N*m] B and the angular gust of the record's sample."""
    gust_omega = get_vector(record, journal.GUST_OMEGA)
    return turn_from_outside(_load_body_params(params, layout.BODY), moment, gust_omega)


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
def _step_held(params: Lane, body: Body, dt: float, record: Lane) -> Body:
    outside = _turn_from_outside(params, get_vector(record, journal.MOMENT), record)
    constants = _load_body_params(params, layout.BODY)
    return rigid_body.step_attitude(constants, body, _read_command(params, record), outside, dt)


@kernel
def _read_command(params: Lane, record: Lane) -> Wrench:
    """Return what the actuators give for the record's command, once their lag has passed."""
    actuators = _load_actuator_params(params, layout.ACTUATORS)
    torque, thrust = get_command(record)
    return Wrench(apply_actuator_faults(actuators, torque), thrust)


@kernel
def _free_inputs(params: Lane, state: Lane, near_ground: bool, failed: bool, record: Lane) -> FreeInputs:
    sag, (torque, thrust) = get(state, X_SAG), _read_command(params, record)
    command = Wrench(scale(sag, torque), sag * thrust)
    body, air = _load_body_params(params, layout.BODY), _load_air_params(params, layout.AIR)
    outside = _turn_from_outside(params, get_vector(state, X_DIRECT), record)
    surroundings = aerodynamics.surround(body, air, get(record, journal.GUST + 2), outside)
    return FreeInputs(command, surroundings, _read_air(record), near_ground, failed)


@kernel
def step_held(params: Lane, state: Lane, dt: float, record: Lane) -> None:
    """Step a vehicle on the stand once."""
    _store_body(state, X_BODY, _step_held(params, _load_body(state, X_BODY), dt, record))


@kernel
def begin_near_ground(params: Lane, state: Lane, h: float, work: Lane) -> None:
    """Begin a sample of `h` [s] near the ground.

    If any flight may touch the ground, all fly this sample besides the one away from it.
    """
    near = may_touch_ground(params, state, h)
    put(work, _IS_NEAR, 1.0 if near else 0.0)
    _store_body(work, _NEAR, _load_body(state, X_BODY))


@kernel
def step_near_ground(params: Lane, state: Lane, dt: float, record: Lane, work: Lane) -> None:
    """Step as if the ground were near; `end_near_ground` drops the result where it is not."""
    inputs, body = _free_inputs(params, state, True, True, record), _load_body(work, _NEAR)
    _store_body(work, _NEAR, aerodynamics.step_near_ground(_free_params(params), body, inputs, dt))


@kernel
def end_near_ground(state: Lane, work: Lane) -> None:
    """Replace the state that `end_sample` wrote, if the ground is near."""
    near, away = _load_body(work, _NEAR), _load_body(state, X_BODY)
    _store_body(state, X_BODY, near if get(work, _IS_NEAR) != 0.0 else away)


@kernel
def begin_sample(params: Lane, state: Lane, failed: bool, h: float, record: Lane, work: Lane) -> None:
    """Begin a sample of `h` [s] as `aerodynamics.fly` does away from the ground, with the same bits.

    For each step follow `step_stage` for stage 0, `step_actuators`, and the other stages; then `end_sample`. Each is a
    loop of its own over flights. A whole step is a chain so long that a processor finds nothing else to do while it
    waits for a root. Unless any rotor has `failed`, all are sound.
    """
    inputs, body = _free_inputs(params, state, False, failed, record), _load_body(state, X_BODY)
    _store_external_loads(work, _OUTSIDE, inputs.outside)
    _store_wrench(work, _COMMAND, inputs.command)
    motion, loads, position_N = aerodynamics.begin_sample(_free_params(params), body, inputs, h)
    _store_motion(work, _START, motion)
    _store_stage_loads(work, END, loads)
    put_vector(state, X_BODY, position_N)


@kernel
def step_actuators(params: Lane, state: Lane, failed: bool, record: Lane, work: Lane) -> None:
    """Step the actuators; stage 0 is done, and no longer needs the accelerations that this overwrites."""
    produced, inputs = _load_wrench(state, _X_WRENCH), _stage_inputs(failed, record, work)
    middle, produced, end = aerodynamics.step_actuators(_free_params(params), produced, inputs)
    _store_stage_loads(work, MIDDLE, middle)
    _store_stage_loads(work, END, end)
    _store_wrench(state, _X_WRENCH, produced)


@kernel
def _stage_inputs(failed: bool, record: Lane, work: Lane) -> FreeInputs:
    outside = _load_external_loads(work, _OUTSIDE)
    return FreeInputs(_load_wrench(work, _COMMAND), outside, _read_air(record), False, failed)


@kernel
def step_stage(stage: int, loads: int, h: float, params: Lane, record: Lane, work: Lane) -> None:
    """Do a stage, 0 to 3, with accelerations from the row `loads`; its change in `h` [s] leads to the next stage."""
    start = _load_motion(work, _START)
    now = start if stage == 0 else _load_motion(work, _NOW)
    given = (_stage_inputs(False, record, work), _load_stage_loads(work, loads))
    rate = aerodynamics.motion_rate(_free_params(params), now, given)
    change = change_motion(h, rate)
    if stage < 3:
        _store_motion(work, _NOW, add_motions(start, change))
    if stage == 1:
        change = change_motion(2.0 * h, rate)  # it counts twice, with the same bits as two of it
    if stage > 0:
        change = add_motions(_load_motion(work, _CHANGE), change)
    if stage < 3:
        _store_motion(work, _CHANGE, change)
    else:
        _store_motion(work, _START, add_motions(start, scale_motion(1.0 / 3.0, change)))


@kernel
def end_sample(state: Lane, h: float, record: Lane, work: Lane) -> None:
    """Write the state after a sample of `h` [s]."""
    motion, position_N = with_unit_length(_load_motion(work, _START)), get_vector(state, X_BODY)
    inputs, loads = _stage_inputs(False, record, work), _load_stage_loads(work, END)
    position_N, velocity_N = aerodynamics.end_sample(position_N, motion, loads, inputs, h)
    put_vector(state, X_BODY, position_N)
    put_vector(state, _X_VELOCITY, velocity_N)
    _put_float4(state, _X_Q_NB, motion.q_NB)
    put_vector(state, _X_OMEGA, motion.omega_B)


@kernel
def is_unusual(params: Lane, state: Lane) -> bool:
    """Return whether a vehicle in free flight may touch the ground, or lacks a rotor."""
    return may_touch_ground(params, state, 0.0) | lacks_rotor(params)


@kernel
def may_touch_ground(params: Lane, state: Lane, dt: float) -> bool:
    """Return whether a vehicle may touch the ground within `dt` [s]."""
    return can_touch_ground(_load_ground_params(params, layout.GROUND), _load_body(state, X_BODY), dt)


@kernel
def lacks_rotor(params: Lane) -> bool:
    """Return whether a rotor has failed."""
    return get(params, layout.LOSS) != 0.0


@kernel
def step_turbulence(params: Lane, state: Lane, a: Float4, b: Float4) -> None:
    """Step the turbulence to the next sample with eight standard normal numbers."""
    noise = (a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3])
    turbulence = dryden_step(_load_dryden_params(params, layout.DRYDEN), _load_dryden(state, X_DRYDEN), noise)
    _store_dryden(state, X_DRYDEN, turbulence)


@kernel
def step_von_karman(params: Lane, state: Lane, a: Float4, b: Float4) -> None:
    """Step von Karman's turbulence instead, and write its gusts as the state of the other."""
    noise, filters = (a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]), _load_karman_params(params, layout.VON_KARMAN)
    turbulence = karman_step(filters, _load_karman(state, layout.X_VON_KARMAN), noise)
    _store_karman(state, layout.X_VON_KARMAN, turbulence)
    _store_dryden(state, X_DRYDEN, show_gust(filters, turbulence))


observe, advance = compiled(observe_kernel), compiled(advance_kernel)
"""The same for calls from Python."""


def estimate_q_NB(state: Array) -> Any:
    """Return the on-board strapdown attitude (4,) of a state."""
    return state[X_STABILIZER : X_STABILIZER + 4]
