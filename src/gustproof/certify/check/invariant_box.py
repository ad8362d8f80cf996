"""Proof that a sampled loop stays inside a box: L1 norms by simulation in integers, closed over the nonlinear terms.

Part of the check: standard library and rational arithmetic only. Everything is derived again from the numbers of the
vehicle and the law.

For each axis, X = (E, omega, torque, law's three states, last command) moves as `X+ = Phi X` plus bounded inputs:

- acceleration `a(t)`: moment and gyroscopic coupling;
- Euler rates `e(t) = (T(E) - I) omega` beyond those at hover, and the same of the law's estimate;
- coupling of the axes in the law;
- float32 rounding.

The box bounds these inputs. If the bounds that follow for all signals lie inside the box, the flight stays in it. With
every nonlinear term clipped at the box the flight obeys the bounds, so nothing was clipped.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from gustproof.lti.rational import (
    RationalMatrix,
    cos_lower_bound,
    identity,
    multiply,
    round_up,
    sin_upper_bound,
    sqrt_upper_bound,
    zeros,
)

SIGNALS = ("E", "omega", "torque", "x0", "x1", "x2", "command", "E - x0", "omega - x1")
"""Bounded signals of each axis. Attitude [rad], rate [rad/s] and torque [N*m] are bounded at all times, the law's
states and command at the samples. The last two are errors of its estimates at a sample, until the next sample."""
_E, _OMEGA, _TORQUE, _X0, _X1, _COMMAND, _OFF_E, _OFF_OMEGA = 0, 1, 2, 3, 4, 6, 7, 8
_LATE_E, _LATE_OMEGA = 9, 10
"""The last two signals at the end of the sample, in the norms only."""
LONGEST = 90_000
"""Largest number of samples, simulated in about half a minute: 6 minutes of flight at 250 Hz."""
_BITS = 96
"""Binary places of the simulation."""
_ENTRY_ERROR = Fraction(1, 1 << 80)
"""Bound on the error of an entry of Phi: truncation of the exponential series, and rounding."""
_FLOAT32, _TINY = Fraction(1, 1 << 23), Fraction(1, 1 << 140)
"""Relative and absolute rounding error of a float32 on the wire, with a factor of two to spare."""

Box = list[list[Fraction]]
"""Bounds by axis and signal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisNorms:
    """Upper bounds of one axis's L1 norms, from each input to `SIGNALS` and to the two at the end of the sample."""

    acceleration: list[Fraction]
    """[s^2 times the signal's unit] from angular acceleration, any function of time."""
    attitude: list[Fraction]
    """[s times the signal's unit] from Euler rates into the attitude alone, any function of time."""
    both: list[Fraction]
    """[s times the signal's unit] from Euler rates, held over a sample, into attitude and estimate."""
    entries: list[list[Fraction]]
    """[the signal's unit] from additions to the law's three states and to its command, one number per sample."""
    noise: list[Fraction]
    """[the signal's unit] rms per rms of gyro noise."""


def axis_norms(evidence: dict[str, Any], axis: int) -> AxisNorms:
    """Return the norms of an axis over the evidence's samples; some seconds per 15,000 samples.

    Raises
    ------
    ValueError
        If there are more than `LONGEST` samples, a sample is too long for the vehicle, or rounding spoils the norms.
    """
    law, samples, h = evidence["law"], evidence["samples"], Fraction(evidence["law"]["dt"])
    if not 0 < samples <= LONGEST:
        raise ValueError(f"samples are {samples}, must be 1 to {LONGEST}")
    own = [axis, axis + 3, axis + 6]
    Phi, start, turned = _loop(evidence, axis)
    zero = Fraction(0)
    unit = identity(7)
    euler_rate = [turned, zero, zero, *(Fraction(law["G"][i][axis]) for i in own), zero]
    gyro = [zero, zero, zero, *(Fraction(law["B"][i][axis]) for i in own), Fraction(law["D"][axis][axis])]
    columns = [unit[1], start, unit[2], *unit[3:], euler_rate, gyro]
    sums, squares = _simulate(Phi, columns, samples)
    decay = Phi[0][0]
    slower = decay + _ENTRY_ERROR  # a leak of 0 leaves 1
    passed = Fraction(samples) if evidence["leak"] == 0 else (1 - _power_lower_bound(slower, samples)) / (1 - slower)
    attitude = [h * passed if k in (_E, _OFF_E, _LATE_E) else zero for k in range(_LATE_OMEGA + 1)]
    leak, damping = Fraction(evidence["leak"]), Fraction(evidence["vehicle"]["rate_damping"])
    # integral of a smooth modulus: its chord from end to end, and h^3 / 12 times the second derivative
    bend = h**3 / 12
    acceleration = [
        h / 2 * (sums[0][k] + sums[1][k]) + bend * (damping**2 * sums[0][k] + (leak + damping) * attitude[k] / h)
        for k in range(_LATE_OMEGA + 1)
    ]
    return AxisNorms(
        acceleration=_round_bounds(acceleration),
        attitude=_round_bounds(attitude),
        both=_round_bounds(sums[7]),
        entries=[_round_bounds(row) for row in sums[3:7]],
        noise=_round_bounds(squares[8]),
    )


def map_box(evidence: dict[str, Any], norms: list[AxisNorms], level: Fraction, box: Box) -> Box:
    """Return the bounds of all signals that follow if `box` bounds the nonlinear terms."""
    vehicle, h, leak = evidence["vehicle"], Fraction(evidence["law"]["dt"]), Fraction(evidence["leak"])
    damping, lag = Fraction(vehicle["rate_damping"]), Fraction(vehicle["actuator_lag"])
    inertia = [Fraction(value) for value in vehicle["inertia_B"]]
    scheduled = any(value != 0 for row in evidence["law"]["G"] for value in row)
    E, omega, x0, x1, off_E, off_omega = (
        [box[i][k] for i in range(3)] for k in (_E, _OMEGA, _X0, _X1, _OFF_E, _OFF_OMEGA)
    )
    own = _excess(x0, x1) if scheduled else [Fraction(0)] * 3
    e = _excess_difference(E, x0, x1, off_E, off_omega) if scheduled else _excess(E, omega)
    additions = _additions(evidence, box, own)
    bounds = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        a = (
            level * Fraction(evidence["moment"][i]) / inertia[i]
            + abs(inertia[j] - inertia[k]) / inertia[i] * omega[j] * omega[k]
        )
        n = norms[i]
        at = [
            n.acceleration[s] * a
            + n.attitude[s] * e[i]
            + n.both[s] * own[i]
            + sum((n.entries[m][s] * additions[i][m] for m in range(4)), Fraction(0))
            + Fraction(evidence["deviations"]) * Fraction(evidence["noise"]) * n.noise[s]
            for s in range(_LATE_OMEGA + 1)
        ]
        at[_TORQUE] = max(at[_TORQUE], at[_COMMAND] * (1 + _FLOAT32))  # between samples torque moves to the command
        # Inside a sample the past gives a chord from sample to sample and h^2 / 8 times its second derivative. The
        # norms count the input since the sample with its weight at the end; its decay is of order h^2.
        spin = at[_OMEGA] + h * (a + at[_TORQUE] / inertia[i])
        push = at[_TORQUE] / inertia[i] + damping * spin
        jerk = (at[_TORQUE] + at[_COMMAND] * (1 + _FLOAT32)) / (lag * inertia[i]) + damping * push
        at[_OMEGA] += h**2 * (jerk / 8 + damping * a)
        angle = at[_E] + h * (spin + e[i] + own[i])
        bend = h**2 * (push + leak * (spin + leak * angle)) / 8
        at[_E] += bend + h**2 * (a / 2 + leak * (e[i] + own[i]))
        at[_OFF_E] = max(at[_OFF_E], at[_LATE_E]) + bend + h * (e[i] + own[i]) + h**2 / 2 * a
        at[_OFF_OMEGA] = max(at[_OFF_OMEGA], at[_LATE_OMEGA]) + h**2 * jerk / 8 + h * a
        bounds.append(_round_bounds(at[: len(SIGNALS)]))
    return bounds


def rate_shares(evidence: dict[str, Any], box: Box) -> list[Fraction]:
    """Return bounds by axis of the rate commanded from attitude, and of roll and pitch, as shares of their limits.

    Below 1 the law is that of its matrices A to G alone. A law that limits no rate has shares of 0.
    """
    limit = evidence["law"].get("rate_limit")
    if limit is None:
        return [Fraction(0)] * 3
    measured = _measured(evidence, box)
    shares = []
    for i in range(3):
        S, T, largest = limit["S"][i], limit["T"][i], Fraction(limit["limits"][i])
        rate = sum((abs(Fraction(S[3 * m + j])) * box[j][_X0 + m] for m in range(3) for j in range(3)), Fraction(0))
        rate += sum((abs(Fraction(T[j])) * measured[j] for j in range(3)), Fraction(0))
        tilt = abs(Fraction(S[i])) * box[i][_X0]
        shares.append(max(rate, tilt) / largest)
    return shares


def _excess(E: list[Fraction], omega: list[Fraction]) -> list[Fraction]:
    """Return bounds of `|(T(E) - I) omega|` from bounds of |E| and |omega|."""
    sin_phi, tan_theta, sec_theta = _trigonometry(E)
    flat = E[0] ** 2 / 2  # 1 - cos(phi)
    return [
        tan_theta * (sin_phi * omega[1] + omega[2]),
        flat * omega[1] + sin_phi * omega[2],
        sec_theta * sin_phi * omega[1] + max(sec_theta - 1, flat) * omega[2],
    ]


def _excess_difference(
    E: list[Fraction], x0: list[Fraction], x1: list[Fraction], off_E: list[Fraction], off_omega: list[Fraction]
) -> list[Fraction]:
    """Return bounds of `|(T(E) - I) omega - (T(x0) - I) x1|`: the rates' difference, and the slope of T between."""
    wide = [max(a, b) for a, b in zip(E, x0, strict=True)]
    sin_phi, tan_theta, sec_theta = _trigonometry(wide)
    first = _excess(wide, off_omega)
    across, along = sin_phi * x1[1] + x1[2], x1[1] + sin_phi * x1[2]
    second = [
        sec_theta**2 * across * off_E[1] + tan_theta * along * off_E[0],
        across * off_E[0],
        sec_theta * along * off_E[0] + sec_theta * tan_theta * across * off_E[1],
    ]
    return [a + b for a, b in zip(first, second, strict=True)]


def _trigonometry(E: list[Fraction]) -> list[Fraction]:
    """Return bounds of sin(phi), tan(theta) and 1 / cos(theta)."""
    cos_theta = cos_lower_bound(E[1])
    return _round_bounds([sin_upper_bound(E[0]), sin_upper_bound(E[1]) / cos_theta, 1 / cos_theta])


def _round_bounds(bounds: list[Fraction]) -> list[Fraction]:
    return [round_up(value) for value in bounds]


def _measured(evidence: dict[str, Any], box: Box) -> list[Fraction]:
    """Return bounds of the gyro's samples before their rounding."""
    return [box[i][_OMEGA] + Fraction(evidence["deviations"]) * Fraction(evidence["noise"]) for i in range(3)]


def _additions(evidence: dict[str, Any], box: Box, own: list[Fraction]) -> list[list[Fraction]]:
    """Return bounds of the additions to the law's states and command of each axis: other axes, and rounding."""
    law = evidence["law"]
    measured = _measured(evidence, box)
    rounding = [_FLOAT32 * value + _TINY for value in measured]
    additions = []
    for i in range(3):
        rows = [(law["A"][r], law["B"][r], law["G"][r]) for r in (i, i + 3, i + 6)]
        rows.append((law["C"][i], law["D"][i], [0.0] * 3))
        values = []
        for states, measurements, rates in rows:
            total = sum((abs(Fraction(measurements[j])) * rounding[j] for j in range(3)), Fraction(0))
            for j in range(3):
                if j == i:
                    continue
                total += sum((abs(Fraction(states[3 * m + j])) * box[j][_X0 + m] for m in range(3)), Fraction(0))
                total += abs(Fraction(measurements[j])) * measured[j]
                total += abs(Fraction(rates[j])) * (box[j][_X1] + own[j])
            values.append(total)
        values[3] += _FLOAT32 * box[i][_COMMAND] + _TINY
        additions.append(_round_bounds(values))
    return additions


def _loop(evidence: dict[str, Any], axis: int) -> tuple[RationalMatrix, list[Fraction], Fraction]:
    """Return Phi (7, 7), the response at a sample's end to unit omega at its start, and a held Euler rate's angle."""
    vehicle, law, h = evidence["vehicle"], evidence["law"], Fraction(evidence["law"]["dt"])
    inertia, lag = Fraction(vehicle["inertia_B"][axis]), Fraction(vehicle["actuator_lag"])
    generator = zeros(5, 5)  # of (E, omega, torque, command, Euler rate), the last two held
    generator[0][0], generator[0][1], generator[0][4] = -Fraction(evidence["leak"]), Fraction(1), Fraction(1)
    generator[1][1], generator[1][2] = -Fraction(vehicle["rate_damping"]), 1 / inertia
    generator[2][2], generator[2][3] = -1 / lag, 1 / lag
    plant = _exponential([[h * value for value in row] for row in generator])
    own = [axis, axis + 3, axis + 6]
    Phi = zeros(7, 7)
    for i in range(3):
        Phi[i][:3] = plant[i][:3]
        Phi[i][6] = plant[i][3]
        Phi[3 + i][1] = Fraction(law["B"][own[i]][axis])
        Phi[3 + i][3:6] = [Fraction(law["A"][own[i]][k]) for k in own]
        Phi[3 + i][4] += Fraction(law["G"][own[i]][axis])  # at hover, f(x) is the estimated rate
        Phi[6][3 + i] = Fraction(law["C"][axis][own[i]])
    Phi[6][1] = Fraction(law["D"][axis][axis])
    return Phi, [plant[0][1], plant[1][1], *[Fraction(0)] * 5], plant[0][4]


def _exponential(A: RationalMatrix) -> RationalMatrix:
    """Return the exponential of `A` to within `_ENTRY_ERROR`: half of it truncation, half rounding."""
    if max(sum(abs(value) for value in row) for row in A) > Fraction(1, 2):
        raise ValueError("a sample is too long for the vehicle's time constants")
    total = term = identity(len(A))
    for k in range(1, 20):  # (1/2)^20 / 20! < 2^-81
        term = [[value / k for value in row] for row in multiply(term, A)]
        total = [[a + b for a, b in zip(x, y, strict=True)] for x, y in zip(total, term, strict=True)]
    return [[Fraction(round(value * (1 << _BITS)), 1 << _BITS) for value in row] for row in total]


def _power_lower_bound(x: Fraction, n: int) -> Fraction:
    """Return a lower bound of `x`^n for 0 <= x <= 1, n > 0, by squaring and rounding down."""
    one = 1 << _BITS
    base, power = x.numerator * one // x.denominator, one
    while n:
        if n & 1:
            power = (power * base) >> _BITS
        base = (base * base) >> _BITS
        n >>= 1
    return Fraction(power, one)


def _simulate(
    Phi: RationalMatrix, columns: list[list[Fraction]], samples: int
) -> tuple[list[list[Fraction]], list[list[Fraction]]]:
    """Return upper bounds of the sums of moduli, and of the roots of the sums of squares, of `SIGNALS` from `columns`.

    The simulation rounds by at most `defect` in a step, and later steps amplify that by at most the sums of the unit
    columns. Those sums contain the error themselves; a factor of two covers that while the error is small.
    """
    one = 1 << _BITS
    rows = [[(k, round(value * one)) for k, value in enumerate(row) if value] for row in Phi]
    sums, squares, largest = [], [], 1
    # at this size the defects of all steps add up to 1/2; beyond it numbers would only grow longer
    most = math.floor(one * (Fraction(1, 28 * samples) - Fraction(16, one)) / (7 * _ENTRY_ERROR))
    for column in columns:
        total, square, peak = _accumulate(rows, [round(value * one) for value in column], samples, most)
        sums.append(total)
        squares.append(square)
        largest = max(largest, peak)
    defect = 7 * _ENTRY_ERROR * Fraction(largest, one) + Fraction(16, one)
    reach = max([Fraction(samples), *(value for column in (0, *range(2, 7)) for value in sums[column][:7])])
    error = 2 * samples * 14 * defect * reach
    above = [[value + error for value in row] for row in sums]
    return above, [[sqrt_upper_bound(value) + error for value in row] for row in squares]


def _accumulate(
    rows: list[list[tuple[int, int]]], state: list[int], samples: int, most: int
) -> tuple[list[Fraction], list[Fraction], int]:
    """Return sums of moduli and of squares of the signals from one initial state, and the state's largest modulus.

    `rows`, `state`, `most` and the modulus are scaled by 2^`_BITS`.
    """
    total, square = [0] * (_LATE_OMEGA + 1), [0] * (_LATE_OMEGA + 1)
    largest = 1
    for _ in range(samples):
        after = [sum([value * state[k] for k, value in row]) >> _BITS for row in rows]
        x0, x1 = state[3], state[4]
        signals = (*state, state[0] - x0, state[1] - x1, after[0] - x0, after[1] - x1)
        total = [a + abs(b) for a, b in zip(total, signals, strict=True)]
        square = [a + ((b * b) >> _BITS) + 1 for a, b in zip(square, signals, strict=True)]
        largest = max(largest, *state, -min(state))
        if largest > most:
            raise ValueError("rounding spoils the norms: the loop is unstable or the horizon too long")
        state = after
    one = 1 << _BITS
    return [Fraction(value, one) for value in total], [Fraction(value, one) for value in square], largest
