"""Attitude error that a logged flight would have had with other gains, by what the loops make of its causes."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.types import Vector
from gustproof.airframe.hover import hover_plant, linear_law, loop_law
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

    The logged error of attitude and set-point is that of the set-point r and of a disturbance, S d + R r. Here
    S = 1 / (1 - K P) is the sensitivity of an axis, with the vehicle's response P as in the scenario. R is the error by
    a set-point of 1. A law has its own S and R; d stays, so that nothing is taken for granted of it.

    R is that of the law as it is, or -S if the rate of the set-point is fed forward. Whichever leaves the smaller
    disturbance in this flight is taken.

    The laws must keep the vehicle stable. The list is empty for a log without set-points, or without 20 s in a stretch.
    """
    if log.attitude is None or log.reference is None or min(len(log.attitude.time), len(log.reference.time)) < 2:
        return []
    dt = max(sample_time(log.attitude), sample_time(log.reference))
    size = round(_PIECE_S / dt)
    frequency = np.fft.rfftfreq(size, dt)
    band = (frequency >= LEAST_HZ) & (frequency <= min(_MOST_HZ, _PER_SAMPLE / dt))
    spectra = _spectra(log.attitude, log.reference, find_stretches(log, log.reference), dt, size)
    if spectra is None or not band.any():
        return []
    error, reference = (each[:, band] for each in spectra)
    omega: Array = np.asarray(2.0 * math.pi * frequency[band])
    P = np.diagonal(hover_plant(vehicle, scenario).response(omega), axis1=1, axis2=2)
    S, R = _responses(flown, P, omega)
    by_attitude, fed_forward = _power(error - R * reference), _power(error + S * reference)
    reads_attitude, found = by_attitude < fed_forward, list[Vector]()
    for law in laws:
        S_law, R_law = _responses(law, P, omega)
        of_set_point = np.where(reads_attitude, R_law - S_law / S * R, 0.0) * reference
        roll, pitch, yaw = np.sqrt(_power(S_law / S * error + of_set_point)).tolist()
        found.append((roll, pitch, yaw))
    return found


def _responses(law: Law, P: ComplexMatrix, omega: Array) -> tuple[ComplexMatrix, ComplexMatrix]:
    """Return S [-] and R [-] (k, 3) of the axes of a law: errors by a disturbance and by a set-point of 1."""
    K = np.diagonal(loop_law(law).response(omega)[:, :, :3], axis1=1, axis2=2)
    to_command = np.diagonal(linear_law(law, inputs=law.D.shape[1]).response(omega)[:, :, 3:6], axis1=1, axis2=2)
    S: ComplexMatrix = np.asarray(1.0 / (1.0 - K * P), dtype=complex)
    return S, np.asarray(S * P * to_command / (1j * omega[:, None]) - 1.0, dtype=complex)


def _power(spectrum: ComplexMatrix) -> Array:
    """Return the mean square [rad^2] (3,) of what has a spectrum (pieces, k, 3)."""
    return np.asarray(np.mean(np.sum(np.abs(spectrum) ** 2, axis=1), axis=0))


def _spectra(
    attitude: LogSignal, reference: LogSignal, spans: Sequence[tuple[float, float]], dt: float, size: int
) -> tuple[ComplexMatrix, ComplexMatrix] | None:
    """Return the spectra [rad] (pieces, k, 3) of error and set-point, from pieces of `size` samples of `dt` [s].

    Their squares are the mean squares at each frequency. It is `None` without a piece.
    """
    window = np.hanning(size)[:, None]
    scale = math.sqrt(2.0 / (size * float(np.sum(window**2))))
    pieces: tuple[list[ComplexMatrix], list[ComplexMatrix]] = [], []
    for begin, end in spans:
        time = np.arange(begin, end, dt)
        if len(time) < size:
            continue
        wanted, flown = _sample(reference, time), _sample(attitude, time)
        for found, signal in zip(pieces, (flown - _turn(wanted, flown), wanted), strict=True):
            for piece in sliding_window_view(signal, size, axis=0)[:: size // 2]:
                level = piece.T - np.mean(piece, axis=1)  # whole turns between the two go with the mean
                found.append(scale * np.fft.rfft(window * level, axis=0))
    return (np.asarray(pieces[0]), np.asarray(pieces[1])) if pieces[0] else None


def _turn(wanted: Array, flown: Array) -> Array:
    """Return angles [rad] (n, 3) whose thrust points as wanted, roll and pitch being those at the heading as flown.

    An autopilot turns the thrust first. While the heading is off, other angles of roll and pitch do so, and no error.
    A heading that is off by the same angle throughout is in another frame, and turns nothing.
    """
    roll, pitch, _ = wanted.T
    off = wanted[:, 2] - flown[:, 2]
    off -= off.mean()
    right, ahead = -np.sin(roll), np.cos(roll) * np.sin(pitch)
    across = np.sin(off) * ahead + np.cos(off) * right
    along = np.cos(off) * ahead - np.sin(off) * right
    turned = np.arcsin(-across), np.arctan2(along, np.cos(roll) * np.cos(pitch))
    return np.column_stack([*turned, wanted[:, 2]])


def _sample(signal: LogSignal, time: Array) -> Array:
    """Return angles [rad] (n, 3) at times [s], without jumps at whole turns."""
    return np.column_stack([np.interp(time, signal.time, angle) for angle in np.unwrap(signal.values, axis=0).T])
