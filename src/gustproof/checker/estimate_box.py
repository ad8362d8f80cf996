"""Theorem 1: the law's own attitude, the rates and the commands stay in a box for ever.

Part of the check: rational numbers, and doubles that are rounded up.

**The loop never sees the true attitude.** For each axis the rate, the torque, the command and the law's states close on
themselves, `xi+ = Phi xi + inputs` (see `kernel_norms`). The inputs are

- angular acceleration `a(t) = m / I + (I_j - I_k) / I_i omega_j omega_k`, any function of time. A sample adds the
  integral of `exp(-damping (h - s)) a` to the rate, at most `h |a|`;
- the kinematic excess `e = (T(x0) - I) x1` of the law's own attitude x0 and rate x1, one number per sample;
- gyro noise, the rounding of gyro and command to float32, and the rounding of the law's sums to double;
- with spreads, the distance of inertia and lag from a cell's centre, `delta(1/I) (torque + m)` and `delta(1/lag)
  (command - torque)`. A box that closes for every cell holds for every constant inertia and lag within the spreads.

A box bounds every signal. It bounds the inputs, and these bound the signals through the norms of Phi over all time. If
the bounds that follow lie inside the box, the flight from rest and level attitude stays in it. For with every nonlinear
term clipped at the box the flight obeys the bounds, so nothing was clipped. No horizon occurs anywhere.

**Noise.** White Gaussian noise adds its rms through Phi times a number z of deviations. With `2 Q(z) <= exp(-z^2 / 2)`
and a union bound over signals and samples, the risk grows in proportion to time.
"""

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gustproof.checker.kernel_norms import COMMAND, OMEGA, TORQUE, UP, X0, X1, AxisNorms
from gustproof.checker.rational import cos_lower_bound, exp_lower_bound, round_up, sin_upper_bound
from gustproof.checker.system import LoopSystem, Refusal

SLEW, GAP, DEMAND, PEAK_RATE = -4, -3, -2, -1
"""Positions of a row's last four bounds.

The rate's change over a sample, demanded torque minus torque, demanded torque, and the rate between samples.
"""
COMMAND_SHARE = Fraction(999, 1000)
"""[-] share of its limit that a command may reach; the rest covers floating-point rounding."""
_FLOAT32, _TINY = Fraction(1, 1 << 22), Fraction(1, 1 << 140)
"""Relative and absolute rounding error of a gyro sample or a command on the wire: float32, twice for a command, as the
published limit is a float32 too."""
_DOUBLE = Fraction(1, 1 << 46)
"""[-] relative rounding error of a sum of at most 64 products of doubles, and of T(x0) x1."""

Box = list[list[Fraction]]
"""Bounds by axis: the loop's states, then `SLEW`, `GAP`, `DEMAND` and `PEAK_RATE`."""


class EstimateCase(NamedTuple):
    """Disturbances that a flight is proved against."""

    moment: list[Fraction]
    """(3,) [N*m] B, bound about each axis, already multiplied by the certified part."""
    noise: Fraction
    """[rad/s] rms of a gyro sample."""
    deviations: Fraction
    """[-] bound of the noise in its rms."""
    free: bool = False
    """True if the moment is any function of time between the samples; only a law that reads tilt can tell."""
    slope: tuple[Fraction, ...] = (Fraction(0),) * 3
    """(3,) [N*m/s] B, largest slope of the moment within a sample; likewise."""


def map_box(system: LoopSystem, norms: list[AxisNorms], case: EstimateCase, box: Box) -> Box:
    """Return the bounds of all signals that follow if `box` bounds the nonlinear terms.

    Raises
    ------
    ValueError
        If an angle of the box is above 1 rad.
    """
    e = estimate_excess(system, box)
    return [_map_axis(system, norms[i], case, box, e, i) for i in range(3)]


def _map_axis(
    system: LoopSystem, norms: AxisNorms, case: EstimateCase, box: Box, e: list[Fraction], axis: int
) -> list[Fraction]:
    """Return the bounds of an axis, the largest over all cells; doubles that are not negative, rounded up by `UP`."""
    return bound_signals(system, norms, axis, box[axis], axis_causes(system, case, box, e, axis))


def axis_causes(system: LoopSystem, case: EstimateCase, box: Box, e: list[Fraction], axis: int) -> "Causes":
    """Return bounds of all that drives an axis of a flight within the box; `e` bounds the excess [rad/s]."""
    states, held = _rounding(system, case, box, e, axis)
    states[COMMAND] += _FLOAT32 * box[axis][COMMAND] + _TINY
    return Causes(
        case.moment[axis],
        system.gyroscopic[axis] * _product(box, axis),
        e[axis],
        states,
        held,
        gyro_rounding(case, box[axis]),
        case.deviations * case.noise,
    )


class Causes(NamedTuple):
    """Bounds of all that drives the loop of an axis."""

    moment: Fraction
    """[N*m] disturbance moment."""
    coupling: Fraction
    """[rad/s^2] gyroscopic terms."""
    excess: Fraction
    """[rad/s] kinematic excess that the law computes."""
    states: list[Fraction]
    """Numbers added to the first states of the loop in a sample, `COMMAND` and law's states among them."""
    held: Fraction
    """[N*m] number added to the demanded torque."""
    gyro: Fraction
    """[rad/s] number added to the gyro."""
    noise: Fraction
    """[rad/s] noise of the gyro, by which its norm for white noise is multiplied."""


def bound_signals(
    system: LoopSystem, norms: AxisNorms, axis: int, row: list[Fraction], causes: Causes
) -> list[Fraction]:
    """Return the bounds of an axis's signals that follow from `causes`, and from bounds `row` of these signals.

    The latter enter through the distance of inertia and lag from a cell's centre, and between the samples.
    """
    h = up(system.dt)
    torque, demand, held = (up(value) for value in (row[TORQUE], row[DEMAND], causes.held))
    inputs, a = axis_inputs(system, norms, row, causes)
    signals = (
        (norms.entries @ inputs[:, :, None])[:, :, 0]
        + norms.excess * up(causes.excess)
        + norms.gyro * up(causes.gyro)
        + norms.noise * up(causes.noise)
    )
    signals[:, SLEW + 1] += inputs[:, OMEGA]  # a change before the sample has ended counts in full
    signals[:, GAP + 1 :] += norms.demand_gyro * up(causes.gyro + causes.noise) + held
    # Between samples: half of h a from the input, and a chord with h^2 / 8 times the torque's second derivative.
    bend = h * h / 8.0 * (demand + torque) * np.sum(norms.inverse_lag, axis=1) * np.sum(norms.inverse_inertia, axis=1)
    drag = up(system.damping[axis] * row[PEAK_RATE])
    peak = signals[:, OMEGA] + h / 2.0 * (a + drag) + bend
    highest = UP * np.max(np.column_stack([signals, peak]), axis=0)
    if not np.all(np.isfinite(highest)):
        raise ValueError("a bound of the box is not finite")
    return [Fraction(value) for value in highest.tolist()]


def axis_inputs(
    system: LoopSystem, norms: AxisNorms, row: list[Fraction], causes: Causes
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return by cell what a sample adds to each state at most (cells, m), and the acceleration (cells,) [rad/s^2].

    Bounds `row` of the signals enter through the distance of inertia and lag from the cell's centre.
    """
    h, (centre, off) = up(system.dt), norms.inverse_inertia.T
    held = up(causes.held)
    a = (centre + off) * up(causes.moment) + off * up(row[TORQUE]) + up(causes.coupling)
    pull = h * norms.inverse_lag[:, 1] * up(row[GAP])  # [N*m] a sample, from the lag's distance to the centre
    inputs = np.zeros((len(a), norms.entries.shape[2]))
    inputs[:, : len(causes.states)] = [up(value) for value in causes.states]
    inputs[:, TORQUE] += pull + held
    inputs[:, OMEGA] += h * a + h * centre * (pull / 2.0 + held)
    return inputs, a


def up(value: Fraction) -> float:
    """Return a double that is not below a number that is not negative."""
    return float(value) * UP


def check_box(system: LoopSystem, case: EstimateCase, box: Box, follows: Box) -> None:
    """Raise `Refusal` unless what `follows` of a box lies within it, and it within the limits of law and vehicle."""
    for axis, (inside, mapped) in enumerate(zip(box, follows, strict=True)):
        for k, (bound, value) in enumerate(zip(inside, mapped, strict=True)):
            if not value <= bound:
                raise Refusal(f"axis {axis}: the bound {k} does not close: {float(value)} above {float(bound)}")
        if not is_within_limits(system, inside, axis):
            raise Refusal(f"axis {axis}: the command may reach its limit")
        if not inside[PEAK_RATE] + case.deviations * case.noise <= system.gyro_range * COMMAND_SHARE:
            raise Refusal(f"axis {axis}: the rate may leave the gyro's range")
    if not is_rate_unlimited(system, case, box):
        raise Refusal("the limit of the rate commanded from attitude may act")


def is_within_limits(system: LoopSystem, row: list[Fraction], axis: int) -> bool:
    """Return whether command and demanded torque of an axis keep their limits."""
    demand = row[DEMAND] <= system.torque_limits[axis] * COMMAND_SHARE
    return demand and row[COMMAND] <= system.limits[axis] * COMMAND_SHARE


def is_rate_unlimited(system: LoopSystem, case: EstimateCase, box: Box) -> bool:
    """Return whether the law's limit of the rate commanded from attitude, if it has one, is never reached.

    It acts on the rate, and on roll and pitch beyond the attitude that alone commands the largest rate: a share of the
    sum that bounds the rate.
    """
    if system.rate_limit is None:
        return True
    gyro = [row[PEAK_RATE] + gyro_rounding(case, row) + case.deviations * case.noise for row in box]
    states = [box[j % 3][X0 + j // 3] for j in range(len(system.A))]
    for i, limit in enumerate(system.rate_limit.limits):
        S, T = system.rate_limit.S[i], system.rate_limit.T[i]
        if weigh(S, states) + weigh(T, gyro) > limit * COMMAND_SHARE:
            return False
    return True


def acceleration(system: LoopSystem, case: EstimateCase, box: Box, axis: int) -> Fraction:
    """Return a bound of moment and gyroscopic coupling [rad/s^2] of an axis at all times."""
    return case.moment[axis] * system.inverse_inertia[axis] + system.gyroscopic[axis] * _product(box, axis)


def _product(box: Box, axis: int) -> Fraction:
    return box[(axis + 1) % 3][PEAK_RATE] * box[(axis + 2) % 3][PEAK_RATE]


def gyro_rounding(case: EstimateCase, row: list[Fraction]) -> Fraction:
    """Return a bound of the rounding of a gyro sample [rad/s]."""
    return _FLOAT32 * (row[PEAK_RATE] + case.deviations * case.noise) + _TINY


def estimate_excess(system: LoopSystem, box: Box) -> list[Fraction]:
    """Return bounds of the excess that the law itself computes; 0 for a linear law."""
    if not any(value for row in system.G for value in row):
        return [Fraction(0)] * 3
    return excess([row[X0] for row in box], [row[X1] for row in box])


def excess(E: list[Fraction], omega: list[Fraction]) -> list[Fraction]:
    """Return bounds of `|(T(E) - I) omega|` from bounds of |E| and |omega|."""
    sin_phi, tan_theta, sec_theta = trigonometry(E)
    flat = E[0] ** 2 / 2  # 1 - cos(phi)
    return [
        round_up(tan_theta * (sin_phi * omega[1] + omega[2])),
        round_up(flat * omega[1] + sin_phi * omega[2]),
        round_up(sec_theta * sin_phi * omega[1] + max(sec_theta - 1, flat) * omega[2]),
    ]


def trigonometry(E: list[Fraction]) -> tuple[Fraction, Fraction, Fraction]:
    """Return bounds of sin(phi), tan(theta) and 1 / cos(theta); an angle above 1 rad raises ValueError."""
    cos_theta = cos_lower_bound(E[1])
    return (
        round_up(sin_upper_bound(E[0])),
        round_up(sin_upper_bound(E[1]) / cos_theta),
        round_up(1 / cos_theta),
    )


def _rounding(
    system: LoopSystem, case: EstimateCase, box: Box, e: list[Fraction], axis: int
) -> tuple[list[Fraction], Fraction]:
    """Return bounds of the rounding of sums in doubles: of each state of the loop, and of the demanded torque.

    Those of the plant's states are 0.
    """
    row = box[axis]
    gyro = row[PEAK_RATE] + case.deviations * case.noise
    rates = e[axis] + sum((box[k][X1] for k in range(3)), Fraction(0))
    own = range(axis, len(system.A), 3)
    law_states = row[X0 : X0 + len(own)]
    command = abs(system.D[axis][axis]) * gyro + weigh([system.C[axis][k] for k in own], law_states)
    sizes = [Fraction(0), Fraction(0), command]
    for i in own:
        states = weigh([system.A[i][k] for k in own], law_states)
        sizes.append(states + abs(system.B[i][axis]) * gyro + 2 * abs(system.G[i][axis]) * rates)
    held = Fraction(0)
    if system.rate_loop is not None:
        p, integrating, d = system.rate_loop.p[axis], system.rate_loop.i[axis], system.rate_loop.d[axis]
        smooth, integral = row[X0 + len(own)], row[X0 + len(own) + 1]
        sizes += [smooth + gyro, integral + system.dt * (row[COMMAND] + gyro)]
        held = _DOUBLE * (p * (row[COMMAND] + gyro) + integrating * integral + d * (gyro + smooth))
    return [_DOUBLE * size for size in sizes], held


def weigh(coefficients: Sequence[Fraction], bounds: Sequence[Fraction]) -> Fraction:
    """Return the largest sum of numbers within `bounds` with these coefficients, of any sign."""
    return sum((abs(c) * bound for c, bound in zip(coefficients, bounds, strict=True) if c), Fraction(0))


def least_deviations(count: Fraction, risk: Fraction) -> Fraction:
    """Return a number z of deviations that `count` normal numbers exceed with probability `risk` at most."""
    guess = math.sqrt(2.0 * (math.log(count) - math.log(risk)))
    z = Fraction(math.ceil(64.0 * guess) + 1, 64)
    if exp_lower_bound(z**2 / 2) * risk < count:
        raise Refusal(f"no bound of the noise is known for a risk of {float(risk)}")
    return z
