"""The page of `gustproof report` on an autopilot's log in Debian's Chromium, as a colleague opens the file."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.design.loops.models import autopilot_law
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import attitude

VEHICLE = load_vehicle("iris")
SCENARIO = replace(load_scenario("doublets"), control_rate_hz=400, physics_rate_hz=1200)
ANGLE_P, PROPELLERS_HZ = 4.5, 97.0
FORMATS = {
    "GYR": ("QQfff", "TimeUS,SampleUS,GyrX,GyrY,GyrZ"),
    "RATE": ("Qfffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut"),
    "ATT": ("Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
}


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """ArduPilot's own loops fly the manoeuvre on the iris; the log, as text, has a line of the propellers."""
    folder = tmp_path_factory.mktemp("logged")
    log = folder / "flight.log"
    law = autopilot_law("ardupilot", {}, VEHICLE).law
    records = fly_direct(SCENARIO, law, vehicle=VEHICLE, seed=1)
    stamps = np.round(records["time_us"]).astype(int) + 1000
    asked = np.degrees(reference_of(SCENARIO, records["time_us"]))
    flown, rates = np.degrees(attitude(records)), np.degrees(records["omega_B"])
    shaken = records["gyro_B"] + 0.05 * np.sin(2e-6 * np.pi * PROPELLERS_HZ * stamps)[:, None]
    out = records["torque_command_B"] / VEHICLE.torque_limit
    lines = [f"FMT, {i}, 0, {name}, {kinds}, {columns}" for i, (name, (kinds, columns)) in enumerate(FORMATS.items())]
    lines += [f"PARM, 500, {name}, {value}" for name, value in law.provenance.parameters.items()]
    for k, t in enumerate(stamps.tolist()):
        pairs = [(ANGLE_P * (asked[k, i] - flown[k, i]), rates[k, i], out[k, i]) for i in range(3)]
        lines.append(f"GYR, {t}, {t}, " + ", ".join(f"{value:.6f}" for value in shaken[k]))
        lines.append(f"RATE, {t}, " + ", ".join(f"{value:.5f}" for pair in pairs for value in pair))
        if k % 8 == 0:
            pairs = zip(asked[k], flown[k], strict=True)
            lines.append(f"ATT, {t}, " + ", ".join(f"{value:.4f}" for pair in pairs for value in pair))
    log.write_text("\n".join([*lines, ""]))
    page = folder / "report.html"
    command = [sys.executable, "-m", "gustproof", "report", str(log), "-o", str(page), "--json"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    return page, json.loads(run.stdout)


def reference_of(scenario, time_us):
    stamps, angles = zip((-1, (0.0, 0.0, 0.0)), *scenario.references, strict=True)
    return np.array(angles)[np.searchsorted(stamps, time_us, side="right") - 1]


def test_the_log_tells_vehicle_loops_vibration_and_verdict(flight):
    _, told = flight
    gains = told["vehicle"]["gain_rad_s2_per_unit"]
    for axis, limit, inertia in zip(("roll", "pitch", "yaw"), VEHICLE.torque_limit, VEHICLE.inertia_B, strict=True):
        assert gains[axis]["nominal"] == pytest.approx(limit / inertia, rel=0.05)
    assert [line["hertz"] for line in told["vibration"]["lines"]] == pytest.approx([PROPELLERS_HZ], abs=2.0)
    assert told["filters"][0]["label"] == "as flown"
    assert {each["loop"] for each in told["step_responses"]} == {"rate", "attitude"}
    assert told["judgement"]["verdict"] in ("sound", "fragile")


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1280])
def test_it_opens_without_complaint_and_draws_every_chart(browser, flight, width, dark):
    page, told = flight
    browser.open(page.as_uri(), width=width, dark=dark)
    browser.run("ready.then(drawAll)")
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert browser.run("charts.drawn.length") == 9 + len(told["step_responses"]) + 3 + 18 + 9
    blank = browser.run("""charts.drawn.filter(({ plot }) => plot.series.slice(1).some((series) =>
      !series.show || !(plot.scales.y.max > plot.scales.y.min))).map(({ chart }) => chart.title)""")
    assert blank == []
    assert browser.complaints == []
    assert browser.requests == [page.as_uri()]
    browser.keep(f"log-{width}-{'dark' if dark else 'light'}", page.parent)


def test_phase_and_coherence_have_a_linear_axis_over_the_logarithm_of_frequency(browser, flight):
    browser.open(flight[0].as_uri())
    browser.run("ready.then(drawAll)")
    axes = browser.run("""charts.drawn.filter(({ chart }) => ["[deg]", "[-]"].some((unit) => chart.title.endsWith(unit))
      && chart.x.startsWith("frequency")).map(({ plot }) => [plot.scales.x.distr, plot.scales.y.distr])""")
    assert axes == [[3, 1]] * 9  # phase and coherence of the response, phase of the loops
