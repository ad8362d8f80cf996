import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.errors import ConfigError
from gustproof.logs.read import tlog
from gustproof.logs.read.assemble import Rows
from gustproof.logs.read.flight_log import CommandUnit
from gustproof.logs.read.read_log import read_log

Write = Callable[[str, bytes], Path]
ARRIVED_US = 1_700_000_000_000_000
VEHICLE, COMPANION, OTHER = (1, 1), (1, 191), (2, 1)


class Station:
    """Recorder of a .tlog."""

    def __init__(self) -> None:
        self._frames = list[tuple[int, bytes]]()
        self._packer = wire.MAVLink(None)

    def hear(self, time_us: int, message: Any, sender: tuple[int, int] = VEHICLE, *, v1: bool = False) -> None:
        self._packer.srcSystem, self._packer.srcComponent = sender
        self._frames.append((time_us, message.pack(self._packer, force_mavlink1=v1)))

    @property
    def content(self) -> bytes:
        frames = sorted(self._frames, key=lambda frame: frame[0])
        return b"".join(struct.pack(">Q", ARRIVED_US + time_us) + frame for time_us, frame in frames)


def heartbeat(autopilot: int = wire.MAV_AUTOPILOT_PX4, base_mode: int = 0) -> Any:
    return wire.MAVLink_heartbeat_message(2, autopilot, base_mode, 0, 0, 3)


def parameter(name: bytes, value: float, kind: int = wire.MAV_PARAM_TYPE_REAL32) -> Any:
    return wire.MAVLink_param_value_message(name, value, kind, 1, 0)


def imu(time_us: int, gyro: tuple[float, float, float]) -> Any:
    return wire.MAVLink_highres_imu_message(time_us, 0.0, 0.0, -9.8, *gyro, *[0.0] * 7, 63)


def torques(time_us: int, controls: tuple[float, float, float], system: int = 1) -> Any:
    return wire.MAVLink_set_actuator_control_target_message(time_us, 0, system, 1, [*controls, *[0.0] * 5])


@pytest.fixture
def station() -> Station:
    """Two seconds of a vehicle that booted half a second before, told 3 ms late."""
    station = Station()
    station.hear(0, heartbeat(wire.MAV_AUTOPILOT_INVALID), COMPANION)
    station.hear(0, heartbeat(base_mode=128))
    for i in range(500):
        sent_us = 4000 * i
        station.hear(sent_us + 3000, imu(sent_us + 500_000, (0.001 * i, 0.0, -0.1)))
        station.hear(sent_us + 3000, imu(sent_us + 500_000, (9.0, 9.0, 9.0)), OTHER)
        if i % 5 == 0:
            attitude = wire.MAVLink_attitude_message(sent_us // 1000 + 500, 0.1, 0.2, 0.3, 5.0, 5.0, 5.0)
            station.hear(sent_us + 3500, attitude, v1=True)
        station.hear(sent_us + 3900, torques(77 * i, (0.5, 0.25, -0.125)), COMPANION)
        station.hear(sent_us + 3900, torques(77 * i, (1.0, 1.0, 1.0), system=2), COMPANION)
    return station


def test_read_log_of_telemetry_takes_the_first_autopilot(written: Write, station: Station) -> None:
    log = read_log(written("flight.tlog", station.content))
    assert (log.system, log.command_unit) == ("px4", CommandUnit.NORMALISED)
    assert log.gyro.time == pytest.approx(0.004 * np.arange(500))
    assert log.gyro.values[10] == pytest.approx([0.01, 0.0, -0.1])
    assert log.attitude is not None
    assert log.attitude.time == pytest.approx(0.02 * np.arange(100))
    assert log.attitude.values[5] == pytest.approx([0.1, 0.2, 0.3])
    assert log.command is not None
    assert log.command.time == pytest.approx(0.0009 + 0.004 * np.arange(500), abs=1e-6)  # on the vehicle's clock
    assert log.command.values[3] == pytest.approx([0.5, 0.25, -0.125])
    assert len(log.airborne) == 1
    assert log.findings == ("not in this log: motors, reference",)


def test_read_log_of_telemetry_reads_parameters_and_landed_state(written: Write, station: Station) -> None:
    (as_bytes,) = struct.unpack("<f", struct.pack("<i", 250))
    station.hear(2_000_000, parameter(b"IMU_INTEG_RATE", as_bytes, wire.MAV_PARAM_TYPE_INT32))
    for name, limit in (("R", 10.0), ("P", 20.0), ("Y", 2.0)):
        station.hear(2_000_000, parameter(b"GP_TRQ_MAX_" + name.encode(), limit))
    for time_us, state in ((100_000, 1), (700_000, 2), (1_500_000, 1)):
        station.hear(time_us, wire.MAVLink_extended_sys_state_message(0, state))
    log = read_log(written("flight.tlog", station.content))
    assert log.parameters["IMU_INTEG_RATE"] == 250.0
    assert (log.system, log.command_unit) == ("gustproof", CommandUnit.NEWTON_METRES)
    assert log.command is not None
    assert log.command.values[0] == pytest.approx([5.0, 5.0, -0.25])
    assert log.airborne[0] == pytest.approx((0.697, 1.497), abs=1e-6)


def test_read_log_of_telemetry_of_an_ardupilot(written: Write) -> None:
    station = Station()
    station.hear(0, heartbeat(wire.MAV_AUTOPILOT_ARDUPILOTMEGA))
    station.hear(0, parameter(b"SERVO1_FUNCTION", 34.0, wire.MAV_PARAM_TYPE_INT16))
    station.hear(0, parameter(b"SERVO2_FUNCTION", 33.0, wire.MAV_PARAM_TYPE_INT16))
    for i in range(300):
        raw = wire.MAVLink_raw_imu_message(4000 * i, 0, 0, -1000, 100, -200, 300, 0, 0, 0)
        servos = wire.MAVLink_servo_output_raw_message(4000 * i, 0, 1250, 1500, *[0] * 6)
        station.hear(4000 * i, raw)
        station.hear(4000 * i, servos)
    log = read_log(written("flight.tlog", station.content))
    assert log.system == "ardupilot"
    assert log.gyro.values[7] == pytest.approx([0.1, -0.2, 0.3])
    assert log.accelerometer is not None
    assert log.accelerometer.values[7] == pytest.approx([0.0, 0.0, -9.80665])
    assert log.motors is not None
    assert log.motors.values[7] == pytest.approx([0.5, 0.25])


def test_read_log_of_telemetry_keeps_one_boot(written: Write, station: Station) -> None:
    for i in range(1000):
        station.hear(3_000_000 + 4000 * i, imu(4000 * i, (0.0, 0.2, 0.0)))
        station.hear(3_001_000 + 4000 * i, torques(0, (0.1, 0.1, 0.1)), COMPANION)
    log = read_log(written("flight.tlog", station.content))
    assert log.gyro.time == pytest.approx(0.004 * np.arange(1000))
    assert log.command is not None
    assert log.command.time == pytest.approx(0.001 + 0.004 * np.arange(1000), abs=1e-6)
    assert any(line.startswith("clock: set anew; ") for line in log.findings)


def test_read_log_of_telemetry_reads_on_after_damage(written: Write, station: Station) -> None:
    content = bytearray(station.content)
    content[40_000:40_500] = bytes(500)
    log = read_log(written("flight.tlog", bytes(content[:-7])))
    assert 480 < len(log.gyro.time) < 500
    assert any("bytes are no frames" in line for line in log.findings)
    assert any(line.startswith("file: it ends within a frame, ") for line in log.findings)


def test_read_log_of_telemetry_refuses_what_is_none(
    written: Write, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigError, match="no heartbeat of an autopilot in it"):
        read_log(written("none.tlog", bytes(5000)))
    monkeypatch.setattr(tlog, "_MOST_DAMAGED", 1000)
    with pytest.raises(ConfigError, match="more than 1,000 bytes of it are no frames"):
        read_log(written("zeros.tlog", bytes(5000)))
    only = Station()
    only.hear(0, heartbeat())
    with pytest.raises(ConfigError, match="no gyro in it"):
        read_log(written("silent.tlog", only.content))


@pytest.mark.slow
def test_read_log_of_mutated_telemetry(check_mutations: Callable[..., None], station: Station) -> None:
    check_mutations("flight.tlog", station.content)


@pytest.mark.parametrize("slower", [1.0, 2.8])  # of a simulator: nearly all stamps were called wrong
@pytest.mark.parametrize(("late_us", "same"), [(48_000.0, True), (-48_000.0, True), (60_000.0, False), (1e12, False)])
def test_clocks_that_differ_by_less_than_arrivals_do_are_one(late_us: float, same: bool, slower: float) -> None:
    time_us = 4000.0 * np.arange(500)
    of = Rows(position=np.arange(500), time_us=time_us, values=np.zeros((500, 3)))
    gyro = tlog._Samples(of, slower * time_us + 3e6)
    late = replace(of, time_us=time_us + late_us).take(time_us > 1e6)  # that begins later, too
    found = tlog._Samples(late, gyro.arrival_us[time_us > 1e6]).on_clock(gyro)
    assert np.array_equal(found.time_us, late.time_us) is same


def test_frames_of_version_1_are_read_whatever_stands_before_them(written: Write) -> None:
    station = Station()
    station.hear(0, heartbeat())
    for i in range(500):
        station.hear(4000 * i, imu(4000 * i, (0.1, 0.0, 0.0)))
        station.hear(4000 * i + 1, wire.MAVLink_statustext_message(6, b"w" * 50))
        station.hear(4000 * i + 2, wire.MAVLink_attitude_message(4 * i, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0), v1=True)
    log = read_log(written("a.tlog", station.content))
    assert log.attitude is not None
    assert len(log.attitude.time) == 500
