"""Theorem 5: on the stand a law that reads tilt keeps the true roll and pitch in a box for ever.

Part of the check: rational numbers, and doubles that are rounded up. On the stand the specific force is gravity alone,
so roll and pitch by gravity are the true ones, E, but for rounding. They close the loop of Theorem 1 beyond the law's
own attitude X = x0 and rate x1. The angle of a sample's loop moves by the rate, by h e with `e = (T(X) - I) x1`, which
moves the law too, and by

    D = integral of (T(E) - I) omega - e,    in roll and pitch.

The law corrects X over tens of seconds. So D counts with a sum of moduli of that length, and has to be split.

**Common rotation.** Let `d = E - X`, M their middle, and `a, b` the rates `sin(phi) q + cos(phi) r` and `cos(phi) q -
sin(phi) r` at M. With `u = a / cos(theta)`, Taylor's formula about the middle gives

    D = integral of u J d - (ln cos(theta))' d_phi + small terms,    J = [[0, 1], [-1, 0]].

An angle P of yaw that follows the law's own heading, with a leak, stays small; u is its rate but for small terms. So
the first is `(O+ - O) O^-1 d` with the rotation `O = exp(P J)`, the second the change of a small function. Summed by
parts, both count with the total variation of the response in place of its length:

    sum_k K_(n-1-k) (O_(k+1) - O_k) y_k,    y = O^-1 d,    |O - 1| <= |P|,

leaves `K_0`, the changes of K, and the changes of y: what moves d beside the common rotation (`TURN`).

**Small terms** of D per time are bounded in `_small_terms`. The law's rate lags behind the true one, and u differs
between M and X. Also d moves within a sample, secant and cosine are not 1, and `T(E) omega` has a third derivative.

The argument of Theorem 1 goes sample by sample: D of a sample follows from bounds of this sample and those before.

References
----------
N. H. Abel, Untersuchungen über die Reihe, Journal für die reine und angewandte Mathematik 1 (1826), 311-339
(summation by parts).
"""

from fractions import Fraction
from typing import NamedTuple

from gustproof.checker.estimate_box import (
    PEAK_RATE,
    Box,
    EstimateCase,
    acceleration,
    axis_causes,
    bound_signals,
    excess,
    trigonometry,
    up,
)
from gustproof.checker.gravity_aided_norms import ANGLE, LAG, LEAK, OFFSET, TURN, GravityAidedNorms
from gustproof.checker.kernel_norms import COMMAND, UP, X0, X1
from gustproof.checker.system import LoopSystem
from gustproof.checker.truth_drift import Three, slope_of_T

_TILT = Fraction(1, 1 << 22)
"""[rad] error of tilt from a force in float32."""


class _Motion(NamedTuple):
    """Bounds of a sample that the splitting of D rests on."""

    angles: Three
    """[rad] true roll and pitch, and 0, at all times."""
    speed: Three
    """[rad/s] |E'|."""
    offset: Three
    """[rad] d at a sample."""
    moved: Three
    """[rad/s] change of d over a sample, per time."""
    yaw: Fraction
    """[rad] P."""
    yaw_step: Fraction
    """[rad] its change over a sample."""
    tan: Fraction
    """[-] tan(theta) at M."""
    sec: Fraction
    """[-] 1 / cos(theta) at M."""
    b: Fraction
    """[rad/s] rate b at M."""
    u: Fraction
    """[rad/s] rate u at M."""


def map_gravity_aided_box(system: LoopSystem, norms: list[GravityAidedNorms], case: EstimateCase, box: Box) -> Box:
    """Return the bounds of all signals that follow if `box` bounds the nonlinear terms.

    Raises
    ------
    ValueError
        If an angle of the box is above 1 rad.
    """
    h = system.dt
    e = excess([row[X0] for row in box], [row[X1] for row in box])
    motion = _bound_motion(system, box, e)
    small = _small_terms(system, box, motion)
    # w is what is summed by parts: its function of time, and what changes otherwise
    P, d, turn = motion.yaw, motion.offset, [row[TURN] for row in box]
    reach = P + motion.yaw_step
    flat = motion.sec - 1  # above -ln cos(theta)
    held = [reach * d[1] + reach**2 / 2 * d[0] + flat * d[0], reach * d[0] + reach**2 / 2 * d[1]]
    changed = [h * (P * turn[1] + P**2 / 2 * turn[0] + flat * motion.moved[0]), h * (P * turn[0] + P**2 / 2 * turn[1])]
    # of a sample's w only the second part moves d otherwise
    own = [motion.tan * (motion.speed[1] + motion.moved[1] / 2) * d[0], Fraction(0)]
    follows = []
    for axis in range(3):
        between = _between_samples(system, case, box, axis)
        row = _map_axis(system, norms[axis], case, box, e, axis, [between, small[axis]])
        if axis < 2:
            added = norms[axis].changes * up(held[axis]) + norms[axis].sums * up(changed[axis])
            more = [Fraction(value) for value in (UP * added).tolist()]
            row = [value + extra for value, extra in zip(row, [*more, more[0]], strict=True)]
            row[TURN] += own[axis]
        row[LAG] += between / h
        follows.append(row)
    return follows


def gravity_aided_truth(system: LoopSystem, box: Box) -> Three:
    """Return bounds [rad] of the true roll and pitch at all times."""
    return [row[ANGLE] + system.dt / 2 * v for row, v in zip(box[:2], _speed(system, box), strict=False)]


def _map_axis(
    system: LoopSystem,
    norms: GravityAidedNorms,
    case: EstimateCase,
    box: Box,
    e: Three,
    axis: int,
    angle: list[Fraction],
) -> list[Fraction]:
    """Return the bounds of an axis under all but what is summed by parts; `angle` is added to the angle in a sample."""
    causes = axis_causes(system, case, box, e, axis)
    states = list(causes.states)
    if system.tilt is not None and axis < 2:
        states[COMMAND] += abs(system.tilt.D[axis][axis]) * _TILT
        own = range(axis, len(system.A), 3)
        states[X0:] = [s + abs(system.tilt.B[i][axis]) * _TILT for s, i in zip(states[X0:], own, strict=True)]
    causes = causes._replace(states=[*states, sum(angle, Fraction(0))])
    return bound_signals(system, norms.axis, axis, box[axis], causes)


def _between_samples(system: LoopSystem, case: EstimateCase, box: Box, axis: int) -> Fraction:
    """Return a bound of the turn in a sample beyond half a sample of the rate's change [rad].

    Of a sample's acceleration a, `|integral of (h/2 - s) a|`, as in Theorem 2, and twice what damping adds at most.
    """
    h, inverse = system.dt, system.inverse_inertia[axis]
    products = acceleration(system, case, box, axis) - case.moment[axis] * inverse
    free = (case.moment[axis] if case.free else 0) * inverse + products
    slow = case.slope[axis] * inverse + system.damping[axis] * acceleration(system, case, box, axis) * 6
    return h**2 / 4 * free + h**3 / 12 * slow


def _speed(system: LoopSystem, box: Box) -> Three:
    """Return bounds of |E'| [rad/s]; an angle above 1 rad raises ValueError."""
    rates = [row[PEAK_RATE] for row in box]
    # below 1 rad |E'| <= 2 |omega|
    wide = [row[ANGLE] + 2 * system.dt * sum(rates, Fraction(0)) for row in box]  # of heading none is read
    return [rate + part for rate, part in zip(rates, excess(wide, rates), strict=True)]


def _bound_motion(system: LoopSystem, box: Box, e: Three) -> _Motion:
    """Return what follows of roll and pitch; `e` bounds the law's excess.

    Raises
    ------
    ValueError
        If an angle is above 1 rad.
    """
    h, zero = system.dt, Fraction(0)
    rates, speed = [row[PEAK_RATE] for row in box], _speed(system, box)
    angles = [row[ANGLE] + h * v for row, v in zip(box[:2], speed, strict=False)] + [zero]
    middle = [(angle + row[X0]) / 2 for angle, row in zip(angles[:2], box, strict=False)] + [zero]
    sin_phi, tan, sec = trigonometry(middle)
    offset = [row[OFFSET] for row in box[:2]] + [zero]
    yaw = box[2][ANGLE]
    yaw_step = h * (LEAK * yaw + rates[2] + e[2])
    moved = [box[i][TURN] + (yaw_step * offset[1 - i] + yaw_step**2 / 2 * offset[i]) / h for i in range(2)] + [zero]
    b, u = rates[1] + sin_phi * rates[2], sec * (sin_phi * rates[1] + rates[2])
    return _Motion(angles, speed, offset, moved, yaw, yaw_step, tan, sec, b, u)


def _small_terms(system: LoopSystem, box: Box, motion: _Motion) -> Three:
    """Return bounds of what D adds to roll and pitch in a sample beside the two sums by parts, and 0 [rad]."""
    h, (d_phi, d_theta, _), v = system.dt, motion.offset, motion.speed
    rates, attitude = [row[PEAK_RATE] for row in box], [row[X0] for row in box]
    late = excess(attitude, [row[LAG] for row in box])  # the law's rate is not the true one
    mean = [d + h / 2 * s for d, s in zip(motion.offset, v, strict=True)]
    largest = max(d + h * s for d, s in zip(motion.offset, v, strict=True))
    apart = [max(a, b) for a, b in zip(motion.angles, attitude, strict=True)]
    _, tan, sec = trigonometry(apart)
    w = rates[1] + rates[2]
    third = largest**3 / 24 * w
    cubic = 2 * sec**4 + 4 * sec**2 * tan**2 + 6 * sec**2 * tan + 3 * sec**2 + tan
    # the rate of P is u but for this
    gap = LEAK * motion.yaw + slope_of_T(apart, rates, [value / 2 for value in mean])[2] + late[2]
    # and (O+ - O) O^-1 d is P+ - P times J d but for this
    second, cube = motion.yaw_step**2 / (2 * h), motion.yaw_step**3 / (6 * h)
    bent = motion.u * (motion.sec - 1)
    roll = late[0] + cubic * third + bent * mean[1] + motion.u * h / 2 * v[1] + (gap + cube) * d_theta + second * d_phi
    pitch = late[1] + third + bent * mean[0] + motion.u * h / 2 * v[0] + (gap + cube) * d_phi + second * d_theta
    # -(ln cos theta)' d_phi against the change of the function over the sample
    roll += motion.tan * motion.b * h / 2 * v[0]
    roll += motion.sec**2 * h * (3 * v[1] + motion.moved[1]) / 2 * motion.b * d_phi
    roll += motion.tan * (w * mean[0] / 2 + motion.moved[1] / 2) * d_phi
    return [h * roll, h * pitch, Fraction(0)]
