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
from dataclasses import asdict, dataclass

import numpy as np

from firmware_model.config.vehicle import Vehicle
from firmware_model.types import Vector
from gustproof.baselines.rotation_estimate import HeldAttitude, as_vector, rotation_error, shorten
from gustproof.baselines.tuned_gains import design_vehicle, find_gains, start_speeds, tune_axes
from gustproof.law.cascade import AxisLaw
from gustproof.performance.covariance import AxisModel

_ZERO: Vector = (0.0, 0.0, 0.0)
CUTOFF = 30.0
"""[Hz] of the filter that a law without lead does not use."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometricGains:
    """Gains of one axis, as angular acceleration."""

    attitude: float
    """[1/s^2] k_R over the inertia."""
    rate: float
    """[1/s] k_Omega over the inertia."""
    integral: float
    """[1/s^2] k_I over the inertia."""
    acceleration: float
    """[-] k_A over the inertia; 0 in the published law."""
    cutoff: float
    """[Hz] corner of the first-order filter on the angular acceleration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _PublishedGains:
    """Gains of the published law, see `GeometricGains`."""

    attitude: float
    """[1/s^2] k_R over the inertia."""
    rate: float
    """[1/s] k_Omega over the inertia."""
    integral: float
    """[1/s^2] k_I over the inertia."""

    def complete(self) -> GeometricGains:
        """Return the gains without lead."""
        return GeometricGains(**asdict(self), acceleration=0.0, cutoff=CUTOFF)


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


def geometric_axis(gains: GeometricGains, inertia: float, dt: float) -> AxisLaw:
    """Return one axis of the law near level.

    States are attitude [rad] and rate [rad/s] a sample ago, `e_I` [rad] and the low-passed rate [rad/s].
    """
    E, omega, integral, smooth = np.eye(4, 6)
    rate = np.eye(6)[4]
    attitude = E + 0.5 * dt * (omega + rate)
    change = -math.expm1(-2.0 * math.pi * gains.cutoff * dt) * (rate - smooth)
    proportional = gains.attitude * attitude + gains.rate * rate
    command = -inertia * (proportional + gains.integral * integral + gains.acceleration / dt * change)
    step = np.vstack([attitude, rate, integral + dt / gains.rate * proportional, smooth + change])
    none = np.zeros((4, 1))
    return AxisLaw(A=step[:, :4], B=step[:, 4:], C=command[None, :4], D=command[None, 4:], G=none, H=none)


def tune_geometric(vehicle: Vehicle) -> list[GeometricGains]:
    """Return the gains of the published law by the procedure of `tuned_gains`, in a second or two.

    Raises
    ------
    DesignError
        If no gains are within the limits.
    """
    starts = [
        _PublishedGains(attitude=20.0 * v * v, rate=8.0 * v, integral=10.0 * v * v) for v in start_speeds(vehicle)
    ]

    def axis(gains: _PublishedGains, model: AxisModel) -> AxisLaw:
        return geometric_axis(gains.complete(), model.inertia, model.plant.dt)

    return [gains.complete() for gains in tune_axes(vehicle, axis, starts, "geometric PID")]


def make(vehicle: Vehicle) -> GeometricPid:
    """Return the published law for a vehicle; one that is not shipped is tuned first, in a second or two."""
    vehicle = design_vehicle(vehicle)
    return GeometricPid(vehicle, find_gains("geometric", vehicle, tune_geometric, GeometricGains))
