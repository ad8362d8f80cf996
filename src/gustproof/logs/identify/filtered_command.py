"""Commands behind the filters that the gyro is logged behind, so that a fit does not take those for the vehicle.

An autopilot's loops see the gyro behind notches and a low-pass, and most logs have it from there. With filters F and a
vehicle P, F omega = P F u: the command is passed through the same filters. Their phase is then counted once, in the
loops, and not a second time as lag, delay and gain of the vehicle. A moving notch is taken at its frequency here and in
the loops: these errors cancel.
"""

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter, lfilter_zi

from firmware_model.config.gyro_filters import Biquad, gyro_filters
from gustproof.logs.identify.stretches import Indices, sample_time
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.types import Array

_FINER = 4  # steps of the filters in a sample of the command, which is held


def filter_command(log: FlightLog) -> FlightLog:
    """Return the log with its commands behind the filters of its gyro; as it is if that is raw or none are known.

    Each value is the mean over the time until the next, so that holding it is no delay. Motors' thrust is filtered,
    the square of their command.
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
        return replace(found, command=_pass_through(signal, filters, step))
    squares = _pass_through(LogSignal(time=signal.time, values=signal.values**2), filters, step)
    return replace(found, motors=LogSignal(time=signal.time, values=np.sqrt(np.maximum(squares.values, 0.0))))


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
