from importlib.resources import files

import pytest

from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.law.form import load_law
from gustproof.studies.league.course import COURSE, FLEET, WORST_DEG, fit_scenario, load_course
from gustproof.studies.league.entries import ROSTER, LeagueEntry, make_controller, parse_league_entry


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


@pytest.mark.parametrize("source", ["no-such-law", "flagship@", "flagship@high", "exec: node mine.mjs", "mine.py"])
def test_source_that_names_nothing_is_one_line(source: str) -> None:
    with pytest.raises(ConfigError, match="--entry") as caught:
        parse_league_entry(source)
    assert "\n" not in str(caught.value)


def test_roster_can_be_entered() -> None:
    assert [parse_league_entry(each).name for each in ROSTER] == list(ROSTER)


def test_shipped_law_flies_its_own_vehicle_and_a_file_takes_the_name_of_each(tmp_path) -> None:
    paper = load_vehicle_set("paper")
    assert make_controller(parse_league_entry("flagship"), paper).to_dict() == load_law("flagship").to_dict()
    load_law("hinf-d2").save(tmp_path / "mine-paper.json")
    mine = parse_league_entry(f"{tmp_path}/mine-{{vehicle}}.json")
    assert mine == LeagueEntry(name="mine", source=f"{tmp_path}/mine-{{vehicle}}.json")
    assert make_controller(mine, paper).to_dict() == load_law("hinf-d2").to_dict()


def test_an_example_of_the_guide_is_entered_by_its_path() -> None:
    for source, name in (("geometric_lead.py:make", "geometric-lead"), ("rotor_indi.py:make", "rotor-indi")):
        entry = parse_league_entry(str(files("gustproof.guide") / "examples" / source))
        controller = make_controller(entry, load_vehicle_set("octo"))
        assert (entry.name, controller.source) == (name, entry.source)
