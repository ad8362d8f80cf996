"""Upper bounds of the deviations of a linear loop in Gaussian air, sample by sample from rest.

Part of the check: doubles with bounds of their rounding. Loop, air and the sum W of the gyro's noise are one system
`x+ = F x + n`, with the loop of `kernel_norms`. Initially the air is stationary and all else 0. The covariance is

    P+ = F P F' + Q + D,    D = eps n diag(u_i^2),    u = |F| sqrt(diag P).

**Rounding.** A product of these matrices in doubles, with F within some roundings of the true one, is wrong by at most
`eps u_i u_j` in entry (i, j), since `|P_ij| <= sqrt(P_ii P_jj)`. The quadratic form of that error is at most `eps
(sum_i |y_i| u_i)^2 <= eps n sum_i u_i^2 y_i^2`, that of D. So P stays an upper bound of the true covariance, by
induction, and the same argument bounds the variance of an output.

**Tail.** A normal number is beyond z of its deviations with a probability below `(4/5) exp(-z^2 / 2) / z`. Samples are
added up, however they depend on each other (Boole's inequality).
"""

import math
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gustproof.checker.dryden_air import DrydenAir
from gustproof.checker.kernel_norms import COMMAND, OMEGA, TORQUE, UP, X0, sample_map, unit_loop
from gustproof.checker.rational import RationalMatrix, add, exp_lower_bound, multiply, round_up, scale, transpose
from gustproof.checker.system import LoopSystem, Refusal

Array = NDArray[np.float64]
_EPS = 2.0**-44
"""[-] two hundred roundings: 8 in each F, two products of at most 30 terms each, and the sums."""
_MOST_ORDER = 30
_CHUNKS = 240
"""Segments of the flight, in each of which a deviation counts as its largest."""
_FAR = Fraction(12)
"""[-] deviations; the tail beyond is below 1e-32."""
_ROOT = Fraction(math.floor(exp_lower_bound(Fraction(1, 16)) * (1 << 96)), 1 << 96)
"""[-] number not above exp(1/16)."""


class Deviations(NamedTuple):
    """Largest deviations over the flight, by axis."""

    signals: list[list[Fraction]]
    """(3, m + 2) loop's states, the rate's change over a sample, and command minus torque."""
    acceleration: list[Fraction]
    """(3,) [rad/s^2] of the air's, held over a sample."""
    angle: list[list[Fraction]]
    """(3, segments) [rad] of the law's attitude less the noise that it has summed up: the true angle."""
    samples: int
    """Samples of a segment."""


@lru_cache(maxsize=4)
def loop_deviations(system: LoopSystem, air: DrydenAir) -> Deviations:
    """Return the deviations of the linear loop in the air, for nominal inertia and lag.

    Raises
    ------
    Refusal
        If a deviation grows without bound, or the law has too many states.
    """
    F, Q, P, rows, m = _stack(system, air)
    n = rows.shape[2]
    size, outputs = np.abs(F), np.abs(rows)
    length = -(-(air.steps + 2) // _CHUNKS)
    peaks = np.zeros((_CHUNKS, 3, rows.shape[1]))
    FT, diagonal = F.transpose(0, 2, 1), np.arange(n)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(_CHUNKS * length):
            s = np.sqrt(np.maximum(P[:, diagonal, diagonal], 0.0))[:, :, None]
            seen = (rows @ P * rows).sum(axis=2) + _EPS * n * (outputs @ s)[:, :, 0] ** 2
            peaks[k // length] = np.maximum(peaks[k // length], seen)
            u = size @ s
            P = F @ P @ FT
            P = 0.5 * (P + P.transpose(0, 2, 1)) + Q
            P[:, diagonal, diagonal] += _EPS * n * u[:, :, 0] ** 2
    if not np.all(np.isfinite(peaks)):
        raise Refusal("the loop diverges within the flight")
    sigmas = UP * np.sqrt(peaks)
    whole = np.max(sigmas, axis=0)
    return Deviations(
        signals=[[Fraction(value) for value in row[: m + 2].tolist()] for row in whole],
        acceleration=[Fraction(value) for value in whole[:, m + 2].tolist()],
        angle=[[Fraction(value) for value in row.tolist()] for row in sigmas[:, :, m + 3].T],
        samples=length,
    )


def _stack(system: LoopSystem, air: DrydenAir) -> tuple[Array, Array, Array, Array, int]:
    """Return F, Q and the first P (3, n, n), outputs (3, outputs, n) and the number of the loop's states.

    States are those of the loop, W, and the air's; axes with fewer have some that stay 0.
    """
    m = X0 + len(system.A) // 3
    n = m + 1 + max(len(axis.A) for axis in air.axes)
    if n > _MOST_ORDER:
        raise Refusal(f"law '{system.name}' has too many states for a bound of the rounding")
    F, Q, P, rows = (np.stack(each) for each in zip(*(_fill(system, air, i, m, n) for i in range(3)), strict=True))
    for M in (P, Q):  # their own rounding, before u counts it
        M[:, range(n), range(n)] *= 1.0 + n * _EPS
    return F, Q, P, rows, m


def _fill(system: LoopSystem, air: DrydenAir, i: int, m: int, n: int) -> tuple[Array, Array, Array, Array]:
    """Return F, Q, P (n, n) and outputs (m + 4, n) of axis i, whose loop has m states."""
    A, stationary = ([list(row) for row in rows] for rows in (air.axes[i].A, air.axes[i].P))
    at, W, sigma = slice(m + 1, m + 1 + len(A)), m, float(air.noise) * UP
    Phi, units = unit_loop(system, i)
    # the air's acceleration is held: it adds the integral of exp(-damping s)
    push = sample_map(system, i, float(1 / system.lag))[3][0]
    pairs = zip(air.axes[i].moment, air.axes[i].turn, strict=True)
    acceleration = _floats([[a / system.inertia[i] + b for a, b in pairs]])
    F = np.zeros((n, n))
    F[:m, :m], F[W, W] = Phi[0], 1.0
    F[OMEGA, at] = push * acceleration[0]
    F[at, at] = _floats(A)
    P = np.zeros((n, n))
    P[at, at] = _floats(stationary)
    noise = np.zeros(n)
    noise[:m], noise[W] = sigma * units[0, :, -1], -sigma * float(system.dt)
    Q = np.outer(noise, noise)
    Q[at, at] += _floats(add(stationary, scale(-1, multiply(multiply(A, stationary), transpose(A)))))
    rows = np.zeros((m + 4, n))
    rows[:m, :m] = np.eye(m)
    rows[m] = F[OMEGA]
    rows[m, OMEGA] -= 1.0
    rows[m + 1, COMMAND], rows[m + 1, TORQUE] = 1.0, -1.0
    rows[m + 2, at] = acceleration[0]
    rows[m + 3, X0] = rows[m + 3, W] = 1.0
    return F, Q, P, rows


def _floats(rows: RationalMatrix) -> Array:
    return np.array([[float(value) for value in row] for row in rows])


def least_angle(sigmas: list[Fraction], samples: int, risk: Fraction) -> Fraction:
    """Return a bound that normal numbers of these deviations, `samples` of each, exceed with the risk at most."""
    floats = [float(value) for value in sigmas]
    low, high = 0.0, float(_FAR) * max(floats)
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        ratios = [middle / value for value in floats if value]
        total = sum(0.8 * math.exp(-0.5 * z * z) / z for z in ratios) * samples
        low, high = (low, middle) if total <= float(risk) else (middle, high)
    bound = Fraction(high)
    while samples * sum((_tail(bound, value) for value in sigmas), Fraction(0)) > risk:
        bound *= Fraction(1001, 1000)
        if bound > _FAR * max(sigmas):
            raise Refusal(f"no bound of the air is known for a risk of {float(risk)}")
    return bound


def _tail(bound: Fraction, sigma: Fraction) -> Fraction:
    """Return a bound of the probability that a normal number of deviation `sigma` is beyond `bound`."""
    z = min(bound / sigma, _FAR) if sigma else _FAR
    return _tail_of(math.floor(8 * z * z)) if z > 1 else Fraction(1)


@lru_cache(maxsize=2048)
def _tail_of(sixteenths: int) -> Fraction:
    """Return a bound of the probability of deviations whose half square is at least so many sixteenths."""
    z = Fraction(math.isqrt(sixteenths << 29), 1 << 16)  # sqrt(sixteenths / 8), rounded down
    return round_up(Fraction(4, 5) / (z * _ROOT**sixteenths), 128)
