from dataclasses import replace

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.logs.identify.identify_vehicle import identify
from gustproof.logs.identify.rates import describe_slow_log
from gustproof.logs.read.flight_log import FlightLog, LogSignal


def slow_log(gyro_hz: float, command_hz: float, system: str) -> FlightLog:
    noise = np.random.default_rng(1)
    gyro, command = (
        LogSignal(
            time=np.arange(0.0, 60.0, 1.0 / rate), values=noise.normal(size=(len(np.arange(0.0, 60.0, 1.0 / rate)), 3))
        )
        for rate in (gyro_hz, command_hz)
    )
    return FlightLog(source="x", system=system, gyro=gyro, command=command)


@pytest.mark.parametrize(
    ("rates", "system", "cure"),
    [
        ((2.6, 1.0), "ardupilot", "gyro at 2.6 Hz and command at 1 Hz: set LOG_BITMASK 442367"),
        ((9.0, 9.0), "px4", "gyro at 9 Hz and command at 9 Hz: set SDLOG_PROFILE 17"),
        ((25.0, 10.0), "ardupilot", "gyro at 25 Hz and command at 10 Hz: set LOG_BITMASK 442367"),
        ((200.0, 4.0), "csv", "gyro at 200 Hz and command at 4 Hz: log gyro and torque at 250 Hz and fly again"),
    ],
)
def test_a_slow_log_is_refused_for_its_rate(rates: tuple[float, float], system: str, cure: str) -> None:
    log = slow_log(*rates, system)
    assert log.command is not None
    told = describe_slow_log(log, {"gyro": log.gyro, "command": log.command})
    assert told.startswith("the log is too slow, ")
    assert cure in told
    if max(rates) == 9.0:
        assert [axis.advice for axis in identify(log).axes] == [told] * 3
    with pytest.raises(
        ConfigError, match="x: the log is too slow"
    ):  # below 8 Hz at once: pieces of .tlog broke filters
        identify(log if min(rates) < 8.0 else replace(log, airborne=((0.0, 4.0),)))


@pytest.mark.parametrize("system", ["px4", "ardupilot", "mavlink"])
def test_settings_of_the_autopilots_card_cure_no_telemetry_log(system: str) -> None:
    log = replace(slow_log(4.0, 4.0, system), source="flight.tlog")
    told = describe_slow_log(log, {"gyro": log.gyro})
    assert "gyro at 4 Hz: take the log of the autopilot's own card" in told


def test_a_log_of_the_default_profile_is_not_slow() -> None:
    log = slow_log(200.0, 50.0, "px4")
    assert log.command is not None
    assert describe_slow_log(log, {"gyro": log.gyro, "command": log.command}) == ""
