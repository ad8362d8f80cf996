"""The cascade with a biquad for one axis: angle P outside, a filtered PID and a biquad inside, on strapdown attitude.

The command is `u = J F (angle_p (reference - attitude) - rate)` with the axis's inertia J and

    F(s) = gain q(s; lead) / (s (s + cutoff)) q(s; zero) / q(s; pole),    q(s; w, zeta) = s^2 + 2 zeta w s + w^2,

sampled by the trapezoidal rule. Without the biquad it is the PID with a filtered derivative. The biquad reduces the
loop gain only at frequencies where delay and lag leave no phase.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gustproof.law.cascade import AxisLaw
from gustproof.law.form import Matrix, RateLimit
from gustproof.robust.lti.state_space import ComplexMatrix

Values = NDArray[Any]
"""Real, or complex for a derivative by complex steps."""


class BiquadGains(NamedTuple):
    """Gains and corners of one axis; all positive."""

    angle_p: float
    """[1/s] commanded rate per attitude error."""
    gain: float
    """[1/s] angular acceleration per rate error at high frequency."""
    lead_frequency: float
    """[rad/s] of the PID's two zeros."""
    lead_damping: float
    """[-] of the PID's two zeros."""
    cutoff: float
    """[rad/s] corner of the filter on the derivative."""
    zero_frequency: float
    """[rad/s] of the biquad's zeros."""
    zero_damping: float
    """[-] of the biquad's zeros."""
    pole_frequency: float
    """[rad/s] of the biquad's poles."""
    pole_damping: float
    """[-] of the biquad's poles."""

    def sort_zeros(self) -> "BiquadGains":
        """Return equivalent gains with the slower pair of zeros as the PID's; `F` does not change."""
        if self.lead_frequency <= self.zero_frequency:
            return self
        return self._replace(
            lead_frequency=self.zero_frequency,
            lead_damping=self.zero_damping,
            zero_frequency=self.lead_frequency,
            zero_damping=self.lead_damping,
        )


class LawFilter(NamedTuple):
    """`F` in state space; each field has the leading axes of the values."""

    A: Values
    """(..., 4, 4) of the states: integral, derivative's filter, and two of the biquad."""
    B: Values
    """(..., 4) from the rate error."""
    C: Values
    """(..., 4) to the angular acceleration."""
    D: Values
    """(...) from the rate error to the angular acceleration."""


def biquad_filter(values: Values, dt: float) -> LawFilter:
    """Return `F` for the values (..., 9) of `BiquadGains`, at the sample time `dt` [s]."""
    _, gain, lead, lead_damping, cutoff, zero, zero_damping, pole, pole_damping = np.moveaxis(values, -1, 0)
    rate = 2.0 / dt
    n0, n1, n2 = _tustin_quadratic(lead, lead_damping, rate)
    decay, scale = (rate - cutoff) / (rate + cutoff), gain / (rate * (rate + cutoff))
    # partial fractions make the integral a separate state, to which reference and limit are applied
    integral = scale * (n0 + n1 + n2) / (1.0 - decay)
    smooth = scale * ((n0 * decay + n1) * decay + n2) / (decay - 1.0)
    b0, b1, b2 = _tustin_quadratic(zero, zero_damping, rate)
    a0, a1, a2 = _tustin_quadratic(pole, pole_damping, rate)
    through = b0 / a0
    A = np.zeros((*values.shape[:-1], 4, 4), values.dtype)
    A[..., 0, 0], A[..., 1, 1] = 1.0, decay
    A[..., 2, 0], A[..., 2, 1] = integral, smooth
    A[..., 2, 2], A[..., 2, 3], A[..., 3, 2] = -a1 / a0, -a2 / a0, 1.0
    B = np.stack([np.ones_like(gain), np.ones_like(gain), scale * n0, np.zeros_like(gain)], axis=-1)
    tail = [(b1 - through * a1) / a0, (b2 - through * a2) / a0]
    return LawFilter(A, B, np.stack([through * integral, through * smooth, *tail], axis=-1), through * scale * n0)


def biquad_axis(gains: BiquadGains, inertia: float, dt: float, rate_limit: float | None = None) -> AxisLaw:
    """Return the law of one axis.

    States: Euler angle `E` [rad] and rate [rad/s] at the previous sample, and the four of `F`; attitude as in
    `strapdown_axis`. The reference enters the integral alone, so it is approached without a kick. When the command
    saturates, the excess unwinds the integral with the time constant 1 / `lead_frequency`.

    `rate_limit` [rad/s], if given, limits the rate commanded from attitude and integral together. The reference is in
    the integral alone, so that in the end the integral holds `angle_p` times it. The excess enters like the rate error.
    """
    F = biquad_filter(np.array(gains), dt)
    E, omega = np.eye(2, 6)
    rate, reference = np.eye(2)
    rows = np.eye(6)[2:]
    # rate error from the states, and from the newest gyro sample
    by_state = -gains.angle_p * (E + 0.5 * dt * omega)
    by_rate = -(1.0 + 0.5 * dt * gains.angle_p) * rate
    by_reference = np.outer(np.eye(4)[0], gains.angle_p * reference)
    # static gain from the integral to the command
    static_gain = inertia * float(F.C[0] + F.C[2:] @ np.linalg.solve(np.eye(2) - F.A[2:, 2:], F.A[2:, 0]))
    H = np.zeros((6, 1))
    H[2] = dt * gains.lead_frequency / static_gain
    limit = None
    if rate_limit is not None:
        # the integral as a rate: its gain over the one that the PID has without it at low frequency
        by_integral = F.A[2, 0] / (F.B[2] + F.A[2, 1] / (1.0 - F.A[1, 1]))
        limit = RateLimit(
            S=(by_state + by_integral * rows[0])[None],
            T=-0.5 * dt * gains.angle_p * rate[None],
            U=np.array([[inertia * F.D]]),
            V=np.concatenate([np.zeros(2), F.B])[:, None],
            limits=np.array([rate_limit]),
        )
    return AxisLaw(
        A=np.vstack([E - 0.5 * dt * omega, 0.0 * omega, F.A @ rows + np.outer(F.B, by_state)]),
        B=np.vstack([0.5 * dt * rate, rate, np.outer(F.B, by_rate) + by_reference]),
        C=inertia * (F.C @ rows + F.D * by_state)[None],
        D=inertia * (F.D * by_rate)[None],
        G=np.eye(6, 1) * dt,
        H=H,
        rate_limit=limit,
    )


def biquad_response(values: Matrix, s: ComplexMatrix) -> tuple[ComplexMatrix, ComplexMatrix]:
    """Return the response (k,) from rate to acceleration, including the attitude loop, and its slopes.

    `s` (k,) are the points `2/dt (z - 1) / (z + 1)` of the trapezoidal rule. The slopes (9, k) are derivatives of the
    response's logarithm with respect to the logarithms of the values.
    """
    angle_p, gain, lead, lead_damping, cutoff, zero, zero_damping, pole, pole_damping = values
    pairs = ((lead, lead_damping), (zero, zero_damping), (pole, pole_damping))
    leads, zeros, poles = (_quadratic(*pair, s) for pair in pairs)
    response = gain * leads[0] / (s * (s + cutoff)) * zeros[0] / poles[0] * (1.0 + angle_p / s)
    fixed = angle_p / (s + angle_p), np.ones_like(s)
    return response, np.array([*fixed, *leads[1:], -cutoff / (s + cutoff), *zeros[1:], -poles[1], -poles[2]])


def _tustin_quadratic(frequency: Values, damping: Values, rate: float) -> tuple[Values, Values, Values]:
    """Return the coefficients of z^2, z and 1 of `q` times (z + 1)^2."""
    middle, side = rate * rate + frequency * frequency, 2.0 * damping * frequency * rate
    return middle + side, 2.0 * (frequency * frequency - rate * rate), middle - side


def _quadratic(
    frequency: float, damping: float, s: ComplexMatrix
) -> tuple[ComplexMatrix, ComplexMatrix, ComplexMatrix]:
    """Return `q`, and the slopes of its logarithm with respect to those of frequency and damping."""
    first, constant = 2.0 * damping * frequency * s, frequency * frequency
    q = s * s + first + constant
    return q, (first + 2.0 * constant) / q, first / q
