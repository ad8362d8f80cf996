import json
from concurrent.futures import Future
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from gustproof.campaign.flights import Flown, lost
from gustproof.campaign.plan import noted
from gustproof.cli.app import app


@pytest.fixture
def command(tmp_path, monkeypatch):
    """Return a function that runs `gustproof campaign paper` in an empty folder, on workers that fly nothing."""
    monkeypatch.chdir(tmp_path)

    def submit(_, note, stretch):
        future = Future()
        future.set_result(Flown(lost(noted(json.loads(note), "note"), stretch, "not flown"), 1.0))
        return future

    @contextmanager
    def pool(_):
        yield SimpleNamespace(deaths=(), width=2, submit=submit)

    monkeypatch.setattr("gustproof.campaign.pools.processes", pool)
    monkeypatch.setattr("gustproof.campaign.pools.cluster", pool)

    def run(*options):
        return CliRunner().invoke(app, ["campaign", "paper", "--law", "hinf-d1", "--runs", "5", *options])

    return run


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("-o", "mc.csv"), "mc.csv: a campaign's table ends in .parquet"),
        (("-o", "nowhere/mc.parquet"), "nowhere: no such folder"),
        (("-o", "mc.parquet", "--spread", "wind"), "--spread: 'wind' is none of vehicle, gyro, gust, attitude"),
        (("-o", "mc.parquet", "--sampling", "grid"), "--sampling: 'grid' is none of uniform, normal, latin, sobol"),
        (("-o", "mc.parquet", "--law", "hinf-d1"), "law 'hinf-d1': given 2 times; each needs a name of its own"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(command, tmp_path, options, complaint):
    done = command(*options)
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr == f"gustproof: {complaint}\n"
    assert list(tmp_path.iterdir()) == []


def test_it_tells_what_came_of_it_as_text_or_json(command):
    told = command("-o", "mc.parquet")
    assert told.exit_code == 0, told.stderr
    assert "5 runs left no figures: run 0: not flown" in told.stdout
    assert "gustproof fly --run mc.parquet:" in told.stdout
    again = command("-o", "mc.parquet", "--executor", "dask://tcp://anywhere:1", "--workers", "7", "--json")
    assert again.exit_code == 0
    assert json.loads(again.stdout)["laws"]["hinf-d1"]["failed"] == 5


def test_a_campaign_that_is_flown_is_not_flown_again_and_another_one_not_over_it(command):
    assert command("-o", "mc.parquet").exit_code == 0
    again = command("-o", "mc.parquet")
    assert (again.exit_code, again.stderr) == (0, "gustproof: mc.parquet: all 5 runs are there\n")
    other = command("-o", "mc.parquet", "--seed", "2")
    assert other.exit_code == 2
    assert other.stderr == (
        "gustproof: mc.parquet: holds another campaign: seed differs; give another -o, or remove it\n"
    )


def test_a_dask_cluster_is_named_by_its_scheduler():
    done = CliRunner().invoke(app, ["campaign", "paper", "--law", "hinf-d1", "--executor", "x://y", "-o", "mc.parquet"])
    assert (done.exit_code, done.stderr) == (2, "gustproof: --executor 'x://y': give dask://tcp://HOST:PORT\n")
