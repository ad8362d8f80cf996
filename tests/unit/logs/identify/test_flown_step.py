"""Step responses from logs of a simulated loop whose response is known."""

from dataclasses import replace

import numpy as np
import pytest

from gustproof.logs.identify.flown_step import FlownStep, Loop, flown_steps
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


def test_settings_of_the_fit_and_of_its_interval_stay():
    """Ridge, memory, blocks, draws and widths are settled by simulations: these numbers move with each of them."""
    told, _ = flown_steps(replace(flight(0, sticks=True), airborne=((0.0, 33.5),)))
    found = [[each.value[k], each.low[k], each.high[k]] for each in told for k in (5, 15, 30)]
    assert [len(each.time) for each in told] == [31, 31]
    rate = [0.401006, 0.345685, 0.441244], [0.919466, 0.75972, 1.05057], [1.05503, 0.770969, 1.22152]
    attitude = [0.361541, 0.305557, 0.427418], [1.02784, 0.898817, 1.144], [0.866616, 0.61228, 1.06803]
    np.testing.assert_allclose(found, [*rate, *attitude], rtol=1e-4)
    bands = (1.570796, 40.05531), (1.570796, 3.141593)
    assert [each.band for each in told] == [pytest.approx(band, rel=1e-5) for band in bands]


def test_close_set_points_are_fitted_by_thirty_samples():
    log = flight(0, sticks=True)
    close = np.interp(log.gyro.time, log.rate_reference.time, log.rate_reference.values[:, 0])
    close = replace(log.gyro, values=np.column_stack([close, 0.0 * close, 0.0 * close]))
    told = flown_steps(replace(log, rate_reference=close, airborne=((0.0, 33.5),)))[0][0]
    np.testing.assert_allclose([told.value[20], told.low[20], told.high[20]], [0.647384, 0.546415, 0.693773], rtol=1e-4)


def test_angles_beyond_half_a_turn_answer_alike():
    log = flight(0, sticks=True)
    turned = {name: getattr(log, name) for name in ("attitude", "reference")}
    turned = {name: replace(each, values=np.angle(np.exp(1j * (each.values + 3.1)))) for name, each in turned.items()}
    (_, straight), (_, beyond) = flown_steps(log)[0], flown_steps(replace(log, **turned))[0]
    assert beyond.value == pytest.approx(straight.value, abs=1e-6)


def test_a_response_is_told_by_when_it_is_reached():
    values, time = np.array([0.5, 0.7, 1.1]), np.array([0.01, 0.02, 0.03])
    step = FlownStep(loop=Loop.RATE, axis=1, time=time, value=values, low=values, high=1.1 * values, band=(1.6, 38.0))
    told = "half after 10 ms, 90 % after 25 ms, peak 1.10 (at most 1.21); coherent from 1.6 to 38 rad/s"
    assert step.describe() == f"pitch rate: {told}"
    assert "never reaches half, never 90 %" in replace(step, value=0.4 * values).describe()


@pytest.mark.parametrize(("until", "short"), [(15.2, True), (15.3, False)])
def test_six_blocks_are_enough(until, short):
    log = replace(flight(0, sticks=True), airborne=((0.0, until),))
    assert ("too short: 12 s" in flown_steps(log)[1][0]) is short


@pytest.mark.parametrize(("moved", "told"), [(0.9e-6, "does not move"), (1.1e-6, "the response is")])
def test_a_set_point_moves_from_a_millionth_on(moved, told):
    log = flight(7, sticks=False)
    values = moved * np.sqrt(2.0) * np.sin(20.0 * log.rate_reference.time)[:, None] * np.ones(3)
    assert told in flown_steps(replace(log, rate_reference=replace(log.rate_reference, values=values)))[1][0]
