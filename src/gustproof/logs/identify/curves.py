"""Curves of one axis: accelerations measured and predicted, frequency response, and the disturbance between them."""

from dataclasses import dataclass

import numpy as np

from gustproof.logs.identify.likelihood import (
    DAMPING,
    DELAY,
    FAST,
    FAST_DRIVE,
    GAINS,
    LAG,
    NOISE,
    SLOW,
    SLOW_DRIVE,
    AxisData,
)
from gustproof.logs.identify.spectra import (
    FrequencyResponse,
    even_series,
    frequency_response,
    high_pass,
    low_pass,
    power_share,
)
from gustproof.logs.read.flight_log import LogSignal
from gustproof.types import Array

_LOWEST, _HIGHEST = 0.5, 25.0  # [Hz] of the accelerations that are compared


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curves:
    """Series of one axis, evenly spaced in each stretch."""

    time: list[Array]
    """(n,) [s] of each stretch."""
    command: list[Array]
    """(n,) command, or the motors' squares, weighted by their gains."""
    rate: list[Array]
    """(n,) [rad/s] measured."""
    caused: list[Array]
    """(n,) [rad/s] rate that command and trim alone cause."""
    damping: float
    """[1/s]."""
    dt: float
    """[s] from sample to sample."""

    def accelerations(self, corner: float) -> tuple[Array, Array]:
        """Return the accelerations measured and predicted, (n,) [rad/s^2], low-passed at `corner` [Hz]."""
        measured = [low_pass(np.gradient(rate, self.dt), self.dt, corner) for rate in self.rate]
        predicted = [
            low_pass(np.gradient(caused, self.dt) + self.damping * (caused - rate), self.dt, corner)
            for caused, rate in zip(self.caused, self.rate, strict=True)
        ]
        return np.concatenate(measured), np.concatenate(predicted)

    def response(self, reference: LogSignal | None, axis: int) -> FrequencyResponse:
        """Return the measured frequency response, by the reference as an instrument if there is one."""
        series = [
            (command, rate, None if reference is None else np.interp(time, reference.time, reference.values[:, axis]))
            for time, command, rate in zip(self.time, self.command, self.rate, strict=True)
        ]
        return frequency_response(series, self.dt, _HIGHEST)

    def corner(self) -> float:
        """Return the frequency [Hz] below which lie 99 % of the power of the acceleration by the command."""
        share = power_share([np.gradient(caused, self.dt) for caused in self.caused], self.dt, 0.99)
        return float(np.clip(share, 3.0, _HIGHEST))

    def r_squared(self, corner: float) -> float:
        """Return R^2 of the acceleration predicted from the command alone, from .5 Hz to `corner` [Hz]."""
        left = total = 0.0
        for rate, caused in zip(self.rate, self.caused, strict=True):
            pair = np.gradient(np.column_stack([rate, caused]), self.dt, axis=0)
            y, p = high_pass(low_pass(pair, self.dt, corner), self.dt, _LOWEST).T
            left, total = left + float(np.sum((y - p) ** 2)), total + float(np.sum(y**2))
        return 1.0 - left / total if total > 0.0 else 0.0


def make_curves(data: AxisData, theta: Array, dt: float) -> Curves:
    """Return the series of an axis under some parameters."""
    gains = theta[GAINS:-1]
    weights = gains / np.sum(np.abs(gains)) if data.square and np.any(gains) else np.ones(len(gains))
    curves = Curves(time=[], command=[], rate=[], caused=[], damping=float(theta[DAMPING]), dt=dt)
    ends = np.cumsum([len(s.time) for s in data.stretches])[:-1]
    for stretch, caused in zip(data.stretches, np.split(data.response(theta) @ theta[GAINS:], ends), strict=True):
        channels = stretch.command[:, data.channels[:-1]]
        command = np.interp(stretch.time, stretch.command_time, (channels**2 if data.square else channels) @ weights)
        series = even_series(stretch.time, (command, stretch.rate[:, data.axis], caused), dt)
        for values, held in zip(series, (curves.time, curves.command, curves.rate, curves.caused), strict=True):
            held.append(values)
    return curves


def model_response(theta: Array, omega: Array, gain: float) -> Array:
    """Return the response (f,) complex of angular acceleration to the command at `omega` [rad/s]."""
    s = 1j * omega
    lagged = gain * np.exp(-s * theta[DELAY]) / (1.0 + s * np.exp(theta[LAG]))
    return np.asarray(lagged * s / (s + theta[DAMPING]))


def disturbance_rms(curves: Curves, theta: Array) -> float:
    """Return the rms [rad/s^2] of the disturbance in this flight, about its mean.

    The residual holds disturbance and gyro noise. Of its spectrum at each frequency counts the share that the model
    gives to the disturbance (Wiener's filter). That is the mean square of the estimate and its uncertainty together.
    """
    noise = 2.0 * np.exp(theta[NOISE]) * curves.dt
    power = weight = 0.0
    for rate, caused in zip(curves.rate, curves.caused, strict=True):
        residual = np.gradient(rate - caused, curves.dt) + curves.damping * (rate - caused)
        n = len(residual)
        omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(n, curves.dt)[1:], dtype=np.float64)
        wanted = _disturbance_density(theta, omega)
        share = wanted / (wanted + noise * (omega**2 + curves.damping**2))
        spectrum = np.abs(np.fft.rfft(residual - residual.mean())[1:]) ** 2
        power, weight = power + float(2.0 * share @ spectrum) / n, weight + n
    return float(np.sqrt(power / weight))


def disturbance_corner(theta: Array) -> float:
    """Return the frequency [rad/s] at which the spectrum of the disturbance falls to a half of its highest."""
    omega = np.geomspace(1e-2, 1e3, 2001)
    density = _disturbance_density(theta, omega)
    return float(omega[np.flatnonzero(density > 0.5 * density[0])[-1]])


def _disturbance_density(theta: Array, omega: Array) -> Array:
    """Return the one-sided density [rad^2/s^4/(rad/s) times pi] of the disturbance at `omega` [rad/s]."""
    parts = ((theta[SLOW], theta[SLOW_DRIVE]), (theta[FAST], theta[FAST_DRIVE]))
    return np.asarray(sum(2.0 * np.exp(drive) / (omega**2 + np.exp(2.0 * corner)) for corner, drive in parts))
