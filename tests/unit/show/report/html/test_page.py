import base64
import json
import re
import zlib
from dataclasses import replace
from html import escape

import numpy as np
import pytest

from firmware_model.config.requirement import Requirement
from firmware_model.config.vehicle import load_vehicle
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.recording.bag import write_bag
from gustproof.flight.routes.flight import FlightPlan
from gustproof.show.report.html import loops
from gustproof.show.report.html.page import NumberBlock, render_page
from gustproof.show.report.html.runs import read_runs
from gustproof.show.report.html.tables import render_headline


@pytest.fixture(scope="module", autouse=True)
def _laws_are_analysed_once():
    """Let pages find the loops of a law and a vehicle once: no test here changes a law."""

    def once(function):
        found = {}

        def of(law, *others):
            key = (law.name, *others[:1], *((script.dt, script.delay_samples) for script in others[1:]))
            if key not in found:
                found[key] = function(law, *others)
            return found[key]

        return of

    with pytest.MonkeyPatch.context() as patch:
        for name in ("hover_loop", "axis_robustness_over_frequency", "_rederive"):
            patch.setattr(loops, name, once(getattr(loops, name)))
        yield


@pytest.fixture(scope="module")
def runs(recorded_once):
    rates = np.random.default_rng(1).standard_normal((500, 3))
    laws = {"pid-fair": rates, "pid-default": -rates}
    return read_runs([recorded_once(name, law=name, omega_B=values) for name, values in laws.items()])


@pytest.fixture(scope="module")
def page(runs):
    return render_page(runs)


def script(page, name):
    (text,) = re.findall(rf'<script type="[^"]*" id="{name}">(.*?)</script>', page, flags=re.DOTALL)
    return text


def numbers(page):
    planes = zlib.decompress(base64.b64decode(script(page, "page-numbers")))
    return np.frombuffer(np.frombuffer(planes, dtype=np.uint8).reshape(4, -1).T.tobytes(), dtype="<f4")


@pytest.mark.slow
def test_the_curves_in_the_page_are_the_recording_s(runs, page):
    values, document = numbers(page), json.loads(script(page, "page-data"))
    (group,) = (group for group in document["sections"]["time"] if group["title"] == "Body rates")
    for k, chart in enumerate(group["charts"]):
        for curve in chart["curves"]:
            (start, length) = curve["y"]
            expected = np.degrees(runs[curve["colour"]].records["omega_B"][:, k])
            assert np.array_equal(values[start : start + length], expected.astype("<f4"))


def test_the_same_flights_give_the_same_bytes(runs, page):
    assert render_page(runs) == page


def test_words_of_a_user_are_words_on_the_page(runs):
    hostile = "</script><script>alert('1 & 2')</script>{{title}}"
    name = hostile.replace("/", "")  # a scenario's name has no slash
    odd = replace(runs[0], label=hostile, scenario=replace(runs[0].scenario, name=name, description=hostile))
    page = render_page([odd])
    assert "<script>alert" not in page
    assert json.loads(script(page, "page-data"))["runs"][0]["label"] == hostile
    assert page.count("&lt;/script&gt;") >= 3


def test_the_tables_hold_figures_and_margins_of_each_flight(runs, page):
    assert all(f"{run.law.name}, {run.law.order} states" in page for run in runs)
    assert re.search(r"<td class='num'>1\.36</td>", page)  # pid-fair's sensitivity peak
    assert page.count('scope="col">') == len(runs) + 9


def test_what_a_scenario_requires_is_shown_with_its_margin(recorded):
    """Roll is 2 degrees throughout: within 3, beyond 1."""
    turned = np.array([np.cos(np.radians(1.0)), np.sin(np.radians(1.0)), 0.0, 0.0])
    limits = ({"at_most": 3.0}, {"at_most": 1.0})
    require = tuple(Requirement(metric="peak_deg", axis="roll", **limit) for limit in limits)
    page = render_page(read_runs([recorded("run", require=require, q_NB=turned)]))
    assert re.findall(r'<span class="(good|bad)">(.*?)</span>', page) == [("good", "held, 1"), ("bad", "not held, -1")]
    assert page.count("peak, roll [deg]") == 3  # and among the figures
    assert "Requirements" not in render_page(read_runs([recorded("free", require=())]))


def test_the_page_says_what_real_time_cost_the_flights_that_were_flown_in_it(runs, page):
    paced = replace(runs[0], timing={"missed": 0, "held": 125, "late_samples": 124, "missed_samples": 3})
    row = r"<th[^>]*>samples late at the law</th><td>124</td><td></td>"
    assert re.search(row, render_page([paced, runs[1]]))
    assert "late at the law" not in page


def test_what_was_not_flown_to_its_end_is_not_judged(recorded):
    whole = read_runs([recorded("run", require=(Requirement(metric="peak_deg", at_most=1.0),))])[0]
    page = render_page([replace(whole, records=whole.records[:100])])
    assert '<span class="interval">not judged</span>' in page
    assert '<strong class="interval">not judged</strong>' in page
    assert "not held" not in page


def test_another_vehicles_law_is_named(runs, page):
    assert "was designed for vehicle" not in page
    words = escape(f"law '{runs[0].law.name}' was designed for vehicle 'paper', not 'iris'")
    page = render_page([replace(runs[0], vehicle=load_vehicle("iris"))])
    assert f": {words}</p>" in page[: page.index("<nav")]  # before any figure
    judged = render_page([replace(runs[0], vehicle=load_vehicle("iris"))], intro="<p>sound</p>")
    assert words not in judged[: judged.index("<nav")]  # a judgement flies where gains fail, on purpose


def test_the_page_names_the_licence_of_what_it_carries(page):
    assert "Copyright (c) 2022 Leon Sorokin" in page


def test_the_best_figure_is_marked_only_among_flights_that_can_be_compared(recorded):
    turned = [np.array([np.cos(angle), np.sin(angle), 0.0, 0.0]) for angle in (0.01, 0.03)]
    runs = read_runs(
        [recorded(name, law=name, q_NB=q) for name, q in zip(("pid-fair", "hinf-d1"), turned, strict=True)]
    )
    tiles = render_headline(runs)
    assert re.findall(r"<li class='best'>.*?</i>(.*?)</span><b>(.*?)</b>", tiles) == [
        ("pid-fair", "0.662"),
        ("pid-fair", "1.15"),
    ]
    assert re.findall(r"<small>(\d.*?)</small>", tiles) == ["3 ×", "3 ×"]
    assert tiles.count("; beside: times pid-fair") == 3
    alone = render_headline([runs[0], replace(runs[1], seed=2)])
    assert "class='best'" not in alone
    assert "×" not in alone


def test_gusts_and_events_are_bands_and_requirements_lines(recorded):
    require = (Requirement(metric="peak_deg", axis="roll", from_s=0.5, at_most=3.0),)
    wave = np.random.default_rng(1).standard_normal((1000, 3))
    (run,) = read_runs([recorded("run", scenario="gust-roll", n=1000, require=require, torque_command_B=wave)])
    document = json.loads(script(render_page([run]), "page-data"))
    assert document["bands"] == [
        {"from": 2.0, "to": 2.6, "kind": "gust", "text": "gust to the right 8 m/s, one minus cosine"}
    ]
    groups = {group["title"]: group["charts"] for group in document["sections"]["time"]}
    limits = [(mark["y"], mark["x"]) for mark in groups["Commanded torque"][2]["marks"]]
    assert limits == [(run.vehicle.torque_limit[2], None), (-run.vehicle.torque_limit[2], None)]
    turned = np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0])
    rolled = np.where(np.arange(1000)[:, None] < 500, turned, [1.0, 0.0, 0.0, 0.0])
    (run,) = read_runs([recorded("rolled", scenario="gust-roll", n=1000, require=require, q_NB=rolled)])
    document = json.loads(script(render_page([run]), "page-data"))
    roll, pitch, _ = next(group["charts"] for group in document["sections"]["time"] if group["title"] == "Attitude")
    assert [(mark["y"], mark["x"]) for mark in roll["marks"]] == [(3.0, [0.5, 4.0]), (-3.0, [0.5, 4.0])]
    assert pitch["marks"] == []


def test_curves_of_a_large_page_are_rounded_to_a_part_in_65000_and_times_are_exact(monkeypatch):
    monkeypatch.setattr("gustproof.show.report.html.page.MAX_EXACT", 3)
    block, values = NumberBlock(), np.array([1.2345678, -987.65432, 0.0, np.nan, np.inf, 3e-7])
    block.add(values, exact=False)
    block.add(2.0 * values)
    planes = zlib.decompress(base64.b64decode(block.encode()))
    read = np.frombuffer(np.frombuffer(planes, dtype=np.uint8).reshape(4, -1).T.tobytes(), dtype="<f4")
    np.testing.assert_allclose(read[:6], values, rtol=2.0**-15)
    np.testing.assert_array_equal(read[6:], (2.0 * values).astype("<f4"))
    assert read[0] != np.float32(values[0])


def test_flight_that_ended_before_its_scenario_is_told_beside_another(tmp_path, runs):
    plan = FlightPlan(runs[0].scenario, ExternalAutopilot(kind="px4"), runs[0].vehicle, 1, False)
    autopilot = {**plan.controller.to_dict(), "flown": {}, "reason": "roll & pitch swapped"}
    about = {**plan.metadata(), "autopilot": autopilot, "outcome": "wrong_geometry"}
    write_bag(tmp_path / "grounded", runs[0].records[:1], about)
    flights = [*read_runs([tmp_path / "grounded"]), runs[0]]
    page = render_page(flights)
    assert "<p>px4: wrong geometry: the rotors do not turn the vehicle" in page
    assert "means to (roll &amp; pitch swapped), after 0.004 s of " in page
    assert len(json.loads(script(page, "page-data"))["runs"]) == 2
    assert render_page(flights[:1])
