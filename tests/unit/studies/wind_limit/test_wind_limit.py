"""The wind that a vehicle stands: shown again by plain flights, said where there is none, never above a proof."""

import json
import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import VehicleSet, load_vehicle_set
from firmware_model.errors import ConfigError
from gustproof.design.loops.models import autopilot_law
from gustproof.flight.routes.batch import Case, make_batch_simulator
from gustproof.law.form import Law, load_law
from gustproof.show.report.html.wind_page import write_wind_page
from gustproof.show.report.wind_lines import describe_limit
from gustproof.studies.campaign.plan import Campaign, select_spreads, usual_dispersions
from gustproof.studies.wind_limit import kept as kept_words
from gustproof.studies.wind_limit import wind_flight
from gustproof.studies.wind_limit import wind_limit as study
from gustproof.studies.wind_limit.kept import parse_keep, shares
from gustproof.studies.wind_limit.wind_flight import gust_scenario, wind_scenario
from gustproof.studies.wind_limit.wind_limit import WindLimit, _Study, find_wind_limit, fly_shares

AIR, RISK = load_scenario("paper-turbulence"), 0.2
KEEP = "error<0.6, saturated<1 %"


@pytest.fixture(autouse=True, scope="module")
def a_minute_is_short() -> Iterator[None]:
    """Fly four seconds: what is tested does not depend on it."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (kept_words, wind_flight, study):
            patch.setattr(module, "MINUTE_S", 4.0)
        yield


class Pool(ThreadPoolExecutor):
    """One worker in this process."""

    death_errors = ()
    max_pending = 2


def limit_of(law: Law, vehicles: VehicleSet, keep: str, **options: bool) -> WindLimit:
    with Pool(1) as pool:
        return find_wind_limit(law, vehicles, AIR, parse_keep(keep), pool, risk=RISK, seed=1, **options)


@cache
def found() -> WindLimit:
    return limit_of(load_law("flagship"), load_vehicle_set("paper"), KEEP, with_map=True)


@pytest.mark.slow
def test_other_flights_agree_with_both_ends() -> None:
    limit, vehicle, kept = found().turbulence, load_vehicle_set("paper").nominal, parse_keep(KEEP)
    assert limit.low is not None
    assert limit.high is not None
    for speed, is_within in ((limit.low, True), (limit.high, False)):
        script = wind_scenario(AIR, vehicle, kept, mean=speed, turbulence=speed, from_deg=found().from_deg)
        assert script is not None
        cases = [Case(vehicle=vehicle, seed=10_000 + number) for number in range(256)]
        failed = np.mean(
            [max(shares(kept, each)) > 1.0 for each in make_batch_simulator(script, load_law("flagship"))(cases)]
        )
        assert bool(failed < RISK) is is_within


@pytest.mark.slow
def test_a_gust_just_below_the_least_holds_and_the_proof_is_below_it() -> None:
    worst, kept, vehicle = found().worst_gust, parse_keep(KEEP), load_vehicle_set("paper").nominal
    assert math.isfinite(worst.speed)
    bearing = {"the front": 0.0, "the right": 90.0, "the back": 180.0, "the left": 270.0}.get(worst.source)
    for scale, is_kept in ((worst.speed - 0.06, True), (worst.speed, False)):
        toward = (0.0, 0.0, 1.0 if worst.source == "above" else -1.0)
        if bearing is not None:
            toward = (-math.cos(math.radians(bearing)), -math.sin(math.radians(bearing)), 0.0)
        script = gust_scenario(AIR, kept, length_s=worst.length_s, direction=toward)
        (flown,) = make_batch_simulator(script, load_law("flagship"))([Case(vehicle=vehicle, seed=1, gust_scale=scale)])
        assert (max(shares(kept, flown)) <= 1.0) is is_kept
    assert 0.0 < found().proved.speed < worst.speed
    assert found().proved.speed <= (found().turbulence.high or math.inf)
    assert found().proved.attitude_deg <= 0.6


def test_the_map_is_monotone_to_its_counts_and_the_page_holds_it(tmp_path) -> None:
    share = {(mean, turbulence): each for mean, turbulence, each in found().grid}
    means, turbulences = (sorted({key[i] for key in share}) for i in (0, 1))
    for turbulence in turbulences:
        row = [share[mean, turbulence] for mean in means]
        assert all(after >= before - 0.2 for before, after in pairwise(row))
    write_wind_page(found(), load_vehicle_set("paper").nominal, load_law("flagship"), tmp_path / "limit.html")
    text = (tmp_path / "limit.html").read_text(encoding="utf-8")
    assert "Mean wind against turbulence" in text
    assert text.count('<polygon points="') == 2  # winds and gusts, from all sides
    assert all(line.replace("'", "&#x27;").replace("<", "&lt;") in text for line in describe_limit(found()))


def test_the_wind_of_each_direction_is_where_its_median_flight_begins_to_fail() -> None:
    assert [bearing for bearing, _ in found().halves] == [45.0 * k for k in range(8)]
    winds = dict(found().halves)
    assert winds[found().from_deg] <= 1.1 * min(winds.values())
    with Pool(1) as pool:
        study = _Study(load_law("flagship"), load_vehicle_set("paper"), AIR, parse_keep(KEEP), pool, 1)
        assert study.load(90.0, 0.96 * winds[90.0]) <= 1.0 < study.load(90.0, 1.04 * winds[90.0])
        assert study.half(90.0, 1.0) == math.inf


def test_the_same_flights_are_flown_whatever_the_batches() -> None:
    vehicles = load_vehicle_set("iris")
    spreads = select_spreads(vehicles, AIR, usual_dispersions(vehicles), gust=0.1, attitude_deg=0.0)
    kept, law = parse_keep("tilt<35"), autopilot_law("px4", {}, vehicles.nominal).law
    script = wind_scenario(AIR, vehicles.nominal, kept, mean=4.0, turbulence=4.0, from_deg=0.0)
    assert script is not None
    metadata = json.dumps(
        Campaign(scenario=script, laws=(law,), vehicles=vehicles, spreads=spreads, cases=100).metadata()
    )
    whole = fly_shares(metadata, kept, 0, 40)
    np.testing.assert_array_equal(whole[7:39], fly_shares(metadata, kept, 7, 32))
    assert len(np.unique(whole)) == 40


def test_without_set_points_it_flies_in_turbulence_alone_and_says_so() -> None:
    vehicles, law = load_vehicle_set("paper"), load_law("hinf-d2")
    with Pool(1) as pool:
        study = _Study(law, vehicles, AIR, parse_keep("tilt<80"), pool, 1)
        script = study.script(30.0, 90.0)
        assert study.failures(90.0, 30.0, 0, 32) == 0
    assert not study.holds_place
    assert script is not None
    assert [item.kind for item in script.wind] == ["dryden"]
    limit = replace(found(), holds_place=False, turbulence=replace(found().turbulence, low=40.0, high=None))
    lines = list(describe_limit(limit))
    assert lines[0].startswith("wind: none found: it stands 40 m/s")
    assert "carried along" in lines[1]


def test_calm_air_that_is_too_much_is_said() -> None:
    lines = [*describe_limit(replace(found(), turbulence=replace(found().turbulence, low=None, high=0.5)))]
    assert lines[0].startswith("wind: it does not stand even 0.5 m/s")


def test_a_drift_is_flown_with_a_position_loop_grows_with_the_wind_and_limits(monkeypatch) -> None:
    monkeypatch.setattr(wind_flight, "PLACE_SETTLE_S", 15.0)
    vehicles, law, kept = load_vehicle_set("paper"), load_law("flagship"), parse_keep("tilt<35, drift<1.5 m")
    with Pool(1) as pool:
        study = _Study(law, vehicles, AIR, kept, pool, 1)
        fails = [study.failures(90.0, speed, 0, 32) for speed in (2.0, 9.0, 40.0)]
        causes = study.find_causes(90.0, 40.0, RISK)
    script = study.script(40.0, 90.0)
    assert script is not None
    assert (script.translation, [item.kind for item in script.event]) == ("position_hold", [])
    assert fails[0] == 0 < fails[1] < fails[2] == 32
    assert causes[0][0] == "drift"
    assert study.place is not None
    told = list(describe_limit(replace(found(), place=study.place)))[1]
    assert "xy_velocity_p = 1.4" in told
    assert "from the true position; Ms 1.45 around this law" in told
    assert replace(found(), place=study.place).to_dict()["position_loop"]["xy_p"] == 0.6
    assert found().to_dict()["position_loop"] is None


@pytest.mark.parametrize(
    ("law", "told"),
    [
        ("hinf-d1", "law 'hinf-d1' has no set-points to follow it by"),
        ("pid-default", "is unstable around law 'pid-default'; stable with xy_p = 0.1573, xy_velocity_p = 0.367"),
    ],
)
def test_a_law_that_can_t_follow_a_position_loop_is_refused_for_drift(law: str, told: str) -> None:
    with Pool(1) as pool, pytest.raises(ConfigError, match=told):
        _Study(load_law(law), load_vehicle_set("paper"), AIR, parse_keep("drift<3"), pool, 1)


@pytest.mark.slow
def test_other_flights_agree_with_both_ends_of_a_drift(monkeypatch) -> None:
    monkeypatch.setattr(wind_flight, "PLACE_SETTLE_S", 15.0)
    law, vehicles, keep = load_law("flagship"), load_vehicle_set("paper"), "tilt<35, drift<1.5 m"
    drifts = limit_of(law, vehicles, keep)
    assert drifts.turbulence.low is not None
    assert drifts.turbulence.high is not None
    for speed, is_within in ((drifts.turbulence.low, True), (drifts.turbulence.high, False)):
        script = wind_scenario(
            AIR, vehicles.nominal, parse_keep(keep), mean=speed, turbulence=speed, from_deg=drifts.from_deg
        )
        assert script is not None
        cases = [Case(vehicle=vehicles.nominal, seed=10_000 + number) for number in range(256)]
        failed = np.mean(
            [max(shares(parse_keep(keep), each)) > 1.0 for each in make_batch_simulator(script, law)(cases)]
        )
        assert bool(failed < RISK) is is_within


@pytest.mark.slow
def test_a_probability_level_by_level_is_that_of_counted_flights(monkeypatch) -> None:
    for module in (kept_words, wind_flight, study):
        monkeypatch.setattr(module, "MINUTE_S", 2.0)
    monkeypatch.setattr(wind_flight, "SETTLE_S", 2.0)
    with Pool(1) as pool:
        flights = _Study(load_law("hinf-d2"), load_vehicle_set("paper"), AIR, parse_keep("tilt<1.2"), pool, 1)
        found, counted = flights.estimate(0.0, 8.0).probability, flights.failures(0.0, 8.0, 0, 4096) / 4096
        tilted = _Study(load_law("flagship"), load_vehicle_set("paper"), AIR, parse_keep("tilt<1"), pool, 1)
        assert tilted.estimate(0.0, 200.0).probability == (1.0, 1.0, 1.0)  # no tilt holds the place
    assert 0.005 < counted < 0.05
    assert found.low < counted + 3.0 * math.sqrt(counted / 4096)
    assert found.high > counted - 3.0 * math.sqrt(counted / 4096)
    assert found.high < 3.0 * found.low


def test_a_small_risk_is_told_with_how_it_was_found() -> None:
    near = replace(found().turbulence, low=17.97, high=18.02, best=18.0)
    lines = list(describe_limit(replace(found(), risk=1e-6, turbulence=near)))
    assert "up to 18 m/s at 20 ft (shown to stand 17.97, shown to fail at 18.02, " in lines[0]
    assert "95 % by subset simulation; risk 1e-06 a minute" in lines[0]
    assert lines[-1].endswith("where they are frequent")


def test_what_no_log_shows_is_said_of_a_vehicle_from_one() -> None:
    said = "drag and gust moment"
    assert said in list(describe_limit(replace(found(), is_from_log=True)))[1]
    assert not any(said in line for line in describe_limit(found()))
