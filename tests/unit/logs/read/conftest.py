"""Writers of small, valid logs in the formats of others."""

import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.logs.read.read_log import read_log

ULOG_TYPES = {
    **{f"int{8 << i}_t": letter for i, letter in enumerate("bhiq")},
    **{f"uint{8 << i}_t": letter for i, letter in enumerate("BHIQ")},
    **{"float": "f", "double": "d", "bool": "?", "char": "B"},
}


def ulog_message(kind: str, content: bytes) -> bytes:
    return struct.pack("<HB", len(content), ord(kind)) + content


def ulog_topic(number: int, name: str, fields: str, rows: list[tuple[float, ...]], padding: int = 0) -> list[bytes]:
    """Return the definition of a topic such as `uint64_t timestamp;float[3] xyz`, and a message for each row."""
    letters = ""
    for field in fields.split(";"):
        kind, _, count = field.split(" ")[0].partition("[")
        letters += (count.rstrip("]") or "1") + ULOG_TYPES[kind]
    padded = f"{name}:{fields};" + (f"uint8_t[{padding}] _padding0;" if padding else "")
    data = [ulog_message("D", struct.pack("<H" + letters, number, *row)) for row in rows]
    return [ulog_message("F", padded.encode()), ulog_message("A", struct.pack("<BH", 0, number) + name.encode()), *data]


def ulog_parameter(name: str, value: float) -> bytes:
    letter, kind = ("i", "int32_t") if isinstance(value, int) else ("f", "float")
    key = f"{kind} {name}".encode()
    return ulog_message("P", bytes([len(key)]) + key + struct.pack("<" + letter, value))


def ulog(topics: list[list[bytes]], parameters: Mapping[str, float] | None = None, late: bytes = b"") -> bytes:
    """Return a log of topics; a sync marker follows each hundred messages."""
    flags = ulog_message("B", bytes(40))
    sync = ulog_message("S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12")
    head = b"".join(topic[0] for topic in topics) + b"".join(
        ulog_parameter(*each) for each in (parameters or {}).items()
    )
    subscribed = b"".join(topic[1] for topic in topics)
    data = [message for topic in topics for message in topic[2:]]
    data.sort(key=lambda message: struct.unpack_from("<Q", message, 5)[0])
    blocks = [b"".join(data[i : i + 100]) + sync for i in range(0, len(data), 100)]
    header = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
    return header + flags + head + subscribed + b"".join(blocks) + late


@pytest.fixture
def px4_topics() -> list[list[bytes]]:
    """Two seconds of a PX4: at rest, in the air from 0.5 s to 1.5 s."""
    rng = np.random.default_rng(3)
    gyro = rng.normal(size=(500, 3)).astype(np.float32).tolist()
    stamps = [1_000_000 + 4000 * i for i in range(500)]
    combined = [(t, *g, 4000, 0, 0.0, 0.0, -9.8) for t, g in zip(stamps, gyro, strict=True)]
    torque = [(t + 300, t, 0.1 * g[0], 0.1, -0.1) for t, g in zip(stamps, gyro, strict=True)]
    motors = [(t + 300, t, 0.4, 0.5, 0.6, float("nan") if t < 1_400_000 else 0.7, *[float("nan")] * 8) for t in stamps]
    attitude = [(t, t - 1000, np.cos(0.1), np.sin(0.1), 0.0, 0.0) for t in stamps[::2]]
    landed = [(1_000_000, True), (1_500_000, False), (2_500_000, True)]
    rates = [(1_000_000 + 20_000 * i, 0.1 * i, 0.2, -0.3) for i in range(80)]
    return [
        ulog_topic(
            3,
            "sensor_combined",
            "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;uint32_t flags;float[3] accelerometer_m_s2",
            combined,
        ),
        ulog_topic(
            7, "vehicle_torque_setpoint", "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz", torque, 4
        ),
        ulog_topic(9, "actuator_motors", "uint64_t timestamp;uint64_t timestamp_sample;float[12] control", motors),
        ulog_topic(12, "vehicle_attitude", "uint64_t timestamp;uint64_t timestamp_sample;float[4] q", attitude),
        ulog_topic(20, "vehicle_rates_setpoint", "uint64_t timestamp;float roll;float pitch;float yaw", rates),
        ulog_topic(300, "vehicle_land_detected", "uint64_t timestamp;bool landed", landed, 7),
        ulog_topic(301, "cpuload", "uint64_t timestamp;float load", [(t, 0.5) for t in stamps[::50]]),
    ]


def dataflash_format(kind: int, name: str, letters: str, columns: str) -> bytes:
    length = 3 + struct.calcsize("<" + dataflash_struct(letters))
    row = struct.pack("<BB4s16s64s", kind, length, name.encode(), letters.encode(), columns.encode())
    return b"\xa3\x95\x80" + row


def dataflash_struct(letters: str) -> str:
    return "".join(
        {"c": "h", "C": "H", "e": "i", "E": "I", "N": "16s", "Z": "64s", "M": "B"}.get(x, x) for x in letters
    )


def dataflash(messages: Mapping[str, tuple[str, str, list[tuple[object, ...]]]]) -> bytes:
    """Return a log of messages by name, each with number formats, columns and rows that begin with a time [us]."""
    formats = [dataflash_format(128, "FMT", "BBnNZ".replace("n", "I"), "Type,Length,Name,Format,Columns")]
    rows: list[tuple[float, bytes]] = []
    for kind, (name, (letters, columns, content)) in enumerate(messages.items(), start=10):
        formats.append(dataflash_format(kind, name, letters, columns))
        layout = struct.Struct("<" + dataflash_struct(letters))
        rows += [(float(row[0]), b"\xa3\x95" + bytes([kind]) + layout.pack(*row)) for row in content]
    return b"".join(formats) + b"".join(message for _, message in sorted(rows, key=lambda row: row[0]))


def dataflash_text(messages: Mapping[str, tuple[str, str, list[tuple[object, ...]]]]) -> bytes:
    """Return the same as Mission Planner writes it: hundredths are scaled."""
    lines = [f"FMT, 10, 0, {name}, {letters}, {columns}" for name, (letters, columns, _) in messages.items()]
    rows = [
        (row[0], ", ".join([name, *(dataflash_cell(*each) for each in zip(letters, row, strict=True))]))
        for name, (letters, _, content) in messages.items()
        for row in content
    ]
    return "\r\n".join([*lines, *(line for _, line in sorted(rows, key=lambda row: float(str(row[0])))), ""]).encode()


def dataflash_cell(letter: str, value: object) -> str:
    if isinstance(value, bytes):
        return value.decode()
    return f"{float(str(value)) / 100.0:.2f}" if letter in "cCeE" else f"{value}"


@pytest.fixture
def ardupilot_messages() -> dict[str, tuple[str, str, list[tuple[object, ...]]]]:
    """Two seconds of an ArduPilot: in the air from 0.5 s to 1.5 s."""
    rng = np.random.default_rng(4)
    gyro = rng.normal(size=(800, 3)).astype(np.float32).tolist()
    stamps = [5_000_000 + 2500 * i for i in range(800)]
    imu = [(t, i, *g, 0.0, 0.0, -9.8) for t, g in zip(stamps, gyro, strict=True) for i in (0, 1)]
    attitude = [(t, 100, 200, 0, -300, 0, 27000) for t in stamps[::4]]
    rate = [(t, 57.3, 0.1, 57.3, 0.2, 57.3, -0.3) for t in stamps[::2]]
    return {
        "PARM": ("QNf", "TimeUS,Name,Value", [(t, n, v) for t, n, v in PARAMETERS]),
        "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", imu),
        "RATE": ("Qffffff", "TimeUS,R,ROut,P,POut,Y,YOut", rate),
        "RCOU": ("QHHHHH", "TimeUS,C1,C2,C3,C4,C5", [(t, 1500, 1300, 0, 1400, 1600) for t in stamps[::4]]),
        "ATT": ("QccccCC", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw", attitude),
        "EV": ("QB", "TimeUS,Id", [(5_500_000, 28), (6_500_000, 18)]),
    }


PARAMETERS = [
    (5_000_000, b"ATC_RAT_RLL_P", 0.135),
    (5_000_000, b"MOT_PWM_MIN", 1100.0),
    (5_000_001, b"MOT_PWM_MAX", 1900.0),
    (5_000_002, b"SERVO1_FUNCTION", 34.0),
    (5_000_003, b"SERVO2_FUNCTION", 33.0),
    (5_000_004, b"SERVO4_FUNCTION", 36.0),
    (5_000_005, b"SERVO5_FUNCTION", 35.0),
    (5_900_000, b"ATC_RAT_RLL_P", 0.2),
]


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str, bytes], Path]:
    """Write a file and return its path."""

    def write(name: str, content: bytes) -> Path:
        path = tmp_path / name
        path.write_bytes(content)
        return path

    return write


SEEDS = 20  # for each format, five files a seed


def flip_bits(content: bytes, rng: np.random.Generator, begin: int = 0) -> bytes:
    """Return a file with twelve bits flipped from byte `begin` on."""
    flipped = bytearray(content)
    for place in rng.integers(begin, len(content), size=12):
        flipped[place] ^= 1 << int(rng.integers(8))
    return bytes(flipped)


def mutations(content: bytes, seed: int) -> Iterator[bytes]:
    """Yield a file with some bits, or a run of bytes, changed; one that is cut, and one with a part twice."""
    rng = np.random.default_rng(seed)
    flipped = bytearray(content)
    for place in rng.integers(len(content), size=int(rng.choice([1, 10, 300]))):
        flipped[place] = int(rng.integers(256))
    yield bytes(flipped)
    yield flip_bits(content, rng)
    begin, end = sorted(rng.integers(len(content), size=2).tolist())
    filled = bytearray(content)
    filled[begin:end] = bytes([int(rng.choice([0, 255, 68, 163]))]) * (end - begin)
    yield bytes(filled)
    yield content[:end]
    yield content[:end] + content[begin:]


def read_or_refuse(path: Path) -> None:
    """Read a log, or see it refused in one line that names it."""
    refusal = ""
    try:
        log = read_log(path)
    except ConfigError as error:
        refusal = str(error)
    if refusal:
        assert refusal.startswith(f"{path}: ")
        assert len(refusal) > len(f"{path}: ")
        assert refusal.isprintable()
        return
    assert len(log.gyro.time) > 1
    for signal in (log.gyro, log.command, log.motors, log.accelerometer, log.attitude, log.reference):
        if signal is not None:
            assert np.all(np.diff(signal.time) > 0.0)
            assert np.all(np.isfinite(signal.values))
    assert all(line.isprintable() for line in log.findings)


@pytest.fixture
def check_mutations(written: Callable[[str, bytes], Path]) -> Callable[..., None]:
    """Read a hundred mutations of a file, each finished by a function."""

    def check(name: str, content: bytes, finish: Callable[[bytes], bytes] = lambda mutated: mutated) -> None:
        for seed in range(SEEDS):
            for mutated in mutations(content, seed):
                read_or_refuse(written(name, finish(mutated)))

    return check


@pytest.fixture
def flipped() -> Callable[..., bytes]:
    """Return the function that flips bits, see `flip_bits`."""
    return flip_bits


@pytest.fixture
def make_ulog() -> Callable[..., bytes]:
    """Return the writer of ULogs, see `ulog`."""
    return ulog


@pytest.fixture
def make_topic() -> Callable[..., list[bytes]]:
    """Return the writer of topics, see `ulog_topic`."""
    return ulog_topic


@pytest.fixture
def make_dataflash() -> Callable[..., bytes]:
    """Return the writer of DataFlash logs, see `dataflash`."""
    return dataflash


@pytest.fixture
def make_dataflash_text() -> Callable[..., bytes]:
    """Return the writer of DataFlash logs as text, see `dataflash_text`."""
    return dataflash_text


@pytest.fixture
def betaflight_log() -> bytes:
    """Two seconds of Betaflight's decoder: DShot, the gyro in whole deg/s."""
    names = ["time (us)", *(f"axis{t}[{i}]" for t in "PID" for i in range(3) if (t, i) != ("D", 2))]
    names += [f"{kind}[{i}]" for kind in ("setpoint", "gyroADC") for i in range(3)]
    names = ["loopIteration", *names, *(f"motor[{i}]" for i in range(4)), "flightModeFlags (flags)"]
    rows = [
        [
            i,
            9_000_000 + 4000 * i,
            100,
            50,
            -40,
            10,
            20,
            30,
            -10,
            5,
            40,
            30,
            20,
            i % 90,
            20,
            -30,
            *[747 + i % 7] * 4,
            "0",
        ]
        for i in range(500)
    ]
    return "\n".join(", ".join(map(str, row)) for row in [names, *rows]).encode() + b"\n"


@pytest.fixture
def px4_log(px4_topics: list[list[bytes]]) -> bytes:
    """Log of a PX4."""
    return ulog(px4_topics, {"MC_ROLLRATE_P": 0.15, "IMU_INTEG_RATE": 250}, late=ulog_parameter("MC_ROLLRATE_P", 0.2))


@pytest.fixture
def ardupilot_log(ardupilot_messages: dict[str, tuple[str, str, list[tuple[object, ...]]]]) -> bytes:
    """Log of an ArduPilot."""
    return dataflash(ardupilot_messages)
