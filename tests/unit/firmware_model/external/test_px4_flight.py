"""Flights of a stand-in for PX4 that checks every field, and its ends by their names.

With GUSTPROOF_PX4, the folder of a build, the flights to the end are flown by the real one too.
"""

import os
import shutil
import socket
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as wire

from firmware_model.config.parameter_files import read_parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.external import px4_process
from firmware_model.external.interface import ExternalOptions, check_law_inside
from firmware_model.external.px4 import SimulatorLink
from firmware_model.external.readings import Readings
from firmware_model.external.world import World
from firmware_model.recording.estimates import read_estimates
from firmware_model.recording.journal import read_journal

PEER = Path(__file__).parent / "px4_build"
REAL = os.environ.get("GUSTPROOF_PX4", "")
real = pytest.param(REAL, marks=pytest.mark.skipif(not REAL, reason="GUSTPROOF_PX4 names no build of PX4"), id="real")
Fly = Callable[..., dict[str, Any]]
SCRIPT = """
description = "a short gust"
duration_s = 1.0
translation = "{translation}"

[[wind]]
kind = "dryden"
wind_speed_20ft_mps = 10.0
"""


@pytest.fixture
def fly(fly_script: Fly) -> Fly:
    def in_gust(*options: str, build: str = str(PEER), translation: str = "held") -> dict[str, Any]:
        return fly_script("px4", SCRIPT.format(translation=translation), *options, build=build)

    return in_gust


@pytest.fixture
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4_process, "_BOOT_REPLY_S", 0.02)
    monkeypatch.setattr(px4_process.Px4, "warm_up_s", 0.0)
    monkeypatch.setattr(px4_process.Px4, "arming_timeout_s", 6.0)


@pytest.mark.parametrize("translation", ["held", "free"])
@pytest.mark.parametrize("build", [pytest.param(str(PEER), id="peer"), real])
def test_peer_finds_no_fault_and_flies_the_scenario(
    tmp_path: Path, fly: Fly, build: str, translation: str, request: pytest.FixtureRequest
) -> None:
    if build != REAL:
        request.getfixturevalue("_impatient")
    facts = fly("--tlog", str(tmp_path / "flight.tlog"), build=build, translation=translation)
    assert (facts["outcome"], facts["reason"], facts["samples"]) == ("done", "", 250)
    assert facts["autopilot"]["version"] == "1.16.0 (cdef01)" or build == REAL
    _, records = read_journal(tmp_path / "flight.journal")
    assert np.array_equal(np.diff(records["time_us"]), np.full(249, 4000.0))
    assert set(records["command_age"][:, 0]) == {1.0}
    assert float(np.max(np.abs(records["omega_B"]))) < 1.0
    assert len(read_estimates(tmp_path / "flight.attitude")) in range(47, 52)
    assert (tmp_path / "flight.tlog").stat().st_size > 10_000


OF_2026 = """
# Once px4-rc.params was read here: . px4-rc.params
env | while IFS='=' read -r line; do
  case $line in "PX4_PARAM_"*) param set "${line#PX4_PARAM_}" ;; esac
done
param set-default COM_LOW_BAT_ACT 3
"""


def build_with(script: str, folder: Path) -> Path:
    """Return a build of the stand-in with another start script."""
    build = folder / "build"
    shutil.copytree(PEER, build)
    (build / "etc" / "init.d-posix" / "rcS").write_text(script)
    return build


@pytest.mark.slow
@pytest.mark.usefixtures("_impatient")
def test_parameters_reach_a_start_script_without_a_file(
    tmp_path: Path, fly: Fly, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PX4_PARAM_MC_ROLLRATE_P", "9")  # of the user's shell, not of this flight
    (tmp_path / "mine.params").write_text("MC_PITCHRATE_P 0.6\nMY_OWN 1\n")
    build = build_with(OF_2026, tmp_path)
    facts = fly("--params", str(tmp_path / "mine.params"), build=str(build))
    assert (facts["outcome"], facts["reason"]) == ("done", "")
    told = facts["autopilot"]["read_back"]
    assert (told["MC_PITCHRATE_P"], told["MC_ROLLRATE_P"]) == pytest.approx((0.6, 0.15))
    assert told["MC_ROLL_P"] == 4.0  # the build's own default
    assert (told["COM_RC_IN_MODE"], told["COM_LOW_BAT_ACT"]) == (4.0, 0.0)  # PX4 1.16 has a default of its own later
    assert not (tmp_path / "run" / "px4-rc.params").exists()


def test_links_of_its_own_follow_the_parameters(tmp_path: Path) -> None:
    build = build_with(OF_2026, tmp_path)
    assert px4_process.write_start_files(build, tmp_path, {"MC_ROLL_P": "4"}, None) == {"PX4_PARAM_MC_ROLL_P": "4"}
    lines = (tmp_path / "px4-rc.mavlink").read_text().splitlines()
    assert lines == ["param set MC_ROLL_P 4", ". ${R}etc/init.d-posix/px4-rc.mavlink"]


def test_file_is_written_where_the_start_script_reads_it(tmp_path: Path) -> None:
    for script in (
        ". px4-rc.params\n",
        OF_2026 + ". px4-rc.params\n",
        "\t[ -f px4-rc.params ] && source px4-rc.params",
    ):
        build = build_with(script, tmp_path)
        assert px4_process.write_start_files(build, tmp_path, {"MC_ROLL_P": "4"}, None) == {}
        assert (tmp_path / "px4-rc.params").read_text() == "param set MC_ROLL_P 4\n"
        shutil.rmtree(build)


@pytest.mark.parametrize("script", ["", "# . px4-rc.params\n\t# PX4_PARAM_X\n", None])
def test_start_script_that_takes_no_parameters_is_refused(tmp_path: Path, fly: Fly, script: str | None) -> None:
    build = build_with(script or "", tmp_path)
    if script is None:
        (build / "etc" / "init.d-posix" / "rcS").unlink()
    facts = fly(build=str(build))
    said = "No such file or directory" if script is None else "takes parameters neither from px4-rc.params nor from"
    assert facts["outcome"] == "wrong_build"
    assert "etc/init.d-posix/rcS: " + said in facts["reason"]


def negate(vector: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(-each for each in vector)


SPOILED: dict[str, Callable[[Readings], Readings]] = {
    "gyro": lambda each: each._replace(gyro_B=negate(each.gyro_B)),
    "gyro in deg/s": lambda each: each._replace(gyro_B=tuple(57.3 * rate for rate in each.gyro_B)),
    "force": lambda each: each._replace(specific_force_B=negate(each.specific_force_B)),
    "field": lambda each: each._replace(field_B=negate(each.field_B)),
    "declination": lambda each: each._replace(field_B=(*each.field_B[:1], -each.field_B[1], *each.field_B[2:])),
    "pressure": lambda each: each._replace(pressure=100.0 * each.pressure),
    "pressure without noise": lambda each: each._replace(pressure=950.0),
    "place of the fix": lambda each: each._replace(gps_position_N=negate(each.gps_position_N)),
    "velocity of the fix": lambda each: each._replace(gps_velocity_N=negate(each.gps_velocity_N)),
    "attitude": lambda each: each._replace(q_NB=(each.q_NB[0], *negate(each.q_NB[1:]))),
    "clock": lambda each: each._replace(time_us=each.time_us - each.time_us % 8000),
}


@pytest.fixture(scope="module")
def motion() -> list[Readings]:
    """Readings of a free flight that turns about all axes and climbs."""
    scenario = replace(load_scenario("calm"), translation="free", physics_rate_hz=500)
    world, found = World(load_vehicle("paper"), scenario, 1, lambda _: None), []
    world.begin()
    for sample in range(800):
        climbs = sample < 400
        if not climbs:
            found.append(world.readings())
        world.answer(world.time_us, (0.6, 0.6, 0.6, 0.6) if climbs else (0.62, 0.55, 0.58, 0.61))
        world.advance()
    return found


def check(readings: Iterable[Readings]) -> None:
    link, checker, parser = SimulatorLink(), run_path(str(PEER / "bin" / "px4"))["Checker"](), wire.MAVLink(None)
    for each in readings:
        messages = parser.parse_buffer(link.pack(each)) or []
        for message in messages:
            checker.check(message)
        assert messages[-1].get_type() == "HIL_SENSOR"


def test_peer_accepts_the_motion_that_a_spoiled_field_contradicts(motion: list[Readings]) -> None:
    check(motion)


@pytest.mark.parametrize("field", SPOILED)
def test_peer_finds_a_spoiled_field(motion: list[Readings], field: str) -> None:
    with pytest.raises(AssertionError):
        check(SPOILED[field](readings) for readings in motion)


@pytest.mark.usefixtures("_impatient")
@pytest.mark.parametrize(
    ("fault", "outcome", "said"),
    [
        ("deaf", "wrong_parameters", "it has CA_ROTOR_COUNT 0 where 4 was set, and 2"),
        ("lacks CA_ROTOR1_PX THR_MDL_FAC", "wrong_parameters", "it has no parameter THR_MDL_FAC, and 1 more like it"),
        ("mute", "wrong_parameters", "it answers for none of the 35 parameters that were set"),
        ("refuse", "not_armed", "Preflight Fail: waiting for the peer"),
        ("plus", "wrong_geometry", "a set-point in roll gave torques of"),
        ("exit", "killed", "it said last: the peer gives up"),
        ("hang", "hung", "no answer to the sample at 3.5 s in 1 s"),
        ("disarm", "disarmed", "it said last: "),
        ("land", "left_mode", "left OFFBOARD for mode"),
        ("silent", "wrong_build", "it did not connect to TCP port"),
        ("no link", "wrong_build", "it was built without simulator_mavlink"),
        ("script", "wrong_build", "helper: not found; ERROR"),
        ("no lockstep", "wrong_build", "without lockstep"),
        ("stranger", "wrong_build", "it is not PX4: MAV_AUTOPILOT 3"),
    ],
)
def test_flight_that_ends_early_tells_how(
    tmp_path: Path, fly: Fly, monkeypatch: pytest.MonkeyPatch, fault: str, outcome: str, said: str
) -> None:
    monkeypatch.setenv("PEER_FAULT", fault)
    # All others answer, on a busy machine late.
    patience = {"hang": ("_HUNG_S", 1.0), "silent": ("_CONNECT_TIMEOUT_S", 2.0)}
    if fault in patience:
        monkeypatch.setattr(px4_process, *patience[fault])
    (tmp_path / "mine.params").write_text("MC_ROLLRATE_P 0.6\n")
    facts = fly("--params", str(tmp_path / "mine.params"))
    assert facts["outcome"] == outcome
    assert said in facts["reason"]
    assert len(read_journal(tmp_path / "flight.journal")[1]) == 1  # all ends here are before the scenario


def test_port_that_another_program_uses_is_told(tmp_path: Path, fly: Fly) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        taken_port = taken.getsockname()[1]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(px4_process, "_PILOT", taken_port - 150)
            facts = fly("--instance", "150")
    assert facts["outcome"] == "port_taken"
    assert f"of instance 150: TCP 4710, UDP {taken_port}" in facts["reason"]
    assert len(read_journal(tmp_path / "flight.journal")[1]) == 1


def test_program_that_is_none_is_told(tmp_path: Path, fly: Fly) -> None:
    for folder in ("bin", "etc"):
        (tmp_path / "build" / folder).mkdir(parents=True)
    (tmp_path / "build" / "etc" / "init.d-posix").mkdir()
    (tmp_path / "build" / "etc" / "init.d-posix" / "rcS").write_text(". px4-rc.params")
    (tmp_path / "build" / "bin" / "px4").write_text("not a program")
    (tmp_path / "build" / "bin" / "px4").chmod(0o700)
    facts = fly(build=str(tmp_path / "build"))
    assert facts["outcome"] == "wrong_build"
    assert "Exec format error" in facts["reason"]


def test_build_without_a_law_inside_is_refused(tmp_path: Path) -> None:
    for folder in ("bin", "etc"):
        (tmp_path / "build" / folder).mkdir(parents=True)
    (tmp_path / "build" / "bin" / "px4").write_text("")
    (tmp_path / "short.toml").write_text(SCRIPT.format(translation="held"))
    options = ExternalOptions(
        autopilot="px4", build=tmp_path / "build", law="flagship", folder=tmp_path / "run", vehicle="paper",
        scenario=str(tmp_path / "short.toml"), journal=tmp_path / "flight.journal",
    )  # fmt: skip
    with pytest.raises(ConfigError, match="no law is built into it"):
        px4_process.make_px4(options, load_scenario(options.scenario), load_vehicle("paper"))


@pytest.mark.parametrize(
    ("text", "wanted", "refusal"),
    [
        ("Law 'flagship' in place of the attitude and rate loops", "flagship", ""),
        ("Law 'flagship-400hz' in control", "flagship", ""),
        ("Law 'flagship-333_3hz' in control", "flagship", ""),
        ("Law 'flagship' in control", "pid-fair", "law 'flagship' is built into it, not 'pid-fair'"),
        ("Law 'flagship-400hz' in control", "flagship-200hz", "not 'flagship-200hz'"),
        ("law '%s' holds level", "flagship", ""),
    ],
)
def test_law_inside_is_the_one_that_is_wanted(tmp_path: Path, text: str, wanted: str, refusal: str) -> None:
    (tmp_path / "px4").write_bytes(b"\x7fELF\0" + text.encode() + b"\0")
    with pytest.raises(ConfigError, match=refusal) if refusal else nullcontext():
        check_law_inside(tmp_path / "px4", wanted)


@pytest.mark.parametrize("below", ["", "build/px4_sitl_default"])
def test_build_is_found_in_its_tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, below: str) -> None:
    folder = tmp_path / below
    (folder / "bin").mkdir(parents=True)
    (folder / "bin" / "px4").write_text("")
    with pytest.raises(ConfigError, match="no PX4 built for simulation"):
        px4_process.find_build(tmp_path)
    (folder / "etc").mkdir()
    assert px4_process.find_build(tmp_path) == folder.resolve()
    monkeypatch.setenv("PX4_BUILD", str(tmp_path))
    assert px4_process.find_build(None) == folder.resolve()


@pytest.mark.parametrize("name", ["px4", "px4-gazebo"])
def test_an_installed_package_is_found_by_its_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    for folder in ("bin", "opt/bin", "opt/etc"):
        (tmp_path / folder).mkdir(parents=True)
    for program in {"px4", name}:
        (tmp_path / "opt/bin" / program).write_text("")
        (tmp_path / "opt/bin" / program).chmod(0o700)
    (tmp_path / "bin" / name).symlink_to(tmp_path / "opt/bin" / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    assert px4_process.find_build(None) == (tmp_path / "opt").resolve()
    (tmp_path / "PX4-Autopilot/bin").mkdir(parents=True)  # what a user has built comes first
    (tmp_path / "PX4-Autopilot/etc").mkdir()
    (tmp_path / "PX4-Autopilot/bin/px4").write_text("")
    assert px4_process.find_build(None) == (tmp_path / "PX4-Autopilot").resolve()


def test_parameters_of_the_user_come_last(tmp_path: Path) -> None:
    given = tmp_path / "mine.params"
    given.write_text("# Onboard parameters\n1\t1\tMC_ROLL_P\t7.5\t9\n1\t1\tCA_ROTOR0_PX\t0.352\t9\n")
    files = {"folder": tmp_path / "run", "scenario": "calm", "vehicle": "paper", "journal": tmp_path / "flight"}
    options = ExternalOptions(autopilot="px4", **files, params=given, build=PEER)
    external = px4_process.make_px4(options, load_scenario("calm"), load_vehicle("paper"))
    parameters = external.facts()["parameters"]
    assert (parameters["MC_ROLL_P"], parameters["CA_ROTOR0_PX"], parameters["CA_ROTOR0_PY"]) == ("7.5", "0.352", "0.22")
    assert float(parameters["EKF2_GYR_NOISE"]) == pytest.approx(0.2 * 10.0 ** (-35.0 / 20.0), rel=1e-3)


@pytest.mark.parametrize("line", ["MC_ROLL_P", "mc_roll_p 1", "MC_ROLL_P 1; rm", "MC_ROLL_P $(x)", "MC_ROLL_P 1 2"])
def test_line_that_is_no_parameter_is_refused(tmp_path: Path, line: str) -> None:
    (tmp_path / "mine.params").write_text(line)
    with pytest.raises(ConfigError, match="line 1"):
        read_parameters(str(tmp_path / "mine.params"), "px4")


def test_shipped_gains_are_read() -> None:
    assert read_parameters("stock", "px4") == {}
    assert float(read_parameters("tuned", "px4")["MC_ROLLRATE_P"]) == 0.2
    with pytest.raises(ConfigError, match="no parameter set named 'best'"):
        read_parameters("best", "px4")
