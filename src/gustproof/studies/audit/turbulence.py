"""Intensity and break frequency of recorded turbulence, beside those of the Dryden model.

References
----------
MIL-F-8785C, Military Specification: Flying Qualities of Piloted Airplanes, 1980, section 3.7 (low-altitude model).
P. Whittle, Estimation and Information in Stationary Time Series, Arkiv for Matematik 2, 1953: the likelihood.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy

from firmware_model.config.waveforms import Dryden
from firmware_model.physics.dryden import dryden_spectrum
from gustproof.studies.audit.simulator import HEIGHT, Array, RequestedAir

_WIND_SPEED = 15.0  # [m/s]
TURBULENT = RequestedAir((_WIND_SPEED, 0.0, 0.0), Dryden(wind_speed_20ft_mps=_WIND_SPEED, kind="dryden"))
"""Air of the turbulence tests."""
_BAND = 0.2  # [-] of the Nyquist frequency: below it, how the filters were discretised shows little
_LONGEST = 0.25  # [-] of the record: the longest time constant that is looked for
_SIGMAS = 4.0  # [-] standard deviations of an estimate that chance is allowed


class Turbulence(NamedTuple):
    """Turbulence along three axes: of the model, or estimated from a record."""

    mean: Array
    """(3,) [m/s] N."""
    intensity: Array
    """(3,) [m/s] rms about the mean."""
    break_rate: Array
    """(3,) [rad/s] inverse of the time constant."""


def expected_turbulence() -> Turbulence:
    """Return what MIL-F-8785C has for `TURBULENT`."""
    wind, dryden = TURBULENT
    assert dryden is not None
    model = dryden_spectrum(dryden, HEIGHT, span=1.0)
    intensity = np.array((model.sigma_u, model.sigma_v, model.sigma_w))
    return Turbulence(np.array(wind), intensity, model.airspeed / np.array((model.L_u, model.L_v, model.L_w)))


def chance_deviation(model: Turbulence, duration: float) -> tuple[Array, Array, Array]:
    """Return by how much chance may move each estimate from a record of `duration` [s], in the order of `Turbulence`.

    Each is four standard deviations, for the autocorrelation `exp(-t break_rate)`; that of v and w is shorter.
    """
    share = np.sqrt(2.0 / (model.break_rate * duration))
    return (
        _SIGMAS * share * model.intensity,
        _SIGMAS * 0.5 * share * model.intensity,
        _SIGMAS * share * model.break_rate,
    )


def estimate_turbulence(record: Array, dt: float) -> Turbulence:
    """Return mean, intensity and break frequency of a record (n, 3) [m/s] N with steps of `dt` [s]."""
    rates = [_break_rate(record[:, axis], dt, transverse=axis > 0) for axis in range(3)]
    return Turbulence(record.mean(axis=0), record.std(axis=0), np.array(rates))


def _break_rate(series: Array, dt: float, *, transverse: bool) -> float:
    """Return the inverse time constant [rad/s] of the Dryden spectrum that makes the periodogram most likely."""
    length = len(series)
    if np.ptp(series) == 0.0:
        return math.nan
    power = np.abs(np.fft.rfft(series - series.mean())[1:]) ** 2
    omega = 2.0 * math.pi * np.fft.rfftfreq(length, dt)[1:]
    used = omega < _BAND * math.pi / dt
    power, omega = power[used], omega[used]

    def unlikelihood(log_tau: float) -> float:
        square = (math.exp(log_tau) * omega) ** 2
        shape = (1.0 + 3.0 * square) / (1.0 + square) ** 2 if transverse else 1.0 / (1.0 + square)
        return float(np.log(shape).mean() + math.log(np.mean(power / shape)))

    bounds = (math.log(dt), math.log(_LONGEST * length * dt))
    return math.exp(-scipy.optimize.minimize_scalar(unlikelihood, bounds=bounds, method="bounded").x)
