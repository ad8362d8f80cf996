"""Socket and clock loop that serves any endpoint, of the vehicle or the controller."""

import ipaddress
import os
import select
import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from firmware_model.errors import ConfigError
from firmware_model.mavlink.frames import Address, RejectReason
from firmware_model.mavlink.wire import LARGEST_DATAGRAM, LockstepLine

_yield_core = getattr(os, "sched_yield", None) or (lambda: time.sleep(0.0))  # not every system has it
_SPIN_WAIT_US = 200  # lockstep answers in less; sleeping and waking take as long as the answer itself
_SLEEP_CYCLES = 100  # waits; on a busy machine a spin in vain can cost ms and must be rare
_DRAIN_CYCLES = 16  # cycles; a check for more datagrams costs a call, and in lockstep there are never more
_DRAIN_LIMIT = 256  # datagrams; about the system's queue of a socket
_PEER_LIMIT = 16  # datagrams of one peer among them that are passed on at once; the rest waits for the next cycles
_PEER_QUEUE = 512  # datagrams of one peer that may wait; further ones are discarded
_LIMITS = ((1, 0), (_DRAIN_LIMIT, _PEER_LIMIT))  # of an ordinary cycle, and of one that drains
_CONNECTED_LIMIT = 4096  # datagrams; more than fit into `_BUFFER`
_BUFFER = 1 << 20  # bytes; a second of all streams, if the system grants it
_RECEIVE_TIMEOUT_US = 5_000  # us; for a slower answer the loop sleeps until the deadline
_SPIN_US = 150  # worst wake-up time on an idle machine; the loop spins for the last part of a wait


class Endpoint(Protocol):
    """Protocol core without socket and clock."""

    @property
    def finished(self) -> bool:
        """True if there is nothing more to do."""

    def receive(self, datagram: bytes, address: Address, now_us: int) -> None:
        """Handle a datagram."""

    def count_reject(self, cause: RejectReason, address: Address) -> None:
        """Count a datagram that was discarded unread."""

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Perform all due actions and return the datagrams to send."""

    def deadline_us(self) -> int:
        """Return the latest time for the next call of `poll`."""


Exchange = Callable[[int, Callable[[], int]], LockstepLine | None]
"""Exchange frames with a peer in machine code, for some ms at most: on the socket of that number, with that clock [us].

It returns the line, with the datagram that ended it, if one did; `None` where anything else is to be done first.
"""


def no_exchange(_socket: int, _clock: Callable[[], int]) -> LockstepLine | None:
    """Return `None`: nothing is exchanged in machine code."""
    return None


def bind(port: int, host: str = "127.0.0.1") -> socket.socket:
    """Return a UDP socket bound to `port`; 0 selects a free one.

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
        raise ConfigError(f"can't listen on UDP port {port}: {reason}") from error
    bound.setblocking(False)
    return bound


def resolve(host: str, port: int) -> tuple[str, int]:
    """Return the source address of datagrams from `host`.

    Raises
    ------
    ConfigError
        If the name is unknown.
    """
    try:
        return socket.gethostbyname(host), port
    except OSError as error:
        raise ConfigError(f"{host}: {error.strerror}") from None


def connect(bound: socket.socket, peer: tuple[str, int]) -> None:
    """Connect a socket to a single peer, which is faster, and enlarge its receive buffer.

    Raises
    ------
    ConfigError
        If there is no route to it.
    """
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        bound.connect(peer)
    except OSError as error:
        raise ConfigError(f"{peer[0]}: {error.strerror}") from None


def is_loopback(host: str) -> bool:
    """Return whether an address is loopback."""
    return ipaddress.ip_address(host).is_loopback


def unix_us() -> int:
    """Return the Unix time at which the clock of `serve` is 0."""
    return time.time_ns() // 1000 - _now_us()


def serve(endpoint: Endpoint, sockets: Sequence[socket.socket], *, real_time: bool = False) -> None:
    """Pass datagrams and time to the endpoint, and its datagrams to the wire, until it has finished.

    The loop spins for the next datagram, as in lockstep it comes at once. After a spin in vain, as in real time or on a
    busy machine, it sleeps through the next waits before it spins again.

    The deadlines of a `real_time` endpoint are absolute: the samples of a flight in real time. The loop sleeps until
    shortly before the next one and then spins.

    A cycle passes on one datagram per socket, so a flood can't delay due actions. Every few cycles a socket is drained
    with a limit for each peer, so a flood can't crowd out other peers. What exceeds the limit is passed on in the next
    cycles, one datagram of each peer.
    """
    sleeps = cycle = 0
    inbox = _Inbox(endpoint, _PEER_QUEUE)
    while True:
        # An interruption while datagrams are sent still has words of its own to send.
        datagrams, finished = endpoint.poll(_now_us()), endpoint.finished
        _send(datagrams, sockets)
        if finished:
            return
        readable: list[socket.socket] = []
        if inbox.is_waiting:
            readable = _wait_readable(sockets, 0)
        elif real_time:
            readable = _wait_precisely(sockets, endpoint.deadline_us())
        elif sleeps:
            sleeps -= 1
        else:
            end_us = _now_us() + _SPIN_WAIT_US
            readable = _spin_readable(sockets, end_us)
            sleeps = _SLEEP_CYCLES if _now_us() >= end_us else 0
        if not (readable or real_time or inbox.is_waiting):
            readable = _wait_readable(sockets, endpoint.deadline_us())
        cycle += 1
        for ready in readable:
            inbox.drain(ready, sockets.index(ready), *_LIMITS[cycle % _DRAIN_CYCLES == 0])
        inbox.pass_on(1)


def serve_lockstep(endpoint: Endpoint, bound: socket.socket, exchange: Exchange = no_exchange) -> None:
    """Serve an endpoint that alternates with its peer, as in lockstep, on one socket, connected or not.

    The process blocks in the read: on a core that both share, the peer runs at once. After a wait in vain it sleeps
    until the deadline or the next datagram, so deadlines are met to some ms.

    While nothing but the expected datagrams comes, `exchange` reads and answers them, on Linux; elsewhere addresses and
    clocks have other forms.

    A connected socket has a single peer, whose datagrams are all passed on, in order and without limit. Those that
    queued during a wait are passed on at once, before the endpoint is polled.
    """
    bound.setblocking(True)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, _RECEIVE_TIMEOUT_US))
    peer = _peer_address(bound)
    now_us = last_seen_us = _now_us()
    is_readable = False
    cycle = 0
    limits, queue = ((_CONNECTED_LIMIT, _CONNECTED_LIMIT), _CONNECTED_LIMIT) if peer else (_LIMITS[True], _PEER_QUEUE)
    inbox = _Inbox(endpoint, queue)
    exchange = exchange if sys.platform == "linux" else no_exchange
    while True:
        datagrams, finished = endpoint.poll(now_us), endpoint.finished
        for datagram, (_, address) in datagrams:
            try:
                _ = bound.send(datagram) if peer else bound.sendto(datagram, address)
            except OSError:
                continue
        if finished:
            return
        if inbox.is_waiting or not is_readable:
            is_readable = bool(_wait_readable((bound,), 0 if inbox.is_waiting else endpoint.deadline_us()))
        if is_readable:
            try:
                datagram, source = _exchange(bound, peer, no_exchange if inbox.is_waiting else exchange)
            except OSError as error:
                is_readable = not isinstance(error, BlockingIOError)
            else:
                before_us, last_seen_us = last_seen_us, _now_us()
                inbox.receive(datagram, (0, source), last_seen_us)
                cycle += 1
                if last_seen_us - before_us > _SPIN_WAIT_US if peer else cycle % _DRAIN_CYCLES == 0:
                    inbox.drain(bound, 0, *limits)
        inbox.pass_on(1)
        now_us = _now_us()


def _exchange(bound: socket.socket, peer: tuple[str, int] | None, exchange: Exchange) -> tuple[bytes, tuple[str, int]]:
    """Let `exchange` read on for a while; return the datagram that it left, or else the next one, and its source."""
    line = exchange(bound.fileno(), _now_us)
    if line is not None and (left := line.left):
        return left
    return (bound.recv(LARGEST_DATAGRAM), peer) if peer else bound.recvfrom(LARGEST_DATAGRAM)


def _send(datagrams: Sequence[tuple[bytes, Address]], sockets: Sequence[socket.socket]) -> None:
    for datagram, (index, address) in datagrams:
        try:
            sockets[index].sendto(datagram, address)
        except OSError:  # a datagram that the system can't send now is lost, as UDP allows
            continue


def _peer_address(bound: socket.socket) -> tuple[str, int] | None:
    """Return the address that a socket is connected to, `None` if it is not connected."""
    try:
        host, port = bound.getpeername()
    except OSError:
        return None
    return host, port


class _Inbox:
    """Datagrams that were read and wait to be passed on: each peer's in order, up to `most` of them."""

    def __init__(self, endpoint: Endpoint, most: int) -> None:
        self._endpoint, self._most = endpoint, most
        self._waiting: dict[Address, deque[bytes]] = {}

    @property
    def is_waiting(self) -> bool:
        """True if a datagram waits."""
        return bool(self._waiting)

    def receive(self, datagram: bytes, peer: Address, now_us: int) -> None:
        """Pass on a datagram at once, unless another one waits: it then waits behind that."""
        if self._waiting:
            self._put(datagram, peer)
        else:
            self._endpoint.receive(datagram, peer, now_us)

    def drain(self, ready: socket.socket, index: int, most: int, share: int) -> None:
        """Read up to `most` datagrams that wait in a socket, and pass on up to `share` of each peer."""
        for _ in range(most):
            try:
                datagram, address = ready.recvfrom(LARGEST_DATAGRAM, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except OSError:  # a damaged datagram, or an ICMP error for an earlier one
                continue
            self._put(datagram, (index, address))
        self.pass_on(share)

    def pass_on(self, share: int) -> None:
        """Pass on up to `share` datagrams of each peer."""
        for peer, queue in list(self._waiting.items()):
            for _ in range(min(share, len(queue))):
                self._endpoint.receive(queue.popleft(), peer, _now_us())
            if not queue:
                del self._waiting[peer]

    def _put(self, datagram: bytes, peer: Address) -> None:
        """Add a datagram; count one that finds its peer's queue full as discarded."""
        queue = self._waiting.setdefault(peer, deque())
        if len(queue) < self._most:
            queue.append(datagram)
        else:
            self._endpoint.count_reject(RejectReason.RATE_LIMITED, peer)


def _wait_readable(sockets: Sequence[socket.socket], end_us: int) -> list[socket.socket]:
    """Return the readable sockets as soon as there is one; none at `end_us`."""
    readable, _, _ = select.select(sockets, (), (), max(end_us - _now_us(), 0) * 1e-6)
    return readable


def _wait_precisely(sockets: Sequence[socket.socket], end_us: int) -> list[socket.socket]:
    """Return the readable sockets like `_wait_readable`, but spin at the end to be on time; this occupies a core."""
    readable = _wait_readable(sockets, end_us - _SPIN_US)
    while not readable and _now_us() < end_us:
        readable, _, _ = select.select(sockets, (), (), 0.0)
    return readable


def _spin_readable(sockets: Sequence[socket.socket], end_us: int) -> list[socket.socket]:
    """Return the readable sockets as soon as there is one; yield the core to other processes in between."""
    readable: list[socket.socket] = []
    while not readable and _now_us() < end_us:
        _yield_core()
        readable, _, _ = select.select(sockets, (), (), 0.0)
    return readable


def _now_us() -> int:
    return time.monotonic_ns() // 1000
