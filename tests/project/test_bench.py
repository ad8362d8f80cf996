"""The benchmark works and writes its table and file; no test judges speed."""

import importlib
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.law.form import load_law

BENCHMARK = Path(__file__).parents[2] / "tools" / "benchmark"


def test_benchmark_prints_a_table_and_writes_ratios_and_rows(tmp_path):
    file = tmp_path / "bench.json"
    command = [sys.executable, str(BENCHMARK), "--quick", "--output", str(file), "codec", "solver", "starts"]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path).stdout
    told = json.loads(file.read_text(encoding="utf-8"))
    assert told["quick"] is True
    assert told["ratios"].keys() == {"hinfsyn_vs_control", "help_s"}
    for row in told["rows"]:
        assert 0.0 < row["min"] <= row["median"] <= row["max"]
        assert row["name"] in printed
    assert told["left_out"] == {}


def test_unknown_part_is_told(tmp_path):
    command = [sys.executable, str(BENCHMARK), "nothing"]
    ended = subprocess.run(command, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert ended.returncode == 2
    assert "no part 'nothing'" in ended.stderr


@pytest.mark.parametrize("width", [1, 32])
def test_flight_written_in_c_by_another_hand_ends_with_our_bits(width, tmp_path, monkeypatch):
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    monkeypatch.syspath_prepend(str(BENCHMARK))
    twins = pytest.importorskip("twins")
    script = replace(load_scenario("paper-turbulence"), duration_s=2.0)
    law, vehicle = load_law("hinf-scheduled"), load_vehicle("paper")
    twin = twins.Twin(tmp_path, script, law, vehicle, width)
    assert twins.difference(twin, script, law, vehicle) == 0.0
    weaker = replace(law, C=0.999 * law.C)
    assert twins.difference(twin, script, weaker, vehicle) > 1e-6


@pytest.fixture
def peer(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARK))
    monkeypatch.setenv("PYTHONPATH", str(BENCHMARK / "peers"))
    return importlib.import_module("peer")


def started(peer, folder, text):
    program = folder / "program.py"
    program.write_text(text, encoding="utf-8")
    return peer.Program([sys.executable, str(program)], folder / "errors.log")


# Its clock ticks once a reading: a flight takes a second, and the k-th flight simulates k seconds.
COUNTS = """
import itertools, turns
ticks, flights = itertools.count(), itertools.count(1)
turns.time.perf_counter = lambda: next(ticks)
print("a library speaks")
def fly():
    print("and once more")
    k = next(flights)
    if k > 3:
        raise RuntimeError("out of fuel")
    return float(k)
turns.serve(fly)
"""


def test_peer_flies_when_asked_and_the_flight_that_makes_it_ready_does_not_count(peer, tmp_path):
    with started(peer, tmp_path, COUNTS) as program:
        program.ready()
        assert [program.fly(), program.fly()] == [2.0, 3.0]
        for _ in range(2):  # and when it is no more
            with pytest.raises(peer.PeerError, match=r"^RuntimeError: out of fuel$"):
                program.fly()


def test_peer_that_says_nothing_is_not_waited_for(peer, tmp_path):
    silent = "import time; time.sleep(600)"
    with started(peer, tmp_path, silent) as program, pytest.raises(peer.PeerError, match=r"^not done in 0.5 s$"):
        program.ready(0.5)


def test_environment_of_the_same_packages_serves_again_and_none_is_made_in_a_hurry(peer, tmp_path, monkeypatch):
    monkeypatch.setattr(peer.subprocess, "run", lambda *_, **__: pytest.fail("something is installed"))
    python = tmp_path / "bin" / "python"
    python.parent.mkdir()
    python.touch()
    (tmp_path / "installed").write_text("one==1 two==2", encoding="utf-8")
    assert peer.environment(tmp_path, ["one==1", "two==2"], new=True) == python
    with pytest.raises(peer.PeerError, match="--quick does not make one"):
        peer.environment(tmp_path, ["one==1", "two==3"], new=False)


def test_packages_that_are_not_to_be_had_leave_one_line_and_no_folder(peer, tmp_path, monkeypatch):
    def run(command, **_):
        if "pip" in command:
            raise subprocess.CalledProcessError(1, command, stderr=b"WARNING: slow\nERROR: none found for one==1\n")
        (tmp_path / "here").mkdir()

    monkeypatch.setattr(peer.subprocess, "run", run)
    with pytest.raises(peer.PeerError, match=r"^ERROR: none found for one==1$"):
        peer.environment(tmp_path / "here", ["one==1"], new=True)
    assert not (tmp_path / "here").exists()


def test_best_peer_is_beside_ours_on_as_many_cores_turn_by_turn(peer):
    peers, table = importlib.import_module("peers"), importlib.import_module("table")
    bench = table.Bench(quick=False)
    rates = {
        peers.ONE: [100.0, 40.0, 60.0],
        peers.ALL: [200.0, 90.0, 100.0],
        peers.FREE: [20.0, 90.0, 20.0],
        "jsbsim": [10.0, 2.0, 2.0],  # 10, 20, 30 times on one core
        "mujoco, RK4": [4.0, 6.0, 4.0],  # 50, 15, 25 times on all
        "crazyflow, Euler": [100.0, 90.0, 100.0],
    }
    peers.compare(bench, rates)
    assert bench.ratios == {"lanes_throughput_vs_best_peer": 20.0}
    told = {row["name"]: row for row in bench.rows}
    assert told["lanes vs crazyflow, Euler"]["median"] == 1.0
    assert told["free flight vs crazyflow, Euler"]["median"] == 0.2
    assert "jsbsim" in told["lanes_throughput_vs_best_peer"]["note"]
    peers.compare(bench, {name: rates[name] for name in rates if name != "jsbsim"})
    assert bench.ratios == {"lanes_throughput_vs_best_peer": 25.0}
    assert bench.rows[-3]["median"] == 5.0  # in free flight, beside the same peer


def test_peer_that_fails_is_left_out_and_the_others_go_on(peer):
    peers, table = importlib.import_module("peers"), importlib.import_module("table")
    bench, order = table.Bench(quick=False), []

    def rate(name):
        order.append(name)
        if name == "second" and order.count(name) == 2:
            raise peer.PeerError("it fell")
        return float(len(order))

    actions = {name: lambda name=name: rate(name) for name in ("first", "second")}
    assert peers.alternate(actions, 3, bench) == {"first": [1.0, 3.0, 5.0]}
    assert bench.left_out == {"second": "it fell"}
