"""`gustproof compare` of laws alone: a verdict on each, a table for a review, a test for a build server."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

import gustproof.design.inside as inside_room
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.cli import compare
from gustproof.cli.app import app
from gustproof.design.autopilot_gains import AutopilotTuning
from gustproof.flight.controllers.external_autopilot import AnyController, ExternalAutopilot
from gustproof.law.form import load_law
from gustproof.show.report import contest
from gustproof.studies.campaign import comparison
from gustproof.studies.campaign.intervals import IntervalEstimate

PEER = Path(__file__).parents[1] / "firmware_model" / "external" / "px4_build"
SHORT = 'description = "gusts"\nduration_s = 6.0\n\n[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 15.0\n'
OWN = """
from gustproof import load_law
from gustproof.law.step import LawStepper

class make:
    def __init__(self, vehicle):
        self.limit = vehicle.torque_limit

    def reset(self):
        self.law = LawStepper(load_law("flagship"), self.limit)

    def step(self, gyro, reference, force, dt):
        shares = self.law.step(tuple(gyro), tuple(force))
        return [share * most for share, most in zip(shares, self.limit)]

class fall:
    def reset(self):
        pass

    def step(self, gyro, reference, force, dt):
        return 3.0, 0.0, 0.0
"""


@pytest.fixture
def laws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a short scenario, a law of 6 % less gain under another name, and one of another rate."""
    monkeypatch.chdir(tmp_path)
    flagship = load_law("flagship")
    replace(flagship, name="weak", C=0.94 * flagship.C, D=0.94 * flagship.D).save(tmp_path / "weak.json")
    replace(flagship, name="same").save(tmp_path / "same.json")
    replace(flagship, name="slow", dt=0.008).save(tmp_path / "slow.json")
    (tmp_path / "short.toml").write_text(SHORT)
    return tmp_path


def test_a_weaker_law_is_worse_and_the_same_law_alike(laws: Path) -> None:
    words = ("compare", "short.toml", "--law", "flagship", "--law", "weak.json", "--law", "same.json")
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 1
    first, weak, same = json.loads(result.stdout)
    assert (first["name"], first["verdict"], first["error_ratio"]) == ("flagship", None, None)
    assert (weak["verdict"], same["verdict"]) == ("worse", "alike")
    assert 1.0 < weak["error_ratio_low"] < weak["error_ratio"] < weak["error_ratio_high"] < 1.15
    assert weak["seeds"] < 20
    assert same["seeds"] < 20


@pytest.mark.slow
def test_several_scenarios_and_a_controller_of_ones_own_are_told_apart_with_their_margins(laws: Path) -> None:
    (laws / "mine.py").write_text(OWN)
    (laws / "other.toml").write_text(SHORT.replace("15.0", "8.0").replace("6.0", "2.0"))
    words = "compare short.toml other.toml --law flagship --law mine.py:make --law mine.py:fall --runs 2 --json"
    result = CliRunner().invoke(app, words.split())
    first, mine, fall = json.loads(result.stdout)
    assert mine["Ms"] == pytest.approx(first["Ms"], rel=0.03)
    assert mine["delay_margin_s"] == pytest.approx(first["delay_margin_s"], rel=0.05)
    assert list(first["by_scenario"]) == ["short", "other"]
    assert mine["by_scenario"] == pytest.approx({"short": 1.0, "other": 1.0}, rel=1e-3)
    assert (mine["failed"], fall["failed"], round(fall["steady_rmse_deg"], 9), fall["Ms"]) == (0, 4, 60.0, None)
    assert result.exit_code == 0  # two seeds tell nothing yet


def test_the_table_is_written_for_a_review_and_a_build_server(laws: Path) -> None:
    words = ("compare", "short.toml", "--law", "flagship", "--law", "same.json", "--runs", "6")
    result = CliRunner().invoke(app, [*words, "-o", "review.md", "-o", "junit.xml", "-o", "error.svg"])
    assert result.exit_code == 0
    assert "flagship" in Path("error.svg").read_text(encoding="utf-8")  # laws have no estimate of their own
    assert "alike" in result.stdout
    text = Path("review.md").read_text(encoding="utf-8")
    assert "| same |" in text
    assert "alike" in text
    suite = ElementTree.parse("junit.xml").getroot()[0]
    assert (suite.get("tests"), suite.get("failures")) == ("1", "0")
    assert suite[0].get("name") == "same against flagship"
    again = CliRunner().invoke(app, [*words, "-o", "review.md"])
    assert again.exit_code == 2
    assert "--force" in again.output


GUSTY = (
    SHORT + '\n[[wind]]\nkind = "one_minus_cosine"\namplitude_mps = [0.0, 6.0, 0.0]\nstart_s = 3.0\nlength_s = 0.5\n'
)


def test_phases_stand_in_every_form_and_do_not_decide(laws: Path) -> None:
    (laws / "gusty.toml").write_text(GUSTY)
    words = "compare gusty.toml --law flagship --law weak.json --runs 2 --json -o phases.md -o phases.svg"
    result = CliRunner().invoke(app, words.split())
    assert result.exit_code == 0  # two seeds tell nothing yet
    first, weak = json.loads(result.stdout)
    gust = "gust to the right 6 m/s, one minus cosine"
    assert [each["name"] for each in weak["phases"]] == ["before", gust, f"after {gust}"]
    before, during, _ = weak["phases"]
    assert during["rmse_deg"] > 1.2 * before["rmse_deg"]
    assert 1.0 < during["rmse_ratio"]["value"] < 1.2
    assert during["rmse_ratio"]["high"] is None
    assert first["phases"][1]["rmse_ratio"] is None
    text = Path("phases.md").read_text(encoding="utf-8")
    assert f"| flagship | {gust}, 0.5 s |" in text
    assert contest.explain_phases() in text
    assert f">{gust[:24]}" in Path("phases.svg").read_text(encoding="utf-8")


def test_large_ratios_are_told_in_times() -> None:
    assert contest._describe_ratio(IntervalEstimate(159.4, 33.88, 750.6)) == "159 times (33.9 to 751)"
    assert contest._describe_ratio(IntervalEstimate(1.5, 1.25, 1.75)) == "+50.0 % (+25.0 to +75.0)"


def test_laws_of_one_name_are_told_apart_by_what_was_given() -> None:
    named: dict[str, AnyController] = {}
    compare._add_laws(named, {"twin.json": load_law("flagship"), "flagship": load_law("flagship")}, asked=True)
    assert list(named) == ["twin.json", "flagship"]


def test_a_worse_law_fails_the_test_of_a_build_server(laws: Path) -> None:
    words = ("compare", "short.toml", "--law", "flagship", "--law", "weak.json", "-o", "junit.xml")
    assert CliRunner().invoke(app, words).exit_code == 1
    suite = ElementTree.parse("junit.xml").getroot()[0]
    assert suite.get("failures") == "1"
    failure = suite[0].find("failure")
    assert failure is not None
    assert "worse" in failure.get("message", "")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--law flagship --law none.json", "none.json"),
        ("--law flagship --law same.json --runs 0", "--runs"),
        ("--law flagship --law same.json -o table.html", ".md or .xml"),
        ("--build a --build a", "given twice"),
        ("--law flagship --law flagship", "--law flagship is given twice"),
        ("short.toml --law flagship --law slow.json", "law 'slow' steps every 0.008 s"),
        ("nowhere --law flagship --law same.json", "nowhere"),
        (f"gust-roll --build {PEER} --params equal", "a scenario with gusts, not flagship in gust-roll"),
        (
            f"short.toml --build {PEER} --params equal --law hinf-rates",
            "a law of torque and a scenario with gusts, not hinf-rates",
        ),
        (f"short.toml --build {PEER} --params equal --law gustproof.guide.examples.geometric:make", "a law of torque"),
    ],
)
def test_what_can_t_be_compared_is_refused_in_a_line(laws: Path, words: str, said: str) -> None:
    result = CliRunner().invoke(app, ["compare", *words.split()])
    assert result.exit_code == 2
    assert said in result.output


STOCK, EQUAL, INSIDE = 0.2, 0.06, 0.05
"""[deg] errors of loops that fly only in a test."""


@pytest.mark.parametrize(("params", "names", "status"), [
    ("", ["px4-equal", "px4-stock", "px4-flagship"], 0),
    ("--law flagship", ["px4-equal", "px4-stock", "px4-flagship", "flagship"], 0),
    ("--params equal --params stock", ["px4-equal", "px4-stock", "px4-flagship"], 1),
    ("--params stock", ["px4-stock", "px4-flagship"], 0),
])  # fmt: skip
def test_own_loops_are_tuned_to_the_price_of_the_law_inside_and_come_first(
    laws: Path, monkeypatch: pytest.MonkeyPatch, params: str, names: list[str], status: int
) -> None:
    written: list[str] = []

    def fly(_: object, __: object, controller: Any, seed: int) -> comparison._Flown:
        parameters, inside = getattr(controller, "parameters", ""), getattr(controller, "law", "") == "flagship"
        if parameters.endswith("equal.params"):
            written.append(Path(parameters).read_text())
        error = INSIDE if inside else EQUAL if parameters.endswith("equal.params") else STOCK if parameters else 0.06
        own = 0.9 * error if isinstance(controller, ExternalAutopilot) else None
        return comparison._Flown(error * (1.0 + 1e-4 * seed), 1.0, own, 1.0, None, failed=False)

    tuning = AutopilotTuning(
        kind="px4", parameters={"MC_YAW_P": 5.5}, law=load_law("flagship"), rmse=1e-3, seen_rmse=1e-3, slew=17.4,
        Ms=1.44, corner_Ms=2.0,
    )  # fmt: skip
    monkeypatch.setattr(comparison, "_fly", fly)
    monkeypatch.setattr(comparison, "_measure_point", lambda *_: None)
    monkeypatch.setattr(inside_room, "equal_gains", lambda *_: (inside_room.PriceInside(7e-4, 17.5, 1.45), tuning))
    monkeypatch.setattr("gustproof.flight.routes.external.find_build", lambda *_: Path())
    words = f"compare short.toml --build . --inside there --runs 8 --json -o curve.svg {params}"
    result = CliRunner().invoke(app, words.split())
    assert result.exit_code == status
    rows = json.loads(result.stdout)
    assert [row["name"] for row in rows] == names
    by_name = {row["name"]: row for row in rows}
    if "px4-equal" in names:
        assert set(written) == {written[0]}
        assert "1\t1\tMC_YAW_P\t5.5\t9" in written[0].splitlines()
        told = "equal to flagship inside by the model: slew 17.4 of 17.5 N m/s, Ms 1.44 of 1.45"
        assert f"{told}; MC_YAW_P above PX4's limit, 5" in result.stderr
        ours = by_name["px4-flagship"]
        assert ours["own_error_ratio"] == pytest.approx(INSIDE / EQUAL)
        assert ours["own_error_ratio_low"] < INSIDE / EQUAL < ours["own_error_ratio_high"]
    drawn = Path("curve.svg").read_text(encoding="utf-8")
    assert [f">  {name}</text>" in drawn for name in names] == [name != "flagship" for name in names]
    predicted = [each for each in rows if each["predicted_slew"] is not None]
    assert [each["name"] for each in predicted] == [name for name in names if name != "flagship"]
    assert by_name["px4-flagship"]["predicted_own_rmse_deg"] < by_name["px4-stock"]["predicted_own_rmse_deg"]
    assert rows[0]["own_error_ratio"] is None
    if "flagship" in names:
        assert by_name["flagship"]["own_error_ratio"] is None  # it has no estimate of its own


@pytest.mark.parametrize(
    ("scenario", "predicted"), [("paper-turbulence", True), ("severe-1797", True), ("attitude-steps", False),
                                ("gust-roll", False), ("kick", False), ("link-delay", False)],
)  # fmt: skip
def test_the_model_predicts_turbulence_alone_and_nothing_beside_other_flights(
    monkeypatch: pytest.MonkeyPatch, scenario: str, predicted: bool
) -> None:
    monkeypatch.setattr("gustproof.flight.routes.external.find_build", lambda *_: Path())
    script = load_scenario(scenario)
    assert compare._is_turbulence_alone(script) is predicted
    named = {"px4-stock": ExternalAutopilot(kind="px4")}
    found = compare._predict(named, load_law("flagship"), load_vehicle("paper"), [script])
    assert bool(found) is predicted
    assert not compare._predict(named, load_law("flagship"), load_vehicle("paper"), [script, script])
