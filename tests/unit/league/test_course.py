from dataclasses import replace

import pytest

from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.law.form import load_law
from gustproof.league.course import COURSE, FLEET, WORST_DEG, box_points, fit_scenario, load_course
from gustproof.league.entrants import ROSTER, Entrant, make_pilot, parse_entrant
from gustproof.league.ledger import Ledger, content_key
from gustproof.league.salt import check_salt, commit, hidden_seeds, keep_salt, store_commitment


def test_course_has_a_score_in_each_of_its_twenty_scenarios() -> None:
    course = load_course()
    assert len(course) == len(set(COURSE)) == 20
    for scenario in course:
        (scored,) = scenario.require
        assert (scored.metric.value, scored.axis, scored.at_most) == ("rmse_deg", None, WORST_DEG)
        assert not scenario.unflown


def test_winds_turn_each_vehicle_alike_and_kicks_are_shares_of_its_torque() -> None:
    (kick,) = load_course(["kick-all-axes"])
    paper, iris = load_vehicle("paper"), load_vehicle("iris")
    assert fit_scenario(kick, paper) == kick
    fitted = fit_scenario(kick, iris)
    assert fitted.gust_scale * iris.gust_gain / iris.inertia_B[0] == pytest.approx(
        kick.gust_scale * paper.gust_gain / paper.inertia_B[0]
    )
    assert fitted.moment[0].amplitude_nm == pytest.approx((1.5, -0.72, 0.14))


@pytest.mark.parametrize(("name", "flown"), [("weak-rotor", set(FLEET)), ("failed-rotor", {"octo"})])
def test_scenario_that_leaves_no_hover_is_not_scored(name: str, flown: set) -> None:
    (scenario,) = load_course([name])
    assert {each for each in FLEET if fit_scenario(scenario, load_vehicle(each)) is not None} == flown


def test_box_has_the_ends_of_inertia_and_lag_and_one_more_sample_of_delay() -> None:
    vehicles = load_vehicle_set("iris")
    (scenario,) = load_course(["turbulence-moderate"])
    points = list(box_points(scenario, vehicles))
    assert [point.name for point in points[1:4:2]] == ["light, slow actuators", "heavy, slow actuators"]
    assert points[1].vehicle.inertia_B < vehicles.nominal.inertia_B < points[3].vehicle.inertia_B
    assert points[4].scenario == replace(scenario, delay_samples=2)
    assert points[4].vehicle == vehicles.nominal


def test_seeds_differ_by_salt_scenario_vehicle_and_run() -> None:
    keys = [("salt", "a", "b"), ("salt", "ab", ""), ("salt", "b", "a"), ("other", "a", "b")]
    seeds = [seed for key in keys for seed in hidden_seeds(*key, 50)]
    assert len(set(seeds)) == 200
    assert hidden_seeds("salt", "a", "b", 2) == hidden_seeds("salt", "a", "b", 3)[:2]


def test_drawn_salt_is_kept_for_the_organiser_and_its_commitment_for_all(tmp_path) -> None:
    salt = keep_salt(tmp_path / "league.work")
    assert salt == keep_salt(tmp_path / "league.work") == check_salt(salt)
    assert (tmp_path / "league.work" / "salt.txt").stat().st_mode & 0o077 == 0
    for _ in range(2):
        store_commitment(tmp_path / "league.work", salt)
    assert (tmp_path / "league.work" / "commitments.txt").read_text() == f"{commit(salt)}\n"


def test_short_salt_is_refused() -> None:
    with pytest.raises(ConfigError, match="12 characters"):
        check_salt("short")


def test_torn_line_is_cut_off_and_the_results_before_it_stay(tmp_path) -> None:
    with Ledger(tmp_path) as ledger:
        ledger.add(content_key(a=1), {"errors_deg": [0.1, None]})
        ledger.add(content_key(a=2), {"errors_deg": [0.3]})
    path = tmp_path / "results.jsonl"
    path.write_bytes(path.read_bytes()[:-1])
    with Ledger(tmp_path) as ledger:
        assert ledger[content_key(a=1)] == {"errors_deg": [0.1, None]}
        assert content_key(a=2) not in ledger
        ledger.add(content_key(a=3), {"errors_deg": []})
    assert path.read_bytes().count(b"\n") == 2


def test_ledger_belongs_to_one_process_at_a_time(tmp_path) -> None:
    with Ledger(tmp_path), pytest.raises(ConfigError, match="another process"):
        Ledger(tmp_path)


@pytest.mark.parametrize("source", ["no-such-law", "flagship@", "flagship@high", "exec: node mine.mjs", "mine.py"])
def test_source_that_names_nothing_is_one_line(source: str) -> None:
    with pytest.raises(ConfigError, match="--entry") as caught:
        parse_entrant(source)
    assert "\n" not in str(caught.value)


def test_roster_can_be_entered() -> None:
    assert [parse_entrant(each).name for each in ROSTER] == list(ROSTER)


def test_shipped_law_flies_its_own_vehicle_and_a_file_takes_the_name_of_each(tmp_path) -> None:
    paper = load_vehicle_set("paper")
    assert make_pilot(parse_entrant("flagship"), paper).to_dict() == load_law("flagship").to_dict()
    load_law("hinf-d2").save(tmp_path / "mine-paper.json")
    mine = parse_entrant(f"{tmp_path}/mine-{{vehicle}}.json")
    assert mine == Entrant(name="mine", source=f"{tmp_path}/mine-{{vehicle}}.json")
    assert make_pilot(mine, paper).to_dict() == load_law("hinf-d2").to_dict()


@pytest.mark.parametrize("vehicle", FLEET)
@pytest.mark.parametrize("name", ["geometric", "geometric-lead", "rotor-indi", "policy", "mpc"])
def test_object_of_the_literature_is_made_for_each_vehicle(name: str, vehicle: str) -> None:
    entrant = parse_entrant(name)
    pilot = make_pilot(entrant, load_vehicle_set(vehicle))
    assert (entrant.name, entrant.source) == (name, pilot.source)
