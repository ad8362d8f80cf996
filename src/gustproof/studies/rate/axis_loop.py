"""Loop of one axis at hover, sampled and delayed, as a function of its inertia and its actuator lag.

With the lag tau, the damping d and the inverse inertia v, exactly,

    moment+ = u + (1 - beta) (moment - u),    rate+ = exp(-d dt) rate + v (b u + c (moment - u)),

with `beta = 1 - exp(-dt / tau)`, `b = (1 - exp(-d dt)) / d` and `c = (exp(-d dt) - exp(-dt / tau)) / (1 / tau - d)`.
One lag fixes both beta and c: it is one parameter. The characteristic polynomial is affine in v, and in (beta, c).
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.law.form import Law, Output
from gustproof.law.references import describe_other_rate
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix

_BITS = 192
"""Binary digits of the coefficients, 57 decimal ones."""
_MOST_STATES = 40
"""States of a law's axis; the polynomials of that many take a few seconds."""
_MOST_DIGITS = 8000
"""Binary digits of the integers in the characteristic polynomial, which a law of huge and tiny numbers exceeds."""

Polynomial = tuple[Fraction, ...]
"""Coefficients of s, the constant first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisLoop:
    """Polynomials of the loop in `s = (z - 1) / (z + 1)`, where s = j tan(omega dt / 2) on the unit circle.

    The characteristic polynomial is `f0 - v f1`, with

        f0 = denominator (beta + (2 - beta) s),    f1 = numerator (b beta + (b (2 - beta) - 2 c) s).

    Law and delay enter exactly, as the rationals that the floats of the law file are. The results are rounded to
    `_BITS`, so that the Routh array stays short. The rate's decay is a float.
    """

    denominator: Polynomial
    """(m + 1,) of law, delay and rate; m is the order of the loop less 1."""
    numerator: Polynomial
    """(m + 1,) of law and delay, with the sign of the law's feedback."""
    controller: Lti
    """Gyro [rad/s] to command [N*m] of the law, in floats."""
    dt: float
    """[s] sample time."""
    delay_samples: int
    """Samples from a measurement to the action of its command."""
    rate_damping: float
    """[1/s] d, per inertia as given: the same at every inertia."""
    inertia: float
    """[kg*m^2] nominal."""
    actuator_lag: float
    """[s] nominal."""

    @property
    def held_gain(self) -> float:
        """[s] b, rate times inertia per torque held over a sample."""
        return _hold(self.rate_damping, self.dt)

    @cached_property
    def in_floats(self) -> Matrix:
        """(2, m + 1) denominator and numerator, rounded to floats."""
        return np.array([self.denominator, self.numerator], dtype=np.float64)

    def lag_terms(self, lag: ArrayLike) -> tuple[Matrix, Matrix]:
        """Return beta [-] and c [s] at the lags (...) [s]: beta falls with the lag, c grows.

        Both are accurate to a few units of rounding, also where the lag is the inverse of the damping.
        """
        speed = 1.0 / np.asarray(lag, dtype=np.float64)
        x = (speed - self.rate_damping) * self.dt
        at_zero = x == 0.0
        share = np.where(at_zero, 1.0, -np.expm1(-x) / np.where(at_zero, 1.0, x))
        return -np.expm1(-speed * self.dt), math.exp(-self.rate_damping * self.dt) * self.dt * share

    def is_stable_at(self, inertia: float, lag: float) -> bool:
        """Return whether every pole is inside the unit circle: a proof in exact arithmetic, by the Routh array.

        Before it, beta, b and c are rounded to floats.
        """
        beta, c = (Fraction(float(term)) for term in self.lag_terms(lag))
        b = Fraction(self.held_gain)
        f0 = _multiply(self.denominator, (beta, 2 - beta))
        f1 = _multiply(self.numerator, (b * beta, b * (2 - beta) - 2 * c))
        return _is_hurwitz(tuple(p - Fraction(1.0 / inertia) * q for p, q in zip(f0, f1, strict=True)))

    def spectral_radius(self, inertia: ArrayLike, lag: ArrayLike) -> Matrix:
        """Return the largest modulus of the poles, (k,), at k inertias [kg*m^2] and lags [s]: eigenvalues in floats."""
        v, (beta, c) = 1.0 / np.asarray(inertia, dtype=np.float64), self.lag_terms(lag)
        K, late = self.controller, self.delay_samples
        rate, moment, sent = 0, 1, 2  # then the delayed commands, oldest first, and the law's states
        law = slice(sent + late, sent + late + K.order)
        A = np.zeros((v.size, law.stop, law.stop))
        command = np.zeros(law.stop)
        command[rate], command[law] = K.D[0, 0], K.C[0]
        acting = np.eye(law.stop)[sent] if late else command
        A[:, rate] = (v * (self.held_gain - c))[:, None] * acting
        A[:, rate, rate] += math.exp(-self.rate_damping * self.dt)
        A[:, rate, moment] += v * c
        A[:, moment] = beta[:, None] * acting
        A[:, moment, moment] += 1.0 - beta
        for k in range(late):
            A[:, sent + k] = np.eye(law.stop)[sent + k + 1] if k + 1 < late else command
        A[:, law, rate], A[:, law, law] = K.B[:, 0], K.A
        return np.asarray(np.max(np.abs(np.linalg.eigvals(A)), axis=1), dtype=np.float64)

    def sensitivity(self, omega: Matrix, inertia: Matrix, lag: Matrix) -> ComplexMatrix:
        """Return the sensitivity `f0 / (f0 - v f1)`, (k, m), of k members at m frequencies [rad/s], in floats."""
        s = 1j * np.tan(0.5 * self.dt * omega)
        v, (beta, c) = 1.0 / inertia[:, None], self.lag_terms(lag[:, None])
        below, above = (np.polyval(p[::-1], s) for p in self.in_floats)
        b = self.held_gain
        f0 = below * (beta + (2.0 - beta) * s)
        f1 = above * (b * beta + (b * (2.0 - beta) - 2.0 * c) * s)
        return np.asarray(f0 / (f0 - v * f1), dtype=np.complex128)


def axis_loop(law: Law, vehicle: Vehicle, scenario: Scenario, axis: int) -> AxisLoop:
    """Return the loop of one axis (0, 1, 2 for roll, pitch, yaw) with the law linear at level attitude, within limits.

    Raises
    ------
    ValueError
        If the law couples its axes, uses the accelerometer, commands no torque or has another sample time. Also if it
        has more than 40 states in the axis, or coefficients that span too many orders of magnitude.
    """
    if line := describe_other_rate(scenario, law.name, law.dt):
        raise ValueError(line)
    A, B, C, D = _axis_controller(law, axis)
    n = len(B)
    if n > _MOST_STATES:
        raise ValueError(f"law '{law.name}' has {n} states in one axis, at most {_MOST_STATES} are allowed here")
    denominator, numerator = _transfer_function(A, B, C, D)
    damping, dt, late = vehicle.rate_damping_B[axis], scenario.dt, scenario.delay_samples
    lost = Fraction(-math.expm1(-damping * dt))
    # (1 - s)^(order of the loop) times the polynomials in z
    below = _multiply(_power((Fraction(1), Fraction(1)), late), (lost, 2 - lost))
    above = _power((Fraction(1), Fraction(-1)), late + 1)
    return AxisLoop(
        denominator=_round(_multiply(_bilinear(denominator, n), below)),
        numerator=_round(_multiply(_bilinear(numerator, n), above)),
        controller=Lti(
            A=A.astype(np.float64),
            B=B[:, None].astype(np.float64),
            C=C[None].astype(np.float64),
            D=np.array([[float(D)]]),
            dt=law.dt,
        ),
        dt=dt,
        delay_samples=late,
        rate_damping=damping,
        inertia=vehicle.inertia_B[axis],
        actuator_lag=vehicle.actuator_lag,
    )


def _axis_controller(law: Law, axis: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], Fraction]:
    """Return A, B, C, D from gyro to command of one axis, of rationals: (n, n), (n,), (n,), one number."""
    A = _rational(law.A)
    if law.has_kinematics:
        A[:, 3:6] += _rational(law.G)
    B = law.B[:, axis]
    own, others = _reachable_states(A != 0, B), [k for k in range(3) if k != axis]
    across = (law.C[others][:, own], law.D[others, axis], law.C[axis, ~own], law.D[axis, others])
    if law.output is not Output.TORQUE or law.uses_accelerometer or any(np.any(part) for part in across):
        raise ValueError(
            f"law '{law.name}' couples its axes, uses the accelerometer or commands no torque: no loop of one gyro"
        )
    return A[np.ix_(own, own)], _rational(B[own]), _rational(law.C[axis, own]), Fraction(law.D[axis, axis])


def _reachable_states(linked: NDArray[np.bool_], B: Matrix) -> NDArray[np.bool_]:
    """Return a mask of the states reachable from one input, with input matrix (n,)."""
    reached: NDArray[np.bool_] = B != 0.0
    for _ in range(len(B)):
        reached = reached | np.any(linked[:, reached], axis=1)
    return reached


def _rational(values: Matrix) -> NDArray[Any]:
    """Return the floats as the equal rationals, in an array of objects."""
    return np.array([Fraction(value) for value in values.ravel().tolist()], dtype=object).reshape(values.shape)


def _transfer_function(A: NDArray[Any], B: NDArray[Any], C: NDArray[Any], D: Fraction) -> tuple[Polynomial, Polynomial]:
    """Return denominator and numerator in z of `C (z - A)^-1 B + D`, exactly, in integers.

    References
    ----------
    F. R. Gantmacher, The Theory of Matrices 1, 1959, chapter IV, section 5 (Faddeev's method).
    """
    n = len(B)
    (N, q), (above, q_above), (right, q_right) = _integers(A), _integers(C), _integers(B)
    longest = max((abs(int(x)).bit_length() for x in N.flat), default=1)
    if n * max(q.bit_length(), longest) > _MOST_DIGITS:
        raise ValueError("the law's coefficients span too many orders of magnitude")
    identity = np.diag(np.ones(n, dtype=int)).astype(object)
    adjoint, a, numerator = identity, [Fraction(1)], [D]
    for k in range(1, n + 1):
        read = Fraction(int(above @ adjoint @ right), q_above * q_right * q ** (k - 1))
        moved = N @ adjoint
        trace = int(np.trace(moved)) // k  # k divides it
        adjoint = moved - trace * identity
        a.append(Fraction(-trace, q**k))
        numerator.append(D * a[k] + read)
    return tuple(a[::-1]), tuple(numerator[::-1])


def _integers(values: NDArray[Any]) -> tuple[NDArray[Any], int]:
    """Return an array of rationals as integers over one positive denominator."""
    q = math.lcm(*(value.denominator for value in values.flat))
    return np.array([int(value * q) for value in values.flat], dtype=object).reshape(values.shape), q


def _bilinear(p: Polynomial, n: int) -> Polynomial:
    """Return `(1 - s)^n p((1 + s) / (1 - s))` of a polynomial of degree at most n."""
    total, (coefficients, q) = [0] * (n + 1), _over_one(p)
    for k, coefficient in enumerate(coefficients):
        rising = _power((Fraction(1), Fraction(1)), k)
        term = _multiply(rising, _power((Fraction(1), Fraction(-1)), n - k))
        total = [x + coefficient * y.numerator for x, y in zip(total, term, strict=True)]
    return tuple(Fraction(x, q) for x in total)


def _round(p: Polynomial) -> Polynomial:
    """Return the coefficients with `_BITS` binary digits."""
    result = []
    for coefficient in p:
        size = coefficient.numerator.bit_length() - coefficient.denominator.bit_length()
        unit = Fraction(2) ** (size - _BITS)
        result.append(round(coefficient / unit) * unit)
    return tuple(result)


def _power(p: Polynomial, n: int) -> Polynomial:
    result: Polynomial = (Fraction(1),)
    for _ in range(n):
        result = _multiply(result, p)
    return result


def _multiply(p: Polynomial, q: Polynomial) -> Polynomial:
    (left, below), (right, other) = _over_one(p), _over_one(q)
    product = [0] * (len(p) + len(q) - 1)
    for i, x in enumerate(left):
        for j, y in enumerate(right):
            product[i + j] += x * y
    return tuple(Fraction(x, below * other) for x in product)


def _over_one(p: Polynomial) -> tuple[list[int], int]:
    """Return the coefficients as integers over one positive denominator."""
    q = math.lcm(*(coefficient.denominator for coefficient in p))
    return [coefficient.numerator * (q // coefficient.denominator) for coefficient in p], q


def _is_hurwitz(p: Polynomial) -> bool:
    """Return whether all roots have negative real parts, by the first column of the Routh array, in integers.

    The first coefficient of a loop with all poles inside the circle is positive. Rows may be multiplied by positive
    numbers: each is divided by its greatest common divisor.
    """
    falling = _over_one(p)[0][::-1]
    upper, lower = falling[0::2], falling[1::2]
    for _ in range(len(p) - 1):
        if upper[0] <= 0:
            return False
        padded = [*lower, 0][: len(upper)]
        row = [lower[0] * x - upper[0] * y for x, y in zip(upper[1:], padded[1:], strict=True)]
        divisor = math.gcd(*row) or 1
        upper, lower = lower, [x // divisor for x in row]
    return upper[0] > 0


def _hold(damping: float, dt: float) -> float:
    return -math.expm1(-damping * dt) / damping if damping else dt
