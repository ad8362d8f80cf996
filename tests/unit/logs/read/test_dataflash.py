from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import DFReader

from gustproof.logs.read.flight_log import CommandUnit
from gustproof.logs.read.read_log import read_log

Write = Callable[[str, bytes], Path]
Messages = dict[str, tuple[str, str, list[tuple[Any, ...]]]]


def test_read_log_of_ardupilot_maps_messages_to_signals(
    written: Write, ardupilot_log: bytes, ardupilot_messages: Messages
) -> None:
    log = read_log(written("any.name", ardupilot_log))
    assert (log.system, log.command_unit) == ("ardupilot", CommandUnit.NORMALISED)
    assert log.gyro.time == pytest.approx(0.0025 * np.arange(800))
    assert np.array_equal(log.gyro.values, [row[2:5] for row in ardupilot_messages["IMU"][2][::2]])
    assert log.command is not None
    assert log.command.values[3] == pytest.approx([0.1, 0.2, -0.3])
    assert log.motors is not None
    # The outputs of motors 1 to 4 are 2, 1, 5 and 4; 1100 us is off, 1900 us full.
    assert log.motors.values[9] == pytest.approx([0.25, 0.5, 0.625, 0.375])
    assert log.attitude is not None
    assert log.attitude.values[9] == pytest.approx(np.deg2rad([2.0, -3.0, -90.0]))
    assert log.reference is not None
    assert log.reference.values[9] == pytest.approx(np.deg2rad([1.0, 0.0, 0.0]))
    assert log.airborne[0] == pytest.approx((0.5, 1.5))
    assert log.parameters["ATC_RAT_RLL_P"] == pytest.approx(0.2)
    assert log.findings == ("parameters: changed in this log, the last value counts: ATC_RAT_RLL_P",)


def test_attitude_is_that_of_the_loops_where_they_log_it(
    written: Write, ardupilot_messages: Messages, make_dataflash: Callable[..., bytes]
) -> None:
    rows = [(5_000_000 + 2500 * i, 1.0, 2.0, 3.0, 4.0, 350.0, 10.0, 0.0025) for i in range(800)]
    ardupilot_messages["ANG"] = ("Qfffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,Dt", rows)
    log = read_log(written("a.bin", make_dataflash(ardupilot_messages)))
    assert log.attitude is not None
    assert log.reference is not None
    assert len(log.attitude.time) == len(log.reference.time) == 800
    assert log.attitude.values[9] == pytest.approx(np.deg2rad([2.0, 4.0, 10.0]))
    assert log.reference.values[9] == pytest.approx(np.deg2rad([1.0, 3.0, -10.0]))


def test_the_gyro_before_its_filters_is_read_where_it_is_logged(
    written: Write, ardupilot_messages: Messages, make_dataflash: Callable[..., bytes]
) -> None:
    _, _, rows = ardupilot_messages["IMU"]
    raw = [(t, i, 2.0 * p, 2.0 * q, 2.0 * r) for t, i, p, q, r, *_ in rows]
    ardupilot_messages["GYR"] = ("QBfff", "TimeUS,I,GyrX,GyrY,GyrZ", raw)
    log = read_log(written("a.bin", make_dataflash(ardupilot_messages)))
    assert log.is_gyro_raw
    assert log.gyro.values == pytest.approx(np.array([row[2:] for row in raw[::2]]), abs=1e-6)


@pytest.mark.parametrize("columns", ["TimeUS,A,B,C", "TimeUS,A", "TimeUS,A,A", "TimeUS,,B"])
def test_a_message_whose_columns_do_not_fit_its_format_is_left_out(
    written: Write, ardupilot_messages: Messages, make_dataflash: Callable[..., bytes], columns: str
) -> None:
    ardupilot_messages["CTUN"] = ("Qff", columns, [(5_000_000 + 2500 * i, 1.0, 2.0) for i in range(9)])
    log = read_log(written("a.bin", make_dataflash(ardupilot_messages)))
    assert len(log.gyro.time) == 800


def test_read_log_of_ardupilot_matches_pymavlink(written: Write, ardupilot_log: bytes) -> None:
    path = written("a.bin", ardupilot_log)
    log, theirs = read_log(path), DFReader.DFReader_binary(str(path))
    messages = []
    while (message := theirs.recv_match(type=["IMU", "RATE"])) is not None:
        messages.append(message)
    imu = [(m.GyrX, m.GyrY, m.GyrZ) for m in messages if m.get_type() == "IMU" and m.I == 0]
    rate = [(m.ROut, m.POut, m.YOut) for m in messages if m.get_type() == "RATE"]
    theirs.close()
    assert np.array_equal(log.gyro.values, imu)
    assert log.command is not None
    assert np.array_equal(log.command.values, rate)


def test_read_log_of_ardupilot_takes_the_fastest_gyro(
    written: Write, ardupilot_messages: Messages, make_dataflash: Callable[..., bytes]
) -> None:
    fast = [(5_000_000 + 1000 * i + 700, 0, 5_000_000 + 1000 * i, 0.1, 0.2, 0.3) for i in range(2000)]
    ardupilot_messages["GYR"] = ("QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ", fast)
    log = read_log(written("a.bin", make_dataflash(ardupilot_messages)))
    assert log.gyro.time == pytest.approx(0.001 * np.arange(2000))
    letters, columns, rows = ardupilot_messages.pop("IMU")
    del ardupilot_messages["GYR"]
    log = read_log(written("b.bin", make_dataflash({**ardupilot_messages, "IMU": (letters, columns, rows[::40])})))
    assert len(log.gyro.time) == 400
    assert log.gyro.values[0] == pytest.approx([1.0, 1.0, 1.0], abs=1e-3)  # RATE, in deg/s


def test_read_log_of_ardupilot_without_events_goes_by_the_motors(
    written: Write, ardupilot_messages: Messages, make_dataflash: Callable[..., bytes]
) -> None:
    letters, columns, rows = ardupilot_messages["RCOU"]
    rows = [(t, *[1100] * 5) if t < 6_000_000 else (t, *outputs) for t, *outputs in rows]
    ardupilot_messages |= {"RCOU": (letters, columns, rows), "EV": ("QB", "TimeUS,Id", [(5_500_000, 10)])}
    log = read_log(written("a.bin", make_dataflash(ardupilot_messages)))
    assert len(log.airborne) == 1
    assert log.airborne[0][0] == pytest.approx(1.0)


def test_read_log_of_ardupilot_as_text_is_that_of_the_binary(
    written: Write, ardupilot_log: bytes, ardupilot_messages: Messages, make_dataflash_text: Callable[..., bytes]
) -> None:
    text, binary = (
        read_log(written(name, content))
        for name, content in (("a.log", make_dataflash_text(ardupilot_messages)), ("a.bin", ardupilot_log))
    )
    for signal in ("gyro", "command", "motors", "accelerometer", "attitude", "reference"):
        assert np.allclose(getattr(text, signal).time, getattr(binary, signal).time, atol=1e-9)
        assert np.allclose(getattr(text, signal).values, getattr(binary, signal).values, atol=1e-6)
    assert text.airborne == binary.airborne
    assert text.parameters == pytest.approx(binary.parameters)
    assert text.findings == binary.findings


def test_read_log_of_ardupilot_text_leaves_out_lines_that_are_damaged(written: Write) -> None:
    rows = [f"IMU, {5_000_000 + 2500 * i}, {i}e-4, 0.1, 0.2" for i in range(800)]
    rows[7:9] = ["IMU, 5017500, 0.x, 0.1, 0.2", "IMU, 5020000, 0.1"]
    head = ["FMT, 11, 0, IMU, Qfff, TimeUS,GyrX,GyrY,GyrZ", "PARM, 1000, ATC_RAT_RLL_P, 0.135"]  # PARM has no format
    log = read_log(written("a.log", "\n".join([*head, *rows, "IMU, 5"]).encode()))
    assert len(log.gyro.time) == 798
    assert log.parameters["ATC_RAT_RLL_P"] == pytest.approx(0.135)
    assert log.findings[:2] == (
        "file: 46 bytes are damaged: left out",
        "file: it ends within a message, 6 bytes of it are there",
    )


def test_read_log_of_an_old_ardupilot_takes_events_without_a_time_by_their_place(written: Write) -> None:
    rows = [f"IMU, {5000 + 5 * i}, 0.1, {i % 5}e-2, 0.3" for i in range(400)]
    rows[300:300], rows[100:100] = ["EV, 18"], ["EV, 28"]
    head = ["FMT, 11, 0, IMU, Ifff, TimeMS,GyrX,GyrY,GyrZ", "FMT, 12, 0, EV, B, Id"]
    log = read_log(written("a.log", "\n".join([*head, *rows, ""]).encode()))
    assert log.airborne == (pytest.approx((0.5, 1.5)),)
    assert "airborne: events have no time, that of the gyro beside them in the file is taken" in log.findings


def test_read_log_of_ardupilot_tells_damage_and_reads_on_after_it(written: Write, ardupilot_log: bytes) -> None:
    damaged = bytearray(ardupilot_log)
    middle = len(damaged) // 2
    damaged[middle : middle + 500] = bytes(500)
    log = read_log(written("b.bin", bytes(damaged[:-1])))
    assert 700 < len(log.gyro.time) < 800
    assert log.gyro.time[-1] > 1.99
    assert any(line.startswith("file: ") and "bytes are damaged: left out" in line for line in log.findings)
    assert any(line.startswith("file: it ends within a message, ") for line in log.findings)


@pytest.mark.parametrize(("angle", "full", "told"), [(100.0, 4500.0, True), (1.0, 1.0, False)])
def test_rates_and_commands_of_old_copters_are_in_their_units(tmp_path, angle, full, told):
    head = ["FMT, 11, 0, IMU, Qfff, TimeUS,GyrX,GyrY,GyrZ",
            "FMT, 12, 0, RATE, Qfffffffff, TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut"]  # fmt: skip
    rates = [(10.0 * np.sin(0.3 * i), 9.0 * np.sin(0.3 * i), 0.5 * np.cos(0.3 * i)) for i in range(200)]
    lines = []
    for i, (asked, flown, out) in enumerate(rates):
        lines.append(f"IMU, {2500 * (i + 1)}, {np.radians(flown)}, 0.001, 0.002")
        lines.append(f"RATE, {2500 * (i + 1)}, {angle * asked}, {angle * flown}, {full * out}, 0, 0, 0, 0, 0, 0")
    path = tmp_path / "old.log"
    path.write_text("\n".join([*head, *lines, ""]))
    log = read_log(path)
    assert log.rate_reference.values[:, 0] == pytest.approx(np.radians([asked for asked, _, _ in rates]), abs=1e-6)
    assert log.command.values[:, 0] == pytest.approx([out for *_, out in rates], abs=1e-6)
    assert any("before 3.4" in line for line in log.findings) is told
    assert not log.is_gyro_raw


@pytest.mark.parametrize(
    ("mode", "parameters", "told"),
    [
        (1, {"REF": 0.2, "FREQ": 60.0}, (60.0 * 1.5**0.5, 1)),
        (2, {"REF": 1.0}, (80.0, 1)),
        (3, {"REF": 0.5}, (50.0, 1)),
        (3, {"OPTS": 2.0, "REF": 1.0}, (100.0, 4)),
        (3, {"OPTS": 5.0, "REF": 1.0}, (100.0, 1)),
        (4, {"REF": 1.0}, (77.0, 1)),
        (0, {"REF": 1.0}, None),  # it stands still
        (1, {"REF": 0.0}, None),
        (1, {"OPTS": 2.0, "REF": 1.0}, None),  # each rotor's thrust is not logged
        (3, {"ENABLE": 0.0, "REF": 1.0}, None),
        (3, {}, None),  # its default is 0
    ],
)
def test_where_a_harmonic_notch_moved_to_is_found_by_its_mode(
    written: Write,
    ardupilot_messages: dict[str, tuple[str, str, list[tuple[object, ...]]]],
    make_dataflash: Callable[..., bytes],
    mode: int,
    parameters: dict[str, float],
    told: tuple[float, int] | None,
) -> None:
    stamps = [5_000_000 + 20_000 * i for i in range(100)]
    letters, columns, rows = ardupilot_messages["PARM"]
    given = {"ENABLE": 1.0, "MODE": float(mode), **parameters}
    rows = [*rows, *((5_000_000, f"INS_HNTCH_{key}".encode(), value) for key, value in given.items())]
    motors = [(t + i, i, 6000.0 + 60.0 * (i - 1.5)) for t in stamps for i in range(4)]
    messages = {
        **ardupilot_messages,
        "PARM": (letters, columns, rows),
        "CTUN": ("Qff", "TimeUS,ThI,ThO", [(t, 0.9, 0.3) for t in stamps]),
        "RPM": ("QBf", "TimeUS,I,RPM", [(t + i, i, 4800.0 - 900.0 * i) for t in stamps for i in range(2)]),
        "ESC": ("QBf", "TimeUS,Instance,RPM", motors),
        "FTN1": ("Qff", "TimeUS,PkAvg,BwAvg", [(t, 77.0, 9.0) for t in stamps]),
    }
    log = read_log(written("a.bin", make_dataflash(messages)))
    found = log.parameters.get("INS_HNTCH_FLOWN"), log.parameters.get("INS_HNTCH_ROTORS")
    assert found == ((None, None) if told is None else (pytest.approx(told[0], rel=1e-6), told[1]))
