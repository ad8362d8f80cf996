"""A law in IEEE single precision, step by step as its C: the twin of what `gustproof.law.write.c` writes.

Attitude, and every other state that nearly keeps its value from step to step, is held in two floats: what rounding
loses is kept. Products in their sums are exact to 2^-36. All other sums are plain. Euler kinematics are computed as
their excess over the body rates, which is small at small tilt, and so is its error. At a steep pitch, where no bound of
rounding is proved, the exact rotation is in plain floats.

References
----------
S. L. Moshier, Cephes, atanf.c (polynomial of the arc tangent).
T. J. Dekker, A floating-point technique for extending the available precision, Numer. Math. 18 (1971), 224-242.
D. E. Knuth, The Art of Computer Programming 2, 4.2.2 (the sum of two floats and what it loses).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gustproof.law.form import ANGLES, BODY_RATES, Law, Schedule
from gustproof.law.step import STEEP, schedule_factor

Array = NDArray[Any]
_F = np.float32
_SLOW = 0.99
"""[-] coefficient of a state in its own sum from which the sum is held in two floats."""
_COARSE_BITS = 12
"""Bits of a coarse factor: its products with halves of a float are exact."""


def single_number(value: float) -> str:
    """Return the shortest decimal of the float nearest to a number, as a constant of C."""
    text = repr(float(str(_F(value))))
    return f"{text}f"


def split(value: float) -> tuple[float, float]:
    """Return a factor as the sum of one of 12 bits and the float nearest to the rest."""
    mantissa, exponent = math.frexp(value)
    coarse = math.ldexp(float(round(mantissa * 2**_COARSE_BITS)), exponent - _COARSE_BITS)
    return coarse, float(_F(value - coarse))


class SingleLaw:
    """A law in single precision.

    Raises
    ------
    ValueError
        If the law reads the accelerometer: only laws of gyros have a single-precision form.
    """

    def __init__(self, law: Law) -> None:
        if law.uses_accelerometer:
            why = "no bound of its rounding is proved, as none of the specific force is known"
            raise ValueError(f"law '{law.name}' reads the accelerometer: {why}; single precision is for gyros alone")
        n = law.order
        self.law = law
        self.A = law.A + law.G @ np.eye(3, n, 3)
        """(n, n) state to next state; the Euler rates that G multiplies are an excess over the estimated rates."""
        slow = [i for i in range(n) if _SLOW <= self.A[i, i] <= 2.0 - _SLOW or (law.is_scheduled and i < 3)]
        self.wide: tuple[int, ...] = tuple(slow)
        """States that are held in two floats, attitude first; the second floats follow the states."""

    def step(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the next states with their second floats, and the command (3,), all floats."""
        law, n = self.law, self.law.order
        x, y = np.asarray(x, dtype=_F), np.asarray(y[:6], dtype=_F)
        none, limit = np.zeros((3, 6)), law.rate_limit
        over = np.zeros(3, dtype=_F)
        with np.errstate(all="ignore"):
            if limit is not None:
                s = _sums(np.hstack([limit.S, limit.T]), [*x[:n], *y])
                over = _rate_excess(x, s, limit.limits.astype(_F), law.attitude_limits.astype(_F))
            U, V = (none[:, :3], np.zeros((n, 3))) if limit is None else (limit.U, limit.V)
            P, Q, turned = none[:, :0], V[:, :0], over[:0]
            if law.schedule is not None:
                P, Q, turned = law.schedule.P, law.schedule.Q, _solve_schedule(law.schedule, x[:n], y)
            u = _sums(np.hstack([law.C, law.D, none, U, P]), [*x[:n], *y, *none[0].astype(_F), *over, *turned])
            command = _limit(u, law.limits.astype(_F))
            rates = euler_excess(x) if law.is_scheduled else np.zeros(3, dtype=_F)
            values = [*x[:n], *y, *rates, *(command - u), *over, *turned]
            matrix = np.hstack([self.A, law.B, law.G, law.H, V, Q])
            after = np.concatenate([_sums(matrix, values), np.zeros(len(self.wide), dtype=_F)])
            for k, i in enumerate(self.wide):
                after[i], after[n + k] = _wide_sum(matrix[i], values, i, x[n + k], exact=n + 6)
            if law.has_kinematics and abs(x[1]) > _F(STEEP):
                after[:3] += self._turn_angles(x) - _F(law.dt) * (x[3:6] + rates)
        return after, command

    def _turn_angles(self, x: Array) -> Array:
        """Return how far (3,) [rad] a sample at the estimated rates turns the angles, by the exact rotation."""
        a, b, c = _F(0.5) * _F(self.law.dt) * x[3:6]
        (sin_phi, cos_phi), (sin_theta, cos_theta) = _sin_cos(_F(0.5) * x[0]), _sin_cos(_F(0.5) * x[1])
        d, e, f, g = cos_phi * cos_theta, sin_phi * cos_theta, cos_phi * sin_theta, sin_phi * sin_theta
        w, i = d - e * a - f * b + g * c, d * a + e + f * c + g * b
        j, k = d * b - e * c + f - g * a, d * c + e * b - f * a - g
        right, down, two = _F(2.0) * (j * k + w * i), w * w - i * i - j * j + k * k, _F(2.0)
        phi = arctan2(right, down)
        sine, cosine = _sin_cos(phi)
        theta = arctan2(two * (w * j - i * k), right * sine + down * cosine)
        psi = arctan2(two * (i * j + w * k), w * w + i * i - j * j - k * k)
        return np.array([self.nearest(phi, x[0]) - x[0], theta - x[1], psi], dtype=_F)

    def nearest(self, angle: Array, to: Array) -> Array:
        """Return the angles [rad] whole turns from `angle` that are nearest to `to`."""
        angle, to = np.asarray(angle, dtype=_F), np.asarray(to, dtype=_F)
        return np.asarray(angle + _floor((to - angle) * _F(0.15915494) + _F(0.5)) * _F(6.2831855))


def sin_versine(x: np.float32) -> tuple[np.float32, np.float32]:
    """Return sine, and one minus the cosine, of an angle [rad] below 1e4."""
    n = _floor(x * _F(0.63661975) + _F(0.5))
    r = ((x - n * _F(1.5703125)) - n * _F(4.837513e-4)) - n * _F(7.54979e-8)
    z = r * r
    P, Q = (
        (-0.16666667, 8.3333333e-3, -1.9841270e-4, 2.7557319e-6),
        (-0.041666667, 1.3888889e-3, -2.4801587e-5, 2.7557319e-7),
    )
    s = r + r * z * (_F(P[0]) + z * (_F(P[1]) + z * (_F(P[2]) + z * _F(P[3]))))
    v = _F(0.5) * z + z * z * (_F(Q[0]) + z * (_F(Q[1]) + z * (_F(Q[2]) + z * _F(Q[3]))))
    one, two = _F(1.0), _F(2.0)
    quadrant = int(n - _F(4.0) * _floor(_F(0.25) * n)) if np.isfinite(n) else 0
    return ((s, v), (one - v, one + s), (-s, two - v), (v - one, one - s))[quadrant]


def arctan2(y: Any, x: Any) -> Any:
    """Return the angle of (`x`, `y`) in [-pi, pi] [rad]; 0 where both are 0."""
    a, b, one = abs(x), abs(y), _F(1.0)
    larger, smaller = max(a, b), min(a, b)
    upper = smaller > _F(0.41421357) * larger
    t = (smaller - larger if upper else smaller) / (smaller + larger if upper else larger if larger > 0.0 else one)
    z = t * t
    p = ((_F(8.0537445e-2) * z - _F(1.3877686e-1)) * z + _F(1.9977711e-1)) * z - _F(3.3332950e-1)
    angle = t + t * z * p + (_F(0.7853982) if upper else _F(0.0))
    angle = _F(1.5707964) - angle if b > a else angle
    angle = _F(3.1415927) - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


def euler_excess(x: Array) -> Array:
    """Return the Euler rates (3,) [rad/s] minus the body rates at the estimates `x`."""
    (sin_phi, flat_phi), (sin_theta, flat_theta) = sin_versine(x[0]), sin_versine(x[1])
    cos_theta = _F(1.0) - flat_theta
    if abs(cos_theta) < _F(0.05):
        cos_theta = _F(0.05) if cos_theta >= 0.0 else _F(-0.05)
        flat_theta = _F(1.0) - cos_theta
    psi_dot = (sin_phi * x[4] + (_F(1.0) - flat_phi) * x[5]) / cos_theta
    return np.array(
        [
            sin_theta * psi_dot,
            -flat_phi * x[4] - sin_phi * x[5],
            (sin_phi * x[4] + (flat_theta - flat_phi) * x[5]) / cos_theta,
        ],
        dtype=_F,
    )


def _sin_cos(x: np.float32) -> tuple[np.float32, np.float32]:
    sine, versine = sin_versine(x)
    return sine, _F(1.0) - versine


def _rate_excess(x: Array, s: Array, limits: Array, angles: Array) -> Array:
    p, q, r = _limit(s, limits)
    beyond = x[:2] - _limit(x[:2], angles[:2])
    (sin_phi, flat_phi), (sin_theta, flat_theta) = sin_versine(beyond[0]), sin_versine(beyond[1])
    cos_phi, across = _F(1.0) - flat_phi, (_F(1.0) - flat_theta) * r
    return np.array(
        [
            p - sin_theta * r - s[0],
            cos_phi * q + sin_phi * across - s[1],
            cos_phi * across - sin_phi * q - s[2],
        ],
        dtype=_F,
    )


def _solve_schedule(schedule: Schedule, x: Array, y: Array) -> Array:
    """Return the outputs of a schedule, by elimination without pivots."""
    k = len(schedule.parameters)
    sources = dict(zip((*ANGLES, *BODY_RATES), (x[0], x[1], *y[:3]), strict=True))
    share = np.zeros(k, dtype=_F)
    for i, (name, limit) in enumerate(zip(schedule.parameters, schedule.limits.tolist(), strict=True)):
        within = min(max(sources[name], -_F(limit)), _F(limit))
        if name in ANGLES:
            sine, flat = sin_versine(within)
            within = sine / (_F(1.0) + (_F(1.0) - flat))
        share[i] = within * _F(schedule_factor(name, limit))
    w = share * _sums(np.hstack([schedule.J, schedule.K]), [*x, *y])
    m = np.eye(k, dtype=_F) - share[:, None] * schedule.L.astype(_F)
    for c in range(k):
        for i in range(c + 1, k):
            factor = m[i, c] / m[c, c]
            m[i, c + 1 :] -= factor * m[c, c + 1 :]
            w[i] -= factor * w[c]
    for i in range(k - 1, -1, -1):
        for j in range(i + 1, k):
            w[i] -= m[i, j] * w[j]
        w[i] /= m[i, i]
    return w


def _floor(x: Any) -> Any:
    return np.floor(x)


def _limit(value: Array, limit: Array) -> Array:
    return np.where(value < -limit, -limit, np.where(value > limit, limit, value))


def _sums(matrix: Array, values: list[Any]) -> Array:
    totals = np.zeros(len(matrix), dtype=_F)
    for i, row in enumerate(matrix.tolist()):
        total = _F(0.0)
        for factor, value in zip(row, values, strict=False):
            if factor:
                total = total + _F(factor) * value
        totals[i] = total
    return totals


def _wide_sum(row: Array, values: list[Any], own: int, low: np.float32, exact: int) -> tuple[np.float32, np.float32]:
    """Return high and low part of a sum; products of the first `exact` values lose nothing."""
    kept = row[own] == 1.0
    total, rest = (values[own], low) if kept else (_F(0.0), _F(row[own]) * low)
    for j, (factor, value) in enumerate(zip(row.tolist(), values, strict=False)):
        if not factor or (kept and j == own):
            continue
        if abs(factor) == 1.0 or j >= exact:
            total, rest = _add(total, rest, _F(factor) * value)
            continue
        coarse, fine = split(factor)
        large = _F(4097.0) * value
        high = large - (large - value)
        total, rest = _add(total, rest, _F(coarse) * high)
        total, rest = _add(total, rest, _F(coarse) * (value - high))
        rest = rest + _F(fine) * value
    whole = total + rest
    return whole, rest - (whole - total)


def _add(total: Any, rest: Any, term: Any) -> tuple[Any, Any]:
    after = total + term
    part = after - total
    return after, rest + ((total - (after - part)) + (term - part))
