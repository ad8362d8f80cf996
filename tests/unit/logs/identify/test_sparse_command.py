"""Command filled in between its logged samples, held against the one that the loop gave."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from firmware_model.config.gyro_filters import gyro_filters
from gustproof.logs.identify.filtered_command import run_filters
from gustproof.logs.identify.sparse_command import fill_command
from gustproof.logs.identify.stretches import find_stretches
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.types import Array

DT, STEP = 0.0025, 8  # [s] of a loop of 400 Hz, of which every eighth command is logged


def log_of_a_loop(system: str = "px4") -> tuple[FlightLog, Array]:
    """Return a log at 50 Hz and the command (n, 3) of every step: a slow part, and an answer to the low-passed gyro."""
    random, n = np.random.default_rng(3), 8000
    time = DT * np.arange(n)
    rate = lfilter(*butter(1, 30.0, fs=1.0 / DT), random.standard_normal((n, 3)), axis=0)
    seen = lfilter(*butter(2, 40.0, fs=1.0 / DT), rate, axis=0)
    command = 0.2 * np.sin(3.0 * time)[:, None] - 0.1 * seen - 4e-4 * np.gradient(seen, DT, axis=0)
    log = FlightLog(
        source="x",
        system=system,
        gyro=LogSignal(time=time, values=rate),
        command=LogSignal(time=time[::STEP], values=command[::STEP]),
    )
    return log, command


def test_the_command_between_its_samples_is_the_loops():
    log, command = log_of_a_loop()
    slow = "command: 50 Hz; identification needs 100 Hz or more"
    found = fill_command(replace(log, findings=(slow, "gyro: 2 gaps")))
    assert found is not None
    assert found.step == pytest.approx(STEP * DT)
    assert min(found.shares) > 0.9
    filled = found.log
    assert filled.command is not None
    assert log.command is not None
    time = DT * np.arange(len(command))
    held = command[np.minimum(np.arange(len(command)) // STEP * STEP, len(command) - 1)]
    linear = np.column_stack([np.interp(time, log.command.time, column) for column in log.command.values.T])
    found = np.column_stack([np.interp(time, filled.command.time, column) for column in filled.command.values.T])
    used = time < filled.command.time[-1]
    error, of_linear, of_held = (float(np.std((each - command)[used])) for each in (found, linear, held))
    assert error < 0.2 * of_linear < 0.2 * of_held
    assert "50 Hz of a loop of 400 Hz" in filled.findings[-1]
    assert filled.findings[:-1] == ("gyro: 2 gaps",)  # it is no longer too slow


def test_a_bias_of_the_gyro_fills_in_nothing():
    log, _ = log_of_a_loop()
    biased = replace(log.gyro, values=log.gyro.values + np.array([0.5, -0.25, 1.0]))
    plain, found = (fill_command(each) for each in (log, replace(log, gyro=biased)))
    assert plain is not None
    assert found is not None
    assert plain.log.command is not None
    assert found.log.command is not None
    np.testing.assert_allclose(found.log.command.values, plain.log.command.values, atol=1e-9)


def test_filters_of_the_parameters_fill_in_best_and_steps_of_the_sticks_spoil_nothing():
    """A tenth of the commands are a step away; no low-pass of those that are tried is like this slope's."""
    random, n = np.random.default_rng(5), 8000
    time, parameters = DT * np.arange(n), {"IMU_GYRO_CUTOFF": 80.0, "IMU_DGYRO_CUTOFF": 6.0}
    rate = lfilter(*butter(1, 30.0, fs=1.0 / DT), random.standard_normal((n, 3)), axis=0)
    seen = np.column_stack([run_filters(column, gyro_filters("px4", parameters, 1.0 / DT)) for column in rate.T])
    passed = 12.0 * np.pi * DT / (1.0 + 12.0 * np.pi * DT)
    slope = lfilter([passed], [1.0, passed - 1.0], np.diff(seen, axis=0, prepend=seen[:1]) / DT, axis=0)
    answer = -0.02 * seen - 4e-3 * slope
    command = answer + np.repeat(random.choice([-1.0, 1.0], n // 160), 160)[:, None]
    log = FlightLog(
        source="x",
        system="px4",
        gyro=LogSignal(time=time, values=rate),
        command=LogSignal(time=time[::STEP], values=command[::STEP]),
        is_gyro_raw=True,
    )

    def share_left(each: FlightLog) -> float:
        """Return the share of the answer that is not filled in, away from steps."""
        whole = fill_command(each)
        assert whole is not None
        filled = whole.log
        assert filled.command is not None
        found = np.column_stack([np.interp(time, filled.command.time, column) for column in filled.command.values.T])
        calm = (np.arange(n) % 160 > STEP) & (np.arange(n) % 160 < 160 - STEP) & (time < filled.command.time[-1])
        return float(np.std((found - command)[calm]) / np.std(answer[calm]))

    found = share_left(replace(log, parameters=parameters))
    assert found < 0.05 < 0.1 < share_left(log)


def test_a_gyro_no_closer_than_the_commands_explains_nothing_by_chance():
    random, time = np.random.default_rng(6), DT * np.arange(0, 8000, STEP)
    signals = (LogSignal(time=time, values=random.standard_normal((len(time), 3))) for _ in range(2))
    log = FlightLog(source="x", system="px4", gyro=next(signals), command=next(signals))
    filled = fill_command(log)
    assert filled is not None
    shares = [float(each) for each in re.findall(r"\d+(?=,| %)", filled.log.findings[-1])]
    assert shares == pytest.approx([100.0 * share for share in filled.shares], abs=0.5)
    assert max(shares) < 10.0


@pytest.mark.parametrize(
    ("system", "changes"),
    [("csv", {}), ("gustproof", {}), ("px4", {"parameters": {"IMU_GYRO_RATEMAX": 50.0}}), ("px4", {"command": None})],
)
def test_a_command_that_may_be_held_is_left_alone(system: str, changes: dict[str, object]):
    log, _ = log_of_a_loop(system)
    assert fill_command(replace(log, **changes)) is None


def test_nothing_is_filled_in_where_the_log_has_a_gap():
    log, _ = log_of_a_loop()
    assert log.command is not None
    kept = (log.command.time < 8.0) | (log.command.time > 9.0)
    gap = replace(log, command=LogSignal(time=log.command.time[kept], values=log.command.values[kept]))
    filled = fill_command(gap)
    assert filled is not None
    assert filled.log.command is not None
    assert len(find_stretches(filled.log, filled.log.command)) == 2
