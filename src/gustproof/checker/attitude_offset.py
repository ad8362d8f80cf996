"""Theorem 4: a law's attitude leaves the strapdown integral of its gyro by a linear output of the loop.

Part of the check: rational numbers, and doubles with bounds of their rounding. A law that filters its attitude, as an
estimator with a leak does, is no strapdown. Let x0 and x1 be its attitude and rate, g the gyro, `e = (T(x0) - I) x1`
the excess that it computes, 0 for a linear law. Let X differ from x0 by d, with d = 0 at the start and

    d+ = d + h/2 (g + g+) + h e - (x0+ - x0),   so that   X+ = X + h/2 (g + g+) + h e.

That is the strapdown of Theorem 2 but for `h ((T(X) - I) g - e)` a sample. The true attitude leaves X by the sum of
its one-step errors, these included. Rotation distance is bi-invariant, so they add up and never grow.

**Norms.** d is a sum of outputs of the loop of Theorem 1: it settles to a constant after an impulse, and its norm grows
with the horizon. For a unit input and n samples, N of them simulated,

    sum_(k < n) |d_k| <= sum_(k < N) |d_k| + (n - N) (|d_N| + sum_j |xi_j| p_j),

with xi the state that is left after N samples and `p_j = sup |d|` after a unit of state j, which follows likewise.

**Rounding.** A state's rounding acts through p_j from then on, so d is wrong by at most N times their sum.
"""

from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gustproof.checker.estimate_box import (
    PEAK_RATE,
    Box,
    EstimateCase,
    axis_causes,
    axis_inputs,
    estimate_excess,
    excess,
    gyro_rounding,
    least_deviations,
    up,
)
from gustproof.checker.kernel_norms import OMEGA, UP, X0, X1, AxisNorms, check_work, unit_loop, unit_roundings
from gustproof.checker.system import LoopSystem, Refusal
from gustproof.checker.truth_drift import Disturbance, slope_of_T

Array = NDArray[np.float64]
_MOST_LEFT = 1e-3
"""[-] share of the largest offset that may be left after the simulation."""
_SPARE = 1e-6
"""[-] share of the largest offset that is added to each, and covers its rounding."""
_ULP = 2.0**-52


class Offset(NamedTuple):
    """Bounds within the horizon."""

    angle: list[Fraction]
    """(3,) [rad] |d|."""
    rate: list[Fraction]
    """(3,) [rad/s] |g - x1|."""


class _Sums(NamedTuple):
    """Norms of d and of g - x1 by cell, (cells, 2, columns): each state, then excess and gyro."""

    total: Array
    """Sums of moduli over the horizon."""
    noise: Array
    """(cells, 2) root of the sum of squares after a unit of the gyro."""


def strapdown_box(
    system: LoopSystem, norms: list[AxisNorms], case: EstimateCase, box: Box, disturbance: Disturbance, samples: int
) -> tuple[Box, Disturbance]:
    """Return box and disturbance of Theorem 2 for the strapdown integral X of the gyro of any law.

    Half of the disturbance's risk is that of the offset. Raises `Refusal` as `bound_offset` does.
    """
    half = disturbance.risk / 2
    own = (
        case._replace(deviations=least_deviations(Fraction(6 * (disturbance.steps + 2)), half)) if case.noise else case
    )
    samples, offset = _first_offset(system, norms, own, box, samples, disturbance.steps)
    # a bound that grows no faster than in proportion to time has its mean at the middle at most
    middle = min((disturbance.steps + samples) // 2 + 1, disturbance.steps)
    mean = bound_offset(system, norms, own, box, samples=samples, steps=middle)
    attitude = [row[X0] for row in box]
    shifted = [a + d for a, d in zip(attitude, offset.angle, strict=True)]
    if max(shifted) > 1:
        raise Refusal("the true attitude has no bound below a radian over this horizon")
    gyro = [row[PEAK_RATE] + gyro_rounding(case, row) + case.deviations * case.noise for row in box]
    wrong = excess(shifted, gyro)
    if any(value for row in system.G for value in row):
        moved, late = slope_of_T(shifted, gyro, mean.angle), excess(attitude, offset.rate)
        wrong = [a + b for a, b in zip(moved, late, strict=True)]
    rows = [[*row[:X0], angle, rate, *row[X1 + 1 :]] for row, angle, rate in zip(box, shifted, gyro, strict=True)]
    return rows, disturbance._replace(wrong_rates=wrong, risk=half)


def _first_offset(
    system: LoopSystem, norms: list[AxisNorms], case: EstimateCase, box: Box, samples: int, steps: int
) -> tuple[int, Offset]:
    """Return how many samples must be simulated to bound the offset, doubled from `samples`, and the bounds."""
    while True:
        try:
            return samples, bound_offset(system, norms, case, box, samples=samples, steps=steps)
        except Refusal:
            check_work(system, 2 * samples)
            samples *= 2


def bound_offset(
    system: LoopSystem, norms: list[AxisNorms], case: EstimateCase, box: Box, *, samples: int, steps: int
) -> Offset:
    """Return bounds of the offset over `steps` samples of a flight that the box proves, from `samples` simulated.

    The deviations of `case` are those of these signals.

    Raises
    ------
    Refusal
        If the simulation is too short to bound what follows it.
    """
    e = estimate_excess(system, box)
    found = [_bound_axis(system, norms[i], case, box, e, i, samples, steps) for i in range(3)]
    return Offset([angle for angle, _ in found], [rate for _, rate in found])


def _bound_axis(
    system: LoopSystem,
    norms: AxisNorms,
    case: EstimateCase,
    box: Box,
    e: list[Fraction],
    axis: int,
    samples: int,
    steps: int,
) -> list[Fraction]:
    sums = _sum_signals(system, norms, axis, samples, steps)
    causes = axis_causes(system, case, box, e, axis)
    inputs, _ = axis_inputs(system, norms, box[axis], causes)
    excess, gyro, noise = (up(value) for value in (causes.excess, causes.gyro, causes.noise))
    signals = (sums.total[:, :, :-2] @ inputs[:, :, None])[:, :, 0]
    signals += sums.total[:, :, -2] * excess + sums.total[:, :, -1] * gyro + sums.noise * noise
    return [Fraction(value) for value in (UP * np.max(signals, axis=0)).tolist()]


def _sum_signals(system: LoopSystem, norms: AxisNorms, axis: int, samples: int, steps: int) -> _Sums:
    """Return the norms of an axis, all rounding included."""
    run = _simulate(system, axis, samples)
    m = run.Phi.shape[1]
    defect = unit_roundings(run.Phi, run.peak)
    states = (norms.entries[:, :m] @ defect[:, :, None])[:, :, 0]  # error of the states, at any sample
    left = np.abs(run.last) + states[:, :, None]
    reach = run.largest[:, :m] + run.first[:, :m]  # of d after each unit state, from its start
    slack = _SPARE * np.max(reach, axis=1)
    reach += slack[:, None]
    share = np.max(np.sum(left[:, :, :m] * reach[:, :, None], axis=1) / reach)
    if not share <= _MOST_LEFT:
        raise Refusal(f"after {samples} samples {share:.3g} of the offset is left: the loop is too slow")
    reach *= UP / (1.0 - share)
    own = 16.0 * _ULP * (np.max(run.largest, axis=1) + 4.0 * np.max(run.peak, axis=1))
    wrong = (samples + 1) * UP * (np.sum(reach * defect, axis=1) + own)  # (cells,) of d, at any sample
    if not np.all(wrong <= slack):
        raise Refusal("rounding spoils the norms of the offset")
    total, noise = run.total.copy(), np.sqrt(run.square)
    settled = run.settled + np.sum(left * reach[:, :, None], axis=1) + wrong[:, None]
    beyond = max(steps - samples, 0)
    total[:, 0] += (samples + 1) * wrong[:, None] + beyond * settled
    noise[:, 0] += (samples + 1) * wrong + np.sqrt(beyond) * settled[:, -1]
    # g - x1 is a difference of two states, after the simulation too
    rest = np.sum(norms.entries[:, [OMEGA, X1]], axis=1)
    tail = np.sum(rest[:, :, None] * left, axis=1) + (samples + 1) * np.sum(states, axis=1)[:, None]
    total[:, 1] += tail
    noise[:, 1] += tail[:, -1]
    grown = UP + samples * _ULP
    return _Sums(grown * total, grown * noise)


class _Run(NamedTuple):
    """Simulation of an axis after units of each state, of the excess and of the gyro, by cell and column."""

    Phi: Array
    """(cells, m, m) loop."""
    total: Array
    """(cells, 2, m + 2) sums of moduli of d and g - x1."""
    square: Array
    """(cells, 2) sums of their squares, after a unit of the gyro."""
    peak: Array
    """(cells, m) largest moduli of the states."""
    first: Array
    """(cells, m + 2) modulus of d at the start."""
    largest: Array
    """(cells, m + 2) largest modulus of d."""
    settled: Array
    """(cells, m + 2) modulus of d after the simulation, but for what the last states do."""
    last: Array
    """(cells, m, m + 2) last states."""


@lru_cache(maxsize=8)
def _simulate(system: LoopSystem, axis: int, samples: int) -> _Run:
    """Simulate d and g - x1; the law's states of a sample of the loop have not read its gyro yet."""
    half = float(system.dt) / 2.0
    Phi, x = unit_loop(system, axis)
    before = np.zeros_like(x[:, OMEGA])  # gyro of the sample before
    before[:, -1] = 1.0
    d, off = half * before - x[:, X0], before - x[:, X1]
    d[:, -2] += 2.0 * half
    first = largest = np.abs(d)
    total, square = np.abs(np.stack([d, off], axis=1)), np.stack([d[:, -1], off[:, -1]], axis=1) ** 2
    peak = np.max(np.abs(x), axis=2)
    for _ in range(samples):
        after = Phi @ x
        d = d + half * (before + x[:, OMEGA]) - (after[:, X0] - x[:, X0])
        off = x[:, OMEGA] - after[:, X1]
        before, x = x[:, OMEGA], after
        total += np.abs(np.stack([d, off], axis=1))
        square += np.stack([d[:, -1], off[:, -1]], axis=1) ** 2
        largest = np.maximum(largest, np.abs(d))
        peak = np.maximum(peak, np.max(np.abs(x), axis=2))
    return _Run(Phi, total, square, peak, first, largest, np.abs(d) + half * np.abs(before), x)
