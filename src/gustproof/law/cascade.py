"""Cascaded PID in the one law form: angle P outside, rate PI or PID inside, each axis on its own.

Gains are angular acceleration per error, independent of the inertia. A law's matrices command torque.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from firmware_model.config.vehicle import Vehicle
from firmware_model.types import AXES
from gustproof.law.form import Law, Matrix, Output, Provenance, RateLimit
from gustproof.robust.lti.state_space import Lti


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
    """Gains of the cascade of one axis.

    Raises
    ------
    ValueError
        If a gain is negative or not finite, or `rate_p` or `derivative_cutoff` is 0.
    """

    angle_p: float
    """[1/s] rate command per attitude error."""
    rate_p: float
    """[1/s] angular acceleration per rate error."""
    rate_i: float
    """[1/s^2] angular acceleration per integrated rate error."""
    rate_d: float = 0.0
    """[-] angular acceleration per filtered derivative of the rate error, without the reference."""
    derivative_cutoff: float = 30.0
    """[Hz] corner of the first-order filter on the derivative."""

    def __post_init__(self) -> None:
        """Check each gain."""
        for name in ("angle_p", "rate_p", "rate_i", "rate_d", "derivative_cutoff"):
            value, positive = getattr(self, name), name in ("rate_p", "derivative_cutoff")
            if not math.isfinite(value) or value < 0.0 or (positive and value == 0.0):
                raise ValueError(f"{name} is {value!r}, must be {'positive' if positive else '0 or more'}, finite")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisLaw:
    """The law of one axis: the law form with one measurement, one reference and one command."""

    A: Matrix
    """(n, n) state to next state."""
    B: Matrix
    """(n, 2) rate [rad/s] and reference [rad] to next state."""
    C: Matrix
    """(1, n) state to command [N*m]."""
    D: Matrix
    """(1, 2) rate and reference to command."""
    G: Matrix
    """(n, 1) Euler rate of the law's own estimate to next state."""
    H: Matrix
    """(n, 1) saturation excess to next state."""
    rate_limit: RateLimit | None = None
    """Limit of the rate commanded from attitude."""

    @property
    def A_linear(self) -> Matrix:
        """(n, n) `A` with the kinematics linearised at level attitude and rest; state 1 is the Euler rate."""
        return self.A + self.G @ np.eye(2, self.A.shape[0])[1:]

    def controller(self, dt: float) -> Lti:
        """Return the law from gyro [rad/s] to command [N*m], linear at level attitude, with sample time `dt` [s]."""
        return Lti(A=self.A_linear, B=self.B[:, :1], C=self.C, D=self.D[:, :1], dt=dt)


def plain_axis(gains: Gains, inertia: float, dt: float) -> AxisLaw:
    """Return the two-state cascade; states are the integrals of the gyro [rad] and of the rate error [rad].

    The attitude at a sample is the integral before it plus half of the newest step: the trapezoidal rule.

    Raises
    ------
    ValueError
        If there is a derivative gain: its filter would be a third state.
    """
    if gains.rate_d:
        raise ValueError(f"rate_d is {gains.rate_d}, must be 0: two states leave none for a derivative filter")
    attitude, integral = np.eye(2)
    rate, angle_reference = np.eye(2)
    error = _rate_error(gains, attitude, 0.5 * dt * rate, rate, angle_reference)
    return AxisLaw(
        A=np.vstack([attitude, integral + dt * error[:2]]),
        B=np.vstack([dt * rate, dt * error[2:]]),
        C=inertia * (gains.rate_p * error[:2] + gains.rate_i * integral)[None],
        D=inertia * gains.rate_p * error[2:][None],
        G=np.zeros((2, 1)),
        H=np.array([[0.0], [_back_calculation(gains, inertia, dt)]]),
    )


def strapdown_axis(gains: Gains, inertia: float, dt: float, rate_limit: float | None = None) -> AxisLaw:
    """Return the cascade on strapdown attitude with a filtered rate derivative.

    States: Euler angle `E` at the previous sample [rad], rate of the previous sample [rad/s], integral of the rate
    error [rad], low-passed rate error [rad/s]. With `g` the new gyro sample and `omega` the previous one,

        E+ = E + dt T(E) omega + dt/2 (g - omega)

    is the trapezoidal rule. The sum telescopes: `E` and `omega` always belong to the same instant, and the kinematics
    are evaluated there. Errors of first order in dt do not accumulate, as `dt/2 q r` does in a forward step. One
    first-order term is left and bounded: the newest half step has no kinematics. The law acts on the attitude
    `E + dt/2 (omega + g)`, which has no phase lag.

    Beyond `rate_limit` [rad/s], if given, the excess of the rate commanded from attitude changes the reference.
    """
    E, omega, integral, smooth = np.eye(4)
    rate, angle_reference = np.eye(2)
    error = _rate_error(gains, E + 0.5 * dt * omega, 0.5 * dt * rate, rate, angle_reference)
    commanded = error + np.concatenate([0.0 * E, rate])
    smoothed = np.concatenate([error[:5], [0.0]])  # without the reference: the slope of a step has no meaning
    smoothing = -math.expm1(-2.0 * math.pi * gains.derivative_cutoff * dt)
    low_passed = (1.0 - smoothing) * np.append(smooth, [0.0, 0.0]) + smoothing * smoothed
    # The slope over the newest step: the answer has no delay.
    slope = (low_passed - np.append(smooth, [0.0, 0.0])) / dt
    command = inertia * (gains.rate_p * error + gains.rate_i * np.append(integral, [0.0, 0.0]) + gains.rate_d * slope)
    A = np.vstack([E - 0.5 * dt * omega, 0.0 * omega, integral + dt * error[:4], low_passed[:4]])
    B = np.vstack([0.5 * dt * rate, rate, dt * error[4:], low_passed[4:]])
    back = _back_calculation(gains, inertia, dt)
    return AxisLaw(
        A=A, B=B, C=command[None, :4], D=command[None, 4:],
        G=np.array([[dt], [0.0], [0.0], [0.0]]), H=np.array([[0.0], [0.0], [back], [0.0]]),
        rate_limit=limit_by_reference(commanded, B, command[None, 4:], rate_limit),
    )  # fmt: skip


def limit_by_reference(commanded: Matrix, B: Matrix, D: Matrix, limit: float | None) -> RateLimit | None:
    """Return the limit of one axis whose excess changes the reference; `None` without `limit` [rad/s].

    Parameters
    ----------
    commanded
        (n + 2,) row of (states, rate, reference) that gives the commanded rate [rad/s].
    B, D
        (n, 2) and (1, 2) of `AxisLaw`; their second columns are the reference's.
    limit
        [rad/s] largest commanded rate.
    """
    if limit is None:
        return None
    S, T = np.split(commanded[None], [len(B)], axis=1)
    gain = float(T[0, 1])
    return RateLimit(S=S, T=T, U=D[:, 1:] / gain, V=B[:, 1:] / gain, limits=np.array([limit]))


def cascade_law(name: str, axes: Sequence[AxisLaw], vehicle: Vehicle, dt: float, provenance: Provenance) -> Law:
    """Return the torque law of roll, pitch and yaw `axes`; state j of axis i is `x[3 j + i]`.

    Raises
    ------
    ValueError
        If there are not three axes of one order.
    """
    orders = {axis.A.shape[0] for axis in axes}
    if len(axes) != 3 or len(orders) != 1:
        raise ValueError(f"{len(axes)} axes of orders {sorted(orders)}, must be three of one order")
    matrices: dict[str, Any] = {name: _assemble(getattr(axis, name) for axis in axes) for name in "ABCDGH"}
    return Law(
        name=name, **matrices, dt=dt, limits=np.array(vehicle.torque_limit), output=Output.TORQUE,
        provenance=provenance, rate_limit=_join_limits([axis.rate_limit for axis in axes if axis.rate_limit]),
    )  # fmt: skip


def _assemble(parts: Iterable[Matrix]) -> Matrix:
    """Return the matrix of three axes from one of each."""
    return np.asarray(sum(np.kron(part, np.diag(unit)) for part, unit in zip(parts, np.eye(3), strict=True)))


def _join_limits(limits: Sequence[RateLimit]) -> RateLimit | None:
    if not limits:
        return None
    parts = {name: _assemble(getattr(limit, name) for limit in limits) for name in "STUV"}
    return RateLimit(**parts, limits=np.concatenate([limit.limits for limit in limits]))


def gain_parameters(gains: Sequence[Gains]) -> dict[str, float]:
    """Return the gains of roll, pitch and yaw by name, for a law's provenance."""
    return {
        f"{axis}_{name}": getattr(values, name)
        for axis, values in zip(AXES, gains, strict=True)
        for name in ("angle_p", "rate_p", "rate_i", "rate_d", "derivative_cutoff")
        if values.rate_d or name not in ("rate_d", "derivative_cutoff")
    }


def _rate_error(gains: Gains, attitude: Matrix, newest: Matrix, rate: Matrix, reference: Matrix) -> Matrix:
    """Return the row of (states, rate, reference) that gives rate command minus rate."""
    return np.concatenate([-gains.angle_p * attitude, gains.angle_p * (reference - newest) - rate])


def _back_calculation(gains: Gains, inertia: float, dt: float) -> float:
    """Return the back-calculation gain per saturated torque; the integral then empties with the PI's time constant.

    References
    ----------
    K. J. Astrom, T. Hagglund, Advanced PID Control, 2006: back-calculation, tracking time equal to the integral time.
    """
    return dt / (inertia * gains.rate_p)
