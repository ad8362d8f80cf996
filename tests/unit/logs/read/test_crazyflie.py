import os
import struct
from binascii import crc32
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.logs.read.read_log import read_log

EXCERPT = Path(__file__).parent / "data" / "crazyflie.log"


def crazyflie_log(path: Path, *, version: int = 2, events: bytes = b"", records: bytes = b"", count: int = 1) -> Path:
    content = struct.pack("<BHH", 0xBC, version, count) + events + records
    path.write_bytes(content + struct.pack("<I", crc32(content)))
    return path


def event(number: int, name: str, *variables: str) -> bytes:
    texts = b"".join(text.encode() + b"\0" for text in variables)
    return struct.pack("<H", number) + name.encode() + b"\0" + struct.pack("<H", len(variables)) + texts


GYRO = event(65535, "fixedFrequency", "gyro.x(f)", "gyro.y(f)", "gyro.z(f)", "stateEstimate.pitch(f)")


def test_read_log_of_a_real_crazyflie_gives_si_units_and_our_axes() -> None:
    log = read_log(EXCERPT)
    assert (log.system, len(log.gyro.time)) == ("crazyflie", 1500)
    assert np.median(np.diff(log.gyro.time)) == pytest.approx(1e-3, rel=0.02)
    assert log.accelerometer is not None
    assert log.motors is not None
    level = log.accelerometer.time < 0.5
    assert log.accelerometer.values[level].mean(axis=0) == pytest.approx([0.0, 0.0, -9.81], abs=0.3)
    assert log.motors.values.max() == pytest.approx(0.733, abs=1e-3)
    assert len(log.airborne) == 1
    assert 0.5 < log.airborne[0][0] < log.airborne[0][1] == log.gyro.time[-1]
    raw = np.frombuffer(EXCERPT.read_bytes()[129:-4], dtype=np.uint8).reshape(1500, 50)
    gyro_dps = raw[:, 22:34].copy().view("<f4")
    assert np.allclose(log.gyro.values, np.deg2rad(gyro_dps * [1.0, -1.0, -1.0]), atol=1e-6)


@pytest.mark.parametrize(("version", "stamp", "tick_s"), [(1, "<HI", 1e-3), (2, "<HQ", 1e-6)])
def test_read_log_of_a_crazyflie_skips_other_events(tmp_path: Path, version: int, stamp: str, tick_s: float) -> None:
    other = event(3, "newSetpoint", "ctrltarget.x(f)", "flags(B)")
    records = b"".join(
        struct.pack(stamp, 65535, 1000 + 4 * i)
        + struct.pack("<4f", 90.0, 45.0, -45.0, i)
        + struct.pack(stamp, 3, 1000 + 4 * i)
        + b"12345"
        for i in range(300)
    )
    path = crazyflie_log(tmp_path / "log00", version=version, events=GYRO + other, records=records, count=2)
    log = read_log(path)
    assert log.gyro.time == pytest.approx(4.0 * tick_s * np.arange(300))
    assert log.gyro.values[7] == pytest.approx(np.pi * np.array([0.5, -0.25, 0.25]))
    assert log.attitude is None


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ({"events": GYRO, "version": 7}, "version 7 of the format"),
        ({"events": event(1, "other", "gyro.x(f)")}, "no event fixedFrequency"),
        ({"events": GYRO.replace(b"gyro.z", b"gyro.w")}, "no variable gyro.z"),
        ({"events": GYRO.replace(b"gyro.z(f)", b"gyro.z(p)")}, r"no variable with a type: 'gyro.z\(p\)'"),
        ({"events": GYRO.replace(b"gyro.z", b"gyro.x")}, "no variable with a type"),
        ({"events": GYRO}, "no gyro in it"),
        ({"events": GYRO, "records": struct.pack("<HQ", 65535, 1)}, "begins no record"),
        ({"events": GYRO, "records": struct.pack("<HQ", 9, 1)}, "begins no record"),
        ({"events": event(1, "x", "a(f)")[:-3]}, "it is damaged|subsection|no variable"),
        ({"events": struct.pack("<H", 1) + b"x\0\xff\xff"}, "an event of 65535 variables"),
        ({"count": 9999}, "9999 event types"),
        ({"count": 2, "events": GYRO}, "it is damaged|subsection"),
    ],
)
def test_read_log_of_a_crazyflie_names_the_fault(tmp_path: Path, content: dict[str, Any], fault: str) -> None:
    path = crazyflie_log(tmp_path / "log00", **content)
    with pytest.raises(ConfigError, match=fault) as told:
        read_log(path)
    assert str(told.value).startswith(f"{path}: ")


@pytest.mark.parametrize("damage", ["cut", "flip"])
def test_read_log_of_a_crazyflie_checks_the_checksum(tmp_path: Path, damage: str) -> None:
    content = bytearray(EXCERPT.read_bytes())
    if damage == "cut":
        del content[-1000:]
    else:
        content[30_000] ^= 4
    (tmp_path / "log00").write_bytes(content)
    with pytest.raises(ConfigError, match="its checksum is wrong"):
        read_log(tmp_path / "log00")


def test_a_card_s_log_of_more_than_64_mib_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log00"
    path.write_bytes(b"\xbc")
    os.truncate(path, (64 << 20) + 1)
    with pytest.raises(ConfigError, match="larger than 64 MiB"):
        read_log(path)
