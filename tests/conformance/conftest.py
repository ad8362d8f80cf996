"""Debian's Chromium without a window, driven over two pipes by its DevTools protocol."""

import base64
import fcntl
import importlib.util
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import pytest

_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
    "--force-color-profile=srgb", "--remote-debugging-pipe",
)  # fmt: skip
_PATIENCE_S = 60.0
_FAULTS = """(() => {
  // Our own checks, of WCAG 2.1: 3.1.1 language, 2.4.2 title, 4.1.1 ids, 4.1.2 names, 1.1.1 pictures,
  // 1.3.1 tables and headings, 2.1.1 what scrolls takes the focus, 1.4.3 contrast of 4.5 to 1.
  const faults = [], all = (what) => [...document.querySelectorAll(what)].filter((each) => each.checkVisibility());
  if (!document.documentElement.lang) faults.push("no language");
  if (!document.title) faults.push("no title");
  const ids = [...document.querySelectorAll("[id]")].map(({ id }) => id);
  for (const id of new Set(ids.filter((id, i) => ids.indexOf(id) !== i))) faults.push(`id twice: ${id}`);
  const named = (each) => each.getAttribute("aria-label") || each.textContent.trim() || each.title
    || [...(each.labels ?? [])].some((label) => label.textContent.trim());
  for (const each of all("a, button, input, select, summary, [role=img], section[aria-label]")) {
    if (!named(each)) faults.push(`no name: ${each.outerHTML.slice(0, 80)}`);
  }
  let level = 0;
  for (const heading of all("h1, h2, h3, h4")) {
    const next = Number(heading.tagName[1]);
    if (next > level + 1) faults.push(`heading skips a level: ${heading.textContent}`);
    level = next;
  }
  for (const table of all("table:not(.u-legend)")) {
    if (table.querySelector("thead th:not([scope])")) faults.push("table without scope");
  }
  for (const each of all(".wide")) {
    const scrolls = each.scrollWidth > each.clientWidth;
    if (scrolls && each.tabIndex < 0) faults.push(`scrolls without focus: ${each.className}`);
  }
  const ink = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgb = (colour) => {
    ink.clearRect(0, 0, 1, 1);
    ink.fillStyle = colour;
    ink.fillRect(0, 0, 1, 1);
    return ink.getImageData(0, 0, 1, 1).data;
  };
  const light = ([r, g, b]) => [r, g, b].reduce((sum, v, i) => {
    const c = v / 255;
    return sum + [0.2126, 0.7152, 0.0722][i] * (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  }, 0);
  const behind = (each) => {
    for (; each; each = each.parentElement) {
      const colour = rgb(getComputedStyle(each).backgroundColor);
      if (colour[3] === 255) return colour;
    }
    return [255, 255, 255];
  };
  const texts = "h1, h2, h3, h4, p, li, td, th, a, button, label, output, small, figcaption, summary, dt, dd";
  for (const each of all(texts)) {
    if (!each.textContent.trim() || each.closest("[disabled], [aria-pressed=false], .u-legend")) continue;
    const [a, b] = [light(rgb(getComputedStyle(each).color)), light(behind(each))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 4.5) faults.push(`contrast ${ratio.toFixed(2)}: ${each.textContent.trim().slice(0, 40)}`);
  }
  return faults;
})()"""

_AXE = """axe.run({
  resultTypes: ["violations"], rules: { "color-contrast": { enabled: COLOURS } },
}).then((found) => found.violations.map(
  ({ id, impact, nodes }) => `${impact}: ${id}: ${nodes.map((node) => node.target).slice(0, 3).join(" ")}`))"""

_A4 = 718
"""[CSS pixels] width of A4 within margins of 1 cm."""


class Browser:
    """Browser with one page. It keeps everything that the page logs, throws or requests from the network."""

    def __init__(self, program: str, profile: Path) -> None:
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self._unread, self._last, self._events = b"", 0, list[dict[str, Any]]()
        self._session: str | None = None
        inward, self._to = os.pipe()
        self._from, outward = os.pipe()
        # The browser reads on 3 and writes on 4; if these are taken, the pipes are moved first.
        ends = tuple(fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in (inward, outward))
        self._process = subprocess.Popen(
            [program, *_FLAGS, f"--user-data-dir={profile}", "about:blank"],
            preexec_fn=lambda: (os.dup2(ends[0], 3), os.dup2(ends[1], 4)), close_fds=False,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        for end in (inward, outward, *ends):
            os.close(end)

    def start(self) -> None:
        """Make the page and listen to it."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def close(self) -> None:
        """End the browser."""
        os.close(self._to)
        os.close(self._from)
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Return the answer to a command of the DevTools protocol."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while (answer := self._read()).get("id") != self._last:
            self._note(answer)
        assert "error" not in answer, f"{method}: {answer['error']}"
        result: dict[str, Any] = answer["result"]
        return result

    def open(self, address: str, *, width: int = 1280, height: int = 900, dark: bool = False) -> None:
        """Open an address in a window of this size [CSS pixels] and wait until it is loaded."""
        phone = width < 600
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=phone)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        for heard in (self.complaints, self.requests, self._events):  # of the page before, up to its last message
            heard.clear()
        self.call("Page.navigate", url=address)
        while not any(event["method"] == "Page.loadEventFired" for event in self._events):
            self._note(self._read())

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression, after its promise if it is one."""
        answer = self._evaluate("evaluate", expression=script)
        if held := answer.get("objectId"):  # the browser may collect a promise that nothing holds
            if answer.get("subtype") == "promise":
                answer = self._evaluate("awaitPromise", promiseObjectId=held, returnByValue=True)
            else:
                itself = "function() { return this; }"
                answer = self._evaluate("callFunctionOn", objectId=held, functionDeclaration=itself, returnByValue=True)
        return answer.get("value")

    def _evaluate(self, method: str, **params: Any) -> dict[str, Any]:
        answer = self.call(f"Runtime.{method}", **params)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        value: dict[str, Any] = answer["result"]
        return value

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """Save what is shown, or the whole page, as PNG."""
        answer = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(answer["data"]))

    def keep(self, name: str, folder: Path) -> None:
        """Keep a screenshot for people, in the folder that `GUSTPROOF_SCREENSHOTS` names, or in `folder`."""
        place = Path(os.environ.get("GUSTPROOF_SCREENSHOTS") or folder)
        place.mkdir(parents=True, exist_ok=True)
        self.screenshot(place / f"{name}.png")

    def faults(self) -> list[str]:
        """Return what hinders a reader of the page by ear or keyboard, or with weak eyes; see `_FAULTS`."""
        found: list[str] = self.run(_FAULTS)
        return found

    def violations(self, axe: str, *, colours: bool = True) -> list[str]:
        """Return the faults that axe-core's script finds on the page."""
        self.run(f"{axe}; true")
        found: list[str] = self.run(_AXE.replace("COLOURS", str(colours).lower()))
        return found

    def look_at(self, address: str, name: str, folder: Path, axe: str) -> None:
        """Keep screenshots of a page on laptop and phone, light and dark; check that it fits, and that all can read it.

        Axe runs on the light laptop and the dark phone, where it is installed. At last the page is printed.
        """
        for (width, height), dark in product(((1366, 768), (390, 844)), (False, True)):
            look = f"{name}-{width}-{'dark' if dark else 'light'}"
            self.open(address, width=width, height=height, dark=dark)
            self.run("typeof ready === 'undefined' || ready")
            self.keep(look, folder)
            assert self.run("document.documentElement.scrollWidth") <= width, look
            assert self.faults() == [], look
            if axe and dark is (width < 600):
                assert self.violations(axe) == [], look
            assert self.complaints == [], look
            assert [request for request in self.requests if not request.startswith((address, "data:"))] == [], look
        assert self.width_on_paper(_A4) <= _A4, name

    def width_on_paper(self, width: int) -> int:
        """Return the width of the page printed on paper of this one [CSS pixels]: what is beyond it is cut."""
        self.run("dispatchEvent(new Event('beforeprint'))")
        self.call("Emulation.setEmulatedMedia", media="print")
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=1000, deviceScaleFactor=1, mobile=False)
        wide: int = self.run("new Promise(requestAnimationFrame).then(() => document.documentElement.scrollWidth)")
        return wide

    def _read(self) -> dict[str, Any]:
        end = time.monotonic() + _PATIENCE_S
        while b"\0" not in self._unread:
            ready, _, _ = select.select([self._from], [], [], max(end - time.monotonic(), 0.0))
            chunk = os.read(self._from, 1 << 20) if ready else b""
            assert chunk, "the browser is silent or has ended"
            self._unread += chunk
        line, _, self._unread = self._unread.partition(b"\0")
        message: dict[str, Any] = json.loads(line)
        return message

    def _note(self, event: dict[str, Any]) -> None:
        method, params = event.get("method"), event.get("params", {})
        self._events.append({"method": method})
        if method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(params["exceptionDetails"]))
        elif method == "Log.entryAdded" or (
            method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning", "assert")
        ):
            self.complaints.append(json.dumps(params))


@pytest.fixture
def browser(_browser: Browser) -> Iterator[Browser]:
    """Yield a browser; without one the test is skipped, and counted.

    Its page is left, as one that replays a flight would take a tenth of a core until the last test.
    """
    yield _browser
    _browser.open("about:blank")


@pytest.fixture(scope="session")
def _browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("chromium is not installed")
    started = Browser(program, tmp_path_factory.mktemp("chromium"))
    try:
        started.start()
        yield started
    finally:
        started.close()


@pytest.fixture(scope="session")
def axe() -> str:
    """Return axe-core's script, empty if it is not installed."""
    found = importlib.util.find_spec("axe_playwright_python")
    if found is None or not found.submodule_search_locations:
        return ""
    return (Path(found.submodule_search_locations[0]) / "axe.min.js").read_text(encoding="utf-8")
