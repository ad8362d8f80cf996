import io
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.errors import ConfigError
from firmware_model.mavlink.messages import heartbeat_message
from gustproof.flight.endpoint import connection
from gustproof.flight.endpoint.connection import Target, parse_target

HOME, AWAY = "127.0.0.1", "10.1.2.3"


@pytest.mark.parametrize(
    ("text", "kind", "port"),
    [("127.0.0.1:14580", "udp", 14580), ("udp:127.0.0.1:1", "udp", 1), ("udpin:127.0.0.1:65535", "udpin", 65535),
     ("tcp:127.0.0.1:5760", "tcp", 5760)],
)  # fmt: skip
def test_target_is_a_kind_a_host_and_a_port(text: str, kind: str, port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    assert parse_target(text) == Target(kind, (HOME, port), True)
    assert str(parse_target(text)) == text.removeprefix("udp:")
    monkeypatch.setattr("sys.stdin", io.StringIO(f"{text}\n"))
    assert parse_target("-") == Target(kind, (HOME, port), False)


@pytest.mark.parametrize(
    "text", ["", ":14580", HOME, f"{HOME}:", f"{HOME}:0", f"{HOME}:65536", f"{HOME}:x", f"serial:{HOME}:1", "a/b:1"]
)
def test_what_is_no_target_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"must be \[udp:\|udpin:\|tcp:\]HOST:PORT"):
        parse_target(text)


@pytest.mark.parametrize(
    ("target", "asked", "bound"),
    [
        (Target("udp", (HOME, 14579), True), None, (0, HOME)),
        (Target("udp", (HOME, 14580), True), None, (14540, HOME)),
        (Target("udp", (AWAY, 14589), True), None, (14549, "0.0.0.0")),
        (Target("udp", (HOME, 14590), True), None, (0, HOME)),
        (Target("udp", (HOME, 14580), False), None, (0, HOME)),  # a parent process knows where it sends
        (Target("udp", (HOME, 14580), True), 7, (7, HOME)),
        (Target("udpin", (AWAY, 14580), True), 7, (14580, AWAY)),
    ],
)
def test_px4_is_met_at_the_port_that_it_sends_to(
    target: Target, asked: int | None, bound: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ports, lines = list[tuple[int, str]](), list[str]()
    monkeypatch.setattr(connection.udp, "bind", lambda *to: ports.append(to))
    connection._bind(target, asked, lines.append)
    assert (ports, lines) == ([bound], [])


def test_a_port_of_px4_that_is_taken_is_told_and_another_used(monkeypatch: pytest.MonkeyPatch) -> None:
    ports, lines = list[int](), list[str]()

    def bind(port: int, _: str) -> None:
        ports.append(port)
        if port:
            raise ConfigError("taken")

    monkeypatch.setattr(connection.udp, "bind", bind)
    connection._bind(Target("udp", (HOME, 14580), True), None, lines.append)
    assert ports == [14540, 0]
    assert lines == ["taken; a free port is used, which PX4 accepts only as its first peer since its start"]


def test_who_speaks_first_as_an_autopilot_is_met_and_the_wait_goes_by_the_endpoint_s_clock(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    beat = heartbeat_message(0, False, critical=False)
    heard = [
        (b"noise", (HOME, 1)),
        (beat.pack(wire.MAVLink(None, 1, 190)), (HOME, 2)),
        (beat.pack(wire.MAVLink(None, 1, 1)), (AWAY, 3)),
    ]
    monkeypatch.setattr(connection.time, "monotonic_ns", lambda: 7_000_000_999)
    monkeypatch.setattr(connection.time, "monotonic", lambda: 7.0)
    polled, waits = list[int](), list[float]()
    endpoint: Any = SimpleNamespace(poll=polled.append, finished=False, deadline_us=lambda: 7_250_000, vehicle=None)
    bound: Any = SimpleNamespace(settimeout=waits.append, recvfrom=lambda _: heard.pop(0))
    assert connection._await_autopilot(endpoint, bound) == (AWAY, 3)
    assert (endpoint.vehicle, polled, waits) == ((0, (AWAY, 3)), [7_000_000] * 3, [0.25] * 3)
    endpoint.finished = True
    assert connection._await_autopilot(endpoint, bound) is None
