"""Turbulence of a scenario, as filters that the flight steps, and the moment of a gust."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.waveforms import RandomGusts
from firmware_model.numerics.compiled import kernel
from firmware_model.physics import gust_filters
from firmware_model.physics.gust_filters import DrydenParams, DrydenSpectrum, low_altitude_spectrum, make_filters
from firmware_model.types import Vector

kernel(gust_filters.transverse_step)
dryden_step, dryden_gust = kernel(gust_filters.dryden_step), kernel(gust_filters.dryden_gust)


def dryden_spectrum(dryden: RandomGusts, altitude: float, span: float) -> DrydenSpectrum:
    """Return intensities and lengths at `altitude` [m], for a `span` [m], of a scenario's turbulence."""
    handbook = dryden.specification == "MIL-HDBK-1797"
    return low_altitude_spectrum(dryden.wind_speed_20ft, altitude, span, dryden.airspeed, handbook=handbook)


@lru_cache(maxsize=256)
def dryden_filters(spectrum: DrydenSpectrum, span: float, dt: float) -> tuple[DrydenParams, NDArray[np.float64]]:
    """Return filters for the step `dt` [s], and the factor (8, 8) of their stationary covariance."""
    params, rows = make_filters(spectrum, span, dt)
    factor = np.array(rows)
    factor.flags.writeable = False
    return params, factor


@kernel
def gust_moment(gain: float, yaw_ratio: float, gust_B: Vector) -> Vector:
    """Return the moment [N*m] B of a gust [m/s] B.

    Each rotor drags along with the air through its plane, F = c (gust), at a height h above the centre of mass.
    With r = (0, 0, -h), r x F = (h c v, -h c u, 0), so `gain` = h c [N*m/(m/s)]. Yaw comes from the rotors' unequal
    response to vertical gusts, `yaw_ratio` times that. On the stand mean wind is trimmed out and gives no moment. In
    free flight all relative air rolls and pitches the vehicle, and its own loop trims out the steady part.
    """
    return gain * gust_B[1], -gain * gust_B[0], yaw_ratio * gain * gust_B[2]
