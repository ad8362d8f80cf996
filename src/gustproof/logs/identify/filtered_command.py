"""Commands behind the filters that the gyro is logged behind, so that a fit does not take those for the vehicle.

An autopilot's loops see the gyro behind notches and a low-pass, and most logs have it from there. With filters F and a
vehicle P, F omega = P F u: the command is passed through the same filters. Their phase is then counted once, in the
loops, and not a second time as lag, delay and gain of the vehicle. A moving notch is taken at its frequency here and in
the loops: these errors cancel.

Noise of the gyro is white before those filters and not behind them, and the command answers it: a fit would take that
for a prompt vehicle. Where each turn of the loop is logged, the filters' inverse makes it white again, as far as an
inverse stays calm. Gyro and command pass through the same, so it need not be exact.
"""

import math
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter, lfilter_zi, welch

from firmware_model.config.gyro_filters import Biquad, gyro_filters
from gustproof.logs.identify.rate_response import Indices
from gustproof.logs.identify.rates import is_whole
from gustproof.logs.identify.stretches import sample_time
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.types import Array

_FINER = 4  # steps of the filters in a sample of the command, which is held
_ALIKE = 0.02  # of sample times: beyond it gyro and command are not of the same turns of the loop
_GAPS = 1e-3  # share of lost samples, beyond which inverses ring all the time
_EVEN, _UPPER_END = 1.1, 0.95  # largest logarithm of how parts of a white spectrum differ, and where the last ends
_CALM, _CALM_NOTCH = (
    (0.95, 0.8, 0.25, 0.0),
    0.98,
)  # largest poles of inverses: they ring, and blow up what filters took away


def filter_command(log: FlightLog) -> FlightLog:
    """Return the log with its commands behind the filters of its gyro; as it is if that is raw or none are known.

    Each value is the mean over the time until the next, so that holding it is no delay. Motors' thrust is filtered,
    the square of their command. Where that makes the gyro's noise white, gyro and command are then taken behind the
    filters' inverse.
    """
    signal = log.command or log.motors
    if log.is_gyro_raw or signal is None or len(signal.time) < 2:
        return log
    step = sample_time(signal) / _FINER
    filters = gyro_filters(log.system, log.parameters, 1.0 / step)
    if not filters:
        return log
    line = "gyro: logged behind the autopilot's filters, so its command is taken behind them too"
    found = replace(log, findings=(*log.findings, line))
    if log.command is not None:
        return _whiten(replace(found, command=_pass_through(signal, filters, step)))
    squares = _pass_through(LogSignal(time=signal.time, values=signal.values**2), filters, step)
    return replace(found, motors=LogSignal(time=signal.time, values=np.sqrt(np.maximum(squares.values, 0.0))))


def _whiten(log: FlightLog) -> FlightLog:
    """Return the log with gyro and command behind the inverse of the gyro's filters, if it has each turn of a loop."""
    gyro, command = log.gyro, log.command
    if command is None or not is_whole(log, gyro) or abs(sample_time(command) / sample_time(gyro) - 1.0) > _ALIKE:
        return log
    if np.mean([np.mean(np.diff(each.time) > 1.5 * sample_time(each)) for each in (gyro, command)]) > _GAPS:
        return log
    filters = gyro_filters(log.system, log.parameters, 1.0 / sample_time(gyro))
    tries = [[_invert(each, calm) for each in filters] for calm in _CALM]
    uneven, _, inverses = min((_unevenness(_run_all(gyro.values, each)), i, each) for i, each in enumerate(tries))
    if uneven > _EVEN:
        return log
    gyro, command = (LogSignal(time=each.time, values=_run_all(each.values, inverses)) for each in (gyro, command))
    return replace(log, gyro=gyro, command=command)


def _unevenness(values: Array) -> float:
    """Return how far parts of the upper half of the spectrum of values (n, 3) differ, as a logarithm."""
    power = welch(values, axis=0, nperseg=min(256, len(values)))[1].sum(axis=1)
    parts = np.array_split(power[len(power) // 2 : int(_UPPER_END * len(power))], 5)
    sizes = [max(float(np.median(part)), 1e-300) for part in parts]
    return math.log(max(sizes) / min(sizes))


def _invert(filtered: Biquad, calm: float) -> Biquad:
    """Return the inverse of a filter of gain 1 at rest, with poles of a low-pass drawn in to `calm`, where it is."""
    b0, b1, b2, a1, a2 = filtered
    most = _CALM_NOTCH if b1 * b1 < 4.0 * b0 * b2 else calm
    poles = np.roots([b0, b1, b2])
    c1, c2 = np.real(np.poly(poles * np.minimum(1.0, most / np.maximum(np.abs(poles), most))))[1:]
    gain = (1.0 + c1 + c2) / (1.0 + a1 + a2)
    return Biquad(gain, gain * a1, gain * a2, float(c1), float(c2))


def _run_all(values: Array, filters: list[Biquad]) -> Array:
    """Return values (n, k) behind filters."""
    return np.column_stack([run_filters(column, filters) for column in values.T])


def _pass_through(signal: LogSignal, filters: list[Biquad], step: float) -> LogSignal:
    """Return a signal that is held between its samples behind filters that run each `step` [s]."""
    time = np.arange(signal.time[0], signal.time[-1] + _FINER * step, step)
    held = np.searchsorted(signal.time, time + 1e-3 * step, side="right") - 1
    begins = np.minimum(np.searchsorted(time + 1e-3 * step, signal.time), len(time) - 1)
    columns = [_mean_between(run_filters(column[held], filters), begins) for column in signal.values.T]
    return LogSignal(time=signal.time, values=np.column_stack(columns))


def run_filters(values: Array, filters: list[Biquad]) -> Array:
    """Return values (n,) behind filters that are settled at the first."""
    for b0, b1, b2, a1, a2 in filters:
        b, a = (b0, b1, b2), (1.0, a1, a2)
        values = lfilter(b, a, values, zi=lfilter_zi(b, a) * values[0])[0]
    return values


def _mean_between(values: Array, begins: Indices) -> Array:
    """Return the means of the samples from each of `begins` (n,) to the next."""
    count = np.maximum(np.diff(begins, append=len(values)), 1)
    return np.asarray(np.add.reduceat(values, begins) / count)
