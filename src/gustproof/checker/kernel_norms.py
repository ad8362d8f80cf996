"""Upper bounds of the l1 norms of one axis's loop over all time, for every inertia and lag within their spreads.

Part of the check: doubles with bounds of their rounding. The state of an axis is `xi = (omega, torque, command, law's
states)`, at a sample. Gyro, law and actuators give `xi+ = Phi xi + b u`. For an input `|u_k| <= 1` of any signs, signal
i stays below `S_i(b) = sum_k |(Phi^k b)_i|`.

**Cells.** The spreads of `1 / inertia` and `1 / lag` are covered by cells. Phi is that of a cell's centre; the distance
from it acts as further inputs, see `estimate_box`.

**Tail.** With `S^N` the sum of the first N terms and `rho = max_j |Phi^N e_j|_1 < 1`, Phi is stable and

    S(b) <= S^N(b) + |Phi^N b|_1 / (1 - rho) * max_j S^N(e_j).

Each state is counted in a unit of its own: its sum after a unit rate.

**Rounding.** The doubles follow `Phi x + delta` with `|delta_j| <= defect_j`. Later samples amplify that by at most
`S^N(e_j)`, so a state is wrong by at most `sum_j S^N(e_j) defect_j`, a sum over N samples by N + 1 times that. S^N
contains this error itself; a factor of two covers it while `(N + 1) sum_j defect_j < 1/2`.

References
----------
M. A. Dahleh, I. J. Diaz-Bobillo, Control of Uncertain Systems: A Linear Programming Approach, 1995 (l1 norms).
"""

from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gustproof.checker.rational import exponential
from gustproof.checker.system import LoopSystem, Refusal

Array = NDArray[np.float64]
OMEGA, TORQUE, COMMAND, X0, X1 = range(5)
"""Positions of an axis's states; the law's states from `X0` on are attitude, rate, and the rest."""
SLEW, GAP = -3, -2
"""Positions of two more signals: the rate's change over a sample, and demand minus torque; the demand is the last."""
LONGEST = 1 << 16
"""Largest number of simulated samples."""
MOST_CELLS = 64
"""Largest number of cells of a spread."""
_MOST_WORK = 1 << 22
"""Largest number of samples times cells: a minute."""
UP = 1.0 + 2.0**-40
"""[-] covers the rounding of a sum of at most 2^10 products of numbers that are not negative, some times over."""
_ULP = 2.0**-52
_DIVERGED = 1e30
"""Size of a state after a unit input that shows an unstable loop early."""
_WATCH = 64
"""Samples from one look at that size to the next."""
_MOST_LEFT = 1e-3
"""[-] of a unit that may be left after the simulation; the tail adds that share of the largest norm."""


class AxisNorms(NamedTuple):
    """Upper bounds of an axis's norms for all time, by cell, to each state, then `SLEW`, `GAP` and the demand."""

    entries: Array
    """(cells, signals, m) [the signal's unit] one number added to a state per sample; the first is angular rate."""
    excess: Array
    """(cells, signals) [s times the signal's unit] kinematic excess of the law's own attitude, one per sample."""
    gyro: Array
    """(cells, signals) [the signal's unit] an addition to the gyro, one per sample."""
    noise: Array
    """(cells, signals) [the signal's unit] rms per rms of white gyro noise."""
    inverse_inertia: Array
    """(cells, 2) [1/(kg*m^2)] centre, and largest distance from it."""
    inverse_lag: Array
    """(cells, 2) [1/s] the same of one over the lag."""
    demand_gyro: float
    """[N*m*s/rad] demanded torque per gyro of the same sample."""


class _Run(NamedTuple):
    """Sums over the first samples of an axis's loop, and where they lead; never written to."""

    samples: int
    total: Array
    """(cells, signals, m + 2) sums of moduli."""
    square: Array
    """(cells, signals) sums of squares after a unit of gyro."""
    peak: Array
    """(cells, m, m + 2) largest moduli of the states."""
    last: Array
    """(cells, m, m + 2) the last states."""


@lru_cache(maxsize=8)
def axis_norms(system: LoopSystem, axis: int, samples: int) -> AxisNorms:
    """Return the norms of an axis from a simulation of `samples`.

    Raises
    ------
    Refusal
        If the simulation is too long or short to bound the tail, or the loop unstable.
    """
    check_work(system, samples)
    inverse_inertia, inverse_lag = _cells(system, axis)
    Phi, _ = unit_loop(system, axis)
    demand, demand_gyro = _demand(system, axis)
    runs = _runs(system, axis)
    run = _simulate(Phi, demand, runs[-1] if runs[-1].samples <= samples else runs[0], samples)
    runs[1:] = [run]
    total, square, peak, x = run.total.copy(), run.square, run.peak, run.last
    peak = np.max(peak, axis=2)  # of each state over all columns
    defect = unit_roundings(Phi, peak)
    # the demand is a sum of the states with a rounding of its own
    slack = (len(demand) + 16) * _ULP * samples * (peak @ np.abs(demand))
    total[:, GAP:] += slack[:, None, None]
    return _add_tails(total, square, x, samples, defect, inverse_inertia, inverse_lag, demand_gyro)


def check_work(system: LoopSystem, samples: int) -> None:
    """Raise `Refusal` for a simulation that would take longer than a minute."""
    if not 0 < samples <= LONGEST:
        raise Refusal(f"samples are {samples}, must be 1 to {LONGEST}")
    if samples * system.cells[0] * system.cells[1] > _MOST_WORK:
        raise Refusal(f"{samples} samples of {system.cells[0]} x {system.cells[1]} cells are too many to simulate")


def unit_loop(system: LoopSystem, axis: int) -> tuple[Array, Array]:
    """Return Phi of an axis by cell, and its states (cells, m, m + 2) after units of each state, of excess and gyro."""
    inverse_inertia, inverse_lag = _cells(system, axis)
    Phi, gyro = axis_loop(system, axis, inverse_inertia[:, 0], inverse_lag[:, 0])
    own, m = range(axis, len(system.A), 3), gyro.shape[1]
    excess = np.zeros(m)
    excess[X0 : X0 + len(own)] = [float(system.G[i][axis]) for i in own]
    x = np.repeat(np.column_stack([np.eye(m), excess, excess])[None], len(Phi), axis=0)
    x[:, :, -1] = gyro
    return Phi, x


def unit_roundings(Phi: Array, peak: Array) -> Array:
    """Return bounds (cells, m) of the rounding of a sample's step, for states within `peak` (cells, m)."""
    defects: Array = (peak.shape[1] + 16) * _ULP * (np.abs(Phi) @ peak[:, :, None])[:, :, 0]
    return defects


def _cells(system: LoopSystem, axis: int) -> tuple[Array, Array]:
    """Return centre and half width of each cell of one over inertia, and over lag, (cells, 2) each."""
    inertia, lag = float(1 / system.inertia[axis]), float(1 / system.lag)
    pairs = [
        (a, b)
        for a in _cover(inertia, float(system.inertia_spread), system.cells[0])
        for b in _cover(lag, float(system.lag_spread), system.cells[1])
    ]
    return np.array([a for a, _ in pairs]), np.array([b for _, b in pairs])


@lru_cache(maxsize=3)
def _runs(system: LoopSystem, axis: int) -> list[_Run]:
    """Return the run of no sample and the last one, to go on from: who looks for the least samples doubles them."""
    _, x = unit_loop(system, axis)
    cells, m = x.shape[:2]
    return [_Run(0, np.zeros((cells, m + 3, m + 2)), np.zeros((cells, m + 3)), np.zeros_like(x), x)]


def _simulate(Phi: Array, demand: Array, run: _Run, samples: int) -> _Run:
    """Return a run of `samples` that goes on from a shorter one, with the bits of one from the start.

    Raises
    ------
    Refusal
        If the loop is unstable.
    """
    m, x = Phi.shape[1], run.last
    total, square, peak = (sums.copy() for sums in (run.total, run.square, run.peak))
    signals, size = np.zeros_like(total), np.zeros_like(total)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(run.samples, samples):
            after, held = Phi @ x, demand @ x
            signals[:, :m], signals[:, m + 2] = x, held
            np.subtract(after[:, OMEGA], x[:, OMEGA], out=signals[:, m])
            np.subtract(held, x[:, TORQUE], out=signals[:, m + 1])
            total += np.abs(signals, out=size)
            square += signals[:, :, -1] ** 2
            np.maximum(peak, size[:, :m], out=peak)
            if k % _WATCH == 0 and not np.max(peak) < _DIVERGED:
                break
            x = after
    if not np.max(peak) < _DIVERGED:
        raise Refusal("the norms have no bound: the loop is unstable")
    return _Run(samples, total, square, peak, x)


def _cover(nominal: float, spread: float, cells: int) -> list[tuple[float, float]]:
    """Return centre and half width of cells that cover one over a number, up to `spread` of it from nominal."""
    low, high = nominal / (1.0 + spread) * (1.0 - 8 * _ULP), nominal / (1.0 - spread) * (1.0 + 8 * _ULP)
    edges = [low + (high - low) * k / cells for k in range(cells)] + [high]
    pairs = [(0.5 * (a + b), a, b) for a, b in pairwise(edges)]
    return [(middle, 0.5 * (b - a) * UP + _ULP * middle) for middle, a, b in pairs]


def axis_loop(system: LoopSystem, axis: int, inverse_inertia: Array, inverse_lag: Array) -> tuple[Array, Array]:
    """Return Phi of an axis by cell, (cells, m, m), and the gyro's column (cells, m); entries within 8 roundings.

    The actuator holds the demanded torque over a sample. For a torque law that is its command of the sample before,
    which is the delay of one sample. A rates law has two more states, low pass and integral of the on-board rate loop.
    That loop answers the newest gyro sample and the command of the sample before.
    """
    own = list(range(axis, len(system.A), 3))
    demand, demand_gyro = _demand(system, axis)
    m = len(demand)
    plants = {value: sample_map(system, axis, value)[:2] for value in set(inverse_lag.tolist())}
    plant = np.array([plants[value] for value in inverse_lag.tolist()])
    plant[:, OMEGA, TORQUE:] *= inverse_inertia[:, None]  # torque acts through one over the inertia alone
    Phi, gyro = np.zeros((len(plant), m, m)), np.zeros((len(plant), m))
    Phi[:, :2, :2] = plant[:, :, :2]
    Phi[:, :2] += plant[:, :, 2, None] * demand
    gyro[:, :2] = plant[:, :, 2] * demand_gyro
    gyro[:, COMMAND] = float(system.D[axis][axis])
    gyro[:, X0 : X0 + len(own)] = [float(system.B[i][axis]) for i in own]
    Phi[:, COMMAND, OMEGA] = float(system.D[axis][axis])
    Phi[:, COMMAND, X0 : X0 + len(own)] = [float(system.C[axis][k]) for k in own]
    for row, i in enumerate(own, X0):
        Phi[:, row, OMEGA] = float(system.B[i][axis])
        Phi[:, row, X0 : X0 + len(own)] = [float(system.A[i][k]) for k in own]
        Phi[:, row, X1] += float(system.G[i][axis])  # at level attitude, f(x) is the estimated rate
    if system.rate_loop is not None:
        h, smoothing = float(system.dt), float(system.rate_loop.smoothing)
        Phi[:, -2, -2], Phi[:, -2, OMEGA] = 1.0 - smoothing, smoothing
        Phi[:, -1, -1], Phi[:, -1, COMMAND], Phi[:, -1, OMEGA] = 1.0, h, -h
        gyro[:, -2], gyro[:, -1] = smoothing, -h
    return Phi, gyro


def _demand(system: LoopSystem, axis: int) -> tuple[Array, float]:
    """Return the demanded torque per state (m,), the rate measured without error, and per error of the gyro."""
    states = X0 + len(system.A) // 3
    if system.rate_loop is None:
        return np.eye(states)[COMMAND], 0.0
    p, i, d = (float(row[axis]) for row in (system.rate_loop.p, system.rate_loop.i, system.rate_loop.d))
    demand = np.zeros(states + 2)
    demand[OMEGA], demand[COMMAND], demand[-2], demand[-1] = -(p + d), p, d, i
    return demand, -(p + d)


def sample_map(system: LoopSystem, axis: int, inverse_lag: float) -> tuple[tuple[float, ...], ...]:
    """Return the map over one sample of an axis of unit inertia, on its rate, torque, held command and angle.

    The angle integrates the rate. Each entry is the double nearest to the exponential series in rational numbers.

    Raises
    ------
    Refusal
        If a sample is too long for the series.
    """
    damping, bandwidth = system.damping[axis], Fraction(inverse_lag)
    if max(damping, bandwidth, Fraction(1)) * system.dt > 4:
        raise Refusal("a sample is too long for the vehicle's time constants")
    return _plant_exponential(system.dt, damping, bandwidth)


@lru_cache(maxsize=256)  # axes, laws and proofs share those of a vehicle
def _plant_exponential(dt: Fraction, damping: Fraction, bandwidth: Fraction) -> tuple[tuple[float, ...], ...]:
    one, none = Fraction(1), Fraction(0)
    generator = [[-damping, one, none, none], [none, -bandwidth, bandwidth, none], [none] * 4, [one, none, none, none]]
    total = exponential(generator, dt, terms=64, bits=256)  # 8^64 / 64! < 2^-103, far below the last bit of an entry
    return tuple(tuple(float(value) for value in row) for row in total)


def _add_tails(
    total: Array,
    square: Array,
    last: Array,
    samples: int,
    defect: Array,
    inverse_inertia: Array,
    inverse_lag: Array,
    demand_gyro: float,
) -> AxisNorms:
    """Return the norms over all time from sums over the first samples."""
    m = last.shape[1]
    if not np.max(np.sum(defect, axis=1)) * (samples + 1) < 0.4:
        raise Refusal("rounding spoils the norms: the loop is unstable")
    wrong = 2.0 * UP * (total[:, :, :m] @ defect[:, :, None])  # (cells, signals, 1), of one sample
    wrong[:, SLEW] *= 2.0  # a difference of two rates
    weight = 1.0 / np.maximum(total[:, :m, OMEGA], 1e-9)  # of each state in |.|_1
    left = UP * np.sum(weight[:, :, None] * (np.abs(last) + wrong[:, :m]), axis=1)  # (cells, columns)
    wrong *= samples + 1
    finite = UP * total + wrong
    rho = np.max(left[:, :m] / weight)
    if not rho <= _MOST_LEFT:
        raise Refusal(f"after {samples} samples {rho:.3g} of a unit is left: the loop is unstable or too slow")
    reach = UP * np.max(finite[:, :, :m] / weight[:, None], axis=2) / (1.0 - rho)
    whole = UP * (finite + left[:, None] * reach[:, :, None])
    noise = UP * (np.sqrt(square) + wrong[:, :, 0] + left[:, None, -1] * reach)
    entries, excess, gyro = whole[:, :, :m], whole[:, :, m], whole[:, :, m + 1]
    return AxisNorms(entries, excess, gyro, noise, inverse_inertia, inverse_lag, abs(demand_gyro))
