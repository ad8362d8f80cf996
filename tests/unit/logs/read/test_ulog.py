import io
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog

from firmware_model.errors import ConfigError
from gustproof.logs.read import ulog
from gustproof.logs.read.flight_log import CommandUnit
from gustproof.logs.read.read_log import read_log

Write = Callable[[str, bytes], Path]


def test_read_log_of_px4_maps_topics_to_signals(written: Write, px4_log: bytes) -> None:
    log = read_log(written("any.name", px4_log))
    assert (log.system, log.command_unit) == ("px4", CommandUnit.NORMALISED)
    assert (log.command, log.motors, log.attitude, log.accelerometer) != (None, None, None, None)
    start_s = 0.998  # the first gyro sample, in the middle of its interval
    assert log.gyro.time == pytest.approx(0.004 * np.arange(500))
    assert log.command is not None
    assert log.command.time[0] == pytest.approx(1.0003 - start_s)
    assert log.command.values[:, 0] == pytest.approx(0.1 * log.gyro.values[:, 0], abs=1e-7)
    assert log.motors is not None
    assert log.motors.values[[0, -1]] == pytest.approx(np.array([[0.4, 0.5, 0.6, 0.0], [0.4, 0.5, 0.6, 0.7]]))
    assert log.attitude is not None
    assert log.attitude.time[0] == pytest.approx(0.999 - start_s)
    assert log.attitude.values[7] == pytest.approx([0.2, 0.0, 0.0])
    assert log.reference is None
    assert log.rate_reference is not None
    assert log.rate_reference.values[3] == pytest.approx([0.3, 0.2, -0.3])
    assert log.is_gyro_raw
    assert log.airborne[0] == pytest.approx((1.5 - start_s, 2.5 - start_s))
    assert log.parameters == pytest.approx({"MC_ROLLRATE_P": 0.2, "IMU_INTEG_RATE": 250.0})
    assert log.findings == (
        "parameters: changed in this log, the last value counts: MC_ROLLRATE_P",
        "not in this log: reference",
    )


def test_read_log_of_px4_matches_pyulog(written: Write, px4_log: bytes) -> None:
    log, theirs = read_log(written("a.ulg", px4_log)), ULog(io.BytesIO(px4_log))
    for values, topic, field in (
        (log.gyro.values, "sensor_combined", "gyro_rad"),
        (log.command.values if log.command else None, "vehicle_torque_setpoint", "xyz"),
    ):
        data = theirs.get_dataset(topic).data
        assert np.array_equal(values, np.column_stack([data[f"{field}[{i}]"] for i in range(3)]))


def test_a_field_is_found_behind_those_of_every_type(
    written: Write,
    px4_topics: list[list[bytes]],
    make_ulog: Callable[..., bytes],
    make_topic: Callable[..., list[bytes]],
) -> None:
    kinds = [f"{sign}int{bits}_t" for sign in ("", "u") for bits in (8, 16, 32, 64)] + [
        "float",
        "double",
        "bool",
        "char",
    ]
    fields = ["uint64_t timestamp", *(f"{kind} of_{kind}" for kind in kinds), "float[3] gyro_rad"]
    rows = [(1_000_000 + 4000 * i, *[1] * len(kinds), 0.01 * i, 0.2, -0.3) for i in range(500)]
    px4_topics[0] = make_topic(3, "sensor_combined", ";".join(fields), rows)
    log = read_log(written("a.ulg", make_ulog(px4_topics)))
    assert log.gyro.values == pytest.approx(np.array([row[-3:] for row in rows]))


def test_a_filtered_gyro_is_not_raw(
    written: Write,
    px4_topics: list[list[bytes]],
    make_ulog: Callable[..., bytes],
    make_topic: Callable[..., list[bytes]],
) -> None:
    rows = [(1_000_000 + 4000 * i, 999_000 + 4000 * i, 0.01 * i, 0.2, -0.3) for i in range(500)]
    fields = "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz"
    px4_topics[0] = make_topic(3, "vehicle_angular_velocity", fields, rows)
    log = read_log(written("a.ulg", make_ulog(px4_topics)))
    assert not log.is_gyro_raw
    assert log.gyro.values == pytest.approx(np.array([row[-3:] for row in rows]))


def raw_gyro() -> list[bytes]:
    """Return two seconds of the raw gyro at 1 kHz, four samples a message."""
    fields = b"uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float dt;float scale;uint8_t samples;"
    fields += b"int16_t[4] x;int16_t[4] y;int16_t[4] z;"
    samples = [[4 * i + j for j in range(4)] for i in range(500)]
    data = [
        struct.pack("<HQQIffB12h", 40, 1_000_000 + 4000 * i, 999_900 + 4000 * i, 1, 1000.0, 0.001, 4, *x, *x, *[0] * 4)
        for i, x in enumerate(samples)
    ]
    head = [
        struct.pack("<HB", 17 + len(fields), ord("F")) + b"sensor_gyro_fifo:" + fields,
        struct.pack("<HBBH", 19, ord("A"), 0, 40) + b"sensor_gyro_fifo",
    ]
    return [*head, *(struct.pack("<HB", len(each), ord("D")) + each for each in data)]


def test_read_log_of_px4_takes_the_fastest_gyro(
    written: Write, px4_topics: list[list[bytes]], make_ulog: Callable[..., bytes]
) -> None:
    log = read_log(written("a.ulg", make_ulog([*px4_topics, raw_gyro()])))
    assert len(log.gyro.time) == 2000
    assert np.diff(log.gyro.time) == pytest.approx(0.001)
    assert log.gyro.values[1234] == pytest.approx([1.234, 1.234, 0.0])


@pytest.mark.parametrize(
    ("key", "value"),
    [(b"float ODD", bytes(3)), (b"int32_t ODD", bytes(5)), (b"double ODD", bytes(4)), (b"float ODD ONE", bytes(4))],
)
def test_read_log_of_px4_leaves_out_what_is_no_parameter(
    written: Write, px4_topics: list[list[bytes]], make_ulog: Callable[..., bytes], key: bytes, value: bytes
) -> None:
    content = bytes([len(key)]) + key + value
    log = read_log(written("a.ulg", make_ulog(px4_topics, late=struct.pack("<HB", len(content), ord("P")) + content)))
    assert not log.parameters


@pytest.mark.parametrize(
    ("limit", "measured", "in_use", "loops"),
    [
        (800, 250.1, 7, 250.0),
        (0, 666.7, 7, 667.0),
        (250, 250.1, 7, 250.0),
        (800, 250.1, 8, 800.0),
        (800, np.nan, 7, 800.0),
    ],
)
def test_read_log_of_px4_tells_loops_as_slow_as_the_gyro(
    written: Write,
    px4_topics: list[list[bytes]],
    make_ulog: Callable[..., bytes],
    make_topic: Callable[..., list[bytes]],
    limit: int,
    measured: float,
    in_use: int,
    loops: float,
) -> None:
    head = "uint64_t timestamp;uint32_t gyro_device_id"
    status = make_topic(50, "vehicle_imu_status", f"{head};float gyro_rate_hz", [(1_500_000, 7, measured)] * 3)
    selection = make_topic(51, "sensor_selection", head, [(1_400_000, in_use)])
    log = read_log(written("a.ulg", make_ulog([*px4_topics, status, selection], {"IMU_GYRO_RATEMAX": limit})))
    assert log.parameters["IMU_GYRO_RATEMAX"] == loops
    assert any("so have the loops" in line for line in log.findings) == (loops != limit)


@pytest.mark.parametrize(
    ("parked", "off", "full", "hover"),
    [
        (900.0, 1000.0, 2000.0, 1500.0),
        (0.0, 48.0, 2047.0, 940.0),
        (48.0, 48.0, 2047.0, 1300.0),
        (0.0, 1000.0, 2000.0, 1100.0),
    ],
)
def test_read_log_of_px4_tells_pulses_from_dshot(
    written: Write,
    make_ulog: Callable[..., bytes],
    make_topic: Callable[..., list[bytes]],
    parked: float,
    off: float,
    full: float,
    hover: float,
) -> None:
    stamps = [1_000_000 + 4000 * i for i in range(1000)]
    gyro = make_topic(
        1, "sensor_gyro", "uint64_t timestamp;float x;float y;float z", [(t, 0.1, 0.2, t % 7) for t in stamps]
    )
    turning = [
        (t, *(hover + 7.0 * (i % 5) + t % 3 if t > 2_500_000 else parked for i in range(4))) for t in stamps[::2]
    ]
    log = read_log(
        written(
            "a.ulg", make_ulog([gyro, make_topic(2, "actuator_outputs", "uint64_t timestamp;float[4] output", turning)])
        )
    )
    assert log.motors is not None
    assert log.motors.values[-1, 0] == pytest.approx((turning[-1][1] - off) / (full - off))
    assert log.motors.values[0, 0] == 0.0
    assert log.airborne == (pytest.approx((1.5, 4.0), abs=0.01),)


def test_read_log_of_px4_leaves_out_too_many_raw_samples(
    written: Write, px4_topics: list[list[bytes]], make_ulog: Callable[..., bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ulog, "_MOST_RAW", 1999)
    log = read_log(written("a.ulg", make_ulog([*px4_topics, raw_gyro()])))
    assert len(log.gyro.time) == 500


def test_read_log_of_px4_tells_damage_and_reads_on_after_it(written: Write, px4_log: bytes) -> None:
    whole = read_log(written("a.ulg", px4_log))
    damaged = bytearray(px4_log)
    middle = len(damaged) // 2
    damaged[middle : middle + 200] = bytes(200)
    log = read_log(written("b.ulg", bytes(damaged)))
    assert 300 < len(log.gyro.time) < len(whole.gyro.time)
    assert any("bytes are damaged: left out" in line for line in log.findings)
    assert log.gyro.time[-1] == pytest.approx(whole.gyro.time[-1])


def test_read_log_of_px4_tells_that_its_end_is_missing(written: Write, px4_log: bytes) -> None:
    log = read_log(written("a.ulg", px4_log[: len(px4_log) * 3 // 4 + 1]))
    assert 300 < len(log.gyro.time) < 400
    assert any(line.startswith("file: it ends within a message, ") for line in log.findings)


def test_read_log_of_px4_tells_drop_outs(
    written: Write, px4_topics: list[list[bytes]], make_ulog: Callable[..., bytes]
) -> None:
    late = struct.pack("<HBH", 2, ord("O"), 120) + struct.pack("<HBH", 2, ord("O"), 30)
    log = read_log(written("a.ulg", make_ulog(px4_topics, late=late)))
    assert "logger: 2 drop-outs, 0.15 s in all" in log.findings


def test_read_log_of_px4_refuses_features_of_later_formats(written: Write, px4_log: bytes) -> None:
    flags = bytearray(px4_log)
    flags[16 + 3 + 9] = 1
    with pytest.raises(ConfigError, match="a ULog with features that are not known here"):
        read_log(written("a.ulg", bytes(flags)))


@pytest.mark.parametrize(
    "fields",
    [
        "uint64_t timestamp;float[65535] gyro_rad",
        "uint64_t timestamp;float[2] gyro_rad",
        "uint64_t timestamp;uint8_t[32] gyro_rad",
        "uint64_t timestamp;uint8_t[0] gyro_rad",
        "uint64_t timestamp;float[99999999999] gyro_rad",
        "uint64_t timestamp;sensor_combined nested;float[3] gyro_rad",
        "uint64_t timestamp;float gyro_rad",
        "float[3] gyro_rad",
        "float timestamp;float[3] gyro_rad",
        "",
    ],
)
def test_read_log_of_px4_survives_what_a_format_claims(
    written: Write, px4_topics: list[list[bytes]], make_ulog: Callable[..., bytes], fields: str
) -> None:
    claim = f"sensor_combined:{fields};".encode()
    px4_topics[0][0] = struct.pack("<HB", len(claim), ord("F")) + claim
    path = written("a.ulg", make_ulog(px4_topics))
    with pytest.raises(ConfigError) as told:
        read_log(path)
    assert str(told.value).startswith(f"{path}: ")


@pytest.mark.parametrize(("enabled", "report"), [(1, True), (3, True), (2, True), (1, False)])
def test_speeds_of_rotors_that_notches_follow_are_read_from_a_topic_within_another(
    written: Write, px4_topics: list[list[bytes]], make_ulog: Callable[..., bytes], enabled: int, report: bool
) -> None:
    number, name, within = 99, b"esc_status", "esc_report:uint64_t timestamp;int32_t esc_rpm;uint8_t[4] _padding0;"
    rpms = [-6000, 6120, 6000, -5880, 0, 0, 0, 0]
    content = [
        struct.pack("<HQ", number, t) + b"".join(struct.pack("<Qi4x", t, rpm) for rpm in rpms) + b"\x04"
        for t in range(1_000_000, 3_000_000, 20_000)
    ]
    formats = ["esc_status:uint64_t timestamp;esc_report[8] esc;uint8_t esc_count;", *([within] if report else [])]
    framed = [struct.pack("<HB", len(each), ord("F")) + each.encode() for each in formats]
    subscribed = struct.pack("<HBBH", 3 + len(name), ord("A"), 0, number) + name
    data = [struct.pack("<HB", len(each), ord("D")) + each for each in content]
    topics = [*px4_topics, [b"".join(framed), subscribed, *data]]
    log = read_log(written("a.ulg", make_ulog(topics, {"IMU_GYRO_DNF_EN": enabled})))
    told = enabled & 1 and report
    assert log.parameters.get("IMU_GYRO_DNF_FLOWN") == (100.0 if told else None)
    assert log.parameters.get("IMU_GYRO_DNF_ROTORS") == (4.0 if told else None)
