"""Flights whose command answers blows more than set-points: what is found of the vehicle spans the truth or is none."""

import numpy as np
import pytest

from firmware_model.config.gyro_filters import gyro_filters
from gustproof.logs.identify.filtered_command import filter_command
from gustproof.logs.identify.identify_vehicle import _axis_data, identify
from gustproof.logs.identify.instrument import gain_by_reference
from gustproof.logs.identify.stretches import cut_stretch
from gustproof.logs.read.flight_log import FlightLog, LogSignal

GAIN, DAMPING = 400.0, 2.0
PARAMETERS = {"INS_GYRO_FILTER": 20.0, "SCHED_LOOP_RATE": 400.0}


def make_log(*, blows: float) -> FlightLog:
    """Return 60 s of soft steps in closed loop, with blows [rad/s^2] of .1 s, its gyro behind a filter."""
    random, dt, count = np.random.default_rng(3), 0.0025, 24000
    target = np.repeat(random.normal(scale=0.12, size=(75, 3)), 320, axis=0)
    reference, rate, angle, felt, integral = np.zeros((count, 3)), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    soft, ((b0, b1, b2, a1, a2),) = np.zeros(3), gyro_filters("ardupilot", PARAMETERS, 1.0 / dt)
    first, second = np.zeros(3), np.zeros(3)
    seen, command, sway = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(3)
    for i in range(count):
        soft += dt * 8.0 * (target[i] - soft)
        reference[i] = soft
        measured = rate + 1e-5 * random.normal(size=3)
        felt = b0 * measured + first
        first, second = b1 * measured - a1 * felt + second, b2 * measured - a2 * felt
        error = 4.5 * (soft - angle) - felt
        integral += dt * 0.135 * error
        seen[i], command[i] = felt, 0.1 * error + integral
        blow = np.zeros(3)
        if i % 680 < 40:
            blow[i // 680 % 3] = blows * (1.0 if i // 2040 % 2 else -1.0)
        sway += dt * (-sway + random.normal(size=3) / np.sqrt(dt))
        rate = rate + dt * (GAIN * command[i] - DAMPING * rate + blow + sway)
        angle = angle + dt * rate
    time = dt * np.arange(count) + 1.0
    signals = {"gyro": seen, "command": command, "reference": reference}
    made = {name: LogSignal(time=time, values=values) for name, values in signals.items()}
    return FlightLog(source="made", system="ardupilot", parameters=PARAMETERS, is_gyro_raw=False, **made)


@pytest.fixture(scope="module")
def shaken() -> FlightLog:
    """Return a log in which blows move the command more than set-points do."""
    return make_log(blows=30.0)


@pytest.mark.parametrize("share", [0.65, 1.0])
def test_set_points_tell_the_gain_whatever_was_fitted(shaken: FlightLog, share: float) -> None:
    log = filter_command(shaken)
    assert log.command is not None
    assert log.reference is not None
    data = _axis_data([cut_stretch(log.gyro, log.command, 1.0, 61.0)], square=False)[0]
    theta = np.array([np.log(0.001), 0.0, DAMPING, *np.log([1e-10, 1.0, 2.0, 20.0, 700.0]), share * GAIN, 0.0])
    found = gain_by_reference(data, theta, log.reference)
    assert found.scale * share == pytest.approx(1.0, abs=3.0 * found.deviation * share)
    assert found.deviation < 0.2
    assert (found.surprise > 2.5) == (share < 1.0)


@pytest.mark.slow
def test_a_gain_spans_what_set_points_tell(shaken: FlightLog) -> None:
    """A fit takes the answer to the blows for two thirds of the gain: on ArduPilot's own vehicle it was 318 of 434."""
    found = identify(shaken)
    assert any(line.startswith("gains: by the set-points alone") for line in found.findings)
    for axis in found.axes:
        assert "by the set-points alone" in axis.advice if axis.gain is None else axis.gain.low < GAIN < axis.gain.high
