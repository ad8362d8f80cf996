"""Read an ArduPilot DataFlash log, .bin, or the same as text, .log.

Each message begins with A3 95 and its type; messages FMT give name, length, number formats and columns of the types.
Damage is passed over to the next such begin. The gyro is the message of the highest rate; of nearly equal ones the one
that is filtered less. Batches of the sampler (ISBD) are not used: they are bursts, in the sensor's own axes. As text,
a line is a message: its name and its values, scaled.

References
----------
ArduPilot, `libraries/AP_Logger/README.md` and `LogStructure.h`; AP_Motors.
"""

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import open_regular
from firmware_model.config.gyro_filters import ARDUPILOT_NOTCH, ARDUPILOT_NOTCHES, MOST_ROTORS
from gustproof.logs.read.assemble import Draft, LoggedParameters, Rows, fastest
from gustproof.logs.read.flight_log import TAKEN
from gustproof.logs.read.pulses import describe_pulses, motor_commands
from gustproof.logs.read.sample_store import SampleStore, read_blocks
from gustproof.types import Array

_BEGIN = b"\xa3\x95"
_FMT, _FMT_LENGTH = 128, 89
MAGIC, TEXT_MAGIC = _BEGIN + bytes((_FMT,)), b"FMT,"
_FORMAT = np.dtype([("type", "u1"), ("length", "u1"), ("name", "S4"), ("format", "S16"), ("columns", "S64")])
_PARAMETER = re.compile(r"[A-Z][A-Z0-9_]{0,15}")
_TYPES = {
    **{
        "b": "i1",
        "B": "u1",
        "M": "u1",
        "h": "<i2",
        "H": "<u2",
        "i": "<i4",
        "I": "<u4",
        "L": "<i4",
        "q": "<i8",
        "Q": "<u8",
    },
    **{"f": "<f4", "d": "<f8", "g": "<f2", "n": "S4", "N": "S16", "Z": "S64", "a": "(32,)<i2"},
    **{"c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4"},
}
_HUNDREDTHS = "cCeE"
_DEGREE = math.pi / 180.0
_TAKEN_OFF, _ON_GROUND = 28, (11, 18)  # events NOT_LANDED; DISARMED, LAND_COMPLETE
_SCALED = str.maketrans("cCeEL", "ddddd")  # number formats whose text is scaled
_PACKED = str.maketrans({"M": "B", "n": "4s", "N": "16s", "Z": "64s", "g": "e"})
_WITHOUT_FORMAT = {"PARM": b"0,0,PARM,QNf,TimeUS,Name,Value"}
_OLD_FULL, _LARGEST_SHARE = 4500.0, 2.0
_LONGEST_LINE = 4096  # [bytes]
_OUTPUT = re.compile(r"C(?:h|han)?(\d{1,2})")


class _Source(NamedTuple):
    """Place of a signal in a log."""

    message: str
    columns: tuple[str, ...]
    scale: float = 1.0
    """SI unit of a step of its numbers."""
    is_raw: bool = False
    """True for a gyro before the autopilot's filters."""


_GYRO = ("GyrX", "GyrY", "GyrZ")
_SIGNALS = {
    "gyro": (
        _Source("GYR", _GYRO, is_raw=True),
        _Source("IMU", _GYRO),
        _Source("RATE", ("R", "P", "Y"), _DEGREE),
    ),
    "command": (_Source("RATE", ("ROut", "POut", "YOut")),),
    "accelerometer": (_Source("IMU", ("AccX", "AccY", "AccZ")),),
    # ANG has the rate of the loops from ArduCopter 4.6 on, where ATT stays at 10 Hz.
    "attitude": tuple(_Source(name, ("Roll", "Pitch", "Yaw"), _DEGREE) for name in ("ANG", "ATT")),
    "reference": tuple(_Source(name, ("DesRoll", "DesPitch", "DesYaw"), _DEGREE) for name in ("ANG", "ATT")),
    "rate_reference": (_Source("RATE", ("RDes", "PDes", "YDes"), _DEGREE),),
}
"""Sources of each signal, the best first."""
_KEPT = {source.message for sources in _SIGNALS.values() for source in sources}
_KEPT |= {"RCOU", "EV", "PARM", "ISBH", "CTUN", "RPM", "ESC", "FTN1"}
_BY_THROTTLE, _BY_RPM, _BY_ESC, _BY_SPECTRUM = range(1, 5)
"""Modes of a harmonic notch that moves."""
_MOVED_BY = {
    _BY_THROTTLE: _Source("CTUN", ("ThO",)),
    _BY_RPM: _Source("RPM", ("RPM",), 1.0 / 60.0),
    _BY_SPECTRUM: _Source("FTN1", ("PkAvg",)),
}
_NOTCH = {"ENABLE": 0.0, "MODE": 1.0, "OPTS": 0.0, "REF": 0.0}  # defaults: it moves once REF is not 0
_EACH_ROTOR = 2  # bit of its OPTS
_ROTOR = "Instance"


class _Parser:
    """State of reading: formats, messages that are kept, and damage."""

    def __init__(self) -> None:
        self.store = SampleStore()
        self.damaged = 0
        self.layouts: dict[str, tuple[np.dtype[np.void], str]] = {}
        self._lengths = {_FMT: _FMT_LENGTH}
        self._names: dict[int, str] = {}

    def consume(self, buffer: bytes, place: int) -> int:
        """Take the whole messages of a buffer, see `read_blocks`."""
        at, end, names, lengths = 0, len(buffer), self._names, self._lengths
        while at + 3 <= end:
            kind = buffer[at + 2]
            length = lengths.get(kind, 0) if buffer.startswith(_BEGIN, at) else 0
            if length == 0:
                found = buffer.find(_BEGIN, at + 1)
                self.damaged -= at
                at = found if found >= 0 else end - 1  # which may begin one
                self.damaged += at
                continue
            if at + length > end:
                break
            if kind == _FMT:
                self._on_format(buffer[at + 3 : at + length])
            elif (name := names.get(kind)) is not None:
                self.store.add(name, place + at, buffer[at + 3 : at + length])
            at += length
        return at

    def _on_format(self, message: bytes) -> None:
        row = np.frombuffer(message, dtype=_FORMAT)[0]
        kind, length = int(row["type"]), int(row["length"])
        name, letters, columns = (bytes(row[key]).decode("ascii", "replace") for key in ("name", "format", "columns"))
        if length < 3 or kind in self._lengths:
            return
        self._lengths[kind] = length
        layout = _layout(letters, columns.split(","))
        if name in _KEPT and name not in self.layouts and layout is not None and layout.itemsize == length - 3:
            self._names[kind], self.layouts[name] = name, (layout, letters)

    def message(self, name: str) -> tuple[NDArray[np.int64], NDArray[np.void]]:
        """Return places and messages of a name, of the first instance if there are many."""
        if name not in self.store:
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=[("TimeUS", "<u8")])
        places, table = self.store.table(name, self.layouts[name][0])
        if "I" in (table.dtype.names or ()):
            first = table["I"] == 0
            places, table = places[first], table[first]
        return places, table

    def rows(self, source: _Source) -> Rows | None:
        """Return the samples of a signal; `None` if they are not logged."""
        places, table = self.message(source.message)
        if len(table) == 0 or not {*source.columns} <= {*(table.dtype.names or ())}:
            return None
        values = np.column_stack([self._numbers(source.message, table, column) for column in source.columns])
        return Rows(position=places, time_us=_stamps(table), values=values * source.scale, is_raw=source.is_raw)

    def _numbers(self, name: str, table: NDArray[np.void], column: str) -> Array:
        layout, letters = self.layouts[name]
        letter = letters[(layout.names or ()).index(column)]
        if letter in "nNZa":
            raise ValueError(f"{name}.{column} is no number")
        return table[column].astype(np.float64) * (0.01 if letter in _HUNDREDTHS else 1.0)


class _TextParser(_Parser):
    """The same of a log as text."""

    def __init__(self) -> None:
        super().__init__()
        self._packers: dict[str, tuple[struct.Struct, str]] = {}
        for message in _WITHOUT_FORMAT.values():
            self._on_text_format(message)

    def consume(self, buffer: bytes, place: int) -> int:
        """Take the whole lines of a buffer, see `read_blocks`."""
        begin = 0
        while (end := buffer.find(b"\n", begin)) >= 0:
            name, _, cells = buffer[begin:end].partition(b",")
            try:
                if name == b"FMT":
                    self._on_text_format(cells)
                elif (key := name.decode("ascii", "replace").strip()) in self._packers:
                    self.store.add(key, place + begin, self._pack(key, cells))
            except (ValueError, struct.error, OverflowError):
                self.damaged += end + 1 - begin
            begin = end + 1
        if len(buffer) - begin > _LONGEST_LINE:
            raise ValueError(f"a line of it has more than {_LONGEST_LINE:,} bytes")
        return begin

    def _pack(self, name: str, cells: bytes) -> bytes:
        packer, letters = self._packers[name]
        values = [cell.strip() for cell in cells.split(b",")]
        if len(values) != len(letters):
            raise ValueError("another number of values")
        return packer.pack(*map(_value, letters, values))

    def _on_text_format(self, cells: bytes) -> None:
        _, _, name, letters, *columns = (cell.strip() for cell in cells.decode("ascii", "replace").split(","))
        scaled = letters.translate(_SCALED)
        layout = _layout(scaled, columns)
        if name in _KEPT and name not in self.store and layout is not None and "a" not in letters:
            self.layouts[name] = layout, scaled
            self._packers[name] = struct.Struct("<" + scaled.translate(_PACKED)), scaled


def _value(letter: str, cell: bytes) -> bytes | float:
    """Return the value of a cell as `struct` takes it."""
    return cell if letter in "nNZ" else float(cell) if letter in "fdg" else int(cell)


def _stamps(table: NDArray[np.void]) -> Array:
    """Return the times [us] (n,) of messages, NaN if they have none; a raw sample has its own."""
    names = table.dtype.names or ()
    for column, unit_us in (("SampleUS", 1.0), ("TimeUS", 1.0), ("TimeMS", 1000.0)):
        if column in names and table.dtype[column].kind in "iu":
            return table[column].astype(np.float64) * unit_us
    return np.full(len(table), np.nan)


def _layout(letters: str, columns: list[str]) -> np.dtype[np.void] | None:
    """Return the layout of a message by the formats and names of its columns; `None` if they are no sound ones."""
    if len(columns) != len(letters) or len({*columns, ""}) <= len(columns) or not {*letters} <= _TYPES.keys():
        return None
    return np.dtype([(column, _TYPES[letter]) for column, letter in zip(columns, letters, strict=True)])


def read_dataflash(path: Path) -> Draft:
    """Return the signals of a log, binary or text.

    Raises
    ------
    OSError
        If the file can't be read.
    ValueError
        If it holds too much.
    """
    with open_regular(path) as file:
        parser = _TextParser() if file.read(len(TEXT_MAGIC)) == TEXT_MAGIC else _Parser()
    left = read_blocks(path, parser.consume)
    parameters = _parameters(parser)
    draft = Draft(source=path.name, system="ardupilot", rows={}, parameters=parameters.values)
    is_old = _has_old_units(parser)
    draft.findings += [f"RATE: of ArduCopter before 3.4{TAKEN}centidegrees/s, with 4500 as full command"] * is_old
    for signal, sources in _SIGNALS.items():
        used = (_in_old_units(signal, source) for source in sources) if is_old else sources
        found = [rows for source in used if (rows := parser.rows(source)) is not None and rows.has_times()]
        if found:
            draft.rows[signal] = fastest(found)
    for signal in ("attitude", "reference"):
        if signal in draft.rows:
            draft.rows[signal].values[:, 2] = (
                np.remainder(draft.rows[signal].values[:, 2] + math.pi, 2.0 * math.pi) - math.pi
            )
    if (motors := _motors(parser, parameters.values)) is not None:
        draft.rows["motors"] = motors
        draft.findings += describe_pulses(parameters.values)
    draft.in_air = _in_air(parser)
    draft.notches = dict(_notches(parser, parameters.values))
    draft.findings += [*_findings(parser, left), *parameters.findings()]
    return draft


def _has_old_units(parser: _Parser) -> bool:
    """Return whether commands are integers up to 4500, as in ArduCopter before 3.4; later ones are shares of 1."""
    rows = parser.rows(_SIGNALS["command"][0])
    return rows is not None and bool(np.quantile(np.nan_to_num(np.abs(rows.values)), 0.99) > _LARGEST_SHARE)


def _in_old_units(signal: str, source: _Source) -> _Source:
    if source.message != "RATE":
        return source
    return source._replace(scale=source.scale * (1.0 / _OLD_FULL if signal == "command" else 0.01))


def _parameters(parser: _Parser) -> LoggedParameters:
    parameters = LoggedParameters()
    _, table = parser.message("PARM")
    if {"Name", "Value"} <= {*(table.dtype.names or ())} and table.dtype["Name"].kind == "S":
        for name, value in zip(table["Name"].tolist(), table["Value"].astype(np.float64).tolist(), strict=True):
            if _PARAMETER.fullmatch(text := name.decode("ascii", "replace")):
                parameters.add(text, value)
    return parameters


def _motors(parser: _Parser, parameters: dict[str, float]) -> Rows | None:
    """Return the commands 0..1 of the motors."""
    _, table = parser.message("RCOU")
    outputs = {int(match[1]): name for name in table.dtype.names or () if (match := _OUTPUT.fullmatch(name))}
    if not outputs or (rows := parser.rows(_Source("RCOU", tuple(outputs.values())))) is None:
        return None
    values = motor_commands(dict(zip(outputs, rows.values.T, strict=True)), parameters)
    return None if values is None else replace(rows, values=values)


def _notches(parser: _Parser, parameters: dict[str, float]) -> Iterator[tuple[str, Rows]]:
    """Yield where each harmonic notch moved to [Hz], by the beginning of its parameters' names.

    References
    ----------
    ArduPilot, AP_Vehicle::update_dynamic_notch of Copter 4.6.
    """
    for name in ARDUPILOT_NOTCHES:
        given = {key: parameters.get(f"{name}_{key}", usual) for key, usual in _NOTCH.items()}
        usual, reference = parameters.get(f"{name}_FREQ", ARDUPILOT_NOTCH["FREQ"]), given["REF"]
        mode, is_each = int(given["MODE"]), bool(int(given["OPTS"]) & _EACH_ROTOR)
        rows = _speeds(parser, mode) if given["ENABLE"] and reference > 0.0 else None
        if rows is not None and (mode == _BY_ESC or not is_each):
            yield name, replace(rows, values=_move(rows.values, mode, usual, reference, is_each=is_each))


def _move(values: Array, mode: int, usual: float, reference: float, *, is_each: bool) -> Array:
    """Return the places [Hz] of a notch by what moves it."""
    if is_each:
        return values
    mean = values.mean(axis=1, keepdims=True)
    if mode == _BY_THROTTLE:
        return np.asarray(usual * np.sqrt(np.maximum(mean, 0.0) / reference))
    return np.asarray(mean if mode == _BY_SPECTRUM else reference * mean)


def _speeds(parser: _Parser, mode: int) -> Rows | None:
    """Return what moves a notch; `None` if it is not logged."""
    if mode == _BY_ESC:
        return _rotors(parser)
    return parser.rows(_MOVED_BY[mode]) if mode in _MOVED_BY else None


def _rotors(parser: _Parser) -> Rows | None:
    """Return the speed [Hz] of all rotors at the times of the first; `None` if it is not logged."""
    rows = parser.rows(_Source("ESC", (_ROTOR, "RPM")))
    if rows is None or not rows.has_times():
        return None
    which, speed = rows.values[:, 0], rows.values[:, 1] / 60.0
    each = [np.flatnonzero(which == number) for number in np.unique(which)[:MOST_ROTORS]]
    columns = [np.interp(rows.position[each[0]], rows.position[own], speed[own]) for own in each]
    return replace(rows.take(which == which[each[0][0]]), values=np.column_stack(columns))


def _in_air(parser: _Parser) -> Rows | None:
    """Return the changes between ground and air; `None` if no take-off is told."""
    events = parser.rows(_Source("EV", ("Id",)))
    if events is None or not np.any(events.values == _TAKEN_OFF):
        return None
    which = np.isin(events.values[:, 0], (_TAKEN_OFF, *_ON_GROUND))
    values = (events.values[which] == _TAKEN_OFF).astype(np.float64)
    return Rows(position=events.position[which], time_us=events.time_us[which], values=values)


def _findings(parser: _Parser, left: int) -> Iterator[str]:
    if parser.damaged:
        yield f"file: {parser.damaged:,} bytes are damaged: left out"
    if left > 1:
        yield f"file: it ends within a message, {left:,} bytes of it are there"
    if "EV" in parser.store and not np.isfinite(_stamps(parser.message("EV")[1])).any():
        yield "airborne: events have no time, that of the gyro beside them in the file is taken"
    if "ISBH" in parser.store:
        yield "gyro: batches of the sampler (ISBD) are not used"
