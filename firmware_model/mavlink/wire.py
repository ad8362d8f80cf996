"""Frames in kernels: wait for the one that is expected, and write the next.

MAVLink, packet serialization: version 2 frames, CRC-16/MCRF4XX, CRC_EXTRA.
"""

import socket
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.libc import ADDRESS_SIZE, Bytes, receive_datagram, send_datagram

Address = tuple[int, tuple[str, int]]
"""Number of our socket, and host and port of the other side."""
LARGEST_DATAGRAM = 65_535
"""[bytes] of UDP."""
MOST_TURNS = 1000
"""Turns of an exchange in one call at most, some 20 ms, so that heartbeats and Ctrl-C need not wait."""
NO_SOCKET = -1
"""In place of a socket: the datagram is in `LockstepLine.taken`, and the answer is left in `LockstepLine.given`."""
RECEIVED, SENT, TURNS, LEFT = range(4)
"""Places in `LockstepLine.numbers`."""
_whole: Any = np.int64  # of Python's type, to who reads types
_FAMILY_PORT_HOST = 8  # bytes of an address
_HEAD, _SEQUENCE, _CHECKSUM = 10, 4, 2  # bytes of the header, place of the sequence number, bytes of the checksum
_PADDING = 6  # before a frame, so that its payload is aligned
_STAMP, _REST, _SEED = range(3)


def _add_byte(byte: int) -> int:
    """Return the CRC-16/MCRF4XX of a byte, from 0 on."""
    low = (byte ^ byte << 4) & 0xFF
    return low << 8 ^ low << 3 ^ low >> 4


_CRC = np.array([_add_byte(byte) for byte in range(256)], dtype=np.int64)


class FrameBuffer(NamedTuple):
    """Room for one frame, and what is known of it: all but its sequence number, stamp and numbers."""

    frame: Bytes
    """(LARGEST_DATAGRAM,) the frame, or any datagram that came in its place."""
    values: NDArray[np.float32]
    """(n,) numbers after the stamp, in the frame."""
    model: Bytes
    """(size,) the frame with sequence number, stamp and numbers 0."""
    layout: NDArray[np.int64]
    """(3,) bytes of the stamp, place of the unchanging bytes after the numbers, seed of the checksum."""


def make_buffer(model: bytes, stamp: int, floats: int, rest: int, seed: int) -> FrameBuffer:
    """Return room for a frame like `model`, with `floats`; the other arguments are those of `FrameBuffer.layout`."""
    frame = np.zeros(_PADDING + LARGEST_DATAGRAM, dtype=np.uint8)[_PADDING:]
    frame[: len(model)] = np.frombuffer(model, dtype=np.uint8)
    values = frame[rest - 4 * floats : rest].view(np.float32)
    return FrameBuffer(frame, values, frame[: len(model)].copy(), np.array([stamp, rest, seed]))


class LockstepLine(NamedTuple):
    """One side of an exchange of frames with a peer, each answered by one."""

    taken: FrameBuffer
    """Frames of the peer."""
    given: FrameBuffer
    """Frames of this side."""
    peer: Bytes
    """(ADDRESS_SIZE,) address of the peer."""
    sender: Bytes
    """(ADDRESS_SIZE + 4,) address that the last datagram came from, and its length."""
    numbers: NDArray[np.int64]
    """(4,) sequence numbers that come next, received and sent; turns of a call; size left over, or below 0."""
    log: Bytes
    """(2, MOST_TURNS, n) frames taken and given in each turn, each at the start of its row."""

    def begin(self, received: int, sent: int) -> None:
        """Set the sequence numbers that come next."""
        self.numbers[:] = received, sent, 0, -1

    def put(self, datagram: bytes) -> bool:
        """Put a datagram in the place of one that comes; return false, and do not, if its size is not the expected."""
        if len(datagram) != self.taken.model.size:
            return False
        self.taken.frame[: len(datagram)] = np.frombuffer(datagram, dtype=np.uint8)
        return True

    @property
    def left(self) -> tuple[bytes, tuple[str, int]] | None:
        """Datagram that a call has left, with host and port that it came from; `None` if it left none."""
        if (size := int(self.numbers[LEFT])) < 0:
            return None
        return self.taken.frame[:size].tobytes(), _unpack_address(self.sender)

    @property
    def address(self) -> Address:
        """Address of the peer, on the only socket."""
        return 0, _unpack_address(self.peer)

    @property
    def answer(self) -> bytes:
        """The last frame that was made."""
        return self.given.frame[: self.given.model.size].tobytes()

    @property
    def turns(self) -> int:
        """Turns of the last call."""
        return int(self.numbers[TURNS])


def make_line(taken: FrameBuffer, given: FrameBuffer, peer: tuple[str, int]) -> LockstepLine:
    """Return a line to a peer at host and port; to a host that is no IPv4 address, it is of use without a socket."""
    try:
        host = socket.inet_aton(peer[0])
    except OSError:
        host = bytes(4)
    address = struct.pack("=H", socket.AF_INET) + struct.pack("!H4s8x", peer[1], host)
    log = np.zeros((2, MOST_TURNS, max(taken.model.size, given.model.size)), dtype=np.uint8)
    sender, numbers = np.zeros(ADDRESS_SIZE + 4, dtype=np.uint8), np.zeros(4, dtype=np.int64)
    return LockstepLine(taken, given, np.frombuffer(address, dtype=np.uint8).copy(), sender, numbers, log)


def _unpack_address(address: Bytes) -> tuple[str, int]:
    """Return host and port of a `sockaddr_in`."""
    port, host = struct.unpack_from("!H4s", address.tobytes(), 2)
    return socket.inet_ntoa(host), port


@kernel
def take_frame(socket: int, line: LockstepLine) -> bool:
    """Wait for a datagram, unless it is there; return whether it is the frame that is expected of the peer."""
    numbers = line.numbers
    numbers[LEFT] = line.taken.model.size
    if socket != NO_SOCKET:
        numbers[LEFT] = receive_datagram(socket, line.taken.frame, line.sender)
        for i in range(_FAMILY_PORT_HOST):
            if line.sender[i] != line.peer[i]:
                return False
    return is_expected(line.taken, numbers[LEFT], numbers[RECEIVED])


@kernel
def give_frame(socket: int, line: LockstepLine, turn: int, stamp: int) -> None:
    """End a turn: finish the frame whose numbers stand in `line.given`, send it, and keep both frames for the log."""
    numbers, taken, given = line.numbers, line.taken, line.given
    finish_frame(given, numbers[SENT], stamp)
    if socket != NO_SOCKET:
        send_datagram(socket, given.frame, given.model.size, line.peer)
    for i in range(taken.model.size):
        line.log[0, turn, i] = taken.frame[i]
    for i in range(given.model.size):
        line.log[1, turn, i] = given.frame[i]
    numbers[RECEIVED], numbers[SENT] = numbers[RECEIVED] + 1 & 0xFF, numbers[SENT] + 1 & 0xFF
    numbers[LEFT], numbers[TURNS] = -1, turn + 1


@kernel
def move_frame(given: FrameBuffer, taken: FrameBuffer) -> None:
    """Carry a frame from one side to the other."""
    for i in range(given.model.size):
        taken.frame[i] = given.frame[i]


@kernel
def is_expected(wire: FrameBuffer, size: int, sequence: int) -> bool:
    """Return whether a datagram of `size` bytes in `wire` is a sound frame of its kind with that sequence number."""
    frame, model, rest = wire.frame, wire.model, wire.layout[_REST]
    end = model.size - _CHECKSUM
    if size != model.size or frame[_SEQUENCE] != sequence:
        return False
    for i in range(_HEAD):
        if frame[i] != model[i] and i != _SEQUENCE:
            return False
    for i in range(rest, end):
        if frame[i] != model[i]:
            return False
    return bool(_checksum(wire, end) == _whole(frame[end]) | _whole(frame[end + 1]) << 8)


@kernel
def read_stamp(wire: FrameBuffer) -> int:
    """Return the stamp of the frame, in its own unit."""
    stamp = _whole(0)
    for i in range(wire.layout[_STAMP]):
        stamp |= _whole(wire.frame[_HEAD + i]) << 8 * i
    return int(stamp)


@kernel
def finish_frame(wire: FrameBuffer, sequence: int, stamp: int) -> None:
    """Write sequence number, stamp and checksum of the frame whose numbers stand in `wire.values`."""
    frame, end = wire.frame, wire.model.size - _CHECKSUM
    frame[_SEQUENCE] = sequence
    for i in range(wire.layout[_STAMP]):
        frame[_HEAD + i] = stamp >> 8 * i & 0xFF
    checksum = _checksum(wire, end)
    frame[end], frame[end + 1] = checksum & 0xFF, checksum >> 8


@kernel
def _checksum(wire: FrameBuffer, end: int) -> int:
    crc = _whole(0xFFFF)
    for i in range(1, end):
        crc = crc >> 8 ^ _CRC[(crc ^ wire.frame[i]) & 0xFF]
    return int(crc >> 8 ^ _CRC[(crc ^ wire.layout[_SEED]) & 0xFF])
