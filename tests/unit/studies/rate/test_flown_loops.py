"""A log's command against the loop of its parameters: told where the gains that flew are others, and only there."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.studies.rate.flown_loops import doubt_flown_gains
from gustproof.types import Array

DT = 0.004
PARAMETERS = {
    "px4": {
        f"MC_{axis}RATE_{name}": value
        for axis in ("ROLL", "PITCH", "YAW")
        for name, value in (("P", 0.1), ("I", 0.3), ("D", 0.004), ("K", 1.5))
    }
    | {"IMU_GYRO_CUTOFF": 6.0, "IMU_DGYRO_CUTOFF": 20.0, "MC_YAW_TQ_CUTOFF": 2.0},
    "ardupilot": {
        f"ATC_RAT_{axis}_{name}": value
        for axis in ("RLL", "PIT", "YAW")
        for name, value in (
            ("P", 0.15),
            ("I", 0.4),
            ("D", 0.006),
            ("FF", 0.05),
            ("FLTT", 3.0),
            ("FLTE", 8.0),
            ("FLTD", 20.0),
        )
    },
}


def smooth(values: Array, corner: float) -> Array:
    """Return values behind a low-pass, sample by sample."""
    share, state, found = 1.0 - math.exp(-2.0 * math.pi * corner * DT), values[0], []
    for value in values:
        state += share * (value - state)
        found.append(state)
    return np.array(found)


def flown(kind: str, scale: float, *, noise: float = 0.0) -> FlightLog:
    """Return the log of a loop whose gains are `scale` times those of its parameters, with noise on its command."""
    random, n = np.random.default_rng(2), 10_000
    rate, target = (smooth(3.0 * random.standard_normal(n), 2.0) for _ in range(2))
    if kind == "px4":
        seen = signal.lfilter(*signal.butter(2, 6.0, fs=1.0 / DT), rate)  # as PX4's low-pass
        error = target - seen
        slope = smooth(np.gradient(seen, DT), 20.0)
        command = scale * 1.5 * (0.1 * error + 0.3 * DT * np.cumsum(error) - 0.004 * slope)
        commands = np.column_stack([command, command, smooth(command, 2.0)])
    else:
        wanted = smooth(target, 3.0)
        error = smooth(wanted - rate, 8.0)
        slope = smooth(np.gradient(error, DT), 20.0)
        command = scale * (0.15 * error + 0.4 * DT * np.cumsum(error) + 0.006 * slope + 0.05 * wanted)
        commands = np.column_stack([command] * 3)
    time = DT * np.arange(n)
    commands = commands + noise * random.standard_normal(commands.shape)
    return FlightLog(
        source="flight",
        system=kind,
        gyro=LogSignal(time=time, values=np.column_stack([rate] * 3)),
        command=LogSignal(time=time, values=commands),
        rate_reference=LogSignal(time=time, values=np.column_stack([target] * 3)),
        is_gyro_raw=kind == "px4",
        airborne=((0.0, float(time[-1])),),
        parameters=PARAMETERS[kind],
    )


@pytest.mark.parametrize("kind", PARAMETERS)
def test_gains_are_doubted_by_the_size_of_the_command_alone(kind: str) -> None:
    assert doubt_flown_gains(flown(kind, 1.0)) == []
    told = doubt_flown_gains(flown(kind, 2.0))
    assert [line.partition(":")[0] for line in told] == ["roll", "pitch", "yaw"]
    for line in told:
        ((share, size),) = re.findall(r"explains (\d+) % of the logged command, which is (\S+) times as large", line)
        assert float(share) > 90.0
        assert float(size) == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("kind", PARAMETERS)
def test_what_the_loop_does_not_explain_is_not_doubted(kind: str) -> None:
    log = flown(kind, 2.0)
    assert log.rate_reference is not None
    halves = replace(log.rate_reference, time=log.rate_reference.time[::5], values=log.rate_reference.values[::5])
    assert len(doubt_flown_gains(replace(log, rate_reference=halves))) == 3  # 50 Hz are enough
    slow = replace(log.rate_reference, time=log.rate_reference.time[::200], values=log.rate_reference.values[::200])
    assert doubt_flown_gains(replace(log, rate_reference=slow)) == []
    assert doubt_flown_gains(flown(kind, 2.0, noise=3.0)) == []
    assert doubt_flown_gains(replace(log, rate_reference=None)) == []
    assert doubt_flown_gains(replace(log, command=None)) == []
    assert doubt_flown_gains(replace(log, airborne=((0.0, 5.0),))) == []
    assert doubt_flown_gains(replace(log, system="crazyflie")) == []
