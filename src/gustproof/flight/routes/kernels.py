"""The direct route for `LANES` flights at once: the kernels of `flight.routes.direct`, each in a loop over flights.

The compiler vectorises a loop over a constant number of flights if its body has no loop and no branch, and all arrays
are flat. So each stage of a sample is a loop of its own; anything common to all flights stands outside.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.numerics import random
from firmware_model.numerics.compiled import compiled, expect_simd, kernel
from firmware_model.numerics.elementary import BLOCK, arctan2, inverse_normals, uniforms
from firmware_model.numerics.soa import Lane, aligned_zeros, mover, summer
from firmware_model.physics.disturbances import Disturbance, disturbance
from firmware_model.physics.sensors import float32
from firmware_model.recording import journal
from firmware_model.recording.journal import WIDTH
from firmware_model.sim import inner_loop, layout, step
from firmware_model.sim.inner_loop import SETPOINT_WIDTH, is_within_limits, limit_command, track_setpoint
from firmware_model.sim.state import Array
from gustproof.flight.controllers.library import Library, call_step
from gustproof.flight.scoring.metrics import PEAK_SHARE, TALLY_SIZE, angle_share, begin_tally, end_tally
from gustproof.flight.scoring.requirements import read_kernel
from gustproof.law.form import Law
from gustproof.law.references import RADIANS
from gustproof.law.step import (
    EXTRA_SIZE,
    FORCE,
    MEASURED_SIZE,
    RATE_EXCESS,
    RATES,
    SATURATION,
    SCHEDULE_SIZE,
    STEEP,
    SparseLaw,
    euler_rates,
    rate_excess,
    share_of_limit,
    tilt,
    turn_steep,
    vector_size,
)

LANES = 32
"""Flights in a batch: four registers of eight numbers hide each other's latency."""
_sum, _move, _move_three = summer(LANES), mover(LANES), mover(3 * LANES)
_STEP_SIZE = MEASURED_SIZE + 3
_GUST, _GYRO, _ACCELEROMETER, _DRAWN = 0, 8, 11, 14
"""Rows of random numbers. Those of a block are drawn by fours, and nobody uses the last of gyro and accelerometer."""


class BatchSetup(NamedTuple):
    """Data common to all flights of a scenario and a law."""

    sample_us: int
    """[us] sample time."""
    dt: float
    """[s] sample time."""
    waves: Array
    """(n, WAVE) see `physics.disturbances`, units there."""
    replay: Array
    """(samples or 0, 3 * TARGETS) see `physics.disturbances`, units there."""
    reference: Array
    """(samples, 3) [rad] attitude to hold: phi, theta, psi."""
    rules: Array
    """(n, 8) rules, see `flight.scoring.requirements`."""
    reads_share: bool
    """True if one of these reads the used share of the envelope from later than the first sample on."""
    law: SparseLaw
    """Terms of the law, unused by a controller in C."""
    step: int
    """Address of the step of a controller in C; 0 for a law."""
    kind: float
    """[-] kind of its set-points, see `sim.inner_loop`."""
    bound: float
    """[-] largest magnitude of its command on the wire."""


class Batch(NamedTuple):
    """Data of `LANES` flights side by side; a flat array holds one number of all of them, then the next number."""

    params: Array
    """(constants * LANES,) see `sim.layout`, units there."""
    state: Array
    """(states * LANES,) see `sim.layout`, units there."""
    changes: Array
    """(n, 3) scripted changes: sample, offset among all constants, value."""
    seeds: NDArray[np.int64]
    """(n, LANES) seeds of gusts and noise, see `mixed_normals`."""
    mix: Array
    """(n, 2, LANES) [-] factor on the noise of the seeds before each, and on its own."""
    scale: Array
    """(3 * LANES,) [N*m or rad/s] B, command that is 1.0 on the wire."""
    thrust: Array
    """(LANES,) [-] thrust beside rates; NaN beside torques."""
    torque_limit: Array
    """(3 * LANES,) [N*m] B."""
    z: Array
    """(vector_size, LANES) vectors that the law sums, see `law.step`."""
    work: Array
    """(n, LANES) next states of the law."""
    commands: Array
    """(3, LANES) [N*m or rad/s] B."""
    each: Array
    """(LANES, n + 12) states, inputs and command of a controller in C that steps one flight in a call."""
    ring: Array
    """(delay + 1, SETPOINT_WIDTH * LANES) latest set-points, see `sim.inner_loop`."""
    kinds: Array
    """(delay + 1,) their kinds."""
    record: Array
    """(WIDTH * LANES,) records of the sample, see `recording.journal`."""
    noise: Array
    """(n, 15 * LANES) standard normal random numbers of each seed, in the same order; their sum in the first row."""
    outer: Array
    """(11 or 14 * LANES + BLOCK,) work space of `inverse_normals`."""
    places: NDArray[np.int32]
    """(11 or 14 * LANES,) work space of `inverse_normals`."""
    stages: Array
    """(WORK_ROWS * LANES,) work space of the stages of a step in free flight, see `sim.step`."""
    tallies: Array
    """(TALLY_SIZE, LANES) see `flight.scoring.metrics`."""
    readings: Array
    """(rules, READING_SIZE, LANES) see `flight.scoring.requirements`."""


def _zeros(count: int) -> Array:
    return aligned_zeros(count * LANES).reshape(count, LANES)


def allocate_batch(law: Law | Library, terms: SparseLaw, delay: int, seeds: int) -> dict[str, Any]:
    """Return the initial fields of a `Batch` for a law, its terms, whose commands act `delay` samples late."""
    drawn = (_DRAWN if law.uses_accelerometer else _ACCELEROMETER) * LANES
    z, each = _zeros(vector_size(terms, law.order)), np.zeros((LANES, law.order + _STEP_SIZE))
    if isinstance(law, Library):
        z[: law.order], each[:, : law.order] = law.initial_state()[:, None], law.initial_state()
    ring = _zeros((delay + 1) * SETPOINT_WIDTH).reshape(delay + 1, SETPOINT_WIDTH * LANES)
    ring[:, inner_loop.THRUST * LANES :] = np.nan
    return {
        "z": z,
        "work": _zeros(law.order),
        "commands": _zeros(3),
        "each": each,
        "ring": ring,
        "kinds": np.zeros(delay + 1),
        "record": aligned_zeros(WIDTH * LANES),
        "noise": aligned_zeros(seeds * (_DRAWN + 1) * LANES).reshape(seeds, (_DRAWN + 1) * LANES),
        "outer": aligned_zeros(drawn + BLOCK),
        "places": np.zeros(drawn, dtype=np.int32),
        "stages": aligned_zeros(step.WORK_ROWS * LANES),
        "tallies": _zeros(TALLY_SIZE),
    }


@compiled
def fly_on_stand(shared: BatchSetup, batch: Batch) -> None:
    """Fly a batch on the test stand, see `_fly`."""
    expect_simd()
    _fly(False, shared, batch)


@compiled
def fly_free(shared: BatchSetup, batch: Batch) -> None:
    """Fly a batch in free flight, see `_fly`."""
    expect_simd()
    _fly(True, shared, batch)


@kernel
def _fly(free: bool, shared: BatchSetup, batch: Batch) -> None:
    """Fly a batch and judge it, as `fly_direct` and the scoring of its records do; only the latest record is kept."""
    params, state, record, noise, ring = batch.params, batch.state, batch.record, batch.noise[0], batch.ring
    tallies, torque_limit = batch.tallies.reshape(TALLY_SIZE * LANES), batch.torque_limit
    limits, late = torque_limit.reshape(3, LANES), batch.kinds.size
    steps, dt = int(params[layout.STEPS * LANES]), shared.sample_us * 1e-6
    rotors = int(params[layout.ROTOR_COUNT * LANES])
    for k in range(shared.reference.shape[0]):
        reference, now, acts = shared.reference[k], k % late, (k + 1) % late
        for j in range(batch.seeds.shape[0]):
            _draw(batch, j, k)
            inverse_normals(batch.noise[j][: batch.places.size], batch.outer, batch.places)
        _mix_noise(batch, batch.places.size)
        _observe(free, shared, batch, k)
        _write_measurements(record, reference, batch.z, batch.work.shape[0])
        _hold_place(free, params, state, batch.z[batch.work.shape[0] + 3 :])
        if shared.step == 0:
            _step_law(shared.law, batch.z, batch.commands, batch.work)
        else:
            _step_each(shared.step, batch)
        _write_setpoint(batch, shared.bound, ring[now])
        batch.kinds[now] = shared.kind
        _command(free, params, state, batch.kinds[acts], ring[acts], record)
        if free and rotors != 4:
            _limit_commands(rotors, params, record)
        elif free:
            _limit_commands(4, params, record)
        if free:
            _fly_freely(params, state, dt / steps, steps, record, batch.stages)
        else:
            for _ in range(steps):
                for w in range(LANES):
                    step.step_held(Lane(params, LANES, w), Lane(state, LANES, w), dt / steps, Lane(record, LANES, w))
        _step_turbulence(params, state, noise)
        _tally(shared, tallies, torque_limit, record, k, batch.stages)
        read_kernel(shared.rules, batch.readings, k, reference, batch.tallies, record, limits)


@kernel
def _draw(batch: Batch, j: int, sample: int) -> None:
    """Draw the uniform numbers of the seeds `j` at a sample; those of the accelerometer if the law reads it."""
    seeds, u = batch.seeds[j], batch.noise[j]
    _draw_block(seeds, random.GUST_STREAM, sample, 0, u, _GUST)
    _draw_block(seeds, random.GUST_STREAM, sample, 1, u, _GUST + 4)
    _draw_block(seeds, random.GYRO_STREAM, sample, 0, u, _GYRO)
    if _feels_force(batch):
        _draw_block(seeds, random.ACCELEROMETER_STREAM, sample, 0, u, _ACCELEROMETER)


@kernel
def _mix_noise(batch: Batch, drawn: int) -> None:
    """Do the sums of `mixed_normals`."""
    for j in range(1, batch.seeds.shape[0]):
        for at in range(0, drawn, LANES):
            for w in range(LANES):
                kept, added = batch.mix[j, 0, w] * batch.noise[0, at + w], batch.mix[j, 1, w] * batch.noise[j, at + w]
                batch.noise[0, at + w] = kept + added


@kernel
def _draw_block(seeds: NDArray[np.int64], stream: int, sample: int, block: int, u: Array, row: int) -> None:
    for w in range(LANES):
        a, b, c, d = uniforms(seeds[w], stream, sample, block)
        at = row * LANES + w
        u[at], u[at + LANES], u[at + 2 * LANES], u[at + 3 * LANES] = a, b, c, d


@kernel
def _noise_block(noise: Array, row: int, w: int) -> tuple[float, float, float, float]:
    at = row * LANES + w
    return noise[at], noise[at + LANES], noise[at + 2 * LANES], noise[at + 3 * LANES]


@kernel
def _observe(free: bool, shared: BatchSetup, batch: Batch, sample: int) -> None:
    """Do the work of `sim.step.observe_kernel`."""
    params, state, noise, record = batch.params, batch.state, batch.noise[0], batch.record
    step.apply_changes(params, Lane(state, LANES, 0), batch.changes, sample)
    time_us = sample * shared.sample_us
    scripted = disturbance(shared.waves, shared.replay, sample, time_us * 1e-6)
    if _has_battery(params):
        for w in range(LANES):
            step.drain_battery(Lane(params, LANES, w), Lane(state, LANES, w))
    if shared.waves.shape[0] + shared.replay.shape[0] > 0:
        for w in range(LANES):
            _measure(free, True, scripted, params, state, noise, time_us, record, w)
    else:
        for w in range(LANES):
            _measure(free, False, scripted, params, state, noise, time_us, record, w)
    if _feels_force(batch):
        if _is_unusual(free, params, state):
            for w in range(LANES):
                _measure_force(free, True, params, state, noise, record, w)
        else:
            for w in range(LANES):
                _measure_force(free, False, params, state, noise, record, w)
    elif free and shared.kind == inner_loop.RATES:  # its integrals stay empty on the ground
        _measure_load(params, state)


@kernel
def _measure_load(params: Array, state: Array) -> None:
    """Write the loads on the ground; mostly no flight is near it, and the last one to leave has left 0."""
    near = False
    for w in range(LANES):
        near |= step.may_touch_ground(Lane(params, LANES, w), Lane(state, LANES, w), 0.0)
        near |= state[layout.X_LOAD * LANES + w] != 0.0
    if near:
        for w in range(LANES):
            step.measure_load(Lane(params, LANES, w), Lane(state, LANES, w))


@kernel
def _measure(
    free: bool,
    acts: bool,
    scripted: Disturbance,
    params: Array,
    state: Array,
    noise: Array,
    time_us: int,
    record: Array,
    w: int,
) -> None:
    p, x, row = Lane(params, LANES, w), Lane(state, LANES, w), Lane(record, LANES, w)
    step.measure(p, x, free, False, acts, scripted, _noise_block(noise, _GYRO, w), time_us, row)


@kernel
def _feels_force(batch: Batch) -> bool:
    """Return whether the law reads the accelerometer."""
    return batch.places.size > _ACCELEROMETER * LANES


@kernel
def _has_battery(params: Array) -> bool:
    found = False
    for w in range(LANES):
        found |= params[layout.BATTERY * LANES + w] != 0.0
    return found


@kernel
def _measure_force(free: bool, unusual: bool, params: Array, state: Array, noise: Array, record: Array,
                   w: int) -> None:  # fmt: skip
    p, x, row = Lane(params, LANES, w), Lane(state, LANES, w), Lane(record, LANES, w)
    step.measure_force(p, x, free, unusual, _noise_block(noise, _ACCELEROMETER, w), row)


@kernel
def _is_unusual(free: bool, params: Array, state: Array) -> bool:
    """Return whether any flight touches the ground or lacks a rotor; mostly none, at less cost."""
    found = False
    if free:
        for w in range(LANES):
            found |= step.is_unusual(Lane(params, LANES, w), Lane(state, LANES, w))
    return found


@kernel
def _write_measurements(record: Array, reference: Array, z: Array, n: int) -> None:
    """Write the inputs of a law: rates, reference, specific force."""
    _move_three(record, journal.GYRO_B * LANES, z, n * LANES)
    _move_three(record, journal.FORCE_B * LANES, z, (n + FORCE) * LANES)
    for i in range(3):
        for w in range(LANES):
            z[n + 3 + i, w] = reference[i]


@kernel
def _hold_place(free: bool, params: Array, state: Array, angles: Array) -> None:
    """Step the position loops, if any flies, and write the roll and pitch that they ask for."""
    if free and params[layout.HOLDS_PLACE * LANES] != 0.0:
        for w in range(LANES):
            inner_loop.seek_place(Lane(params, LANES, w), Lane(state, LANES, w))
        for i in range(2):
            for w in range(LANES):
                angles[i, w] = RADIANS * state[(layout.X_TILT_DEG + i) * LANES + w]


@kernel
def _step_law(law: SparseLaw, z: Array, commands: Array, work: Array) -> None:
    """Do the work of `law_kernel`, each flight's sums in the same order."""
    n, k = work.shape[0], law.schedule.shape[0]
    if law.is_gravity_aided:
        for w in range(LANES):
            force = (z[n + FORCE, w], z[n + FORCE + 1, w], z[n + FORCE + 2, w])
            roll, pitch = tilt(force, (z[0, w], z[1, w]))
            z[n + FORCE, w], z[n + FORCE + 1, w] = roll, pitch
    begin = _schedule(law, z, n)
    if law.ends.size > k + 3 + n:
        begin = _limit_rates(law, z, n, k)
        k += 3
    for i in range(3):
        _sum(law.terms, begin, law.ends[k + i], z, commands[i])
        limit = law.limits[i]
        for w in range(LANES):
            within = min(max(commands[i, w], -limit), limit)
            z[n + SATURATION + i, w] = within - commands[i, w]
            commands[i, w] = within
        begin = law.ends[k + i]
    if law.is_scheduled:
        for w in range(LANES):
            rates = euler_rates((z[0, w], z[1, w], z[2, w]), (z[3, w], z[4, w], z[5, w]))
            z[n + RATES, w], z[n + RATES + 1, w], z[n + RATES + 2, w] = rates
    for i in range(n):
        _sum(law.terms, begin, law.ends[k + 3 + i], z, work[i])
        begin = law.ends[k + 3 + i]
    if law.is_scheduled:
        _turn_steep(z, n, law.dt, work)
    for i in range(n):
        _move(work, i * LANES, z, i * LANES)


@kernel
def _turn_steep(z: Array, n: int, dt: float, work: Array) -> None:
    """Put right the next attitude of flights that pitch steeply, mostly none."""
    steep = False
    for w in range(LANES):
        steep |= abs(z[1, w]) > STEEP
    if steep:
        for w in range(LANES):
            E, omega = (z[0, w], z[1, w], z[2, w]), (z[3, w], z[4, w], z[5, w])
            rates = z[n + RATES, w], z[n + RATES + 1, w], z[n + RATES + 2, w]
            after = work[0, w], work[1, w], work[2, w]
            work[0, w], work[1, w], work[2, w] = turn_steep(E, omega, rates, dt, after)


@kernel
def _step_each(step: int, batch: Batch) -> None:
    """Call a controller in C once for each flight."""
    z, each, commands, n = batch.z, batch.each, batch.commands, batch.work.shape[0]
    end = n + MEASURED_SIZE
    for w in range(LANES):
        for i in range(n, end):
            each[w, i] = z[i, w]
        call_step(step, each[w], each[w, n:], each[w, end:])
        for i in range(3):
            commands[i, w] = each[w, end + i]


@kernel
def _schedule(law: SparseLaw, z: Array, n: int) -> int:
    """Write the outputs of a schedule, as `law.step` does; return the end of the terms of its inputs."""
    rows, begin = law.schedule, 0
    k, at = rows.shape[0], n + EXTRA_SIZE
    m = at + k
    for i in range(k):
        source, limit, factor = int(rows[i, 0]), rows[i, 1], rows[i, 2]
        _sum(law.terms, begin, law.ends[i], z, z[at + i])
        begin = law.ends[i]
        # the last row of the work space is filled last: until then it holds delta
        delta = z[m + k * k - 1]
        for w in range(LANES):
            delta[w] = share_of_limit(z[source, w], limit, factor, source < n)
            z[at + i, w] = delta[w] * z[at + i, w]
        for j in range(k):
            one, of_delta = 1.0 if i == j else 0.0, rows[i, SCHEDULE_SIZE + j]
            for w in range(LANES):
                z[m + i * k + j, w] = one - delta[w] * of_delta
    _eliminate(z[m:], z[at:], k)
    return int(begin)


@kernel
def _eliminate(m: Array, x: Array, k: int) -> None:
    """Write the solution of (k, k) equations `m` in place of their right sides `x`."""
    for c in range(k):
        for i in range(c + 1, k):
            share = m[i * k + c]  # below the diagonal nothing is read again
            for w in range(LANES):
                share[w] = share[w] / m[c * k + c, w]
            for j in range(c + 1, k):
                for w in range(LANES):
                    m[i * k + j, w] -= share[w] * m[c * k + j, w]
            for w in range(LANES):
                x[i, w] -= share[w] * x[c, w]
    for i in range(k - 1, -1, -1):
        for j in range(i + 1, k):
            for w in range(LANES):
                x[i, w] -= m[i * k + j, w] * x[j, w]
        for w in range(LANES):
            x[i, w] /= m[i * k + i, w]


@kernel
def _limit_rates(law: SparseLaw, z: Array, n: int, first: int) -> int:
    """Write the excess of the rates commanded from attitude, mostly 0; their sums begin with the `first`."""
    begin, limited = 0 if first == 0 else law.ends[first - 1], False
    limits, angles, s = law.rate_limits, law.attitude_limits, z[n + RATE_EXCESS : n + RATE_EXCESS + 3]
    for i in range(3):
        _sum(law.terms, begin, law.ends[first + i], z, s[i])
        begin = law.ends[first + i]
    for w in range(LANES):
        rates = (abs(s[0, w]) <= limits[0]) & (abs(s[1, w]) <= limits[1]) & (abs(s[2, w]) <= limits[2])
        level = (abs(z[0, w]) <= angles[0]) & (abs(z[1, w]) <= angles[1]) & (abs(z[2, w]) <= angles[2])
        limited |= not (rates & level)
    if limited:
        for w in range(LANES):
            excess = rate_excess((s[0, w], s[1, w], s[2, w]), (z[0, w], z[1, w]), limits, angles)
            s[0, w], s[1, w], s[2, w] = excess
    else:
        s[:] = 0.0
    return int(begin)


@kernel
def _write_setpoint(batch: Batch, bound: float, setpoint: Array) -> None:
    for i in range(3):
        for w in range(LANES):
            at = i * LANES + w
            setpoint[LANES + at] = min(max(float32(batch.commands[i, w] / batch.scale[at]), -bound), bound)
    for w in range(LANES):
        setpoint[inner_loop.THRUST * LANES + w] = batch.thrust[w]


@kernel
def _command(free: bool, params: Array, state: Array, kind: float, setpoint: Array, record: Array) -> None:
    """Write the actuator commands, in a loop for each kind of set-point, as kinds branch."""
    if kind == inner_loop.TORQUE:
        for w in range(LANES):
            _command_lane(free, params, state, inner_loop.TORQUE, setpoint, record, w)
    elif kind == inner_loop.RATES:
        for w in range(LANES):
            _command_lane(free, params, state, inner_loop.RATES, setpoint, record, w)
    else:
        for w in range(LANES):
            _command_lane(free, params, state, inner_loop.TRIM, setpoint, record, w)


@kernel
def _command_lane(free: bool, params: Array, state: Array, kind: float, setpoint: Array, record: Array, w: int) -> None:
    p, x = Lane(params, LANES, w), Lane(state, LANES, w)
    track_setpoint(p, x, free, kind, Lane(setpoint, LANES, w), Lane(record, LANES, w))


@kernel
def _limit_commands(rotors: int, params: Array, record: Array) -> None:
    """Limit the actuator commands if any is over the limits; mostly none is, which saves nine divisions a flight."""
    within = True
    for w in range(LANES):
        within &= is_within_limits(Lane(params, LANES, w), rotors, Lane(record, LANES, w))
    if not within:
        for w in range(LANES):
            limit_command(Lane(params, LANES, w), rotors, Lane(record, LANES, w))


@kernel
def _fly_freely(params: Array, state: Array, dt: float, steps: int, record: Array, work: Array) -> None:
    """Do the work of `aerodynamics.fly`; mostly no flight is near the ground or lacks a rotor, which costs less."""
    near, failed, h = False, False, steps * dt
    for w in range(LANES):
        near |= step.may_touch_ground(Lane(params, LANES, w), Lane(state, LANES, w), h)
        failed |= step.lacks_rotor(Lane(params, LANES, w))
    if near:
        _fly_near_ground(params, state, dt, steps, record, work)
    if failed:
        _begin_sample(True, params, state, h, record, work)
    else:
        _begin_sample(False, params, state, h, record, work)
    for _ in range(steps):
        _step_stage(0, step.END, 0.5 * dt, params, record, work)
        if failed:
            _step_actuators(True, params, state, record, work)
        else:
            _step_actuators(False, params, state, record, work)
        _step_stage(1, step.MIDDLE, 0.5 * dt, params, record, work)
        _step_stage(2, step.MIDDLE, dt, params, record, work)
        _step_stage(3, step.END, 0.5 * dt, params, record, work)
    for w in range(LANES):
        step.end_sample(Lane(state, LANES, w), h, Lane(record, LANES, w), Lane(work, LANES, w))
    if near:
        for w in range(LANES):
            step.end_near_ground(Lane(state, LANES, w), Lane(work, LANES, w))


@kernel
def _fly_near_ground(params: Array, state: Array, dt: float, steps: int, record: Array, work: Array) -> None:
    for w in range(LANES):
        step.begin_near_ground(Lane(params, LANES, w), Lane(state, LANES, w), steps * dt, Lane(work, LANES, w))
    for _ in range(steps):
        for w in range(LANES):
            p, x, row = Lane(params, LANES, w), Lane(state, LANES, w), Lane(record, LANES, w)
            step.step_near_ground(p, x, dt, row, Lane(work, LANES, w))


@kernel
def _begin_sample(failed: bool, params: Array, state: Array, h: float, record: Array, work: Array) -> None:
    for w in range(LANES):
        p, x, row = Lane(params, LANES, w), Lane(state, LANES, w), Lane(record, LANES, w)
        step.begin_sample(p, x, failed, h, row, Lane(work, LANES, w))


@kernel
def _step_actuators(failed: bool, params: Array, state: Array, record: Array, work: Array) -> None:
    for w in range(LANES):
        p, x, row = Lane(params, LANES, w), Lane(state, LANES, w), Lane(record, LANES, w)
        step.step_actuators(p, x, failed, row, Lane(work, LANES, w))


@kernel
def _step_stage(stage: int, acting: int, h: float, params: Array, record: Array, work: Array) -> None:
    for w in range(LANES):
        p, row = Lane(params, LANES, w), Lane(record, LANES, w)
        step.step_stage(stage, acting, h, p, row, Lane(work, LANES, w))


@kernel
def _tally(shared: BatchSetup, tallies: Array, limits: Array, record: Array, sample: int, work: Array) -> None:
    """Do the work of `tally_kernel`: each arc tangent and sine is a long chain, so they have loops of their own.

    No share of an angle is over the angle. If none is over the largest share so far, 0 stands for all of them.
    """
    for w in range(LANES):
        begin_tally(Lane(record, LANES, w), Lane(work, LANES, w))
    for i in range(3 * LANES):
        work[i] = arctan2(work[i], work[i + 3 * LANES])
    counts = shared.reads_share
    for w in range(LANES):
        largest = tallies[PEAK_SHARE * LANES + w]
        counts |= not ((abs(work[w]) <= largest) & (abs(work[w + LANES]) <= largest))
    for i in range(2 * LANES):
        work[i + 3 * LANES] = 0.0
    if counts:
        for i in range(2 * LANES):
            work[i + 3 * LANES] = angle_share(work[i])
    for w in range(LANES):
        tally, limit = Lane(tallies, LANES, w), Lane(limits, LANES, w)
        end_tally(tally, sample, limit, Lane(record, LANES, w), shared.dt, Lane(work, LANES, w))


@kernel
def _step_turbulence(params: Array, state: Array, noise: Array) -> None:
    if params[layout.VON_KARMAN * LANES] != 0.0:
        for w in range(LANES):
            a, b = _noise_block(noise, _GUST, w), _noise_block(noise, _GUST + 4, w)
            step.step_von_karman(Lane(params, LANES, w), Lane(state, LANES, w), a, b)
    else:
        for w in range(LANES):
            a, b = _noise_block(noise, _GUST, w), _noise_block(noise, _GUST + 4, w)
            step.step_turbulence(Lane(params, LANES, w), Lane(state, LANES, w), a, b)
