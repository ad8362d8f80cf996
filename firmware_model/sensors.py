"""Gyro and accelerometer: bias, noise, range, and the float32 that the wire carries."""

from typing import NamedTuple

import numpy as np

from firmware_model.compiled import kernel
from firmware_model.signals import Vector


class GyroParams(NamedTuple):
    """Constants of the gyro and its faults."""

    sigma: float  # [rad/s] rms of the noise of a sample
    ratio: float  # [-] rms of the noise of a sample per rate, for the state-dependent form
    b_x: float  # [rad/s] B, bias
    b_y: float
    b_z: float
    range: float  # [rad/s]
    drift_x: float = 0.0  # [rad/s^2] B, by which the bias grows
    drift_y: float = 0.0
    drift_z: float = 0.0
    since: float = 0.0  # [s] from when on


@kernel
def float32(value: float) -> float:
    """Return `value` rounded as the wire rounds it."""
    return float(np.float32(value))


@kernel
def _axis(params: GyroParams, rate: float, bias: float, noise: float) -> float:
    value = rate + bias + (params.sigma + params.ratio * abs(rate)) * noise
    return float32(min(max(value, -params.range), params.range))


@kernel
def gyro(params: GyroParams, omega_B: Vector, noise: tuple[float, float, float, float], time: float) -> Vector:
    """Return the rate [rad/s] B measured at `time` [s] for three standard normal numbers (a fourth is not used)."""
    age = time - params.since
    return (
        _axis(params, omega_B[0], params.b_x + params.drift_x * age, noise[0]),
        _axis(params, omega_B[1], params.b_y + params.drift_y * age, noise[1]),
        _axis(params, omega_B[2], params.b_z + params.drift_z * age, noise[2]),
    )


@kernel
def accelerometer(specific_force_B: Vector) -> Vector:
    """Return the measured specific force [m/s^2] B."""
    return float32(specific_force_B[0]), float32(specific_force_B[1]), float32(specific_force_B[2])
