"""Theorem 2: the true attitude leaves a strapdown estimate by at most the sum of one-step errors.

Part of the check: rational arithmetic only.

**Strapdown.** With X = x0 and g = x1 after a sample, `E = X + h/2 (T(X) - I) g` is the trapezoid of `T(X) g`, exactly.
Let `omega^l` interpolate the true rates at the samples, and `R^L` turn with the interpolated gyro (true rate, rounding,
noise), from R(E) at each sample on. Let `S = R^L exp(c)` with `c' = omega - omega^l`: the true rotation, but for
products of small numbers. Then `Y = R S^T` (R the truth) turns with the body rate

    S ((I - exp(-c)) omega^L + (I - J(c)) c' - noise),     |I - exp(-c)| <= |c|,  |I - J(c)| <= |c| / 2,

and jumps at a sample by the two one-step errors below, rotated by S. A common rotation never amplifies them: rotation
distance is bi-invariant. `R = Y R(E) exp(c)` at a sample; the Euler angles follow through the Euler kinematics.

**One-step errors.** (1) E against the flow of `F = T(E) omega^L`: the integral of `(s - h/2) F'`, at most
`h^3/12 |F''|`. F'' holds the change of the rate over the sample. At the nodes T is taken at X, not at E. (2) The rate's
integral against the trapezoid, `-integral (s - h/2) omega'`:

- torque follows a held command: exactly `-kappa` times its change, `kappa <= h^2/12`. It telescopes, c starts a sample
  at `-kappa torque / I`, and only the last value counts;
- a moment held over a sample: 0. A moment of slope m': at most `h^3/12 |m'| / I`. Any function of time: at most
  `h^2/4 |m| / I`, reached by a square wave in step with the samples, which no gyro sample sees;
- gyroscopic and damping terms: at most `h^3/12` times their derivative.

**Noise.** A sample turns Y by `w = -h M nu` but for products of second order, with M a rotation that depends on earlier
noise only. So w is Gaussian and isotropic, given the past. The vector part of the product of these rotations, a unit
quaternion, is a martingale but for `|w|^2 / 8` a sample, and sub-Gaussian with deviation `s = sigma h / 2`. Averaging
`exp(l u'X)` over all directions u gives the supermartingale `exp(-n l^2 s^2 / 2) sinh(l |X|) / (l |X|)`; by Doob,

    P(sup_n |X_n| >= y s sqrt(N)) <= exp(y^2 / 2) y^2 / sinh(y^2) <= 2.1 y^2 exp(-y^2 / 2),  y >= 2.

Sums of |noise| over the flight use its mean square, by the chi-square tail `exp(-n (d - ln(1 + d)) / 2)`, and
`d - ln(1 + d) >= 3 d^2 / 10` for d <= 1. Neither law nor moment foresees the noise.

References
----------
P. G. Savage, Strapdown Inertial Navigation Integration Algorithm Design Part 1, JGCD 21 (1998), 19-28 (coning).
T. Lee, M. Leok, N. H. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3), CDC 2010 (errors on SO(3)).
I. Pinelis, Optimum bounds for the distributions of martingales in Banach spaces, Annals of Probability 22 (1994).
"""

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import NamedTuple

from gustproof.checker.estimate_box import (
    DEMAND,
    PEAK_RATE,
    SLEW,
    Box,
    EstimateCase,
    acceleration,
    excess,
    gyro_rounding,
    least_deviations,
    trigonometry,
)
from gustproof.checker.kernel_norms import TORQUE, X0, X1
from gustproof.checker.rational import exp_lower_bound, round_up, sin_upper_bound, sqrt_upper_bound
from gustproof.checker.system import LoopSystem, Refusal

_ROUNDS = 200
"""Most rounds of the fixed point of the angles."""
_CHUNKS = 32
"""Parts in which the sum of one-step errors is turned into angles."""
_LARGEST = Fraction(1)
"""[rad] angle beyond which no bound is stated."""
_ROUNDING = Fraction(1, 1 << 44)
"""[rad] rounding of the law's attitude in a sample: doubles below 4 rad, few terms."""
Three = list[Fraction]
"""A bound of each component of a vector."""


class Disturbance(NamedTuple):
    """Class of the moment between the samples, horizon, and risk of the noise."""

    unseen: Three
    """(3,) [N*m] B, moment that is any function of time; 0 if held or of stated slope."""
    slope: Three
    """(3,) [N*m/s] B, largest slope within a sample."""
    steps: int
    """Number of samples."""
    risk: Fraction
    """[-] probability that the noise leaves the bounds of this theorem."""
    wrong_rates: Sequence[Fraction] = (Fraction(0),) * 3
    """(3,) [rad/s] error of the Euler rates that the attitude sums up; 0 for a strapdown law."""


class _Noise(NamedTuple):
    """Bounds of the noise over the flight, all with the stated risk."""

    mean: Fraction
    """[rad/s] root of the mean square of a component over the flight."""
    walk: Fraction
    """[rad] angle of the product of its rotations."""


class _Angles(NamedTuple):
    """Bounds of the second derivatives of Euler angles, and what they are made of."""

    second: Three
    """[rad/s^2] second derivatives."""
    third: Three
    """[rad/s^3] derivatives of `T(E) omega` twice, for a rate linear in time."""


class Joint(NamedTuple):
    """Bounds of the law's attitude and the noise that it sums up, both Gaussian, together."""

    angle: Three
    """(3,) [rad] linear part of the law's attitude less `h` times the sum of the noise, at all samples."""
    rest: Three
    """(3,) [rad] law's attitude less that linear part."""
    risk: Fraction
    """[-] probability that the noise's turn leaves the bound of its distance from the sum."""


def truth_bound(
    system: LoopSystem, case: EstimateCase, box: Box, disturbance: Disturbance, joint: Joint | None = None
) -> Three:
    """Return bounds of |phi|, |theta|, |psi| [rad] of the true attitude at all times within the horizon.

    With `joint`, of a strapdown law, what it bounds takes the place of the law's attitude and of the noise's turn.

    Raises
    ------
    Refusal
        If the horizon is too short for the noise's mean, or an angle reaches `_LARGEST`.
    """
    noise = _noise(system, case, disturbance)
    estimate = [row[X0] + system.dt / 2 * e for row, e in zip(box, _own_excess(box), strict=True)]
    carried, steps = _step_errors(system, case, box, disturbance, noise, estimate)
    newest = system.dt * case.deviations * case.noise  # half of the newest sample's noise, which w counts in full
    # R = Y R(E) exp(c): the estimate, turned by c in B, and then in N by all of Y
    own = _rotate(estimate, carried, excess)
    walk = [noise.walk + newest] * 3
    angles = _rotate(own, walk, _excess_N)
    if joint is not None:
        # of S at a sample, and the turn of one sample more
        tilted = sum((a + system.dt * row[X1] for a, row in zip(own, box, strict=True)), Fraction(0))
        apart = newest + _walk_error(system, case, noise, tilted, disturbance.steps, joint.risk)
        coupled = _excess_N(angles, walk)
        angles = [joint.angle[i] + joint.rest[i] + (own[i] - box[i][X0]) + apart + coupled[i] for i in range(3)]
    for budget in [[disturbance.steps * step / _CHUNKS for step in steps]] * _CHUNKS:
        angles = _rotate(angles, budget, _excess_N)
    # between samples: a chord, and h^2 / 8 times the second derivative
    rates = [row[PEAK_RATE] for row in box]
    wide = [angle + 2 * system.dt * _norm(rates) for angle in angles]
    bend = _angles(wide, rates, [_rate_slope(system, case, box, i) for i in range(3)]).second
    return [round_up(angle + system.dt**2 / 8 * value) for angle, value in zip(angles, bend, strict=True)]


def blind_angles(system: LoopSystem, moment: Three, steps: int) -> Three:
    """Return the angles [rad] that a square wave of `moment` in step with the samples turns any law of this gyro."""
    return [steps * system.dt**2 / 4 * m / inertia for m, inertia in zip(moment, system.inertia, strict=True)]


def _own_excess(box: Box) -> Three:
    return excess([row[X0] for row in box], [row[X1] for row in box])


def _step_errors(
    system: LoopSystem, case: EstimateCase, box: Box, disturbance: Disturbance, noise: _Noise, estimate: Three
) -> tuple[Three, Three]:
    """Return bounds of c at a sample, and of the turn of Y in a sample, by axis in N."""
    h = system.dt
    gyro = [row[X1] for row in box]
    held = [h**2 / 12 * row[TORQUE] * inverse for row, inverse in zip(box, system.inverse_inertia, strict=True)]
    jerk = [_jerk(system, case, box, disturbance, i) for i in range(3)]
    unseen = _over_inertia(system, disturbance.unseen)
    # c and c' within a sample
    c = [held[i] + h**3 / 12 * jerk[i] + h**2 / 3 * unseen[i] for i in range(3)]
    c_rate = _norm([h**2 / 8 * jerk[i] + h / 2 * unseen[i] for i in range(3)])
    size = _norm(c)
    second_order = size**2 / 2 * _norm(gyro) + size / 2 * c_rate
    between = [h * (value + second_order) for value in _cross(c, gyro)]
    quadrature = [
        h**2 / 4 * unseen[i]
        + h**3 / 12 * (disturbance.slope[i] * system.inverse_inertia[i] + _drag_slope(system, case, box, i))
        + h * gyro_rounding(case, box[i])
        for i in range(3)
    ]
    kinematics = _kinematic_error(system, case, box, noise, estimate, disturbance.wrong_rates)
    twist = size * _norm(quadrature)
    body = [a + b + d + twist for a, b, d in zip(between, kinematics, quadrature, strict=True)]
    # the rotations that these vectors pass: the estimate's, a sample's turn, c, and the noise's of Y
    passed = [x + h * g + part + noise.walk for x, g, part in zip(estimate, gyro, c, strict=True)]
    tilted = _tilt(passed, body)
    length = _norm(body)
    random = _noise_error(system, noise, size, _norm(gyro) + c_rate) + 4 * h * noise.mean * length
    return held, [round_up(value + random) for value in tilted]


def _over_inertia(system: LoopSystem, moments: Sequence[Fraction]) -> Three:
    """Return the accelerations of moments."""
    return [moment * inverse for moment, inverse in zip(moments, system.inverse_inertia, strict=True)]


def _kinematic_error(
    system: LoopSystem, case: EstimateCase, box: Box, noise: _Noise, estimate: Three, wrong_rates: Sequence[Fraction]
) -> Three:
    """Return a bound of the body vector from the flow of the Euler kinematics to E, in a sample."""
    h = system.dt
    gyro = [row[X1] for row in box]
    # the mean over the flight of the gyro's change in a sample
    change = [(row[SLEW] + 2 * noise.mean + 2 * gyro_rounding(case, row)) / h for row in box]
    wide = [value + 2 * h * _norm(gyro) for value in estimate]
    base = [h**3 / 12 * value for value in _angles(wide, gyro, change).third]
    off = [h / 2 * e for e in _own_excess(box)]
    at_nodes = [h * value for value in slope_of_T(wide, gyro, off)]
    own = [a + b + h * c + _ROUNDING for a, b, c in zip(base, at_nodes, wrong_rates, strict=True)]
    # the last node holds the error itself; h/2 times the slope of T is below 1/100
    unit = max(slope_of_T(wide, gyro, [Fraction(1)] * 3))
    if h / 2 * unit > Fraction(1, 100):
        raise Refusal("a sample is too long for the rates")
    wrong = [value + h * unit * max(own) for value in own]
    sin_phi, sin_theta = sin_upper_bound(wide[0]), sin_upper_bound(wide[1])
    return [wrong[0] + sin_theta * wrong[2], wrong[1] + sin_phi * wrong[2], wrong[2] + sin_phi * wrong[1]]


def _angles(E: Three, omega: Three, change: Three) -> _Angles:
    """Return bounds for Euler angles within E that turn with |omega| and |omega'| within `change`.

    With `a = sin(phi) q + cos(phi) r` and `b = cos(phi) q - sin(phi) r`: `phi' = p + tan(theta) a`, `theta' = b`,
    `psi' = a / cos(theta)`, `a' = b phi' + A`, `b' = -a phi' + B`, `A' = phi' B`, `B' = -phi' A`.
    """
    s_phi, t, s = trigonometry(E)
    a, b = s_phi * omega[1] + omega[2], omega[1] + s_phi * omega[2]
    A, B = s_phi * change[1] + change[2], change[1] + s_phi * change[2]
    turn = omega[0] + t * a
    a_rate, b_rate = b * turn + A, a * turn + B
    phi2 = change[0] + s**2 * a * b + t * a_rate
    a2 = b_rate * turn + b * phi2 + turn * B
    phi3 = 2 * s**2 * t * a * b**2 + s**2 * (a_rate * b + a * b_rate) + s**2 * b * a_rate + t * a2
    theta3 = a_rate * turn + a * phi2 + A * turn
    psi3 = s * a2 + 2 * s * t * b * a_rate + a * s * (t**2 * b**2 + s**2 * b**2 + t * b_rate)
    second = [phi2, b_rate, s * a_rate + a * s * t * b]
    return _Angles([round_up(value) for value in second], [round_up(value) for value in (phi3, theta3, psi3)])


def slope_of_T(E: Three, omega: Three, off: Three) -> Three:
    """Return bounds of `|(T(E) - T(E')) omega|` for angles within E that differ by at most `off`."""
    s_phi, t, s = trigonometry(E)
    a, b = s_phi * omega[1] + omega[2], omega[1] + s_phi * omega[2]
    return [
        s**2 * a * off[1] + t * b * off[0],
        a * off[0],
        s * b * off[0] + s * t * a * off[1],
    ]


def _rate_slope(system: LoopSystem, case: EstimateCase, box: Box, axis: int) -> Fraction:
    """Return a bound of |omega'| [rad/s^2] at all times."""
    row = box[axis]
    return (
        row[TORQUE] * system.inverse_inertia[axis]
        + acceleration(system, case, box, axis)
        + system.damping[axis] * row[PEAK_RATE]
    )


def _drag_slope(system: LoopSystem, case: EstimateCase, box: Box, axis: int) -> Fraction:
    """Return a bound of the derivative of gyroscopic and damping terms [rad/s^3]."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    slope = [_rate_slope(system, case, box, i) for i in range(3)]
    product = slope[j] * box[k][PEAK_RATE] + slope[k] * box[j][PEAK_RATE]
    return system.gyroscopic[axis] * product + system.damping[axis] * slope[axis]


def _jerk(system: LoopSystem, case: EstimateCase, box: Box, disturbance: Disturbance, axis: int) -> Fraction:
    """Return a bound of omega'' [rad/s^3] within a sample, but for a moment that is any function of time."""
    row, inverse = box[axis], system.inverse_inertia[axis]
    torque = (row[DEMAND] + row[TORQUE]) * system.inverse_lag * inverse
    return torque + disturbance.slope[axis] * inverse + _drag_slope(system, case, box, axis)


def _noise(system: LoopSystem, case: EstimateCase, disturbance: Disturbance) -> _Noise:
    """Return bounds of the noise, half of the risk for each of its two."""
    if case.noise == 0:
        return _Noise(Fraction(0), Fraction(0))
    n, half = disturbance.steps, disturbance.risk / 2
    spread = Fraction(math.ceil(1e4 * math.sqrt(math.log(3 / half) / (0.15 * n))), 10**4)
    if spread > 1 or exp_lower_bound(Fraction(3, 20) * n * spread**2) * half < 3:
        raise Refusal("the horizon is too short to bound the mean square of the noise")
    y = Fraction(2)
    while exp_lower_bound(y**2 / 2) * half < Fraction(21, 10) * y**2:
        y += Fraction(1, 16)
    mean = case.noise * sqrt_upper_bound(1 + spread)
    h = system.dt
    vector = y * case.noise * h / 2 * sqrt_upper_bound(Fraction(n)) + n * 3 * (h * mean) ** 2 / 8
    # angle = 2 arcsin(vector), and arcsin(v) <= v + v^3 / 2 for v <= 1/2
    if vector > Fraction(1, 2):
        raise Refusal("the noise may turn the attitude by a radian")
    return _Noise(round_up(mean), round_up(2 * (vector + vector**3 / 2)))


def _noise_error(system: LoopSystem, noise: _Noise, c: Fraction, rate: Fraction) -> Fraction:
    """Return a bound of the mean turn of Y in a sample by products of noise with other small rotations.

    A sample's noise acts through a hat function over two samples, in the mean h/3 away from its middle. On the way S
    turns with at most `rate`. Without the newest noise R(E) is less than h times that noise away. Rotations of noise by
    noise add 3/4 of the square of a sample's turn.
    """
    turn = system.dt * sqrt_upper_bound(Fraction(3)) * noise.mean
    return turn * (system.dt / 3 * rate + 2 * c) + 2 * turn**2


def _walk_error(
    system: LoopSystem, case: EstimateCase, noise: _Noise, tilted: Fraction, steps: int, risk: Fraction
) -> Fraction:
    """Return a bound of each component of the noise's turn, as rotation vector y, plus `h` times the noise's sum.

    With X and q the vector and scalar part of the turn so far, a sample adds `(q I + [X x]) M (-h nu)` to 2 X, but for
    `|w|^2 / 4`. That leaves `-h nu` by at most `ratio |h nu|`: `|M - I|` is below the angle of S, and the rest below
    half the turn's. Each component of the sum is sub-Gaussian, given the past, so Doob's inequality bounds it at all
    samples as if at the last. Last, `|y - 2 X| <= |X|^3`.
    """
    ratio = tilted + noise.walk / 2
    z = least_deviations(Fraction(6), risk)
    random = z * ratio * system.dt * case.noise * sqrt_upper_bound(Fraction(steps))
    second = steps * 3 * (system.dt * noise.mean) ** 2 / 4
    return round_up(random + second + (noise.walk / 2) ** 3)


def _rotate(start: Three, budget: Three, excess_of: Callable[[Three, Three], Three]) -> Three:
    """Return bounds of Euler angles from within `start` after rotations that sum up to `budget` [rad] by axis.

    `excess_of` bounds the difference of Euler rates and rates, about axes of B or of N.
    """
    angles = [a + b for a, b in zip(start, budget, strict=True)]
    for _ in range(_ROUNDS):
        if max(angles) > _LARGEST:
            break
        follows = [a + b + e for a, b, e in zip(start, budget, excess_of(angles, budget), strict=True)]
        if all(value <= angle for value, angle in zip(follows, angles, strict=True)):
            return angles
        angles = [round_up(value * (1 + Fraction(1, 10**6))) for value in follows]
    raise Refusal("the true attitude has no bound below a radian over this horizon")


def _excess_N(E: Three, omega_N: Three) -> Three:
    """Return bounds of the Euler rates minus the rates in N: the formulas of B with yaw and roll exchanged."""
    return excess(E[::-1], omega_N[::-1])[::-1]


def _tilt(passed: Three, vector: Three) -> Three:
    """Return bounds of a vector after rotations that sum up to `passed` [rad] about each axis, in any order.

    With s the sum of all angles, the product of the rotations is I plus the sum of their generators, but for
    `exp(s) - 1 - s <= s^2` for s <= 1.
    """
    s = sum(passed)
    if s > 1:
        raise Refusal("the true attitude has no bound below a radian over this horizon")
    first, second = _cross(passed, vector), s**2 * _norm(vector)
    return [value + a + second for value, a in zip(vector, first, strict=True)]


def _cross(a: Three, b: Three) -> Three:
    """Return bounds of the components of a cross product."""
    return [a[(i + 1) % 3] * b[(i + 2) % 3] + a[(i + 2) % 3] * b[(i + 1) % 3] for i in range(3)]


def _norm(vector: Three) -> Fraction:
    return round_up(sqrt_upper_bound(sum((value**2 for value in vector), Fraction(0))))
