"""Kernels of the rate model: response of a rate to commands, and one-step prediction errors of the measured rate.

Both are exact for samples at any times, so a log is never resampled: lost samples and uneven stamps need no care.
"""

import math

import numpy as np
from numpy.typing import NDArray

from firmware_model.numerics.compiled import compiled, kernel
from gustproof.types import Array

Indices = NDArray[np.int64]
_SAME = 1e-12
"""[s] a step that differs by no more from the last of its kind, as even stamps do by rounding, has its constants. The
kind says whether it begins, and whether it ends, at a change of the command rather than at a sample."""


@kernel
def _decay_integral(rate: float, decay: float, h: float, damping: float) -> float:
    """Return the integral of `exp(-damping (h - s)) exp(-rate s)` over s in 0..h [s]; `decay` is `exp(-damping h)`."""
    x = (damping - rate) * h
    return decay * h if abs(x) < 1e-7 else decay * math.expm1(x) / (damping - rate)


@compiled
def command_response(
    command_time: Array,
    command: Array,
    time: Array,
    bins: Indices,
    model: Array,
    square: bool,
    state: Array,
    steps: Array,
    response: Array,
) -> None:
    """Write the rate's response (b, k) to k commands, from rest, per unit of angular acceleration.

    It is the mean of that at the `time` (n,) [s] of the samples of each bin; `bins` (b,) holds the first of each. Each
    of the commands (m, k) is held from its `command_time` (m,) [s] plus delay and passes a first-order lag, which
    starts settled. Squared if `square`, it drives a rate that decays by its damping. `model` holds lag [s],
    delay [s], damping [1/s]; `state` (2, k) and `steps` (4, 6) are work space.
    """
    delay = model[1]
    channels, last, j = command.shape[1], command_time.size - 1, 0
    for c in range(channels):
        state[0, c], state[1, c] = command[0, c], 0.0
    now, b, ends = command_time[0] + delay, -1, 0
    response[:], steps[:] = 0.0, -1.0
    for k in range(time.size):
        if b + 1 < bins.size and bins[b + 1] == k:
            b += 1
        while now < time[k]:
            until, begins, ends = time[k], ends, 0
            if j < last and command_time[j + 1] + delay < until:
                until, ends = command_time[j + 1] + delay, 1
            h, kind = until - now, 2 * begins + ends
            if abs(h - steps[kind, 0]) > _SAME:
                _write_step(h, model, square, steps[kind])
            _advance(state, command[j], steps[kind], square)
            if until < time[k]:
                j += 1
            now = until
        for c in range(channels):
            response[b, c] += state[1, c]
    _divide(response, bins, time.size)


@kernel
def _divide(sums: Array, bins: Indices, size: int) -> None:
    """Divide the sums (b, k) over bins by the count of their samples, of `size` in all."""
    for b in range(bins.size):
        end = bins[b + 1] if b + 1 < bins.size else size
        for c in range(sums.shape[1]):
            sums[b, c] /= end - bins[b]


@kernel
def _advance(state: Array, command: Array, step: Array, square: bool) -> None:
    """Advance lags and rates (2, k) by a step under commands (k,), with the constants (6,) of `_write_step`."""
    decay, fall, held, once, twice = step[1], step[2], step[3], step[4], step[5]
    for c in range(command.size):
        u, apart = command[c], state[0, c] - command[c]
        gained = u * u * held + 2.0 * u * apart * once + apart * apart * twice if square else u * held + apart * once
        state[0, c], state[1, c] = u + apart * fall, decay * state[1, c] + gained


@kernel
def _write_step(h: float, model: Array, square: bool, step: Array) -> None:
    """Write the constants (6,) of a step of `h` [s] under one command, see `command_response`."""
    lag, damping = model[0], model[2]
    decay = math.exp(-damping * h)
    step[0], step[1], step[2] = h, decay, math.exp(-h / lag)
    step[3] = _decay_integral(0.0, decay, h, damping)
    step[4] = _decay_integral(1.0 / lag, decay, h, damping)
    step[5] = _decay_integral(2.0 / lag, decay, h, damping) if square else 0.0


@compiled
def prediction_errors(
    time: Array, count: Array, start: Array, signals: Array, model: Array, state: Array, errors: Array, variance: Array
) -> None:
    """Write the errors (n, k) of predicting each of k signals (n, k) from its own past, and their variance (n,).

    The predictor is the Kalman filter of a rate that decays by its damping, seen with white noise. Two disturbances of
    first order drive it, a slow one and a fast one. It is linear: errors of `y - W g` are those of y minus those of W
    times g.

    Parameters
    ----------
    time
        (n,) [s] strictly increasing within a stretch.
    count
        (n,) samples averaged into each.
    start
        (n,) 1 where a stretch begins: all that is known there are the spectra of the disturbances.
    model
        Damping [1/s], variance [rad^2/s^2] of the noise of a sample; of the slow, then of the fast disturbance the
        corner [rad/s] and the drive `2 corner rms^2` [rad^2/s^5].
    state
        (3, k) work space.
    """
    damping, noise, slow, slow_drive, fast, fast_drive = model[0], model[1], model[2], model[3], model[4], model[5]
    before, h_before = 0.0, -1.0
    pww, pws, pwf, pss, psf, pff = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    a, b, c, r, s = 1.0, 0.0, 0.0, 1.0, 1.0
    qww, qws, qwf, qss, qff = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(time.size):
        if start[k] != 0.0:
            pww, pws, pwf, psf = 1e4, 0.0, 0.0, 0.0
            pss, pff = slow_drive / (2.0 * slow), fast_drive / (2.0 * fast)
            for i in range(signals.shape[1]):
                state[0, i], state[1, i], state[2, i] = 0.0, 0.0, 0.0
        else:
            h = time[k] - before
            if abs(h - h_before) > 1e-9:
                h_before, a = h, math.exp(-damping * h)
                b, r, v, qws, qss = _disturbance(slow, slow_drive, h, damping)
                c, s, qww, qwf, qff = _disturbance(fast, fast_drive, h, damping)
                qww += v
            fww, fws, fwf = a * pww + b * pws + c * pwf, a * pws + b * pss + c * psf, a * pwf + b * psf + c * pff
            pww = a * fww + b * fws + c * fwf + qww
            pws, pwf, psf = r * fws + qws, s * fwf + qwf, r * s * psf
            pss, pff = r * r * pss + qss, s * s * pff + qff
            for i in range(signals.shape[1]):
                state[0, i] = a * state[0, i] + b * state[1, i] + c * state[2, i]
                state[1, i], state[2, i] = r * state[1, i], s * state[2, i]
        before = time[k]
        total = pww + noise / count[k]
        gain, to_slow, to_fast = pww / total, pws / total, pwf / total
        variance[k] = total
        for i in range(signals.shape[1]):
            error = signals[k, i] - state[0, i]
            errors[k, i] = error
            state[0, i] += gain * error
            state[1, i] += to_slow * error
            state[2, i] += to_fast * error
        pss, psf, pff = pss - to_slow * pws, psf - to_slow * pwf, pff - to_fast * pwf
        pww, pws, pwf = pww - gain * pww, pws - gain * pws, pwf - gain * pwf


@kernel
def _disturbance(corner: float, drive: float, h: float, damping: float) -> tuple[float, float, float, float, float]:
    """Return what a disturbance does in a step of `h` [s] to the rate and keeps of itself, and its noise.

    The noise is the variance of the rate, its covariance with the disturbance, and the disturbance's variance.
    Simpson's rule has positive weights, so that their matrix has no negative eigenvalue.
    """
    half, decay = math.exp(-0.5 * corner * h), math.exp(-0.5 * damping * h)
    middle, whole = _decay_integral(corner, decay, 0.5 * h, damping), _decay_integral(corner, decay * decay, h, damping)
    w, kept = drive * h / 6.0, half * half
    variance, covariance = w * (4.0 * middle * middle + whole * whole), w * (4.0 * middle * half + whole * kept)
    return whole, kept, variance, covariance, w * (1.0 + 4.0 * kept + kept * kept)
