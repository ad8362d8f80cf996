"""Upper bounds of the l1 norms of one axis's loop over all time, for every inertia and lag within their spreads.

Part of the check: doubles with bounds of their rounding. The state of an axis is `xi = (omega, torque, command, law's
states)`, at a sample. Gyro, law and actuators give `xi+ = Phi xi + b u`. For an input `|u_k| <= 1` of any signs, signal
i stays below `S_i(b) = sum_k |(Phi^k b)_i|`.

**Cells.** The spreads of `1 / inertia` and `1 / lag` are covered by cells. Phi is that of a cell's centre; the distance
from it acts as further inputs, see `estimate_box`.

**Tail.** With `S^N` the sum of the first N terms and `rho = max_j |Phi^N e_j|_1 < 1`, Phi is stable and

    S(b) <= S^N(b) + |Phi^N b|_1 / (1 - rho) * max_j S^N(e_j).

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

from gustproof.certify.check.system import LoopSystem, Refusal
from gustproof.lti.rational import identity, multiply, round_up

Array = NDArray[np.float64]
OMEGA, TORQUE, COMMAND, X0, X1 = range(5)
"""Positions of an axis's states; the law's states from `X0` on are attitude, rate, and the rest."""
SLEW, GAP = -2, -1
"""Positions of two more signals: the rate's change over a sample, and command minus torque."""
LONGEST = 20_000
"""Largest number of simulated samples."""
MOST_CELLS = 64
"""Largest number of cells of a spread."""
UP = 1.0 + 2.0**-40
"""[-] covers the rounding of a sum of at most 2^10 products of numbers that are not negative, some times over."""
_ULP = 2.0**-52
_MOST_LEFT = 1e-3
"""[-] of a unit that may be left after the simulation; the tail adds that share of the largest norm."""


class AxisNorms(NamedTuple):
    """Upper bounds of an axis's norms for all time, by cell, to each state and then to `SLEW` and `GAP`."""

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


@lru_cache(maxsize=8)
def axis_norms(system: LoopSystem, axis: int, samples: int) -> AxisNorms:
    """Return the norms of an axis from a simulation of `samples`.

    Raises
    ------
    Refusal
        If the simulation is too long or short to bound the tail, or the loop unstable.
    """
    if not 0 < samples <= LONGEST:
        raise Refusal(f"samples are {samples}, must be 1 to {LONGEST}")
    inertia, lag = float(1 / system.inertia[axis]), float(1 / system.lag)
    pairs = [
        (a, b)
        for a in _cover(inertia, float(system.inertia_spread), system.cells[0])
        for b in _cover(lag, float(system.lag_spread), system.cells[1])
    ]
    inverse_inertia, inverse_lag = np.array([a for a, _ in pairs]), np.array([b for _, b in pairs])
    Phi = axis_loop(system, axis, inverse_inertia[:, 0], inverse_lag[:, 0])
    own, m = range(axis, len(system.A), 3), Phi.shape[1]
    excess = [0.0] * 3 + [float(system.G[i][axis]) for i in own]
    gyro = [0.0, 0.0, float(system.D[axis][axis])] + [float(system.B[i][axis]) for i in own]
    columns = np.column_stack([np.eye(m), excess, gyro])
    x = np.repeat(columns[None], len(pairs), axis=0)
    total, peak = np.zeros((len(pairs), m + 2, m + 2)), np.zeros_like(x)
    square = np.zeros((len(pairs), m + 2))
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(samples):
            after = Phi @ x
            signals = np.concatenate([x, after[:, :1] - x[:, :1], x[:, COMMAND, None] - x[:, TORQUE, None]], axis=1)
            total += np.abs(signals)
            square += signals[:, :, -1] ** 2
            peak = np.maximum(peak, np.abs(x))
            if k % 64 == 0 and not np.max(peak) < 1e30:
                raise Refusal("the norms have no bound: the loop is unstable")
            x = after
    peak = np.max(peak, axis=2)  # of each state over all columns
    defect = (m + 8) * _ULP * (np.abs(Phi) @ peak[:, :, None])[:, :, 0]
    return _add_tails(total, square, x, samples, defect, inverse_inertia, inverse_lag)


def _cover(nominal: float, spread: float, cells: int) -> list[tuple[float, float]]:
    """Return centre and half width of cells that cover one over a number, up to `spread` of it from nominal."""
    low, high = nominal / (1.0 + spread) * (1.0 - 8 * _ULP), nominal / (1.0 - spread) * (1.0 + 8 * _ULP)
    edges = [low + (high - low) * k / cells for k in range(cells)] + [high]
    pairs = [(0.5 * (a + b), a, b) for a, b in pairwise(edges)]
    return [(middle, max(b - middle, middle - a) * UP + _ULP * middle) for middle, a, b in pairs]


def axis_loop(system: LoopSystem, axis: int, inverse_inertia: Array, inverse_lag: Array) -> Array:
    """Return Phi of an axis by cell, (cells, m, m), each entry within 4 roundings of its value.

    The actuator holds the command of the sample before, which is the delay of one sample.
    """
    own = list(range(axis, len(system.A), 3))
    Phi = np.zeros((len(inverse_lag), 3 + len(own), 3 + len(own)))
    plants = {value: _plant(system, value) for value in set(inverse_lag.tolist())}
    Phi[:, :2, :3] = [plants[value] for value in inverse_lag.tolist()]
    Phi[:, OMEGA, TORQUE : COMMAND + 1] *= inverse_inertia[:, None]  # torque acts through one over the inertia alone
    Phi[:, COMMAND, OMEGA] = float(system.D[axis][axis])
    Phi[:, COMMAND, X0:] = [float(system.C[axis][k]) for k in own]
    for row, i in enumerate(own, X0):
        Phi[:, row, OMEGA] = float(system.B[i][axis])
        Phi[:, row, X0:] = [float(system.A[i][k]) for k in own]
        Phi[:, row, X1] += float(system.G[i][axis])  # at level attitude, f(x) is the estimated rate
    return Phi


def _plant(system: LoopSystem, inverse_lag: float) -> list[list[float]]:
    """Return rate and torque, for a unit inertia, after a sample by rate, torque and command before it.

    The exponential series in rational numbers; each entry is the double nearest to it.

    Raises
    ------
    Refusal
        If a sample is too long for the series.
    """
    bandwidth = Fraction(inverse_lag)
    generator = [
        [-system.damping, Fraction(1), Fraction(0)],
        [Fraction(0), -bandwidth, bandwidth],
        [Fraction(0)] * 3,
    ]
    if max(system.damping, bandwidth, Fraction(1)) * system.dt > 4:
        raise Refusal("a sample is too long for the vehicle's time constants")
    total = term = identity(3)
    for k in range(1, 64):  # 8^64 / 64! < 2^-103, far below the last bit of every entry
        term = [[round_up(system.dt * value / k, 256) for value in row] for row in multiply(term, generator)]
        total = [[a + b for a, b in zip(x, y, strict=True)] for x, y in zip(total, term, strict=True)]
    return [[float(value) for value in row] for row in total[:2]]


def _add_tails(
    total: Array,
    square: Array,
    last: Array,
    samples: int,
    defect: Array,
    inverse_inertia: Array,
    inverse_lag: Array,
) -> AxisNorms:
    """Return the norms over all time from sums over the first samples."""
    m = last.shape[1]
    if not np.max(np.sum(defect, axis=1)) * (samples + 1) < 0.4:
        raise Refusal("rounding spoils the norms: the loop is unstable")
    wrong = 2.0 * UP * (total[:, :, :m] @ defect[:, :, None])  # (cells, signals, 1), of one sample
    wrong[:, SLEW] *= 2.0  # a difference of two rates
    left = UP * np.sum(np.abs(last) + wrong[:, :m], axis=1)  # (cells, columns)
    wrong *= samples + 1
    finite = UP * total + wrong
    rho = np.max(left[:, :m])
    if not rho <= _MOST_LEFT:
        raise Refusal(f"after {samples} samples {rho:.3g} of a unit is left: the loop is unstable or too slow")
    reach = UP * np.max(finite[:, :, :m], axis=2) / (1.0 - rho)
    whole = UP * (finite + left[:, None] * reach[:, :, None])
    noise = UP * (np.sqrt(square) + wrong[:, :, 0] + left[:, None, -1] * reach)
    return AxisNorms(whole[:, :, :m], whole[:, :, m], whole[:, :, m + 1], noise, inverse_inertia, inverse_lag)
