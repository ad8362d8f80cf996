import math
from dataclasses import replace

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
    assert found.throttle == pytest.approx((0.4267, 0.4635, 0.5003, 0.5371, 0.5731))  # sorted, as many segments each
    line = found.lines[0]
    low, high = line.moves
    assert low == pytest.approx(150.0 * np.sqrt(0.42 / 0.5), abs=4.0)
    assert high == pytest.approx(150.0 * np.sqrt(0.58 / 0.5), abs=4.0)
    assert "as propellers do" in line.describe()


def test_a_line_of_the_frame_stays():
    throttle = 0.4 + 0.2 * (TIME / SECONDS)
    (line,) = gyro_spectrum(vibrating(80.0, throttle)).lines
    assert (line.hertz, line.moves) == (pytest.approx(80.0, abs=1.6), None)
    assert (line.height_db, line.share) == pytest.approx((22.99698, 0.5179528))  # over 40 Hz, and within 4
    total = 0.5 * 0.05**2 + 3.0 * 0.02**2 * 0.97
    assert line.share == pytest.approx(0.5 * 0.05**2 / total, rel=0.1)


def test_a_slow_or_short_log_has_no_spectrum():
    log = vibrating(80.0, 0.5)
    slow = LogSignal(time=log.gyro.time[::25], values=log.gyro.values[::25])
    assert gyro_spectrum(FlightLog(source="x", system="px4", gyro=slow)) is None
    short = LogSignal(time=log.gyro.time[:1500], values=log.gyro.values[:1500])
    assert gyro_spectrum(FlightLog(source="x", system="px4", gyro=short)) is None


def test_a_line_is_one_from_15_hz_on_and_7_db_above_what_is_beside_it():
    """A sine of size a has a^2 / (2 b) in a bin of the window's noise bandwidth b = 1.5 / .64 s."""
    noise = 0.02**2 / (0.5 * RATE)
    for hertz, decibels, told in ((80.0, 9.0, True), (80.0, 4.0, False), (16.4, 20.0, True), (11.0, 20.0, False)):
        size = np.sqrt(2.0 * 1.5 / 0.64 * 3.0 * noise * 10.0 ** (decibels / 10.0))
        lines = gyro_spectrum(vibrating(hertz, 0.5, size=size)).lines
        assert bool(lines) == told
        if told:
            assert lines[0].height_db == pytest.approx(10.0 * np.log10(1.0 + 10.0 ** (decibels / 10.0)), abs=2.0)


def test_four_lines_are_told_those_of_most_power_first():
    log = vibrating(60.0, 0.5, size=0.05)
    sines = sum(size * np.sin(2.0 * math.pi * hertz * TIME) for hertz, size in ((100, 0.03), (150, 0.04), (220, 0.02)))
    more = sines + 0.015 * np.sin(2.0 * math.pi * 300.0 * TIME)
    values = log.gyro.values + np.column_stack([more, 0.0 * TIME, 0.0 * TIME])
    lines = gyro_spectrum(replace(log, gyro=replace(log.gyro, values=values))).lines
    assert [line.hertz for line in lines] == pytest.approx([60.0, 150.0, 100.0, 220.0], abs=1.6)


def test_bands_of_throttle_need_six_segments_each_and_a_step_of_a_sixtieth():
    for span, told in ((0.08, 0), (0.085, 5)):  # a fifth of its range apart, in 37 s of 40
        assert len(gyro_spectrum(vibrating(80.0, 0.4 + span * TIME / SECONDS)).throttle) == told
    log = vibrating(80.0, 0.2 + 0.6 * TIME / SECONDS)
    for until, told in ((12.9, 0), (13.2, 5)):  # of 1.5 s beside the ground, and segments each .32 s
        assert len(gyro_spectrum(replace(log, airborne=((0.0, until),))).throttle) == told
    for until, told in ((5.2, False), (5.4, True)):
        assert (gyro_spectrum(replace(log, airborne=((0.0, until),))) is not None) is told
