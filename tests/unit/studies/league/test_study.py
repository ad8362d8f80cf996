import json
from concurrent.futures import BrokenExecutor
from dataclasses import replace
from typing import Any

import pytest

from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.errors import ConfigError
from gustproof.errors import DesignError
from gustproof.law.form import load_law
from gustproof.show.report.html.league_page import render_league_page
from gustproof.show.report.league import describe_failures
from gustproof.studies.league.course import load_course
from gustproof.studies.league.entries import parse_league_entry
from gustproof.studies.league.study import LeaguePlan, fly_league


@pytest.fixture
def plan(unflown) -> LeaguePlan:
    """Return a league of two laws."""
    return LeaguePlan(
        entries=(parse_league_entry("hinf-d1"), parse_league_entry("pid-fair")),
        vehicles=(load_vehicle_set("paper"),),
        scenarios=tuple(load_course(["turbulence-severe", "failed-rotor"])),
        runs=2,
    )


def test_league_does_all_work_once_and_none_again(plan, here, tmp_path) -> None:
    first, again = here(), here()
    league = fly_league(plan, tmp_path / "work", first)
    assert sorted(first.labels) == sorted(
        f"{kind} {name}" for name in ("hinf-d1", "pid-fair") for kind in ("_tune", "_measure", "pretend")
    )
    assert [str(cell) for cell in league.skipped] == ["failed-rotor, paper"]
    assert league.standings.ratios[1] == (1.0, 1.0, 1.0)
    assert league.standings.ratios[0].value == pytest.approx(4.0)
    assert fly_league(plan, tmp_path / "work", again).to_dict() == league.to_dict()
    assert again.labels == []


def test_more_entries_and_more_flights_fly_what_is_new_alone(plan, here, tmp_path) -> None:
    fly_league(plan, tmp_path / "work", here())
    pool = here()
    more = replace(
        plan, entries=(parse_league_entry("hinf-d2"), plan.entries[0])
    )  # the reference flies, and does not rank
    league = fly_league(more, tmp_path / "work", pool)
    assert pool.labels == ["_tune hinf-d2", "_measure hinf-d2", "pretend hinf-d2"]
    assert (league.errors_deg.shape, league.reference_deg.shape) == ((2, 1, 2), (1, 2))
    longer = fly_league(replace(more, runs=3), tmp_path / "work", pool)
    assert longer.errors_deg.shape == (2, 1, 3)
    assert pool.labels[3:] == [f"pretend {name}" for name in ("hinf-d1", "pid-fair", "hinf-d2")]
    assert fly_league(more, tmp_path / "work", here()).to_dict() == league.to_dict()


def test_page_and_json_tell_the_ranking_and_what_was_not_measured(plan, here, tmp_path) -> None:
    load_law("hinf-d2").save(tmp_path / "tumbler.json")
    plan = replace(plan, entries=(*plan.entries, parse_league_entry(f"{tmp_path}/tumbler.json")))
    league = fly_league(plan, tmp_path / "work", here())
    page = render_league_page(league)
    for text in ("hinf-d1", "not measured", "seed 1", "failed-rotor, paper"):
        assert text in page
    assert page == render_league_page(league)
    document = json.loads(json.dumps(league.to_dict(), allow_nan=False))
    assert [each["name"] for each in document["entrants"]] == ["pid-fair", "hinf-d1", "tumbler"]
    assert {each["class"] for each in document["entrants"]} == {"open"}
    assert document["entrants"][0]["operating_points"]["paper"]["Ms"] is None
    assert document["entrants"][2]["failed"] == 2
    assert "tumbler: 2 of 2 flights failed in turbulence-severe, paper: tumbled: error 75 deg" in [
        *describe_failures(league)
    ]


def test_entry_that_kills_its_workers_fails_and_the_others_fly(plan, here, tmp_path) -> None:
    league = fly_league(plan, tmp_path / "work", here(deadly="_measure hinf-d1"))
    assert (league.points[0][0].refused, league.points[1][0].refused) == ("its process died", "not measured")
    again = here()
    assert fly_league(plan, tmp_path / "work", again).points[0][0].refused == "not measured"
    assert again.labels == ["_measure hinf-d1"]  # a death is no result to keep


def test_pool_that_breaks_between_two_tasks_costs_no_result(plan, here, tmp_path) -> None:
    class Breaking(here):
        """Refuses its fourth task, whose workers are gone."""

        def submit(self, *task: Any) -> Any:
            if len(self.labels) == 3:
                self.labels.append("refused")
                raise BrokenExecutor
            return super().submit(*task)

    league = fly_league(plan, tmp_path / "work", Breaking())
    assert league.to_dict() == fly_league(plan, tmp_path / "other", here()).to_dict()


def test_law_that_cannot_be_tuned_is_told_by_name(plan, here, tmp_path) -> None:
    with pytest.raises(DesignError, match="tuning hinf-d1 for paper: its process died"):
        fly_league(plan, tmp_path / "work", here(deadly="_tune hinf-d1"))


def test_vehicle_that_can_fly_nothing_and_a_folder_that_is_none_are_refused(plan, here, tmp_path) -> None:
    alone = replace(plan, scenarios=tuple(load_course(["failed-rotor"])))
    with pytest.raises(ConfigError, match="'paper' can fly none"):
        fly_league(alone, tmp_path / "work", here())
    with pytest.raises(ConfigError, match="No such file"):
        fly_league(plan, tmp_path / "nowhere" / "work", here())
