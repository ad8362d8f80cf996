"""Command between its logged samples, for logs that keep only some of an autopilot's commands.

By default PX4 logs the torque at 50 Hz, where its loops run at 400 Hz. Between two samples the command is not held: it
goes on answering the gyro, whose samples are closer. So the command is taken as a smooth part and an answer to the
filtered gyro and its slope. Filters are those of the autopilot's parameters, or one of several low-passes where that
explains more. Gains are those that explain the command's second differences best. Only the smooth part is interpolated.
That needs neither the autopilot's gains nor its version, and the share that is explained tells how far it holds.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, lfilter

from firmware_model.config.gyro_filters import gyro_filters
from gustproof.logs.identify.filtered_command import run_filters
from gustproof.logs.identify.rates import is_sparse, loop_rate
from gustproof.logs.identify.stretches import LONGEST_GAP, sample_time
from gustproof.logs.read.assemble import TOO_SLOW
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.types import Array

_SLOPES = {
    "px4": ("IMU_DGYRO_CUTOFF",) * 3,
    "ardupilot": ("ATC_RAT_RLL_FLTD", "ATC_RAT_PIT_FLTD", "ATC_RAT_YAW_FLTD"),
    "crazyflie": ("",) * 3,
}
"""Parameter [Hz] of the low-pass of each axis' slope, by the writer of the log."""
_STEP = 0.005  # [s] largest between two commands that are filled in
_CORNERS = (15.0, 25.0, 40.0, 60.0, 90.0)  # [Hz] of the gyro's low-pass that are tried
_LARGEST_CORNER = 0.45  # of the gyro's rate
_CLOSER, _CLOSE = 2.0, 0.01  # gyro samples between two commands, and [s] between those, to see what filters see
_USUAL, _ROUNDS = 2.0, 10  # median errors of full weight; rounds that the weights take to settle


class Filled(NamedTuple):
    """A log whose commands are filled in."""

    log: FlightLog
    """Log with its command at even, close times."""
    step: float
    """[s] between two commands that are logged."""
    shares: tuple[float, ...]
    """(3,) [-] of each axis' quick part that the gyro explains."""


def fill_command(log: FlightLog) -> Filled | None:
    """Return the log with its command filled in; `None` if none of the loop's commands is known to miss."""
    command, gyro = log.command, log.gyro
    if command is None or len(command.time) < 3 or not is_sparse(log, command):
        return None
    step = sample_time(command)
    dt = min(sample_time(gyro), _STEP)
    time = np.arange(command.time[0], command.time[-1], dt)
    before = np.searchsorted(command.time, time, side="right") - 1
    gaps = np.append(np.diff(command.time), 0.0)
    time = time[gaps[before] <= max(LONGEST_GAP, 3.0 * step)]
    columns, shares = zip(*(_fill_axis(log, command, axis, time) for axis in range(3)), strict=True)
    told = ", ".join(f"{100.0 * share:.0f}" for share in shares)
    line = (
        f"command: {1.0 / step:.0f} Hz of a loop of {loop_rate(log):.0f} Hz is logged; between its "
        f"samples it is filled in by the gyro, which explains {told} % of its quick part in roll, pitch, yaw"
    )
    filled = LogSignal(time=time, values=np.column_stack(columns))
    others = [each for each in log.findings if not (each.startswith("command: ") and each.endswith(TOO_SLOW))]
    return Filled(replace(log, command=filled, findings=(*others, line)), step, shares)


def _fill_axis(log: FlightLog, command: LogSignal, axis: int, time: Array) -> tuple[Array, float]:
    """Return the command of an axis at `time` (n,) [s], and the share [-] of its second differences explained."""
    gyro, logged = log.gyro, command.values[:, axis]
    quick = np.diff(logged, 2)
    power = least = _usual_square(quick)
    when, answer = gyro.time, np.zeros(len(gyro.time))
    for at, signals in _answers(log, command, axis):
        seen = np.column_stack([np.diff(np.interp(command.time, at, each), 2) for each in signals.T])
        gains = _fit_robustly(seen, quick)
        if (left := _usual_square(quick - seen @ gains)) < least:
            least, when, answer = left, at, signals @ gains
    smooth = logged - np.interp(command.time, when, answer)
    return np.interp(time, command.time, smooth) + np.interp(time, when, answer), 1.0 - least / max(power, 1e-300)


def _answers(log: FlightLog, command: LogSignal, axis: int) -> Iterator[tuple[Array, Array]]:
    """Yield times (n,) [s], and the gyro and its slope (n, 2) behind filters: those of the parameters, then others.

    A slow gyro, or one that is no closer than the commands, tells nothing of what those filters see.
    """
    gyro, dt = log.gyro, sample_time(log.gyro)
    rate = gyro.values[:, axis] - gyro.values[0, axis]
    hertz = loop_rate(log)
    if hertz is not None and dt < min(_CLOSE, sample_time(command) / _CLOSER):
        at = np.arange(gyro.time[0], gyro.time[-1], 1.0 / hertz)
        filters = gyro_filters(log.system, log.parameters, hertz) if log.is_gyro_raw else []
        low = run_filters(np.interp(at, gyro.time, rate), filters)
        passed = 2.0 * math.pi * log.parameters.get(_SLOPES[log.system][axis], 0.0) / hertz
        share = passed / (1.0 + passed) if passed > 0.0 else 1.0
        yield at, np.column_stack([low, lfilter([share], [1.0, share - 1.0], np.diff(low, prepend=low[0]) * hertz)])
    for corner in _CORNERS:
        if corner * dt <= _LARGEST_CORNER:
            low = lfilter(*butter(2, corner, fs=1.0 / dt), rate)
            yield gyro.time, np.column_stack([low, np.gradient(low, dt)])


def _fit_robustly(signals: Array, wanted: Array) -> Array:
    """Return the gains (m,) of `signals` (n, m) that explain most of `wanted` (n,).

    Steps of the sticks are no answer to the gyro: they are few and large, and weigh little.

    References
    ----------
    P. J. Huber, Robust Statistics, 1981, section 7.8: modified weights.
    """
    gains, weight = np.zeros(signals.shape[1]), np.ones(len(wanted))
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        gains = np.asarray(np.linalg.lstsq(signals * root[:, None], wanted * root, rcond=None)[0], dtype=np.float64)
        size = np.abs(wanted - signals @ gains)
        weight = np.asarray(np.minimum(1.0, _USUAL * np.median(size) / np.maximum(size, 1e-300)))
    return gains


def _usual_square(values: Array) -> float:
    """Return the square of the median size of values (n,)."""
    return float(np.median(np.abs(values))) ** 2
