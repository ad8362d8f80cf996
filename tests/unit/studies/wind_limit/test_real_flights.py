"""Winds in a real autopilot's place: a stand-in for PX4 flies the same ones as the law that stands for its loops."""

from dataclasses import replace
from pathlib import Path

import pytest

from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.design.loops.models import autopilot_law
from gustproof.errors import FlightError
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.studies.rate.judge import scenario_for
from gustproof.studies.wind_limit.kept import parse_keep
from gustproof.studies.wind_limit.real_flights import RealFlight, fly_real
from gustproof.studies.wind_limit.wind_flight import gust_scenario

PEER = Path(__file__).parents[3] / "unit" / "firmware_model" / "external" / "px4_build"
VEHICLE, KEPT = load_vehicle("paper"), parse_keep("tilt<10, error<10, saturated<5 %")


def fly(fault: str, monkeypatch: pytest.MonkeyPatch) -> tuple[Scenario, list[RealFlight]]:
    """Fly the stand-in, with a fault or none."""
    monkeypatch.setenv("PEER_FAULT", fault)
    law = autopilot_law("px4", {}, VEHICLE).law
    base = scenario_for(law, VEHICLE, load_scenario("paper-turbulence"))
    wind = gust_scenario(base, KEPT, length_s=0.5, direction=(0.0, 1.0, 0.0))
    wind = replace(wind, translation="held", duration_s=3.0)
    autopilot = ExternalAutopilot(kind="px4", build=str(PEER), parameters="tuned")
    return wind, fly_real([wind], VEHICLE, autopilot, law, KEPT, (4,))


def test_a_flight_has_both_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    wind, found = fly("", monkeypatch)
    assert [(each.wind, each.seed) for each in found] == [(wind.description, 4)]
    assert all(0.0 < each.real < 1.0 and 0.0 < each.model < 1.0 for each in found)


def test_a_flight_that_breaks_off_is_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FlightError, match="without lockstep"):
        fly("no lockstep", monkeypatch)
