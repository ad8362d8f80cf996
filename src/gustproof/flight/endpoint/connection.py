"""Link of a controller to its autopilot: `--connect` by UDP, as a peer or listening, or by TCP."""

import socket
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from pymavlink.dialects.v20 import all as wire

from firmware_model.errors import ConfigError
from firmware_model.mavlink.frames import Frame, parse
from firmware_model.mavlink.messages import AUTOPILOT
from firmware_model.mavlink.wire import LARGEST_DATAGRAM
from firmware_model.process import access, tcp, udp
from gustproof.flight.endpoint.endpoint import ControllerEndpoint

# PX4's simulation listens on 14580 + instance. It sends to 14540 + instance unless another port sends to it first; then
# it sends to that one until it ends.
_PX4_PORTS, _PX4_OFFSET = range(14580, 14590), -40


class Target(NamedTuple):
    """Address of the autopilot, or of this side if it listens."""

    kind: str
    """`udp`, `udpin` or `tcp`."""
    address: tuple[str, int]
    """Host and port."""
    is_given: bool
    """True if a user gave it, not a parent process."""

    def __str__(self) -> str:
        return f"{'' if self.kind == 'udp' else f'{self.kind}:'}{self.address[0]}:{self.address[1]}"


def parse_target(text: str) -> Target:
    """Return the target of `--connect`; `-` waits for it in the first line of standard input.

    Raises
    ------
    ConfigError
        If it is no address, or its host is unknown.
    """
    line = sys.stdin.readline().strip() if text == "-" else text
    kind, separator, rest = line.partition(":")
    if kind not in ("udp", "udpin", "tcp") or not separator:
        kind, rest = "udp", line
    host, _, port = rest.rpartition(":")
    if not (host and not set(host) & set("/:") and port.isdecimal() and 0 < int(port) < 65536):
        raise ConfigError(f"--connect is '{text}', must be [udp:|udpin:|tcp:]HOST:PORT, as 127.0.0.1:14580")
    return Target(kind, udp.resolve(host, int(port)), text != "-")


def serve(
    endpoint: ControllerEndpoint,
    target: Target,
    bind_port: int | None,
    report: Callable[[str], None],
    *,
    is_loaded: bool = False,
) -> None:
    """Serve an endpoint over the link until it has finished; `report` is called with lines for people.

    Samples are exchanged in machine code only if that is loaded. To compile it in flight takes longer than a stream may
    be silent.

    Raises
    ------
    ConfigError
        If the port to send from, or to listen on, can't be used.
    """
    if target.kind == "tcp":
        report(f"waiting for an autopilot at {target}")
        tcp.serve(endpoint, target.address, report)
        return
    with _bind(target, bind_port, report) as bound:
        report(f"waiting for an autopilot at {target}")
        peer = target.address if target.kind == "udp" else _await_autopilot(endpoint, bound)
        if peer is not None:
            udp.connect(bound, peer)
            udp.serve_lockstep(endpoint, bound, endpoint.exchange if is_loaded else udp.no_exchange)


def _bind(target: Target, bind_port: int | None, report: Callable[[str], None]) -> socket.socket:
    """Return the socket to send from; for PX4 its default peer port, if that is free."""
    host, port = target.address
    if target.kind == "udpin":
        return udp.bind(port, host)
    local = access.LOOPBACK if udp.is_loopback(host) else "0.0.0.0"
    if bind_port is not None:
        return udp.bind(bind_port, local)
    if target.is_given and port in _PX4_PORTS:
        try:
            return udp.bind(port + _PX4_OFFSET, local)
        except ConfigError as error:
            report(f"{error}; a free port is used, which PX4 accepts only as its first peer since its start")
    return udp.bind(0, local)


def _await_autopilot(endpoint: ControllerEndpoint, bound: socket.socket) -> tuple[str, int] | None:
    """Return who first sends an autopilot's HEARTBEAT, as the endpoint's vehicle; `None` if the endpoint ends first."""
    while True:
        endpoint.poll(time.monotonic_ns() // 1000)  # counts the time: there is nobody to send to
        if endpoint.finished:
            return None
        bound.settimeout(max(endpoint.deadline_us() * 1e-6 - time.monotonic(), 1e-3))
        with suppress(OSError):
            datagram, (host, port) = bound.recvfrom(LARGEST_DATAGRAM)
            if any(isinstance(frame, Frame) and _is_autopilot(frame) for frame in parse(datagram)):
                endpoint.vehicle = (0, (host, port))
                return host, port


def _is_autopilot(frame: Frame) -> bool:
    return frame.message_id == wire.MAVLINK_MSG_ID_HEARTBEAT and frame.component == AUTOPILOT
