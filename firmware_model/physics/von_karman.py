"""Von Karman turbulence by rational filters, discretised so that its samples have exactly their law.

The spectra fall with the frequency to the power 5/3, which no filter of finite order does. Those here are of order
five, and have the standard's variances. Up to Omega L = 740 their spectra are within .72 % of the standard's along the
wind, and within 1.4 % across it. Beyond, they fall with the square. The roll gust is that of `gust_filters`. Pitch and
yaw follow w and v as there.

Each filter is a sum of first-order lags of one white noise, so it steps in closed form. It sends out two numbers a
sample, v and r. The flight steps the estimate of the lags that an observer of these numbers has, the Kalman filter's.
Its outputs are the same process, and two normal numbers a sample drive it in place of six.

References
----------
MIL-F-8785C, Military Specification: Flying Qualities of Piloted Airplanes, 1980, sections 3.7.1.1 and 3.7.3.4.
E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, Structure-preserving algorithms for periodic discrete-time algebraic
Riccati equations, International Journal of Control 77, 2004: the doubling iteration.
"""

import math
from collections.abc import Sequence
from decimal import Decimal, localcontext
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.numerics.compiled import kernel
from firmware_model.physics.gust_filters import (
    DrydenParams,
    DrydenSpectrum,
    DrydenState,
    TransverseParams,
    factorize,
    first_order,
)

Array = NDArray[Any]
"""(n,) or (n, m) of decimals; a factor is of floats."""
Five = tuple[float, float, float, float, float]
Six = tuple[float, float, float, float, float, float]
LENGTH = 1.339
"""[-] of the standard's spectra: x = 1.339 L Omega."""
ALONG = (0.910644, 0.228934, 0.0438054, 0.00826258, 0.00141756), (0.299477, 0.0578021, 0.0109212, 0.00195543)
"""[-] time constants of poles and zeros, by 1.339 L / V, of 1 / (1 + x^2)^(5/6)."""
ACROSS = (1.818, 0.593947, 0.0838215, 0.0124485, 0.00172999), (2.22564, 0.115231, 0.0171122, 0.00245732)
"""[-] the same of (1 + 8/3 x^2) / (1 + x^2)^(11/6)."""
_DIGITS = 200
_LEAST_APART = Decimal("1e-6")  # [-] of a pole and the lag of an angular gust: nearer, their parts would cancel


class AlongParams(NamedTuple):
    """Filter of u: each lag steps by `a x + b n`, n standard normal, and u is the sum of `c x`."""

    a: Five
    """[-]."""
    b: Five
    """[s^.5]."""
    c: Five
    """[m/s^1.5]."""


class AcrossParams(NamedTuple):
    """Filter of v or w: each lag steps by `a x + b n + d m`, n and m standard normal."""

    a: Six
    """[-]."""
    b: Six
    """[s^.5]."""
    d: Six
    """[s^.5]."""
    c: Six
    """[m/s^1.5] the gust is the sum of `c x`."""
    e: Six
    """[rad/s^1.5] the angular gust is the sum of `e x`."""


class KarmanParams(NamedTuple):
    """Discrete filters of one sample time."""

    acts: float
    """[-] 1 if there is such turbulence, else 0."""
    u: AlongParams
    """Filter of u, units beside each number."""
    v: AcrossParams
    """Filter of v and r, units beside each number."""
    w: AcrossParams
    """Filter of w and q, units beside each number."""
    p_a: float
    """[-] of p."""
    p_b: float
    """[rad/s] of p."""


class KarmanState(NamedTuple):
    """Lags of the filters, each of white noise of unit density, and the roll gust."""

    u: Five
    """[s^.5]."""
    v: Six
    """[s^.5]."""
    w: Six
    """[s^.5]."""
    p: float
    """[rad/s]."""


_NO_U, _NO_V = AlongParams(*[(0.0,) * 5] * 3), AcrossParams(*[(0.0,) * 6] * 5)
NO_KARMAN = KarmanParams(0.0, _NO_U, _NO_V, _NO_V, 0.0, 0.0)
"""Filters without such turbulence."""
STILL = KarmanState((0.0,) * 5, (0.0,) * 6, (0.0,) * 6, 0.0)
"""Their state."""
_NO_SIDE = TransverseParams(*[0.0] * 15)
CALM = DrydenParams(0.0, 0.0, 0.0, 0.0, _NO_SIDE, _NO_SIDE)
"""Filters without Dryden turbulence."""
_SHOWN_SIDE = _NO_SIDE._replace(c1=1.0, slope=1.0)
SHOWN = CALM._replace(v=_SHOWN_SIDE, w=_SHOWN_SIDE)
"""Filters whose `dryden_gust` shows the state that `show_gust` returns."""


@lru_cache(maxsize=256)
def karman_filters(spectrum: DrydenSpectrum, span: float, dt: float) -> tuple[KarmanParams, Array]:
    """Return the filters for the step `dt` [s], and the factor (18, 18) of their stationary covariance.

    Intensities and lengths are those that the Dryden model has, as is the wing `span` [m] of the angular gusts.
    """
    V, whole = spectrum.airspeed, spectrum.transverse / spectrum.airspeed
    r_lag, q_lag = (spans * span / (math.pi * V) for spans in (3.0, 4.0))
    with localcontext(prec=_DIGITS):
        rates, residues = _design(ALONG, spectrum.sigma_u, spectrum.L_u / V)
        along, u_factor = _discretise(rates, np.array([residues]), dt)
        v = _add_angular(_design(ACROSS, spectrum.sigma_v, whole * spectrum.L_v), r_lag, math.pi / (3.0 * span))
        w = _add_angular(_design(ACROSS, spectrum.sigma_w, whole * spectrum.L_w), q_lag, -math.pi / (4.0 * span))
        (v_side, v_factor), (w_side, w_factor) = (_discretise(*each, dt) for each in (v, w))
    filters = AlongParams(*along), AcrossParams(*v_side), AcrossParams(*w_side)  # type: ignore[arg-type]
    factor = np.zeros((18, 18))
    factor[:5, :5], factor[5:11, 5:11], factor[11:17, 11:17] = u_factor, v_factor, w_factor
    factor[17, 17] = spectrum.sigma_p
    factor.flags.writeable = False
    return KarmanParams(1.0, *filters, *first_order(spectrum.sigma_p, q_lag, dt)), factor


def _design(shape: tuple[Sequence[float], Sequence[float]], sigma: float, tau: float) -> tuple[Array, Array]:
    """Return poles [1/s] and residues [m/s^1.5] of a filter of unit white noise, with variance `sigma` [m/s] squared.

    `tau` [s] is the length over the airspeed.
    """
    poles, zeros = (np.array([Decimal(each) * Decimal(LENGTH) * Decimal(tau) for each in part]) for part in shape)
    rates = 1 / poles
    others = np.where(np.eye(len(poles)), poles[:, None], 1 - np.outer(rates, poles))
    residues = np.prod(1 - np.outer(rates, zeros), axis=1) / np.prod(others, axis=1)
    variance = residues @ (1 / np.add.outer(rates, rates)) @ residues
    return rates, residues * (Decimal(sigma) / variance.sqrt())


def _add_angular(gust: tuple[Array, Array], lag: float, slope: float) -> tuple[Array, Array]:
    """Return the poles with that of an angular gust, and the residues of both: `slope` times the gust less its lag."""
    (rates, residues), fast = gust, 1 / Decimal(lag)
    while np.min(abs(fast / rates - 1)) < _LEAST_APART:
        fast *= 1 + 2 * _LEAST_APART
    shares = residues * fast / (fast - rates)
    angular = Decimal(slope) * np.array([*(residues - shares), np.sum(shares)])
    return np.array([*rates, fast]), np.array([[*residues, Decimal(0)], angular])


def _discretise(rates: Array, C: Array, dt: float) -> tuple[list[tuple[float, ...]], Array]:
    """Return the rows of a filter's parameters, and the factor of its stationary covariance.

    They are of an observer of the outputs `C x`: the decay of each lag, its noise from each output, then `C`.
    """
    both, step = np.add.outer(rates, rates), Decimal(dt)
    decay = np.exp(-rates * step)
    Q = (1 - np.exp(-both * step)) / both
    P = _unseen(decay, Q, C)
    seen = (P * np.outer(decay, decay) + Q) @ C.T
    noise = seen @ _inverse(np.array(factorize((C @ seen).tolist()))).T
    rest = np.array(factorize((1 / both - P).tolist()), dtype=np.float64)
    return [tuple(map(float, row)) for row in (decay, *noise.T, *C)], rest


def _unseen(decay: Array, Q: Array, C: Array) -> Array:
    """Return the covariance of the states that outputs `C x`, known at each sample without error, leave open.

    It solves the Riccati equation of an observer that has each sample's output of the next, by doubling.
    """
    shared, H = Q @ C.T, C * decay
    weight = _inverse(C @ shared)
    gain = shared @ weight
    F, G, X = (np.diag(decay) - gain @ H).T, H.T @ weight @ H, Q - gain @ shared.T
    while True:
        W = _inverse(np.diag([Decimal(1)] * len(decay)) + G @ X)
        added = F.T @ X @ W @ F
        F, G, X = F @ W @ F, G + F @ W @ G @ F.T, X + added
        if max(np.diag(added) / np.diag(X)) < Decimal("1e-60"):
            return np.asarray(X)


def _inverse(A: Array) -> Array:
    """Return the inverse, by elimination with the largest pivot of each column."""
    n = len(A)
    rows = np.hstack([A, np.diag([Decimal(1)] * n)])
    for k in range(n):
        best = k + int(np.argmax(abs(rows[k:, k])))
        rows[[k, best]] = rows[[best, k]]
        rows[k] = rows[k] / rows[k, k]
        others = np.arange(n) != k
        rows[others] = rows[others] - np.outer(rows[others, k], rows[k])
    return rows[:, n:]


@kernel
def karman_step(f: KarmanParams, x: KarmanState, n: tuple[float, ...]) -> KarmanState:
    """Return the next state for eight standard normal numbers, those of Dryden turbulence; it uses six."""
    u, a, b = x.u, f.u.a, f.u.b
    along = (
        a[0] * u[0] + b[0] * n[0],
        a[1] * u[1] + b[1] * n[0],
        a[2] * u[2] + b[2] * n[0],
        a[3] * u[3] + b[3] * n[0],
        a[4] * u[4] + b[4] * n[0],
    )
    return KarmanState(
        along, _step_across(f.v, x.v, n[1], n[2]), _step_across(f.w, x.w, n[4], n[5]), f.p_a * x.p + f.p_b * n[7]
    )


@kernel
def _step_across(f: AcrossParams, x: Six, n: float, m: float) -> Six:
    a, b, d = f.a, f.b, f.d
    return (
        a[0] * x[0] + b[0] * n + d[0] * m,
        a[1] * x[1] + b[1] * n + d[1] * m,
        a[2] * x[2] + b[2] * n + d[2] * m,
        a[3] * x[3] + b[3] * n + d[3] * m,
        a[4] * x[4] + b[4] * n + d[4] * m,
        a[5] * x[5] + b[5] * n + d[5] * m,
    )


@kernel
def _sum_six(c: Six, x: Six) -> float:
    return c[0] * x[0] + c[1] * x[1] + c[2] * x[2] + c[3] * x[3] + c[4] * x[4] + c[5] * x[5]


@kernel
def show_gust(f: KarmanParams, x: KarmanState) -> DrydenState:
    """Return the state that `dryden_gust` shows as these gusts, with the filters `SHOWN`: all that a flight reads."""
    c, u = f.u.c, x.u
    v, w = _sum_six(f.v.c, x.v), _sum_six(f.w.c, x.w)
    along = c[0] * u[0] + c[1] * u[1] + c[2] * u[2] + c[3] * u[3] + c[4] * u[4]
    return DrydenState(along, v, 0.0, v - _sum_six(f.v.e, x.v), w, 0.0, w - _sum_six(f.w.e, x.w), x.p)
