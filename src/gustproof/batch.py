"""The direct route for `LANES` flights at once: the kernels of `closed_loop`, each in a loop over flights side by side.

The compiler makes SIMD of a loop over a constant number of flights, if nothing inside it loops or branches and all
arrays are flat. So each stage of a sample is a loop of its own, and what is the same for all flights stands outside.
"""

import numpy as np

from firmware_model import commands, journal, plant, world
from firmware_model.commands import SETPOINT, command
from firmware_model.compiled import compiled, kernel
from firmware_model.disturbances import disturbance
from firmware_model.elementary import normals
from firmware_model.journal import WIDTH
from firmware_model.rows import Column
from firmware_model.sensors import float32
from firmware_model.world import Array
from gustproof.law import euler_rates
from gustproof.metrics import tally_kernel
from gustproof.requirements import read_kernel

LANES = 32
"""Flights in a batch: four registers of eight numbers, which hide each other's latency."""
_UNUSED = (0.0, 0.0, 0.0, 0.0)


@compiled
def fly_held(params: Array, state: Array, waves: Array, replay: Array, changes: Array, seeds: Array, sample_us: int,
             dt: float, A: Array, B: Array, C: Array, D: Array, G: Array, H: Array, limits: Array, reference: Array,
             scale: Array, kind: float, bound: float, thrust: Array, delay: int, torque_limit: Array, rules: Array,
             tallies: Array, readings: Array) -> None:  # fmt: skip
    """Fly a batch on the test stand, see `_fly`."""
    _fly(False, params, state, waves, replay, changes, seeds, sample_us, dt, A, B, C, D, G, H, limits, reference,
         scale, kind, bound, thrust, delay, torque_limit, rules, tallies, readings)  # fmt: skip


@kernel
def _fly(free: bool, params: Array, state: Array, waves: Array, replay: Array, changes: Array, seeds: Array,
         sample_us: int, dt: float, A: Array, B: Array, C: Array, D: Array, G: Array, H: Array, limits: Array,
         reference: Array, scale: Array, kind: float, bound: float, thrust: Array, delay: int, torque_limit: Array,
         rules: Array, tallies: Array, readings: Array) -> None:  # fmt: skip
    """Fly a batch and judge it: `closed_loop.fly_direct` and what measures its records, of which one is kept a flight.

    Arrays of a flight's numbers are flat, rows of `LANES`; waves, replay, law and reference are those of all flights.
    """
    n = A.shape[0]
    x, y, asked, work = np.zeros(n * LANES), np.zeros(9 * LANES), np.zeros(3 * LANES), np.zeros((n + 9) * LANES)
    record, noise = np.zeros(WIDTH * LANES), np.zeros(8 * LANES)
    ring, kinds = np.zeros((delay + 1, SETPOINT * LANES)), np.zeros(delay + 1)
    ring[:, commands.THRUST * LANES :] = np.nan
    degrees, steps = np.degrees(reference), int(params[world.STEPS * LANES])
    for k in range(reference.shape[0]):
        _observe(free, D.shape[1] > 6, params, state, waves, replay, changes, seeds, k, sample_us, noise, record)
        _measured(record, reference[k], y)
        _law(A, B, C, D, G, H, limits, x, y, asked, work)
        _ask(asked, scale, bound, thrust, ring[k % (delay + 1)])
        kinds[k % (delay + 1)] = kind
        acts = (k + 1) % (delay + 1)
        _command(free, params, state, kinds[acts], ring[acts], record)
        for _ in range(steps):
            _move(free, params, state, sample_us * 1e-6 / steps, record)
        _breathe(params, state, seeds, k, noise)
        for w in range(LANES):
            tally, limit = Column(tallies, LANES, w), Column(torque_limit, LANES, w)
            tally_kernel(tally, k == 0, limit, Column(record, LANES, w), dt)
        read_kernel(rules, readings, k, degrees[k], tallies, record, torque_limit, LANES)


@kernel
def _observe(free: bool, feels: bool, params: Array, state: Array, waves: Array, replay: Array, changes: Array,
             seeds: Array, sample: int, sample_us: int, noise: Array, record: Array) -> None:  # fmt: skip
    """Do what `plant.observe_kernel` does; a law that does not read the accelerometer is not told its noise."""
    plant.change(params, Column(state, LANES, 0), changes, sample)
    time_us = sample * sample_us
    scripted = disturbance(waves, replay, sample, time_us * 1e-6)
    _draw(seeds, world.GYRO_STREAM, sample, 0, noise, 0)
    if feels:
        _draw(seeds, world.ACCELEROMETER_STREAM, sample, 0, noise, 4)
    for w in range(LANES):
        p, x, row = Column(params, LANES, w), Column(state, LANES, w), Column(record, LANES, w)
        plant.sense(p, x, free, scripted, _four(noise, 0, w), _four(noise, 4, w), time_us, row)


@kernel
def _draw(seeds: Array, stream: int, sample: int, block: int, noise: Array, row: int) -> None:
    for w in range(LANES):
        a, b, c, d = normals(seeds[w], stream, sample, block)
        at = row * LANES + w
        noise[at], noise[at + LANES], noise[at + 2 * LANES], noise[at + 3 * LANES] = a, b, c, d


@kernel
def _four(noise: Array, row: int, w: int) -> tuple[float, float, float, float]:
    at = row * LANES + w
    return noise[at], noise[at + LANES], noise[at + 2 * LANES], noise[at + 3 * LANES]


@kernel
def _measured(record: Array, reference: Array, y: Array) -> None:
    """Write what a law reads: rates, reference, specific force."""
    for i in range(3):
        for w in range(LANES):
            y[i * LANES + w] = record[(journal.GYRO_B + i) * LANES + w]
            y[(3 + i) * LANES + w] = reference[i]
            y[(6 + i) * LANES + w] = record[(journal.FORCE_B + i) * LANES + w]


@kernel
def _law(A: Array, B: Array, C: Array, D: Array, G: Array, H: Array, limits: Array, x: Array, y: Array, asked: Array,
         work: Array) -> None:  # fmt: skip
    """Do what `law_kernel` does; each flight's sums in the same order."""
    n = A.shape[0]
    scheduled = False
    for i in range(n):
        for j in range(3):
            scheduled = scheduled or G[i, j] != 0.0
    total, cut, rates = (
        work[n * LANES : (n + 3) * LANES],
        work[(n + 3) * LANES : (n + 6) * LANES],
        work[(n + 6) * LANES :],
    )
    for i in range(3):
        u = total[i * LANES : (i + 1) * LANES]
        _sum(C[i], x, D[i], y, u)
        for w in range(LANES):
            asked[i * LANES + w] = min(max(u[w], -limits[i]), limits[i])
            cut[i * LANES + w] = asked[i * LANES + w] - u[w]
    if scheduled:
        for w in range(LANES):
            E = (x[w], x[LANES + w], x[2 * LANES + w])
            omega = (x[3 * LANES + w], x[4 * LANES + w], x[5 * LANES + w])
            rates[w], rates[LANES + w], rates[2 * LANES + w] = euler_rates(E, omega)
    for i in range(n):
        s, g, h = work[i * LANES : (i + 1) * LANES], G[i], H[i]
        _sum(A[i], x, B[i], y, s)
        for w in range(LANES):
            s[w] += g[0] * rates[w] + g[1] * rates[LANES + w] + g[2] * rates[2 * LANES + w]
            s[w] += h[0] * cut[w] + h[1] * cut[LANES + w] + h[2] * cut[2 * LANES + w]
    for i in range(n * LANES):
        x[i] = work[i]


@kernel
def _sum(a: Array, x: Array, b: Array, y: Array, total: Array) -> None:
    """Write the sums of `a x + b y`, in this order."""
    for w in range(LANES):
        total[w] = 0.0
    _add(a, x, total)
    _add(b, y, total)


@kernel
def _add(a: Array, x: Array, total: Array) -> None:
    """Add `a x`, one product after the other; three at a time, as to load and store the sum takes most of the time."""
    n = a.shape[0]
    for j in range(0, n - n % 3, 3):
        u, v, z = x[j * LANES :], x[(j + 1) * LANES :], x[(j + 2) * LANES :]
        for w in range(LANES):
            total[w] = total[w] + a[j] * u[w] + a[j + 1] * v[w] + a[j + 2] * z[w]
    for j in range(n - n % 3, n):
        for w in range(LANES):
            total[w] += a[j] * x[j * LANES + w]


@kernel
def _ask(asked: Array, scale: Array, bound: float, thrust: Array, setpoint: Array) -> None:
    for i in range(3):
        for w in range(LANES):
            at = i * LANES + w
            setpoint[LANES + at] = min(max(float32(asked[at] / scale[at]), -bound), bound)
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
    for w in range(LANES):
        plant.move(Column(params, LANES, w), Column(state, LANES, w), free, dt, Column(record, LANES, w))


@kernel
def _breathe(params: Array, state: Array, seeds: Array, sample: int, noise: Array) -> None:
    _draw(seeds, world.GUST_STREAM, sample, 0, noise, 0)
    _draw(seeds, world.GUST_STREAM, sample, 1, noise, 4)
    for w in range(LANES):
        plant.breathe(Column(params, LANES, w), Column(state, LANES, w), _four(noise, 0, w), _four(noise, 4, w))
