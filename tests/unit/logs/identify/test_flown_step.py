"""Step responses from logs of a simulated loop whose response is known."""

from dataclasses import replace

import numpy as np
import pytest

from gustproof.logs.identify.flown_step import Loop, flown_steps
from gustproof.logs.read.flight_log import FlightLog, LogSignal

DT, SECONDS = 0.002, 60.0
GAIN, LAG, ANGLE_P = 80.0, 0.03, 3.0
P, I = 6.0 / GAIN, 8.0 / GAIN  # noqa: E741


def loop(asked, disturbance, noise, *, is_rate=False):
    """Return gyro, attitude and rate set-point of a cascade that answers `asked`, an attitude or a rate."""
    gyro, attitude, target = (np.zeros(len(disturbance)) for _ in range(3))
    torque = rate = angle = integral = 0.0
    for k in range(len(disturbance)):
        attitude[k], gyro[k] = angle, rate + noise[k]
        target[k] = asked[k] if is_rate else ANGLE_P * (asked[k] - angle)
        error = target[k] - gyro[k]
        integral += I * error * DT
        torque += DT / LAG * (P * error + integral - torque)
        rate += DT * (GAIN * torque + disturbance[k])
        angle += DT * rate
    return gyro, attitude, target


def flight(seed, *, sticks):
    """Return the log of a flight in gusts, at the rates of PX4's default profile."""
    rng, n = np.random.default_rng(seed), round(SECONDS / DT)
    asked = np.zeros(n)
    if sticks:
        changes = np.cumsum(rng.uniform(0.4, 2.0, 200))
        levels = np.radians(rng.uniform(-20.0, 20.0, 201))
        asked = levels[np.searchsorted(changes, DT * np.arange(n))]
    white, gust = rng.standard_normal(n), np.zeros(n)
    for k in range(1, n):
        gust[k] = gust[k - 1] * (1.0 - 2.0 * DT) + 2.0 * np.sqrt(DT) * white[k]
    gyro, attitude, target = loop(asked, gust, 0.01 * rng.standard_normal(n))

    def signal(values, every):
        three = np.column_stack([values, np.zeros(len(values)), np.zeros(len(values))])
        return LogSignal(time=DT * np.arange(n)[::every], values=three[::every])

    return FlightLog(
        source="flight.ulg", system="px4", gyro=signal(gyro, 2), rate_reference=signal(target, 10),
        attitude=signal(attitude, 25), reference=signal(asked, 25), airborne=((0.0, SECONDS),),
    )  # fmt: skip


def truth(which):
    n = 1000
    gyro, attitude, _ = loop(np.ones(n), np.zeros(n), np.zeros(n), is_rate=which is Loop.RATE)
    return DT * np.arange(n), gyro if which is Loop.RATE else attitude


@pytest.mark.slow
def test_the_response_of_sticks_in_gusts_is_the_true_one():
    covered = []
    for seed in range(3):
        told, _ = flown_steps(flight(seed, sticks=True))
        assert [(each.loop, each.axis) for each in told] == [(Loop.RATE, 0), (Loop.ATTITUDE, 0)]
        for each in told:
            true = np.interp(each.time, *truth(each.loop))
            covered.append(np.mean((each.low <= true) & (true <= each.high)))
            assert np.max(np.abs(each.value - true)) < 0.15
            assert each.peak == pytest.approx(true.max(), abs=0.1)
            half = float(np.interp(0.5, true[: np.argmax(true)], each.time[: np.argmax(true)]))
            assert each.reaches(0.5) == pytest.approx(half, abs=0.02 if each.loop is Loop.RATE else 0.05)
            assert f"peak {each.peak:.2f}" in each.describe()
            assert each.band is not None
    assert np.mean(covered) > 0.85


def test_hover_in_gusts_tells_no_response_though_set_points_move():
    told, reasons = flown_steps(flight(5, sticks=False))
    assert told == []
    assert reasons[0].startswith("roll rate: the response is ")
    assert "move the roll stick" in reasons[0]
    assert "roll attitude: its set-point does not move" in reasons


def test_what_is_not_logged_or_too_slow_is_told():
    log = flight(6, sticks=True)
    assert log.reference is not None
    slow = LogSignal(time=log.reference.time[::4], values=log.reference.values[::4])
    told, reasons = flown_steps(replace(log, rate_reference=None, reference=slow))
    assert told == []
    assert reasons[0] == "rate: no set-points in this log"
    assert reasons[1].startswith("attitude: the log is too slow, attitude set-point at 5 Hz and attitude at 20 Hz")
    assert "SDLOG_PROFILE" in reasons[1]
    short = replace(log, airborne=((0.0, 8.0),))
    assert flown_steps(short)[1][0] == "roll rate: too short: 12 s in the air are needed"
