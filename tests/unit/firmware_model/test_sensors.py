"""The gyro as asked for: noise, bias, range, float32."""

import math

import numpy as np
import pytest

from firmware_model.elementary import normals
from firmware_model.sensors import GyroParams, accelerometer, gyro

QUIET = GyroParams(sigma=0.0, ratio=0.0, b_x=0.0, b_y=0.0, b_z=0.0, range=34.9)


def readings(params: GyroParams, rate: tuple[float, float, float], count: int = 4000) -> np.ndarray:
    return np.array([gyro(params, rate, normals(1, 2, k, 0), 0.0) for k in range(count)])


def test_the_signal_to_noise_ratio_is_as_asked() -> None:
    sigma = 0.2 * 10.0 ** (-35.0 / 20.0)
    noise = readings(QUIET._replace(sigma=sigma), (0.0, 0.0, 0.0))
    # 12,000 values: five standard errors of a standard deviation.
    assert 20.0 * math.log10(0.2 / noise.std()) == pytest.approx(
        35.0, abs=20.0 * math.log10(1.0 + 5.0 / math.sqrt(24000))
    )


def test_state_dependent_noise_grows_with_the_rate() -> None:
    noise = readings(QUIET._replace(ratio=0.1), (1.0, -2.0, 0.0)) - (1.0, -2.0, 0.0)
    assert noise[:, 0].std() == pytest.approx(0.1, rel=0.06)
    assert noise[:, 1].std() == pytest.approx(0.2, rel=0.06)
    assert not noise[:, 2].any()


def test_bias_is_added_and_range_clips() -> None:
    reading = gyro(QUIET._replace(b_x=0.25, b_z=-0.5, range=2.0), (1.0, 5.0, -9.0), (0.0, 0.0, 0.0, 0.0), 0.0)
    assert reading == (1.25, 2.0, -2.0)


def test_readings_are_float32() -> None:
    reading = gyro(QUIET, (0.1, 1 / 3, math.pi), (0.0, 0.0, 0.0, 0.0), 0.0)
    assert reading == tuple(float(np.float32(value)) for value in (0.1, 1 / 3, math.pi))
    assert accelerometer((0.1, 0.0, -9.80665))[2] == float(np.float32(-9.80665))
