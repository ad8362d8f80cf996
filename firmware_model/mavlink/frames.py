"""MAVLink framing: parse datagrams into checked frames, pack messages into datagrams.

pymavlink's own stream parser loses the datagram after a truncated frame, and takes 10 us where this one takes 2.
Layout, checksum seed and names of each message come from pymavlink's dialect module.

References
----------
MAVLink, packet serialization: version 2 frames, version 1 frames, payload truncation, CRC_EXTRA, message signing.
"""

import re
import struct
from functools import cache
from hashlib import sha256
from inspect import signature as parameters_of
from typing import Any, NamedTuple

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.reasons import RejectReason as RejectReason
from firmware_model.mavlink.wire import Address as Address
from firmware_model.mavlink.wire import FrameBuffer, make_buffer

Message = Any
"""A message of pymavlink's dialect module, which has no type stubs."""

_V2, _V1 = wire.PROTOCOL_MARKER_V2, wire.PROTOCOL_MARKER_V1
_SIGNED, _SIGNATURE = wire.MAVLINK_IFLAG_SIGNED, wire.MAVLINK_SIGNATURE_BLOCK_LEN
_SIGNATURE_HEAD = 7  # bytes of the signature block before the signature itself: link id, time stamp
_V2_HEADER = struct.Struct("<BBBBBBBHB")  # marker, length, two flag bytes, sequence, system, component, id in 3 bytes
_MESSAGE_FORMATS = {
    message_id: (bytes([kind.crc_extra]), kind.unpacker.size) for message_id, kind in wire.mavlink_map.items()
}
_BYTES = {"char": 1, "uint8_t": 1, "int8_t": 1, "uint16_t": 2, "int16_t": 2, "uint32_t": 4, "int32_t": 4, "float": 4}
_decoder = wire.MAVLink(None)


DAMAGE_REASONS = (
    RejectReason.NOT_MAVLINK,
    RejectReason.TRUNCATED,
    RejectReason.INCOMPATIBLE,
    RejectReason.BAD_CHECKSUM,
    RejectReason.UNKNOWN_MESSAGE,
)
"""Reasons for a datagram without a readable frame."""


class Frame(NamedTuple):
    """MAVLink frame whose length, checksum and message id were checked."""

    message_id: int
    """Message id."""
    system: int
    """Sender's system id."""
    component: int
    """Sender's component id."""
    payload: bytes
    """Fields in wire order, zero-padded to the message's full length."""
    raw: bytes
    """The whole frame."""

    @property
    def sequence(self) -> int:
        """Sequence number, 0..255."""
        return self.raw[4] if self.raw[0] == _V2 else self.raw[2]

    @property
    def is_version_1(self) -> bool:
        """True for a frame of MAVLink 1."""
        return bool(self.raw[0] == _V1)

    @property
    def is_signed(self) -> bool:
        """True if a signature block ends the frame."""
        return self.raw[0] == _V2 and bool(self.raw[2] & _SIGNED)

    def message(self) -> Message:
        """Return the frame as a pymavlink message, with fields by name."""
        return _decoder.decode(bytearray(self.raw))


class EncodedMessage(NamedTuple):
    """A message with its payload already packed; used like a pymavlink message, but faster."""

    message_id: int
    """Message id."""
    payload: bytes
    """Fields in wire order."""

    @property
    def size(self) -> int:
        """[bytes] Length of the unsigned frame."""
        return len(self.payload.rstrip(b"\0") or b"\0") + 12

    def pack(self, packer: Any) -> bytes:
        """Return the version 2 frame, with sender, sequence number and key of `packer`, a `wire.MAVLink`."""
        number, payload = self
        payload = payload.rstrip(b"\0") or b"\0"
        signing = packer.signing
        flags = _SIGNED if signing.sign_outgoing else 0
        sender = packer.srcSystem, packer.srcComponent
        header = _V2_HEADER.pack(_V2, len(payload), flags, 0, packer.seq, *sender, number & 0xFFFF, number >> 16)
        frame = header + payload
        frame += mcrf4xx(frame[1:] + _MESSAGE_FORMATS[number][0]).to_bytes(2, "little")
        if flags:
            frame += struct.pack("<BQ", signing.link_id, signing.timestamp)[:_SIGNATURE_HEAD]
            frame += signature(signing.secret_key, frame)
        return frame


class FrameTemplate:
    """Frames of one message from one sender in which only the first fields change; packed in one step.

    Frames are of version 2, unsigned, and equal those of `EncodedMessage` byte for byte.
    `layout` is the struct format of the changing fields, a stamp and floats; `rest` is the payload after them, without
    trailing zeros.
    """

    def __init__(self, message_id: int, system: int, component: int, layout: str, rest: bytes) -> None:
        self._message_id, self._fields = message_id, struct.Struct(layout)
        self._seed = _MESSAGE_FORMATS[message_id][0]
        self._rest, self._rest_at = rest, 10 + self._fields.size
        length = self._fields.size + len(rest)
        self._heads = tuple(
            _V2_HEADER.pack(_V2, length, 0, 0, number, system, component, message_id & 0xFFFF, message_id >> 16)
            for number in range(256)
        )

    @property
    def size(self) -> int:
        """[bytes] of a frame."""
        return self._rest_at + len(self._rest) + 2

    def make(self, sequence: int, *fields: float) -> bytes:
        """Return the frame with the given sequence number."""
        frame = self._heads[sequence] + self._fields.pack(*fields) + self._rest
        return frame + mcrf4xx(frame[1:] + self._seed).to_bytes(2, "little")

    def encode(self, *fields: float) -> EncodedMessage:
        """Return the message without frame."""
        return EncodedMessage(self._message_id, self._fields.pack(*fields) + self._rest)

    def buffer(self) -> FrameBuffer:
        """Return room for one frame, which kernels read and write; see `firmware_model.mavlink.wire`."""
        floats = int(re.findall(r"\d+", self._fields.format)[-1])
        stamp = 8 if "Q" in self._fields.format else 4
        return make_buffer(self.make(0, *[0] * (1 + floats)), stamp, floats, self._rest_at, self._seed[0])


def to_version_1(frame: bytes) -> bytes:
    """Return an unsigned frame of version 2 as one of version 1; empty if that has no such message.

    Version 1 has message ids to 255, no fields that were appended to a message later, and no payload cut short.
    """
    _, _, _, _, sequence, system, component, low, high = _V2_HEADER.unpack_from(frame)
    number = low | high << 16
    if number > 255:
        return b""
    length = _version_1_length(number)
    content = bytes((length, sequence, system, component, number)) + frame[10:-2].ljust(length, b"\0")[:length]
    return bytes((_V1,)) + content + mcrf4xx(content + _MESSAGE_FORMATS[number][0]).to_bytes(2, "little")


@cache
def _version_1_length(number: int) -> int:
    """Return the length of a message's payload without appended fields: pymavlink gives those a default value."""
    kind = wire.mavlink_map[number]
    given = parameters_of(kind.__init__).parameters
    sizes = zip(kind.fieldnames, kind.fieldtypes, (kind.array_lengths[order] for order in kind.orders), strict=True)
    return sum(
        _BYTES.get(size, 8) * max(count, 1) for name, size, count in sizes if given[name].default is given[name].empty
    )


def signature(key: bytes, frame: bytes) -> bytes:
    """Return the signature of a frame that ends with link id and time stamp: the first 48 bits of a SHA-256."""
    return sha256(key + frame).digest()[: _SIGNATURE - _SIGNATURE_HEAD]


def parse(datagram: bytes) -> list[Frame | RejectReason]:
    """Return the frames in a datagram, and a reason in place of each unreadable one; never raise.

    The rest of the datagram after a truncated frame is skipped.
    """
    start, end = 0, len(datagram)
    # The usual datagram is one unsigned frame of version 2.
    if end > 11 and datagram[0] == _V2 and datagram[1] + 12 == end and not datagram[2]:
        return [_check_frame(datagram)]
    found: list[Frame | RejectReason] = []
    while start < end:
        length = _frame_length(datagram, start, end - start)
        if isinstance(length, RejectReason):
            found.append(length)
            break
        found.append(_check_frame(datagram if length == end else datagram[start : start + length]))
        start += length
    return found


def split_stream(stream: bytearray) -> list[bytes]:
    """Remove the complete frames from the front of a byte stream and return them, without bytes that are in no frame.

    An unknown message can't be checked: it is returned as it is. After a damaged frame the search goes on in it.
    """
    frames: list[bytes] = []
    start, end = 0, len(stream)
    while start < end:
        length = _frame_length(stream, start, end - start)
        if length is RejectReason.TRUNCATED:
            break
        if isinstance(length, RejectReason):
            start += 1
            continue
        frame = bytes(stream[start : start + length])
        if _check_frame(frame) is RejectReason.BAD_CHECKSUM:
            start += 1
            continue
        frames.append(frame)
        start += length
    del stream[:start]
    return frames


def _frame_length(datagram: bytes | bytearray, start: int, left: int) -> int | RejectReason:
    marker = datagram[start]
    if marker != _V2 and marker != _V1:
        return RejectReason.NOT_MAVLINK
    if left < 3:
        return RejectReason.TRUNCATED
    length = datagram[start + 1] + 8
    if marker == _V2:
        length += 4 + _SIGNATURE if datagram[start + 2] & _SIGNED else 4
    return length if length <= left else RejectReason.TRUNCATED


def _check_frame(frame: bytes) -> Frame | RejectReason:
    if frame[0] == _V2:
        _, length, flags, _, _, system, component, low, high = _V2_HEADER.unpack_from(frame)
        number, header = low | high << 16, 10
        if flags & ~_SIGNED:
            return RejectReason.INCOMPATIBLE
    else:
        _, length, _, system, component, number = frame[:6]
        header = 6
    kind = _MESSAGE_FORMATS.get(number)
    if kind is None:
        return RejectReason.UNKNOWN_MESSAGE
    seed, full = kind
    end = header + length
    if mcrf4xx(frame[1:end] + seed) != frame[end] | frame[end + 1] << 8:
        return RejectReason.BAD_CHECKSUM
    payload = frame[header:end]
    if length != full:
        # Senders cut trailing zeros; fields that a newer dialect appends are ignored.
        payload = payload.ljust(full, b"\0")[:full]
    return Frame(number, system, component, payload, frame)
