"""Web server of the live page: on loopback alone, behind a token, for its own page only.

    GET  /TOKEN/           page, script, style
    GET  /TOKEN/events     updates, as server-sent events
    GET  /TOKEN/report     report on the flights so far, once one is over
    POST /TOKEN/start      JSON true
    POST /TOKEN/pause      JSON true or false
    POST /TOKEN/gust       JSON number
    POST /TOKEN/law        JSON number, of the law that flies next

The token keeps out other users of this machine. The Host check stops DNS rebinding, the Origin check pages from
elsewhere.
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

from gustproof.show.live.telemetry_buffer import TelemetryBuffer

LOOPBACK = "127.0.0.1"
_FILES = {
    "": ("index.html", "text/html"),
    "view.js": ("view.js", "text/javascript"),
    "picture.js": ("picture.js", "text/javascript"),
    "style.css": ("style.css", "text/css"),
}
_UPDATE_S = 1 / 30  # the page interpolates between two updates
_KEEPALIVE_S = 5.0
_PATIENCE_S = 10.0  # with a request of which only a part comes, and with a connection that is idle
_MAX_BODY = 64  # bytes of a request
_CLOSE_TIMEOUT_S = 5.0
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

_OWN_SCRIPTS = _HEADERS["Content-Security-Policy"].replace("'self'", "'unsafe-inline'").replace("data:", "data: blob:")
"""Policy of a page that brings its scripts and connects to nothing."""


class PageServer(ThreadingHTTPServer):
    """Server of the page of a buffer, in threads of its own; a context manager that sends the last update at its end.

    `handlers` are called by name with the values that the page sends, and raise `ValueError` at bad ones. `pages`
    return further pages by name, empty if there is none yet.
    """

    daemon_threads = True
    allow_reuse_address = False
    request_queue_size = 128

    def __init__(
        self,
        buffer: TelemetryBuffer,
        handlers: Mapping[str, Callable[[Any], None]],
        pages: Mapping[str, Callable[[], str]] | None = None,
    ) -> None:
        super().__init__((LOOPBACK, 0), _Handler)
        self.buffer, self.handlers, self.pages = buffer, handlers, pages or {}
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
        """Send the last update to every open page, and close."""
        self.closing.set()
        for sent in list(self.readers):
            sent.wait(_CLOSE_TIMEOUT_S)
        self.shutdown()
        self._thread.join()
        super().server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors: a page that closes in the middle of an answer is none."""


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    protocol_version = "HTTP/1.1"
    timeout = _PATIENCE_S

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: standard error is for the flight."""

    def do_GET(self) -> None:
        """Send a file or the updates."""
        name = self._name()
        if name == "events":
            self._send_events()
        elif name in _FILES:
            file, kind = _FILES[name]
            body = resources.files("gustproof.show.live").joinpath("assets", file).read_bytes()
            self._answer(HTTPStatus.OK, body, f"{kind}; charset=utf-8")
        elif name is not None and name in self.server.pages and (text := self.server.pages[name]()):
            self._answer(HTTPStatus.OK, text.encode(), "text/html; charset=utf-8", _OWN_SCRIPTS)
        elif name is not None:
            self._answer(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Pass a value to its handler."""
        name = self._name()
        if name is None:
            return
        handle = self.server.handlers.get(name)
        if handle is None:
            self._answer(HTTPStatus.NOT_FOUND)
            return
        length = self.headers.get("Content-Length", "")
        if not (length.isdecimal() and int(length) <= _MAX_BODY):
            self._answer(HTTPStatus.BAD_REQUEST)
            return
        try:
            handle(json.loads(self.rfile.read(int(length))))
        except ValueError as error:
            self._answer(HTTPStatus.BAD_REQUEST, f"{error}\n".encode())
        else:
            self._answer(HTTPStatus.NO_CONTENT)

    def _name(self) -> str | None:
        """Return the path behind the token; refuse a request that is not allowed, and return `None`."""
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

    def _answer(
        self,
        status: HTTPStatus,
        body: bytes = b"",
        kind: str = "text/plain; charset=utf-8",
        policy: str = _HEADERS["Content-Security-Policy"],
    ) -> None:
        self.close_connection = True  # an unread body must not become the next request
        self.send_response(status)
        headers = {**_HEADERS, "Content-Security-Policy": policy, "Content-Type": kind, "Content-Length": len(body)}
        for name, value in headers.items():
            self.send_header(name, str(value))
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def _send_events(self) -> None:
        """Send updates until the server or the page closes."""
        self.close_connection = True
        self.send_response(HTTPStatus.OK)
        for name, value in {**_HEADERS, "Content-Type": "text/event-stream", "Connection": "close"}.items():
            self.send_header(name, value)
        self.end_headers()
        sent, reader, silent_s = Event(), self.server.buffer.reader(), 0.0
        self.server.readers.add(sent)
        try:
            closing = False
            while not closing:
                closing = self.server.closing.wait(_UPDATE_S)
                update = reader.read()
                silent_s = 0.0 if update else silent_s + _UPDATE_S
                if update:
                    self.wfile.write(f"data: {json.dumps(update, separators=(',', ':'))}\n\n".encode())
                elif silent_s > _KEEPALIVE_S:  # detects a page that has closed
                    silent_s = 0.0
                    self.wfile.write(b":\n\n")
        finally:
            sent.set()
            self.server.readers.discard(sent)


def parse_number(value: Any, lowest: float, highest: float) -> float:
    """Return a number from a page.

    Raises
    ------
    ValueError
        If it is not a number, or outside `lowest` to `highest`.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(f"{value!r} is not a number")
    if not lowest <= value <= highest:
        raise ValueError(f"{value:g} is outside {lowest:g} to {highest:g}")
    return float(value)


def parse_bool(value: Any) -> bool:
    """Return a boolean from a page.

    Raises
    ------
    ValueError
        If it is neither.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{value!r} is neither true nor false")
    return value
