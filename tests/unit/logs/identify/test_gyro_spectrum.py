import math

import numpy as np
import pytest

from gustproof.logs.identify.gyro_spectrum import gyro_spectrum
from gustproof.logs.read.flight_log import FlightLog, LogSignal

RATE, SECONDS = 1000.0, 40.0
TIME = np.arange(0.0, SECONDS, 1.0 / RATE)


def vibrating(hertz, throttle, *, size=0.05, noise=0.02):
    """Return a log whose roll gyro has white noise and a sine of a frequency (n,) or number [Hz]."""
    gyro = noise * np.random.default_rng(1).standard_normal((len(TIME), 3))
    gyro[:, 0] += size * np.sin(2.0 * math.pi * np.cumsum(np.broadcast_to(hertz, TIME.shape)) / RATE)
    motors = LogSignal(time=TIME[::20], values=np.repeat(np.broadcast_to(throttle, TIME.shape)[::20, None], 4, axis=1))
    signal = LogSignal(time=TIME, values=gyro)
    return FlightLog(source="x", system="px4", gyro=signal, motors=motors, is_gyro_raw=True, airborne=((0.0, SECONDS),))


def test_noise_has_its_density_and_no_line():
    found = gyro_spectrum(vibrating(90.0, 0.5, size=0.0))
    assert found.density.mean() == pytest.approx(0.02**2 / (0.5 * RATE), rel=0.02)
    assert found.vibration == pytest.approx(0.02 * np.sqrt((500.0 - 15.0) / 500.0), rel=0.03)
    assert (found.lines, found.throttle) == ((), ())


def test_a_line_that_rises_with_throttle_is_of_propellers():
    throttle = 0.4 + 0.2 * (TIME / SECONDS)
    found = gyro_spectrum(vibrating(150.0 * np.sqrt(throttle / 0.5), throttle))
    assert len(found.throttle) == len(found.by_throttle) == 5
    line = found.lines[0]
    low, high = line.moves
    assert low == pytest.approx(150.0 * np.sqrt(0.42 / 0.5), abs=4.0)
    assert high == pytest.approx(150.0 * np.sqrt(0.58 / 0.5), abs=4.0)
    assert "as propellers do" in line.describe()


def test_a_line_of_the_frame_stays():
    throttle = 0.4 + 0.2 * (TIME / SECONDS)
    (line,) = gyro_spectrum(vibrating(80.0, throttle)).lines
    assert (line.hertz, line.moves) == (pytest.approx(80.0, abs=1.6), None)
    total = 0.5 * 0.05**2 + 3.0 * 0.02**2 * 0.97
    assert line.share == pytest.approx(0.5 * 0.05**2 / total, rel=0.1)


def test_a_slow_or_short_log_has_no_spectrum():
    log = vibrating(80.0, 0.5)
    slow = LogSignal(time=log.gyro.time[::25], values=log.gyro.values[::25])
    assert gyro_spectrum(FlightLog(source="x", system="px4", gyro=slow)) is None
    short = LogSignal(time=log.gyro.time[:1500], values=log.gyro.values[:1500])
    assert gyro_spectrum(FlightLog(source="x", system="px4", gyro=short)) is None
