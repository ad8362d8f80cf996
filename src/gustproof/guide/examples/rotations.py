"""Strapdown rotation matrix of the gyro alone, and errors between rotations, in scalars: fastest in plain Python.

The examples share it, and the choice of their gains.

A rotation matrix is a tuple of its nine entries, row by row. It takes components from B to N.

References
----------
T. Lee, M. Leok, N. H. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3), IEEE Conference on Decision
and Control 2010, equation (10): the attitude error.
"""

import math
from collections.abc import Iterable, Mapping

from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.types import Vector

Rotation = tuple[float, float, float, float, float, float, float, float, float]

LEVEL: Rotation = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_SMALL = 1e-3
"""[rad] angle below which series of two terms are exact to rounding."""


def as_vector(v: Iterable[float]) -> Vector:
    """Return three numbers as floats of Python, the fastest to compute with one by one."""
    x, y, z = map(float, v)
    return x, y, z


class RotationEstimate:
    """Attitude by the gyro, from level: each step turns about the mean of the newest two rates, the trapezoidal rule.

    Each turn is exact, so the matrix keeps its orthonormality up to rounding, 1e-13 after a million steps.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Return to level, at rest."""
        self.R_NB: Rotation = LEVEL
        self._rate: Vector = (0.0, 0.0, 0.0)

    def update(self, gyro: Vector, dt: float) -> Rotation:
        """Return the attitude at the instant of a gyro sample [rad/s], `dt` [s] after the previous one."""
        p, q, r = self._rate
        half = 0.5 * dt
        x, y, z = half * (p + gyro[0]), half * (q + gyro[1]), half * (r + gyro[2])
        self._rate = gyro
        square = x * x + y * y + z * z
        angle = math.sqrt(square)
        if angle < _SMALL:
            sine, versine = 1.0 - square / 6.0, 0.5 - square / 24.0
        else:
            sine, versine = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
        a, b, c, d, e, f, g, h, i = self.R_NB
        # the turn's matrix (Rodrigues), then the product
        xy, xz, yz, sx, sy, sz = versine * x * y, versine * x * z, versine * y * z, sine * x, sine * y, sine * z
        t0, t4, t8 = 1.0 - versine * (y * y + z * z), 1.0 - versine * (x * x + z * z), 1.0 - versine * (x * x + y * y)
        t1, t2, t3, t5, t6, t7 = xy - sz, xz + sy, xy + sz, yz - sx, xz - sy, yz + sx
        self.R_NB = (
            a * t0 + b * t3 + c * t6,
            a * t1 + b * t4 + c * t7,
            a * t2 + b * t5 + c * t8,
            d * t0 + e * t3 + f * t6,
            d * t1 + e * t4 + f * t7,
            d * t2 + e * t5 + f * t8,
            g * t0 + h * t3 + i * t6,
            g * t1 + h * t4 + i * t7,
            g * t2 + h * t5 + i * t8,
        )
        return self.R_NB


class HeldAttitude:
    """Attitude by the gyro, beside the one to hold; the matrix of a reference is made when it changes."""

    def __init__(self) -> None:
        self._estimate = RotationEstimate()
        self.reset()

    def reset(self) -> None:
        """Return to level, at rest, with level to hold."""
        self._estimate.reset()
        self._reference, self._R_d = (0.0, 0.0, 0.0), LEVEL

    def update(self, gyro: Vector, reference: Vector, dt: float) -> tuple[Rotation, Rotation]:
        """Return the attitude at a gyro sample [rad/s], see `RotationEstimate`, and the one to hold [rad] ZYX."""
        if reference != self._reference:
            self._reference, self._R_d = reference, rotation_matrix(reference)
        return self._estimate.update(gyro, dt), self._R_d


def rotation_matrix(euler: Vector) -> Rotation:
    """Return the rotation matrix of ZYX Euler angles phi, theta, psi [rad]."""
    phi, theta, psi = euler
    sx, cx, sy, cy, sz, cz = (f(angle) for angle in (phi, theta, psi) for f in (math.sin, math.cos))
    return (
        cy * cz,
        sx * sy * cz - cx * sz,
        cx * sy * cz + sx * sz,
        cy * sz,
        sx * sy * sz + cx * cz,
        cx * sy * sz - sx * cz,
        -sy,
        sx * cy,
        cx * cy,
    )


def rotation_error(R: Rotation, R_d: Rotation) -> Vector:
    """Return `e_R = 1/2 (R_d' R - R' R_d)` as a vector [-] B: axis times sine of the angle from `R_d` to `R`."""
    a, b, c, d, e, f, g, h, i = R
    A, B, C, D, E, F, G, H, I = R_d  # noqa: E741
    return (
        0.5 * (C * b + F * e + I * h - B * c - E * f - H * i),
        0.5 * (A * c + D * f + G * i - C * a - F * d - I * g),
        0.5 * (B * a + E * d + H * g - A * b - D * e - G * h),
    )


def rotation_vector(R: Rotation, R_d: Rotation) -> Vector:
    """Return axis times angle [rad] B from `R_d` to `R`; 0 at half a turn, which has no axis of its own."""
    x, y, z = rotation_error(R, R_d)
    sine = math.sqrt(x * x + y * y + z * z)
    if sine < _SMALL * _SMALL:
        return x, y, z
    a, b, c, d, e, f, g, h, i = R
    A, B, C, D, E, F, G, H, I = R_d  # noqa: E741
    trace = a * A + b * B + c * C + d * D + e * E + f * F + g * G + h * H + i * I
    factor = math.atan2(sine, 0.5 * (trace - 1.0)) / sine
    return factor * x, factor * y, factor * z


def shorten(v: Vector, longest: float) -> Vector:
    """Return a vector at no more than a length; to the bit itself if it is no longer."""
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if length <= longest:
        return v
    factor = longest / length
    return factor * v[0], factor * v[1], factor * v[2]


Table = Mapping[str, tuple[tuple[float, ...], ...]]
"""Gains of roll, pitch and yaw by vehicle."""


def pick_gains(table: Table, vehicle: Vehicle) -> tuple[tuple[float, ...], ...]:
    """Return the gains for a vehicle by its name; `octo` turns as `paper` does.

    Raises
    ------
    ConfigError
        If there are none: an example has no search for gains.
    """
    name = "paper" if vehicle.name == "octo" else vehicle.name
    if name not in table:
        known = ", ".join([*table, "octo"])
        raise ConfigError(f"this example has gains for {known}, none for '{vehicle.name}'; add yours to its table")
    return table[name]
