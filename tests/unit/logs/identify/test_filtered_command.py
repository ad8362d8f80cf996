"""Gyros that are logged behind the autopilot's filters, and motors without a lag: what is found is the vehicle's."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from firmware_model.config.gyro_filters import gyro_filters, notch
from gustproof.logs.identify import identify_vehicle
from gustproof.logs.identify.filtered_command import filter_command, run_filters
from gustproof.logs.identify.identify_vehicle import identify
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.logs.read.flown_part import crop
from gustproof.types import Array

GAIN, DELAY = 200.0, 0.005
FILTERS = {
    "ardupilot": {"INS_GYRO_FILTER": 20.0, "INS_HNTCH_ENABLE": 1.0, "INS_HNTCH_FREQ": 60.0, "INS_HNTCH_BW": 30.0},
    "px4": {"IMU_GYRO_CUTOFF": 30.0, "IMU_GYRO_NF0_FRQ": 50.0, "IMU_GYRO_NF0_BW": 20.0},
}


def make_log(system: str, hertz: int, lag: float, *, raw: bool, slow_yaw: bool = False, lead: float = 0.0) -> FlightLog:
    """Return 40 s of steps and noise as commands, held for 2.5 ms, and the rates by them behind the filters.

    Yaw is turned at once by `lead` [-] times its gain, as rotors that speed up do, and loses that with the lag.
    """
    rng, fine, rate = np.random.default_rng(4), 1600, 400
    command = 0.02 * np.repeat(rng.normal(size=(160, 3)), 100, axis=0) + 0.004 * rng.normal(size=(16000, 3))
    if slow_yaw:
        command[:, 2] = 0.4 * lfilter(*butter(2, 0.5, fs=rate), command[:, 2])
    held = np.repeat(command, fine // rate, axis=0)
    late = np.vstack([np.zeros((round(DELAY * fine), 3)), held])[: len(held)]
    kept = np.exp(-1.0 / (fine * lag)) if lag else 0.0
    lagged = lfilter([1.0 - kept], [1.0, -kept], late, axis=0)
    lagged[:, 2] += lead * (late - lagged)[:, 2]
    driven = GAIN * lagged + rng.normal(size=late.shape)
    gyro = np.cumsum(driven, axis=0) / fine + 2e-3 * rng.normal(size=late.shape)
    parameters = FILTERS[system] | {"SCHED_LOOP_RATE": 400.0, "IMU_GYRO_RATEMAX": 400.0}
    for b0, b1, b2, a1, a2 in [] if raw else gyro_filters(system, parameters, fine):
        gyro = lfilter((b0, b1, b2), (1.0, a1, a2), gyro, axis=0)
    time = np.arange(len(command)) / rate + 1.0
    every = fine // hertz
    return FlightLog(
        source="made",
        system=system,
        gyro=LogSignal(time=np.arange(0, len(gyro), every) / fine + 1.0, values=gyro[::every]),
        command=LogSignal(time=time, values=command),
        is_gyro_raw=raw,
        parameters=parameters,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "hertz", "lag", "raw"),
    [
        ("ardupilot", 400, 0.03, False),
        ("px4", 200, 0.03, False),
        ("ardupilot", 100, 0.03, False),  # coloured noise at 100 Hz, where no wider spacing is left
        ("ardupilot", 400, 0.0, False),
        ("px4", 400, 0.0, True),
    ],
)
def test_filters_of_the_gyro_are_none_of_the_vehicle(system: str, hertz: int, lag: float, raw: bool) -> None:
    found = identify(make_log(system, hertz, lag, raw=raw))
    assert any("logged behind" in line for line in found.findings) == (not raw)
    assert any(line.startswith("lag: none is seen") for line in found.findings) == (lag == 0.0)
    assert found.lateness is not None
    assert found.actuator_lag is not None
    # without a lag, the least of the search stands for it
    assert found.actuator_lag.nominal == pytest.approx(lag or 0.001, abs=0.0025 if lag else 1e-9)
    assert found.lateness.nominal == pytest.approx(lag + DELAY, abs=0.0025)
    for axis in found.axes:
        assert axis.gain is not None
        assert axis.gain.nominal == pytest.approx(GAIN, rel=0.04)


MOVING = {
    "ardupilot": {"INS_HNTCH_MODE": 3.0, "INS_HNTCH_FREQ": 40.0, "INS_HNTCH_BW": 20.0, "INS_HNTCH_HMNCS": 1.0},
    "px4": {"IMU_GYRO_DNF_EN": 1.0, "IMU_GYRO_DNF_HMC": 1.0},
}


@pytest.mark.slow
@pytest.mark.parametrize(("system", "name", "rotors"), [("ardupilot", "INS_HNTCH", 1), ("px4", "IMU_GYRO_DNF", 4)])
def test_a_notch_that_moves_is_taken_where_it_was_in_flight(system: str, name: str, rotors: int) -> None:
    """It follows rotors of 54 to 66 Hz; on the ground, before 2 s, they stand still."""
    raw = make_log(system, 1600, 0.03, raw=True)
    gyro, at = raw.gyro.values, raw.gyro.time
    speed = 60.0 + 6.0 * np.sin(2.0 * at)
    state = np.zeros((rotors, 2, 3))
    for begin in range(0, len(gyro), 8):
        f, block = speed[begin], gyro[begin : begin + 8]
        wide = np.tan(np.pi * 15.0 / 1600.0) if system == "px4" else np.sin(2.0 * np.pi * f / 1600.0) * 7.0 / 24.0
        b0, b1, b2, a1, a2 = notch(f, wide, 0.0 if system == "px4" else 0.01, 1600.0)
        for i in range(rotors):
            block, state[i] = lfilter((b0, b1, b2), (1.0, a1, a2), block, axis=0, zi=state[i])
        gyro[begin : begin + 8] = block
    parameters = {"SCHED_LOOP_RATE": 400.0, "IMU_GYRO_RATEMAX": 400.0, "INS_HNTCH_ENABLE": 1.0, **MOVING[system]}
    followed = LogSignal(time=at[::160], values=np.repeat((speed * (at > 2.0))[::160, None], rotors, axis=1))
    left_out = replace(
        raw,
        gyro=LogSignal(time=at[::4], values=gyro[::4]),
        is_gyro_raw=False,
        parameters=parameters,
        notches={name: followed},
    )
    log = crop(left_out, 2.0, None)
    assert log.parameters[f"{name}_FLOWN"] == pytest.approx(60.0, abs=0.5)
    assert log.parameters[f"{name}_ROTORS"] == rotors
    assert any(line.startswith(f"a notch that moved: {name} at 60 Hz, from 54 to 66") for line in log.findings)
    found, without = identify(log), identify(replace(log, parameters=parameters))
    assert found.lateness is not None
    assert without.lateness is not None
    assert found.lateness.low < 0.03 + DELAY < found.lateness.high
    error, before = (abs(each.lateness.nominal - 0.03 - DELAY) for each in (found, without))
    assert error < min(0.001, 0.7 * before)
    for axis in found.axes:
        assert axis.gain is not None
        assert axis.gain.nominal == pytest.approx(GAIN, rel=0.04)


def test_command_is_changed_by_known_filters_alone() -> None:
    log = make_log("px4", 200, 0.03, raw=False)
    for same in (replace(log, is_gyro_raw=True), replace(log, parameters={}), replace(log, system="csv")):
        assert filter_command(same) is same
    still = replace(log, command=LogSignal(time=log.gyro.time, values=np.full(log.gyro.values.shape, 0.3)))
    found = filter_command(still).command
    assert found is not None
    np.testing.assert_allclose(found.values, 0.3, rtol=1e-9)
    motors = filter_command(replace(still, command=None, motors=still.command)).motors
    assert motors is not None
    np.testing.assert_allclose(motors.values, 0.3, rtol=1e-9)


@pytest.mark.parametrize("system", ["px4", "ardupilot"])
def test_noise_of_a_filtered_gyro_is_white_again(system: str) -> None:
    """Each turn of the loop is logged; a log of every second is left as it is."""
    parameters = FILTERS[system] | {"SCHED_LOOP_RATE": 400.0, "IMU_GYRO_RATEMAX": 400.0}
    noise = np.random.default_rng(2).standard_normal((8000, 3))
    seen = np.column_stack([run_filters(column, gyro_filters(system, parameters, 400.0)) for column in noise.T])

    def log_every(turns: int) -> FlightLog:
        signals = (LogSignal(time=0.0025 * np.arange(0, 8000, turns), values=each[::turns]) for each in (seen, noise))
        return FlightLog(source="made", system=system, gyro=next(signals), command=next(signals), parameters=parameters)

    def largest_likeness(values: Array) -> float:
        return max(abs(np.corrcoef(values[k:, 0], values[:-k, 0])[0, 1]) for k in range(2, 12))

    found, sparse = filter_command(log_every(1)), log_every(2)
    assert found.command is not None
    assert largest_likeness(found.gyro.values) < 0.15 < 0.4 < largest_likeness(seen)
    # Both are behind the same filters: held for a step, and a mean over it, a slow command is where it was.
    gyro, command = (lfilter(*butter(2, 10.0, fs=400.0), each.values[:, 0]) for each in (found.gyro, found.command))
    np.testing.assert_allclose(command[100:], gyro[100:], atol=0.1 * gyro.std())
    assert filter_command(sparse).gyro is sparse.gyro
    # Neither is a log with holes, or one whose noise is not that of a filtered gyro.
    whole, kept = log_every(1), np.arange(8000) % 100 > 2
    holed = replace(whole, gyro=LogSignal(time=whole.gyro.time[kept], values=whole.gyro.values[kept]))
    rough = replace(whole, gyro=LogSignal(time=whole.gyro.time[2:], values=np.diff(noise, 2, axis=0)))
    assert filter_command(holed).gyro is holed.gyro
    assert filter_command(rough).gyro is rough.gyro


@pytest.mark.slow
def test_yaw_that_tells_no_lag_has_that_of_roll_and_pitch(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"_APART": -1e9, "_FAR_APART": 1e9, "_KNOWN_LAG": 0.1}.items():
        monkeypatch.setattr(identify_vehicle, name, value)
    found = identify(make_log("ardupilot", 400, 0.03, raw=True, slow_yaw=True))
    assert found.actuator_lag is not None
    assert found.actuator_lag.high < 0.032
    assert not any("unlike roll and pitch" in line for line in found.findings)


@pytest.mark.slow
def test_yaw_that_rotors_turn_by_their_inertia_is_not_told() -> None:
    """A real 5-inch got three times its gain of yaw, this one twice, and a lag from 1 ms on."""
    found = identify(make_log("ardupilot", 400, 0.03, raw=True, lead=2.0))
    assert found.axes[2].gain is None
    assert found.axes[2].advice.endswith("the inertia of rotors that speed up hides the gain of their drag")
    assert found.actuator_lag is not None
    assert 0.028 < found.actuator_lag.low < 0.03 < found.actuator_lag.high < 0.032
