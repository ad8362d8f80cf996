"""The page's server over real sockets of this machine."""

import json
from collections.abc import Iterator
from contextlib import ExitStack
from http.client import HTTPConnection, HTTPResponse
from socket import create_connection

import pytest

from gustproof.show.live import server as live
from gustproof.show.live.server import PageServer, parse_bool, parse_number
from gustproof.show.live.telemetry_buffer import TelemetryBuffer


@pytest.fixture
def wished() -> list:
    return []


@pytest.fixture
def server(wished) -> Iterator[PageServer]:
    def gust(value):
        wished.append(parse_number(value, 0.0, 3.0))

    with PageServer(TelemetryBuffer(phase="ready"), {"gust": gust}) as server:
        yield server


def ask(server: PageServer, path: str, method: str = "GET", body: str | None = None, **headers: str) -> HTTPResponse:
    connection = HTTPConnection("127.0.0.1", server.server_port, timeout=30.0)
    connection.request(method, path, body, headers)
    return connection.getresponse()


def test_server_is_on_loopback_alone(server):
    assert server.server_address[0] == "127.0.0.1"
    assert server.address == f"http://127.0.0.1:{server.server_port}/{server.token}/"
    assert len(server.token) >= 32


@pytest.mark.parametrize(
    ("name", "kind"), [("", "text/html"), ("view.js", "text/javascript"), ("style.css", "text/css")]
)
def test_page_comes_with_a_policy_that_allows_no_other_source(server, name, kind):
    answer = ask(server, f"/{server.token}/{name}")
    assert answer.status == 200
    assert answer.headers["Content-Type"].startswith(kind)
    assert answer.headers["Content-Security-Policy"].startswith("default-src 'none'; script-src 'self'")
    text = answer.read().decode()
    assert text
    assert "http" not in text.replace("http-equiv", "")


@pytest.mark.parametrize("path", ["/", "/events", "/wrong/", "/wrong/events", "//", "/{token}", "/{token}x/"])
def test_without_the_token_there_is_nothing(server, path):
    assert ask(server, path.format(token=server.token)).status == 404


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1:{port}"},
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_names_and_pages_from_elsewhere_are_refused(server, wished, headers, method):
    filled = {name: value.format(port=server.server_port) for name, value in headers.items()}
    assert ask(server, f"/{server.token}/gust", method, "2.0", **filled).status == 403
    assert wished == []


def test_wish_of_the_page_itself_is_taken(server, wished):
    origin = f"http://127.0.0.1:{server.server_port}"
    assert ask(server, f"/{server.token}/gust", "POST", "2.5", Origin=origin).status == 204
    assert wished == [2.5]


@pytest.mark.parametrize(
    "body", ["", "x", "4", "-1", "NaN", "1e999", "true", '"1"', "[1]", "1" * 65, "\x00", '{"a": 1}', "[" * 60]
)
def test_what_is_no_wish_is_refused_and_said(server, wished, body):
    assert ask(server, f"/{server.token}/gust", "POST", body).status == 400
    assert ask(server, f"/{server.token}/gust", "POST", "1.5").status == 204
    assert wished == [1.5]


def test_what_cannot_be_wished_is_not_found(server):
    assert ask(server, f"/{server.token}/pause", "POST", "true").status == 404
    assert ask(server, f"/{server.token}/../server.py").status == 404


def test_news_come_as_events_and_the_last_before_the_server_closes():
    feed = TelemetryBuffer(phase="ready")
    with PageServer(feed, {}) as server:
        answer = ask(server, f"/{server.token}/events")
        assert answer.headers["Content-Type"] == "text/event-stream"
        first = answer.readline()
        feed.add("wind", [[0.0, 1.0, 2.0, 3.0]])
        feed.update(phase="over")
    events = [line for line in [first, *answer.read().split(b"\n")] if line.startswith(b"data: ")]
    news = [json.loads(event.removeprefix(b"data: ")) for event in events]
    assert news[0] == {"facts": {"phase": "ready"}}
    assert [rows for told in news for rows in told.get("wind", [])] == [[0.0, 1.0, 2.0, 3.0]]
    assert news[-1]["facts"] == {"phase": "over"}


def test_page_that_goes_away_leaves_nothing_behind():
    feed = TelemetryBuffer(phase="ready")
    with PageServer(feed, {}) as server:
        answer = ask(server, f"/{server.token}/events")
        answer.readline()
        answer.close()
        while server.readers:
            feed.add("wind", [[0.0, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    "sent", ["", "GET /", "GET / HTTP/1.1\r\nHost: x", "POST /{token}/gust HTTP/1.1\r\n{host}\r\n\r\n1"]
)
def test_request_that_stays_unfinished_is_closed(server, sent, monkeypatch):
    monkeypatch.setattr(live._Handler, "timeout", 0.1)
    host = f"Host: 127.0.0.1:{server.server_port}\r\nContent-Length: 9"
    with ExitStack() as stack:
        opened = [stack.enter_context(create_connection(server.server_address, 20.0)) for _ in range(20)]
        for each in opened:
            each.sendall(sent.format(token=server.token, host=host).encode())
        assert [each.recv(99) for each in opened] == [b""] * 20
    assert ask(server, f"/{server.token}/").status == 200


@pytest.mark.parametrize("value", [1, 0, "true", None])
def test_switch_takes_true_and_false_alone(value):
    assert parse_bool(True)
    with pytest.raises(ValueError, match="neither true nor false"):
        parse_bool(value)
