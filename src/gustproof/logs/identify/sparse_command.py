"""Command between its logged samples, for logs that keep only some of an autopilot's commands.

By default PX4 logs the torque at 50 Hz, where its loops run at 400 Hz. Between two samples the command is not held: it
goes on answering the gyro, whose samples are closer. So the command is taken as a smooth part and an answer to the
low-passed gyro and its slope. Their gains are those that explain the command's second differences best. Only the
smooth part is interpolated. That needs neither the autopilot's gains nor its version, and the share that is explained
tells how far it holds.
"""

from dataclasses import replace

import numpy as np
from scipy.signal import butter, lfilter

from gustproof.logs.identify.stretches import LONGEST_GAP, sample_time
from gustproof.logs.read.assemble import TOO_SLOW
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.types import Array

_LOOP_RATES = {
    "px4": ("IMU_GYRO_RATEMAX", 400.0),
    "ardupilot": ("SCHED_LOOP_RATE", 400.0),
    "crazyflie": ("", 500.0),
}
"""Parameter and default [Hz] of the rate of the loops that make the command, by the writer of the log."""
_SPARSE = 1.5  # steps of the loop from one logged command to the next, from which on some are missing
_STEP = 0.005  # [s] largest between two commands that are filled in
_CORNERS = (15.0, 25.0, 40.0, 60.0, 90.0)  # [Hz] of the gyro's low-pass that are tried
_LARGEST_CORNER = 0.45  # of the gyro's rate


def is_whole(log: FlightLog) -> bool:
    """Return whether a log is known to have each command of the autopilot's loop, which then holds it."""
    rate = log.parameters.get(_LOOP_RATES.get(log.system, ("", 0.0))[0], 0.0)
    return log.command is not None and rate > 0.0 and sample_time(log.command) * rate < _SPARSE


def fill_command(log: FlightLog) -> FlightLog | None:
    """Return the log with its command at even, close times; `None` if none of the loop's commands is known to miss."""
    command, gyro = log.command, log.gyro
    if command is None or len(command.time) < 3 or log.system not in _LOOP_RATES:
        return None
    name, usual = _LOOP_RATES[log.system]
    step = sample_time(command)
    if step * log.parameters.get(name, usual) < _SPARSE:
        return None
    dt = min(sample_time(gyro), _STEP)
    time = np.arange(command.time[0], command.time[-1], dt)
    before = np.searchsorted(command.time, time, side="right") - 1
    gaps = np.append(np.diff(command.time), 0.0)
    time = time[gaps[before] <= max(LONGEST_GAP, 3.0 * step)]
    columns, shares = zip(*(_fill_axis(gyro, command, axis, time) for axis in range(3)), strict=True)
    told = ", ".join(f"{100.0 * share:.0f}" for share in shares)
    line = (
        f"command: {1.0 / step:.0f} Hz of a loop of {log.parameters.get(name, usual):.0f} Hz is logged; between its "
        f"samples it is filled in by the gyro, which explains {told} % of its quick part in roll, pitch, yaw"
    )
    filled = LogSignal(time=time, values=np.column_stack(columns))
    others = [each for each in log.findings if not (each.startswith("command: ") and each.endswith(TOO_SLOW))]
    return replace(log, command=filled, findings=(*others, line))


def _fill_axis(gyro: LogSignal, command: LogSignal, axis: int, time: Array) -> tuple[Array, float]:
    """Return the command of an axis at `time` (n,) [s], and the share [-] of its second differences explained."""
    rate, dt, logged = gyro.values[:, axis], sample_time(gyro), command.values[:, axis]
    quick = _second_differences(logged)
    power = float(quick @ quick)
    best, answer = 0.0, np.zeros(len(rate))
    for corner in _CORNERS:
        if corner * dt > _LARGEST_CORNER or power == 0.0:
            break
        low = lfilter(*butter(2, corner, fs=1.0 / dt), rate - rate[0])
        signals = np.column_stack([low, np.gradient(low, dt)])
        seen = np.column_stack([_second_differences(np.interp(command.time, gyro.time, each)) for each in signals.T])
        gains = np.linalg.lstsq(seen, quick, rcond=None)[0]
        left = quick - seen @ gains
        if (share := 1.0 - float(left @ left) / power) > best:
            best, answer = share, signals @ gains
    smooth = logged - np.interp(command.time, gyro.time, answer)
    return np.interp(time, command.time, smooth) + np.interp(time, gyro.time, answer), best


def _second_differences(values: Array) -> Array:
    return np.asarray(np.diff(values, 2))
