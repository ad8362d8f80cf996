import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from typer.testing import CliRunner

from gustproof.campaign import executors
from gustproof.cli.app import app
from gustproof.league.salt import commit

SMALL = ["--vehicle", "paper", "--scenario", "gust-2s", "--runs", "2"]


@pytest.fixture
def run(unflown, here, monkeypatch, tmp_path) -> Any:
    @contextmanager
    def pool(_: int) -> Iterator[Any]:
        yield here()

    monkeypatch.setattr(executors, "process_pool", pool)
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(app, ["league", "-o", "league.html", *SMALL, *words])


def test_organiser_tells_the_commitment_first_and_the_salt_after(run, tmp_path) -> None:
    words = ("--entry", "hinf-d1", "--draw-salt")
    told = run(*words)
    salt = (tmp_path / "league.work" / "salt.txt").read_text()
    page = (tmp_path / "league.html").read_text()
    assert told.exit_code == 0
    assert f"SHA-256 of the salt: {commit(salt)}" in told.stderr
    assert commit(salt) in page
    assert salt not in page + told.stdout
    assert run(*words, "--reveal").exit_code == 0
    assert salt in (tmp_path / "league.html").read_text()


def test_json_is_all_of_stdout_and_tables_stand_beside(run, tmp_path) -> None:
    found = run("--entry", "hinf-d1", "--entry", "pid-fair", "--json", "--csv", "league.csv", "--latex", "league.tex")
    document = json.loads(found.stdout)
    assert [each["rank"] for each in document["entrants"]] == [1, 2]
    assert (tmp_path / "league.csv").read_text().startswith("rank,entry,class")
    assert "tabular" in (tmp_path / "league.tex").read_text()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--entry", "no-such"), "--entry 'no-such'"),
        (("--salt", "short"), "--salt"),
        (("--salt", "long enough a salt", "--draw-salt"), "give one of them"),
        (("--csv", "league.txt"), "ends in .csv"),
        (("--scenario", "no-such"), "no-such"),
    ],
)
def test_bad_input_is_one_line_and_status_2(run, words: tuple[str, ...], line: str) -> None:
    found = run(*words)
    assert (found.exit_code, len(found.stderr.splitlines())) == (2, 1)
    assert line in found.stderr
