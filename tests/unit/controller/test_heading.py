import math

import numpy as np
import pytest

from gustproof.controller.heading import SlowHeading

DT = 0.02


def follow(error, seconds: float, gyro_bias: float = 0.0, yaw_rate: float = 0.0) -> np.ndarray:
    """Return the error [deg] of a heading, where the autopilot's has `error` [deg] at a time [s], from 3 rad on."""
    heading, errors = SlowHeading((0.0, 0.0, 3.0 + math.radians(error(0.0)))), []
    for k in range(round(seconds / DT)):
        true = k * DT * yaw_rate
        heading.add((0.0, 0.0, yaw_rate + math.radians(gyro_bias)), DT if k else 0.0)
        yaw = 3.0 + true + math.radians(error(k * DT))
        heading.correct((0.0, 0.0, math.remainder(yaw, 2.0 * math.pi)), 0.5 * DT, DT)
        errors.append(math.degrees(heading.turned - true))
    return np.array(errors)


def test_wander_of_the_autopilots_heading_is_not_followed():
    errors = follow(lambda t: 0.3 * math.sin(2.0 * math.pi * t / 60.0), 60.0)
    assert np.max(np.abs(errors)) < 0.06


@pytest.mark.parametrize("jump", [-20.0, 20.0])
def test_heading_far_off_is_regained_in_seconds(jump):
    errors = follow(lambda t: jump * (t > 1.0), 15.0)
    assert abs(errors[-1] - jump) < 1.05


def test_bias_of_the_gyro_stands_off_and_does_not_drift():
    errors = follow(lambda _: 0.0, 600.0, gyro_bias=0.003)
    assert abs(errors[-1] - 0.3) < 0.01
    assert abs(follow(lambda _: 0.0, 60.0, gyro_bias=1.0)[-1]) < 3.1  # beyond a degree in seconds


def test_turns_are_followed_at_once_and_over_the_south():
    errors = follow(lambda _: 0.0, 20.0, yaw_rate=0.5)
    assert np.max(np.abs(errors)) < 0.4  # the autopilot's is a sample late


def test_turn_of_a_tilted_body_is_that_of_its_heading():
    heading = SlowHeading((0.5, 0.2, 0.0))
    q, r = 0.1 * math.sin(0.5) * math.cos(0.2), 0.1 * math.cos(0.5) * math.cos(0.2)  # roll and pitch stay
    for _ in range(101):
        heading.add((0.0, q, r), 0.01)
    assert math.isclose(heading.turned, 0.1)


def test_samples_that_are_missing_are_bridged():
    heading = SlowHeading((0.0, 0.0, 0.0))
    for step_s, rate in ((0.0, 0.1), (0.5, 0.3), (100.0, 0.3)):
        heading.add((0.0, 0.0, rate), step_s)
    assert math.isclose(heading.turned, 0.5 * 0.2 + 1.0 * 0.3)
