"""The page's web server: on loopback alone, behind a token, for pages of its own only.

    GET  /TOKEN/           page, script, style
    GET  /TOKEN/events     what is new, as server-sent events
    POST /TOKEN/start      JSON true
    POST /TOKEN/pause      JSON true or false
    POST /TOKEN/gust       JSON number

The token keeps out others on this machine, the Host that a request names keeps out names that were made to point
here, and the Origin keeps out pages from elsewhere.
"""

import json
import math
import secrets
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from threading import Event, Thread
from typing import Any

from gustproof.live.telemetry_buffer import TelemetryBuffer

LOOPBACK = "127.0.0.1"
_FILES = {
    "": ("index.html", "text/html"),
    "view.js": ("view.js", "text/javascript"),
    "picture.js": ("picture.js", "text/javascript"),
    "style.css": ("style.css", "text/css"),
}
_UPDATE_S = 1 / 30  # the page draws what lies between two
_KEEPALIVE_S = 5.0
_MAX_BODY = 64  # bytes of a wish
_CLOSE_TIMEOUT_S = 5.0
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class PageServer(ThreadingHTTPServer):
    """Serve the page of a feed from threads of its own; a context manager that tells the last news before it ends.

    `wishes` are called with what the page sends, by name, and raise `ValueError` at what they can't take.
    """

    daemon_threads = True
    allow_reuse_address = False

    def __init__(self, feed: TelemetryBuffer, wishes: Mapping[str, Callable[[Any], None]]) -> None:
        super().__init__((LOOPBACK, 0), _Handler)
        self.feed, self.wishes = feed, wishes
        self.token = secrets.token_urlsafe(24)
        self.closing = Event()
        self.readers: set[Event] = set()
        self._thread = Thread(target=self.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{LOOPBACK}:{self.server_port}/{self.token}/"

    def server_close(self) -> None:
        """Let every page that is open read to the end, and end."""
        self.closing.set()
        for told in list(self.readers):
            told.wait(_CLOSE_TIMEOUT_S)
        self.shutdown()
        self._thread.join()
        super().server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a page that goes away in the middle of an answer is no error."""


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: standard error is for the flight."""

    def do_GET(self) -> None:
        """Send a file or the news."""
        name = self._name()
        if name == "events":
            self._send_events()
        elif name in _FILES:
            file, kind = _FILES[name]
            body = resources.files("gustproof.live").joinpath("assets", file).read_bytes()
            self._answer(HTTPStatus.OK, body, f"{kind}; charset=utf-8")
        elif name is not None:
            self._answer(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Take a wish."""
        name = self._name()
        if name is None:
            return
        wish = self.server.wishes.get(name)
        if wish is None:
            self._answer(HTTPStatus.NOT_FOUND)
            return
        length = self.headers.get("Content-Length", "")
        if not (length.isdecimal() and int(length) <= _MAX_BODY):
            self._answer(HTTPStatus.BAD_REQUEST)
            return
        try:
            wish(json.loads(self.rfile.read(int(length))))
        except ValueError as error:
            self._answer(HTTPStatus.BAD_REQUEST, f"{error}\n".encode())
        else:
            self._answer(HTTPStatus.NO_CONTENT)

    def _name(self) -> str | None:
        """Return what is asked for behind the token; answer the request and return `None` if it may not be."""
        hosts = [f"{host}:{self.server.server_port}" for host in (LOOPBACK, "localhost")]
        origin = self.headers.get("Origin")
        if self.headers.get("Host") not in hosts or origin not in (None, *(f"http://{host}" for host in hosts)):
            self._answer(HTTPStatus.FORBIDDEN)
            return None
        token, slash, name = self.path.removeprefix("/").partition("/")
        if not (slash and secrets.compare_digest(token.encode(), self.server.token.encode())):
            self._answer(HTTPStatus.NOT_FOUND)
            return None
        return name

    def _answer(self, status: HTTPStatus, body: bytes = b"", kind: str = "text/plain; charset=utf-8") -> None:
        self.close_connection = True  # an unread body is not the next request
        self.send_response(status)
        for name, value in {**_HEADERS, "Content-Type": kind, "Content-Length": len(body)}.items():
            self.send_header(name, str(value))
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def _send_events(self) -> None:
        """Send what is new until the server closes or the page does."""
        self.close_connection = True
        self.send_response(HTTPStatus.OK)
        for name, value in {**_HEADERS, "Content-Type": "text/event-stream", "Connection": "close"}.items():
            self.send_header(name, value)
        self.end_headers()
        told, reader, silent_s = Event(), self.server.feed.reader(), 0.0
        self.server.readers.add(told)
        try:
            closing = False
            while not closing:
                closing = self.server.closing.wait(_UPDATE_S)
                news = reader.news()
                silent_s = 0.0 if news else silent_s + _UPDATE_S
                if news:
                    self.wfile.write(f"data: {json.dumps(news, separators=(',', ':'))}\n\n".encode())
                elif silent_s > _KEEPALIVE_S:  # a page that has gone is found out by this
                    silent_s = 0.0
                    self.wfile.write(b":\n\n")
        finally:
            told.set()
            self.server.readers.discard(told)


def parse_number(value: Any, lowest: float, highest: float) -> float:
    """Return a number that a page sent.

    Raises
    ------
    ValueError
        If it is none, or outside `lowest` to `highest`.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(f"{value!r} is not a number")
    if not lowest <= value <= highest:
        raise ValueError(f"{value:g} is outside {lowest:g} to {highest:g}")
    return float(value)


def parse_bool(value: Any) -> bool:
    """Return true or false that a page sent.

    Raises
    ------
    ValueError
        If it is neither.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{value!r} is neither true nor false")
    return value
