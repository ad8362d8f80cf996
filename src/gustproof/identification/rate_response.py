"""Kernels of the rate model: response of a rate to commands, and one-step prediction errors of the measured rate.

Both are exact for samples at any times, so a log is never resampled: lost samples and uneven stamps need no care.
"""

import math

from firmware_model.numerics.compiled import compiled, kernel
from gustproof.types import Array


@kernel
def _decay_integral(rate: float, decay: float, h: float, damping: float) -> float:
    """Return the integral of `exp(-damping (h - s)) exp(-rate s)` over s in 0..h [s]; `decay` is `exp(-damping h)`."""
    x = (damping - rate) * h
    return decay * h if abs(x) < 1e-7 else decay * math.expm1(x) / (damping - rate)


@compiled
def command_response(
    command_time: Array, command: Array, time: Array, model: Array, square: bool, state: Array, response: Array
) -> None:
    """Write the rate's response (n, k) at `time` (n,) [s] to k commands, from rest, per unit of angular acceleration.

    Each of the commands (m, k) is held from its `command_time` (m,) [s] plus delay, passes a first-order lag, is
    squared if `square`, and drives a rate that decays by its damping. The lag starts settled at the first. `model` holds lag [s],
    delay [s], damping [1/s]; `state` (2, k) is work space.
    """
    lag, delay, damping = model[0], model[1], model[2]
    channels, last, j = command.shape[1], command_time.size - 1, 0
    for c in range(channels):
        state[0, c], state[1, c] = command[0, c], 0.0
    now = command_time[0] + delay
    for k in range(time.size):
        while now < time[k]:
            until = time[k]
            if j < last and command_time[j + 1] + delay < until:
                until = command_time[j + 1] + delay
            h = until - now
            decay, fall = math.exp(-damping * h), math.exp(-h / lag)
            held = _decay_integral(0.0, decay, h, damping)
            once, twice = _decay_integral(1.0 / lag, decay, h, damping), _decay_integral(2.0 / lag, decay, h, damping)
            for c in range(channels):
                u, step = command[j, c], state[0, c] - command[j, c]
                gained = (
                    u * u * held + 2.0 * u * step * once + step * step * twice if square else u * held + step * once
                )
                state[0, c], state[1, c] = u + step * fall, decay * state[1, c] + gained
            if until < time[k]:
                j += 1
            now = until
        for c in range(channels):
            response[k, c] = state[1, c]


@compiled
def prediction_errors(
    time: Array, count: Array, start: Array, signals: Array, model: Array, state: Array, errors: Array, variance: Array
) -> None:
    """Write the errors (n, k) of predicting each of k signals (n, k) from its own past, and their variance (n,).

    The predictor is the Kalman filter of a rate that decays by its damping under white and coloured angular
    acceleration, seen with white noise. It is linear: errors of `y - W g` are those of y minus those of W times g.

    Parameters
    ----------
    time
        (n,) [s] strictly increasing within a stretch.
    count
        (n,) samples averaged into each; 0 if it is to be predicted only.
    start
        (n,) 1 where a stretch begins: all that is known there is the spectrum of the disturbance.
    model
        Damping [1/s], variance of the noise of a sample, corner [rad/s] of the disturbance, its drive [rad^2/s^5],
        which is `2 corner rms^2`, and the spectral density of the white acceleration [rad^2/s^3].
    state
        (2, k) work space.
    """
    damping, noise, corner, drive, white = model[0], model[1], model[2], model[3], model[4]
    p11, p12, p22, before, h_before = 0.0, 0.0, 0.0, 0.0, -1.0
    a, b, rho, q11, q12, q22 = 1.0, 0.0, 1.0, 0.0, 0.0, 0.0
    for k in range(time.size):
        if start[k] != 0.0:
            p11, p12, p22 = 1e4, 0.0, drive / (2.0 * corner)
            for c in range(signals.shape[1]):
                state[0, c], state[1, c] = 0.0, 0.0
        else:
            h = time[k] - before
            if abs(h - h_before) > 1e-9:
                h_before = h
                half, rho_half = math.exp(-0.5 * damping * h), math.exp(-0.5 * corner * h)
                a, rho = half * half, rho_half * rho_half
                b_half = _decay_integral(corner, half, 0.5 * h, damping)
                b = _decay_integral(corner, a, h, damping)
                w = drive * h / 6.0  # Simpson's rule over the step: positive weights, so Q is positive semidefinite
                q11 = w * (4.0 * b_half * b_half + b * b) + white * h
                q12 = w * (4.0 * b_half * rho_half + b * rho)
                q22 = w * (1.0 + 4.0 * rho_half * rho_half + rho * rho)
            p11 = a * a * p11 + 2.0 * a * b * p12 + b * b * p22 + q11
            p12 = rho * (a * p12 + b * p22) + q12
            p22 = rho * rho * p22 + q22
            for c in range(signals.shape[1]):
                state[0, c] = a * state[0, c] + b * state[1, c]
                state[1, c] = rho * state[1, c]
        before = time[k]
        s = p11 + noise / max(count[k], 1.0)
        gain1, gain2 = p11 / s, p12 / s
        variance[k] = s
        if count[k] == 0.0:
            gain1, gain2 = 0.0, 0.0
        for c in range(signals.shape[1]):
            error = signals[k, c] - state[0, c]
            errors[k, c] = error
            state[0, c] += gain1 * error
            state[1, c] += gain2 * error
        p22 -= gain2 * p12
        p12 -= gain1 * p12
        p11 -= gain1 * p11
