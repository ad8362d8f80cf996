"""The direct route for `LANES` flights at once: the kernels of `closed_loop`, each in a loop over flights side by side.

The compiler makes SIMD of a loop over a constant number of flights, if nothing inside it loops or branches and all
arrays are flat. So each stage of a sample is a loop of its own, and what is the same for all flights stands outside.
"""

import numpy as np

from firmware_model import commands, journal, plant, world
from firmware_model.commands import SETPOINT, command
from firmware_model.compiled import align_stack, compiled, kernel
from firmware_model.disturbances import Disturbance, disturbance
from firmware_model.elementary import BLOCK, inverse_normals, uniforms
from firmware_model.journal import WIDTH
from firmware_model.rows import Column, aligned
from firmware_model.sensors import float32
from firmware_model.world import Array
from gustproof.law_step import CUT, EXTRA, FOUR, RATES, Sums, euler_rates
from gustproof.metrics import TALLY, tally_kernel
from gustproof.requirements import read_kernel

LANES = 32
"""Flights in a batch: four registers of eight numbers, which hide each other's latency."""
_GYRO, _GUST, _ACCELEROMETER, _DRAWN = 0, 4, 12, 16  # rows of random numbers


@compiled
def fly_held(params: Array, state: Array, waves: Array, replay: Array, changes: Array, seeds: Array, sample_us: int,
             dt: float, law: Sums, feels: bool, reference: Array, scale: Array, kind: float, bound: float,
             thrust: Array, delay: int, torque_limit: Array, rules: Array, tallies: Array,
             readings: Array) -> None:  # fmt: skip
    """Fly a batch on the test stand, see `_fly`."""
    align_stack()
    _fly(False, params, state, waves, replay, changes, seeds, sample_us, dt, law, feels, reference, scale, kind, bound,
         thrust, delay, torque_limit, rules, tallies, readings)  # fmt: skip


@compiled
def fly_free(params: Array, state: Array, waves: Array, replay: Array, changes: Array, seeds: Array, sample_us: int,
             dt: float, law: Sums, feels: bool, reference: Array, scale: Array, kind: float, bound: float,
             thrust: Array, delay: int, torque_limit: Array, rules: Array, tallies: Array,
             readings: Array) -> None:  # fmt: skip
    """Fly a batch in free flight, see `_fly`."""
    align_stack()
    _fly(True, params, state, waves, replay, changes, seeds, sample_us, dt, law, feels, reference, scale, kind, bound,
         thrust, delay, torque_limit, rules, tallies, readings)  # fmt: skip


@kernel
def _fly(free: bool, params: Array, state: Array, waves: Array, replay: Array, changes: Array, seeds: Array,
         sample_us: int, dt: float, law: Sums, feels: bool, reference: Array, scale: Array, kind: float, bound: float,
         thrust: Array, delay: int, torque_limit: Array, rules: Array, tallies: Array,
         readings: Array) -> None:  # fmt: skip
    """Fly a batch and judge it: `closed_loop.fly_direct` and what measures its records, of which one is kept a flight.

    Arrays of a flight's numbers are flat, rows of `LANES`; waves, replay, law and reference are those of all flights.
    A law that does not read the accelerometer is not told its noise.
    """
    n = law.ends.size - 3
    z, work = _rows(n + EXTRA), _rows(n)
    asked, record = _rows(3), aligned(WIDTH * LANES)
    drawn = (_DRAWN if feels else _ACCELEROMETER) * LANES
    u, noise, outer = aligned(drawn), aligned(_DRAWN * LANES), aligned(drawn + BLOCK)
    places = np.zeros(drawn, dtype=np.int64)
    ring, kinds = _rows((delay + 1) * SETPOINT).reshape(delay + 1, SETPOINT * LANES), np.zeros(delay + 1)
    ring[:, commands.THRUST * LANES :] = np.nan
    in_rows, limit_rows = tallies.reshape(TALLY, LANES), torque_limit.reshape(3, LANES)
    degrees, steps = np.degrees(reference), int(params[world.STEPS * LANES])
    for k in range(reference.shape[0]):
        _draw(seeds, k, feels, u)
        inverse_normals(u, noise, outer, places)
        _observe(free, params, state, waves, replay, changes, k, sample_us, noise, record)
        _measured(record, reference[k], z, n)
        _law(law, z, asked, work)
        _ask(asked, scale, bound, thrust, ring[k % (delay + 1)])
        kinds[k % (delay + 1)] = kind
        acts = (k + 1) % (delay + 1)
        _command(free, params, state, kinds[acts], ring[acts], record)
        for _ in range(steps):
            _move(free, params, state, sample_us * 1e-6 / steps, record)
        _breathe(params, state, noise)
        for w in range(LANES):
            tally, limit = Column(tallies, LANES, w), Column(torque_limit, LANES, w)
            tally_kernel(tally, k == 0, limit, Column(record, LANES, w), dt)
        read_kernel(rules, readings, k, degrees[k], in_rows, record, limit_rows)


@kernel
def _rows(count: int) -> Array:
    return aligned(count * LANES).reshape(count, LANES)


@kernel
def _draw(seeds: Array, sample: int, feels: bool, u: Array) -> None:
    """Draw all uniform numbers of a sample."""
    _draw_block(seeds, world.GYRO_STREAM, sample, 0, u, _GYRO)
    _draw_block(seeds, world.GUST_STREAM, sample, 0, u, _GUST)
    _draw_block(seeds, world.GUST_STREAM, sample, 1, u, _GUST + 4)
    if feels:
        _draw_block(seeds, world.ACCELEROMETER_STREAM, sample, 0, u, _ACCELEROMETER)


@kernel
def _draw_block(seeds: Array, stream: int, sample: int, block: int, u: Array, row: int) -> None:
    for w in range(LANES):
        a, b, c, d = uniforms(seeds[w], stream, sample, block)
        at = row * LANES + w
        u[at], u[at + LANES], u[at + 2 * LANES], u[at + 3 * LANES] = a, b, c, d


@kernel
def _four(noise: Array, row: int, w: int) -> tuple[float, float, float, float]:
    at = row * LANES + w
    return noise[at], noise[at + LANES], noise[at + 2 * LANES], noise[at + 3 * LANES]


@kernel
def _observe(free: bool, params: Array, state: Array, waves: Array, replay: Array, changes: Array, sample: int,
             sample_us: int, noise: Array, record: Array) -> None:  # fmt: skip
    """Do what `plant.observe_kernel` does."""
    plant.change(params, Column(state, LANES, 0), changes, sample)
    time_us = sample * sample_us
    scripted = disturbance(waves, replay, sample, time_us * 1e-6)
    if _low(free, params, state, 0.0):
        for w in range(LANES):
            _sense(free, True, params, state, scripted, noise, time_us, record, w)
    else:
        for w in range(LANES):
            _sense(free, False, params, state, scripted, noise, time_us, record, w)


@kernel
def _sense(free: bool, low: bool, params: Array, state: Array, scripted: Disturbance, noise: Array, time_us: int,
           record: Array, w: int) -> None:  # fmt: skip
    p, x, row = Column(params, LANES, w), Column(state, LANES, w), Column(record, LANES, w)
    turning, felt = _four(noise, _GYRO, w), _four(noise, _ACCELEROMETER, w)
    plant.sense(p, x, free, low, False, scripted, turning, felt, time_us, row)


@kernel
def _low(free: bool, params: Array, state: Array, dt: float) -> bool:
    """Whether one of them may touch the ground within `dt` [s]; if not, nothing is asked about it: most of the time."""
    low = False
    if free:
        for w in range(LANES):
            low |= plant.nears_ground(Column(params, LANES, w), Column(state, LANES, w), dt)
    return low


@kernel
def _measured(record: Array, reference: Array, z: Array, n: int) -> None:
    """Write what a law reads: rates, reference, specific force."""
    for i in range(3):
        for w in range(LANES):
            z[n + i, w] = record[(journal.GYRO_B + i) * LANES + w]
            z[n + 3 + i, w] = reference[i]
            z[n + 6 + i, w] = record[(journal.FORCE_B + i) * LANES + w]


@kernel
def _law(law: Sums, z: Array, asked: Array, work: Array) -> None:
    """Do what `law_kernel` does; each flight's sums in the same order."""
    n, begin = law.ends.size - 3, 0
    for i in range(3):
        _sum(law.terms, begin, law.ends[i], z, asked, i)
        limit = law.limits[i]
        for w in range(LANES):
            within = min(max(asked[i, w], -limit), limit)
            z[n + CUT + i, w] = within - asked[i, w]
            asked[i, w] = within
        begin = law.ends[i]
    if law.scheduled:
        for w in range(LANES):
            rates = euler_rates((z[0, w], z[1, w], z[2, w]), (z[3, w], z[4, w], z[5, w]))
            z[n + RATES, w], z[n + RATES + 1, w], z[n + RATES + 2, w] = rates
    for i in range(n):
        _sum(law.terms, begin, law.ends[3 + i], z, work, i)
        begin = law.ends[3 + i]
    for i in range(n):
        for w in range(LANES):
            z[i, w] = work[i, w]


@kernel
def _sum(terms: Array, begin: int, end: int, z: Array, totals: Array, row: int) -> None:
    """Write the sum of some terms; four at a time, as to load and store the sum takes most of the time."""
    for t in range(begin, end, FOUR):
        a, b, c, d = terms[t, 1], terms[t + 1, 1], terms[t + 2, 1], terms[t + 3, 1]
        # Without a sign there is nothing to be counted from the end.
        i, j = np.uint64(terms[t, 0]), np.uint64(terms[t + 1, 0])
        k, m = np.uint64(terms[t + 2, 0]), np.uint64(terms[t + 3, 0])
        if t == begin:
            for w in range(LANES):
                totals[row, w] = 0.0 + a * z[i, w] + b * z[j, w] + c * z[k, w] + d * z[m, w]
        else:
            for w in range(LANES):
                totals[row, w] = totals[row, w] + a * z[i, w] + b * z[j, w] + c * z[k, w] + d * z[m, w]


@kernel
def _ask(asked: Array, scale: Array, bound: float, thrust: Array, setpoint: Array) -> None:
    for i in range(3):
        for w in range(LANES):
            at = i * LANES + w
            setpoint[LANES + at] = min(max(float32(asked[i, w] / scale[at]), -bound), bound)
    for w in range(LANES):
        setpoint[commands.THRUST * LANES + w] = thrust[w]


@kernel
def _command(free: bool, params: Array, state: Array, kind: float, setpoint: Array, record: Array) -> None:
    """Write what is asked of the actuators; a loop for each kind of set-point, as kinds branch."""
    if kind == commands.TORQUE:
        for w in range(LANES):
            _command_one(free, params, state, commands.TORQUE, setpoint, record, w)
    elif kind == commands.RATES:
        for w in range(LANES):
            _command_one(free, params, state, commands.RATES, setpoint, record, w)
    else:
        for w in range(LANES):
            _command_one(free, params, state, commands.TRIM, setpoint, record, w)


@kernel
def _command_one(free: bool, params: Array, state: Array, kind: float, setpoint: Array, record: Array,
                 w: int) -> None:  # fmt: skip
    p, x = Column(params, LANES, w), Column(state, LANES, w)
    command(p, x, free, kind, Column(setpoint, LANES, w), Column(record, LANES, w))


@kernel
def _move(free: bool, params: Array, state: Array, dt: float, record: Array) -> None:
    if _low(free, params, state, dt):
        for w in range(LANES):
            _move_one(free, True, params, state, dt, record, w)
    else:
        for w in range(LANES):
            _move_one(free, False, params, state, dt, record, w)


@kernel
def _move_one(free: bool, low: bool, params: Array, state: Array, dt: float, record: Array, w: int) -> None:
    plant.move(Column(params, LANES, w), Column(state, LANES, w), free, low, dt, Column(record, LANES, w))


@kernel
def _breathe(params: Array, state: Array, noise: Array) -> None:
    for w in range(LANES):
        plant.breathe(
            Column(params, LANES, w), Column(state, LANES, w), _four(noise, _GUST, w), _four(noise, _GUST + 4, w)
        )
