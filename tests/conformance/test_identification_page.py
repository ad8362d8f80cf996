"""The report of `gustproof identify` in Debian's Chromium, as a colleague opens the file."""

import subprocess
import sys

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.flight.recording.bag import write_bag
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.flight import FlightPlan
from gustproof.law.form import load_law


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The page on a flight of the manoeuvre, made by the command."""
    folder = tmp_path_factory.mktemp("identified")
    plan = FlightPlan(load_scenario("doublets"), load_law("pid-fair"), load_vehicle("iris"), 1, False)
    records = fly_direct(plan.scenario, plan.controller, vehicle=plan.vehicle, seed=1)
    write_bag(folder / plan.name, records, {**plan.metadata(), "outcome": "done"})
    path = folder / "report.html"
    command = [sys.executable, "-m", "gustproof", "identify", str(folder), "--like", "iris", "--report", str(path)]
    subprocess.run(command, capture_output=True, check=True)
    return path


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1280])
def test_it_opens_without_complaint_and_draws_every_chart(browser, page, width, dark):
    browser.open(page.as_uri(), width=width, dark=dark)
    browser.run("ready.then(drawAll)")
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert browser.run("charts.drawn.length") == 18  # response, phase, coherence, spectrum, prediction, residual
    blank = browser.run("""charts.drawn.filter(({ plot }) => plot.series.slice(1).some((series) =>
      !series.show || !(plot.scales.y.max > plot.scales.y.min))).map(({ chart }) => chart.title)""")
    assert blank == []
    assert browser.complaints == []
    assert browser.requests == [page.as_uri()]


def test_phase_and_coherence_have_a_linear_axis_over_the_logarithm_of_frequency(browser, page):
    browser.open(page.as_uri())
    browser.run("ready.then(drawAll)")
    axes = browser.run("charts.drawn.slice(3, 9).map(({ plot }) => [plot.scales.x.distr, plot.scales.y.distr])")
    assert axes == [[3, 1]] * 6
    assert browser.run("charts.drawn.slice(0, 3).every(({ plot }) => plot.scales.y.distr === 3)")
