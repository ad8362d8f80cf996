"""Recordings of one flight, read by foreign programs, and the flight repeated from its bag alone."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.flight.recording.bag import read_bag
from gustproof.flight.recording.folder import find_bags
from gustproof.law.form import load_law

SCRIPT = 'description = "short"\nduration_s = 2.0\n[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 15.4\n'
NAME = "short-mine-seed5"
MODULES = Path(sys.prefix) / "node" / "node_modules"
READER = Path(__file__).with_name("readers") / "mcap_reader.mjs"


def gustproof(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "gustproof", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A flight whose scenario and law are gone."""
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "short.toml").write_text(SCRIPT)
    law = json.loads(Path(sys.modules["gustproof.law.form"].LAWS / "hinf-scheduled.json").read_text())
    (folder / "mine.json").write_text(json.dumps({**law, "name": "mine"}))
    ended = gustproof(
        folder, "fly", "short.toml", "--law", "mine.json", "--vehicle", "iris", "--anyway", "--seed", "5",
        "--output", "run1", "--json",
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    for file in ("short.toml", "mine.json"):
        (folder / file).unlink()
    return folder / "run1"


def mcap(run: Path) -> Path:
    return run / NAME / f"{NAME}.mcap"


def test_a_flight_is_flown_again_from_its_bag_alone_byte_for_byte(run):
    again = gustproof(run.parent, "replay", "run1", "--output", "run2", "--json")
    assert again.returncode == 0, again.stderr
    assert again.stderr.strip() == "gustproof: equal to run1 in every bit of its 500 samples"
    assert mcap(run.parent / "run2").read_bytes() == mcap(run).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run1", "--law", "hinf-d1"), "No such option"),
        (("run1", "--seed", "1"), "No such option"),
        ((".",), "no bag in it"),
    ],
)
def test_a_repetition_takes_nothing_but_the_recording(run, arguments, words, monkeypatch):
    monkeypatch.chdir(run.parent)
    ended = CliRunner().invoke(app, ["replay", *arguments])
    assert ended.exit_code == 2
    assert words in ended.stderr


def test_the_bag_holds_the_law_the_vehicle_and_the_scenario_whole(run):
    about, _ = read_bag(run / NAME)
    law = load_law("hinf-scheduled")
    for matrix in ("A", "B", "C", "D", "G", "H", "limits"):
        assert np.array_equal(about["law"][matrix], getattr(law, matrix))
    assert about["vehicle"]["name"] == "iris"
    assert about["vehicle"]["rotors"]["thrust_max"] > 0.0
    assert about["scenario"]["wind"][0]["wind_speed_20ft_mps"] == 15.4
    assert set(about["versions"]) >= {"gustproof", "python", "numpy", "numba"}


@pytest.fixture(scope="module")
def traffic(run) -> list:
    os.environ.setdefault("MAVLINK20", "1")
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(run / f"{NAME}.tlog"))

    def messages() -> Iterator:
        while (message := log.recv_msg()) is not None:
            yield message

    found = list(messages())
    log.close()
    return found


def test_mavutil_reads_the_traffic_of_both_directions_and_finds_nothing_else(traffic):
    kinds = {(message.get_srcSystem(), message.get_srcComponent(), message.get_type()) for message in traffic}
    assert {(1, 1, "HIGHRES_IMU"), (1, 1, "HEARTBEAT"), (1, 191, "SET_ACTUATOR_CONTROL_TARGET")} <= kinds
    assert "BAD_DATA" not in {kind for _, _, kind in kinds}
    assert {message._link for message in traffic} == {0}  # one peer, the controller


def test_the_traffic_holds_what_was_measured_and_commanded_to_the_bit_at_the_pace_of_the_flight(run, traffic):
    _, records = read_bag(run / NAME)
    stamps, gyro = records["time_us"].astype(int).tolist(), records["gyro_B"].tolist()
    measured = {m.time_usec: m for m in traffic if m.get_type() == "HIGHRES_IMU"}
    commanded = {m.time_usec: m for m in traffic if m.get_type() == "SET_ACTUATOR_CONTROL_TARGET"}
    assert set(stamps) == set(measured) & set(commanded)
    for stamp, rates in zip(stamps, gyro, strict=True):
        assert [measured[stamp].xgyro, measured[stamp].ygyro, measured[stamp].zgyro] == rates
    times = np.array([measured[stamp]._timestamp for stamp in stamps])
    assert np.diff(times[1:]) == pytest.approx(0.004, abs=1e-5)
    everything = [message._timestamp for message in traffic]
    assert everything == sorted(everything)


def leaves(message) -> Iterator:
    """Yield the values of a message of mcap_ros2 depth first, NaN as a word, as JSON has none."""
    if hasattr(message, "__slots__"):
        for name in message.__slots__:
            yield from leaves(getattr(message, name))
    elif isinstance(message, list | tuple | np.ndarray):
        for item in message:
            yield from leaves(item)
    else:
        yield "NaN" if isinstance(message, float) and math.isnan(message) else message


@pytest.mark.skipif(
    shutil.which("node") is None or not (MODULES / "@mcap" / "core").is_dir(), reason="@mcap/core is not here"
)
def test_mcap_for_python_and_for_node_find_equal_values_in_every_message(run):
    command = ["node", str(READER), f"{MODULES}/", str(mcap(run))]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 0, ended.stderr
    theirs = json.loads(ended.stdout)
    ours: dict[str, SimpleNamespace] = {}
    with mcap(run).open("rb") as stream:
        for _, channel, message, decoded in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            found = ours.setdefault(channel.topic, SimpleNamespace(times=[], values=[]))
            found.times.append(message.log_time)
            found.values.append(list(leaves(decoded)))
    assert set(theirs) == set(ours) >= {"/imu", "/truth/pose", "/actuator/rotors", "/flight", "/mode"}
    for topic, found in ours.items():
        assert theirs[topic]["times"] == found.times
        assert theirs[topic]["values"] == found.values, topic


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """The journal of an autopilot in lockstep that a controller of its own has flown, recovered."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "short.toml").write_text(f'{SCRIPT}[[require]]\nmetric = "peak_deg"\nat_most = 1.0\n')
    words = ["--scenario", "short.toml", "--lockstep", "--bind-port", "0", "--json", "--journal", "flight.journal"]
    autopilot = [sys.executable, "-m", "gustproof", "autopilot", *words]
    with subprocess.Popen(autopilot, cwd=folder, stdout=subprocess.PIPE, text=True) as vehicle:
        port = json.loads(vehicle.stdout.readline())["listening"][0]
        controller = [sys.executable, "-m", "gustproof", "controller", "--law", "pid-fair"]
        subprocess.run([*controller, "--connect", f"127.0.0.1:{port}"], check=True, capture_output=True, timeout=60)
        vehicle.communicate(timeout=60)
    shown = CliRunner().invoke(app, ["report", str(folder), "-o", str(folder / "page.html")])
    assert shown.exit_code == 2  # a page needs the law, but the bag is complete
    return folder, shown.stdout


def test_a_flight_of_an_own_controller_is_recovered_with_its_figures(own):
    folder, shown = own
    assert re.search(r"short, .*500 of 500 samples", " ".join(shown.split()))
    assert "rmse" in shown.lower()
    (bag,) = find_bags(folder)
    about, records = read_bag(bag)
    assert (about["law"], len(records)) == (None, 500)
    assert not list(folder.glob("*.journal"))


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("replay", "."), "flown by a controller of its own, whose law is not in it"),
        (("report", "."), "flown by a controller of its own; a page needs its law"),
    ],
)
def test_what_needs_the_law_of_an_own_controller_says_so(own, command, words, monkeypatch):
    monkeypatch.chdir(own[0])
    told = CliRunner().invoke(app, command)
    assert told.exit_code == 2
    (line,) = told.stderr.strip().splitlines()
    assert words in line
