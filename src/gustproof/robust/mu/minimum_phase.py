"""Rational functions fitted to logarithms of responses, stable with stable inverses by their very form."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix, gain, series
from gustproof.robust.uncertain.uncertain_system import stack

_LEAST_DAMPING, _MOST_DAMPING = 0.1, 30.0
"""[-] limits of the damping of each pair of poles and of zeros."""
_REACH = 10.0
"""[-] factor by which poles and zeros may lie outside the frequencies fitted."""
_ROUNDS = 100
"""Most evaluations of the least-squares search, for each order."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MinimumPhase:
    """A gain times sections `(s^2 + 2 d z s + z^2) / (s^2 + 2 e p s + p^2)`, and `(s + z) / (s + p)` at odd order."""

    order: int
    """Number of poles, and of zeros."""
    theta: Matrix
    """(2 order + 1,) logarithms: z, d, p, e of each section, then z and p of the odd one, then the gain."""

    def log_response(self, omega: Matrix) -> ComplexMatrix:
        """Return the logarithm of the response, (k,), its phase continuous and 0 at both ends, at `omega` [rad/s]."""
        total = np.full(omega.shape, self.theta[-1], dtype=np.complex128)
        for z, d, p, e in self._pairs():
            total += np.log(z**2 - omega**2 + 2j * d * z * omega) - np.log(p**2 - omega**2 + 2j * e * p * omega)
        if self.order % 2:
            z, p = np.exp(self.theta[-3:-1])
            total += np.log(1j * omega + z) - np.log(1j * omega + p)
        return total

    def system(self) -> Lti:
        """Return the function as a system of `order` states."""
        whole = gain(np.exp(self.theta[-1]))
        for z, d, p, e in self._pairs():
            A, B = np.array([[0.0, p], [-p, -2.0 * e * p]]), np.array([[0.0], [p]])
            C = np.array([[(z / p) ** 2 - 1.0, 2.0 * (d * z - e * p) / p]])
            whole = series(whole, Lti(A=A, B=B, C=C, D=np.eye(1)))
        if self.order % 2:
            z, p = np.exp(self.theta[-3:-1])
            whole = series(whole, Lti(A=np.array([[-p]]), B=np.array([[p]]), C=np.array([[z / p - 1.0]]), D=np.eye(1)))
        return whole

    def _pairs(self) -> Sequence[Matrix]:
        count = self.order // 2
        return list(np.exp(self.theta[: 4 * count]).reshape(count, 4))


def fit_factors(omega: Matrix, target: ComplexMatrix, weight: Matrix, order: int) -> tuple[MinimumPhase, MinimumPhase]:
    """Return `a` and `b` of an order with `log a + conj(log b)` near `target`, in weighted least squares.

    A real target is a squared magnitude: then `a = b` is its spectral factor. Otherwise the phase of `a / b` follows
    the imaginary part.

    Parameters
    ----------
    omega
        (k,) [rad/s] positive frequencies.
    target
        (k,) logarithm of a multiplier.
    weight
        (k,) of each error.
    order
        Number of poles of each factor.
    """
    twins = not (order and np.any(target.imag))
    start = _start(omega, float(np.average(target.real, weights=weight)) / 2.0, order)
    low, high = _limits(omega, order)
    if not twins:  # both have one gain, the last parameter of all
        start, low, high = (np.concatenate([part[:-1], part]) for part in (start, low, high))

    def factors(theta: Matrix) -> tuple[MinimumPhase, MinimumPhase]:
        b = MinimumPhase(order=order, theta=theta[-1 - 4 * (order // 2) - 2 * (order % 2) :])
        return (b if twins else MinimumPhase(order=order, theta=np.append(theta[: b.theta.size - 1], theta[-1]))), b

    def errors(theta: Matrix) -> Matrix:
        a, b = factors(theta)
        off = (a.log_response(omega) + b.log_response(omega).conj() - target) * weight
        return np.asarray(off.real if twins else np.concatenate([off.real, off.imag]), dtype=np.float64)

    found = scipy.optimize.least_squares(errors, start, bounds=(low, high), max_nfev=_ROUNDS, ftol=1e-6, xtol=1e-6)
    return factors(np.asarray(found.x, dtype=np.float64))


def fit_least_order(
    omega: Matrix, target: ComplexMatrix, weight: Matrix, *, most: int, tolerance: float
) -> tuple[MinimumPhase, MinimumPhase]:
    """Return the factors of the least order, up to `most`, whose largest weighted error is at most `tolerance`.

    The factors with the least such error are returned if no order suffices.
    """
    best, least = None, np.inf
    for order in range(most + 1):
        a, b = fit_factors(omega, target, weight, order)
        off = float(np.max(np.abs(a.log_response(omega) + b.log_response(omega).conj() - target) * weight))
        if best is None or off < least:
            best, least = (a, b), off
        if least <= tolerance:
            break
    assert best is not None
    return best


def is_positive_real(a: MinimumPhase, b: MinimumPhase) -> bool:
    """Return whether `conj(b) a` has a positive real part everywhere: `(a - b) / (a + b)` is below 1."""
    if a is b:
        return True
    both = stack(a.system(), b.system()).M
    total, difference = np.array([[1.0, 1.0]]), np.array([[1.0, -1.0]])
    one = np.ones((2, 1))
    A, B, C, D = both.A, both.B @ one, both.C, both.D @ one
    E = 1.0 / float((total @ D)[0, 0])
    ratio = Lti(
        A=A - B @ (E * total @ C),
        B=E * B,
        C=difference @ C - difference @ D @ (E * total @ C),
        D=E * difference @ D,
    )
    return ratio.is_stable() and hinf_norm(ratio).gain < 1.0


def _start(omega: Matrix, level: float, order: int) -> Matrix:
    """Return parameters with zeros upon poles, spread over the frequencies; all dampings 1."""
    places = np.log(np.geomspace(omega[0], omega[-1], order // 2 + order % 2 + 2)[1:-1])
    pairs = [value for place in places[: order // 2] for value in (place + 0.1, 0.0, place - 0.1, 0.0)]
    single = [places[-1] + 0.1, places[-1] - 0.1] if order % 2 else []
    return np.array([*pairs, *single, level])


def _limits(omega: Matrix, order: int) -> tuple[Matrix, Matrix]:
    ends = np.log([omega[0] / _REACH, omega[-1] * _REACH])
    damping = np.log([_LEAST_DAMPING, _MOST_DAMPING])
    low, high = (
        [*[ends[k], damping[k]] * (order - order % 2), *[ends[k]] * (2 * (order % 2)), limit]
        for k, limit in ((0, -np.inf), (1, np.inf))
    )
    return np.array(low), np.array(high)
