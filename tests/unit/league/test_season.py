import json
from concurrent.futures import BrokenExecutor, Future
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_model.config.uncertainty import load_vehicle_set
from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.league import tasks
from gustproof.league.course import load_course
from gustproof.league.entrants import parse_entrant
from gustproof.league.salt import PUBLIC_SALT
from gustproof.league.season import LeaguePlan, fly_league
from gustproof.report.html.league_page import render_league_page
from gustproof.report.league import write_csv, write_latex


class Here:
    """Pool that works at once, in this process; the tasks in `deadly` kill their worker."""

    death_errors = (BrokenExecutor,)
    max_pending = 3

    def __init__(self, deadly: str = "") -> None:
        self.deadly, self.labels = deadly, []

    def submit(self, function: Any, task: Any) -> Future:
        future: Future = Future()
        self.labels.append(task.label)
        if self.deadly and self.deadly in task.label:
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(function(task))
        return future


@pytest.fixture
def plan(monkeypatch) -> LeaguePlan:
    """Return a league of two laws whose flights are not flown, as a conformance test flies some."""

    def refuse(*_: Any, **__: Any) -> None:
        raise DesignError("not weighed")

    def fly(_: Any, law: Law) -> Any:
        error = 0.1 if law.name == "pid-fair" else 0.4
        return lambda cases: [SimpleNamespace(requirements=[SimpleNamespace(value=error)]) for _ in cases]

    monkeypatch.setattr(tasks, "measure_price", refuse)
    monkeypatch.setattr(tasks, "make_batch_simulator", fly)
    return LeaguePlan(
        entrants=(parse_entrant("hinf-d1"), parse_entrant("pid-fair")),
        vehicles=(load_vehicle_set("paper"),),
        scenarios=tuple(load_course(["turbulence-severe", "failed-rotor"])),
        runs=2,
        salt=PUBLIC_SALT,
    )


def test_league_flies_each_task_once_and_none_again(plan, tmp_path) -> None:
    first, again = Here(), Here()
    league = fly_league(plan, tmp_path / "work", first)
    flown = [label for label in first.labels if label.endswith("turbulence-severe")]
    assert len(flown) == 2 * (1 + 5)  # the nominal vehicle and the box
    assert [cell.scenario.name for cell in league.skipped] == ["failed-rotor"]
    assert league.standings.ratios[1] == (1.0, 1.0, 1.0)
    repeated = fly_league(plan, tmp_path / "work", again)
    assert again.labels == []
    assert repeated.to_dict() == league.to_dict()
    document = json.loads(json.dumps(league.to_dict(reveal=True), allow_nan=False))
    assert document["salt"] == PUBLIC_SALT
    assert {each["class"] for each in document["entrants"]} == {"open"}


def test_page_and_tables_tell_the_ranking_and_what_was_not_measured(plan, tmp_path) -> None:
    league = fly_league(plan, tmp_path / "work", Here())
    page = render_league_page(league)
    for text in ("hinf-d1", "not weighed", "seeds: public", "failed-rotor on paper", "may not look at the truth"):
        assert text in page
    assert page == render_league_page(league)
    assert len(write_csv(league).splitlines()) == 3
    assert r"slew\_share" in write_latex(league)


def test_entrant_that_kills_its_workers_fails_and_the_others_fly(plan, tmp_path) -> None:
    pool = Here(deadly="hinf-d1, paper, turbulence-severe")
    league = fly_league(plan, tmp_path / "work", pool)
    assert set(league.failures[0][0]["failures"]) == {"its process died"}
    assert league.failures[1][0]["failures"] == ["", ""]
    assert league.order == [1, 0]
