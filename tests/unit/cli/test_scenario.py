"""`gustproof scenario`, and what becomes of a flight whose scenario requires something."""

import json

import pytest
from typer.testing import CliRunner

from firmware_model.config.scenario import SCENARIOS, Scenario, list_scenarios
from firmware_model.config.vehicle import load_vehicle
from gustproof.cli.app import app
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.law.form import load_law

HEAD = 'description = "x"\nduration_s = 1.0\n'
LEVEL = '[[require]]\nmetric = "peak_deg"\nat_most = 5.0\n'
STILL = '[[require]]\nmetric = "torque_peak_nm"\naxis = "yaw"\nto_s = 0.5\nat_most = 1e-9\n'


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


def test_the_list_names_every_shipped_scenario_and_what_it_shows():
    told = json.loads(run("scenario", "list", "--json").stdout)
    assert [each["name"] for each in told] == list(list_scenarios())
    shown = run("scenario", "list").stdout
    assert all(each["name"] in shown and each["description"][:20] in shown for each in told)


def test_a_shown_scenario_is_its_file_to_the_letter(tmp_path):
    text = (SCENARIOS / "paper.toml").read_text(encoding="utf-8")
    assert run("scenario", "show", "paper").stdout == text
    mine = tmp_path / "mine.toml"
    mine.write_text(text, encoding="utf-8")
    assert run("scenario", "show", str(mine)).stdout == text


def test_a_sound_file_is_told_by_what_is_in_it(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text(HEAD + LEVEL + STILL)
    result = run("scenario", "check", str(mine))
    assert result.exit_code == 0
    assert result.stdout == "mine: sound; 1 s on the test stand, 2 [[require]]\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["is empty"]),
        ("altitude_m = 5.0\n", ["description: missing", "duration_s: missing"]),
        (HEAD + LEVEL + "at_lest = 1\n" + '[[require]]\nmetric = "peek"\n', ["require.0.at_lest: unknown key", "peek"]),
        (HEAD + LEVEL + "to_s = 2.0\n", ["require.0: to_s must not be later than the end, 1.0 s"]),
        (HEAD + "[[require", ["not TOML"]),
    ],
)
def test_every_mistake_of_a_file_is_told_in_one_go_and_the_status_is_2(text, words, tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text(text)
    result = run("scenario", "check", str(mine))
    assert result.exit_code == 2
    assert "Traceback" not in result.stderr
    assert all(word in result.stderr for word in [str(mine), *words])
    assert len(result.stderr.splitlines()) == len(words)


def test_no_such_scenario_is_one_line():
    for action in ("show", "check"):
        result = run("scenario", action, "nowhere")
        assert result.exit_code == 2
        assert "no scenario named 'nowhere'" in result.stderr


@pytest.fixture(scope="module")
def second():
    """Fly one second in still air: what the scenarios of these tests fly."""
    still = Scenario(name="still", description="x", duration_s=1.0)
    return fly_direct(still, load_law("hinf-d1"), vehicle=load_vehicle("paper"), seed=1)


@pytest.fixture
def flown(tmp_path, monkeypatch, second, fly_here):
    """Take the `second` for the flight of a scenario's text; `samples` of it if it breaks off."""

    def run_it(text: str, *options: str, outcome: FlightOutcome = FlightOutcome.DONE, samples: int | None = None):
        def fly(plan, out, **_):
            return fly_here(plan, out, second[:samples], outcome)

        monkeypatch.setattr("gustproof.flight.routes.recorder.fly_plan", fly)
        (tmp_path / "mine.toml").write_text(text)
        return run("fly", str(tmp_path / "mine.toml"), "--law", "hinf-d1", "--output", str(tmp_path / "out"), *options)

    return run_it


def test_a_flight_that_keeps_what_is_required_ends_with_0_and_says_by_what_margin(flown):
    result = flown(HEAD + LEVEL)
    assert result.exit_code == 0
    assert "≤ 5" in result.stdout
    assert "held" in result.stdout
    assert "FAILED" not in result.stdout


def test_a_failed_requirement_is_told_in_the_table_and_by_status_1(flown):
    result = flown(HEAD + LEVEL + STILL)
    assert result.exit_code == 1
    assert result.stderr.strip() == "gustproof: 1 of 2 requirements failed"
    assert "torque peak, yaw [N m]" in result.stdout
    assert "FAILED" in result.stdout


def test_json_has_each_requirement_and_the_status_is_the_same(flown):
    result = flown(HEAD + LEVEL + STILL, "--json")
    assert result.exit_code == 1
    level, still = json.loads(result.stdout)["requirements"]
    assert (level["held"], still["held"]) == (True, False)
    assert level["margin"] == 5.0 - level["value"]
    assert still["axis"] == "yaw"
    assert still["margin"] < 0.0


def test_a_flight_that_broke_off_says_so_first_and_its_open_windows_hold_nothing(flown):
    result = flown(HEAD + LEVEL + STILL, "--json", outcome=FlightOutcome.AUTOPILOT_LOST, samples=200)
    assert result.exit_code == 3
    level, still = json.loads(result.stdout)["requirements"]
    assert (level["value"], level["held"]) == (None, False)
    assert still["value"] > 0.0


def test_where_nothing_was_flown_nothing_holds(flown):
    result = flown(HEAD + LEVEL, outcome=FlightOutcome.NOT_STARTED, samples=0)
    assert result.exit_code == 3
    assert "not flown" in result.stdout


SCRIPTED = '[[event]]\nkind = "controller_killed"\nat_s = 0.5\n'


@pytest.mark.parametrize(("script", "status"), [("", 3), (SCRIPTED, 0)])
def test_a_controller_that_dies_by_the_script_breaks_nothing_off(flown, script, status):
    assert flown(HEAD + script + LEVEL, outcome=FlightOutcome.CONTROLLER_LOST).exit_code == status


def test_a_vehicle_that_dies_breaks_a_flight_off_whatever_the_script_says(flown):
    assert flown(HEAD + SCRIPTED + LEVEL, outcome=FlightOutcome.AUTOPILOT_LOST).exit_code == 3
