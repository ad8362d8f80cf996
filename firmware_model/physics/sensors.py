"""Gyro and accelerometer: bias, noise, range, and rounding to the float32 of the wire."""

from typing import NamedTuple

import numpy as np

from firmware_model.numerics.compiled import kernel
from firmware_model.types import Vector


class GyroParams(NamedTuple):
    """Constants of the gyro and its faults."""

    sigma: float  # [rad/s] rms of the noise of a sample
    ratio: float  # [-] rms of the noise of a sample per rate, for state-dependent noise
    b_x: float  # [rad/s] B, bias
    b_y: float
    b_z: float
    range: float  # [rad/s]
    drift_x: float = 0.0  # [rad/s^2] B, growth of the bias
    drift_y: float = 0.0
    drift_z: float = 0.0
    since: float = 0.0  # [s] start of the growth


class AccelerometerParams(NamedTuple):
    """Constants of the accelerometer and its faults."""

    sigma: float  # [m/s^2] rms of the noise of a sample
    b_x: float  # [m/s^2] B, bias
    b_y: float
    b_z: float
    range: float  # [m/s^2]


@kernel
def float32(value: float) -> float:
    """Return `value` rounded to float32, as on the wire."""
    return float(np.float32(value))


@kernel
def _clip_float32(value: float, limit: float) -> float:
    return float32(min(max(value, -limit), limit))


@kernel
def _measure_rate(params: GyroParams, rate: float, bias: float, noise: float) -> float:
    return _clip_float32(rate + bias + (params.sigma + params.ratio * abs(rate)) * noise, params.range)


@kernel
def measure_gyro(params: GyroParams, omega_B: Vector, noise: tuple[float, float, float, float], time: float) -> Vector:
    """Return the rate [rad/s] B measured at `time` [s] for three standard normal numbers (a fourth is unused)."""
    age = time - params.since
    return (
        _measure_rate(params, omega_B[0], params.b_x + params.drift_x * age, noise[0]),
        _measure_rate(params, omega_B[1], params.b_y + params.drift_y * age, noise[1]),
        _measure_rate(params, omega_B[2], params.b_z + params.drift_z * age, noise[2]),
    )


@kernel
def measure_accelerometer(
    params: AccelerometerParams, specific_force_B: Vector, noise: tuple[float, float, float, float]
) -> Vector:
    """Return the measured specific force [m/s^2] B for three standard normal numbers (a fourth is unused)."""
    return (
        _clip_float32(specific_force_B[0] + params.b_x + params.sigma * noise[0], params.range),
        _clip_float32(specific_force_B[1] + params.b_y + params.sigma * noise[1], params.range),
        _clip_float32(specific_force_B[2] + params.b_z + params.sigma * noise[2], params.range),
    )
