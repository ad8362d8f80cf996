"""Socket and clock loop that serves an endpoint over a TCP connection that it opens itself, and opens again."""

import select
import socket
import time
from collections.abc import Callable
from contextlib import closing, suppress

from firmware_model.mavlink.frames import split_stream
from firmware_model.process.udp import Endpoint

RECONNECT_S = 0.5
"""[s] wall time between attempts to connect."""
_CONNECT_TIMEOUT_S = 1.0
_SEND_TIMEOUT_S = 1.0  # a peer that reads nothing for so long counts as lost
_LINGER_S = 0.3
_READ_BYTES = 65_536


def serve(endpoint: Endpoint, address: tuple[str, int], report: Callable[[str], None]) -> None:
    """Serve an endpoint until it has finished, over a connection to `address`, its only peer.

    A connection that is refused or lost is opened again; the endpoint's own time-outs bound that. Without a connection
    nothing is sent. `report` is called with the reason, once for each loss.
    """
    with closing(_Connection(address, report)) as connection:
        while True:
            outbox, finished = b"".join(datagram for datagram, _ in endpoint.poll(_now_us())), endpoint.finished
            frames = connection.exchange(outbox, 0 if finished else endpoint.deadline_us())
            if finished:
                return
            for frame in frames:
                endpoint.receive(frame, (0, address), _now_us())


class _Connection:
    """Connection that is opened when it is needed."""

    def __init__(self, address: tuple[str, int], report: Callable[[str], None]) -> None:
        self._address, self._report = address, report
        self._link: socket.socket | None = None
        self._stream = bytearray()
        self._retry_at_us, self._reported = 0, False

    def exchange(self, outbox: bytes, deadline_us: int) -> list[bytes]:
        """Send, and return the frames that come until the deadline [us]; without a connection, wait that long."""
        try:
            if self._link is None and _now_us() >= self._retry_at_us:
                self._open()
            if self._link is None:
                time.sleep(max(min(deadline_us, self._retry_at_us) - _now_us(), 0) * 1e-6)
                return []
            if outbox:
                self._link.sendall(outbox)
            readable, _, _ = select.select((self._link,), (), (), max(deadline_us - _now_us(), 0) * 1e-6)
            if readable:
                if not (data := self._link.recv(_READ_BYTES)):
                    raise ConnectionResetError("the other side closed the connection")
                self._stream += data
        except OSError as error:
            if not self._reported:
                self._report(f"TCP {self._address[0]}:{self._address[1]}: {error.strerror or error}; trying again")
            self.close()
            self._retry_at_us, self._reported = _now_us() + round(RECONNECT_S * 1e6), True
        return split_stream(self._stream)

    def close(self) -> None:
        """Close the connection, if it is open.

        What is still to be read is read for a moment. Closed with data unread, the system would reset the connection,
        and the other side would lose what it has not read, such as a last request.
        """
        if self._link is None:
            return
        with self._link, suppress(OSError):
            self._link.shutdown(socket.SHUT_WR)
            self._link.settimeout(_LINGER_S)
            end_us = _now_us() + round(_LINGER_S * 1e6)
            while self._link.recv(_READ_BYTES) and _now_us() < end_us:
                pass
        self._link = None

    def _open(self) -> None:
        self._link = socket.create_connection(self._address, timeout=_CONNECT_TIMEOUT_S)
        self._link.settimeout(_SEND_TIMEOUT_S)
        self._link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._stream.clear()
        self._reported = False


def _now_us() -> int:
    return time.monotonic_ns() // 1000
