"""Command line: immediate help, one line for each mistake, the right exit status."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from firmware_model.config.files import write_toml
from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import load_vehicle
from firmware_model.recording.journal import JournalWriter
from gustproof.cli.app import app
from gustproof.cli.laws import default_law
from gustproof.cli.replay import _reason_to_differ
from gustproof.design.autopilot_gains import AutopilotTuning
from gustproof.errors import DesignError, FlightError
from gustproof.flight.recording.bag import read_bag
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.flight import FlightPlan
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.scoring.metrics import Metrics
from gustproof.law.form import load_law
from gustproof.studies.audit.checks import AuditVerdict, Row
from gustproof.version import software_versions


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


def one_line(result) -> str:
    assert "Traceback" not in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    return result.stderr.strip()


@pytest.fixture(scope="module")
def second():
    """Fly one second of `calm`."""
    scenario = replace(load_scenario("calm"), duration_s=1.0)
    return fly_direct(scenario, load_law("hinf-d1"), vehicle=load_vehicle("paper"), seed=5)


@pytest.fixture
def end_flight(monkeypatch, fly_here):
    """Return what ends each flight in an outcome with these records; by default it is flown without processes."""

    def end(records=None, outcome=FlightOutcome.DONE):
        def fly(plan, out, **_):
            return fly_here(plan, out, records, outcome)

        monkeypatch.setattr("gustproof.flight.routes.recorder.fly_plan", fly)

    return end


@pytest.mark.parametrize("command", ["reproduce", "design", "fly"])
def test_help_shows_an_example(command):
    result = run(command, "--help")
    assert result.exit_code == 0
    assert f"gustproof {command}" in result.stdout


@pytest.mark.parametrize(
    ("command", "option"), [(("autopilot", "fly"), "--lockstep"), (("controller", "run"), "--via")]
)
def test_a_process_command_has_the_command_line_of_the_others(command, option):
    shown = run(*command, "--help").stdout
    assert option in shown
    assert "Exit status" in shown


def test_help_loads_nothing_heavy():
    code = (
        "import sys; from gustproof.cli.app import app\n"
        "try: app(['--help'])\n"
        "except SystemExit: pass\n"
        "print(*sorted({'numpy', 'pydantic', 'numba', 'scipy', 'matplotlib', 'control', 'rosbags'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.splitlines()[-1] == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("fly", "nowhere", "--law", "hinf-d1"), "no scenario named 'nowhere'"),
        (("fly", "paper", "--law", "nothing"), "no law named 'nothing'"),
        (("fly", "paper", "--law", "hinf-d1", "--vehicle", "bike"), "no vehicle named 'bike'"),
        (("fly", "paper", "--law", ""), "no law named ''"),
        (("fly", "paper", "--law", "pid-fair", "--vehicle", "iris"), "'pid-fair' is unstable on vehicle 'iris'"),
        (("tune", "iris", "--slew", "0"), "slew 0 N m/s: must be above 0, such as 20"),
        (("tune", "iris", "--slew", "1e30"), "torques of vehicle 'iris' change by at most 892 N m/s rms"),
        (("tune", "iris", "--ms", "1"), "sensitivity peak 1.0: must be between 1 and 10"),
        (("tune", "iris", "--scenario", "calm"), "'calm' has no turbulence"),
        (("tune", "iris", "-o", "law.params"), "a law file ends in .json"),
        (("tune", "iris", "--from", "px4", "-o", "my.json"), "my.json: a parameter file ends in .params"),
        (("tune", "iris", "--from", "px4", "--law", "pid"), "--law cannot be given with it"),
        (("fly", "paper", "--law", "/nowhere/law.json"), "/nowhere/law.json: No such file"),
        (("design", "hinfsyn", "D99"), "no design named 'D99'"),
        (("design", "hinfsyn", "D1", "--gamma", "0.1"), "gamma"),
        (("design", "hinfsyn", "D1", "--gamma", "0.3", "--backoff", "1.1"), "give one of them"),
        (("design", "hinfsyn", "D1", "--backoff", "1.0"), "--backoff must be above 1"),
        (("design", "hinfsyn", "D1", "-o", "law.txt"), "ends in .json"),
        (("design", "hinfsyn", "D1", "-o", "/nowhere/law.json"), "/nowhere: no such folder"),
    ],
)
def test_bad_input_is_one_clear_line_and_status_2(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run(*arguments)
    assert result.exit_code == 2
    assert words in one_line(result)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_gains_of_an_autopilot_have_the_true_error_first(monkeypatch):
    tuning = AutopilotTuning(
        kind="px4", parameters={"MC_ROLL_P": 5.0}, law=load_law("flagship"), rmse=0.0015, seen_rmse=0.00085, slew=21.29,
        Ms=1.399, corner_Ms=2.1,
    )  # fmt: skip
    monkeypatch.setattr("gustproof.studies.rate.filter_tuning.tune_gains", lambda *_, **__: tuning)
    words = ("tune", "paper", "--from", "px4")
    told = r"predicted in paper-turbulence: error (\S+) deg \((\S+) deg by its own attitude, without the walk of the "
    told += r"gyro's noise\), torque slew \S+ N m/s, Ms \S+, \S+ over the file's spreads\n"
    found = re.search(told + r"next: gustproof tune paper --from px4 -o paper.params\n$", run(*words).stdout)
    assert float(found[1]) > float(found[2]) > 0.0
    first, last = (json.loads(run(*words, "--json", *more).stdout) for more in ((), ("--at-once",)))
    assert first["steps"] == last["steps"]
    for document, at in ((first, 1), (last, -1)):
        assert document["parameters"] == document["steps"][at]["parameters"]
        assert 0.0 < document["rmse_deg"] < document["true_rmse_deg"]
    assert last["parameters"]["MC_ROLL_P"] == 5.0 < first["parameters"]["MC_ROLL_P"] < 6.5


def test_without_a_law_it_is_said_that_one_is_tuned(monkeypatch, capsys):
    tuning = SimpleNamespace(law=load_law("flagship"), Ms=1.4, slew=8.0)
    monkeypatch.setattr("gustproof.design.tune.tune_law", lambda *_, **__: tuning)
    asked = load_vehicle_set("iris"), load_scenario("calm")
    assert default_law(*asked, quiet=False) is tuning.law
    assert capsys.readouterr().err.startswith("gustproof: no --law: tuning one for 'iris'\ngustproof: flagship tuned")
    default_law(*asked, quiet=True)
    assert "no --law" not in capsys.readouterr().err


def test_a_scenario_with_an_unknown_key_names_file_and_key(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('description = "x"\nduration_s = 1.0\ndurationn_s = 2.0\n')
    result = run("fly", str(path), "--law", "hinf-d1")
    assert result.exit_code == 2
    assert f"{path}: line 3, durationn_s: unknown key" in one_line(result)


@pytest.mark.parametrize(
    ("event", "words"),
    [
        ("kind = 'payload'\nmass_kg = -3.0", "event 'payload' at 0.5 s: vehicle 'iris' of 1.5 kg can't be with -3 kg"),
        ("kind = 'payload'\nmass_kg = 30.0", "can't be with +30 kg: rotors.thrust_max: all rotors must lift 1.2 times"),
        ("kind = 'payload'\ninertia_share = [0.0, 0.0, 2.0]", "from 0.5 s on: inertia_B: no rigid body has"),
        ("kind = 'rotor_failure'\nrotor = 5", "event 'rotor_failure': vehicle 'iris' has 4 rotors, no 5"),
    ],
)
def test_an_event_that_the_vehicle_can_not_have_is_one_line(event, words, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(f"description = 'x'\nduration_s = 1.0\ntranslation = 'free'\n[[event]]\nat_s = 0.5\n{event}\n")
    for arguments in (("fly", str(path), "--law"), ("campaign", "fly", str(path), "--law")):
        result = run(*arguments, "pid-default", "--vehicle", "iris", "--output" if arguments[0] == "fly" else "-o",
                     str(tmp_path / "out.parquet"))  # fmt: skip
        assert result.exit_code == 2
        assert words in one_line(result)
        assert len(result.stderr) < 300


@pytest.mark.parametrize(
    ("words", "given"),
    [
        (("tune", "paper", "--slew", "20 N m/s"), "(given '20 N m/s')"),
        (("tune", "paper", "--slew", "20,5"), "(given '20,5')"),
        (("campaign", "fly", "calm", "--runs", "1e3"), "(given '1e3')"),
        (("fly", "calm", "--junit", "a.xml"), "says what is written: -o junit.xml"),
    ],
)
def test_a_text_that_is_no_number_is_shown(words, given):
    result = run(*words)
    assert result.exit_code == 2
    assert given in " ".join(result.stderr.replace("│", " ").split())


def test_a_taken_output_folder_is_refused(tmp_path):
    (tmp_path / "mine").touch()
    result = run("fly", "paper", "--law", "hinf-d1", "--output", str(tmp_path))
    assert result.exit_code == 2
    assert "nothing is overwritten" in one_line(result)


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (DesignError("no controller"), 2),
        (FlightError("lost"), 3),
        (KeyboardInterrupt(), 130),
        (PermissionError(13, "Permission denied", "/root/x"), 2),
        (OSError(28, "No space left on device"), 2),
    ],
)
def test_each_failure_has_its_status(error, status, monkeypatch):
    def fail(_: object) -> None:
        raise error

    monkeypatch.setattr("gustproof.design.designs.load_design", fail)
    result = run("design", "hinfsyn", "D1")
    assert result.exit_code == status
    one_line(result)


def test_what_nobody_expected_is_not_hidden(monkeypatch):
    def fail(_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("gustproof.design.designs.load_design", fail)
    assert isinstance(run("design", "hinfsyn", "D1").exception, ZeroDivisionError)


@pytest.mark.slow
def test_a_design_prints_its_levels_and_leaves_law_and_figure(tmp_path):
    law = tmp_path / "law.json"
    result = run("design", "hinfsyn", "D1", "--json", "-o", str(law))
    assert result.exit_code == 0
    figures = json.loads(result.stdout)
    assert figures["gamma_opt"] == pytest.approx(0.2136, abs=2e-4)
    assert figures["norm"] < figures["gamma"] == 0.25
    assert json.loads(law.read_text())["name"] == figures["law"]
    assert law.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def test_a_level_can_be_asked_for_either_way():
    least = json.loads(run("design", "hinfsyn", "D1", "--json").stdout)["gamma_opt"]
    by_level = json.loads(run("design", "hinfsyn", "D1", "--gamma", "0.3", "--json").stdout)
    by_backoff = json.loads(run("design", "hinfsyn", "D1", "--backoff", "1.1", "--json").stdout)
    assert by_level["gamma"] == 0.3
    assert by_backoff["gamma"] == pytest.approx(1.1 * least, rel=1e-6)


def test_the_flagship_flies_unless_another_law_is_asked_for(tmp_path, monkeypatch):
    def fly(plan, out, **_):
        raise FlightError(f"{plan.controller.name} was asked to fly {plan.scenario.name}")

    monkeypatch.setattr("gustproof.flight.routes.recorder.fly_plan", fly)
    result = run("fly", "calm", "--output", str(tmp_path / "out"))
    assert "flagship was asked to fly calm" in one_line(result)
    assert "[default: flagship]" in run("controller", "run", "--help").stdout


@pytest.mark.parametrize(
    ("outcome", "status"),
    [(FlightOutcome.DONE, 0), (FlightOutcome.CONTROLLER_LOST, 3), (FlightOutcome.INTERRUPTED, 130)],
)
def test_a_flight_leaves_its_bag_whatever_its_end_and_its_status_says_which(
    outcome, status, tmp_path, second, end_flight
):
    end_flight(second, outcome)
    result = run("fly", "calm", "--law", "hinf-d1", "--seed", "5", "--json", "--output", str(tmp_path / "out"))
    assert result.exit_code == status
    told = json.loads(result.stdout)
    assert set(Metrics.__dataclass_fields__) < set(told)
    assert (told["scenario"], told["law"], told["seed"], told["realtime_factor"]) == ("calm", "hinf-d1", 5, 9.0)
    about, records = read_bag(tmp_path / "out" / "calm-hinf-d1-seed5")
    assert about["outcome"] == outcome.name.lower()
    assert len(records) == 250
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["calm-hinf-d1-seed5"]
    if status:
        assert str(tmp_path / "out") in one_line(result)


@pytest.fixture
def direct(end_flight):
    """Fly without processes."""
    end_flight()


def test_anyway_flies_what_is_refused_and_warns_of_it(tmp_path, direct):
    refused = ("calm", "--law", "pid-fair", "--vehicle", "iris")
    plain = run("fly", *refused, "--anyway", "--output", str(tmp_path / "plain"))
    assert plain.exit_code == 0
    told = json.loads(run("fly", *refused, "--anyway", "--json", "--output", str(tmp_path / "json")).stdout)["warnings"]
    assert "unstable" in told[0]
    assert len(told) == 2
    assert plain.stderr == "".join(f"gustproof: warning: {line}\n" for line in told)
    assert all(f"warning: {line}" in " ".join(plain.stdout.split()) for line in told)


@pytest.mark.slow
def test_a_repetition_says_whether_it_is_equal(tmp_path, direct):
    first, second = str(tmp_path / "first"), str(tmp_path / "second")
    assert run("fly", "calm", "--law", "pid-fair", "--output", first).exit_code == 0
    again = run("replay", first, "--json", "--output", second)
    assert again.exit_code == 0
    assert json.loads(again.stdout)["equal"] is True
    assert again.stderr == f"gustproof: equal to {first} in every bit of its 15000 samples\n"


@pytest.mark.slow
def test_a_repetition_of_a_flight_that_now_differs_says_so_in_json(tmp_path, direct, monkeypatch):
    first, second = str(tmp_path / "first"), str(tmp_path / "second")
    assert run("fly", "calm", "--law", "pid-fair", "--output", first).exit_code == 0
    monkeypatch.setattr("gustproof.flight.recording.difference.first_difference", lambda *_: (125, 15000))
    again = run("replay", first, "--json", "--output", second)
    assert again.exit_code == 1
    assert json.loads(again.stdout)["equal"] is False
    assert "differs from" in one_line(again)


@pytest.mark.parametrize("command", ["report", "replay"])
def test_a_flight_that_was_cut_off_is_completed_from_its_journal(command, tmp_path, second, direct):
    plan = FlightPlan(
        replace(load_scenario("calm"), duration_s=1.0), load_law("hinf-d1"), load_vehicle("paper"), 5, False
    )
    (run_folder := tmp_path / "run").mkdir()
    with JournalWriter(run_folder / "x.journal", {"note": json.loads(json.dumps(plan.metadata()))}) as journal:
        for row in second[:100].copy().view(np.float64).reshape(100, -1):
            journal.append(row)
    output = tmp_path / ("page.html" if command == "report" else "again")
    told = run(command, str(run_folder), "-o", str(output))
    assert told.exit_code == 0, told.stderr
    assert f"100 of {len(second)} samples" in " ".join(told.stdout.split())
    assert [path.is_dir() for path in run_folder.iterdir()] == [True]
    assert output.exists()


@pytest.mark.parametrize(
    ("told", "reason"),
    [
        ({"versions": {**software_versions(), "numba": "0.1"}, "controller": {}}, "it was flown with numba 0.1, now"),
        ({"controller": {"source": "mine.py:make"}}, "a controller of one's own need not fly the same twice"),
        ({"autopilot": {"autopilot": "px4"}}, "PX4 arms on a thread of its own"),
        ({"autopilot": {"autopilot": "ardupilot"}}, "the versions are the same"),
        ({"autopilot": None}, "the versions are the same"),
    ],
)
def test_a_repetition_that_differs_tells_what_may_be_the_reason(told, reason):
    assert _reason_to_differ({"versions": software_versions(), **told}).startswith(reason)


def test_a_repetition_of_a_real_time_flight_says_that_nothing_is_compared(tmp_path, direct):
    first, second = str(tmp_path / "first"), str(tmp_path / "second")
    assert run("fly", "calm", "--law", "pid-fair", "--real-time", "--output", first).exit_code == 0
    again = run("replay", first, "--json", "--output", second)
    assert again.exit_code == 0
    assert json.loads(again.stdout)["equal"] is None
    assert one_line(again) == (
        f"gustproof: {first} was flown in real time, where no two flights share all bits: not compared"
    )


def test_a_report_is_not_written_over_another_file(tmp_path, direct):
    page = tmp_path / "report.html"
    page.write_text("mine")
    assert run("fly", "calm", "--law", "pid-fair", "--output", str(tmp_path / "run")).exit_code == 0
    refused = run("report", str(tmp_path / "run"), "-o", str(page))
    assert (refused.exit_code, page.read_text()) == (2, "mine")
    assert one_line(refused) == f"gustproof: {page}: exists already; --force overwrites it"


@pytest.mark.parametrize("law", ["hinf-d1", "pid-fair"])
def test_references_that_a_law_ignores_are_warned_of_once(law, tmp_path, direct):
    turn = 'kind = "attitude"\nat_s = 0.5\neuler_deg = [5.0, 0.0, 0.0]\n'
    (tmp_path / "turn.toml").write_text(f'description = "turn"\nduration_s = 1.0\n[[event]]\n{turn}')
    plain, json_ = (
        run("fly", str(tmp_path / "turn.toml"), "--law", law, "--output", str(tmp_path / str(i)), *form)
        for i, form in enumerate(((), ("--json",)))
    )
    told = json.loads(json_.stdout)["warnings"]
    assert len(told) == (law == "hinf-d1")
    assert plain.stderr == "".join(f"gustproof: warning: {line}\n" for line in told)
    assert json_.stderr == ""


def test_ctrl_c_while_the_bag_is_written_keeps_the_journal_and_says_what_to_do(
    tmp_path, monkeypatch, second, end_flight
):
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    end_flight(second)
    monkeypatch.setattr("gustproof.flight.routes.recorder.write_bag", interrupted)
    out = tmp_path / "out"
    result = run("fly", "calm", "--law", "hinf-d1", "--output", str(out))
    assert result.exit_code == 130
    assert result.stderr.strip().endswith(f"gustproof report {out} completes it")
    assert [path.name for path in out.iterdir()] == ["calm-hinf-d1-seed1.journal"]


@pytest.mark.parametrize("existing", ["law.c", "law.h", "law.mat", "law.json"])
def test_export_overwrites_nothing(existing, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / existing).write_text("mine")
    result = run("export", "pid-default", "-o", "law.c", "-o", "law.mat", "-o", "law.json")
    assert result.exit_code == 2
    assert one_line(result) == f"gustproof: {existing}: exists already; --force overwrites it"
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(existing, "mine")]


def test_export_names_the_header_that_it_writes_beside_the_source(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("export", "pid-default", "-o", "my-law.c").stdout == "law 'pid-default' in my-law.c and my-law.h\n"
    assert '#include "my-law.h"' in (tmp_path / "my-law.c").read_text()
    assert "int pid_default_self_test(void);" in (tmp_path / "my-law.h").read_text()


def test_export_at_another_rate_tells_the_margins_of_both(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = run("export", "flagship", "--rate", "400", "-o", "fast.json").stdout.splitlines()
    assert [line[:14] for line in lines[:2]] == ["250 Hz: Ms 1.3", "400 Hz: Ms 1.3"]
    assert load_law("fast.json").dt == 1.0 / 400.0


def test_export_in_single_precision_proves_its_rounding(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = json.loads(run("export", "flagship", "--float32", "-o", "law.c", "--json").stdout)
    assert told["rounding"]["proven"]
    assert told["rounding"]["attitude_deg"] <= 0.02
    assert told["instructions"] >= told["operations"] > 1000
    header = " ".join((tmp_path / "law.h").read_text().replace("\n *", " ").split())
    assert told["rounding"]["statement"] in header
    assert "void flagship_init(float x[" in header


def test_export_says_where_no_bound_of_rounding_is_proved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("export", "flagship", "--float32", "--attitude", "autopilot", "-o", "law.c")
    assert "No bound of the rounding is proved with the autopilot's attitude." in result.stdout
    assert "No bound of the rounding is proved" in (tmp_path / "law.h").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["flagship", "--rate", "125", "-o", "law.c"], "poor at 125 Hz"),
        (["flagship", "--vehicle", "paper", "-o", "law.c"], "--vehicle: belongs to --rate"),
        (["flagship", "--float32", "-o", "law.json"], "belong to a .c file"),
        (["flagship", "--attitude", "theirs", "-o", "law.c"], "must be one of own, autopilot"),
        (["hinf-d1", "--attitude", "autopilot", "-o", "law.c"], "is linear"),
        (["aided", "--float32", "-o", "law.c"], "reads the accelerometer"),
    ],
)
def test_export_refuses_in_one_line_and_writes_nothing(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("export", *arguments)
    assert result.exit_code == 2
    assert words in one_line(result)
    assert not list(tmp_path.iterdir())


def test_export_writes_a_folder_for_each_autopilot_at_its_rate(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("export", "pid-fair", "--px4", "p", "--ardupilot", "a", "--crazyflie", "c", "--json")
    told = json.loads(result.stdout)
    assert [(each["files"], each["rate_hz"]) for each in told] == [(["p"], 250.0), (["a"], 400.0), (["c"], 250.0)]
    assert {each["attitude"] for each in told} == {"autopilot"}
    assert (tmp_path / "p/src/modules/gustproof/gustproof_law.c").is_file()
    again = run("export", "pid-fair", "--px4", "p")
    assert one_line(again) == "gustproof: p: exists already; --force overwrites it"


@pytest.mark.parametrize("option", ["--px4", "--ardupilot", "--crazyflie"])
def test_a_law_that_is_unstable_on_the_vehicle_is_exported_only_anyway(option, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    paper = load_vehicle("paper")
    write_toml(replace(paper, name="small", inertia_B=tuple(row / 20.0 for row in paper.inertia_B)), Path("small.toml"))
    refused = run("export", "flagship", option, "p", "--vehicle", "small.toml")
    assert (refused.exit_code, (tmp_path / "p").exists()) == (2, False)
    assert re.match(r"gustproof: law '\S+' is unstable on vehicle 'small' at .*; --anyway writes it", one_line(refused))
    told = json.loads(run("export", "flagship", option, "p", "--vehicle", "small.toml", "--anyway", "--json").stdout)
    assert told["stable"] is False
    assert "UNSTABLE: law 'flagship" in (tmp_path / "p/README.md").read_text()


def test_c_code_for_a_vehicle_that_is_named_is_refused_where_its_loop_is_unstable(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused = run("export", "flagship", "-o", "law.c", "--float32", "--vehicle", "iris")
    assert (refused.exit_code, (tmp_path / "law.c").exists()) == (2, False)
    assert "unstable on vehicle 'iris'" in one_line(refused)


def test_a_law_for_a_vehicle_of_ones_own_asks_for_its_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    law = load_law("flagship")
    replace(law, provenance=replace(law.provenance, vehicle="my-twin")).save(tmp_path / "mine.json")
    refused = run("export", "mine.json", "--px4", "p")
    assert refused.exit_code == 2
    assert "give --vehicle FILE" in one_line(refused)


def test_export_of_a_linear_law_keeps_its_own_attitude(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, verdict = run("export", "hinf-d1", "--px4", "p").stdout.splitlines()
    assert first == "law 'hinf-d1' in p for vehicle 'paper', see its README.md"
    assert verdict.startswith("At hover on vehicle 'paper' at 250 Hz, 4 ms late: Ms ")
    assert "The law is linear" in (tmp_path / "p/README.md").read_text()
    refused = run("export", "hinf-d1", "--px4", "q", "--attitude", "autopilot")
    assert (refused.exit_code, (tmp_path / "q").exists()) == (2, False)
    assert "linear" in one_line(refused)


def test_analyse_of_numbers_beyond_all_routines_is_one_clear_line(tmp_path):
    replace(load_law("hinf-d1"), name="huge", C=np.full((3, 9), 1e307)).save(tmp_path / "huge.json")
    result = run("analyse", str(tmp_path / "huge.json"), "-o", str(tmp_path / "huge.png"))
    assert result.exit_code == 2
    assert "law 'huge' cannot be analysed on vehicle 'paper'" in one_line(result)


def test_a_parameter_file_is_a_law_and_what_it_lacks_is_told(tmp_path):
    path = tmp_path / "mine.params"
    path.write_text("MC_ROLL_P 5\nMC_ROLRATE_P 0.1\n")
    result = run("export", str(path), "-o", str(tmp_path / "mine.json"), "--rate", "500")
    assert result.exit_code == 0, result.stderr
    assert "px4-mine: not known: MC_ROLRATE_P" in result.stderr
    law = load_law(tmp_path / "mine.json")
    assert (law.name, law.dt) == ("px4-mine", 0.002)
    assert law.provenance.parameters["MC_ROLL_P"] == 5.0


def test_a_bad_parameter_file_is_one_line(tmp_path):
    path = tmp_path / "mine.param"
    path.write_text("ATC_RAT_RLL_P -1\n")
    for arguments in (("analyse", str(path)), ("fly", "calm", "--law", str(path)), ("worst-case", str(path))):
        result = run(*arguments)
        assert result.exit_code == 2
        assert one_line(result) == f"gustproof: {path}: ATC_RAT_RLL_P: is -1, must be 0 to 100"


@pytest.mark.parametrize(
    ("verdicts", "status", "told"),
    [
        (["not reachable", "not reachable"], 1, True),
        ([], 1, True),
        (["not reachable", "passed"], 0, False),
        (["not reachable", "FAILED"], 1, False),
    ],
)
def test_audit_in_which_nothing_was_tested_is_no_success(monkeypatch, verdicts, status, told):
    rows = [Row("test", "", "", (), "", "", AuditVerdict(verdict)) for verdict in verdicts]
    monkeypatch.setattr("gustproof.studies.audit.checks.audit", lambda _: rows)
    done = run("audit", "own", "--json")
    assert done.exit_code == status
    assert len(json.loads(done.stdout)["rows"]) == len(rows)
    assert ("gustproof: nothing was tested of gustproof" in done.stderr) == told
