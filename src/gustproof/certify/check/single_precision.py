"""Theorem 3: a law in single precision leaves the same law in real numbers by at most the sum of its roundings.

Part of the check: rational arithmetic and rounded doubles only. Two flights are compared, with the same moments, the
same errors of the gyro and the same start. One law computes in real numbers, the other as its C does in floats. Both
stay in the box of Theorem 1: the second one in a box a fiftieth wider, as long as the difference is smaller than that.

**One step.** With u = 2^-24, a plain sum of k products of rounded factors is wrong by at most `(k + 4) u` times the sum
of its magnitudes, the rounding of the states that it reads included. A state in two floats adds products that are exact
but for 2^-35 of each; what its sum loses is kept in the second float, which is small, and rounded at u of itself.
Below 3/4 rad no angle is reduced. With the rounding of the angle itself, sine, one minus cosine and cosine by Taylor
polynomials are wrong by at most 2.5 u, 4.5 u and 3.2 u of themselves: of the series 2^-28 is left, its later terms are
small, and each operation adds u. So the excess of the Euler rates is wrong by `_KINEMATICS` u, term by term:
`sin_theta (sin_phi q + cos_phi r) / cos_theta` 12.9 u, `flat_phi q + sin_phi r` 6.5 u, and `(sin_phi q + (flat_theta -
flat_phi) r) / cos_theta` 11.7 u of the sum of the magnitudes. Second order is covered by the rest.

**The loop.** The difference of the flights obeys the loop of Theorem 1, driven by the roundings. Gyroscopic terms and
the kinematic excess differ by at most their slope within the box times the difference. The fixed point of this map
bounds each signal for ever. A start at a heading rounds the states at rest there, once: no more than at each step.

**Attitude.** The law's own attitude differs by that bound. On strapdown attitude the true one also takes every rounding
of the sum of the attitude: a turn of at most the sum of the three, each step, because each Euler angle turns about an
axis of unit length and rotation distance is bi-invariant. Both together bound the angle between the two attitudes.

**Heading.** Only differences of yaw act on a law. Its sums hold yaw itself: sizes count for yaw and reference anywhere
within the heading, and states at rest there.

References
----------
N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd edition, 2002, chapters 3 and 4.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from gustproof.certify.check.estimate_box import (
    PEAK_RATE,
    Box,
    Case,
    Causes,
    bound_signals,
    excess,
    is_rate_unlimited,
    is_within_limits,
    trigonometry,
)
from gustproof.certify.check.kernel_norms import COMMAND, X0, X1, AxisNorms
from gustproof.certify.check.system import LoopSystem, Refusal, is_strapdown
from gustproof.certify.check.truth_drift import slope_of_T
from gustproof.lti.rational import round_up

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
    case: Case,
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
    is_scheduled = any(value for row in system.G for value in row)
    if is_scheduled and max(row[X0] for row in wide_box[:2]) > _SMALL:
        raise Refusal("an angle needs reduction")
    within = all(is_within_limits(system, row, axis) for axis, row in enumerate(wide_box))
    if not (within and is_rate_unlimited(system, case, wide_box)):
        raise Refusal("the flight is too near a limit")
    errors = [_row_error(system, case, wide_box, form, reference, i) for i in range(len(system.A) + 3)]
    difference = [[Fraction(0)] * len(row) for row in box]
    for _ in range(_ROUNDS):
        follows = _map(system, norms, wide_box, difference, errors, form)
        pairs = [pair for a, b in zip(follows, difference, strict=True) for pair in zip(a, b, strict=True)]
        if all(value <= bound for value, bound in pairs):
            break
        difference = [[value * (1 + Fraction(1, 1000)) for value in row] for row in follows]
    else:
        raise Refusal("the differences by rounding do not settle")
    for row, inside in zip(difference, box, strict=True):
        if any(value > (_WIDER - 1) * bound for value, bound in zip(row, inside, strict=True)):
            raise Refusal("rounding in single precision is not small beside the box of the flight")
    return RoundingBounds(
        own=[row[X0] for row in difference],
        command=[row[COMMAND] for row in difference],
        drift=round_up(sum(errors[:3], Fraction(0)), 128) if is_strapdown(system) else None,
    )


def _map(
    system: LoopSystem, norms: list[AxisNorms], box: Box, difference: Box, errors: list[Fraction], form: Form
) -> list[list[Fraction]]:
    """Return the bounds of the difference that follow if `difference` bounds it in the nonlinear terms."""
    n, E, omega = len(system.A), [row[X0] for row in box], [row[X1] for row in box]
    turned = [Fraction(0)] * 3
    if any(value for row in system.G for value in row):
        attitude, rates = [row[X0] for row in difference], [row[X1] for row in difference]
        turned = [a + b for a, b in zip(slope_of_T(E, omega, attitude), excess(E, rates), strict=True)]
    follows = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        coupling = box[j][PEAK_RATE] * difference[k][PEAK_RATE] + box[k][PEAK_RATE] * difference[j][PEAK_RATE]
        at_start = [form.heading * form.at_heading[s] * (_EXACT if s in form.wide else 2 * _U) for s in range(i, n, 3)]
        own = [error + first for error, first in zip(errors[i:n:3], at_start, strict=True)]
        states = [Fraction(0), Fraction(0), errors[n + i], *own]
        none = Fraction(0)
        causes = Causes(none, system.gyroscopic[i] * coupling, turned[i], states, none, none, none)
        follows.append(bound_signals(system, norms[i], i, difference[i], causes))
    return follows


def _row_error(
    system: LoopSystem, case: Case, box: Box, form: Form, reference: Sequence[Sequence[Fraction]], i: int
) -> Fraction:
    """Return a bound of the rounding of a state's sum, or of a command's for `i` from n on."""
    n, axis = len(system.A), i % 3 if i < len(system.A) else i - len(system.A)
    sizes = [box[j % 3][X0 + j // 3] + form.heading * form.at_heading[j] for j in range(n)]
    gyro = [row[PEAK_RATE] + case.deviations * case.noise for row in box]
    A, B = (system.A[i], system.B[i]) if i < n else (system.C[axis], system.D[axis])
    G = list(system.G[i]) if i < n else [Fraction(0)] * 3
    A = [value + (G[j - 3] if 3 <= j < 6 else 0) for j, value in enumerate(A)]
    terms = [abs(a) * size for a, size in zip(A, sizes, strict=True)]
    kept = i in form.wide and A[i] == 1
    own = terms[i] if i < n else Fraction(0)
    others = sum(terms, Fraction(0)) - (own if kept else 0)
    others += sum((abs(b) * rate for b, rate in zip(B, gyro, strict=True)), Fraction(0))
    others += abs(reference[i][2]) * form.heading
    count = sum(map(bool, [*A, *B, *reference[i]]))
    bends = [abs(g) * size for g, size in zip(G, _excess_terms(box), strict=True)] if any(G) else [Fraction(0)] * 3
    bent = sum(bends, Fraction(0))
    kinematics = _U * sum((k * size for k, size in zip(_KINEMATICS, bends, strict=True)), Fraction(0))
    if i not in form.wide:
        if count == 1 and not bent and set(map(abs, [*A, *B])) <= {0, 1}:
            return _TINY  # a copy
        return (count + 4) * _U * (others + bent) * _WIDER + kinematics + _TINY
    # magnitude of the second float: what sums lose, and the fine parts of the factors
    low = (3 * count + 4) * _U * (own + others + bent) * _WIDER + _FINE * others
    read = sum((terms[j] for j in form.wide if j != i), Fraction(0))  # without their second float
    return _U * read + _EXACT * others + kinematics + 3 * _U * bent + (4 * count + 8) * _U * low + _TINY


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
