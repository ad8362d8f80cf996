"""`gustproof worst-case`: what it prints, what it leaves behind, what it refuses."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.cli.app import app
from gustproof.cli.worst_case import _print
from gustproof.law.form import load_law

SHORT = ("worst-case", "hinf-d1", "--flights", "100", "--horizon", "2")


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


def test_help_shows_how_to_fly_what_is_found():
    result = run("worst-case", "--help")
    assert result.exit_code == 0
    assert "gustproof fly worst.toml" in result.stdout


def test_what_is_found_is_printed_and_left_as_a_scenario(tmp_path: Path):
    path = tmp_path / "worst.toml"
    result = run(*SHORT, "-o", str(path))
    assert result.exit_code == 0
    assert f"gustproof fly {path} --law hinf-d1" in result.stdout
    assert load_scenario(path).moment
    assert [entry.name for entry in tmp_path.iterdir()] == ["worst.toml"]
    shrunk = run(*SHORT, "-o", str(path), "--limit", "3", "--force")
    assert "smallest that gives 3.00 deg: 3." in shrunk.stdout
    assert f"gustproof fly {tmp_path / 'worst-smallest.toml'} --law hinf-d1" in shrunk.stdout
    assert len(load_scenario(tmp_path / "worst-smallest.toml").moment) < len(load_scenario(path).moment)
    assert "not shrunk: the worst flight found does not reach 170 deg" in run(*SHORT, "--limit", "170").stdout


def test_a_changed_vehicle_is_left_beside_its_scenario(tmp_path: Path):
    short = ("worst-case", "hinf-scheduled", "--flights", "100", "--horizon", "2")  # a light vehicle is its worst
    result = run(*short, "--inertia-spread", "0.2", "--json", "-o", str(tmp_path / "worst.toml"))
    assert result.exit_code == 0
    told = json.loads(result.stdout)
    assert told["files"] == [str(tmp_path / "worst.toml"), str(tmp_path / "worst-vehicle.toml")]
    assert list(load_vehicle(tmp_path / "worst-vehicle.toml").inertia_B) == told["vehicle"]["inertia_B"]
    assert told["peak_deg"] == max(told["peaks_deg"]) > 0.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nothing",), "no law named 'nothing'"),
        (("hinf-d1", "--moment", "1,2"), "must be three numbers"),
        (("hinf-d1", "--moment", "1,2,x"), "must be three numbers"),
        (("hinf-d1", "--moment", "1,2,0"), "must be positive"),
        (("hinf-d1", "--moment", "1,2,nan"), "must be positive"),
        (("hinf-d1", "-o", "worst.json"), "ends in .toml"),
        (("mine.py:make",), "controller 'mine.py:make': No such file or directory"),
        (("hinf-d1", "-o", "/nowhere/worst.toml"), "/nowhere: no such folder"),
    ],
)
def test_bad_input_is_one_clear_line_and_status_2(arguments: tuple[str, ...], words: str):
    result = run("worst-case", *arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_a_law_that_diverges_before_any_search_is_one_clear_line_and_status_2(tmp_path: Path):
    replace(load_law("hinf-d1"), name="unstable", A=2.0 * np.eye(9)).save(tmp_path / "unstable.json")
    result = run("worst-case", str(tmp_path / "unstable.json"), "--flights", "100", "--horizon", "5")
    assert result.exit_code == 2
    assert "law 'unstable' diverges on vehicle 'paper' (inertia 0.25, 0.2, 0.1 kg m^2, lag 0.05 s)" in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_a_flight_beyond_all_numbers_is_said_to_diverge_and_left_to_be_flown(tmp_path: Path):
    few = ("--flights", "100", "--horizon", "1")
    huge = ("worst-case", "pid-fair", "--moment", "1e4,1e4,1e4", *few)
    result = run(*huge, "-o", str(tmp_path / "worst.toml"))
    assert result.exit_code == 0
    assert result.stdout.startswith("pid-fair: diverges within 1 s; found in ")
    assert "nan" not in result.stdout
    assert load_scenario(tmp_path / "worst.toml").moment
    told = run(*huge, "--json").stdout
    assert json.loads(told)["peak_deg"] is None
    assert "NaN" not in told
    assert "Infinity" not in told
    beyond = run("worst-case", "pid-fair", "--moment", "1e9,1e9,1e9", *few)
    assert beyond.exit_code == 2
    assert "before the search: the loop is unstable or the moment too large" in beyond.stderr


def test_law_of_another_vehicle_is_named():
    result = run("worst-case", "pid-fair", "--vehicle", "iris", "--flights", "100", "--horizon", "1", "--json")
    unstable, other = json.loads(result.stdout)["warnings"]
    assert "unstable on vehicle 'iris'" in unstable
    assert "designed for vehicle 'paper', not 'iris'" in other


@pytest.mark.parametrize(
    ("peaks", "told"),
    [
        ((268.36, 89.95, 266.14), "hinf-d1: turns over in 60 s: roll reaches 268 deg, pitch 90, yaw 266"),
        ((1.234, 0.5, 0.25), "flagship: 1.23 deg (roll 1.23, pitch 0.50, yaw 0.25) in 60 s"),
    ],
)
def test_angles_that_count_whole_turns_are_told_as_no_tilt(peaks, told, capsys):
    found = SimpleNamespace(
        peak_deg=max(peaks), peaks_deg=peaks, flights=3, start="a sine", start_deg=1.0, linear_deg=2.0
    )
    _print(told.partition(":")[0], found, 60.0)
    assert capsys.readouterr().out.splitlines()[0] == told
