"""Frequency response from command to angular acceleration, and the accelerations themselves."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, get_window, sosfiltfilt

from gustproof.types import Array

_WINDOW = 4.0  # [s] of a spectrum's segment, half of it shared with the next
_LINES = 60  # frequencies of a response


class FrequencyResponse(NamedTuple):
    """Frequency response of one axis."""

    omega: Array
    """(f,) [rad/s]."""
    response: Array
    """(f,) complex [rad/s^2 per unit of command]."""
    coherence: Array
    """(f,) [0..1]."""


def even_series(time: Array, values: Sequence[Array], dt: float) -> list[Array]:
    """Return series at even times, by linear interpolation; the first is the time itself."""
    even = np.arange(time[0], time[-1] + 0.5 * dt, dt)
    return [even, *(np.interp(even, time, each) for each in values)]


def frequency_response(
    series: Sequence[tuple[Array, Array, Array | None]], dt: float, highest: float
) -> FrequencyResponse:
    """Return the response of rate to command, times `j omega`, up to `highest` [Hz].

    Spectra are averaged over segments, and over lines to even steps of log frequency. A reference, if all `series` of
    (command, rate, reference) have one, is the instrument: it is free of the disturbance, which the command is not.

    References
    ----------
    J. S. Bendat, A. G. Piersol, Random Data, 2010, chapters 6 and 9.
    """
    length = max(8, min(round(_WINDOW / dt), *(len(command) for command, *_ in series)))
    window, sums = get_window("hann", length), np.zeros((5, length // 2 + 1), dtype=np.complex128)
    for command, rate, reference in series:
        for begin in range(0, len(command) - length + 1, length // 2):
            u, y, z = (
                np.fft.rfft(window * (each[begin : begin + length] - np.mean(each[begin : begin + length])))
                for each in (command, rate, command if reference is None else reference)
            )
            sums += np.array([abs(u) ** 2, abs(y) ** 2, np.conj(u) * y, np.conj(z) * y, np.conj(z) * u])
    frequency = np.fft.rfftfreq(length, dt)
    edges = np.geomspace(0.75 * frequency[1], min(highest, 0.4 / dt), _LINES + 1)
    number = np.digitize(frequency, edges)
    lines = [np.flatnonzero(number == i) for i in range(1, _LINES + 1)]
    lines = [line for line in lines if len(line)]
    uu, yy, uy, zy, zu = np.array([sums[:, line].mean(axis=1) for line in lines]).T
    omega = 2.0 * np.pi * np.array([frequency[line].mean() for line in lines])
    tiny = np.finfo(float).tiny
    coherence = np.abs(uy) ** 2 / np.maximum(np.real(uu * yy), tiny)
    return FrequencyResponse(omega, 1j * omega * zy / np.where(zu == 0.0, np.inf, zu), np.minimum(coherence, 1.0))


def low_pass(values: Array, dt: float, corner: float) -> Array:
    """Return a series (n, ...) without phase shift, low-passed at `corner` [Hz]."""
    sections = butter(2, min(corner, 0.45 / dt), fs=1.0 / dt, output="sos")
    return np.asarray(sosfiltfilt(sections, values, axis=0))


def high_pass(values: Array, dt: float, corner: float) -> Array:
    """Return a series (n, ...) without phase shift, high-passed at `corner` [Hz]."""
    return np.asarray(sosfiltfilt(butter(2, corner, "high", fs=1.0 / dt, output="sos"), values, axis=0))


def power_share(series: Sequence[Array], dt: float, share: float) -> float:
    """Return the frequency [Hz] below which lies a `share` of the power of all `series` (n,)."""
    frequency = np.concatenate([np.fft.rfftfreq(len(each), dt) for each in series])
    power = np.concatenate([np.abs(np.fft.rfft(each - each.mean())) ** 2 / len(each) for each in series])
    order = np.argsort(frequency)
    total = np.cumsum(power[order])
    return float(frequency[order][np.searchsorted(total, share * total[-1])])
