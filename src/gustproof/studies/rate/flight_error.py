"""Attitude error that a logged flight would have had with other gains, by the ratio of the loops' sensitivities."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.types import Vector
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.law.form import Law
from gustproof.logs.identify.stretches import find_stretches, sample_time
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.robust.lti.state_space import ComplexMatrix
from gustproof.types import Array

_PIECE_S = 20.0
LEAST_HZ = 0.1
"""[Hz] below it an error counts as trim, which is not predicted."""
_MOST_HZ, _PER_SAMPLE = 20.0, 0.4  # the band ends at [Hz], and at this share of the sample rate


def flight_errors(
    log: FlightLog, flown: Law, laws: Sequence[Law], vehicle: Vehicle, scenario: Scenario
) -> list[Vector]:
    """Return the rms error [rad] of roll, pitch and yaw in a flight of `flown`, as each of the laws would have it.

    Each frequency of the logged error of set-point and attitude is multiplied by |S_law / S_flown|. S = 1 / (1 - K P)
    is the sensitivity of an axis, with the vehicle's response P as in the scenario. So nothing is taken for granted of
    the disturbance. What is left out is the part of a set-point that reaches the command past the error.

    The laws must keep the vehicle stable. The list is empty for a log without set-points, or without 20 s in a stretch.
    """
    if log.attitude is None or log.reference is None or min(len(log.attitude.time), len(log.reference.time)) < 2:
        return []
    dt = max(sample_time(log.attitude), sample_time(log.reference))
    size = round(_PIECE_S / dt)
    frequency = np.fft.rfftfreq(size, dt)
    band = (frequency >= LEAST_HZ) & (frequency <= min(_MOST_HZ, _PER_SAMPLE / dt))
    power = _error_power(log.attitude, log.reference, find_stretches(log, log.reference), dt, size)
    if power is None or not band.any():
        return []
    omega: Array = np.asarray(2.0 * math.pi * frequency[band])
    P = np.diagonal(hover_plant(vehicle, scenario).response(omega), axis1=1, axis2=2)
    now, found = _square_sensitivity(flown, P, omega), list[Vector]()
    for law in laws:
        roll, pitch, yaw = np.sqrt(np.sum(power[band] * _square_sensitivity(law, P, omega) / now, axis=0)).tolist()
        found.append((roll, pitch, yaw))
    return found


def _square_sensitivity(law: Law, P: ComplexMatrix, omega: Array) -> Array:
    """Return |S|^2 [-] (k, 3) of the axes of a law."""
    K = np.diagonal(loop_law(law).response(omega)[:, :, :3], axis1=1, axis2=2)
    return np.asarray(np.abs(1.0 - np.multiply(K, P)) ** -2.0)


def _error_power(
    attitude: LogSignal, reference: LogSignal, spans: Sequence[tuple[float, float]], dt: float, size: int
) -> Array | None:
    """Return the mean square [rad^2] (k, 3) of the error at each frequency, from pieces of `size` samples of `dt` [s].

    It is `None` without a piece.
    """
    window = np.hanning(size)[:, None]
    pieces = list[Array]()
    for begin, end in spans:
        time = np.arange(begin, end, dt)
        if len(time) < size:
            continue
        error = _sample(attitude, time) - _sample(reference, time)
        for piece in sliding_window_view(error, size, axis=0)[:: size // 2]:
            level = piece.T - np.mean(piece, axis=1)  # whole turns between the two go with the mean
            pieces.append(np.abs(np.fft.rfft(window * level, axis=0)) ** 2)
    if not pieces:
        return None
    return np.asarray(np.mean(pieces, axis=0) * 2.0 / (size * np.sum(window**2)))


def _sample(signal: LogSignal, time: Array) -> Array:
    """Return angles [rad] (n, 3) at times [s], without jumps at whole turns."""
    return np.column_stack([np.interp(time, signal.time, angle) for angle in np.unwrap(signal.values, axis=0).T])
