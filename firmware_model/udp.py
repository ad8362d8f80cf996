"""The only loop with a socket and a clock: it serves any endpoint, the vehicle's and the controller's."""

import contextlib
import select
import socket
import time
from collections.abc import Sequence
from typing import Protocol

from firmware_model.errors import ConfigError
from firmware_model.frames import Peer

_LARGEST = 65_535  # bytes, the largest UDP datagram
_SPIN_US = 150  # waking from sleep takes this long at worst on an idle machine; the last stretch is polled instead


class Endpoint(Protocol):
    """A protocol core that knows neither socket nor clock."""

    @property
    def finished(self) -> bool:
        """Whether there is nothing more to do."""

    def receive(self, datagram: bytes, peer: Peer, now_us: int) -> None:
        """Take a datagram."""

    def poll(self, now_us: int) -> list[tuple[bytes, Peer]]:
        """Do what is due and return the datagrams to send."""

    def deadline_us(self) -> int:
        """Return the time at which `poll` is to be called at the latest."""


def bind(port: int, host: str = "127.0.0.1") -> socket.socket:
    """Return a UDP socket bound to `port`; 0 takes a free one.

    Raises
    ------
    ConfigError
        If the port is in use or not allowed.
    """
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        bound.bind((host, port))
    except (OSError, OverflowError) as error:
        bound.close()
        reason = error.strerror if isinstance(error, OSError) else "not a port number"
        raise ConfigError(f"can't listen on UDP port {port}: {reason}") from None
    bound.setblocking(False)
    return bound


def resolve(host: str, port: int) -> tuple[str, int]:
    """Return the address that datagrams from `host` carry.

    Raises
    ------
    ConfigError
        If the name is not known.
    """
    try:
        return socket.gethostbyname(host), port
    except OSError as error:
        raise ConfigError(f"{host}: {error.strerror}") from None


def serve(endpoint: Endpoint, sockets: Sequence[socket.socket]) -> None:
    """Carry datagrams and time to the endpoint, and its datagrams to the wire, until it has finished."""
    while True:
        now_us = time.monotonic_ns() // 1000
        for datagram, (index, address) in endpoint.poll(now_us):
            # UDP promises nothing: what the system can't send now is lost like any other datagram.
            with contextlib.suppress(OSError):
                sockets[index].sendto(datagram, address)
        if endpoint.finished:
            return
        wait_us = endpoint.deadline_us() - now_us - _SPIN_US
        readable, _, _ = select.select(sockets, (), (), max(wait_us, 0) * 1e-6)
        for ready in readable:
            # A damaged datagram, or the refusal of one that was sent before, is not an arrival.
            with contextlib.suppress(OSError):
                datagram, address = ready.recvfrom(_LARGEST)
                endpoint.receive(datagram, (sockets.index(ready), address), time.monotonic_ns() // 1000)
