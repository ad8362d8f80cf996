from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.identification.identify import identify
from gustproof.identification.trial import random_log, run_trials
from gustproof.logs.flight_log import FlightLog, Signal
from gustproof.logs.read import read_log

SEEDS = (1000, 1011)


@pytest.fixture(scope="module")
def brief() -> FlightLog:
    return random_log(1011, duration=20.0)[0]


def test_trials_have_the_truth_inside_the_intervals():
    trials = list(run_trials(SEEDS))
    for trial in trials:
        assert trial.lag is not None
        assert trial.delay is not None
        assert len(trial.gains) == 3
        assert all(low <= 1.0 <= high for low, _, high in (trial.lag, *trial.gains))
        assert trial.delay.low <= 0.0 <= trial.delay.high
        assert max(map(abs, trial.disturbance_db)) < 2.0
    assert np.median([abs(gain.nominal - 1.0) for trial in trials for gain in trial.gains]) < 0.05
    assert np.median([abs(trial.lag.nominal - 1.0) for trial in trials if trial.lag]) < 0.1


def test_still_hover_is_told_as_unexcited():
    log, _ = random_log(1011, duration=30.0, excited=False, windy=False)
    found = identify(log)
    assert found.actuator_lag is None
    assert found.delay is None
    assert all(axis.gain is None and axis.damping is None and axis.held_out_r2 is None for axis in found.axes)
    for name, axis in zip(("roll", "pitch", "yaw"), found.axes, strict=True):
        assert axis.advice.startswith(f"{name} is not excited")
        assert "chirp" in axis.advice
        assert f"{name} is not excited" in found.findings


def test_identification_predicts_and_repeats_its_bits(brief):
    told = list[float]()
    first, second = identify(brief, progress=told.append), identify(brief)
    assert told == sorted(told)
    assert 0.0 < told[0] < told[-1] <= 1.0
    assert [axis.gain for axis in first.axes] == [axis.gain for axis in second.axes]
    assert (first.actuator_lag, first.delay) == (second.actuator_lag, second.delay)
    assert all(np.array_equal(getattr(first, n), getattr(second, n)) for n in ("time", "predicted", "response"))
    assert min(axis.held_out_r2 for axis in first.axes) > 0.7
    assert first.acceleration.shape == first.predicted.shape == (len(first.time), 3)
    assert np.all(np.diff(first.time) > 0.0)


def test_measured_response_agrees_with_the_model(brief):
    found = identify(brief)
    seen = found.coherence > 0.9
    assert np.all(seen.sum(axis=1) > 5)
    apart = np.abs(found.response / found.model - 1.0)[seen]
    assert np.median(apart) < 0.15


def test_clock_offset_of_the_command_is_its_delay(brief):
    near = identify(brief)
    early = replace(brief, command=Signal(time=brief.command.time - 0.005, values=brief.command.values))
    assert identify(early).delay.nominal - near.delay.nominal == pytest.approx(0.005, abs=5e-4)


def test_slow_and_fast_motors_are_told_apart():
    """Four motors, thrust the square of a lagged command, in place of the torque command."""
    random, dt, lag = np.random.default_rng(1), 0.002, 0.06
    gains = np.array([[-300.0, -250.0, 280.0, 270.0], [260.0, -240.0, -290.0, 250.0], [30.0, -30.0, 30.0, -30.0]])
    held = np.repeat(0.5 + 0.05 * random.standard_normal((100, 4)), 100, axis=0)
    speed, rates = held[0].copy(), np.zeros((len(held), 3))
    for k in range(1, len(held)):
        speed += (held[k - 1] - speed) * -np.expm1(-dt / lag)
        rates[k] = rates[k - 1] + dt * (gains @ (speed**2 - 0.25) - rates[k - 1])
    time = dt * np.arange(len(held))
    noisy = rates + 0.01 * random.standard_normal(rates.shape)
    found = identify(
        FlightLog(source="x", system="csv", gyro=Signal(time=time, values=noisy), motors=Signal(time=time, values=held))
    )
    assert found.actuator_lag.nominal == pytest.approx(lag, rel=0.03)
    assert found.motor_gains == pytest.approx(gains, rel=0.05)
    assert np.all(found.motor_intervals[..., 0] < found.motor_intervals[..., 1])


def test_crazyflie_in_flight_is_predicted_over_its_last_third():
    """The whole flight has a lag of .0639 s, published is .072 s; another flight of that vehicle has .055 s."""
    found = identify(read_log(Path(__file__).parent / "data" / "crazyflie.log"))
    assert min(found.axes[0].held_out_r2, found.axes[1].held_out_r2) >= 0.85
    assert found.actuator_lag.low < 0.0639 < found.actuator_lag.high < 0.075
    roll, pitch, _ = found.motor_gains
    assert np.all(np.sign(roll) == [-1, -1, 1, 1])
    assert np.all(np.sign(pitch) == [1, -1, -1, 1])
    assert np.all((np.abs([roll, pitch]) > 200.0) & (np.abs([roll, pitch]) < 360.0))


def test_logs_without_commands_or_too_short_are_refused(brief):
    with pytest.raises(ConfigError, match="neither torque commands nor motor outputs"):
        identify(replace(brief, command=None))
    with pytest.raises(ConfigError, match="too short"):
        identify(replace(brief, airborne=((1.0, 6.0),)))
