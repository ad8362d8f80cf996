"""Check of a log's commands against the loops of its parameters: whether those are the gains that flew."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy import signal

from firmware_model.config.gyro_filters import gyro_filters
from gustproof.design.loops.models import AUTOPILOTS
from gustproof.design.loops.settings import complete
from gustproof.logs.identify.filtered_command import run_filters
from gustproof.logs.identify.stretches import sample_time
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.types import Array

_BAND_HZ = (0.7, 8.0)  # below it integrals have limits, above it sparse samples fold vibration down
_PER_SAMPLE = 0.3  # of the sample rate that the band ends at
_SHORTEST_S = 10.0
_AXES = {"roll": ("ROLL", "RLL"), "pitch": ("PITCH", "PIT"), "yaw": ("YAW", "YAW")}
_EXPLAINED, _SCALES = 0.7, (0.6, 1.6)
"""[-] least share of the command that must be explained before its size is doubted; sizes that are not doubted."""


class _Loop(NamedTuple):
    """Rate loop of one axis: gains of a command of 1 [per rad/s], and corners of its filters [Hz], 0 for none.

    D acts on the slope of the rate in PX4, on that of the error in ArduPilot.
    """

    P: float
    I: float  # noqa: E741
    D: float
    FF: float
    target: float
    error: float
    slope: float
    command: float
    is_of_error: bool


def doubt_flown_gains(log: FlightLog) -> list[str]:
    """Return a remark for each axis whose logged command is not that of its parameters' loop, by its size.

    The loop is fed with logged rates and their set-points. What it gives is compared with the command, .7 to 8 Hz.
    An axis whose command it does not explain is not doubted: sparse samples or vibration may be the cause. There is no
    remark without logged set-points, or for another autopilot.
    """
    if log.system not in AUTOPILOTS or log.command is None or log.rate_reference is None:
        return []
    values, found = complete(AUTOPILOTS[log.system], log.parameters), []
    dt = max(map(sample_time, (log.gyro, log.command, log.rate_reference)))
    if 2.0 * _BAND_HZ[0] * dt > _PER_SAMPLE:
        return []
    for axis, name in enumerate(_AXES):
        loop = _find_loop(log.system, name, values)
        command, caused = _compare(log, log.command, log.rate_reference, axis, loop, dt)
        both, own = float(command @ caused), float(caused @ caused)
        share = both**2 / max(own * float(command @ command), 1e-300)
        if share > _EXPLAINED and not _SCALES[0] < both / own < _SCALES[1]:
            found.append(
                f"{name}: the loop of its parameters explains {100.0 * share:.0f} % of the logged command, which is "
                f"{both / own:.2g} times as large: the gains that flew may be others"
            )
    return found


def _find_loop(kind: str, axis: str, values: Mapping[str, float]) -> _Loop:
    px4, ardupilot = _AXES[axis]
    if kind == "px4":
        P, I, D, K, FF = (values[f"MC_{px4}RATE_{each}"] for each in ("P", "I", "D", "K", "FF"))  # noqa: E741
        command = values["MC_YAW_TQ_CUTOFF"] if axis == "yaw" else 0.0
        return _Loop(K * P, K * I, K * D, FF, 0.0, 0.0, values["IMU_DGYRO_CUTOFF"], command, False)
    P, I, D, FF, target, error, slope = (  # noqa: E741
        values[f"ATC_RAT_{ardupilot}_{each}"] for each in ("P", "I", "D", "FF", "FLTT", "FLTE", "FLTD")
    )
    return _Loop(P, I, D, FF, target, error, slope, 0.0, True)


def _compare(
    log: FlightLog, command: LogSignal, reference: LogSignal, axis: int, loop: _Loop, dt: float
) -> tuple[Array, Array]:
    """Return the logged command of an axis (n,), and that of a loop fed with the log, in the band, each `dt` [s]."""
    band = signal.butter(2, (_BAND_HZ[0], min(_BAND_HZ[1], _PER_SAMPLE / dt)), "band", fs=1.0 / dt, output="sos")
    found = [np.zeros(0)], [np.zeros(0)]
    for begin, end in log.airborne or ():
        time = np.arange(begin, end, dt)
        if end - begin < _SHORTEST_S:
            continue
        rate, slope = _sample_gyro(log, time, axis, loop.slope)
        target = _low_pass(np.interp(time, reference.time, reference.values[:, axis]), loop.target, dt)
        error = _low_pass(target - rate, loop.error, dt)
        if loop.is_of_error:
            slope = _low_pass(-np.gradient(error, dt), loop.slope, dt)
        caused = loop.P * error + loop.I * dt * np.cumsum(error) - loop.D * slope + loop.FF * target
        logged = np.interp(time, command.time, command.values[:, axis])
        for rows, values in zip(found, (logged, _low_pass(caused, loop.command, dt)), strict=True):
            rows.append(signal.sosfiltfilt(band, values))
    return np.concatenate(found[0]), np.concatenate(found[1])


def _sample_gyro(log: FlightLog, time: Array, axis: int, corner: float) -> tuple[Array, Array]:
    """Return the rate as the loops read it, and its slope behind a low-pass at `corner` [Hz]."""
    dt = sample_time(log.gyro)
    fine = np.arange(time[0], time[-1] + dt, dt)
    rate = np.interp(fine, log.gyro.time, log.gyro.values[:, axis])
    if log.is_gyro_raw:
        rate = run_filters(rate, gyro_filters(log.system, log.parameters, 1.0 / dt))
    slope = _low_pass(np.gradient(rate, dt), corner, dt)
    return np.interp(time, fine, rate), np.interp(time, fine, slope)


def _low_pass(values: Array, corner: float, dt: float) -> Array:
    """Return values behind a low-pass of the first order at `corner` [Hz]; the same for 0."""
    if corner == 0.0:
        return values
    share = 1.0 - math.exp(-2.0 * math.pi * corner * dt)
    return np.asarray(signal.lfilter([share], [1.0, share - 1.0], values))
