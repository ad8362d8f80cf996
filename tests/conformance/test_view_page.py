"""The live page in Debian's Chromium, with flights by real processes. No test depends on the machine's speed."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Thread

import numpy as np
import psutil
import pytest

from firmware_model.autopilot.parameters import PAUSE_NAME
from firmware_model.config.link_faults import LinkDelay
from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.numerics.rotations import euler_angles
from firmware_model.recording.journal import count_records
from gustproof.flight.routes.flight import Flight
from gustproof.flight.routes.loopback import fly_loopback
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.processes import fly
from gustproof.law.form import Law, load_law
from gustproof.show.live.live import LivePage

LAW, VEHICLE = load_law("hinf-scheduled"), load_vehicle("paper")
LAWS = (LAW, load_law("pid-fair"))
PATIENCE_S = 200.0  # kernels may have to be compiled first
DRAGGED = """(() => { const slider = document.getElementById('gust'); for (let value = 0; value <= 60; value++) {
  slider.value = value / 20; slider.dispatchEvent(new Event('input')); } })()"""
RESOLUTION = 1e-6  # of the rows; telemetry is float32


def scenario(duration_s: float) -> Scenario:
    required = (
        Requirement(metric=Metric.PEAK, at_most=10.0),
        Requirement(metric=Metric.TORQUE_PEAK, at_most=1e-3),
    )
    return replace(load_scenario("paper-turbulence"), duration_s=duration_s, require=required)


class Watched:
    """A flight in a thread, as the command line flies it, and its page."""

    def __init__(self, page: LivePage, script: Scenario, out: Path, *, real_time: bool, twice: bool) -> None:
        self.page, self.out, self.flight, self.again = page, out, None, None
        self._thread = Thread(target=self._fly, args=(script, out, real_time, twice), daemon=True)
        self._thread.start()

    def _fly(self, script: Scenario, out: Path, real_time: bool, twice: bool) -> None:
        self.flight = self._fly_once(script, LAWS[self.page.wait()], out, real_time=real_time)
        if twice:
            self.again = self._fly_once(script, LAWS[self.page.wait_again()], out / "again", real_time=real_time)

    def _fly_once(self, script: Scenario, law: Law, out: Path, *, real_time: bool) -> Flight:
        flight = fly(
            script,
            law,
            vehicle=VEHICLE,
            out=out,
            real_time=real_time,
            default_ports=False,
            on_listening=self.page.watch,
        )
        self.page.end(flight.message, flight.records, report=lambda: f"<title>{law.name}</title>")
        return flight

    def flown(self) -> Flight:
        until(lambda: self.flight is not None, "the flight ends")
        return self.flight


@contextmanager
def watched(script: Scenario, out: Path, *, real_time: bool, twice: bool = False) -> Iterator[Watched]:
    with LivePage(script, LAWS, VEHICLE, real_time=real_time) as page:
        flight = Watched(page, script, out, real_time=real_time, twice=twice)
        try:
            yield flight
        finally:
            page._start(True)
            page._request(PAUSE_NAME, 0.0)
            flight._thread.join(PATIENCE_S)


def until(reached: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not reached():
        assert time.monotonic() < end, f"{what}: not within {PATIENCE_S:g} s"
        time.sleep(0.02)


def phase(browser) -> str:
    return browser.run("globalThis.gustproof?.facts.phase ?? ''")


def click(browser, name: str, share: float = 0.5) -> None:
    """Click with the mouse, at a share of the width."""
    box = f"document.getElementById('{name}').getBoundingClientRect()"
    left, top, width, height = browser.run(f"[{box}.left, {box}.top, {box}.width, {box}.height]")
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        browser.call(
            "Input.dispatchMouseEvent", type=kind, x=left + share * width, y=top + 0.5 * height,
            button="none" if kind == "mouseMoved" else "left", clickCount=int(kind != "mouseMoved"),
        )  # fmt: skip


def slide(browser, share: float) -> None:
    """Drag the slider of the gusts; the grip stays within its ends."""
    click(browser, "gust", min(max(share, 0.01), 0.99))


def vehicle_process() -> psutil.Process:
    (found,) = [child for child in psutil.Process().children() if "firmware_model" in child.cmdline()]
    return found


def drawn(browser, canvas: str) -> int:
    """Return how many colours a picture has."""
    return browser.run(
        f"(() => {{ const c = document.querySelector('{canvas}'); const d = new Uint32Array(c.getContext('2d')"
        ".getImageData(0, 0, c.width, c.height).data.buffer); return new Set(d).size; })()"
    )


def text(browser, name: str) -> str:
    return browser.run(f"document.getElementById('{name}').textContent")


def assert_clean(browser, page: LivePage) -> None:
    browser.run("0")  # all earlier messages are read with the answer
    assert browser.complaints == []
    assert browser.requests
    assert [request for request in browser.requests if not request.startswith((page.address, "data:"))] == []


def assert_attitude_is_the_recordings(browser, flight: Flight) -> None:
    """All rows of the page are those of the journal, and the last one is drawn at the end of the flight.

    In real time the page may also have the state after the last sample, which no record has.
    """
    rows = np.array(browser.run("gustproof.rows.attitude"))
    sample = np.rint(rows[:, 0] / flight.scenario.dt).astype(int)
    flown = sample < len(flight.records)
    assert np.all(flown[:-1])
    records = flight.records[sample[flown]]
    np.testing.assert_allclose(rows[flown, 1:5], records["q_NB"], atol=RESOLUTION)
    np.testing.assert_allclose(rows[flown, 5:8], records["omega_B"], atol=RESOLUTION)
    until(lambda: browser.run("gustproof.shown.t === gustproof.rows.attitude.at(-1)[0]"), "the last row is drawn")
    last = rows[-1, 1:5]
    assert browser.run("gustproof.shown.q") == pytest.approx(last.tolist(), abs=2 * RESOLUTION)
    until(lambda: abs(told_angles(browser) - np.degrees(euler_angles(last[np.newaxis])[0])).max() < 0.0051, "angles")


def assert_age_is_the_recordings(browser, flight: Flight) -> None:
    """Each row has the oldest command since the row before; that of the last row is shown as text."""
    age_ms = flight.scenario.sample_us / 1000 * flight.records["command_age"][:, 0]
    last = range(0, len(age_ms), 5)
    oldest = [age_ms[max(sample - 4, 0) : sample + 1].max() for sample in last]
    rows = np.array(browser.run("gustproof.rows.age"), dtype=float)
    np.testing.assert_allclose(rows[:, 0], flight.scenario.dt * np.array(last), atol=RESOLUTION)
    np.testing.assert_array_equal(rows[:, 1], oldest)
    until(lambda: text(browser, "age") == f"{oldest[-1]:g} ms old", "the age is told")


def set_speed(browser, speed: str) -> None:
    browser.run(f"speed.value = '{speed}', speed.dispatchEvent(new Event('change'))")


def assert_is_played_at_the_clocks_pace(browser) -> None:
    """Samples that came long ago are shown no faster than they were flown, and what comes is not told before."""
    until(lambda: phase(browser) == "over" and browser.run("gustproof.shown.t > 0"), "it is played")
    state = "[performance.now() / 1000, gustproof.shown.t, gustproof.rows.attitude.at(-1)[0]]"
    (begun_s, from_s, last_s), later = browser.run(state), f"gustproof.shown.t > {0.3 + browser.run(state)[1]}"
    assert from_s < last_s
    assert text(browser, "phase") == "flying"
    assert browser.run("lights.querySelectorAll('.dark').length") == 2
    until(lambda: browser.run(later), "it goes on")
    now_s, to_s, _ = browser.run(state)
    assert to_s - from_s <= now_s - begun_s + 0.3  # two frames apart, on a busy machine
    roll, told = browser.run("['#charts figure b', '#angles'].map((each) => document.querySelector(each).textContent)")
    assert float(roll.replace("−", "-")) == pytest.approx(float(told.split()[1].replace("−", "-")[:-1]), abs=0.006)
    click(browser, "pause")
    until(lambda: text(browser, "pause") == "Play", "it stands")
    stands = browser.run("new Promise(requestAnimationFrame).then(() => gustproof.shown.t)")
    assert browser.run("new Promise((seen) => setTimeout(() => seen(gustproof.shown.t), 100))") == stands < last_s
    click(browser, "pause")


def assert_can_be_played_again(browser, flight: Flight) -> None:
    browser.run("scrub.value = 1.5, scrub.dispatchEvent(new Event('input'))")
    until(lambda: browser.run("gustproof.shown.t") == 1.5, "the time is chosen")
    assert browser.run("gustproof.shown.q") == pytest.approx(flight.records["q_NB"][375].tolist(), abs=2 * RESOLUTION)
    set_speed(browser, "4")
    click(browser, "pause")
    until(lambda: browser.run("gustproof.shown.t > 1.5 && !gustproof.play.on"), "it has been played")
    set_speed(browser, "Infinity")


def told_angles(browser) -> np.ndarray:
    words = text(browser, "angles").replace("−", "-").replace("°", "").split()
    return np.array([float(word.rstrip(",")) for word in words[1:6:2]])


def fly_another_law(browser, flight: Watched) -> None:
    """Fly again with the other law: both flights are on the page, and either is drawn by choice."""
    first = browser.run("gustproof.shown.q")
    until(lambda: browser.run("!start.disabled && start.textContent === 'Fly again' && !report.hidden"), "may go on")
    browser.run("laws.value = 1, laws.dispatchEvent(new Event('change'))")
    click(browser, "start")
    until(lambda: browser.run("gustproof.tracks.length === 2 && gustproof.facts.phase === 'over'"), "over again")
    assert browser.run("gustproof.tracks.map(({ law, rows }) => [law, rows.attitude.length])") == [
        [LAW.name, 200],
        [LAWS[1].name, 200],
    ]
    until(lambda: flight.again is not None, "the flight ends")
    assert_attitude_is_the_recordings(browser, flight.again)
    assert browser.run("[compare.checkVisibility(), track.value, against.value]") == [True, "1", "0"]
    browser.keep("live-two-laws-1366-light", flight.out)
    browser.run("track.value = '0', track.dispatchEvent(new Event('change'))")
    until(lambda: browser.run("gustproof.shown.q") == first, "the first flight is drawn again")


def test_lockstep_flight_is_started_paused_and_shown_and_is_the_same_to_the_bit(browser, axe, tmp_path):
    late = LinkDelay(kind="delay", direction="to_vehicle", delay_s=0.012, start_s=2.0)
    script = replace(scenario(4.0), link=(late,))
    with watched(script, tmp_path, real_time=False, twice=True) as flight:
        browser.open(flight.page.address)
        until(lambda: phase(browser) == "ready", "the page is ready")
        click(browser, "start")
        click(browser, "start")
        assert_is_played_at_the_clocks_pace(browser)
        set_speed(browser, "Infinity")
        flown = flight.flown()
        assert flown.outcome is FlightOutcome.DONE
        assert len(browser.run("gustproof.rows.attitude")) == 200
        assert_attitude_is_the_recordings(browser, flown)
        assert_age_is_the_recordings(browser, flown)
        assert text(browser, "age") == "16 ms old"
        for canvas in ("#vehicle", "#horizon", *(f"#charts figure:nth-child({n}) canvas" for n in range(1, 6))):
            until(lambda canvas=canvas: drawn(browser, canvas) > 20, f"{canvas} is drawn")
        assert browser.run("[...lights.children].map((light) => light.className)") == ["held", "failed"]
        assert text(browser, "mode").startswith("OFFBOARD")
        assert_can_be_played_again(browser, flown)
        assert browser.run("gustproof.shown.frames") > 0
        fly_another_law(browser, flight)
        browser.look_at(flight.page.address, "live", tmp_path, axe)
        assert browser.run("laws.selectedOptions[0].textContent") == "pid-fair"  # in another window, too
        browser.open(f"{flight.page.address}report")
        assert browser.run("document.title") == "pid-fair"
        assert_clean(browser, flight.page)
    assert flight.again.records.tobytes() == fly_loopback(script, LAWS[1], vehicle=VEHICLE).tobytes()
    assert flown.records.tobytes() == fly_loopback(script, LAW, vehicle=VEHICLE).tobytes()


@pytest.mark.usefixtures("started_as_users")
def test_pause_and_gusts_act_in_mid_flight(browser, tmp_path):
    script = scenario(3600.0)  # nobody waits for its end
    with watched(script, tmp_path, real_time=False) as flight:
        browser.open(flight.page.address)
        until(lambda: phase(browser) == "ready", "the page is ready")
        slide(browser, 0.0)
        until(lambda: text(browser, "scale") == "× 0.00", "the gusts' scale is told")
        click(browser, "start")
        until(lambda: browser.run("gustproof.rows.wind.length") > 100, "the flight is shown")
        click(browser, "pause")
        until(lambda: browser.run("gustproof.facts.paused"), "pause")
        (journal,) = tmp_path.glob("*.journal")
        stands = count_records(journal)
        until(lambda: browser.run("gustproof.rows.wind.length") == -(-stands // 5), "what stands is shown")
        assert text(browser, "pause") == "Resume"
        assert browser.run("Math.max(...gustproof.rows.wind.slice(1).flatMap((row) => row.slice(1)))") == 0.0
        browser.run(DRAGGED)
        until(lambda: text(browser, "scale") == "× 3.00", "the last of many wishes holds")
        slide(browser, 0.5)
        until(lambda: text(browser, "scale") == "× 1.50", "the gusts' scale is told back")
        assert count_records(journal) == stands
        click(browser, "pause")
        until(lambda: count_records(journal) > stands + 500, "the flight goes on")
        click(browser, "pause")
        assert_clean(browser, flight.page)
        vehicle_process().terminate()
        flown = flight.flown()
    assert flown.outcome is FlightOutcome.AUTOPILOT_LOST
    gust = np.linalg.norm(flown.records["gust_B"], axis=1)
    assert np.all(gust[1:stands] == 0.0)  # sample 0 was taken before any request
    assert np.all(gust[-250:] > 0.0)


def test_page_that_is_closed_in_mid_flight_changes_nothing(browser, tmp_path):
    script = scenario(2.0)
    with watched(script, tmp_path, real_time=False) as flight:
        browser.open(flight.page.address)
        until(lambda: phase(browser) == "ready", "the page is ready")
        browser.run("fetch('pause', {method: 'POST', body: 'true'})")  # so that it is still under way
        click(browser, "start")
        until(lambda: phase(browser) == "flying", "the flight begins")
        assert_clean(browser, flight.page)
        browser.open("about:blank")
        until(lambda: not flight.page._server.readers, "the page is gone")
        flight.page._pause(False)
        flown = flight.flown()
    assert flown.outcome is FlightOutcome.DONE
    assert flown.records.tobytes() == fly_loopback(script, LAW, vehicle=VEHICLE).tobytes()


@pytest.mark.parametrize("dark", [False, True])
def test_real_time_flight_is_watched_by_telemetry_at_phone_width(browser, tmp_path, dark):
    with watched(scenario(3.0), tmp_path, real_time=True) as flight:
        browser.open(flight.page.address, width=390, height=844, dark=dark)
        until(lambda: phase(browser) == "ready", "the page is ready")
        assert browser.run("document.getElementById('pause').checkVisibility()") is False
        click(browser, "start")
        until(lambda: phase(browser) == "over", "the flight is over")
        flown = flight.flown()
        assert flown.outcome is FlightOutcome.DONE
        assert browser.run("gustproof.rows.attitude.length") > 10  # of 150, where this process is kept waiting
        assert browser.run("gustproof.rows.torque.length") > 10
        assert_attitude_is_the_recordings(browser, flown)
        assert_age_is_the_recordings(browser, flown)
        assert browser.run("document.documentElement.scrollWidth") <= 390
        background = browser.run("getComputedStyle(document.body).backgroundColor")
        assert background == ("rgb(18, 22, 26)" if dark else "rgb(246, 247, 249)")
        assert_clean(browser, flight.page)
