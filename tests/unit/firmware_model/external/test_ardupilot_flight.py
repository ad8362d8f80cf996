"""Flights of a stand-in for ArduCopter that checks every field, and its ends by their names.

With GUSTPROOF_ARDUPILOT, a build of ArduCopter for simulation, the flights to the end are flown by the real one too.
"""

import json
import os
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest

from firmware_model.config.parameter_files import read_parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.external import ardupilot_process
from firmware_model.external.ardupilot import encode_answer
from firmware_model.external.interface import ExternalOptions
from firmware_model.external.readings import Readings
from firmware_model.external.world import World
from firmware_model.recording.estimates import read_estimates
from firmware_model.recording.journal import read_journal

PEER = Path(__file__).parent
REAL = os.environ.get("GUSTPROOF_ARDUPILOT", "")
real = pytest.mark.skipif(not REAL, reason="GUSTPROOF_ARDUPILOT names no build of ArduCopter")
Fly = Callable[..., dict[str, Any]]
SCRIPT = """
description = "a short gust"
duration_s = 1.0
control_rate_hz = 400
physics_rate_hz = 1200
translation = "{translation}"

[[wind]]
kind = "dryden"
wind_speed_20ft_mps = 10.0
"""
LOST = """
[[event]]
kind = "gps_lost"
at_s = 0.25
for_s = 0.5
"""


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    if "real" in request.node.name:
        return
    monkeypatch.setattr(ardupilot_process.ArduPilot, "arming_timeout_s", 3.5)


@pytest.fixture
def fly(fly_script: Fly) -> Fly:
    def in_gust(
        *options: str, translation: str = "held", build: str = str(PEER), events: str = "", folder: str = "."
    ) -> dict[str, Any]:
        script = SCRIPT.format(translation=translation) + events
        return fly_script("ardupilot", script, *options, build=build, folder=folder)

    return in_gust


@pytest.mark.parametrize(("fault", "outcome"), [("", "done"), ("no law", "wrong_build")])
def test_law_inside_is_switched_on_before_the_scenario(
    tmp_path: Path, fly: Fly, monkeypatch: pytest.MonkeyPatch, fault: str, outcome: str
) -> None:
    monkeypatch.setenv("PEER_FAULT", fault)
    facts = fly("--law", "flagship")
    assert facts["outcome"] == outcome, facts["reason"]
    assert facts["autopilot"]["parameters"]["CC_AXIS_MASK"] == "7"
    said = "Custom controller type is out of range" if fault else "Custom controller is ON"
    assert said in facts["texts"]
    assert (said in facts["reason"]) == bool(fault)


@pytest.mark.parametrize(("translation", "fault"), [("held", "repeat"), ("free", "wide")])
def test_peer_finds_no_fault_and_flies_the_scenario(
    tmp_path: Path, fly: Fly, monkeypatch: pytest.MonkeyPatch, translation: str, fault: str
) -> None:
    monkeypatch.setenv("PEER_FAULT", fault)
    given = tmp_path / "given.parm"
    given.write_text("ATC_RAT_RLL_P 0.1\nRATE_RLL_P 0.2\nINS_GYRO_FILTER 53.574\n")
    facts = fly("--params", str(given), translation=translation)
    assert (facts["outcome"], facts["reason"], facts["samples"]) == ("done", "", 400)
    assert facts["autopilot"]["unknown_parameters"] == ["RATE_RLL_P"]
    assert facts["autopilot"]["rounded_parameters"] == {"INS_GYRO_FILTER": 53.0}
    assert facts["autopilot"]["version"] == "4.7.0 (abcdef01)"
    _, records = read_journal(tmp_path / "flight.journal")
    assert len(records) == 400
    assert float(np.max(np.abs(records["omega_B"]))) < 1.0
    estimates = read_estimates(tmp_path / "flight.attitude")
    assert len(estimates) in range(48, 52)


@pytest.mark.slow
def test_frame_repeated_before_a_late_answer_gets_one(
    tmp_path: Path, fly: Fly, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine that stalls, answers, and stalls again must not answer the repeats of the first stall."""
    answer, sent = ardupilot_process.ArduPilot.send, []

    def send_late(self: ardupilot_process.ArduPilot, readings: Readings) -> None:
        sent.append(readings)
        if len(sent) == 400:
            time.sleep(1.2)
        answer(self, readings)
        if len(sent) == 400:
            time.sleep(0.7)

    monkeypatch.setattr(ardupilot_process.ArduPilot, "send", send_late)
    facts = fly()
    assert (facts["outcome"], facts["reason"]) == ("done", "")


@real
@pytest.mark.parametrize("translation", ["held", "free"])
def test_real_ardupilot_holds_the_attitude_and_repeats_its_flight(tmp_path: Path, fly: Fly, translation: str) -> None:
    flights = []
    for name in ("first", "second"):
        facts = fly("--params", "tuned", translation=translation, build=REAL, folder=name)
        assert (facts["outcome"], facts["reason"], facts["samples"]) == ("done", "", 400)
        flights.append(read_journal(tmp_path / name / "flight.journal")[1])
    tilt = 2.0 * np.hypot(flights[0]["q_NB"][:, 1], flights[0]["q_NB"][:, 2])
    assert 1e-5 < float(np.sqrt(np.mean(tilt**2))) < np.radians(0.5)
    assert flights[0].tobytes() == flights[1].tobytes()


def negate(vector: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(-each for each in vector)


SPOILED: dict[str, Callable[[Readings], Readings]] = {
    "gyro": lambda each: each._replace(gyro_B=negate(each.gyro_B)),
    "gyro in deg/s": lambda each: each._replace(gyro_B=tuple(57.3 * rate for rate in each.gyro_B)),
    "force": lambda each: each._replace(specific_force_B=negate(each.specific_force_B)),
    "velocity": lambda each: each._replace(velocity_N=negate(each.velocity_N)),
    "height": lambda each: each._replace(position_N=(*each.position_N[:2], -each.position_N[2])),
    "attitude": lambda each: each._replace(q_NB=(each.q_NB[0], *negate(each.q_NB[1:]))),
    "attitude, scalar last": lambda each: each._replace(q_NB=(*each.q_NB[1:], each.q_NB[0])),
    "clock": lambda each: each._replace(time_us=each.time_us - each.time_us % 4000),
}


@pytest.fixture(scope="module")
def motion() -> list[Readings]:
    """Readings of a free flight that turns about all axes, climbs, and drifts with a wind."""
    scenario = load_scenario("shear")
    scenario = replace(scenario, control_rate_hz=400, physics_rate_hz=800, translation="free", delay_samples=0)
    world, found = World(load_vehicle("paper"), scenario, 1, lambda _: None), []
    world.begin()
    for sample in range(1000):
        climbs = sample < 800
        if not climbs:
            found.append(world.readings())
        world.answer(world.time_us, (0.6, 0.6, 0.6, 0.6) if climbs else (0.62, 0.55, 0.58, 0.61))
        world.advance()
    return found


def check(answers: Iterable[bytes]) -> None:
    checker = run_path(str(PEER / "arducopter"))["Checker"]()
    for answer in answers:
        checker.check(answer)


def test_peer_accepts_the_motion_that_a_spoiled_field_contradicts(motion: list[Readings]) -> None:
    check(map(encode_answer, motion))


@pytest.mark.parametrize("field", SPOILED)
def test_peer_finds_a_spoiled_field(motion: list[Readings], field: str) -> None:
    with pytest.raises(AssertionError):
        check(encode_answer(SPOILED[field](readings)) for readings in motion)


@pytest.mark.parametrize("name", ["velocity_wind", "direction", "rng_1"])
def test_peer_finds_a_spoiled_wind_or_height(motion: list[Readings], name: str) -> None:
    answers = [json.loads(encode_answer(readings)) for readings in motion]
    for answer in answers:
        place = answer["windvane"] if name == "direction" else answer
        place[name] = negate(place[name]) if name == "velocity_wind" else place[name] + 3.1
    with pytest.raises(AssertionError):
        check(b"\n" + json.dumps(answer, separators=(",", ":")).encode() + b"\n" for answer in answers)


@pytest.mark.parametrize(
    ("fault", "outcome", "said"),
    [
        ("hover", "wrong_parameters", "it has MOT_THST_HOVER 0.35 where 0.4375 was set"),
        ("refuse", "not_armed", "PreArm: waiting for the peer"),
        ("plus", "wrong_geometry", "a set-point in roll gave torques of"),
        ("exit", "killed", "the peer gives up"),
        ("hang", "hung", "no frame in 1 s"),
        ("restart", "killed", "its count of frames went back"),
        ("disarm", "disarmed", "it said last: "),
        ("land", "left_mode", "left GUIDED for mode 9"),
        ("silent", "wrong_build", "no frame of the JSON interface"),
        ("stranger", "wrong_build", "it is not ArduPilot: MAV_AUTOPILOT 12"),
        ("rotors", "killed", "the peer found: KeyError"),
    ],
)
def test_flight_that_ends_early_tells_how(
    tmp_path: Path, fly: Fly, monkeypatch: pytest.MonkeyPatch, fault: str, outcome: str, said: str
) -> None:
    monkeypatch.setenv("PEER_FAULT", fault)
    # All others answer, on a busy machine late.
    patience = {"hang": ("_HUNG_S", 1.0), "silent": ("_START_TIMEOUT_S", 2.0)}
    if fault in patience:
        monkeypatch.setattr(ardupilot_process, *patience[fault])
    facts = fly()
    assert facts["outcome"] == outcome
    assert said in facts["reason"]
    assert len(read_journal(tmp_path / "flight.journal")[1]) >= (0 if outcome == "wrong_build" else 1)


@pytest.mark.parametrize(("fault", "outcome"), [("lost", "gps_lost"), ("", "done")])
def test_loss_of_the_fix_is_flown_and_an_end_by_it_has_a_name(
    tmp_path: Path, fly: Fly, monkeypatch: pytest.MonkeyPatch, fault: str, outcome: str
) -> None:
    monkeypatch.setenv("PEER_FAULT", fault)
    facts = fly(events=LOST)
    assert facts["outcome"] == outcome
    if fault:
        assert "s without a fix it left GUIDED for mode 9" in facts["reason"]
        assert 100 <= len(read_journal(tmp_path / "flight.journal")[1]) < 300


def test_program_that_is_not_one_is_told(tmp_path: Path, fly: Fly) -> None:
    build = tmp_path / "arducopter"
    build.write_text("not a program")
    build.chmod(0o700)
    facts = fly(build=str(build))
    assert (facts["outcome"], facts["samples"]) == ("wrong_build", 0)
    assert "Exec format error" in facts["reason"]


def test_parameters_of_the_user_come_last(tmp_path: Path) -> None:
    given = tmp_path / "mine.parm"
    given.write_text("# mine\nATC_ANG_RLL_P,7.5\nMOT_SPIN_MIN 0.05\nMOT_SPIN_MAX 1.0\n")
    files = {"folder": tmp_path / "run", "scenario": "calm", "vehicle": "paper", "journal": tmp_path / "flight"}
    options = ExternalOptions(autopilot="ardupilot", **files, params=given, build=PEER)
    external = ardupilot_process.make_ardupilot(
        options, replace(load_scenario("calm"), control_rate_hz=400, physics_rate_hz=1200), load_vehicle("paper")
    )
    parameters = external.facts()["parameters"]
    assert (parameters["ATC_ANG_RLL_P"], parameters["FRAME_TYPE"]) == ("7.5", "1")
    # It hovers at half the largest thrust; throttle 0 is .05 of it and throttle 1 all of it.
    assert float(parameters["MOT_THST_HOVER"]) == pytest.approx(0.45 / 0.95, rel=1e-6)
    assert external.dialect.thrust_range == (0.05, 1.0)


@pytest.mark.parametrize(("low", "high"), [("0.9", "0.2"), ("-0.1", "0.9"), ("0.1", "1.1")])
def test_motor_range_that_is_none_is_refused(low: str, high: str) -> None:
    with pytest.raises(ConfigError, match="MOT_SPIN_MIN"):
        ardupilot_process.thrust_range({"MOT_SPIN_MIN": low, "MOT_SPIN_MAX": high})


@pytest.mark.parametrize("place", ["arducopter", "bin/arducopter", "build/sitl/bin/arducopter"])
def test_build_is_found_in_its_tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    program = tmp_path / place
    program.parent.mkdir(parents=True, exist_ok=True)
    program.write_text("")
    with pytest.raises(ConfigError, match="no ArduCopter built for simulation"):
        ardupilot_process.find_build(tmp_path)
    program.chmod(0o700)
    assert ardupilot_process.find_build(tmp_path) == program.resolve()
    monkeypatch.setenv("HOME", str(tmp_path / "nobody"))
    monkeypatch.setenv("PATH", str(program.parent))
    assert ardupilot_process.find_build(None) == program.resolve()
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("ARDUPILOT_BUILD", str(tmp_path))
    assert ardupilot_process.find_build(None) == program.resolve()


def test_shipped_gains_are_read() -> None:
    assert read_parameters("stock", "ardupilot") == {}
    assert float(read_parameters("tuned", "ardupilot")["ATC_RAT_RLL_P"]) == 0.36
