"""Dryden turbulence, discretised exactly, and the moment of a gust.

References
----------
MIL-F-8785C, Military Specification: Flying Qualities of Piloted Airplanes, 1980, section 3.7 (low-altitude model).
MIL-HDBK-1797, Flying Qualities of Piloted Aircraft, 1997, section 4.9 (low-altitude model).
"""

import math
from collections.abc import Sequence
from decimal import Decimal, localcontext
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.waveforms import Dryden
from firmware_model.exact import DIGITS, power
from firmware_model.numerics.compiled import kernel
from firmware_model.types import Vector

FOOT = 0.3048
"""[m]."""
Array = NDArray[np.float64]


class DrydenState(NamedTuple):
    """State of the six shaping filters: `u` and `p` of first order, (v, r) and (w, q) of third order each.

    `u` [m/s] and `p` [rad/s] are the gusts themselves; the others combine to them, see `dryden_gust`.
    """

    u: float
    v1: float
    v2: float
    v3: float
    w1: float
    w2: float
    w3: float
    p: float


class TransverseParams(NamedTuple):
    """Discrete filter of v (or w) and its angular gust: `x+ = A x + B n`, A and B lower triangular, n standard normal.

    The outputs are `c1 x1 + c2 x2`, and its filtered derivative.
    """

    a11: float
    a21: float
    a22: float
    a31: float
    a32: float
    a33: float
    b11: float
    b21: float
    b22: float
    b31: float
    b32: float
    b33: float
    c1: float
    c2: float
    slope: float  # [1/m] r_gust = slope (v - x3), or q_gust for w


class DrydenParams(NamedTuple):
    """Discrete filters of one sample time; scalar ones `x+ = a x + b n` for u and p."""

    u_a: float
    """[-] of u."""
    u_b: float
    """[m/s] of u."""
    p_a: float
    """[-] of p."""
    p_b: float
    """[rad/s] of p."""
    v: TransverseParams
    """Filter of v and r, its units beside each number."""
    w: TransverseParams
    """Filter of w and q, its units beside each number."""


class DrydenSpectrum(NamedTuple):
    """Intensities and lengths of the low-altitude model at one height, as the specification states them."""

    sigma_u: float  # [m/s] along the mean wind
    sigma_v: float  # [m/s] across
    sigma_w: float  # [m/s] vertical
    L_u: float  # [m]
    L_v: float  # [m]
    L_w: float  # [m]
    sigma_p: float  # [rad/s] roll gust
    airspeed: float  # [m/s] at which the frozen field passes
    transverse: float  # [-] L_v and L_w times this, by the airspeed, are the time constants of v and w


def dryden_spectrum(dryden: Dryden, altitude: float, span: float) -> DrydenSpectrum:
    """Return intensities and lengths at `altitude` [m], for a `span` [m], MIL-F-8785C below 1000 ft (3.7.3.4).

    The roll gust's variance is the integral of its spectrum (3.7.1.2). The airspeed defaults to the mean wind: past a
    hovering vehicle the field moves at that speed. Heights below 10 ft count as 10 ft, the model's own floor.

    MIL-HDBK-1797 halves the transverse lengths and writes twice them where MIL-F-8785C writes them once. So below
    1000 ft the gusts are the same, in all spectra.
    """
    height = max(altitude / FOOT, 10.0)
    shear = 0.177 + 0.000823 * height
    sigma_w = 0.1 * dryden.wind_speed_20ft
    sigma_u = sigma_w / power(shear, 0.4)
    transverse = 2.0 if dryden.specification == "MIL-HDBK-1797" else 1.0
    L_u = height / power(shear, 1.2) * FOOT
    whole_L_w = height * FOOT
    third_root = power(math.pi * whole_L_w / (4.0 * span), 1.0 / 3.0)
    variance_p = sigma_w**2 / whole_L_w * 0.8 * third_root * math.pi**2 / (8.0 * span)
    return DrydenSpectrum(
        sigma_u=sigma_u,
        sigma_v=sigma_u,
        sigma_w=sigma_w,
        L_u=L_u,
        L_v=L_u / transverse,
        L_w=whole_L_w / transverse,
        sigma_p=math.sqrt(variance_p),
        airspeed=dryden.airspeed,
        transverse=transverse,
    )


@lru_cache(maxsize=256)
def dryden_filters(spectrum: DrydenSpectrum, span: float, dt: float) -> tuple[DrydenParams, Array]:
    """Return the exactly discretised filters for the step `dt` [s] and the factor (8, 8) of the stationary covariance.

    At each sample the joint distribution is that of the continuous filters: `A = exp(F dt)` and `B B^T = P - A P A^T`.
    P is the stationary covariance; the difference equals van Loan's integral of the noise over a step. An initial state
    `factor n` with n standard normal is stationary. All numbers are closed forms, rounded from 100 digits.
    """
    V = spectrum.airspeed
    v = _transverse(spectrum.sigma_v, spectrum.transverse * spectrum.L_v / V, 3.0 * span / (math.pi * V), dt)
    w = _transverse(spectrum.sigma_w, spectrum.transverse * spectrum.L_w / V, 4.0 * span / (math.pi * V), dt)
    # A gust field w(x) turns the air nose down where w grows ahead: q_gust = -dw/dx, and r_gust = +dv/dx.
    u = _first_order(spectrum.sigma_u, spectrum.L_u / V, dt)
    p = _first_order(spectrum.sigma_p, 4.0 * span / (math.pi * V), dt)
    v_r = TransverseParams._make((*v.numbers, math.pi / (3.0 * span)))
    w_q = TransverseParams._make((*w.numbers, -math.pi / (4.0 * span)))
    factor = np.zeros((8, 8))
    factor[0, 0], factor[7, 7] = spectrum.sigma_u, spectrum.sigma_p
    factor[1:4, 1:4], factor[4:7, 4:7] = v.stationary, w.stationary
    factor.flags.writeable = False
    return DrydenParams(*u, *p, v_r, w_q), factor


def _first_order(sigma: float, tau: float, dt: float) -> tuple[float, float]:
    """Return a and b of the filter of u or p, sigma sqrt(2 tau) / (1 + tau s)."""
    with localcontext(prec=DIGITS):
        steps = Decimal(dt) / Decimal(tau)
        return float((-steps).exp()), float(Decimal(sigma) * (1 - (-2 * steps).exp()).sqrt())


class _Transverse(NamedTuple):
    numbers: tuple[float, ...]
    stationary: Array


def _transverse(sigma: float, tau: float, lag: float, dt: float) -> _Transverse:
    """Return the filter of v or w and of the angular gust that it drives.

    v(s) / n(s) = sigma sqrt(tau) (1 + sqrt(3) tau s) / (1 + tau s)^2 gives variance sigma^2 for unit white noise. The
    angular gust is (s / V) / (1 + lag s) v(s). States: two first-order lags in a chain, then v low-passed by `lag`.

    The noise of a short step is a small difference of large covariances, and nearly singular. Doubles would leave half
    of its digits to the order in which a machine adds.
    """
    with localcontext(prec=DIGITS):
        alpha, beta, step = 1 / Decimal(tau), 1 / Decimal(lag), Decimal(dt)
        gain, root = Decimal(sigma) * alpha.sqrt(), Decimal(3).sqrt()
        c1, c2 = gain * root, gain * (1 - root)
        slow, fast = (-alpha * step).exp(), (-beta * step).exp()
        # Integrals over a step of exp(-beta (dt - s)) times exp(-alpha s), and times s exp(-alpha s).
        apart = beta - alpha
        once = (slow - fast) / apart if apart else step * slow
        twice = (step * slow - once) / apart if apart else step * step * slow / 2
        zero = Decimal(0)
        A = (
            (slow, zero, zero),
            (alpha * step * slow, slow, zero),
            (beta * (c1 * once + alpha * c2 * twice), beta * c2 * once, fast),
        )
        # F P + P F^T = -b b^T, solved entry by entry, as F is lower triangular and only the first lag has noise.
        p11 = 1 / (2 * alpha)
        p21 = p22 = p11 / 2
        p31 = beta * (c1 * p11 + c2 * p21) / (alpha + beta)
        p32 = (beta * (c1 * p21 + c2 * p22) + alpha * p31) / (alpha + beta)
        P = ((p11, p21, p31), (p21, p22, p32), (p31, p32, c1 * p31 + c2 * p32))
        Q = [
            [P[i][j] - sum(A[i][k] * P[k][n] * A[j][n] for k in range(3) for n in range(3)) for j in range(3)]
            for i in range(3)
        ]
        lower = [*_lower(A), *_lower(_factorize(Q)), c1, c2]
        return _Transverse(tuple(map(float, lower)), np.array(_factorize(P), dtype=np.float64))


def _lower(matrix: Sequence[Sequence[Decimal]]) -> list[Decimal]:
    return [matrix[i][j] for i in range(3) for j in range(i + 1)]


def _factorize(Q: Sequence[Sequence[Decimal]]) -> list[list[Decimal]]:
    """Return Cholesky's lower-triangular B with `B B^T = Q`; the last pivot may be 0 to rounding."""
    B = [[Decimal(0)] * 3 for _ in range(3)]
    for i in range(3):
        for j in range(i):
            B[i][j] = (Q[i][j] - sum(B[i][k] * B[j][k] for k in range(j))) / B[j][j]
        B[i][i] = max(Q[i][i] - sum(B[i][k] ** 2 for k in range(i)), Decimal(0)).sqrt()
    return B


Float8 = tuple[float, float, float, float, float, float, float, float]


@kernel
def dryden_step(params: DrydenParams, x: DrydenState, n: Float8) -> DrydenState:
    """Return the next filter state for eight standard normal numbers."""
    v1, v2, v3 = _step_transverse(params.v, (x.v1, x.v2, x.v3), (n[1], n[2], n[3]))
    w1, w2, w3 = _step_transverse(params.w, (x.w1, x.w2, x.w3), (n[4], n[5], n[6]))
    u, p = params.u_a * x.u + params.u_b * n[0], params.p_a * x.p + params.p_b * n[7]
    return DrydenState(u, v1, v2, v3, w1, w2, w3, p)


@kernel
def _step_transverse(f: TransverseParams, x: Vector, n: Vector) -> Vector:
    return (
        f.a11 * x[0] + f.b11 * n[0],
        f.a21 * x[0] + f.a22 * x[1] + f.b21 * n[0] + f.b22 * n[1],
        f.a31 * x[0] + f.a32 * x[1] + f.a33 * x[2] + f.b31 * n[0] + f.b32 * n[1] + f.b33 * n[2],
    )


@kernel
def dryden_gust(params: DrydenParams, x: DrydenState) -> tuple[Vector, Vector]:
    """Return the gust [m/s] B and the angular gust [rad/s] B of a filter state."""
    v = params.v.c1 * x.v1 + params.v.c2 * x.v2
    w = params.w.c1 * x.w1 + params.w.c2 * x.w2
    return (x.u, v, w), (x.p, params.w.slope * (w - x.w3), params.v.slope * (v - x.v3))


@kernel
def gust_moment(gain: float, yaw_ratio: float, gust_B: Vector) -> Vector:
    """Return the moment [N*m] B of a gust [m/s] B.

    Each rotor drags along with the air through its plane, F = c (gust), at a height h above the centre of mass.
    With r = (0, 0, -h), r x F = (h c v, -h c u, 0), so `gain` = h c [N*m/(m/s)]. Yaw comes from the rotors' unequal
    response to vertical gusts, `yaw_ratio` times that. On the stand mean wind is trimmed out and gives no moment. In
    free flight all relative air rolls and pitches the vehicle, and its own loop trims out the steady part.
    """
    return gain * gust_B[1], -gain * gust_B[0], yaw_ratio * gain * gust_B[2]
