"""The MAVLink traffic of a flight as a telemetry log (.tlog), both directions, as it passed the socket.

Each frame follows the microseconds of its stamp, eight bytes, big-endian. The two lowest bits are not time but the
number of the peer, in the order in which they came up, as MAVProxy writes them: up to three are told apart. The stamp
is Unix time; in lockstep it goes on from t = 0 as model time does, so that a replay has the pace of the flight.
"""

import struct
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from firmware_model.mavlink.frames import Address, Frame, RejectReason, parse
from firmware_model.process.udp import Endpoint
from firmware_model.recording.durable_file import AppendOnlyFile

_STAMP = struct.Struct(">Q")
_PEERS = 3  # that have a number of their own; all others share the fourth, the last that two bits hold
_FLUSH_US = 1_000_000  # stamps: what a crash of the process can lose
_V2 = b"\xfd"
_V2_FRAME = 12  # [bytes] a version 2 frame without payload and signature


class Tlog:
    """An endpoint that passes everything on to another one, and logs it; a context manager that writes the rest.

    `stamp_us` makes Unix time [us] of the wall time that the endpoint is told. A datagram that holds no frame is not
    logged: no reader could tell where the next one begins.
    """

    def __init__(self, path: Path, endpoint: Endpoint, stamp_us: Callable[[int], int]) -> None:
        self._endpoint, self._stamp_us = endpoint, stamp_us
        self._file = AppendOnlyFile(path)
        self._buffer = bytearray()
        self._numbers: dict[Address, int] = {}
        self._flush_at_us = 0

    @property
    def finished(self) -> bool:
        """Whether there is nothing more to do."""
        return self._endpoint.finished

    def receive(self, datagram: bytes, peer: Address, now_us: int) -> None:
        """Take a datagram."""
        # Nearly always it is one frame, of version 2 and not signed.
        if datagram[:1] == _V2 and len(datagram) > 2 and len(datagram) == datagram[1] + _V2_FRAME:
            self._log(datagram, peer, self._stamp_us(now_us))
        else:
            for frame in parse(datagram):
                if isinstance(frame, Frame):
                    self._log(frame.raw, peer, self._stamp_us(now_us))
        self._endpoint.receive(datagram, peer, now_us)

    def drop(self, cause: RejectReason, peer: Address) -> None:
        """Count a datagram that was not handed over."""
        self._endpoint.drop(cause, peer)

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Do what is due and return the datagrams to send."""
        sent = self._endpoint.poll(now_us)
        if sent:
            stamp_us = self._stamp_us(now_us)
            for datagram, peer in sent:
                self._log(datagram, peer, stamp_us)
            if stamp_us >= self._flush_at_us:
                self._flush()
                self._flush_at_us = stamp_us + _FLUSH_US
        return sent

    def deadline_us(self) -> int:
        """Return the time at which `poll` is to be called at the latest."""
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

    def _log(self, frame: bytes, peer: Address, stamp_us: int) -> None:
        number = self._numbers.get(peer, _PEERS)
        if number == _PEERS and len(self._numbers) < _PEERS:
            number = self._numbers[peer] = len(self._numbers)
        self._buffer += _STAMP.pack(stamp_us & ~3 | number)
        self._buffer += frame

    def _flush(self) -> None:
        buffer, self._buffer = self._buffer, bytearray()
        self._file.write(buffer)
