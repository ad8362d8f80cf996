"""`gustproof certify`: what it prints, what it leaves behind, and its exit status."""

import json
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from firmware_model.config.vehicle import load_vehicle, vehicle_path
from gustproof.airframe.rotational import Envelope
from gustproof.checker.evidence import FORMAT
from gustproof.checker.flight_box import KIND
from gustproof.checker.gaussian_box import KIND as CHANCE
from gustproof.cli.app import app
from gustproof.cli.certify.printed import show_assumptions
from gustproof.design.designs import design_problem, list_designs, load_design
from gustproof.law.form import law_path
from gustproof.prove.attitude_gain import attitude_loop
from gustproof.robust.gain.certificate import Certificate
from gustproof.robust.gain.parts import Delay
from gustproof.robust.lti.state_space import gain
from gustproof.robust.shown import shorten_statement

ENVELOPE = ("--angle-rad", "0.01", "--rate-rad-s", "0.01")


def run(*arguments: str):
    return CliRunner().invoke(app, ["certify", *arguments])


def answer(monkeypatch: pytest.MonkeyPatch, *, gain: float | None, lower_bound: float, proven: bool) -> None:
    """Let `certify_gain` return this result, as it does after some seconds."""
    certificate = Certificate(
        statement=f"the gain is below {gain}", gain=gain, lower_bound=lower_bound, proven=proven,
        assumes={"leak_per_s": 0.05, "horizon_s": None}, evidence={}, residual=0.0,
    )  # fmt: skip
    monkeypatch.setattr("gustproof.prove.attitude_gain.certify_gain", lambda *_, **__: certificate)


def test_help_says_what_a_gain_is_and_shows_examples():
    result = run("gain", "--help")
    assert result.exit_code == 0
    assert "L2 gain" in result.stdout
    assert "gustproof certify gain hinf-d2" in result.stdout


@pytest.mark.slow
def test_a_law_is_proved_by_its_design_and_the_file_checked_until_a_digit_is_changed(tmp_path: Path):
    path = tmp_path / "certificate.json"
    proved = run("gain", "hinf-d2", *ENVELOPE, "--json", "-o", str(path))
    assert proved.exit_code == 0
    told = json.loads(proved.stdout)
    assert told["proven"] is True
    # between the norm at hover, .2493, and the published bound on this envelope, .37
    assert 0.2492 < told["lower_bound"] < told["gain"] < 0.375
    assert (told["assumes"]["leak_per_s"], told["assumes"]["angle_rad"]) == (0.05, 0.01)

    checked = run("check", str(path), "--json")
    assert checked.exit_code == 0
    assert json.loads(checked.stdout)["gain"] == told["gain"]
    assert "proven: " in run("check", str(path)).stdout

    again = run("check", str(path), "--design", "hinf-d2", *ENVELOPE, "--json")
    assert again.exit_code == 0
    verdict = json.loads(again.stdout)
    assert (verdict["gain"], verdict["lower_bound"]) == (told["gain"], pytest.approx(told["lower_bound"]))
    assert "within its rounding" in verdict["assumes"]["plant"]
    other = run("check", str(path), "--design", "hinf-d2", "--angle-rad", "0.02", "--rate-rad-s", "0.01")
    assert other.exit_code == 1
    assert other.stdout == "refused: the matrix inequality does not hold\n"
    for reached, words in ((told["lower_bound"], "of the derived loop reached"), (2.0 * told["gain"], "reached")):
        with pytest.MonkeyPatch().context() as patch:
            patch.setattr("gustproof.robust.gain.lft_gain.lower_bound", lambda *_, reached=reached: reached)
            shown = run("check", str(path), "--design", "hinf-d2", *ENVELOPE).stdout
        assert f"a simulation {words}" in shown
        assert shown.startswith("refused: a simulation reached") is (reached > told["gain"])

    path.write_text(path.read_text().replace(f'"level": {told["gain"]}', '"level": 0.25'))
    refused = run("check", str(path))
    assert refused.exit_code == 1
    assert refused.stdout.startswith("refused: ")
    assert json.loads(run("check", str(path), "--json").stdout)["proven"] is False


@pytest.mark.slow
def test_a_controller_with_exact_rho_is_proved_on_a_plant_of_another_leak():
    result = run("gain", "hinf-d1", *ENVELOPE, "--exact-rho", "--leak", "0.05", "--json")
    assert result.exit_code == 0
    told = json.loads(result.stdout)
    assert told["gain"] < 0.26  # .41 without the schedule, on this envelope
    assert told["assumes"]["leak_per_s"] == 0.05
    assert "exact in the controller" in told["assumes"]["rho"]


def test_the_law_that_flies_is_proved_to_stay_in_a_box(tmp_path: Path):
    path = tmp_path / "certificate.json"
    proved = run("box", "flagship", "--moment", "0.65,0.65,0.3", "--horizon", "60", "--json", "-o", str(path))
    assert proved.exit_code == 0
    told = json.loads(proved.stdout)
    figures = {"part", "estimate_deg", "truth_deg", "torque_nm", "moment_class"}
    assert set(told) == {"proven", "vehicle", "assumes", "statement"} | figures
    assert told["vehicle"] == "paper"
    assert (told["proven"], told["part"], told["moment_class"]) == (True, 1.0, "held")
    assert all(angle <= most for angle, most in zip(told["estimate_deg"], (1.1, 1.3, 0.9), strict=True))
    assert max(told["truth_deg"]) <= 1.5
    assert {"delay_samples": 1, "horizon_s": 60.0, "law": "flagship"}.items() <= told["assumes"].items()

    checked = run("check", str(path), "--law", "flagship", "--vehicle", "paper", "--json")
    assert checked.exit_code == 0
    again = json.loads(checked.stdout)
    assert {key: again[key] for key in ("proven", "part", "estimate_deg", "truth_deg", "assumes")} == {
        key: told[key] for key in ("proven", "part", "estimate_deg", "truth_deg", "assumes")
    }
    shown = run("check", str(path), "--law", "flagship", "--vehicle", "paper")
    assert shown.stdout.startswith(f"proven: {shorten_statement(told['statement'])}\nassumptions\n")
    for law, vehicle in (("pid-fair", "paper"), ("flagship", "iris")):
        refused = run("check", str(path), "--law", law, "--vehicle", vehicle)
        assert refused.exit_code == 1
        assert "is not the one of this certificate" in refused.stdout
    assert "is about a flight: give --law" in run("check", str(path)).stderr


def test_a_flight_without_horizon_bounds_the_laws_own_attitude_with_its_risk():
    result = run("box", "hinf-scheduled", "--horizon", "inf", "--noise", "0.0036", "--risk", "1e-3")
    assert result.exit_code == 0
    assert "but for a risk of 0.001 in 600 s; without a horizon the truth has no bound" in result.stdout
    assert "duration [s]             unlimited" in result.stdout


def test_a_moment_of_any_form_turns_the_truth_unseen():
    result = run("box", "pid-fair", "--moment", "0.01,0.01,0.01", "--moment-class", "any", "--horizon", "10")
    assert result.exit_code == 0
    assert (
        "a moment that is any function of time (a square wave in step with the samples turns any law" in result.stdout
    )
    steep = run("box", "pid-fair", "--moment", "0.01,0.01,0.01", "--moment-class", "slope", "--slope", "1,1,1")
    assert "under slopes below 1, 1, 1 N m/s within a sample" in steep.stdout


def test_what_is_asked_of_a_gain_is_handed_on(monkeypatch: pytest.MonkeyPatch):
    asked: dict[str, object] = {}

    def certify_gain(*_: object, **options: object) -> Certificate:
        asked.update(options)
        return Certificate(
            statement="", gain=0.3, lower_bound=0.2, proven=True, assumes={}, evidence={}, residual=0.0
        )  # fmt: skip

    monkeypatch.setattr("gustproof.prove.attitude_gain.certify_gain", certify_gain)
    assert run("gain", "D2", *ENVELOPE, "--slow", "--level", "0.3").exit_code == 0
    plain: dict[str, object] = {"angle": 0.01, "rate": 0.01, "delay": None, "saturation": None}
    assert asked == {**plain, "scheduled": False, "rate_bounded": True, "level": 0.3}
    assert run("gain", "D2", *ENVELOPE, "--exact-rho").exit_code == 0
    assert asked == {**plain, "scheduled": True, "rate_bounded": False, "level": None}


def test_what_is_not_proved_has_status_1_and_leaves_no_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    answer(monkeypatch, gain=0.25, lower_bound=1.72, proven=False)
    result = run("gain", "D2", *ENVELOPE, "--level", "0.25", "-o", str(tmp_path / "c.json"))
    assert result.exit_code == 1
    assert "NOT proven" in result.stdout
    assert "a simulation reached 1.72, so the claimed bound 0.25 is false" in result.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_gain_that_nothing_bounds_is_null_in_json(monkeypatch: pytest.MonkeyPatch):
    answer(monkeypatch, gain=None, lower_bound=3.0, proven=False)
    result = run("gain", "D2", *ENVELOPE, "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["gain"] is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("gain", "D2", "--angle-rad", "30", "--rate-rad-s", "1"), "must be below pi/2; 30 deg is 0.52"),
        (("gain", "D2", "--angle-rad", "2", "--rate-rad-s", "1"), "angle is 2.0 rad"),
        (("gain", "D2", *ENVELOPE, "--leak", "0"), "--leak: is 0.0, must be positive"),
        (("gain", "D2", *ENVELOPE, "--leak", "inf"), "--leak: is inf, must be positive"),
        (("gain", "D2", *ENVELOPE, "--level", "inf"), "level is inf, must be positive"),
        (("gain", "D2", *ENVELOPE, "--level", "nan"), "level is nan, must be positive"),
        (("gain", "D2", *ENVELOPE, "-o", "c.txt"), "ends in .json"),
        (("gain", "hinf-rates", *ENVELOPE), "design R1: certify supports torque designs only; this one has no"),
        (("gain", "hinf-reference", *ENVELOPE), "design reference: certify supports designs that hold level only"),
        (("gain", "nothing", *ENVELOPE), "no design named 'nothing'"),
        (("gain", "pid-fair", *ENVELOPE), "law 'pid-fair' was made from no design"),
        (("box", "hinf-d2", "--moment", "1,2"), "--moment: is '1,2', must be three numbers"),
        (("box", "hinf-d2", "--moment-class", "some"), "--moment-class: is 'some', must be one of held, slope, any"),
        (("box", "hinf-d2", "--moment-class", "slope"), "a slope belongs to moments of class 'slope'"),
        (("box", "hinf-d2", "--slope", "1,1,1"), "a slope belongs to moments of class 'slope'"),
        (("box", "hinf-d2", "--horizon", "-1"), "horizon is -1.0 s, must be positive"),
        (("box", "hinf-d2", "--horizon", "1e9"), "horizon is 1000000000.0 s, must be positive, at most 1000000 s"),
        (("box", "hinf-d2", "--horizon", "nan"), "horizon is nan, must be a finite number"),
        (("box", "hinf-d2", "--noise", "1e-3", "--risk", "1e-320"), "must be a probability"),
        (("box", "hinf-d2", "--noise", "-1"), "noise is -1.0, must not be negative"),
        (("box", "aided", "--noise", "0.0036"), "law 'aided' reads the accelerometer: its box is proved without noise"),
        (("box", "D2"), "no law named 'D2'"),
        (("check", "/nowhere.json"), "/nowhere.json: No such file"),
        (("check", "c.json", "--leak", "0.1"), "without --design no loop of a gain is derived; --leak cannot"),
        (("check", "c.json", *ENVELOPE), "--angle-rad cannot be given with it"),
        (("check", "c.json", "--design", "D2"), "--angle-rad is missing: --design needs the envelope"),
        (("check", "c.json", "--design", "D2", *ENVELOPE[:2]), "--rate-rad-s is missing"),
        (("check", "c.json", "--design", "D2", *ENVELOPE, "--law", "flagship"), "--law cannot be given with it"),
        (("check", "c.json", "--design", "D2", *ENVELOPE, "--air", "calm"), "--air cannot be given with it"),
    ],
)
def test_bad_input_is_one_clear_line_and_status_2(arguments: tuple[str, ...], words: str):
    result = run(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [
        ("gain", ("--law", "flagship"), "is about a gain: leave out --law"),
        ("gain", ("--vehicle", "paper"), "is about a gain: leave out --vehicle"),
        ("flight", ("--law", "flagship"), "is about a flight: give --vehicle"),
        ("flight", ("--law", "flagship", "--vehicle", "paper", "--air", "calm"), "is about a flight: leave out --air"),
        ("chance", ("--law", "flagship", "--vehicle", "paper"), "is about a flight's chance: give --air"),
        ("flight", ("--design", "D2", *ENVELOPE), "is about a flight: leave out --design"),
    ],
)
def test_a_check_with_options_of_another_kind_is_a_wrong_command_not_a_refusal(kind, options, words, tmp_path: Path):
    """It had the status of a proof that does not hold."""
    names = {"flight": KIND, "chance": CHANCE}
    file = tmp_path / "c.json"
    file.write_text(json.dumps({"format": FORMAT, "evidence": {"kind": names.get(kind, kind)}}))
    result = run("check", str(file), *options)
    assert result.exit_code == 2
    assert words in result.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("boxes", "flagship"), "'boxes' is none of box, gain, air, check"),
        (("bx", "flagship"), "did you mean 'box'?"),
        (("gain", "D2", "--angle-rad", "0.1"), "Missing option '--rate-rad-s'"),
        (("gain", "D2", *ENVELOPE, "--moment", "1,1,1"), "No such option"),
        (("box", "D2", "--leak", "0.05"), "No such option"),
        (("check", "c.json", "--horizon", "60"), "No such option"),
    ],
)
def test_what_belongs_to_another_statement_is_no_word_of_this_one(arguments: tuple[str, ...], words: str):
    result = run(*arguments)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.split())


def test_what_the_hint_names_is_what_a_gain_can_be_proved_of():
    vehicle, envelope = load_vehicle("paper"), Envelope(angle=0.1, rate=0.5)
    hint = run("gain", "pid-fair", *ENVELOPE).stderr.strip()
    assert hint.endswith("give one of hinf-d1, hinf-d1-noise, hinf-d2, hinf-scheduled")
    for design in map(load_design, list_designs()):
        with nullcontext() if f" {design.law}," in f"{hint}," else pytest.raises(ValueError, match="certify supports"):
            problem = design_problem(design, vehicle)
            attitude_loop(problem, gain(np.zeros((problem.n_con, problem.n_meas))), envelope, scheduled=False)


@pytest.fixture
def breath(tmp_path: Path) -> str:
    """Return a scenario of .4 s of the paper's air."""
    path = tmp_path / "breath.toml"
    wind = '[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 15.0\n'
    path.write_text(f'description = "a breath"\nduration_s = 0.4\n{wind}', encoding="utf-8")
    return str(path)


def test_an_air_is_predicted_for_a_law_without_proof_and_not_called_proven(breath: str) -> None:
    told = run("air", "hinf-scheduled", breath, "--risk", "1e-3", "--json")
    assert told.exit_code == 0
    found = json.loads(told.stdout)
    assert found["proven"] is False
    assert (found["risk"], found["horizon_s"], found["air"]) == (1e-3, 0.4, breath)
    assert all(0.05 < angle < 1.1 for angle in found["attitude_deg"])
    assert "angular gusts" in found["assumes"]["neglected"]
    assert "no pure integral of its gyro" in found["statement"]
    shown = run("air", "aided", breath).stdout
    assert shown.startswith("aided on paper: predicted, not proven: ")
    assert "with probability 0.999 or more" in shown
    assert "no proof: law 'aided' reads the accelerometer" in shown


def test_an_air_is_proved_and_checked_from_the_files(breath: str, tmp_path: Path) -> None:
    path = str(tmp_path / "chance.json")
    shown = run("air", "flagship", breath, "-o", path)
    assert shown.exit_code == 0
    assert shown.stdout.startswith("flagship on paper: proven\n  true attitude, 0.4 s ")
    assert "in Dryden turbulence of 15 m/s at 20 ft" in shown.stdout
    told = json.loads(run("air", "flagship", breath, "--json").stdout)
    assert (told["proven"], told["risk"], told["horizon_s"], told["air"]) == (True, 1e-3, 0.4, breath)
    files = ("--law", "flagship", "--vehicle", "paper", "--air")
    checked = json.loads(run("check", path, *files, breath, "--json").stdout)
    assert (checked["proven"], checked["truth_deg"]) == (True, told["attitude_deg"])
    assert run("check", path, *files, "paper-turbulence").exit_code == 1
    assert run("check", path, *files[:-1]).exit_code == 2


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("flagship", "calm"), "has no turbulence"),
        (("flagship", "paper-turbulence", "--risk", "2"), "risk is 2.0"),
    ],
)
def test_an_air_that_cannot_be_predicted_is_refused(arguments: tuple[str, ...], reason: str) -> None:
    refused = run("air", *arguments)
    assert refused.exit_code == 2
    assert reason in refused.stderr


def test_delay_and_limit_of_the_command_reach_the_proof(monkeypatch: pytest.MonkeyPatch):
    given: dict[str, Any] = {}
    certificate = Certificate(
        statement="the gain is below 2",
        gain=2.0,
        lower_bound=1.0,
        proven=True,
        assumes={"delay_s": "constant"},
        evidence={"kind": "constrained gain"},
        residual=0.0,
    )

    def prove(*_: object, **options: Any) -> Certificate:
        given.update(options)
        return certificate

    monkeypatch.setattr("gustproof.prove.attitude_gain.certify_gain", prove)
    result = run("gain", "hinf-d2", *ENVELOPE, "--delay-ms", "8", "--saturation", "1.5")
    assert (given["delay"], given["saturation"]) == (Delay(largest=0.008), 1.5)
    assert "a simulation or a linear member reached 1" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--delay-ms", "0"), "--delay-ms: the largest delay is 0.0 s, must be positive"),
        (("--saturation", "1"), "saturation is 1.0, must be above 1"),
        (("--saturation", "1.5", "--slow"), "not proved together"),
        (("--saturation", "1.5", "--slow", "--level", "1"), "not proved together"),
    ],
)
def test_a_command_path_that_is_none_is_refused(arguments, reason):
    result = run("gain", "hinf-d2", *ENVELOPE, *arguments)
    assert result.exit_code == 2
    assert reason in result.output


@pytest.fixture(scope="module")
def partly(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    """Return what is said of a moment in N mm where N m are meant, and the certificate."""
    path = tmp_path_factory.mktemp("partly") / "c.json"
    return run("box", "flagship", "--moment", "650,650,300", "-o", str(path)), path


def test_a_part_of_the_moment_is_not_proven_by_the_maker_nor_by_the_check(partly: tuple[Any, Path]) -> None:
    made, path = partly
    checked = run("check", str(path), "--law", "flagship", "--vehicle", "paper")
    for result, start in ((made, "flagship on paper: "), (checked, "")):
        assert result.exit_code == 1
        assert result.stdout.startswith(f"{start}NOT proven for 650, 650, 300 N m; proven for 0.29")
        assert "moment up to [N m]       1.9" in result.stdout
        assert "moment asked [N m]       650, 650, 300\n" in result.stdout
    told = json.loads(run("check", str(path), "--law", "flagship", "--vehicle", "paper", "--json").stdout)
    assert (told["proven"], told["part"] < 0.003) == (False, True)


def test_a_true_attitude_without_bound_is_not_proven() -> None:
    result = run("box", "hinf-scheduled", "--horizon", "600")
    assert result.exit_code == 1
    assert result.stdout.startswith(
        "hinf-scheduled on paper: NOT proven for the true attitude; proven for the law's own"
    )


def law_of(vehicle: str, folder: Path) -> str:
    path = folder / "law.json"
    law = json.loads(law_path("flagship").read_text(encoding="utf-8"))
    path.write_text(json.dumps({**law, "provenance": {**law["provenance"], "vehicle": vehicle}}), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("made_for", "words"), [("my-twin", "'my-twin', which is not shipped"), ("", "names no vehicle")]
)
@pytest.mark.parametrize("proof", [("box",), ("air", "paper-turbulence")])
def test_a_law_of_a_vehicle_that_is_not_at_hand_is_not_proved_on_another(
    made_for: str, words: str, proof: tuple[str, ...], tmp_path: Path
) -> None:
    refused = run(proof[0], law_of(made_for, tmp_path), *proof[1:])
    assert refused.exit_code == 2
    assert words in refused.stderr
    assert "give --vehicle FILE" in refused.stderr


def test_a_law_is_proved_on_its_own_vehicle_and_a_warning_names_another(tmp_path: Path) -> None:
    own = run("box", law_of("iris", tmp_path), "--horizon", "6")
    assert " on iris: " in own.stdout + own.stderr or "unstable" in own.stderr
    told = run("box", law_of("iris", tmp_path), "--vehicle", "paper", "--horizon", "6")
    assert "was designed for vehicle 'iris', not 'paper'" in told.stderr
    assert "law is made for          iris" in told.stdout
    assert told.stdout.splitlines()[0].endswith(" on paper: proven")


def test_a_bias_of_the_gyro_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "biased.toml"
    biased = (
        vehicle_path("paper")
        .read_text(encoding="utf-8")
        .replace("nominal = 0.0, low = -2e-5", "nominal = 0.02, low = 0.0", 1)
    )
    path.write_text(biased.replace("high = 2e-5", "high = 0.03", 1), encoding="utf-8")
    refused = run("box", "flagship", "--vehicle", str(path), "--horizon", "6")
    assert refused.exit_code == 2
    assert "the gyro has a bias (gyro.bias_B)" in refused.stderr


def test_a_parameter_whose_speed_has_no_bound_may_have_any(capsys: pytest.CaptureFixture[str]) -> None:
    show_assumptions({"speeds_per_s": [None, 1.25], "horizon_s": None})
    shown = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert shown == ["assumptions", "speeds up to [1/s] any, 1.25", "duration [s] unlimited"]
