# SPDX-License-Identifier: BSD-3-Clause
# Copyright (c) 2026, the gustproof maintainers
"""Dryden turbulence as exactly discretised filters: one file for any simulator, which the standard library serves.

Copy it. Each number may be a float, or an array of numpy, JAX or torch with one entry an environment. `dryden_step` and
`dryden_gust` only add and multiply, so a batch needs no other form, and a compiler can trace them.

    air = low_altitude_spectrum(wind_speed_20ft=8.0, altitude=10.0, span=0.5)
    filters, factor = make_filters(air, span=0.5, dt=0.004)
    state = stationary_state(factor, rng.standard_normal((8, 10_000)))
    while flying:
        (u, v, w), (p, q, r) = dryden_gust(filters, state)
        state = dryden_step(filters, state, rng.standard_normal((8, 10_000)))

u, v, w [m/s] blow forward (along the mean wind), right and down; p, q, r [rad/s] turn the air about these axes. The
filters hold for one `dt`: for another make others. A state from zeros would take L / V [s], often ten seconds and more,
to grow to its strength, so start from `stationary_state`.

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

FOOT = 0.3048
"""[m]."""
DIGITS = 100
"""Decimal digits to compute with: the noise of a short step is a small difference of large numbers."""
Vector = tuple[float, float, float]
Matrix = tuple[tuple[float, ...], ...]


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


def low_altitude_spectrum(
    wind_speed_20ft: float, altitude: float, span: float, airspeed: float | None = None, *, handbook: bool = False
) -> DrydenSpectrum:
    """Return intensities and lengths at `altitude` [m] for a mean wind [m/s] at 20 ft, MIL-F-8785C 3.7.3.4.

    The roll gust's variance is the integral of its spectrum for a wing `span` [m] (3.7.1.2). `airspeed` [m/s] defaults
    to the mean wind: past a hovering vehicle the field moves at that speed. Heights below 10 ft count as 10 ft, the
    model's own floor.

    MIL-HDBK-1797 (`handbook`) halves the transverse lengths and writes twice them where MIL-F-8785C writes them once.
    So below 1000 ft the gusts are the same, in all spectra.

    Raises
    ------
    ValueError
        If a number has no meaning: above 1000 ft another model holds, and without airspeed no field passes.
    """
    airspeed = wind_speed_20ft if airspeed is None else airspeed
    if not (airspeed > 0.0 and span > 0.0 and altitude <= 1000.0 * FOOT):
        raise ValueError("airspeed and span must be positive, and altitude at most 304.8 m (1000 ft)")
    height = max(altitude / FOOT, 10.0)
    shear, transverse = 0.177 + 0.000823 * height, 2.0 if handbook else 1.0
    sigma_w = 0.1 * wind_speed_20ft
    sigma_u = sigma_w / _power(shear, 0.4)
    L_u, whole_L_w = height / _power(shear, 1.2) * FOOT, height * FOOT
    third_root = _power(math.pi * whole_L_w / (4.0 * span), 1.0 / 3.0)
    variance_p = sigma_w**2 / whole_L_w * 0.8 * third_root * math.pi**2 / (8.0 * span)
    sigmas, lengths = (sigma_u, sigma_u, sigma_w), (L_u, L_u / transverse, whole_L_w / transverse)
    return DrydenSpectrum(*sigmas, *lengths, math.sqrt(variance_p), airspeed, transverse)


@lru_cache  # it takes .2 ms, and all flights of a campaign share height and span
def _power(x: float, exponent: float) -> float:
    with localcontext(prec=DIGITS):
        return float(Decimal(x) ** Decimal(exponent))


def make_filters(spectrum: DrydenSpectrum, span: float, dt: float) -> tuple[DrydenParams, Matrix]:
    """Return the exactly discretised filters for the step `dt` [s] and the factor (8, 8) of the stationary covariance.

    At each sample the joint distribution is that of the continuous filters: `A = exp(F dt)` and `B B^T = P - A P A^T`.
    P is the stationary covariance; the difference equals van Loan's integral of the noise over a step. An initial state
    `factor n` with n standard normal is stationary. All numbers are closed forms, rounded from 100 digits.
    """
    V = spectrum.airspeed
    v, v_factor = _transverse(spectrum.sigma_v, spectrum.transverse * spectrum.L_v / V, 3.0 * span / (math.pi * V), dt)
    w, w_factor = _transverse(spectrum.sigma_w, spectrum.transverse * spectrum.L_w / V, 4.0 * span / (math.pi * V), dt)
    # A gust field w(x) turns the air nose down where w grows ahead: q_gust = -dw/dx, and r_gust = +dv/dx.
    u = first_order(spectrum.sigma_u, spectrum.L_u / V, dt)
    p = first_order(spectrum.sigma_p, 4.0 * span / (math.pi * V), dt)
    v_r = TransverseParams._make((*v, math.pi / (3.0 * span)))
    w_q = TransverseParams._make((*w, -math.pi / (4.0 * span)))
    blocks = ((0, ((spectrum.sigma_u,),)), (1, v_factor), (4, w_factor), (7, ((spectrum.sigma_p,),)))
    factor = [[0.0] * 8 for _ in range(8)]
    for at, block in blocks:
        for i, row in enumerate(block):
            factor[at + i][at : at + len(row)] = row
    return DrydenParams(*u, *p, v_r, w_q), tuple(map(tuple, factor))


def first_order(sigma: float, tau: float, dt: float) -> tuple[float, float]:
    """Return a and b of the filter of u or p, sigma sqrt(2 tau) / (1 + tau s)."""
    with localcontext(prec=DIGITS):
        steps = Decimal(dt) / Decimal(tau)
        return float((-steps).exp()), float(Decimal(sigma) * (1 - (-2 * steps).exp()).sqrt())


def _transverse(sigma: float, tau: float, lag: float, dt: float) -> tuple[tuple[float, ...], Matrix]:
    """Return the numbers of the filter of v or w, and of its angular gust, and the factor of its covariance.

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
        lower = [M[i][j] for M in (A, factorize(Q)) for i in range(3) for j in range(i + 1)]
        return tuple(map(float, (*lower, c1, c2))), tuple(tuple(map(float, row)) for row in factorize(P))


def factorize(Q: Sequence[Sequence[Decimal]]) -> list[list[Decimal]]:
    """Return Cholesky's lower-triangular B with `B B^T = Q`; a pivot may be 0, to rounding."""
    B = [[Decimal(0)] * len(Q) for _ in Q]
    for i in range(len(Q)):
        for j in range(i):
            B[i][j] = (Q[i][j] - sum(B[i][k] * B[j][k] for k in range(j))) / B[j][j] if B[j][j] else Decimal(0)
        B[i][i] = max(Q[i][i] - sum(B[i][k] ** 2 for k in range(i)), Decimal(0)).sqrt()
    return B


def dryden_step(params: DrydenParams, x: DrydenState, n: Sequence[float]) -> DrydenState:
    """Return the next filter state for eight standard normal numbers."""
    v1, v2, v3 = transverse_step(params.v, (x.v1, x.v2, x.v3), (n[1], n[2], n[3]))
    w1, w2, w3 = transverse_step(params.w, (x.w1, x.w2, x.w3), (n[4], n[5], n[6]))
    u, p = params.u_a * x.u + params.u_b * n[0], params.p_a * x.p + params.p_b * n[7]
    return DrydenState(u, v1, v2, v3, w1, w2, w3, p)


def transverse_step(f: TransverseParams, x: Vector, n: Vector) -> Vector:
    """Return the next state of the filter of v or w."""
    return (
        f.a11 * x[0] + f.b11 * n[0],
        f.a21 * x[0] + f.a22 * x[1] + f.b21 * n[0] + f.b22 * n[1],
        f.a31 * x[0] + f.a32 * x[1] + f.a33 * x[2] + f.b31 * n[0] + f.b32 * n[1] + f.b33 * n[2],
    )


def dryden_gust(params: DrydenParams, x: DrydenState) -> tuple[Vector, Vector]:
    """Return the gust [m/s] B and the angular gust [rad/s] B of a filter state."""
    v = params.v.c1 * x.v1 + params.v.c2 * x.v2
    w = params.w.c1 * x.w1 + params.w.c2 * x.w2
    return (x.u, v, w), (x.p, params.w.slope * (w - x.w3), params.v.slope * (v - x.v3))


def stationary_state(factor: Matrix, n: Sequence[float]) -> DrydenState:
    """Return a state at full strength for eight standard normal numbers."""
    return DrydenState(*(sum(row[j] * n[j] for j in range(8) if row[j]) for row in factor))
