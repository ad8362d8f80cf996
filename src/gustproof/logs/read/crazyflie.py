"""Read the binary log of the Crazyflie's uSD deck.

Header: 0xBC, version and number of event types (uint16); for each type its number, name and variables, such as
`gyro.x(f)`, with the letters of Python's struct. Records follow: event number, stamp, values. The last four bytes are
the CRC-32 of all before. All is little-endian. Only the event `fixedFrequency` is read.

The body's axes there are front, left, up; its pitch angle has the sign of ours.

References
----------
Bitcraze, crazyflie-firmware, `tools/usdlog/cfusdlog.py`, and the variables' units in `src/modules/src/stabilizer.c`.
"""

import math
import re
import struct
from array import array
from binascii import crc32
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import MIB, read_bytes
from firmware_model.config.validation import sanitize_line
from gustproof.logs.read.assemble import Draft, Rows, stack

MAGIC = b"\xbc"
_LARGEST = 64 * MIB
_EVENT = "fixedFrequency"
_STAMPS = {1: ("<u4", 1e3), 2: ("<u8", 1.0)}  # by version: type, and microseconds of a tick
_NUMBERS = {"B": "<u1", "b": "<i1", "H": "<u2", "h": "<i2", "I": "<u4", "i": "<i4", "f": "<f4", "Q": "<u8", "q": "<i8"}
_MOST = 1000  # event types, and variables of one
_DEGREE, _G, _FULL_MOTOR = math.pi / 180.0, 9.80665, 65535.0
_SIGNALS = {
    "gyro": {"gyro.x": _DEGREE, "gyro.y": -_DEGREE, "gyro.z": -_DEGREE},
    "accelerometer": {"acc.x": _G, "acc.y": -_G, "acc.z": -_G},
    "attitude": {"stateEstimate.roll": _DEGREE, "stateEstimate.pitch": _DEGREE, "stateEstimate.yaw": -_DEGREE},
    "motors": {f"motor.m{i}": 1.0 / _FULL_MOTOR for i in (1, 2, 3, 4)},
}
"""Variables of each signal, with their scale to SI units and axes front, right, down."""


def read_crazyflie(path: Path) -> Draft:
    """Return the signals of a log.

    Raises
    ------
    OSError
        If the file can't be read or is too large.
    ValueError
        If it is no such log, or damaged.
    """
    content = read_bytes(path, _LARGEST)
    if len(content) < 9 or crc32(content[:-4]) != struct.unpack("<I", content[-4:])[0]:
        raise ValueError("its checksum is wrong: it is damaged, or its end is missing")
    table, tick_us = _read_table(content)
    position, names = np.arange(len(table)), table.dtype.names or ()
    draft = Draft(source=path.name, system="crazyflie", rows={})
    for signal, variables in _SIGNALS.items():
        if set(variables) <= set(names):
            values = stack([table[name] * scale for name, scale in variables.items()])
            time_us = table["stamp"].astype(np.float64) * tick_us
            draft.rows[signal] = Rows(position=position, time_us=time_us, values=values)
    if "gyro" not in draft.rows:
        lacks = ", ".join(name for name in _SIGNALS["gyro"] if name not in names)
        raise ValueError(f"no variable {lacks} in the event {_EVENT}")
    return draft


def _read_table(content: bytes) -> tuple[NDArray[np.void], float]:
    """Return the records of the event, (n,), and the microseconds of a tick of its stamps."""
    version, count = struct.unpack_from("<HH", content, 1)
    if version not in _STAMPS or count > _MOST:
        raise ValueError(f"version {version} of the format with {count} event types; known are versions 1 and 2")
    stamp, tick_us = _STAMPS[version]
    layouts, at, wanted = dict[int, np.dtype[np.void]](), 5, -1
    for _ in range(count):
        (number,) = struct.unpack_from("<H", content, at)
        name, at = _text(content, at + 2)
        (variables,) = struct.unpack_from("<H", content, at)
        layouts[number], at = _layout(content, at + 2, variables, stamp)
        wanted = number if name == _EVENT else wanted
    if wanted < 0:
        raise ValueError(f"no event {_EVENT} in it")
    end, places = len(content) - 4, array("q")
    while at < end:
        (number,) = struct.unpack_from("<H", content, at)
        layout = layouts.get(number)
        if layout is None or at + 2 + layout.itemsize > end:
            raise ValueError(f"byte {at:,} begins no record of a known event")
        if number == wanted:
            places.append(at + 2)
        at += 2 + layout.itemsize
    layout = layouts[wanted]
    everywhere = np.ndarray((max(len(content) - layout.itemsize + 1, 0),), layout, buffer=content, strides=(1,))
    return everywhere[np.frombuffer(places, dtype=np.int64)], tick_us


def _layout(content: bytes, at: int, count: int, stamp: str) -> tuple[np.dtype[np.void], int]:
    """Return the layout of an event's record after its number, and the place after its definition."""
    if count > _MOST:
        raise ValueError(f"an event of {count} variables")
    fields = {"stamp": stamp}
    for _ in range(count):
        text, at = _text(content, at)
        match = re.fullmatch(r"(.+)\((.)\)", text)
        if match is None or match[2] not in _NUMBERS or match[1] in fields:
            raise ValueError(f"no variable with a type: {sanitize_line(text)!r}")
        fields[match[1]] = _NUMBERS[match[2]]
    return np.dtype(list(fields.items())), at


def _text(content: bytes, at: int) -> tuple[str, int]:
    """Return a text that a zero ends, and the place after it."""
    end = content.index(b"\0", at)
    return content[at:end].decode(), end + 1
