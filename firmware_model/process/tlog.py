"""MAVLink traffic of a flight as a telemetry log (.tlog), both directions, as it passed the socket.

A stamp in microseconds, eight bytes, big-endian, precedes each frame. Its two lowest bits hold the number of the peer,
as in MAVProxy's logs. Peers are numbered in order of appearance; the first three have numbers of their own. The
stamp is Unix time. In lockstep it advances with model time from t = 0, so a replay has the pace of the flight.
"""

import struct
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from firmware_model.mavlink.frames import Address, Frame, RejectReason, parse
from firmware_model.mavlink.wire import LockstepLine
from firmware_model.process.udp import Endpoint, Exchange, no_exchange
from firmware_model.recording.durable_file import AppendOnlyFile

_STAMP = struct.Struct(">Q")
_PEERS = 3  # with a number of their own; all others share the last number of two bits
_FLUSH_US = 1_000_000  # by stamps: a crash of the process loses this much at most
_V2 = b"\xfd"
_V2_FRAME = 12  # [bytes] a version 2 frame without payload and signature


class Tlog:
    """Endpoint that forwards to another one and logs the frames; as a context manager it writes the rest at exit.

    `stamp_us` converts the endpoint's wall time to Unix time [us]. A datagram without a frame is not logged, as no
    reader could find the next frame after it.
    """

    def __init__(
        self, path: Path, endpoint: Endpoint, stamp_us: Callable[[int], int], exchange: Exchange = no_exchange
    ) -> None:
        self._endpoint, self._stamp_us, self._exchange = endpoint, stamp_us, exchange
        self._file = AppendOnlyFile(path)
        self._buffer = bytearray()
        self._peer_numbers: dict[Address, int] = {}
        self._flush_at_us = 0

    @property
    def finished(self) -> bool:
        """True if there is nothing more to do."""
        return self._endpoint.finished

    def receive(self, datagram: bytes, address: Address, now_us: int) -> None:
        """Handle a datagram."""
        # Nearly every datagram is one unsigned frame of version 2.
        if datagram[:1] == _V2 and len(datagram) > 2 and len(datagram) == datagram[1] + _V2_FRAME:
            self._log(datagram, address, self._stamp_us(now_us))
        else:
            for frame in parse(datagram):
                if isinstance(frame, Frame):
                    self._log(frame.raw, address, self._stamp_us(now_us))
        self._endpoint.receive(datagram, address, now_us)

    def count_reject(self, cause: RejectReason, address: Address) -> None:
        """Count a datagram that was discarded unread."""
        self._endpoint.count_reject(cause, address)

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Perform all due actions and return the datagrams to send."""
        sent = self._endpoint.poll(now_us)
        if sent:
            stamp_us = self._stamp_us(now_us)
            for datagram, address in sent:
                self._log(datagram, address, stamp_us)
            self._flush_after(stamp_us)
        return sent

    def exchange(self, socket: int, clock: Callable[[], int]) -> LockstepLine | None:
        """Exchange frames as the endpoint does."""
        before_us = self._stamp_us(clock())
        line = self._exchange(socket, clock)
        if line is not None and line.turns:
            stamps_us = np.linspace(before_us, self._stamp_us(clock()), line.turns + 1, dtype=np.int64)
            self._log_turns(line, stamps_us)
        return line

    def deadline_us(self) -> int:
        """Return the latest time for the next call of `poll`."""
        return self._endpoint.deadline_us()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._flush()
        finally:
            self._file.close()

    def _log(self, frame: bytes, address: Address, stamp_us: int) -> None:
        self._buffer += _STAMP.pack(stamp_us & ~3 | self._number(address))
        self._buffer += frame

    def _number(self, address: Address) -> int:
        number = self._peer_numbers.get(address, _PEERS)
        if number == _PEERS and len(self._peer_numbers) < _PEERS:
            number = self._peer_numbers[address] = len(self._peer_numbers)
        return number

    def _flush_after(self, stamp_us: int) -> None:
        if stamp_us >= self._flush_at_us:
            self._flush()
            self._flush_at_us = stamp_us + _FLUSH_US

    def _log_turns(self, line: LockstepLine, stamps_us: NDArray[np.int64]) -> None:
        parts = []
        for log, wire, since in zip(line.log, (line.taken, line.given), (stamps_us[:-1], stamps_us[1:]), strict=True):
            head = (since & ~3 | self._number(line.address)).astype(">i8")
            parts += [head.view(np.uint8).reshape(-1, _STAMP.size), log[: line.turns, : wire.model.size]]
        self._buffer += np.hstack(parts).tobytes()
        self._flush_after(int(stamps_us[-1]))

    def _flush(self) -> None:
        buffer, self._buffer = self._buffer, bytearray()
        self._file.write(buffer)
