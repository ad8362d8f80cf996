"""Upper bounds of the l1 norms of one axis's loop over all time, by simulation in integers and a bound of the tail.

Part of the check: standard library and rational arithmetic only.

The state of an axis is `xi = (omega, torque, command, law's states)`, at a sample. Gyro, law and actuators give
`xi+ = Phi xi + b u`. For an input `|u_k| <= 1` of any signs, signal i stays below `S_i(b) = sum_k |(Phi^k b)_i|`.

**Tail.** With `S^N` the sum of the first N terms and `rho = max_j |Phi^N e_j|_1 < 1`, Phi is stable and

    S(b) <= S^N(b) + |Phi^N b|_1 / (1 - rho) * max_j S^N(e_j).

**Rounding.** The integers follow `Phi x + delta` with `|delta| <= defect` in each entry. Later samples amplify that by
at most `R = sum_j S^N(e_j)`, so a sum over N samples is wrong by at most `(N + 1) defect R`. R contains this error
itself; a factor of two covers it while `m (N + 1) defect < 1/2`, m the number of states.

References
----------
M. A. Dahleh, I. J. Diaz-Bobillo, Control of Uncertain Systems: A Linear Programming Approach, 1995 (l1 norms).
"""

from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from gustproof.certify.check.system import LoopSystem, Refusal
from gustproof.lti.rational import RationalMatrix, identity, multiply, round_up, sqrt_upper_bound, zeros

OMEGA, TORQUE, COMMAND, X0, X1 = range(5)
"""Positions of an axis's states; the law's states from `X0` on are attitude, rate, and the rest."""
LONGEST = 20_000
"""Largest number of simulated samples: some seconds."""
_BITS = 96
"""Binary places of the simulation."""
_MOST_LEFT = Fraction(1, 1000)
"""[-] of a unit that may be left after the simulation; the tail adds that share of the largest norm."""
_ENTRY_ERROR = Fraction(1, 1 << 80)
"""Bound on the error of an entry of Phi or b: truncation of the exponential series, and rounding."""


class AxisNorms(NamedTuple):
    """Upper bounds of an axis's norms for all time, to each state and then to the rate's change over a sample."""

    entries: list[list[Fraction]]
    """[the signal's unit] by state: one number added to it per sample; the first is angular rate."""
    excess: list[Fraction]
    """[s times the signal's unit] from kinematic excess of the law's own attitude, one number per sample."""
    gyro: list[Fraction]
    """[the signal's unit] from an addition to the gyro, one number per sample."""
    noise: list[Fraction]
    """[the signal's unit] rms per rms of white gyro noise."""


class _Sums(NamedTuple):
    """Sums of one column over N samples, scaled by 2^`_BITS`, and its state after them."""

    moduli: list[int]
    squares: list[int]
    last: list[int]


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
    Phi = axis_loop(system, axis)
    own, m = range(axis, len(system.A), 3), len(Phi)
    no_plant = [Fraction(0)] * 3
    excess = [*no_plant, *(system.G[i][axis] for i in own)]
    gyro = [Fraction(0), Fraction(0), system.D[axis][axis], *(system.B[i][axis] for i in own)]
    rows = [[(k, round(value * (1 << _BITS))) for k, value in enumerate(row) if value] for row in Phi]
    # at this size the defects of all samples add up to 1/2; beyond it numbers would only grow longer
    most = int((Fraction(1, 2 * m * (samples + 1)) - Fraction(16, 1 << _BITS)) / (m * _ENTRY_ERROR))
    sums, largest = [], 1
    for column in [*identity(m), excess, gyro]:
        total, peak = _simulate(rows, [round(value * (1 << _BITS)) for value in column], samples, most << _BITS)
        sums.append(total)
        largest = max(largest, peak)
    defect = m * _ENTRY_ERROR * Fraction(largest, 1 << _BITS) + Fraction(16, 1 << _BITS)
    return _add_tails(sums, m, samples, defect)


def axis_loop(system: LoopSystem, axis: int) -> RationalMatrix:
    """Return Phi of an axis, (m, m), each entry within `_ENTRY_ERROR`.

    The actuator holds the command of the sample before, which is the delay of one sample.
    """
    own = range(axis, len(system.A), 3)
    generator = zeros(3, 3)
    generator[0][0], generator[0][1] = -system.damping, 1 / system.inertia[axis]
    generator[1][1], generator[1][2] = -1 / system.lag, 1 / system.lag
    plant = _exponential([[system.dt * value for value in row] for row in generator])
    Phi = zeros(3 + len(own), 3 + len(own))
    Phi[OMEGA][:3], Phi[TORQUE][:3] = plant[0], plant[1]
    Phi[COMMAND][OMEGA], Phi[COMMAND][X0:] = system.D[axis][axis], [system.C[axis][k] for k in own]
    for row, i in zip(Phi[X0:], own, strict=True):
        row[OMEGA], row[X0:] = system.B[i][axis], [system.A[i][k] for k in own]
        row[X1] += system.G[i][axis]  # at level attitude, f(x) is the estimated rate
    return Phi


def _exponential(A: RationalMatrix) -> RationalMatrix:
    """Return the exponential of `A` to within `_ENTRY_ERROR`: half of it truncation, half rounding.

    Raises
    ------
    Refusal
        If a sample is too long for the series.
    """
    scale = max(sum(abs(value) for value in row) for row in A)
    if scale > 8:
        raise Refusal("a sample is too long for the vehicle's time constants")
    total = term = identity(len(A))
    for k in range(1, 64):  # 8^64 / 64! < 2^-103
        term = [[round_up(value / k, 160) for value in row] for row in multiply(term, A)]
        total = [[a + b for a, b in zip(x, y, strict=True)] for x, y in zip(total, term, strict=True)]
    return [[Fraction(round(value * (1 << _BITS)), 1 << _BITS) for value in row] for row in total]


def _simulate(rows: list[list[tuple[int, int]]], state: list[int], samples: int, most: int) -> tuple[_Sums, int]:
    """Return sums of states and of the rate's change from an initial state, and the largest modulus of a state."""
    total, square = [0] * (len(state) + 1), [0] * (len(state) + 1)
    largest = 1
    for _ in range(samples):
        after = [sum([value * state[k] for k, value in row]) >> _BITS for row in rows]
        signals = [*state, after[OMEGA] - state[OMEGA]]
        total = [a + abs(b) for a, b in zip(total, signals, strict=True)]
        square = [a + ((b * b) >> _BITS) + 1 for a, b in zip(square, signals, strict=True)]
        largest = max(largest, *state, -min(state))
        if largest > most:
            raise Refusal("rounding spoils the norms: the loop is unstable")
        state = after
    return _Sums(total, square, state), largest


def _add_tails(sums: list[_Sums], m: int, samples: int, defect: Fraction) -> AxisNorms:
    """Return the norms over all time from sums over the first samples."""
    one = 1 << _BITS
    count = m + 1
    amplified = [2 * Fraction(sum(total.moduli[i] for total in sums[:m]), one) for i in range(count)]
    amplified[m] = 2 * (amplified[OMEGA] + 1)  # a change is the difference of two rates
    error = [(samples + 1) * defect * value + Fraction(4 * samples, one) for value in amplified]
    finite = [[Fraction(total.moduli[i], one) + error[i] for i in range(count)] for total in sums]
    left = [sum((Fraction(abs(total.last[i]), one) + error[i] for i in range(m)), Fraction(0)) for total in sums]
    rho = max(left[:m])
    if rho > _MOST_LEFT:
        raise Refusal(f"after {samples} samples {float(rho):.3g} of a unit is left: the loop is unstable or too slow")
    reach = [max(row[i] for row in finite[:m]) / (1 - rho) for i in range(count)]
    whole = [
        [round_up(value + rest * far) for value, far in zip(row, reach, strict=True)]
        for row, rest in zip(finite, left, strict=True)
    ]
    noise = [
        round_up(sqrt_upper_bound(Fraction(square, one)) + error[i] + left[-1] * reach[i])
        for i, square in enumerate(sums[-1].squares)
    ]
    return AxisNorms(entries=whole[:m], excess=whole[m], gyro=whole[m + 1], noise=noise)
