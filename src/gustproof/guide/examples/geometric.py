"""Geometric PID on SO(3): attitude error of rotation matrices, on a strapdown rotation matrix of the gyro.

The command is

    M = -k_R e_R - k_Omega Omega - k_I e_I + Omega x J Omega,      e_I' = Omega + c e_R,

with the attitude error `e_R = 1/2 (R_d' R - R' R_d)^v`. The reference is held from step to step, so its rate and
acceleration are 0, and the terms in them vanish. Gains are diagonal, here over the inertia. With the constant
c = k_R / k_Omega `e_I` integrates the error of the rate that `e_R` commands. Near level another would change nothing
that k_R and k_I can't. Added to the publications: `e_R` is shortened to the rate limit that all laws here have. Torques
are clipped at the vehicle's limit, where back-calculation empties the integral.

The published law has no lead to make up for actuators and delay, so its sensitivity limits it long before its slew
does. `make` is that law. `geometric_lead` adds `-k_A` times the filtered angular acceleration, as the rate loops of
autopilots do.

References
----------
T. Lee, M. Leok, N. H. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3), IEEE Conference on Decision
and Control 2010, equations (10), (11) and (16).
F. Goodarzi, D. Lee, T. Lee, Geometric nonlinear PID control of a quadrotor UAV on SE(3), European Control Conference
2013: the integral term.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from firmware_model.config.vehicle import Vehicle
from firmware_model.types import Vector
from gustproof.guide.examples.rotations import HeldAttitude, as_vector, pick_gains, rotation_error, shorten

_ZERO: Vector = (0.0, 0.0, 0.0)
_PUBLISHED = {
    "paper": (
        (8.914014259015774, 7.037669393256285, 8.89155713333475),
        (8.9140651752861, 7.0376692914289345, 8.891506217041368),
        (16.95235075285162, 8.086147016363961, 0.12310021415911804),
    ),
    "iris": (
        (32.034832969468475, 12.476355630746909, 31.871110858835628),
        (28.73305149743721, 11.612652190933787, 28.591499652208128),
        (57.88382613018227, 13.765628075401954, 0.0010000000000000002),
    ),
}
"""Attitude, rate and integral of the published law, see `GeometricGains`, tuned in turbulence."""


class GeometricGains(NamedTuple):
    """Gains of one axis, as angular acceleration."""

    attitude: float
    """[1/s^2] k_R over the inertia."""
    rate: float
    """[1/s] k_Omega over the inertia."""
    integral: float
    """[1/s^2] k_I over the inertia."""
    acceleration: float = 0.0
    """[-] k_A over the inertia; 0 in the published law."""
    cutoff: float = 30.0
    """[Hz] corner of the first-order filter on the angular acceleration."""


class GeometricPid:
    """The law in flight, from level at rest."""

    def __init__(self, vehicle: Vehicle, gains: Sequence[GeometricGains]) -> None:
        J = vehicle.inertia_B
        self._J, self._limit, self._rate_limit = J, vehicle.torque_limit, vehicle.stabilizer.rate_limit
        self._kR = tuple(j * g.attitude for j, g in zip(J, gains, strict=True))
        self._kW = tuple(j * g.rate for j, g in zip(J, gains, strict=True))
        self._kI = tuple(j * g.integral for j, g in zip(J, gains, strict=True))
        self._kA = tuple(j * g.acceleration for j, g in zip(J, gains, strict=True))
        self._cutoff, self._dt = tuple(2.0 * math.pi * g.cutoff for g in gains), 0.0
        self._c = tuple(g.attitude / g.rate for g in gains)
        self._attitude = HeldAttitude()
        self.reset()

    def reset(self) -> None:
        """Return to level, at rest."""
        self._attitude.reset()
        self._e_I = self._smooth = _ZERO

    def step(self, gyro: Iterable[float], reference: Iterable[float], force: Iterable[float], dt: float) -> Vector:
        """Return the torque [N*m] B for a gyro sample [rad/s]; the specific force is not read."""
        rates = as_vector(gyro)
        x, y, z = rotation_error(*self._attitude.update(rates, as_vector(reference), dt))
        p, q, r = rates
        c, kW, kI, (e1, e2, e3) = self._c, self._kW, self._kI, self._e_I
        # [rad/s] the rate that the error commands, reversed
        sx, sy, sz = shorten((c[0] * x, c[1] * y, c[2] * z), self._rate_limit)
        if dt != self._dt:
            self._dt, self._share = dt, tuple(-math.expm1(-corner * dt) for corner in self._cutoff)
        (f1, f2, f3), share, kA = self._smooth, self._share, self._kA
        dp, dq, dr = share[0] * (p - f1), share[1] * (q - f2), share[2] * (r - f3)
        self._smooth = f1 + dp, f2 + dq, f3 + dr
        Jx, Jy, Jz = self._J
        ux = -kW[0] * (sx + p) - kI[0] * e1 - kA[0] * dp / dt + (Jz - Jy) * q * r
        uy = -kW[1] * (sy + q) - kI[1] * e2 - kA[1] * dq / dt + (Jx - Jz) * r * p
        uz = -kW[2] * (sz + r) - kI[2] * e3 - kA[2] * dr / dt + (Jy - Jx) * p * q
        L, M, N = self._limit
        vx, vy, vz = min(max(ux, -L), L), min(max(uy, -M), M), min(max(uz, -N), N)
        # back-calculation: the integral empties with the time constant k_Omega / k_I
        self._e_I = (
            e1 + dt * (p + sx - (vx - ux) / kW[0]),
            e2 + dt * (q + sy - (vy - uy) / kW[1]),
            e3 + dt * (r + sz - (vz - uz) / kW[2]),
        )
        return vx, vy, vz


def make(vehicle: Vehicle) -> GeometricPid:
    """Return the published law for a vehicle."""
    return GeometricPid(vehicle, [GeometricGains(*each) for each in pick_gains(_PUBLISHED, vehicle)])
