"""`gustproof report` in Debian's Chromium, as a colleague opens the file."""

import base64
import csv
import io
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import load_vehicle
from gustproof.flight.recording.bag import read_bag, write_bag
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.flight import FlightPlan
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.scoring.metrics import attitude
from gustproof.law.form import load_law
from gustproof.show.report.html.judgement_page import write_judgement
from gustproof.show.report.html.page import render_page
from gustproof.show.report.html.runs import ReportRun
from gustproof.studies.rate import judge as judging

LAWS = ("hinf-d1", "pid-fair")
DURATION = 12.0
FRAME = "new Promise((shown) => requestAnimationFrame(() => requestAnimationFrame(shown)))"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two flights of the paper's gusts, as folders of `gustproof fly`."""
    folder, vehicle = tmp_path_factory.mktemp("flights"), load_vehicle("paper")
    scenario = replace(load_scenario("paper-turbulence"), duration_s=DURATION)
    for name in LAWS:
        plan = FlightPlan(scenario, load_law(name), vehicle, 1, False)
        records = fly_direct(scenario, plan.controller, vehicle=vehicle, seed=1)
        write_bag(folder / name / plan.name, records, {**plan.metadata(), "outcome": "done"})
    return [folder / name for name in LAWS]


@pytest.fixture(scope="module")
def page(runs):
    """The report's file, made by the command."""
    path = runs[0].parent / "report.html"
    command = [sys.executable, "-m", "gustproof", "report", *map(str, runs), "-o", str(path)]
    told = subprocess.run(command, capture_output=True, text=True, check=True)
    assert told.stdout.startswith(f"2 flights in {path}\nnext: ")
    return path


@pytest.fixture(scope="module")
def flights(runs):
    """The contents of the bags."""
    return [read_bag(next(run.iterdir()))[1] for run in runs]


@pytest.fixture
def opened(browser, page):
    """Open the page, and check at the end that it logged no complaint and requested nothing else.

    Charts out of sight are drawn only where all are wanted.
    """

    def see(*, whole=False, **window):
        browser.open(page.as_uri(), **window)
        browser.run("ready.then(drawAll)" if whole else "ready")
        return browser

    yield see
    assert browser.complaints == []
    assert browser.requests == [page.as_uri()]


def drag(browser, chart, start, stop):
    """Drag the mouse across a chart, from one share of its width to another."""
    browser.run(f"charts.drawn[{chart}].plot.root.scrollIntoView({{block: 'center', behavior: 'instant'}})")
    browser.run(FRAME)  # the small views that stay in sight move what is below them
    box = f"charts.drawn[{chart}].plot.over.getBoundingClientRect()"
    x, y, width, height = browser.run(f"[{box}.left, {box}.top, {box}.width, {box}.height]")
    middle = y + height / 2
    for kind, share in (("mouseMoved", start), ("mousePressed", start), ("mouseMoved", stop), ("mouseReleased", stop)):
        pressed = 0 if share == start and kind == "mouseMoved" else 1
        browser.call("Input.dispatchMouseEvent", type=kind, x=x + share * width, y=middle, button="left",
                     buttons=pressed, clickCount=1)  # fmt: skip
    browser.run(FRAME)


def test_every_curve_of_every_chart_is_drawn(opened):
    browser = opened(whole=True)
    counts = browser.run("Object.values(page.sections).map((groups) => groups.length)")
    assert all(count > 0 for count in counts)
    undrawn = browser.run("""(async () => {
      const pixels = ({ ctx: { canvas } }) => {  // of a copy: a canvas that is read often is one that is drawn slowly
        const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
        copy.drawImage(canvas, 0, 0);
        return copy.getImageData(0, 0, canvas.width, canvas.height).data;
      };
      const undrawn = [];
      for (const { chart, plot } of charts.drawn) {
        const scales = Object.entries(plot.scales).map(([key, { min, max }]) => [key, { min, max }]);
        for (let i = 1; i < plot.series.length; i++) {
          const before = pixels(plot);
          plot.batch(() => {  // hidden at the same scales, so that no axis moves
            plot.setSeries(i, { show: false });
            for (const [key, range] of scales) plot.setScale(key, range);
          });
          await new Promise((done) => setTimeout(done));
          const same = pixels(plot).every((value, k) => value === before[k]);
          if (same) undrawn.push(`${chart.title}: ${plot.series[i].label}`);
          plot.setSeries(i, { show: true });
          await new Promise((done) => setTimeout(done));
        }
      }
      return undrawn;
    })()""")
    assert undrawn == []
    assert browser.run("charts.drawn.length") >= 30


def test_the_attitude_shown_is_that_of_the_bag(opened, flights):
    browser = opened()
    for time in (0.0, 3.1, 7.772, DURATION - 0.004):
        browser.run(f"scrub.value = {time}, scrub.dispatchEvent(new Event('input'))")
        texts = browser.run("[...document.querySelectorAll('.angles')].map((angles) => angles.textContent)")
        sample = round(time * 250)
        for text, records in zip(texts, flights, strict=True):
            shown = [float(value) for value in re.findall(r"-?\d+\.\d+", text.replace("−", "-"))]
            assert shown == pytest.approx(np.degrees(attitude(records))[sample], abs=6e-4)  # three decimals


def test_the_vehicle_is_drawn_as_the_bag_has_it_turned(opened, flights):
    """Compare rotor hubs with an independent rotation matrix and camera."""
    browser = opened()
    azimuth, elevation = browser.run("[camera.azimuth, camera.elevation]")
    ahead = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    hub_B = np.array([0.62 / np.sqrt(2), 0.62 / np.sqrt(2), -0.08])  # front right
    sample = int(np.argmax(np.abs(attitude(flights[0])[:, 0])))
    browser.run(f"showMoment({sample * 0.004})")
    for i, records in enumerate(flights):
        arm = browser.run(f"document.querySelectorAll('.attitude')[{i}].querySelector('.arm').getAttribute('d')")
        tip = [float(value) for value in arm.rpartition("L")[2].split()]
        hub_N = Rotation.from_quat(records["q_NB"][sample, [1, 2, 3, 0]]).apply(hub_B)
        assert tip == pytest.approx([hub_N @ right, hub_N @ np.cross(ahead, right)], abs=1e-3)


def test_nose_up_is_up_and_right_wing_down_is_down(opened):
    browser = opened()
    browser.run("camera.azimuth = 0, camera.elevation = 0.1")
    heights = "replay.runs[0].view.svg.querySelectorAll('.rotor')].map((rotor) => rotor.getBBox().y)"
    for q, higher, lower in (("[0.98, 0, 0.2, 0]", (0, 2), (1, 3)), ("[0.98, 0.2, 0, 0]", (1, 2), (0, 3))):
        y = browser.run(f"replay.runs[0].view.update({q}, null), [...{heights}")
        assert max(y[i] for i in higher) < min(y[i] for i in lower)


def test_the_replay_plays_and_pauses(opened):
    browser = opened()
    browser.run("play.click()")
    for _ in range(3):
        browser.run(FRAME)
    browser.run("play.click()")
    stopped = browser.run("replay.time")
    assert 0.0 < stopped < DURATION
    browser.run(FRAME)
    assert browser.run("[replay.time, play.textContent]") == [stopped, "Play"]
    assert browser.run("Number(scrub.value)") == pytest.approx(stopped)


def test_a_drag_zooms_all_time_histories_and_a_click_sets_the_replay(opened):
    browser = opened(whole=True)
    whole = browser.run("[charts.start, charts.end]")
    drag(browser, 0, 0.25, 0.5)
    ranges = browser.run("charts.ofTime().map(({ plot }) => [plot.scales.x.min, plot.scales.x.max])")
    assert len(ranges) > 15
    assert all(shown == ranges[0] for shown in ranges)
    assert ranges[0] == pytest.approx([0.25 * whole[1], 0.5 * whole[1]], abs=0.2)
    assert browser.run("[Number(from.value), Number(to.value)]") == pytest.approx(ranges[0], abs=1e-3)
    drag(browser, 4, 0.5, 0.5)
    assert browser.run("replay.time") == pytest.approx(0.375 * whole[1], abs=0.1)
    browser.run("document.getElementById('whole').click()")
    browser.run(FRAME)
    assert browser.run("charts.ofTime().every(({ plot }) => plot.scales.x.max === charts.end)")


def test_a_cursor_in_one_chart_reads_all_of_them(opened, flights):
    browser = opened(whole=True)
    drag(browser, 0, 0.5, 0.5)
    read = browser.run("charts.drawn.slice(0, 6).map(({ plot }) => plot.cursor.idx)")
    assert len(set(read)) == 1
    values = browser.run("[...charts.drawn[0].plot.root.querySelectorAll('.u-value')].map((cell) => cell.textContent)")
    phi = sorted(np.degrees(attitude(records))[read[0], 0] for records in flights)
    assert sorted(float(value.replace("−", "-")) for value in values[1:]) == pytest.approx(phi, rel=1e-3)


@pytest.mark.parametrize("width", [320, 390, 1280])
def test_the_page_fits_its_window(opened, width):
    browser = opened(whole=True, width=width, height=800)
    assert browser.run("document.documentElement.scrollWidth") <= width
    widest = browser.run("Math.max(...charts.drawn.map(({ plot }) => plot.root.getBoundingClientRect().right))")
    assert widest <= width
    apart = browser.run(  # a tile's values from the middle of their flight's name, which they stand beside or below
        "[...document.querySelectorAll('.tile li')].map((li) => [li.querySelector('.name'), "
        "li.querySelector('b, strong')].map((part) => part.getBoundingClientRect())).map(([name, value]) => "
        "[value.top + value.height / 2 - name.top - name.height / 2, name.width])"
    )
    assert len(apart) == 8
    assert all(-5.0 < down < (40.0 if width < 600 else 5.0) and wide > 60.0 for down, wide in apart)


def test_a_curve_joins_no_two_samples_over_what_is_missing(opened):
    browser = opened(whole=True)
    assert browser.run("charts.drawn.every(({ plot }) => plot.series.slice(1).every(({ spanGaps }) => !spanGaps))")
    # samples of two curves are joined in one table: there, another curve's x is no gap
    joined = "uPlot.join([[[1, 3, 5], [1, null, 5]], [[2, 4], [2, 4]]])"
    assert browser.run(f"{joined}[1].map((y) => y === undefined ? 'other' : y)") == [1, "other", None, "other", 5]


@pytest.mark.parametrize("paper", [500, 718, 1043])  # A5, A4 upright and across, within 1 cm
def test_on_paper_every_chart_is_whole_and_light(opened, paper):
    browser = opened(dark=True)
    assert browser.width_on_paper(paper) <= paper
    shown = browser.run(
        "[...document.querySelectorAll('.chart')].map((place) => [...place.querySelectorAll('canvas')]"
        ".filter((each) => each.clientWidth).map((canvas) => [canvas, canvas.getBoundingClientRect()])"
        ".map(([canvas, { left, right }]) => [left, right, canvas.toDataURL().length]))"
    )
    assert len(shown) == browser.run("charts.drawn.length + charts.waiting.size") > 20
    for (left, right, drawn), *others in shown:
        assert 0 <= left < right <= paper
        assert drawn > 3000  # a blank picture has a tenth of it
        assert others == []
    assert browser.run("themed('--ink')") == "#1d2329"
    browser.run("dispatchEvent(new Event('afterprint'))")
    assert browser.run("document.querySelectorAll('.chart > canvas').length") == 0
    assert browser.run("document.documentElement.dataset.theme") is None


def test_a_printer_gets_the_charts_in_the_zoom_without_hidden_curves(opened):
    browser = opened()
    browser.run("addEventListener('beforeprint', () => { window.printed = charts.paper.map(({ series, scales }) => "
                "[series.slice(1).filter(({ show }) => show).length, scales.x.min, scales.x.max]); })")  # fmt: skip
    browser.run("zoom(2, 5), document.querySelector('#legend button').click()")
    pdf = base64.b64decode(browser.call("Page.printToPDF", paperWidth=8.27, paperHeight=11.7)["data"])
    assert pdf.startswith(b"%PDF-")
    assert browser.run("printed")[0] == [1, 2, 5]
    assert browser.run("charts.paper.length") == 0


def luminance(shown):
    return float(np.mean(np.asarray(Image.open(io.BytesIO(shown)).convert("L"))))


def test_the_page_is_light_or_dark_as_the_reader_s_system_is(opened, tmp_path):
    shown = {}
    for dark in (False, True):
        browser = opened(dark=dark)
        browser.run("document.getElementById('time').scrollIntoView({behavior: 'instant'})")
        browser.run(FRAME)
        browser.screenshot(tmp_path / "shown.png")
        shown[dark] = luminance((tmp_path / "shown.png").read_bytes())
    assert shown[False] > 200.0
    assert shown[True] < 60.0


def test_a_change_of_the_system_s_colours_repaints_the_charts(opened):
    browser = opened(whole=True)
    axis = "charts.drawn[0].plot.ctx.canvas.toDataURL()"
    light = browser.run(axis)
    browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    browser.run(FRAME)
    assert browser.run(axis) != light


def test_a_group_is_saved_as_a_picture_for_paper(opened):
    browser = opened(dark=True)
    data = browser.run("picture(page.sections.time[0]).then((canvas) => canvas.toDataURL('image/png'))")
    content = base64.b64decode(data.partition(",")[2])
    picture = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))
    assert picture.shape[1] >= 1800  # 6 inches at 300 dots an inch
    assert luminance(content) > 220.0
    blue, vermillion = np.array([0x00, 0x72, 0xB2]), np.array([0xD5, 0x5E, 0x00])
    for third in np.array_split(picture, 3):
        for colour in (blue, vermillion):
            assert np.count_nonzero(np.all(np.abs(third - colour.astype(int)) < 30, axis=2)) > 200
    assert browser.run("document.documentElement.dataset.theme") is None


def test_a_reader_by_ear_keyboard_or_weak_eyes_is_not_hindered(browser, axe, page, tmp_path):
    browser.look_at(page.as_uri(), "report", tmp_path, axe)
    browser.run("document.getElementById('frequency').scrollIntoView({behavior: 'instant'})")
    browser.run(FRAME)
    browser.keep("report-frequency-390-dark", tmp_path)


def test_a_judgement_s_page_is_a_report_with_verdict_and_limits(browser, axe, tmp_path, monkeypatch):
    for name, value in (("worst_case", refuse), ("_prove", lambda *_: (None, "")), ("_least_error", lambda *_: None)):
        monkeypatch.setattr(judging, name, value)
    scenario = replace(load_scenario("paper-turbulence"), duration_s=2.0)
    found = judging.judge_law(load_law("pid-fair"), load_vehicle_set("paper"), scenario)
    write_judgement(found, None, ("a remark",), tmp_path / "judgement.html")
    browser.look_at((tmp_path / "judgement.html").as_uri(), "judgement", tmp_path, axe)
    browser.run("drawAll()")
    told = browser.run("document.getElementById('verdict').textContent")
    assert "fragile: pid-fair" in told
    assert "a remark" in told
    limits = "charts.drawn.find(({ chart }) => chart.title === 'roll: |S| [dB]')"
    assert browser.run(f"{limits}.chart.marks.map(({{ label }}) => label)") == ["nominal ≤ 2", "spreads ≤ 2.5"]
    assert browser.run(f"{limits}.plot.scales.y.max") > 20.0 * np.log10(2.5)
    pressed = browser.run("""Object.fromEntries(Array.from(document.querySelectorAll("#legend button"),
      (button) => [button.textContent, button.getAttribute("aria-pressed")]))""")
    assert {pressed[name] for name in ("in the air", "where it fails")} == {"true", "false"}
    attitude = "charts.drawn.find(({ chart }) => chart.title.startsWith('roll φ'))"
    assert browser.run(f"{attitude}.plot.series.slice(1, 3).map(({{ show }}) => show)") == [False, True]


def refuse(*_, **__):
    raise ValueError("not searched here")


def test_the_replay_and_the_one_legend_stay_in_sight(opened):
    browser = opened()
    assert browser.run("getComputedStyle(minis).display") == "none"
    drawn, waiting = browser.run("[charts.drawn.length, charts.waiting.size]")
    assert drawn < 10 < waiting  # drawn as they come near
    browser.run("document.getElementById('spectra').scrollIntoView({behavior: 'instant'})")
    for _ in range(3):
        browser.run(FRAME)
    assert browser.run("charts.drawn.at(-1).chart.group").startswith("Spectrum")
    assert browser.run("charts.waiting.size") > 10
    top, bottom = browser.run("[dock.getBoundingClientRect().top, dock.getBoundingClientRect().bottom]")
    assert top == 0.0
    assert bottom < 200.0
    assert browser.run("[getComputedStyle(minis).display, minis.querySelectorAll('svg').length]") == ["flex", 2]
    names = browser.run("[...document.querySelectorAll('#legend button')].map((button) => button.textContent)")
    assert names == [*LAWS, "all runs"]
    browser.run("document.querySelector('#legend button').click(); drawAll()")
    series = "chart.curves.map(({ label }, i) => [label, plot.series[i + 1].show])"
    shown = f"charts.drawn.flatMap(({{ chart, plot }}) => {series})"
    assert {label for label, is_shown in browser.run(shown) if not is_shown} == {LAWS[0]}


def test_one_scale_in_a_row_is_a_choice_and_play_stays_in_the_zoom(opened):
    browser = opened(whole=True)
    heights = "charts.drawn.slice(0, 3).map(({ plot }) => [plot.scales.y.min, plot.scales.y.max])"
    assert len({tuple(each) for each in browser.run(heights)}) == 3
    browser.run("alike.click()")
    browser.run(FRAME)
    assert len({tuple(each) for each in browser.run(heights)}) == 1
    browser.run("zoom(5, 5.05); play.click()")
    for _ in range(20):
        browser.run(FRAME)
    assert browser.run("[replay.playing, replay.time]") == [False, 5.05]


def test_the_time_axis_ends_with_the_flight_and_no_label_covers_another(opened):
    browser = opened(whole=True)
    assert browser.run("charts.drawn[0].plot.axes[0]._splits.at(-1)") == DURATION
    heights = browser.run(
        "(() => { const taken = []; return [0, 5, 30].map((x) => freePlace(taken, [x, 7], 20, 11, 1)[1]); })()"
    )
    assert heights == [7, 18, 7]


def test_what_is_shown_is_saved_as_a_table(opened, flights):
    browser = opened()
    browser.run("zoom(2, 3); document.querySelectorAll('#legend button')[1].click()")
    rows = [*csv.DictReader(io.StringIO(browser.run("tableText(page.sections.time[0])")))]
    assert {row["curve"] for row in rows} == {LAWS[0]}
    roll = [row for row in rows if row["panel"] == "1"]
    assert [float(row["x"]) for row in roll] == pytest.approx(0.004 * np.arange(500, 751))
    assert [float(row["y"]) for row in roll] == pytest.approx(np.degrees(attitude(flights[0]))[500:751, 0], rel=1e-6)


def test_a_page_of_three_flights_of_a_minute_is_below_3_mb():
    vehicle, runs = load_vehicle("paper"), []
    for law in map(load_law, (*LAWS, "flagship")):
        scenario = load_scenario("paper")
        records = fly_direct(scenario, law, vehicle=vehicle, seed=1)
        told = {"outcome": FlightOutcome.DONE, "message": "", "versions": {"gustproof": "0"}, "label": law.name}
        runs.append(ReportRun(scenario=scenario, controller=law, vehicle=vehicle, seed=1, records=records, **told))
    assert len(render_page(runs).encode()) < 3_000_000
