"""The only loop with a socket and a clock: it serves any endpoint, the vehicle's and the controller's."""

import ipaddress
import os
import select
import socket
import struct
import time
from collections import Counter
from collections.abc import Sequence
from typing import Protocol

from firmware_model.errors import ConfigError
from firmware_model.mavlink.frames import Address, RejectReason

_yield_core = getattr(os, "sched_yield", None) or (lambda: time.sleep(0.0))  # not every system has it
_MAX_DATAGRAM = 65_535  # bytes, the largest UDP datagram
_SPIN_WAIT_US = 200  # lockstep answers in less; to fall asleep and to wake takes as long as the answer itself
_SLEEP_CYCLES = 100  # waits; on a busy machine a watch in vain can cost ms, and is to be rare
_DRAIN_CYCLES = 16  # cycles; a look whether more waits costs a call, and in lockstep there never is more
_DRAIN_LIMIT = 256  # datagrams; about what the system keeps for a socket
_PEER_LIMIT = 16  # datagrams of one peer among them; the rest is thrown away unread
_KEPT = 4096  # datagrams; more than fit into `_BUFFER`
_BUFFER = 1 << 20  # bytes; a second of all streams, as far as the system grants it
_RECEIVE_TIMEOUT_US = 5_000  # an answer that takes longer is waited for by the deadline instead
_SPIN_US = 150  # waking from sleep takes this long at worst on an idle machine; the last stretch is not slept through


class Endpoint(Protocol):
    """A protocol core that knows neither socket nor clock."""

    @property
    def finished(self) -> bool:
        """Whether there is nothing more to do."""

    def receive(self, datagram: bytes, peer: Address, now_us: int) -> None:
        """Take a datagram."""

    def drop(self, cause: RejectReason, peer: Address) -> None:
        """Count a datagram that was not handed over."""

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
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


def connect(bound: socket.socket, peer: tuple[str, int]) -> None:
    """Let a socket speak to one peer only, which is faster, and keep what that peer says while nobody reads.

    Raises
    ------
    ConfigError
        If there is no way there.
    """
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        bound.connect(peer)
    except OSError as error:
        raise ConfigError(f"{peer[0]}: {error.strerror}") from None


def is_loopback(host: str) -> bool:
    """Whether an address is of this machine alone."""
    return ipaddress.ip_address(host).is_loopback


def unix_us() -> int:
    """Return the Unix time at which the clock of `serve` is 0."""
    return time.time_ns() // 1000 - _now_us()


def serve(endpoint: Endpoint, sockets: Sequence[socket.socket], *, real_time: bool = False) -> None:
    """Carry datagrams and time to the endpoint, and its datagrams to the wire, until it has finished.

    The next datagram is awaited without falling asleep, as in lockstep it comes at once. Where that was in vain, as in
    real time or on a machine with other work to do, the process sleeps through the next waits before it tries again.

    A `real_time` endpoint has deadlines that are absolute, the samples of a flight in real time: it sleeps until shortly
    before the next one, and is awake when it comes.

    A cycle hands over one datagram a socket, so that nobody who floods keeps the endpoint from what is due. Every few
    cycles a socket is emptied, each peer getting its share, so that he keeps nobody else's datagrams out either.
    """
    naps = cycle = 0
    while True:
        for datagram, (index, address) in endpoint.poll(_now_us()):
            try:
                sockets[index].sendto(datagram, address)
            except OSError:  # UDP promises nothing: what the system can't send now is lost like any other datagram
                continue
        if endpoint.finished:
            return
        readable: list[socket.socket] = []
        if real_time:
            readable = _wait_punctually(sockets, endpoint.deadline_us())
        elif naps:
            naps -= 1
        else:
            end_us = _now_us() + _SPIN_WAIT_US
            readable = _spin_readable(sockets, end_us)
            naps = _SLEEP_CYCLES if _now_us() >= end_us else 0
        if not (readable or real_time):
            readable = _wait_readable(sockets, endpoint.deadline_us())
        cycle += 1
        for ready in readable:
            if cycle % _DRAIN_CYCLES == 0:
                _drain(endpoint, ready, sockets.index(ready))
                continue
            try:
                datagram, address = ready.recvfrom(_MAX_DATAGRAM)
            except OSError:  # a damaged datagram, or the refusal of one that was sent before, is not an arrival
                continue
            endpoint.receive(datagram, (sockets.index(ready), address), _now_us())


def serve_lockstep(endpoint: Endpoint, bound: socket.socket) -> None:
    """Serve an endpoint that speaks in turns with its peer, as in lockstep, by one socket, connected or not.

    The process falls asleep in the call that reads: on a core that both share, who is to answer goes on at once. After
    a wait in vain it sleeps until there is something to do, so deadlines are met to some ms.

    A connected socket has no strangers to guard against: all that its peer said is handed over, in order. What gathered
    during a wait is handed over at once, before the endpoint is polled.
    """
    bound.setblocking(True)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, _RECEIVE_TIMEOUT_US))
    peer = _peer_address(bound)
    now_us = last_seen_us = _now_us()
    heard = False
    cycle = 0
    while True:
        for datagram, (_, address) in endpoint.poll(now_us):
            try:
                _ = bound.send(datagram) if peer else bound.sendto(datagram, address)
            except OSError:
                continue
        if endpoint.finished:
            return
        if not heard:
            wait_us = endpoint.deadline_us() - _now_us()
            heard = bool(select.select((bound,), (), (), max(wait_us, 0) * 1e-6)[0])
        if heard:
            try:
                datagram, source = (bound.recv(_MAX_DATAGRAM), peer) if peer else bound.recvfrom(_MAX_DATAGRAM)
            except OSError as error:
                heard = not isinstance(error, BlockingIOError)
            else:
                before_us, last_seen_us = last_seen_us, _now_us()
                endpoint.receive(datagram, (0, source), last_seen_us)
                cycle += 1
                if peer and last_seen_us - before_us > _SPIN_WAIT_US:
                    _drain(endpoint, bound, 0, most=_KEPT, share=_KEPT)
                elif not peer and cycle % _DRAIN_CYCLES == 0:
                    _drain(endpoint, bound, 0)
        now_us = _now_us()


def _peer_address(bound: socket.socket) -> tuple[str, int] | None:
    """Return the one address that a socket speaks to, `None` if it speaks to any."""
    try:
        host, port = bound.getpeername()
    except OSError:
        return None
    return host, port


def _drain(
    endpoint: Endpoint, ready: socket.socket, index: int, *, most: int = _DRAIN_LIMIT, share: int = _PEER_LIMIT
) -> None:
    """Hand over what waits in a socket, of each peer no more than its share."""
    taken: Counter[Address] = Counter()
    for _ in range(most):
        try:
            datagram, address = ready.recvfrom(_MAX_DATAGRAM, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        except OSError:
            continue
        peer = index, address
        taken[peer] += 1
        if taken[peer] <= share:
            endpoint.receive(datagram, peer, _now_us())
        else:
            endpoint.drop(RejectReason.RATE_LIMITED, peer)


def _wait_readable(sockets: Sequence[socket.socket], end_us: int) -> list[socket.socket]:
    """Return the sockets that can be read, as soon as there is one, or none when it is time."""
    readable, _, _ = select.select(sockets, (), (), max(end_us - _now_us(), 0) * 1e-6)
    return readable


def _wait_punctually(sockets: Sequence[socket.socket], end_us: int) -> list[socket.socket]:
    """Return what `_wait_readable` does, but be awake when it is time, which needs the core to itself for the last stretch."""
    readable = _wait_readable(sockets, end_us - _SPIN_US)
    while not readable and _now_us() < end_us:
        readable, _, _ = select.select(sockets, (), (), 0.0)
    return readable


def _spin_readable(sockets: Sequence[socket.socket], end_us: int) -> list[socket.socket]:
    """Return the sockets that can be read, as soon as there is one; whoever else wants this core gets it in between."""
    readable: list[socket.socket] = []
    while not readable and _now_us() < end_us:
        _yield_core()
        readable, _, _ = select.select(sockets, (), (), 0.0)
    return readable


def _now_us() -> int:
    return time.monotonic_ns() // 1000
