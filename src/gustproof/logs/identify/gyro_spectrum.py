"""Spectrum of the gyro in flight, by throttle, and the lines in it: propellers, frame, sensor."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import find_peaks

from gustproof.logs.identify.stretches import find_stretches, sample_time
from gustproof.logs.read.flight_log import FlightLog
from gustproof.types import Array

LOWEST_HZ = 15.0
"""[Hz] below it a vehicle moves; above it, it vibrates."""
_SEGMENT_S = 0.64  # 1.6 Hz apart
_BANDS, _LEAST_STEP = 5, 0.015  # bands of throttle, and the least step [-] between two
_ABOUT_HZ = 40.0  # of the background beside a line
_LINE_DB = 7.0  # above it
_MOST = 4
_WIDE_HZ = 4.0  # half of a line
_NEAR = 0.1  # share of a line's frequency within which it is found again at the next throttle
_MOVES = 0.03  # share by which a line of propellers moves, at least
_ENOUGH = 600.0  # [s] of a flight; of a longer one segments are left out evenly
_SEGMENTS = 6  # a spectrum has at least


@dataclass(frozen=True, slots=True, kw_only=True)
class VibrationLine:
    """Narrow peak of the spectrum."""

    hertz: float
    """[Hz]."""
    height_db: float
    """[dB] above what is beside it."""
    share: float
    """[-] of the mean square above 15 Hz, all axes."""
    moves: tuple[float, float] | None
    """[Hz] at the lowest and the highest band of throttle, if it moves; `None` if it does not, or is not known to."""

    def describe(self) -> str:
        """Return the line in words."""
        text = f"{self.hertz:.0f} Hz, {self.height_db:.0f} dB above what is beside it, {100.0 * self.share:.0f} %"
        if self.moves is None:
            return f"{text} of the vibration"
        low, high = self.moves
        return f"{text} of the vibration, from {low:.0f} to {high:.0f} Hz with throttle, as propellers do"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroSpectrum:
    """One-sided spectra of the gyro in the air."""

    hertz: Array
    """(f,) [Hz] above 0, up to half of the logged rate."""
    density: Array
    """(3, f) [(rad/s)^2/Hz] of the whole flight."""
    throttle: tuple[float, ...]
    """[-] mean motor command of each band, rising; empty if it is not logged or hardly moves."""
    by_throttle: tuple[Array, ...]
    """(3, f) [(rad/s)^2/Hz] of each band."""
    lines: tuple[VibrationLine, ...]
    """Lines above 15 Hz, that of most power first."""
    is_raw: bool
    """True if the gyro is known to be logged before the autopilot's filters."""

    @property
    def vibration(self) -> Array:
        """Return the rms (3,) [rad/s] above 15 Hz."""
        above = self.hertz >= LOWEST_HZ
        return np.asarray(np.sqrt(self.density[:, above].sum(axis=1) * (self.hertz[1] - self.hertz[0])))


def gyro_spectrum(log: FlightLog) -> GyroSpectrum | None:
    """Return the spectrum of a log; `None` if it is too short in the air, or too slow, to show vibration.

    References
    ----------
    P. Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Transactions on Audio and
    Electroacoustics 15, 1967.
    """
    dt = sample_time(log.gyro)
    size = round(_SEGMENT_S / dt)
    if 0.5 / dt < 2.0 * LOWEST_HZ:
        return None
    window = np.hanning(size + 1)[:-1]
    powers, throttles = [], []
    spans = find_stretches(log, log.gyro)
    step = max(1, round(sum(end - begin for begin, end in spans) / _ENOUGH)) * (size // 2)
    for begin, end in spans:
        time = np.arange(begin, end, dt)
        rate = np.column_stack([np.interp(time, log.gyro.time, each) for each in log.gyro.values.T])
        for first in range(0, len(time) - size + 1, step):
            part = rate[first : first + size]
            powers.append(np.abs(np.fft.rfft(window[:, None] * (part - part.mean(axis=0)), axis=0)).T ** 2)
            throttles.append(_throttle(log, time[first], time[first + size - 1]))
    if len(powers) < _SEGMENTS:
        return None
    densities = np.array(powers)[:, :, 1:] * 2.0 * dt / np.sum(window**2)
    hertz = np.asarray(np.fft.rfftfreq(size, dt)[1:], dtype=np.float64)
    throttle, bands = _split(densities, np.array(throttles))
    density = densities.mean(axis=0)
    lines = _find_lines(hertz, bands or (density,))
    return GyroSpectrum(
        hertz=hertz, density=density, throttle=throttle, by_throttle=bands, lines=lines, is_raw=log.is_gyro_raw
    )


def _throttle(log: FlightLog, begin: float, end: float) -> float:
    """Return the mean command of all motors between two times; NaN if none is logged."""
    if log.motors is None:
        return math.nan
    first, last = np.searchsorted(log.motors.time, (begin, end))
    return float(log.motors.values[first : last + 1].mean()) if last > first else math.nan


def _split(densities: Array, throttle: Array) -> tuple[tuple[float, ...], tuple[Array, ...]]:
    """Return mean throttle and spectrum of bands with as many segments each; none if they are not apart."""
    known = np.isfinite(throttle)
    order = np.flatnonzero(known)[np.argsort(throttle[known], kind="stable")]
    if len(order) < _BANDS * _SEGMENTS:
        return (), ()
    parts = np.array_split(order, _BANDS)
    means = [float(throttle[part].mean()) for part in parts]
    if min(np.diff(means)) < _LEAST_STEP:
        return (), ()
    return tuple(means), tuple(densities[part].mean(axis=0) for part in parts)


def _find_lines(hertz: Array, spectra: tuple[Array, ...]) -> tuple[VibrationLine, ...]:
    """Return the peaks that stand out of a running median, those of most power first.

    They are those of the middle one of the `spectra` over throttle, followed to the others: a line of propellers is
    smeared over the whole flight.
    """
    step, above = hertz[1] - hertz[0], hertz >= LOWEST_HZ
    levels = [10.0 * np.log10(np.maximum(each.sum(axis=0), 1e-300)) for each in spectra]
    size = 2 * round(0.5 * _ABOUT_HZ / step) + 1
    grounds = [median_filter(level, size, mode="nearest") for level in levels]
    heights = [np.where(above, level - ground, 0.0) for level, ground in zip(levels, grounds, strict=True)]
    middle = len(spectra) // 2
    peaks, _ = find_peaks(heights[middle], height=_LINE_DB, distance=max(1, round(_WIDE_HZ / step)))
    lines = []
    for peak in peaks.tolist():
        places = _follow(hertz, heights, peak)
        shares = [
            _excess(hertz, each, ground, at) / float(each[:, above].sum())
            for each, ground, at in zip(spectra, grounds, places, strict=True)
        ]
        first, last = float(hertz[places[0]]), float(hertz[places[-1]])
        rises = bool(np.all(np.diff(places) >= 0)) and last > (1.0 + _MOVES) * first
        lines.append(
            VibrationLine(
                hertz=float(hertz[peak]),
                height_db=float(heights[middle][peak]),
                share=float(np.mean(shares)),
                moves=(first, last) if rises else None,
            )
        )
    return tuple(sorted(lines, key=lambda line: -line.share)[:_MOST])


def _follow(hertz: Array, heights: list[Array], peak: int) -> list[int]:
    """Return the places of a line of the middle band in all bands, from each to the next."""
    middle, places = len(heights) // 2, {len(heights) // 2: peak}
    for band in (*range(middle + 1, len(heights)), *range(middle - 1, -1, -1)):
        before = hertz[places[band - 1 if band > middle else band + 1]]
        near = np.flatnonzero(np.abs(hertz - before) <= max(_NEAR * before, hertz[1] - hertz[0]))
        places[band] = int(near[np.argmax(heights[band][near])])
    return [places[band] for band in range(len(heights))]


def _excess(hertz: Array, density: Array, ground: Array, place: int) -> float:
    """Return the power of a line above what is beside it."""
    near = np.abs(hertz - hertz[place]) <= _WIDE_HZ
    return float(np.maximum(density[:, near].sum(axis=0) - 10.0 ** (0.1 * ground[near]), 0.0).sum())
