"""The benchmark works and writes what it says; how fast anything is, no test judges."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from firmware_model.scenario import load_scenario
from firmware_model.vehicle import load_vehicle
from gustproof.law import load_law

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


@pytest.mark.compiled
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
