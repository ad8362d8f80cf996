"""Read a PX4 log, ULog.

A message has a size (uint16) and a kind, a letter. F names the fields of a topic, A gives a topic a number, and D is a
sample of a number. P is a parameter, O a drop-out of the logger. Damage is passed over to the next sync marker, or to a
sample of a number that is known.

The gyro is the topic of the highest rate; of nearly equal ones the one that is filtered less. `sensor_combined` is a
mean over its interval, so its stamps are put in the middle. A command has the stamp of its message.

Loops run at the rate of the gyro, at most at IMU_GYRO_RATEMAX. PX4 measures that rate. If it is less, as in PX4's own
simulator and of some gyros, the parameter is told as what it came to.

References
----------
PX4, *ULog File Format*, https://docs.px4.io/main/en/dev_log/ulog_file_format.html
"""

import re
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.gyro_filters import MOST_ROTORS, PX4_BY_ROTORS
from gustproof.logs.read.assemble import Draft, LoggedParameters, Rows, euler_angles, fastest
from gustproof.logs.read.pulses import describe_outputs, output_commands
from gustproof.logs.read.sample_store import SampleStore, read_blocks
from gustproof.types import Array

MAGIC = b"ULog\x01\x12\x35"
_SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_HEADER = 16  # [bytes]
_DATA = ord("D")
_TYPES = {
    **{f"int{bits}_t": f"<i{bits // 8}" for bits in (8, 16, 32, 64)},
    **{f"uint{bits}_t": f"<u{bits // 8}" for bits in (8, 16, 32, 64)},
    **{"float": "<f4", "double": "<f8", "bool": "u1", "char": "u1"},
}
_FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")
_SAMPLE, _MESSAGE = "timestamp_sample", "timestamp"
_NESTED = ("esc_report",)  # topics within others that are used
_MOST_RAW = 4_000_000  # samples of the gyro: eight minutes at 8 kHz; of longer logs the other topics are used
_LONGEST = 64  # numbers of a field


class _Field(NamedTuple):
    """A field of a topic."""

    type: str
    length: int
    offset: int

    @property
    def end(self) -> int:
        """[bytes] offset of what follows."""
        return self.offset + self.length * np.dtype(self.type).itemsize


def _repeat(name: str, fields: Mapping[str, _Field], count: int) -> dict[str, _Field]:
    """Return the fields of a topic that stands `count` times within another, under a `name`."""
    size = max((each.end for each in fields.values()), default=0)
    return {
        f"{name}[{i}].{key}": each._replace(offset=i * size + each.offset)
        for i in range(count)
        for key, each in fields.items()
    }


class _Parser:
    """State of reading: topics, samples that are kept, parameters, and damage."""

    def __init__(self, topics: Iterable[str]) -> None:
        self.store = SampleStore()
        self.parameters = LoggedParameters()
        self.damaged = self.dropouts = self.dropped_ms = 0
        self._topics = frozenset(topics)
        self._formats: dict[str, str] = {}
        self._numbers: dict[int, str] = {}
        self._lengths: dict[str, int] = {}
        self._subscribed = set[bytes]()  # numbers of all topics, as they stand in the file
        self._sizes: dict[bytes, bytes] = {}  # of their samples
        self._messages: dict[int, Callable[[bytes], None]] = {
            ord("A"): self._on_topic,
            ord("B"): self._on_flags,
            ord("F"): self._on_format,
            ord("O"): self._on_dropout,
            ord("P"): self._on_parameter,
        }

    def consume(self, buffer: bytes, place: int) -> int:
        """Take the whole messages of a buffer, see `read_blocks`."""
        at, end = 0 if place else _HEADER, len(buffer)
        while at + 3 <= end:
            size, kind = buffer[at] | buffer[at + 1] << 8, buffer[at + 2]
            if size == 0 or not 65 <= kind <= 90 or not self._is_usual(buffer, at):  # no letter
                self.damaged -= at
                at = self._resume(buffer, at + 1)
                self.damaged += at
                continue
            after = at + 3 + size
            if after > end:
                break
            if kind == _DATA:
                self._on_data(buffer, at + 3, after, place)
            elif (handle := self._messages.get(kind)) is not None:
                handle(buffer[at + 3 : after])
            at = after
        return min(at, end)

    def _is_usual(self, buffer: bytes, at: int) -> bool:
        """Return False for a sample whose size is not that of its number."""
        if buffer[at + 2] != _DATA or at + 5 > len(buffer):
            return True
        number = buffer[at + 3 : at + 5]
        return (
            number not in self._subscribed or self._sizes.setdefault(number, buffer[at : at + 2]) == buffer[at : at + 2]
        )

    def _resume(self, buffer: bytes, at: int) -> int:
        """Return the place of the next sync marker, or of a known sample before another message."""
        begins = [re.escape(size + b"D" + number) for number, size in self._sizes.items()]
        for match in re.compile(b"|".join([re.escape(_SYNC), *begins])).finditer(buffer, at):
            place = match.start()
            if match[0] == _SYNC:
                return max(at, place - 3)
            after = place + 3 + (buffer[place] | buffer[place + 1] << 8)
            if after + 5 > len(buffer) or (65 <= buffer[after + 2] <= 90 and self._is_usual(buffer, after)):
                return place
        return max(at, len(buffer) - len(_SYNC) - 3)

    def _on_data(self, buffer: bytes, begin: int, end: int, place: int) -> None:
        topic = self._numbers.get(buffer[begin] | buffer[begin + 1] << 8) if end - begin > 2 else None
        if topic is None:
            return
        if self._lengths.setdefault(topic, end - begin - 2) != end - begin - 2:
            self.damaged += end - begin
            return
        self.store.add(topic, place + begin, buffer[begin + 2 : end])

    def _on_topic(self, message: bytes) -> None:
        instance, number = struct.unpack_from("<BH", message)
        self._subscribed.add(message[1:3])
        topic = message[3:].decode(errors="replace")
        if instance == 0 and topic in self._topics and topic not in self._numbers.values():
            self._numbers[number] = topic

    def _on_format(self, message: bytes) -> None:
        topic, _, text = message.decode(errors="replace").partition(":")
        if topic in self._topics:
            self._formats.setdefault(topic, text)

    def _on_parameter(self, message: bytes) -> None:
        kind, _, name = message[1 : 1 + message[0]].decode(errors="replace").partition(" ")
        value = message[1 + message[0] :]
        if kind in ("float", "int32_t") and len(value) == 4 and name.isidentifier():
            self.parameters.add(name, float(struct.unpack("<f" if kind == "float" else "<i", value)[0]))

    def _on_dropout(self, message: bytes) -> None:
        self.dropouts += 1
        self.dropped_ms += struct.unpack_from("<H", message)[0]

    def _on_flags(self, message: bytes) -> None:
        incompatible = message[8:16]
        if any(incompatible[1:]) or incompatible[:1] > b"\x01":
            raise ValueError("a ULog with features that are not known here")

    def _fields(self, topic: str) -> dict[str, _Field]:
        """Return the fields of a topic up to one that is not known; of nested ones each, `esc[3].esc_rpm`."""
        fields, offset = dict[str, _Field](), 0
        for item in self._formats.get(topic, "").split(";"):
            if (match := _FIELD.fullmatch(item)) is None:
                break
            kind, count, name = match[1], int(match[2] or 1), match[3]
            if kind in _TYPES:
                parts = {name: _Field(_TYPES[kind], count, 0)}
            else:
                is_within = topic in _NESTED or kind not in _NESTED
                parts = {} if is_within else _repeat(name, self._fields(kind), min(count, _LONGEST))
            if not parts:  # a topic within that is not used, or not told: what is behind it has no place
                break
            fields |= {key: each._replace(offset=offset + each.offset) for key, each in parts.items()}
            offset += max(each.end for each in parts.values())
        return fields

    def topic(self, name: str, fields: Iterable[str]) -> tuple[NDArray[np.int64], NDArray[np.void]] | None:
        """Return places and samples of a topic, with these fields and its stamps.

        `None` if they are not logged, or have absurdly many numbers.
        """
        known = self._fields(name)
        wanted = [field for field in (_MESSAGE, _SAMPLE) if field in known] + list(fields)
        has_stamps = _MESSAGE in known and known[_MESSAGE].type == _TYPES["uint64_t"]
        if name not in self.store or not has_stamps or not known.keys() >= {*fields}:
            return None
        if any(known[field].length > _LONGEST or known[field].end > self._lengths[name] for field in wanted):
            return None
        layout: Any = {
            "names": wanted,
            "formats": [(known[field].type, (known[field].length,)) for field in wanted],
            "offsets": [known[field].offset for field in wanted],
            "itemsize": self._lengths[name],
        }
        return self.store.table(name, np.dtype(layout))


class _Source(NamedTuple):
    """Place of a signal in a log."""

    topic: str
    fields: tuple[str, ...]
    convert: Callable[[Array], Array] = lambda numbers: numbers
    """Values of the signal, of the numbers of all fields."""
    stamp: str = _SAMPLE
    """Field of its time, if it is logged and not 0; else `timestamp`."""
    is_raw: bool = False
    """True for a gyro before the autopilot's filters."""

    def rows(self, parser: _Parser) -> Rows | None:
        """Return the samples of the signal; `None` if they are not logged."""
        if (found := parser.topic(self.topic, self.fields)) is None:
            return None
        places, table = found
        numbers = np.concatenate([table[field] for field in self.fields], axis=1).astype(np.float64)
        values = self.convert(numbers)
        return Rows(position=places, time_us=_stamps(table, self.stamp), values=values, is_raw=self.is_raw)


def _stamps(table: NDArray[np.void], field: str) -> Array:
    """Return the times [us] (n,) of samples by a field, or by `timestamp` where it is absent or 0."""
    stamps = table[_MESSAGE][:, 0].astype(np.float64)
    if field in (table.dtype.names or ()):
        stamped = table[field][:, 0].astype(np.float64)
        stamps = np.where(stamped > 0.0, stamped, stamps)
    return stamps


def _first_three(numbers: Array) -> Array:
    return numbers[:, :3]


def _motors(control: Array) -> Array:
    """Return the commands 0..1 of the motors in use; NaN is a motor that is off."""
    return np.nan_to_num(control[:, ~np.isnan(control).all(axis=0)])


_GYRO_FIFO = ("dt", "scale", "samples", "x", "y", "z")
_SIGNALS = {
    "gyro": (
        _Source("sensor_combined", ("gyro_rad",), is_raw=True),
        _Source("vehicle_angular_velocity", ("xyz",)),
        _Source("sensor_gyro", ("x", "y", "z"), is_raw=True),
    ),
    "command": (
        _Source("vehicle_torque_setpoint", ("xyz",), stamp=_MESSAGE),
        _Source("actuator_controls_0", ("control",), _first_three, stamp=_MESSAGE),
    ),
    "motors": (
        _Source("actuator_motors", ("control",), _motors, stamp=_MESSAGE),
        _Source("actuator_outputs", ("output",), lambda outputs: output_commands(outputs[:, :4]), stamp=_MESSAGE),
    ),
    "accelerometer": (
        _Source("sensor_combined", ("accelerometer_m_s2",)),
        _Source("vehicle_acceleration", ("xyz",)),
    ),
    "attitude": (_Source("vehicle_attitude", ("q",), euler_angles),),
    "reference": (_Source("vehicle_attitude_setpoint", ("q_d",), euler_angles, stamp=_MESSAGE),),
    "rate_reference": (_Source("vehicle_rates_setpoint", ("roll", "pitch", "yaw"), stamp=_MESSAGE),),
}
"""Sources of each signal, the best first."""
_ROTORS, _SPEED = "esc_status", "esc[{}].esc_rpm"
_LANDED = _Source("vehicle_land_detected", ("landed",), lambda landed: 1.0 - landed)
_GYRO_RATE, _GYRO_IN_USE = ("vehicle_imu_status", "gyro_rate_hz"), ("sensor_selection", "gyro_device_id")
_RATE_LIMIT = "IMU_GYRO_RATEMAX"
_SLOWER = 0.95  # of the limit, below which the gyro is the slower one
_TOPICS = {source.topic for sources in _SIGNALS.values() for source in sources}
_TOPICS |= {_LANDED.topic, "sensor_gyro_fifo", _GYRO_RATE[0], _GYRO_IN_USE[0], _ROTORS, *_NESTED}


def read_ulog(path: Path) -> Draft:
    """Return the signals of a log.

    Raises
    ------
    OSError
        If the file can't be read.
    ValueError
        If it holds too much, or features of a later format.
    """
    parser = _Parser(_TOPICS)
    left = read_blocks(path, parser.consume)
    draft = Draft(
        source=path.name, system="px4", rows={}, in_air=_LANDED.rows(parser), parameters=parser.parameters.values
    )
    for signal, sources in _SIGNALS.items():
        found = [rows for source in sources if (rows := source.rows(parser)) is not None]
        if signal == "gyro":
            found = [*_fifo(parser), *_centre_gyro(parser, found)]
        if found:
            draft.rows[signal] = fastest(found) if signal == "gyro" else found[0]
    if "motors" in draft.rows and (outputs := _outputs(parser)) is not None:
        draft.findings.append(describe_outputs(outputs))
    if (rotors := _rotors(parser)) is not None:
        draft.notches = {"IMU_GYRO_DNF": rotors}
    draft.findings += [*_findings(parser, left), *_correct_rate(parser)]
    return draft


def read_topics(
    path: Path, topics: Mapping[str, Iterable[str]]
) -> tuple[dict[str, NDArray[np.void]], dict[str, float]]:
    """Return fields of topics with their stamps, as far as they are logged, and all parameters.

    Raises
    ------
    OSError
        If the file can't be read.
    ValueError
        If it holds too much, or features of a later format.
    """
    parser = _Parser(topics)
    read_blocks(path, parser.consume)
    tables = {name: parser.topic(name, fields) for name, fields in topics.items()}
    return {name: table[1] for name, table in tables.items() if table is not None}, parser.parameters.values


def _centre_gyro(parser: _Parser, found: list[Rows]) -> list[Rows]:
    """Return the sources of the gyro, with the means of `sensor_combined` at the middle of their intervals."""
    table = parser.topic("sensor_combined", ("gyro_rad", "gyro_integral_dt"))
    if table is None:
        return found
    combined, *others = found
    middle = combined.time_us - 0.5 * table[1]["gyro_integral_dt"][:, 0]
    return [replace(combined, time_us=middle), *others]


def _fifo(parser: _Parser) -> Iterator[Rows]:
    """Yield the raw samples of the gyro, if they are logged: many a message, `dt` [us] apart, the last at its stamp."""
    if (found := parser.topic("sensor_gyro_fifo", _GYRO_FIFO)) is None:
        return
    places, table = found
    most = table["x"].shape[1]
    if table["x"].size > _MOST_RAW or not table["x"].shape == table["y"].shape == table["z"].shape:
        return
    count = np.minimum(table["samples"][:, 0].astype(np.int64), most)
    taken = np.arange(most) < count[:, np.newaxis]
    age = (count[:, np.newaxis] - 1 - np.arange(most)) * table["dt"].astype(np.float64)
    values = np.stack([table[axis] * table["scale"].astype(np.float64) for axis in "xyz"], axis=-1)
    time_us = _stamps(table, _SAMPLE)[:, np.newaxis] - age
    yield Rows(position=np.repeat(places, count), time_us=time_us[taken], values=values[taken], is_raw=True)


def _outputs(parser: _Parser) -> Array | None:
    """Return the outputs (n, 4) that tell the motors' commands; `None` if these are logged themselves."""
    own, outputs = (parser.topic(source.topic, source.fields) for source in _SIGNALS["motors"])
    return None if own is not None or outputs is None else outputs[1]["output"][:, :4].astype(np.float64)


def _rotors(parser: _Parser) -> Rows | None:
    """Return the speeds [Hz] of the rotors, which notches follow; `None` if they do not, or none are told."""
    if not int(parser.parameters.values.get("IMU_GYRO_DNF_EN", 0.0)) & PX4_BY_ROTORS:
        return None
    found = _Source(_ROTORS, tuple(_SPEED.format(i) for i in range(MOST_ROTORS)), stamp=_MESSAGE).rows(parser)
    turns = found is not None and (found.values != 0.0).any(axis=0)
    return replace(found, values=np.abs(found.values[:, turns]) / 60.0) if found is not None and np.any(turns) else None


def _correct_rate(parser: _Parser) -> Iterator[str]:
    """Set the limit of the loops' rate to that of a slower gyro, the one in use, and yield a line on it."""
    limit, device = parser.parameters.values.get(_RATE_LIMIT), _GYRO_IN_USE[1]
    status = parser.topic(_GYRO_RATE[0], (device, _GYRO_RATE[1]))
    used = parser.topic(_GYRO_IN_USE[0], (device,))
    if limit is None or status is None or (used and used[1][device][-1, 0] != status[1][device][-1, 0]):
        return
    rate = float(np.median(status[1][_GYRO_RATE[1]]))
    if 0.0 < rate < (_SLOWER * limit or np.inf):
        parser.parameters.values[_RATE_LIMIT] = float(round(rate))
        yield f"{_RATE_LIMIT}: {limit:g} is set, but the gyro has {rate:.0f} Hz, and so have the loops"


def _findings(parser: _Parser, left: int) -> Iterator[str]:
    if parser.damaged:
        yield f"file: {parser.damaged:,} bytes are damaged: left out"
    if left:
        yield f"file: it ends within a message, {left:,} bytes of it are there"
    if parser.dropouts:
        yield f"logger: {parser.dropouts} drop-outs, {1e-3 * parser.dropped_ms:.3g} s in all"
    yield from parser.parameters.findings()
