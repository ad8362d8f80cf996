"""The vehicle's position loop around a law: where it holds, where it can't, and which laws can't follow it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.events import AttitudeReference
from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import Dryden, GustRamp
from firmware_model.errors import ConfigError
from gustproof.airframe.place_loop import GOOD_PEAK, place_peak, slow_down
from gustproof.design.loops.models import autopilot_law
from gustproof.flight.recording.flown import FlownRecords
from gustproof.flight.routes.batch import Case, fly_many
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.external import check_external
from gustproof.flight.routes.flight import check
from gustproof.law.form import Law, load_law
from gustproof.show.report.catalogue import describe_scenario

PAPER, IRIS, AIR = load_vehicle("paper"), load_vehicle("iris"), load_scenario("paper-turbulence")
HERE = np.array((0.0, 0.0, -10.0))


def windy(mean: float, turbulence: float, duration_s: float = 40.0) -> Scenario:
    """Return a flight in wind from the north-east that grows for 8 s; its drift from 20 s on is to be below 3 m."""
    wind = (
        GustRamp(kind="ramp", speed_mps=mean, from_deg=45.0, rise_s=8.0),
        Dryden(kind="dryden", wind_speed_20ft_mps=turbulence),
    )
    drift = (Requirement(metric=Metric.DRIFT, from_s=20.0, at_most=3.0),) if duration_s > 20.0 else ()
    return replace(AIR, duration_s=duration_s, translation="position_hold", wind=wind, require=drift)


def fly_away(records: FlownRecords, from_s: float) -> float:
    """Return the largest distance [m] from the place to hold, from a time on."""
    return float(np.linalg.norm(records["position_N"][round(250 * from_s) :] - HERE, axis=1).max())


@pytest.mark.parametrize(
    ("law", "vehicle", "most"),
    [
        (load_law("flagship"), PAPER, 1.0),
        (load_law("pid-fair"), PAPER, 1.0),
        (autopilot_law("px4", {}, IRIS).law, IRIS, 2.5),
    ],
)
def test_it_holds_the_place_in_wind_and_lanes_judge_the_same_flight(law: Law, vehicle, most: float) -> None:
    scenario = windy(5.0, 5.0)
    scenario = replace(scenario, control_rate_hz=round(1.0 / law.dt), physics_rate_hz=1000)
    records = fly_direct(scenario, law, vehicle=vehicle, seed=3)
    place = records["position_N"][-round(20.0 / law.dt) :]
    assert np.linalg.norm(place - HERE, axis=1).max() < most
    flown = fly_many(scenario, law, [Case(vehicle=vehicle, seed=seed) for seed in (3, 4)])
    assert flown[0].requirements[0].value == np.linalg.norm(place - place[0], axis=1).max()
    assert flown[1].requirements[0].value != flown[0].requirements[0].value


def test_it_holds_the_place_while_the_vehicle_turns() -> None:
    turns = [AttitudeReference(kind="attitude", at_s=20.0 + k, euler_deg=(0.0, 0.0, 30.0 * k)) for k in range(6)]
    records = fly_direct(replace(windy(6.0, 1.0), event=tuple(turns)), load_law("flagship"), vehicle=PAPER, seed=1)
    assert 2.0 * math.atan2(records[-1]["q_NB"][3], records[-1]["q_NB"][0]) == pytest.approx(
        math.radians(150.0), abs=0.1
    )
    assert fly_away(records, 20.0) < 1.0


def test_wind_beyond_the_largest_tilt_is_a_drift_and_no_missing_number() -> None:
    (flown,) = fly_many(windy(30.0, 5.0), load_law("flagship"), [Case(vehicle=PAPER, seed=1)])
    assert 100.0 < flown.requirements[0].value < 1000.0
    assert flown.metrics.peak_pitch_deg < 60.0


def test_a_law_that_follows_too_slowly_is_found_and_slower_gains_hold() -> None:
    law = load_law("pid-default")
    assert place_peak(law, PAPER, AIR, PAPER.position) == math.inf
    assert fly_away(fly_direct(windy(0.5, 1.0, 90.0), law, vehicle=PAPER, seed=1), 60.0) > 2.0
    gains = slow_down(law, PAPER, AIR)
    assert gains is not None
    peak = place_peak(law, PAPER, AIR, gains)
    assert peak is not None
    assert 1.0 < peak < GOOD_PEAK
    slow = replace(PAPER, position=gains)
    assert fly_away(fly_direct(windy(0.5, 1.0, 90.0), law, vehicle=slow, seed=1), 60.0) < 1.0


def test_the_linear_loop_decays_where_the_flight_does() -> None:
    """Raise the gains up to twice the peak: what is stable comes back from a gust, what is not swings ever further."""
    law, gains = load_law("flagship"), PAPER.position
    for factor, is_stable in ((2.0, True), (5.0, False)):
        fast = replace(gains, xy_p=factor * gains.xy_p, xy_velocity_p=factor * gains.xy_velocity_p)
        assert (place_peak(law, PAPER, AIR, fast) != math.inf) is is_stable
        records = fly_direct(windy(0.2, 0.5), law, vehicle=replace(PAPER, position=fast), seed=1)
        assert (fly_away(records, 30.0) < 0.2) is is_stable


def test_what_can_t_follow_is_refused_by_name_on_every_route() -> None:
    scenario, law = windy(5.0, 5.0, 1.0), load_law("hinf-d1")
    told = "law 'hinf-d1' has no reference input: it can't track the position loop of 'paper-turbulence'"
    with pytest.raises(ValueError, match=told):
        fly_direct(scenario, law, vehicle=PAPER)
    with pytest.raises(ValueError, match=told):
        fly_many(scenario, law, [Case(vehicle=PAPER, seed=1)])
    with pytest.raises(ConfigError, match=told):
        check(scenario, law, PAPER)
    check(scenario, load_law("flagship"), PAPER)
    assert "1 s in free flight, its position held" in describe_scenario(scenario)
    with pytest.raises(ConfigError, match="flies the position loop of our own autopilot"):
        check_external(scenario, "px4")
