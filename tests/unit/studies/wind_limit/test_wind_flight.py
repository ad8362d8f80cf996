"""Flights in mean wind: the tilt that holds the place is that of the simulation."""

import math

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.design.loops.models import autopilot_law
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import load_law
from gustproof.studies.rate.judge import scenario_for
from gustproof.studies.wind_limit.kept import parse_keep
from gustproof.studies.wind_limit.wind_flight import find_tilt, mean_wind, tracks_references, wind_scenario

AIR, KEPT = load_scenario("paper-turbulence"), parse_keep("tilt<35")


@pytest.mark.parametrize("name", ["paper", "iris", "octo"])
@pytest.mark.parametrize("from_deg", [0.0, 135.0, 270.0])
def test_the_vehicle_stays_in_place_at_that_tilt(name: str, from_deg: float) -> None:
    vehicle = load_vehicle(name)
    law = load_law("flagship") if name == "paper" else autopilot_law("px4", {}, vehicle).law
    script = wind_scenario(scenario_for(law, vehicle, AIR), vehicle, KEPT, mean=8.0, turbulence=0.0, from_deg=from_deg)
    assert script is not None
    last = fly_direct(script, law, vehicle=vehicle, seed=1)[-1]
    assert np.linalg.norm(last["velocity_N"]) < 0.15
    assert np.linalg.norm(last["position_N"] + (0.0, 0.0, 10.0)) < 6.0
    assert last["wind_N"].tolist() == [0.0, 0.0, 0.0]  # it blows as a gust, so that it may grow
    assert np.linalg.norm(last["gust_B"]) == pytest.approx(mean_wind(8.0, 10.0), rel=1e-3)


def test_tilt_grows_with_wind_leans_into_it_and_ends_where_thrust_does() -> None:
    iris = load_vehicle("iris")
    angles = [find_tilt(iris, speed, 0.0) for speed in (2.0, 5.0, 10.0, 15.0)]
    pitches = [math.degrees(each[1]) for each in angles if each is not None]
    assert pitches == sorted(pitches, reverse=True)
    assert pitches[0] < -1.0
    assert find_tilt(iris, 40.0, 0.0) is None
    assert wind_scenario(AIR, iris, KEPT, mean=40.0, turbulence=5.0, from_deg=0.0) is None


def test_a_regulator_to_level_holds_no_place() -> None:
    assert [tracks_references(load_law(name)) for name in ("flagship", "pid-fair", "hinf-d1")] == [True, True, False]
