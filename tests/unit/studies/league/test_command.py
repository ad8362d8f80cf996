import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.studies.campaign import executors

SMALL = ["--vehicle", "paper", "--scenario", "gust-2s", "--runs", "2"]


@pytest.fixture
def run(unflown, here, monkeypatch, tmp_path) -> Any:
    @contextmanager
    def pool(_: int) -> Iterator[Any]:
        yield here()

    monkeypatch.setattr(executors, "process_pool", pool)
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(app, ["league", "-o", "league.html", *SMALL, *words])


def test_ranking_is_printed_with_the_places_of_page_and_flights(run, tmp_path) -> None:
    found = run("--entry", "hinf-d1", "--seed", "7")
    assert found.exit_code == 0
    assert "hinf-d1: no operating point on paper: not measured" in found.stdout
    assert "page in league.html; tables of all flights in league.work" in found.stdout
    assert "seed 7" in (tmp_path / "league.html").read_text()
    assert (tmp_path / "league.work" / "gust-2s-paper.parquet").is_file()


def test_json_is_all_of_stdout(run) -> None:
    found = run("--entry", "hinf-d1", "--entry", "pid-fair", "--json")
    document = json.loads(found.stdout)
    assert [(each["name"], each["rank"]) for each in document["entrants"]] == [("pid-fair", 1), ("hinf-d1", 2)]
    assert document["seed"] == 1


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--entry", "no-such"), "--entry 'no-such'"),
        (("--scenario", "no-such"), "no-such"),
        (("--entry", "indi", "--entry", "indi"), "--entry: two of them"),
    ],
)
def test_bad_input_is_one_line_and_status_2(run, words: tuple[str, ...], line: str) -> None:
    found = run(*words)
    assert (found.exit_code, len(found.stderr.splitlines())) == (2, 1)
    assert line in found.stderr


def test_flights_of_another_seed_in_the_folder_are_refused(run) -> None:
    assert run("--entry", "hinf-d1").exit_code == 0
    found = run("--entry", "hinf-d1", "--seed", "2", "--force")
    assert (found.exit_code, len(found.stderr.splitlines())) == (2, 1)
    assert "gust-2s-paper.parquet: holds another campaign: seed was" in found.stderr
