"""Write journal records as a rosbag2 bag in MCAP, and read them back.

A bag is made in a temporary folder beside its destination and moved there when it is whole. So every bag is readable,
and an interrupted writer leaves none. Chunks are compressed with zstd; compressed messages would be refused by other
readers.
"""

import json
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from firmware_model.config.files import TEXT, parse_json
from firmware_model.config.scenario import Scenario
from firmware_model.config.validation import sanitize_line
from firmware_model.errors import ConfigError
from firmware_model.recording.estimates import ESTIMATE
from firmware_model.recording.journal import record_blocks
from gustproof.flight.recording import definitions
from gustproof.flight.recording.definitions import TYPES, definition
from gustproof.flight.recording.derived import (
    EVENTS_TOPIC,
    INFO,
    REQUIREMENTS_TOPIC,
    angle_blocks,
    event_lines,
    parse_scenario,
    requirement_fields,
)
from gustproof.flight.recording.interleaved import BagWriter
from gustproof.flight.recording.mcap import Message, messages
from gustproof.flight.recording.topics import (
    ANGLE_TOPICS,
    BASE_LINK_FRD,
    ESTIMATE_TOPICS,
    ROTORS_TOPIC,
    TOLD_WIND_TOPIC,
    TOPICS,
    Topic,
    decode,
    encode,
    list_topics,
    nan_records,
    rotors_in,
    times_us,
)
from gustproof.flight.recording.transforms import TF_STATIC_TOPIC, TF_TOPIC, encode_tf, static_message, tf_rows

FLIGHT_TOPIC, MODE_TOPIC, RATES_TOPIC = "/flight", "/mode", "/command/rates"
UNFINISHED_PREFIX = ".bag-"
"""Prefix of the folder of an unfinished bag; a killed writer leaves it behind."""
_FOREVER = QosTime(sec=9223372036, nsec=854775807)  # ROS 2's "no deadline"
_RELIABLE = (QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL)
_LATCHED = Qos(*_RELIABLE, _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)

Records = NDArray[np.void]


def write_bag(
    path: Path,
    records: Records,
    flight: Mapping[str, Any],
    estimates: Records | None = None,
    requirements: Iterable[Mapping[str, Any]] = (),
) -> None:
    """Write the journal `records` (n,) as a bag, the folder `path`, with `flight` as JSON on /flight.

    `estimates` (m,) are attitudes and winds that a real autopilot told, see `firmware_model.recording.estimates`. The
    `requirements` are results as JSON. With the scenario in `flight`, they and its events have topics for viewers.

    Equal records and an equal `flight` give equal bytes of every message. Stamps are model time. Without commanded
    rates there is no topic /command/rates.

    Raises
    ------
    ConfigError
        If `path` exists: a bag is never overwritten.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import fly_direct, load_law, load_scenario, load_vehicle, read_bag, write_bag
    >>> scenario = replace(load_scenario("paper-turbulence"), duration_s=0.1)
    >>> records = fly_direct(scenario, load_law("hinf-d1"), vehicle=load_vehicle("paper"))
    >>> with TemporaryDirectory() as folder:
    ...     write_bag(Path(folder) / "flight", records, {"pilot": "nobody"})
    ...     read_bag(Path(folder) / "flight")[0]
    {'pilot': 'nobody'}
    """
    if path.exists():
        raise ConfigError(f"{path}: exists already; a bag is never overwritten")
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=UNFINISHED_PREFIX) as unfinished:
        staged = Path(unfinished) / path.name  # rosbag2 names the file inside after the folder
        writer = BagWriter(staged, version=BagWriter.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            _write(writer, records, flight)
            if estimates is not None:
                tells_wind = np.isfinite(estimates["told_wind_N"]).any()
                for topic in (*ESTIMATE_TOPICS, *[TOLD_WIND_TOPIC] * bool(tells_wind)):
                    _write_rows(writer, topic, record_blocks(estimates))
            _write_derived(writer, records, parse_scenario(flight), requirements)
        staged.rename(path)


def read_bag(path: Path) -> tuple[dict[str, Any], Records]:
    """Return the metadata on /flight and the journal records (n,) from `write_bag`, to the bit.

    `path` is the bag's folder or its one .mcap file.

    Raises
    ------
    ConfigError
        If the bag can't be read, or lacks one of the topics.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import fly_direct, load_law, load_scenario, load_vehicle, read_bag, write_bag
    >>> scenario = replace(load_scenario("paper-turbulence"), duration_s=0.1)
    >>> records = fly_direct(scenario, load_law("hinf-d1"), vehicle=load_vehicle("paper"))
    >>> with TemporaryDirectory() as folder:
    ...     write_bag(Path(folder) / "flight", records, {})
    ...     _, read = read_bag(Path(folder) / "flight")
    >>> read.tobytes() == records.tobytes()
    True
    """
    with _refused(path):
        return _read(path)


def read_flight(path: Path) -> dict[str, Any]:
    """Return the metadata on /flight of a bag whose messages can all be read, in little memory.

    Raises
    ------
    ConfigError
        If the bag can't be read, or lacks one of the topics.
    """
    document = b""
    for name, _, payload in checked_messages(path):
        document = document or payload if name == FLIGHT_TOPIC else document
    with _refused(path):
        return _parse_flight(path, document)


def checked_messages(path: Path) -> Iterator[Message]:
    """Yield all messages of a bag of ours; the /flight, /mode and journal topics that it lacks are told at the end.

    Raises
    ------
    ConfigError
        If the bag can't be read, or lacks one of the topics.
    """
    lacking = {FLIGHT_TOPIC, MODE_TOPIC, *(topic.name for topic in TOPICS)} - {RATES_TOPIC}
    with _refused(path):
        for file in _files(path):
            for message in messages(file):
                lacking.discard(message[0])
                yield message
        if lacking:
            raise ConfigError(f"{path}: no topic {min(lacking)}: not a bag of a gustproof flight")


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Name the file in any error."""
    try:
        yield
    except ConfigError:
        raise
    except KeyError:  # of a channel or a schema that no record defines: its text would be a number
        raise ConfigError(f"{path}: it is damaged: a message of no channel that it defines") from None
    except Exception as error:  # readers raise anything at a damaged file
        reason = sanitize_line(" ".join(str(error).split())) or type(error).__name__
        raise ConfigError(f"{path}: {reason}") from None


def _read(path: Path) -> tuple[dict[str, Any], Records]:
    known = {FLIGHT_TOPIC, MODE_TOPIC, *(topic.name for topic in TOPICS)}
    payloads: dict[str, bytearray] = defaultdict(bytearray)
    changed_us: list[int] = []
    for name, time_ns, payload in checked_messages(path):
        if name in known and not (name == FLIGHT_TOPIC and FLIGHT_TOPIC in payloads):
            payloads[name] += payload
        if name == MODE_TOPIC:
            changed_us.append(time_ns // 1000)
    flight = _parse_flight(path, payloads[FLIGHT_TOPIC])
    samples = len(payloads[TOPICS[0].name]) // TOPICS[0].layout.itemsize
    rotors = rotors_in(len(payloads[ROTORS_TOPIC]) // max(samples, 1))
    records = nan_records(samples, rotors)
    for topic in list_topics(rotors):
        if topic.name in payloads:
            rows: NDArray[np.void] = np.frombuffer(payloads[topic.name], dtype=topic.layout)
            decode(topic, rows, records)
            records["time_us"] = times_us(rows)
    modes = np.frombuffer(payloads[MODE_TOPIC], dtype="<u4").reshape(len(changed_us), -1)[:, -1]
    latest = np.searchsorted(changed_us, records["time_us"], side="right") - 1
    records["mode"][latest >= 0] = modes[latest[latest >= 0]]
    return flight, records


def _parse_flight(path: Path, payload: bytes | bytearray) -> dict[str, Any]:
    if len(payload) > TEXT:
        raise ConfigError(f"{path}: the message on {FLIGHT_TOPIC} is longer than {TEXT:,} bytes")
    flight: dict[str, Any] = parse_json(TYPES.deserialize_cdr(payload, definitions.FLIGHT).document)
    if not isinstance(flight, dict):
        raise ConfigError(f"{path}: does not say what was flown")
    return flight


def _files(path: Path) -> list[Path]:
    """Return the MCAP files of a bag, its folder or its one file."""
    return [path] if path.suffix == ".mcap" else sorted(path.glob("*.mcap"))


def _write(writer: BagWriter, records: Records, flight: Mapping[str, Any]) -> None:
    has_rates = any(not np.isnan(block["omega_command_B"]).all() for block in record_blocks(records))
    topics = [
        topic for topic in list_topics(records.dtype["rotors"].shape[0]) if topic.name != RATES_TOPIC or has_rates
    ]
    start_ns = int(records["time_us"][0]) * 1000
    text = json.dumps(flight, sort_keys=True)
    about = _add_topic(writer, FLIGHT_TOPIC, definitions.FLIGHT, latched=True)
    mode = _add_topic(writer, MODE_TOPIC, definitions.MODE, latched=True)
    writer.write(about, start_ns, _serialize(definitions.FLIGHT, text))
    connections = [_add_topic(writer, topic.name, topic.message) for topic in topics]
    before = ~records["mode"][:1].astype(np.int64)  # another one: the first is written
    for block in record_blocks(records):
        rows = [encode(topic, block) for topic in topics]
        modes, times_us = block["mode"].astype(np.int64), block["time_us"].astype(np.int64)
        changed = np.flatnonzero(np.diff(modes, prepend=before)).tolist()
        for begin, end in pairwise(sorted({0, *changed, len(block)})):
            if begin in changed:
                time_us = int(times_us[begin])
                fields = _header(time_us), int(modes[begin])
                writer.write(mode, time_us * 1000, _serialize(definitions.MODE, *fields))
            streams = [(to, encoded[begin:end]) for to, encoded in zip(connections, rows, strict=True)]
            writer.write_interleaved(times_us[begin:end] * 1000, streams)
        before = modes[-1:]


def _write_rows(writer: BagWriter, topic: Topic, blocks: Iterable[Records]) -> None:
    """Write blocks of stamped rows, one message a row."""
    connection = _add_topic(writer, topic.name, topic.message)
    for rows in blocks:
        writer.write_interleaved(rows["time_us"].astype(np.int64) * 1000, [(connection, encode(topic, rows))])


def _write_derived(
    writer: BagWriter, records: Records, scenario: Scenario | None, requirements: Iterable[Mapping[str, Any]]
) -> None:
    """Write the topics for viewers; those of events and requirements need the scenario."""
    start_us = int(records["time_us"][0])
    static = _add_topic(writer, TF_STATIC_TOPIC, definitions.TF_MESSAGE, latched=True)
    writer.write(static, start_us * 1000, static_message(start_us))
    frames, shown = _add_topic(writer, TF_TOPIC, definitions.TF_MESSAGE), tf_rows(records)
    for block in record_blocks(records[shown]):
        writer.write_interleaved(block["time_us"].astype(np.int64) * 1000, [(frames, encode_tf(block))])
    for topic in ANGLE_TOPICS:
        _write_rows(writer, topic, angle_blocks(records, scenario))
    if scenario is None:
        return
    end_us = int(records["time_us"][-1])
    events = _add_topic(writer, EVENTS_TOPIC, definitions.LOG)
    for time_us, text in event_lines(scenario, end_us):
        log = (_stamp(time_us), INFO, "scenario", text, "", "", 0)
        writer.write(events, time_us * 1000, _serialize(definitions.LOG, *log))
    judged = _add_topic(writer, REQUIREMENTS_TOPIC, definitions.REQUIREMENT)
    for result in requirements:
        time_us, row = requirement_fields(result, scenario, end_us)
        writer.write(judged, time_us * 1000, _serialize(definitions.REQUIREMENT, _header(time_us), *row))


def read_estimate_topics(path: Path) -> Records:
    """Return attitudes and winds (m,) of `ESTIMATE` that a real autopilot told, from its bag; none in any other bag."""
    payloads: dict[str, bytearray] = {topic.name: bytearray() for topic in (*ESTIMATE_TOPICS, TOLD_WIND_TOPIC)}
    for file in _files(path):
        for name, _, payload in messages(file):
            if name in payloads:
                payloads[name] += payload
    first = ESTIMATE_TOPICS[0]
    estimates = np.full(len(payloads[first.name]) // first.layout.itemsize, np.nan, dtype=ESTIMATE)
    for topic in (*ESTIMATE_TOPICS, *[TOLD_WIND_TOPIC] * bool(payloads[TOLD_WIND_TOPIC.name])):
        rows: NDArray[np.void] = np.frombuffer(payloads[topic.name], dtype=topic.layout)
        decode(topic, rows, estimates)
        estimates["time_us"] = times_us(rows)
    return estimates


def _add_topic(writer: BagWriter, topic: str, message: str, *, latched: bool = False) -> Any:
    text, digest = definition(message)
    qos = [_LATCHED] if latched else []
    return writer.add_connection(topic, message, msgdef=text, rihs01=digest, offered_qos_profiles=qos)


def _serialize(message: str, *fields: Any) -> memoryview:
    payload: memoryview = TYPES.serialize_cdr(TYPES.types[message](*fields), message)
    return payload


def _header(time_us: int) -> Any:
    return TYPES.types["std_msgs/msg/Header"](stamp=_stamp(time_us), frame_id=BASE_LINK_FRD)


def _stamp(time_us: int) -> Any:
    return TYPES.types["builtin_interfaces/msg/Time"](sec=time_us // 1_000_000, nanosec=time_us % 1_000_000 * 1000)
