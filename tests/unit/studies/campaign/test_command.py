import json
import re
import socket
import subprocess
import sys
from concurrent.futures import Future
from contextlib import contextmanager
from html import escape
from io import StringIO
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import pytest
from rich.console import Console
from typer.testing import CliRunner

from firmware_model.config.vehicle import VEHICLES
from gustproof.cli.app import app
from gustproof.show.report.campaign import render_campaign
from gustproof.show.report.html.campaign_page import render_campaign_page
from gustproof.studies.campaign.plan import parse_campaign
from gustproof.studies.campaign.statistics import compute_statistics
from gustproof.studies.campaign.worker import ChunkResult, failed_rows


@pytest.fixture
def command(tmp_path, monkeypatch):
    """Return a function that runs `gustproof campaign fly paper` in an empty folder, on workers that fly nothing."""
    monkeypatch.chdir(tmp_path)

    def submit(_, note, stretch):
        future = Future()
        future.set_result(ChunkResult(failed_rows(parse_campaign(json.loads(note), "note"), stretch, "not flown"), 1.0))
        return future

    @contextmanager
    def pool(_):
        yield SimpleNamespace(death_errors=(), max_pending=2, submit=submit)

    monkeypatch.setattr("gustproof.studies.campaign.executors.process_pool", pool)
    monkeypatch.setattr("gustproof.studies.campaign.executors.dask_pool", pool)

    def run(*options):
        return CliRunner().invoke(app, ["campaign", "fly", "paper", "--law", "hinf-d1", "--runs", "5", *options])

    return run


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("-o", "mc.csv"), "-o: no table (.parquet) of one campaign"),
        (("-o", "mc.parquet", "-o", "b.parquet"), "-o: two tables of one campaign"),
        (("-o", "nowhere/mc.parquet"), "nowhere: no such folder"),
        (("-o", "mc.parquet", "--spread", "wind"), "--spread: 'wind' is none of vehicle, gyro, gust, attitude"),
        (("-o", "mc.parquet", "--sampling", "grid"), "--sampling: 'grid' is none of uniform, normal, latin, sobol"),
        (("-o", "mc.parquet", "--law", "hinf-d1"), "law 'hinf-d1': given 2 times; names must be distinct"),
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
    assert "5 runs without figures: run 0: not flown" in told.stdout
    assert "gustproof campaign rerun mc.parquet:" in told.stdout
    again = command("-o", "mc.parquet", "--workers", "dask://tcp://anywhere:1", "--json")
    assert again.exit_code == 0
    assert json.loads(again.stdout)["laws"]["hinf-d1"]["failed"] == 5


def test_a_campaign_that_is_flown_is_not_flown_again_and_another_one_not_over_it(command):
    assert command("-o", "mc.parquet").exit_code == 0
    again = command("-o", "mc.parquet")
    assert (again.exit_code, again.stderr) == (0, "gustproof: mc.parquet: all 5 runs are there\n")
    other = command("-o", "mc.parquet", "--seed", "2")
    assert other.exit_code == 2
    assert other.stderr == (
        "gustproof: mc.parquet: holds another campaign: seed was 1; give another -o, or remove it\n"
    )


def test_a_table_grows_by_runs_and_laws_and_tells_so(command):
    assert command("-o", "mc.parquet").exit_code == 0
    grown = command("-o", "mc.parquet", "--law", "pid-fair", "-o", "mc.csv", "-o", "mc.tex")
    assert grown.exit_code == 0, grown.stderr
    assert grown.stderr == "gustproof: mc.parquet: 5 of 10 runs are there\n"
    assert [Path(name).stat().st_size > 0 for name in ("mc.csv", "mc.tex")] == [True, True]
    again = command("-o", "mc.parquet")
    assert again.stderr == "gustproof: mc.parquet: all 10 runs are there\n"
    refused = command("-o", "mc.txt")
    assert (refused.exit_code, "mc.txt: a campaign's table ends in .parquet" in refused.stderr) == (2, True)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("peak_deg",), "must be a figure and its limit"),
        (("peak_deg > 1", "-o", "mc.parquet"), "mc.parquet: a scenario file ends in .toml"),
        (("peak_deg > 1", "--sampling", "sobol"), "--sampling uniform or normal, not sobol"),
        (("peak_deg > 1", "--workers", "0"), "--workers: is '0', must be a number of processes"),
    ],
)
def test_a_rare_event_takes_no_table(options, complaint, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused = CliRunner().invoke(app, ["campaign", "rare", "paper", options[0], "--law", "hinf-d1", *options[1:]])
    assert (refused.exit_code, complaint in refused.stderr) == (2, True)
    assert len(refused.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("gust=2", "the size of 'gust' is '2', must be 0.01 .. 1"),
        ("attitude=x", "the size of 'attitude' is 'x', must be 0.01 .. 60"),
        ("gyro=1", "the size of 'gyro' stands in the vehicle file"),
    ],
)
def test_the_size_of_a_spread_is_one_that_can_be(command, words, complaint):
    refused = command("-o", "mc.parquet", "--spread", words)
    assert (refused.exit_code, complaint in refused.stderr) == (2, True)


def test_the_size_of_a_spread_is_drawn(command):
    told = command("-o", "mc.parquet", "--spread", "gust=0.25, attitude=2", "--json")
    spreads = json.loads(told.stdout)["spreads"]
    assert spreads["gust_scale"]["high"] == 1.25
    assert len(spreads) == 4


def test_what_is_drawn_by_default_is_gusts_and_what_the_file_has(command, tmp_path):
    quad = tmp_path / "quad.toml"
    quad.write_text((VEHICLES / "iris.toml").read_text())
    text = re.sub(r"\{ nominal = ([^,]+),[^}]*\}", r"\1", quad.read_text())
    quad.write_text(text.replace("actuator_lag = ", "actuator_lag = { nominal = 0.05, low = 0.04, high = 0.06 } # "))
    for vehicle, drawn in (("paper", "gyro.snr_db"), (str(quad), "gust_scale")):
        told = command("-o", f"{Path(vehicle).stem}.parquet", "--vehicle", vehicle, "--json")
        assert told.exit_code == 0, told.stderr
        assert drawn in json.loads(told.stdout)["spreads"]
    assert set(json.loads(told.stdout)["spreads"]) == {"actuator_lag", "gust_scale"}
    asked = command("-o", "asked.parquet", "--vehicle", str(quad), "--spread", "gyro")
    assert (asked.exit_code, "no spread to draw 'gyro' from" in asked.stderr) == (2, True)


def test_an_unstable_law_is_refused_and_another_vehicles_law_named(command):
    refused = command("-o", "mc.parquet", "--law", "pid-fair", "--vehicle", "iris")
    assert refused.exit_code == 2
    assert refused.stderr.startswith("gustproof: law 'pid-fair' is unstable on vehicle 'iris'")
    told = command("-o", "mc.parquet", "--law", "pid-fair", "--vehicle", "iris", "--anyway")
    assert told.exit_code == 0
    assert "warning: law 'hinf-d1' was designed for vehicle 'paper', not 'iris'" in told.stdout
    assert "warning: law 'pid-fair' is unstable on vehicle 'iris', by the linear model at hover" in told.stdout
    again = command("-o", "mc.parquet", "--law", "pid-fair", "--vehicle", "iris", "--anyway", "--json")
    lines = json.loads(again.stdout)["warnings"]
    assert len(lines) == 3
    page = render_campaign_page(Path("mc.parquet"))
    assert all(escape(line) in page for line in lines)


def test_eighty_columns_are_enough_for_names_and_figures(command):
    laws = ("hinf-scheduled", "hinf-reference", "hinf-d1-noise")
    options = [word for law in laws for word in ("--law", law)]
    assert command("-o", "mc.parquet", *options).exit_code == 0
    found, shown = compute_statistics(Path("mc.parquet")), StringIO()
    Console(file=shown, width=80).print(render_campaign(found))
    assert "causes: not estimated" in shown.getvalue()
    causes = found.laws[1].figures["rmse_deg"].importance
    causes |= dict.fromkeys(found.campaign.spreads, (-0.81, 0.64, 0.02))
    shown = StringIO()
    Console(file=shown, width=80).print(render_campaign(found))
    lines = shown.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    assert "…" not in shown.getvalue()
    for law in laws:
        assert sum(f" {law} " in line for line in lines) >= 3  # figures, requirements, what they depend on


def test_the_page_does_not_say_that_what_is_not_estimated_has_no_effect(command):
    assert command("-o", "mc.parquet", "--law", "pid-fair").exit_code == 0
    found = compute_statistics(Path("mc.parquet"))
    assert found.campaign.spreads
    flown = found.laws[0].figures["rmse_deg"].flown
    page = render_campaign_page(Path("mc.parquet"))
    names = ", ".join(found.campaign.spreads)
    assert f"Not estimated: {names}; it needs 50 runs of a law (have {flown})." in page
    assert "No effect found" not in page


def test_what_answers_in_the_place_of_a_dask_scheduler_is_told_in_one_line(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        Thread(target=_answer_nonsense, args=(server,), daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        command = ["campaign", "fly", "calm", "--law", "pid-fair", "-o", "mc.parquet", "--workers", f"dask://{address}"]
        done = subprocess.run(
            [sys.executable, "-m", "gustproof", *command], cwd=tmp_path, capture_output=True, text=True, timeout=60,
            check=False,
        )  # fmt: skip
    assert done.returncode == 2
    *progress, line = done.stderr.splitlines()  # on a busy machine a line of progress comes first
    assert line == f"gustproof: --workers: no dask scheduler answers at {address}: another program answers"
    assert all(each.startswith("gustproof: connecting to ") and each.endswith(" s") for each in progress)


def _answer_nonsense(server: socket.socket) -> None:
    connection, _ = server.accept()
    with connection:
        connection.sendall(b"HTTP/1.1 400 Bad Request\r\n" * 20)
        connection.recv(65536)


def test_a_dask_cluster_is_named_by_its_scheduler():
    done = CliRunner().invoke(
        app, ["campaign", "fly", "paper", "--law", "hinf-d1", "--workers", "x://y", "-o", "mc.parquet"]
    )
    assert (done.exit_code, done.stderr) == (2, "gustproof: --workers 'x://y': give dask://tcp://HOST:PORT\n")


@pytest.mark.parametrize("cold", [True, False])
def test_a_cold_start_says_that_it_compiles(command, monkeypatch, cold):
    told = []

    @contextmanager
    def progress(title, **_):
        told.append(title)
        yield lambda _, text: told.append(text)

    monkeypatch.setattr("gustproof.cli.campaign.fly.progress", progress)
    monkeypatch.setattr("gustproof.flight.routes.batch.is_cold", lambda _: cold)
    assert command("-o", "mc.parquet").exit_code == 0
    first, second, *_, last = told
    assert first == "starting workers, paper, hinf-d1"
    assert second == f"paper, hinf-d1: {'compiling the simulator, once after an installation' if cold else '0 runs'}"
    assert last == "paper, hinf-d1: 5 runs"
