import json
from concurrent.futures import BrokenExecutor
from typing import Any

import pytest

from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.errors import ConfigError
from gustproof.errors import DesignError
from gustproof.league import season
from gustproof.league.course import load_course
from gustproof.league.entrants import parse_entrant
from gustproof.league.salt import PUBLIC_SALT
from gustproof.league.season import LeaguePlan, fly_league
from gustproof.report.html.league_page import render_league_page
from gustproof.report.league import write_csv, write_latex


@pytest.fixture
def plan(unflown) -> LeaguePlan:
    """Return a league of two laws."""
    return LeaguePlan(
        entrants=(parse_entrant("hinf-d1"), parse_entrant("pid-fair")),
        vehicles=(load_vehicle_set("paper"),),
        scenarios=tuple(load_course(["turbulence-severe", "failed-rotor"])),
        runs=2,
        salt=PUBLIC_SALT,
    )


def test_league_flies_each_task_once_and_none_again(plan, here, tmp_path) -> None:
    first, again = here(), here()
    league = fly_league(plan, tmp_path / "work", first)
    flown = [label for label in first.labels if label.endswith("turbulence-severe")]
    assert len(flown) == 2 * (1 + 5)  # the nominal vehicle and the box
    assert [cell.scenario.name for cell in league.skipped] == ["failed-rotor"]
    assert league.standings.ratios[1] == (1.0, 1.0, 1.0)
    assert league.standings.ratios[0].value == pytest.approx(4.0)
    repeated = fly_league(plan, tmp_path / "work", again)
    assert again.labels == []
    assert repeated.to_dict() == league.to_dict()


def test_json_holds_no_salt_before_it_is_revealed(plan, here, tmp_path) -> None:
    league = fly_league(plan, tmp_path / "work", here())
    hidden = json.dumps(league.to_dict(), allow_nan=False)
    assert PUBLIC_SALT not in hidden
    revealed = league.to_dict(reveal=True)
    assert revealed["salt"] == PUBLIC_SALT
    assert {each["class"] for each in revealed["entrants"]} == {"open"}
    assert [each["name"] for each in revealed["entrants"]] == ["pid-fair", "hinf-d1"]


def test_page_and_tables_tell_the_ranking_and_what_was_not_measured(plan, here, tmp_path) -> None:
    league = fly_league(plan, tmp_path / "work", here())
    page = render_league_page(league)
    for text in ("hinf-d1", "not weighed", "seeds: public", "failed-rotor on paper", "may not look at the truth"):
        assert text in page
    assert page == render_league_page(league)
    assert len(write_csv(league).splitlines()) == 3
    assert r"slew\_share" in write_latex(league)


def test_entrant_that_kills_its_workers_fails_and_the_others_fly(plan, here, tmp_path) -> None:
    pool = here(deadly="hinf-d1, paper, turbulence-severe")
    league = fly_league(plan, tmp_path / "work", pool)
    assert set(league.failures[0][0]["failures"]) == {"its process died"}
    assert league.failures[1][0]["failures"] == ["", ""]
    assert league.order == [1, 0]


def test_pool_that_breaks_between_two_tasks_costs_no_result(plan, here, tmp_path) -> None:
    class Breaking(here):
        """Refuses its fourth task, whose workers are gone."""

        def submit(self, function: Any, task: Any) -> Any:
            if len(self.labels) == 3:
                self.labels.append("refused")
                raise BrokenExecutor
            return super().submit(function, task)

    league = fly_league(plan, tmp_path / "work", Breaking())
    assert league.failures == fly_league(plan, tmp_path / "other", here()).failures


def test_law_that_cannot_be_tuned_is_told_by_name(plan, here, tmp_path) -> None:
    with pytest.raises(DesignError, match="tuning hinf-d1 for paper: its process died"):
        fly_league(plan, tmp_path / "work", here(deadly="tuning hinf-d1"))


def test_vehicle_that_can_fly_nothing_and_names_given_twice_are_refused(plan, here, tmp_path) -> None:
    course = load_course(["failed-rotor"])
    alone = season.replace(plan, scenarios=tuple(course))
    with pytest.raises(ConfigError, match="'paper' can fly none"):
        fly_league(alone, tmp_path / "work", here())
    with pytest.raises(ConfigError, match="--entry: two of them"):
        season.replace(plan, entrants=(parse_entrant("indi"), parse_entrant("indi")))
