"""`gustproof judge`: what it reads, what it prints, its page and parameter file, its exit status."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from firmware_model.config.parameter_files import read_parameters
from firmware_model.config.vehicle import load_vehicle
from gustproof.cli.app import app
from gustproof.design.loops.models import read_autopilot_law
from gustproof.logs.read import read_log as read
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.studies.rate import judge as judging

SPOILT = {**read_parameters("tuned", "px4"), "IMU_DGYRO_CUTOFF": "2"}


def run(*arguments: str):
    return CliRunner().invoke(app, ["judge", *arguments])


@pytest.fixture
def quick(monkeypatch):
    """Search shortly; the proof and the flights of the search have tests of their own. Return what is judged."""
    judge, judged = judging.judge_law, []

    def kept(*arguments, **options):
        judged.append(judge(*arguments, **options))
        return judged[-1]

    monkeypatch.setattr(judging, "judge_law", kept)
    monkeypatch.setattr(judging, "_FLIGHTS", 100)
    monkeypatch.setattr(judging, "_SEARCH_S", 1.0)
    monkeypatch.setattr(judging, "_prove", lambda *_: (None, "left out"))
    return judged


@pytest.fixture
def spoilt(tmp_path: Path) -> Path:
    path = tmp_path / "spoilt.params"
    path.write_text("".join(f"{name} {value}\n" for name, value in SPOILT.items()), encoding="utf-8")
    return path


@pytest.mark.slow
def test_spoilt_gains_are_fragile_and_better_ones_are_written(quick, spoilt, monkeypatch):
    page, better = spoilt.with_suffix(".html"), spoilt.with_name("better.params")
    result = run(str(spoilt), "-o", str(page), "--better", str(better))
    assert result.exit_code == 1, result.stderr
    assert result.stdout.startswith("fragile: px4-spoilt on 'paper' in 'paper-turbulence', 250 Hz, 4 ms late")
    for words in (
        "- yaw: Ms 5.57, above 2",
        "proved",
        "where it fails",
        "IMU_DGYRO_CUTOFF 2 Hz to 6 Hz",
        "Better gains: Sound in place of fragile, less error",
        "delay [ms], nominal; worst corner",
        "peak where it fails now [deg]",
        "feel the motors",
    ):
        assert words in result.stdout
    assert f"{page} is written" in result.stdout
    assert result.stdout.index("│ verdict") > result.stdout.index("┃ now ") > 0
    assert result.stderr.startswith("gustproof: no --vehicle given: judged on 'paper'\n")
    assert read_autopilot_law(better, load_vehicle("paper")).law.provenance.parameters["IMU_DGYRO_CUTOFF"] > 10.0
    text = page.read_text(encoding="utf-8")
    for words in (
        "px4-spoilt on",
        '<a href="#verdict">Verdict</a>',
        '<section id="verdict">',
        "Ms 5.57, above 2",
        "Better gains: Sound in place of fragile, less error",
        "feel the motors",
        "Sensitivity, px4-spoilt",
        "where it fails",
    ):
        assert words in text
    assert "spreads \u2264 " in text
    assert '"kind":"semilog"' in text
    monkeypatch.setattr(judging, "judge_law", lambda *_, **__: quick[0])
    monkeypatch.setattr(judging, "improve", lambda *_: None)
    vain = run(str(spoilt), "--vehicle", "paper", "--better", str(spoilt.with_name("none.params")))
    assert (vain.exit_code, "Better gains" in vain.stdout) == (2, False)
    assert "\nno better gains found within 2 times this torque slew" in vain.stdout
    assert vain.stderr.endswith("none.params is not written\n")
    assert not spoilt.with_name("none.params").exists()
    assert "no --vehicle" not in vain.stderr


def test_a_sound_law_is_told_as_json(quick):
    result = run("flagship", "--json")
    assert result.exit_code == 0, result.stderr
    told = json.loads(result.stdout)
    assert (told["verdict"], told["better"], told["advice"], told["remarks"]) == ("sound", None, [], [])
    assert told["axes"]["pitch"]["Ms_found"] <= told["axes"]["pitch"]["Ms_proved"]
    assert told["worst_gust"]["peak_deg"] > 0.0


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("RATE_RLL_P", "names of ArduCopter before 3.4"),
        ("Q_A_RAT_RLL_P", "quadplane"),
        ("INS_GYRO_FILTER", "no gain of"),
    ],
)
def test_a_log_without_gains_that_are_known_is_refused(tmp_path, name, told):
    path = tmp_path / "flight.log"
    lines = [f"IMU, {2500 * i}, 0.1, {i % 7}e-3, 0.3" for i in range(1, 90)]
    head = ["FMT, 11, 0, IMU, Qfff, TimeUS,GyrX,GyrY,GyrZ", f"PARM, 1000, {name}, 0.135"]
    path.write_text("\n".join([*head, *lines, ""]))
    result = run(str(path))
    assert result.exit_code == 2
    assert f"{path}: " in result.stderr.replace("\n", "")
    assert told in result.stderr.replace("\n", " ")


@pytest.mark.slow
def test_the_gains_of_a_log_are_those_of_its_parameters(quick, monkeypatch, tmp_path):
    gyro = LogSignal(time=np.arange(2.0), values=np.zeros((2, 3)))
    log = FlightLog(source="flight.ulg", system="px4", gyro=gyro, findings=("no accelerometer",),
                    parameters={name: float(value) for name, value in SPOILT.items()})  # fmt: skip
    monkeypatch.setattr(read, "read_log", lambda _: log)
    monkeypatch.setattr(judging, "tune_gains", lambda *_, **__: SimpleNamespace(**judged))
    law = read_autopilot_law(_tuned(tmp_path), load_vehicle("paper")).law
    judged = {"law": law, "Ms": 1.4, "slew": 12.0, "rmse": 0.002}
    result = run(str(tmp_path / "flight.ulg"), "--vehicle", "paper", "--json")
    assert result.exit_code == 1, result.stderr
    told = json.loads(result.stdout)
    assert (told["verdict"], told["better"]["verdict"]) == ("fragile", "sound")
    assert told["better"]["title"].startswith("Sound in place of fragile, less Ms over the spreads, for")
    assert told["better"]["where_now_fails"]["better_peak_deg"] < told["better"]["where_now_fails"]["now_peak_deg"]
    assert told["remarks"][-1] == "no accelerometer"
    monkeypatch.setattr(read, "read_log", lambda _: replace(log, parameters={}))
    result = run(str(tmp_path / "flight.ulg"))
    assert (result.exit_code, "the log has no parameters" in result.stderr) == (2, True)


def flown(gain):
    """Return the log of doublets by PX4's gains on a vehicle of `gain` [rad/s^2 per unit of command]."""
    rng, dt, n = np.random.default_rng(2), 0.004, 12000
    asked = np.radians(10.0) * np.sign(np.sin(np.arange(n)[:, None] * dt * np.array([3.1, 2.3, 1.4])))
    rate, angle, torque, trim, gust = (np.zeros(3) for _ in range(5))
    rates, commands, angles = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    for k in range(n):
        angles[k] = angle
        rates[k] = rate + 0.002 * rng.standard_normal(3)
        error = 4.0 * (asked[k] - angle) - rates[k]
        trim = trim + 3.0 / gain * error * dt
        commands[k] = 8.0 / gain * error + trim
        torque = torque + dt / 0.03 * (commands[k] - torque)
        gust = gust + dt * (3.0 * rng.standard_normal(3) / np.sqrt(dt) - 2.0 * gust)
        rate = rate + dt * (gain * torque - 0.3 * rate + gust)
        angle = angle + dt * rate
    time = dt * np.arange(n)
    return FlightLog(
        source="flight.ulg", system="px4", gyro=LogSignal(time=time, values=rates),
        command=LogSignal(time=time, values=commands), attitude=LogSignal(time=time, values=angles),
        reference=LogSignal(time=time, values=asked), airborne=((0.0, n * dt),),
        parameters={f"MC_{axis}RATE_P": 8.0 / gain for axis in ("ROLL", "PITCH", "YAW")} | {"IMU_GYRO_RATEMAX": 250.0},
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("over", [False, True])
def test_gains_of_a_log_are_judged_on_the_vehicle_that_it_shows(quick, monkeypatch, tmp_path, over):
    monkeypatch.setattr(read, "read_log", lambda _: flown(60.0))
    path, gains = str(tmp_path / "flight.ulg"), tmp_path / "my.params"
    gains.write_text("MC_ROLLRATE_P 0.1\n")
    result = run(*((str(gains), "--over", path) if over else (path,)), "--json")
    told = json.loads(result.stdout)
    assert told["remarks"][0].startswith("on the vehicle that flight.ulg shows, in the air that it flew in; no log")
    (judged, *_) = quick
    assert judged.law.provenance.parameters["MC_ROLLRATE_P"] == pytest.approx(0.1 if over else 8.0 / 60.0)
    assert told["remarks"][-1].startswith("in this flight: error of roll, pitch and yaw ") is over
    full = np.array(judged.vehicle.torque_limit) / judged.vehicle.inertia_B
    assert full == pytest.approx([60.0] * 3, rel=0.1)
    assert judged.vehicle.actuator_lag == pytest.approx(0.03, abs=0.01)
    assert "no --vehicle given" not in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "told"), [(60.0, True), (1.0, False)])
def test_gains_that_flew_but_are_unstable_by_the_model_are_doubted(quick, monkeypatch, tmp_path, factor, told):
    log = flown(60.0)
    gains = {name: factor * value for name, value in log.parameters.items() if name.endswith("_P")}
    monkeypatch.setattr(read, "read_log", lambda _: replace(log, parameters={**log.parameters, **gains}))
    monkeypatch.setattr(judging, "improve", lambda *_: None)
    document = json.loads(run(str(tmp_path / "flight.ulg"), "--json").stdout)
    assert (document["verdict"] == "unstable") is told
    assert document["remarks"][0].startswith("yet they flew 48 s in this log: ") is told


def test_a_log_that_shows_no_vehicle_is_refused_with_the_way_out(monkeypatch, tmp_path):
    log = flown(60.0)
    monkeypatch.setattr(read, "read_log", lambda _: replace(log, command=None))
    result = run(str(tmp_path / "flight.ulg"))
    assert result.exit_code == 2
    assert result.stderr.endswith(
        "neither torque commands nor motor outputs are logged: set SDLOG_PROFILE 17; or give --vehicle FILE\n"
    )


def _tuned(folder: Path) -> Path:
    path = folder / "tuned.params"
    path.write_text("".join(f"{n} {v}\n" for n, v in read_parameters("tuned", "px4").items()), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nothing",), "no law named 'nothing'"),
        (("nothing.params",), "nothing.params"),
        (("pid-fair", "--air", "coning"), "has no turbulence"),
        (
            ("hinf-rates",),
            "law 'hinf-rates' cannot be judged on vehicle 'paper': law 'hinf-rates' commands rates: its loop",
        ),
        (("flagship", "--moment", "1,2,0"), "must be positive"),
        (("flagship", "-o", "page.txt"), "ends in .html"),
        (("flagship", "--better", "better.params"), "ends in .json"),
        (("px4", "--better", "better.json"), "ends in .params"),
        (("flagship", "--vehicle", "none"), "no vehicle named 'none'"),
    ],
)
def test_a_mistake_is_one_line(arguments, words):
    result = run(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1
