import numpy as np
import pytest

from gustproof.flight.endpoint.height import HeightLoop


def fly(hover: float, true_hover: float, gust: float, seconds: float = 60.0) -> np.ndarray:
    """Return the height error of a mass whose thrust is late by .1 s in all, in a vertical gust [m/s^2] of 5 s."""
    loop, dt = HeightLoop(hover), 0.02
    down, v_down, waiting, errors = -10.0, 0.0, [hover] * 5, []
    for k in range(round(seconds / dt)):
        waiting.append(loop.thrust(round(1000 * k * dt), down, v_down))
        push = gust * np.sin(2.0 * np.pi * k * dt / 5.0)
        v_down += dt * (9.80665 * (1.0 - waiting.pop(0) / true_hover) + push)
        down += dt * v_down
        errors.append(down + 10.0)
    return np.array(errors)


def test_height_is_held_in_a_gust():
    assert np.max(np.abs(fly(0.5, 0.5, 0.8))) < 0.3


@pytest.mark.parametrize("hover", [0.4, 0.6])
def test_hover_thrust_is_learned(hover):
    errors = fly(hover, 0.5, 0.0)
    assert np.max(np.abs(errors)) < 1.0
    assert np.max(np.abs(errors[-500:])) < 0.01


def test_released_loop_takes_the_height_where_it_is():
    loop = HeightLoop(0.5)
    assert loop.thrust(0, -10.0, 0.0) == 0.5
    loop.release()
    assert loop.thrust(20, -20.0, 0.0) == 0.5
    assert loop.thrust(40, -19.0, 0.0) > 0.5


def test_no_time_has_passed_at_the_first_position():
    loop = HeightLoop(0.5)
    first = loop.thrust(100, -10.0, 0.2)
    assert loop.thrust(100, -10.0, 0.2) == first == 0.5 * (1.0 + 3.0 * 0.2 / 9.80665)
    assert loop.thrust(120, -10.0, 0.2) > first


def test_thrust_keeps_room_for_the_attitude():
    loop = HeightLoop(0.5)
    loop.thrust(0, -10.0, 0.0)
    assert loop.thrust(20, 90.0, 50.0) == 0.75
    assert loop.thrust(40, -90.0, -50.0) == 0.25


@pytest.mark.parametrize("hover", [0.3, 0.5, 0.9])
def test_thrust_is_that_of_its_formula(hover):
    random, loop, integral, before = np.random.default_rng(1), HeightLoop(hover), 0.0, 0
    loop.thrust(0, -10.0, 0.0)
    for k in range(400):
        time = 20 * k + int(random.integers(-30, 400))  # some late, some behind the last, some after a silence
        down, v_down = -10.0 + random.normal(), random.normal() * (0.2 if k % 200 < 100 else 3.0)
        step_s = np.clip(1e-3 * (time - before), 0.0, 0.2)
        error = np.clip(1.5 * (down + 10.0), -1.0, 1.0) + v_down
        integral = np.clip(integral + 1.5 * error * step_s / 9.80665, -0.4, 0.4)
        share = np.clip(1.0 + 3.0 * error / 9.80665 + integral, 0.5, 1.5)
        assert loop.thrust(time, down, v_down) == pytest.approx(min(hover * share, 1.0), abs=1e-12)
        before = time
