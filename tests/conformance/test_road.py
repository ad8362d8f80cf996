"""The main road, walked from a first flight: each command prints the next one, which does what it says."""

import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gustproof.cli.app import app

pytestmark = pytest.mark.slow


def test_each_step_of_the_main_road_names_the_next_up_to_the_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    road, line = [], "gustproof fly doublets"
    while line:
        words = shlex.split(line)[1:]
        road.append(words[0])
        result = CliRunner().invoke(app, words)
        assert result.exit_code == 0, f"{line}: {result.output}"
        line = next((each.removeprefix("next: ") for each in result.stdout.splitlines() if each[:6] == "next: "), "")
        assert len(road) < 9, road
    assert road == ["fly", "report", "identify", "tune", "judge", "export"]
    assert list(tmp_path.glob("*.c"))
