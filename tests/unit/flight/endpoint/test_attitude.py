import math

import numpy as np
import pytest

from firmware_model.mavlink.services.geodesy import earth_rate
from firmware_model.numerics.rotations import conjugate, from_euler, rotate, to_euler
from gustproof.flight.endpoint.attitude import SlowAttitude

DT = 0.02
SOUTH = 2.4  # [rad] heading at the start, so that turns go over the south; a tilt is about both axes of N
AXES = pytest.mark.parametrize("axis", range(3))


NO_EARTH = 0.0, 0.0, 0.0


def follow(
    axis: int, seconds: float, error=lambda _: 0.0, bias=lambda _: 0.0, yaw_rate: float = 0.0, known=NO_EARTH
) -> np.ndarray:
    """Return the error [deg] of an attitude about an axis.

    The autopilot's is off by `error` [deg] at a time [s], the gyro by `bias` [deg/s], while the vehicle turns level.
    """

    def about(value: float) -> list[float]:
        return [math.radians(value) * (each == axis) for each in range(3)]

    def told(time_s: float) -> tuple[float, float, float]:
        roll, pitch, yaw = about(error(time_s))
        return to_euler(from_euler(roll, pitch, SOUTH + time_s * yaw_rate + yaw))

    attitude, errors = SlowAttitude(told(0.0)), []
    for k in range(round(seconds / DT)):
        p, q, r = about(bias(k * DT))
        attitude.add((p, q, r + yaw_rate), DT)
        attitude.correct(told(k * DT), known, DT)
        away = attitude.angles[axis] - (k * DT * yaw_rate if axis == 2 else 0.0)
        errors.append(math.degrees(math.remainder(away, 2.0 * math.pi)))
    return np.array(errors)


@pytest.mark.slow
@AXES
def test_wander_of_the_autopilots_attitude_is_not_followed(axis):
    errors = follow(axis, 60.0, lambda t: 0.28 * math.sin(2.0 * math.pi * t / 60.0))
    assert np.max(np.abs(errors)) < 0.03


@pytest.mark.slow
@AXES
@pytest.mark.parametrize("jump", [-20.0, 20.0])
def test_attitude_far_off_is_regained_in_seconds(axis, jump):
    errors = follow(axis, 12.0, lambda t: jump * (t > 1.0))
    assert abs(errors[-1] - jump) < (0.43, 0.43, 1.05)[axis]


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "most"), [(0, 0.63), (1, 0.63), (2, 1.21)])
def test_bias_that_jumps_in_flight_stands_off_and_does_not_drift(axis, most):
    errors = np.abs(follow(axis, 40.0, bias=lambda t: 0.2 * (t > 5.0)))
    assert most - 0.05 < errors[-1] <= np.max(errors) < most


@pytest.mark.slow
@pytest.mark.parametrize(("known", "time_constant_s"), [(NO_EARTH, 200.0), (None, 10.0)])
def test_small_bias_stands_off_by_less_and_least_where_one_is_to_be_expected(known, time_constant_s):
    expected = 0.001 * time_constant_s * (1.0 - math.exp(-120.0 / time_constant_s))
    assert abs(follow(0, 120.0, bias=lambda _: 0.001, known=known)[-1] - expected) < 0.005


def test_turns_are_followed_at_once_and_over_the_south():
    errors = follow(2, 20.0, yaw_rate=0.5)
    assert np.max(np.abs(errors)) < 0.6  # of the sample that comes before the gyro's first step


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_turn_of_the_earth_is_no_turn_of_the_vehicle(heading):
    level, earth = (0.0, 0.0, heading), earth_rate(math.radians(47.4))
    assert math.isclose(math.hypot(*earth), 2.0 * math.pi / 86164.0, rel_tol=1e-4)
    drifts = []
    for known in (earth, NO_EARTH):
        attitude = SlowAttitude(level)
        for _ in range(600):
            attitude.add(rotate(conjugate(from_euler(*level)), earth), 0.1)
            attitude.correct(level, known, 0.1)
        drifts.append(max(map(abs, attitude.angles)))
    assert drifts[0] < 1e-5  # the first sample has no turn
    assert drifts[1] > 0.002


def test_heading_of_a_tilted_body_turns_with_its_rates():
    attitude = SlowAttitude((0.5, 0.2, 0.0))
    rates = -0.1 * math.sin(0.2), 0.1 * math.sin(0.5) * math.cos(0.2), 0.1 * math.cos(0.5) * math.cos(0.2)
    for _ in range(101):
        attitude.add(rates, 0.01)
    np.testing.assert_allclose(attitude.angles, (0.5, 0.2, 0.1), atol=1e-6)


def test_attitude_goes_over_the_vertical():
    attitude = SlowAttitude((0.0, 0.0, SOUTH))
    angles = []
    for _ in range(315):
        attitude.add((0.0, 1.0, 0.0), 0.01)
        attitude.correct((*attitude.angles[:2], attitude.angles[2] + SOUTH), NO_EARTH, 0.01)
        angles.append(attitude.angles)
    assert max(pitch for _, pitch, _ in angles) > 1.56
    roll, pitch, heading = angles[-1]
    np.testing.assert_allclose((abs(roll), pitch, abs(heading)), (math.pi, math.pi - 3.14, math.pi), atol=1e-4)


def test_samples_that_are_missing_are_bridged():
    attitude = SlowAttitude((0.0, 0.0, 0.0))
    for step_s, rate in ((0.0, 0.1), (0.5, 0.3), (100.0, 0.3)):
        attitude.add((0.0, 0.0, rate), step_s)
    assert math.isclose(attitude.angles[2], 0.5 * 0.2 + 1.0 * 0.3, rel_tol=0.01)


@AXES
@pytest.mark.parametrize("known", [NO_EARTH, (1e-4, -2e-4, 3e-4), None])
def test_pull_is_that_of_its_formula(axis, known):
    for error in np.radians(
        (-20.0, -3.0, -1.05, -0.95, -0.31, -0.29, 0.0, 0.05, 0.29, 0.31, 0.95, 1.05, 5.0, 6.8, 20.0)
    ):
        attitude, told = SlowAttitude((0.0, 0.0, 0.0)), [error * (each == axis) for each in range(3)]
        attitude.correct((told[0], told[1], told[2]), known, DT)
        away, wander = 2.0 * math.sin(0.5 * error), math.radians((0.3, 0.3, 1.0)[axis])
        within, pulls = np.clip(away, -wander, wander), (10.0, 10.0, 200.0) if known is None else (200.0,) * 3
        rate = within / pulls[axis] + np.clip(away - within, -0.1, 0.1) - (known or NO_EARTH)[axis]
        assert attitude.angles[axis] == pytest.approx(DT * rate, rel=1e-4, abs=1e-9)
