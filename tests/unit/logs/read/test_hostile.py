"""Files that were damaged, or made to harm: one line each, and bounded memory."""

import os
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.flight.recording import bag
from gustproof.flight.recording.bag import write_bag
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import load_law
from gustproof.logs.read import sample_store
from gustproof.logs.read.read_log import read_log

Write = Callable[[str, bytes], Path]
Check = Callable[..., None]
EXCERPT = Path(__file__).parent / "data" / "crazyflie.log"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["px4", "ardupilot", "text", "betaflight", "crazyflie", "bag", "csv"])
def test_read_log_of_mutated_files(
    check_mutations: Check,
    px4_log: bytes,
    ardupilot_log: bytes,
    ardupilot_messages: dict[str, tuple[str, str, list[tuple[object, ...]]]],
    betaflight_log: bytes,
    make_dataflash_text: Callable[..., bytes],
    tmp_path: Path,
    kind: str,
) -> None:
    rows = b"".join(b"%d,1.5,-2,3e1\n" % i for i in range(300))
    sources: dict[str, Callable[[], tuple[str, bytes]]] = {
        "px4": lambda: ("a.ulg", px4_log),
        "ardupilot": lambda: ("a.bin", ardupilot_log),
        "text": lambda: ("a.log", make_dataflash_text(ardupilot_messages)),
        "betaflight": lambda: ("a.csv", betaflight_log),
        "crazyflie": lambda: ("log00", EXCERPT.read_bytes()),
        "bag": lambda: ("a.mcap", own_bag(tmp_path)),
        "csv": lambda: ("a.csv", b"time_s,p_dps,q_dps,r_dps\n" + rows),
    }
    check_mutations(*sources[kind]())


@pytest.mark.parametrize("block", [31, 997, 5003])
@pytest.mark.parametrize("kind", ["px4", "ardupilot", "text"])
def test_a_damaged_log_is_the_same_in_blocks_of_any_size(
    written: Write,
    px4_log: bytes,
    ardupilot_log: bytes,
    ardupilot_messages: dict[str, tuple[str, str, list[tuple[object, ...]]]],
    make_dataflash_text: Callable[..., bytes],
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    block: int,
) -> None:
    logs = {"px4": px4_log, "ardupilot": ardupilot_log, "text": make_dataflash_text(ardupilot_messages)}
    content, sync = bytearray(logs[kind]), b"" if kind != "px4" else b"\x08\0S/s\x13 %\x0c\xbb\x12"
    for begin in range(len(content) // 8, len(content) - 400, len(content) // 8):
        content[begin : begin + 150] = bytes(150 - len(sync)) + sync
    path = written({"px4": "a.ulg", "ardupilot": "a.bin", "text": "a.log"}[kind], bytes(content))
    whole = read_log(path)
    monkeypatch.setattr(sample_store, "_BLOCK", block)
    parts = read_log(path)
    assert (parts.findings, parts.airborne, parts.parameters) == (whole.findings, whole.airborne, whole.parameters)
    for name in ("gyro", "command", "motors", "attitude", "reference", "rate_reference"):
        one, other = getattr(parts, name), getattr(whole, name)
        assert np.array_equal(one.time, other.time) if one else other is None
        assert np.array_equal(one.values, other.values, equal_nan=True) if one else True


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_flipped_bits_cost_few_samples(
    written: Write, flipped: Callable[..., bytes], px4_log: bytes, ardupilot_log: bytes, kind: str
) -> None:
    content, rng = {"px4": px4_log, "ardupilot": ardupilot_log}[kind], np.random.default_rng(8)
    whole = read_log(written("whole", content))
    for _ in range(40):
        log = read_log(written("flipped", flipped(content, rng, begin=2000)))
        for name in ("gyro", "command"):
            signal, truth = getattr(log, name), getattr(whole, name)
            assert len(signal.time) > 0.95 * len(truth.time)
            place = np.searchsorted(truth.time, signal.time - 1e-9)
            right = (abs(truth.time[place] - signal.time) < 1e-5) & (
                abs(truth.values[place] - signal.values) < 1e-6
            ).all(1)
            assert np.count_nonzero(~right) <= 12


def test_read_log_of_mutations_that_the_checksum_does_not_tell(check_mutations: Check) -> None:
    check_mutations(
        "log00", EXCERPT.read_bytes(), lambda mutated: mutated[:-4] + struct.pack("<I", crc32(mutated[:-4]))
    )


def own_bag(folder: Path) -> bytes:
    """Return the .mcap file of a short flight."""
    scenario = replace(load_scenario("paper-turbulence"), duration_s=0.2)
    write_bag(folder / "flight", fly_direct(scenario, load_law("hinf-d1"), vehicle=load_vehicle("paper")), {})
    return next((folder / "flight").glob("*.mcap")).read_bytes()


def test_a_bag_whose_messages_have_no_channel_is_damaged() -> None:
    fault = r"^a\.mcap: it is damaged: a message of no channel that it defines$"
    with pytest.raises(ConfigError, match=fault), bag._refused(Path("a.mcap")):
        raise KeyError(182)


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("a.ulg", b"", "is empty"),
        ("a.csv", b"", "is empty"),
        ("a.bin", b"GIF89a", "no flight log that is known; known are ULog"),
        ("a.tlog", b"GIF89a", "no heartbeat of an autopilot in it"),
        ("a.pdf", b"%PDF-1.7", "no flight log that is known"),
        ("a.toml", b"duration_s = 1.0", "is a scenario file: give it as the scenario"),
        ("a.ulg", b"ULog\x01\x12\x35\x01", "no gyro in it"),
        ("a.bin", b"\xa3\x95\x80", "no gyro in it; file: it ends within a message, 3 bytes"),
        ("log00", b"\xbc", "its checksum is wrong"),
        ("a.mcap", b"\x89MCAP0\r\n", "not an MCAP file"),
        ("a.csv", b"\xff\xfe\x00\x01", "not a CSV"),
        ("a.bbl", b"H Product:Blackbox flight data", "decode it with `blackbox_decode`, and give the .csv"),
        ("a.csv", b"loopIteration, time (us), motor[0]\n0, 1, 2\n", "without the column gyroadc_0"),
        ("a.csv", b"timestamp,timestamp_sample,xyz[0]\n1,2,3\n", "of PX4's ulog2csv, give the .ulg"),
        ("a.bag", b"#ROSBAG V2.0\n", "a bag of ROS 1"),
        ("a.log", b"FMT, " + bytes(9000), "a line of it has more than 4,096 bytes"),
        ("a.csv", b"time_s,p_dps,q_dps,r_dps\xff\n", "it is damaged"),
    ],
)
def test_read_log_of_what_is_no_log(written: Write, name: str, content: bytes, fault: str) -> None:
    path = written(name, content)
    with pytest.raises(ConfigError, match=fault) as told:
        read_log(path)
    assert str(told.value).startswith(f"{path}: ")


def test_read_log_of_what_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.ulg")
    for path, fault in (
        (tmp_path / "absent.ulg", "No such file or directory"),
        (tmp_path / "pipe.ulg", "is a device or a pipe, must be a file"),
        (Path("/dev/zero"), "is a device or a pipe, must be a file"),
    ):
        with pytest.raises(ConfigError) as told:
            read_log(path)
        assert str(told.value) == f"{path}: {fault}"


def test_read_log_bounds_what_it_keeps(written: Write, px4_log: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sample_store, "_KEPT", 20_000)
    with pytest.raises(ConfigError, match="more than 0 MiB of the signals that are used: cut it"):
        read_log(written("a.ulg", px4_log))
    monkeypatch.setattr(sample_store, "_LARGEST", 1000)
    with pytest.raises(ConfigError, match="is larger than"):
        read_log(written("a.ulg", px4_log))
