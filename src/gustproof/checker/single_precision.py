"""Theorem 3: a law in single precision leaves the same law in real numbers by at most the sum of its roundings.

Part of the check: rational arithmetic and rounded doubles only. Two flights are compared, with the same moments, the
same errors of the gyro and the same start. One law computes in real numbers, the other as its C does in floats. Both
stay in the box of Theorem 1: the second one in a box a fiftieth wider, as long as the difference is smaller than that.

**One step.** Let u = 2^-24. A plain sum of k products of rounded factors is wrong by at most `(k + 4) u` times the sum
of its magnitudes. That includes the rounding of the states that it reads. A state in two floats adds products that are
exact but for 2^-35 of each. Its sum keeps what it loses in the second float. That one is small, and rounded at u of
itself.

Below 3/4 rad no angle is reduced. Sine, one minus cosine and cosine are wrong by at most 2.5 u, 4.5 u and 3.2 u of
themselves, with the rounding of the angle. For 2^-28 is left of Taylor's series, its later terms are small, and each
operation adds u. The excess of the Euler rates is then wrong by `_KINEMATICS` u of the sum of its magnitudes:

- roll, `sin_theta (sin_phi q + cos_phi r) / cos_theta`: 12.9 u;
- pitch, `flat_phi q + sin_phi r`: 6.5 u;
- yaw, `(sin_phi q + (flat_theta - flat_phi) r) / cos_theta`: 11.7 u.

The next whole number covers the second order.

**The loop.** The difference of the flights obeys the loop of Theorem 1, driven by the roundings. Gyroscopic terms and
the kinematic excess differ by at most their slope within the box times the difference. The fixed point of this map
bounds each signal for ever. A start at a heading rounds the states at rest there, once: no more than at each step.

**Attitude.** The law's own attitude differs by that bound. On strapdown attitude the true one also takes every rounding
of the sum of the attitude. That is a turn of at most the sum of the three, each step. For an Euler angle turns about an
axis of unit length, and rotation distance is bi-invariant. Both together bound the angle between the two attitudes.

**Heading.** Only differences of yaw act on a law. Its sums hold yaw itself: sizes count for yaw and reference anywhere
within the heading, and states at rest there.

References
----------
N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd edition, 2002, chapters 3 and 4.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from gustproof.checker.estimate_box import (
    COMMAND_SHARE,
    PEAK_RATE,
    Box,
    Causes,
    EstimateCase,
    bound_signals,
    excess,
    is_rate_unlimited,
    is_within_limits,
    trigonometry,
    weigh,
)
from gustproof.checker.kernel_norms import COMMAND, X0, X1, AxisNorms
from gustproof.checker.system import LoopSystem, Refusal, Row, is_strapdown
from gustproof.checker.truth_drift import slope_of_T

_U = Fraction(1, 1 << 24)
"""[-] unit roundoff of a float."""
_EXACT = Fraction(1, 1 << 35)
"""[-] error of a product of a factor in two floats."""
_FINE = Fraction(1, 1 << 12)
"""[-] share of a factor that is not in its coarse float."""
_TINY = Fraction(1, 1 << 110)
"""Underflow of every operation of a sum, also where small numbers are flushed to 0."""
_KINEMATICS = (14, 7, 13)
"""(3,) [u] errors of the computed excess of the Euler rates, of the magnitudes of its terms."""
_WIDER = Fraction(51, 50)
"""[-] box of the flight in single precision over that of the flight in real numbers."""
_SMALL = Fraction(3, 4)
"""[rad] angle below which sine and cosine need no reduction."""
_ROUNDS = 100
"""Most rounds of the fixed point."""


class Form(NamedTuple):
    """Form of a law in single precision."""

    wide: frozenset[int]
    """States that are held in two floats."""
    heading: Fraction
    """[rad] bound of the magnitude of yaw, and of its reference."""
    at_heading: list[Fraction]
    """(n,) magnitude of each state at rest at a yaw of 1 rad."""


class RoundingBounds(NamedTuple):
    """Bounds of the differences that single precision makes."""

    own: list[Fraction]
    """(3,) [rad] law's own phi, theta, psi, for ever."""
    command: list[Fraction]
    """(3,) [N*m or rad/s] B, command, for ever."""
    drift: Fraction | None
    """[rad] turn of the true attitude in a step; `None` if the law's attitude is no strapdown integral."""


def bound_rounding(
    system: LoopSystem,
    norms: list[AxisNorms],
    case: EstimateCase,
    box: Box,
    form: Form,
    reference: Sequence[Sequence[Fraction]],
) -> RoundingBounds:
    """Return the bounds for a flight that the box proves; `reference` (n + 3, 3) multiplies yaw's in states, commands.

    Raises
    ------
    Refusal
        If an angle needs reduction, or roundings are not small beside the box.
    """
    wide_box = [[value * _WIDER for value in row] for row in box]
    _check_form(system, case, wide_box, form)
    errors = [_row_error(system, case, wide_box, form, reference, i) for i in range(len(system.A) + 3)]
    difference = _fixed_point(system, norms, wide_box, errors, form)
    if not _is_below(difference, [[(_WIDER - 1) * value for value in row] for row in box]):
        raise Refusal("rounding in single precision is not small beside the box of the flight")
    return RoundingBounds(
        own=[row[X0] for row in difference],
        command=[row[COMMAND] for row in difference],
        drift=sum(errors[:3], Fraction(0)) if is_strapdown(system) else None,
    )


def _fixed_point(
    system: LoopSystem, norms: list[AxisNorms], box: Box, errors: list[Fraction], form: Form
) -> list[list[Fraction]]:
    """Return bounds of the difference between a flight in single precision and in exact numbers, by axis and signal.

    A sample maps flights within these bounds to flights within them, so they hold for ever. They are searched by
    mapping and widening.

    Raises
    ------
    Refusal
        If none are found in `_ROUNDS` steps.
    """
    difference = [[Fraction(0)] * len(row) for row in box]
    for _ in range(_ROUNDS):
        follows = _map(system, norms, box, difference, errors, form)
        if _is_below(follows, difference):
            return difference
        difference = [[value * (1 + Fraction(1, 1000)) for value in row] for row in follows]
    raise Refusal("the differences by rounding do not settle")


def _check_form(system: LoopSystem, case: EstimateCase, box: Box, form: Form) -> None:
    """Refuse a box in which an angle needs reduction, or a limit may act."""
    if _is_scheduled(system) and max(row[X0] for row in box[:2]) > _SMALL:
        raise Refusal("an angle needs reduction")
    within = all(is_within_limits(system, row, axis) for axis, row in enumerate(box))
    if not (within and is_rate_unlimited(system, case, box) and _is_rate_sum_exact(system, case, box, form)):
        raise Refusal("the flight is too near a limit")


def _is_rate_sum_exact(system: LoopSystem, case: EstimateCase, box: Box, form: Form) -> bool:
    """Return whether the rounding of a limited rate is below the share of its limit that is kept free.

    At rest at a heading the sum is 0, so the reference's part of it is as large as that of the states.
    """
    if system.rate_limit is None:
        return True
    sizes, gyro = _sizes(system, case, box, form)
    for S, T, limit in zip(system.rate_limit.S, system.rate_limit.T, system.rate_limit.limits, strict=True):
        if (len(sizes) + 10) * _U * (2 * weigh(S, sizes) + weigh(T, gyro)) > (1 - COMMAND_SHARE) * limit:
            return False
    return True


def _sizes(system: LoopSystem, case: EstimateCase, box: Box, form: Form) -> tuple[list[Fraction], list[Fraction]]:
    """Return bounds of the magnitudes of states and gyro, at any heading."""
    states = [box[j % 3][X0 + j // 3] + form.heading * form.at_heading[j] for j in range(len(system.A))]
    return states, [row[PEAK_RATE] + case.deviations * case.noise for row in box]


def _is_scheduled(system: LoopSystem) -> bool:
    return any(value for row in system.G for value in row)


def _is_below(bounds: Box, others: Box) -> bool:
    rows = zip(bounds, others, strict=True)
    return all(value <= other for pair in rows for value, other in zip(*pair, strict=True))


def _map(
    system: LoopSystem, norms: list[AxisNorms], box: Box, difference: Box, errors: list[Fraction], form: Form
) -> list[list[Fraction]]:
    """Return the bounds of the difference that follow if `difference` bounds it in the nonlinear terms."""
    turned = _excess_difference(system, box, difference)
    none = Fraction(0)
    follows = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        coupling = box[j][PEAK_RATE] * difference[k][PEAK_RATE] + box[k][PEAK_RATE] * difference[j][PEAK_RATE]
        own = [errors[s] + _start_error(form, s) for s in range(i, len(system.A), 3)]
        states = [none, none, errors[len(system.A) + i], *own]
        causes = Causes(none, system.gyroscopic[i] * coupling, turned[i], states, none, none, none)
        follows.append(bound_signals(system, norms[i], i, difference[i], causes))
    return follows


def _excess_difference(system: LoopSystem, box: Box, difference: Box) -> list[Fraction]:
    """Return bounds of the difference of the kinematic excess [rad/s]."""
    if not _is_scheduled(system):
        return [Fraction(0)] * 3
    attitude, rates = [row[X0] for row in difference], [row[X1] for row in difference]
    slope = slope_of_T([row[X0] for row in box], [row[X1] for row in box], attitude)
    return [a + b for a, b in zip(slope, excess([row[X0] for row in box], rates), strict=True)]


def _start_error(form: Form, state: int) -> Fraction:
    return form.heading * form.at_heading[state] * (_EXACT if state in form.wide else 2 * _U)


def _row_error(
    system: LoopSystem, case: EstimateCase, box: Box, form: Form, reference: Sequence[Sequence[Fraction]], i: int
) -> Fraction:
    """Return a bound of the rounding of a state's sum, or of a command's for `i` from n on."""
    A, B, G = _row(system, i)
    sizes, gyro = _sizes(system, case, box, form)
    others = weigh(A, sizes) + weigh(B, gyro) + abs(reference[i][2]) * form.heading
    count = sum(map(bool, [*A, *B, *reference[i]]))
    terms_of_excess = _excess_terms(box) if any(G) else [Fraction(0)] * 3
    bent = weigh(G, terms_of_excess)
    kinematics = _U * weigh(G, [k * size for k, size in zip(_KINEMATICS, terms_of_excess, strict=True)])
    if i not in form.wide:
        is_copy = count == 1 and not bent and set(map(abs, [*A, *B])) <= {0, 1}
        return _TINY if is_copy else (count + 4) * _U * (others + bent) * _WIDER + kinematics + _TINY
    read = sum((abs(A[j]) * sizes[j] for j in form.wide - {i}), Fraction(0))  # without their second float
    inexact = others - (sizes[i] if A[i] == 1 else 0)
    # magnitude of the second float: what sums lose, and the fine parts of the factors
    low = (3 * count + 4) * _U * (others + bent) * _WIDER + _FINE * inexact
    return _U * read + _EXACT * inexact + kinematics + 3 * _U * bent + (4 * count + 8) * _U * low + _TINY


def _row(system: LoopSystem, i: int) -> tuple[list[Fraction], Row, Row]:
    """Return the factors of states, gyro and excess in a state's sum, or a command's for `i` from n on."""
    n = len(system.A)
    if i >= n:
        return list(system.C[i - n]), system.D[i - n], (Fraction(0),) * 3
    G = system.G[i]
    return [value + (G[j - 3] if 3 <= j < 6 else 0) for j, value in enumerate(system.A[i])], system.B[i], G


def _excess_terms(box: Box) -> list[Fraction]:
    """Return the magnitudes of the terms of the excess of the Euler rates, as they are computed."""
    E, omega = [row[X0] for row in box], [row[X1] for row in box]
    sin_phi, tan_theta, sec_theta = trigonometry(E)
    flat_phi, flat_theta = E[0] ** 2 / 2, E[1] ** 2 / 2
    return [
        tan_theta * (sin_phi * omega[1] + omega[2]),
        flat_phi * omega[1] + sin_phi * omega[2],
        sec_theta * (sin_phi * omega[1] + (flat_phi + flat_theta) * omega[2]),
    ]
