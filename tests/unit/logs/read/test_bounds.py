"""Bounds of the readers, from both sides: what is just allowed, and what is just refused."""

import io
import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.logs.read import betaflight, crazyflie, dataflash, table, tlog
from gustproof.logs.read.assemble import LoggedParameters, Rows, _stretches, euler_angles
from gustproof.logs.read.read_log import read_log
from gustproof.logs.read.sample_store import SampleStore

Write = Callable[[str, bytes], Path]


def refused(call: Callable[..., object], *arguments: object) -> str:
    """Return why a call is refused; empty if it is not."""
    try:
        call(*arguments)
    except ValueError as error:
        return str(error)
    return ""


def test_a_table_has_at_most_so_many_names_bytes_and_numbers(tmp_path: Path) -> None:
    assert not refused(table.read_names, io.BytesIO(b",".join([b"a"] * 1000)))
    assert refused(table.read_names, io.BytesIO(b",".join([b"a"] * 1001))) == "1,001 columns; at most 1,000 are allowed"
    assert not refused(table.read_names, io.BytesIO(b"a" * 65535))
    assert "more than 65,536 bytes" in refused(table.read_names, io.BytesIO(b"a" * 65536))
    assert not refused(table._check_count, 12_000_000)
    assert "more than 12,000,000 numbers" in refused(table._check_count, 12_000_001)
    for size, is_refused in ((256 << 20, False), ((256 << 20) + 1, True)):
        (tmp_path / "a.csv").write_bytes(b"")
        os.truncate(tmp_path / "a.csv", size)
        with (tmp_path / "a.csv").open("rb") as file:
            assert bool(refused(table.check_size, file)) is is_refused
            assert file.tell() == 0 or is_refused


def test_a_thousand_lines_may_stand_before_the_names_of_a_blackbox() -> None:
    head = b"a,b\n" * 999 + b"loopiteration,time\n"
    assert betaflight._skip_headers(io.BytesIO(head))[0] == ["loopiteration", "time"]
    assert "without names of columns" in refused(betaflight._skip_headers, io.BytesIO(b"a,b\n" + head))


def test_a_store_keeps_256_mib_with_24_bytes_a_record() -> None:
    store = SampleStore()
    assert store._left == 256 << 20
    store._left = 2 * (10 + 24)
    assert [refused(store.add, "a", place, bytes(10)) for place in (3, 7)] == ["", ""]
    assert "more than 256 MiB of the signals that are used" in refused(store.add, "a", 9, b"")
    assert store.table("a", np.dtype([("x", "S10")]))[0].tolist() == [3, 7]


@pytest.mark.parametrize(("count", "is_refused"), [(1000, False), (1001, True)])
def test_a_card_s_log_has_at_most_a_thousand_events_and_variables(count: int, is_refused: bool) -> None:
    def event(number: int, variables: int) -> bytes:
        texts = b"".join(b"v%d(f)\0" % each for each in range(variables))
        return struct.pack("<H", number) + b"fixedFrequency\0" + struct.pack("<H", variables) + texts

    many = struct.pack("<BHH", 0xBC, 2, 1) + event(1, count) + bytes(4)
    assert refused(crazyflie._read_table, many) == (f"an event of {count} variables" if is_refused else "")
    events = b"".join(event(number, 1) for number in range(count))
    told = refused(crazyflie._read_table, struct.pack("<BHH", 0xBC, 2, count) + events + bytes(4))
    assert (f"{count} event types" in told) is is_refused


def test_telemetry_may_have_300_000_damaged_bytes_and_ends_within_a_frame_of_less_than_20() -> None:
    for size, told in ((24, ""), (25, "more than 300,000 bytes of it are no frames")):
        parser = tlog._Parser()
        parser.damaged = 299_995
        assert refused(parser.consume, bytes(size), 0) == told
        assert parser.damaged == 299_995 + size - 19


def test_a_line_of_a_text_log_has_at_most_4096_bytes() -> None:
    assert not refused(dataflash._TextParser().consume, b"x" * 4096, 0)
    assert refused(dataflash._TextParser().consume, b"x" * 4097, 0) == "a line of it has more than 4,096 bytes"


@pytest.mark.parametrize(("tail", "told"), [(b"", []), (b"\xa3", []), (b"\xa3\x95", ["2 bytes of it are there"])])
def test_one_byte_at_the_end_of_a_binary_log_is_no_message(
    written: Write, ardupilot_log: bytes, tail: bytes, told: list[str]
) -> None:
    found = read_log(written("a.bin", ardupilot_log + tail)).findings
    assert [line.partition(", ")[2] for line in found if line.startswith("file: ")] == told


@pytest.mark.parametrize(
    ("share", "command", "is_old"), [(0.02, 2.1, True), (0.005, 2.1, False), (0.02, 1.9, False), (0.02, -2.1, True)]
)
def test_commands_are_integers_up_to_4500_if_a_hundredth_is_beyond_2(
    written: Write, share: float, command: float, is_old: bool
) -> None:
    head = ["FMT, 11, 0, IMU, Qfff, TimeUS,GyrX,GyrY,GyrZ", "FMT, 12, 0, RATE, Qfff, TimeUS,ROut,POut,YOut"]
    every = round(1.0 / share)
    rows = [
        f"IMU, {2500 * i}, 0.1, {i % 5}e-2, 0.3\nRATE, {2500 * i}, " + ", ".join([f"{command * (i % every == 0)}"] * 3)
        for i in range(1, 1001)
    ]
    log = read_log(written("a.log", "\n".join([*head, *rows, ""]).encode()))
    assert any("before 3.4" in line for line in log.findings) is is_old


@pytest.mark.parametrize(("length", "is_read"), [(64, True), (65, False)])
def test_a_field_of_px4_has_at_most_64_numbers(
    written: Write,
    px4_topics: list[list[bytes]],
    make_ulog: Callable[..., bytes],
    make_topic: Callable[..., list[bytes]],
    length: int,
    is_read: bool,
) -> None:
    rows = [(1_000_000 + 4000 * i, *[0.5] * length) for i in range(500)]
    topics = [topic for topic in px4_topics if b"actuator_motors" not in topic[0]]
    motors = make_topic(9, "actuator_motors", f"uint64_t timestamp;float[{length}] control", rows)
    assert (read_log(written("a.ulg", make_ulog([*topics, motors]))).motors is not None) is is_read


@pytest.mark.parametrize(("flag", "is_refused"), [(0, False), (1, False), (2, True)])
def test_data_appended_to_a_log_of_px4_is_the_only_feature_that_is_known(
    written: Write, px4_log: bytes, flag: int, is_refused: bool
) -> None:
    content = bytearray(px4_log)
    content[16 + 3 + 8] = flag
    told = ""
    try:
        read_log(written("a.ulg", bytes(content)))
    except ConfigError as error:
        told = str(error)
    assert bool(told) is is_refused


def test_eight_parameters_that_changed_are_named_and_of_more_their_number() -> None:
    parameters = LoggedParameters()
    for number in range(9):
        parameters.add(f"P{number}", 1.0)
        parameters.add(f"P{number}", 1.0)
        assert parameters.findings() == [] or number
        parameters.add(f"P{number}", 2.0)
        named = ", ".join(f"P{each}" for each in range(min(number + 1, 8)))
        (line,) = parameters.findings()
        assert line.endswith(f": {named}{' and 1 more' if number == 8 else ''}")


def test_stretches_and_pauses_of_half_a_second_count() -> None:
    def found(*changes: float) -> tuple[tuple[float, float], ...]:
        states = np.arange(len(changes)) % 2 == 0
        return _stretches(np.array(changes), states, 9.0)

    assert found(1.0, 1.5) == ((1.0, 1.5),)
    assert found(1.0, 1.49) == ()
    assert found(1.0, 2.0, 2.5, 4.0) == ((1.0, 2.0), (2.5, 4.0))
    assert found(1.0, 2.0, 2.49, 4.0) == ((1.0, 4.0),)
    assert found(-3.0, 2.0, 8.0) == ((0.0, 2.0), (8.0, 9.0))


def test_a_quaternion_of_less_than_half_the_length_is_no_rotation() -> None:
    lengths = np.array([0.49, 0.51])
    assert np.isnan(euler_angles(lengths[:, None] * [1.0, 0.0, 0.0, 0.0])).any(axis=1).tolist() == [True, False]


def test_samples_without_a_stamp_have_no_times() -> None:
    rows = Rows(position=np.arange(2), time_us=np.array([np.nan, np.nan]), values=np.zeros((2, 3)))
    assert not rows.has_times()
    rows.time_us[1] = 0.0
    assert rows.has_times()
    assert rows.take(np.array([True, True])) is rows
