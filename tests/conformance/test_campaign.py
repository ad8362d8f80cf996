"""Campaigns on real processes and a real cluster, killed and interrupted, give the same bytes."""

import gc
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Future
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import psutil
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from firmware_model.config.files import write_toml
from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from gustproof.cli.app import app
from gustproof.law.form import load_law
from gustproof.studies.campaign.executors import dask_pool, process_pool
from gustproof.studies.campaign.plan import Campaign, DispersionKind, select_spreads
from gustproof.studies.campaign.runner import fly_campaign
from gustproof.studies.campaign.worker import Chunk, failed_rows

LAWS = ("hinf-d1", "hinf-rates")
CASES = 12
RUNS = CASES * len(LAWS)
PATIENCE_S = 120.0
KILLED = """
import json, os, signal, sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from gustproof.studies.campaign.plan import parse_campaign
from gustproof.studies.campaign.runner import fly_campaign

class Pool(ThreadPoolExecutor):
    death_errors, max_pending = (), 2

def kill(flown, of):
    if flown:
        os.kill(os.getpid(), signal.SIGKILL)

campaign = parse_campaign(json.loads(Path(sys.argv[1]).read_text()), "note")
fly_campaign(campaign, Path(sys.argv[2]), Pool(1), chunk_runs=5, progress=kill)
"""

CLUSTER = """
import json, sys
from distributed import LocalCluster

if __name__ == "__main__":
    local = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=sys.argv[1])
    workers = [worker.pid for worker in local.workers.values()]
    print(json.dumps({"address": local.scheduler_address, "workers": workers}), flush=True)
    sys.stdin.read()
"""


class Here:
    """This process as the only worker."""

    death_errors = ()
    max_pending = 1

    def submit(self, function, *arguments):
        future = Future()
        future.set_result(function(*arguments))
        return future


@pytest.fixture(scope="module")
def script(tmp_path_factory) -> Path:
    """Return a scenario file of half a second in turbulence."""
    path = tmp_path_factory.mktemp("campaign") / "short.toml"
    write_toml(replace(load_scenario("paper-turbulence"), name="short", duration_s=0.5), path)
    return path


@pytest.fixture(scope="module")
def campaign(script) -> Campaign:
    scenario, vehicles = load_scenario(script), load_vehicle_set("paper")
    spreads = select_spreads(vehicles, scenario, list(DispersionKind), gust=0.5, attitude_deg=5.0)
    laws = tuple(map(load_law, LAWS))
    return Campaign(scenario=scenario, laws=laws, vehicles=vehicles, spreads=spreads, cases=CASES)


@pytest.fixture(scope="module")
def table(campaign, script) -> Path:
    """Return the campaign's file, flown here one run at a time, which compiles the kernel for all processes."""
    path = script.with_name("mc.parquet")
    fly_campaign(campaign, path, Here(), chunk_runs=1)
    return path


def test_a_campaign_that_was_killed_goes_on_with_two_workers_to_the_same_bytes(campaign, table, tmp_path) -> None:
    note, output = tmp_path / "note.json", tmp_path / "mc.parquet"
    note.write_text(json.dumps(campaign.metadata()), encoding="utf-8")
    killed = subprocess.run([sys.executable, "-c", KILLED, str(note), str(output)], timeout=PATIENCE_S, check=False)
    assert killed.returncode == -signal.SIGKILL
    assert len(list(tmp_path.glob("*.parts/0*.arrow"))) == 1
    told: list[tuple[int, int]] = []
    with process_pool(2) as pool:
        fly_campaign(campaign, output, pool, chunk_runs=3, progress=lambda *numbers: told.append(numbers))
    assert told[0] == (0, RUNS - 5)
    assert output.read_bytes() == table.read_bytes()


def test_ctrl_c_leaves_the_parts_one_line_and_no_process(table, script, tmp_path) -> None:
    command = [
        sys.executable,
        "-m",
        "gustproof",
        "campaign",
        "fly",
        str(script),
        "--law",
        "hinf-d1",
        "--runs",
        "1000000",
    ]
    process = subprocess.Popen(
        [*command, "--workers", "1", "-o", "mc.parquet"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        end = time.monotonic() + PATIENCE_S
        while not list(tmp_path.glob("*.parts/0*.arrow")):
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.05)
        family = [child for child in psutil.Process(process.pid).children(recursive=True) if child.is_running()]
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        told, complaint = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == 130
    assert told == ""
    *progress, line = complaint.splitlines()  # on a busy machine a line of progress comes first
    assert [each for each in progress if not (each.startswith("gustproof: ") and each.endswith(" s"))] == []
    assert line == (
        "gustproof: interrupted; finished runs are in mc.parquet.parts, and the same command resumes from there"
    )
    assert psutil.wait_procs(family, PATIENCE_S)[1] == []


def test_a_run_that_kills_its_process_is_found_and_the_others_are_flown(campaign, tmp_path) -> None:
    poison = 7
    stretches = [Chunk(first, runs) for first in range(RUNS) for runs in (1, 2) if first + runs <= RUNS]
    rows = {tuple(each): failed_rows(campaign, each, "not flown") for each in stretches}

    def fly(first: int, runs: int) -> SimpleNamespace:
        if first <= poison < first + runs:
            os._exit(1)
        return SimpleNamespace(table=rows[first, runs], wall_s=1.0)

    class Light:
        """Processes that do not load the project, so that they start fast."""

        death_errors, max_pending = (BrokenExecutor,), 3

        def submit(self, function, note, *stretch):
            return pool.submit(fly, *stretch[0]) if stretch else pool.submit(os.getpid)

    with process_pool(1) as pool:
        fly_campaign(campaign, tmp_path / "mc.parquet", Light(), chunk_runs=2)
    failures = pq.read_table(tmp_path / "mc.parquet", columns=["run", "failure"]).to_pylist()
    assert [row["run"] for row in failures] == list(range(RUNS))
    assert [row["run"] for row in failures if row["failure"] != "not flown"] == [poison]


def test_a_worker_that_has_done_a_task_has_nothing_old_to_be_looked_through_for_garbage() -> None:
    with process_pool(1) as pool:
        pool.submit(os.getpid).result()
        assert pool.submit(gc.get_freeze_count).result() > 0


@pytest.fixture
def dask(tmp_path) -> Iterator[tuple[str, list[int]]]:
    """Start a dask cluster of two workers; yield its scheduler's address and the workers' processes."""
    pytest.importorskip("distributed")
    process = subprocess.Popen(
        [sys.executable, "-c", CLUSTER, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        told = json.loads(process.stdout.readline())
        yield told["address"], told["workers"]
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def test_a_dask_cluster_that_loses_a_worker_leaves_the_same_bytes(dask, campaign, table, tmp_path) -> None:
    address, workers = dask

    def kill(flown: int, of: int) -> None:
        if flown and len(workers) == 2:
            os.kill(workers.pop(), signal.SIGKILL)

    with dask_pool(f"dask://{address}") as pool:
        fly_campaign(campaign, tmp_path / "mc.parquet", pool, chunk_runs=2, progress=kill)
    assert len(workers) == 1
    assert (tmp_path / "mc.parquet").read_bytes() == table.read_bytes()


def test_a_run_is_flown_again_over_udp_to_the_same_bits(table, tmp_path) -> None:
    run = CASES + 5
    options = ["--output", str(tmp_path / "again"), "--no-tlog", "--json"]
    again = CliRunner().invoke(app, ["campaign", "rerun", f"{table}:{run}", *options])
    assert again.exit_code == 0, again.stderr
    assert again.stderr == f"gustproof: equal to run {run} of {table} in every bit of its figures\n"
    row = pq.read_table(table).to_pylist()[run]
    flown = json.loads(again.stdout)
    assert flown["rmse_deg"] == row["rmse_deg"]
    assert [each["value"] for each in flown["requirements"]] == [
        row["require_0_rho_share"],
        row["require_1_saturated_s"],
    ]


def test_the_page_opens_in_a_browser_and_asks_nobody(browser, axe, table, tmp_path) -> None:
    path = tmp_path / "mc.html"
    told = CliRunner().invoke(app, ["report", str(table), "-o", str(path)])
    assert (told.exit_code, told.stdout) == (0, f"the campaign of {table} in {path}\n")
    browser.look_at(path.as_uri(), "campaign", tmp_path, axe)
    browser.run("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    lines = browser.run(
        "Array.from(document.querySelectorAll('polyline'), (line) => line.getBoundingClientRect().width)"
    )
    assert len(lines) >= 2 * len(LAWS)
    assert min(lines) > 0.0
    colours = browser.run(
        "new Set(Array.from(document.querySelectorAll('polyline'), (line) => getComputedStyle(line).stroke)).size"
    )
    assert colours == len(LAWS)
    assert f"gustproof campaign rerun {table}:" in browser.run("document.getElementById('worst').textContent")
