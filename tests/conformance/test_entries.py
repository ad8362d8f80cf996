"""Controllers of a user's own, in a process of their own, over real sockets."""

import json
import shutil
import subprocess
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.cli.app import app
from gustproof.flight.controllers.stepper import make_stepper
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.flight.recording.bag import read_bag
from gustproof.flight.recording.folder import find_bag
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.flight import first_difference_s
from gustproof.flight.routes.loopback import fly_by_messages
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.processes import fly
from gustproof.law.form import load_law
from gustproof.law.write.c import save_c

VEHICLE = load_vehicle("paper")
SHORT = replace(load_scenario("paper-turbulence"), duration_s=0.6)
ENTRY = """
import os, random, time
import numpy as np

class Mine:
    def reset(self):
        self.angle, self.samples = np.zeros(3), 0
    def step(self, gyro, reference, force, dt):
        print("prints do not matter" * 10)
        self.angle += gyro * dt
        self.samples += 1
        if self.samples == 50:
            {end}
        return -15.0 * (self.angle - reference) - 3.0 * gyro
make = Mine
"""


@pytest.fixture
def entry(tmp_path):
    def write(end: str = "pass"):
        (tmp_path / "mine.py").write_text(ENTRY.format(end=end))
        return parse_controller(f"{tmp_path}/mine.py:make")

    return write


def test_an_object_flies_the_same_bits_on_every_route(entry, tmp_path):
    mine = entry()
    direct = fly_controller(SHORT, mine, vehicle=VEHICLE, seed=5)
    flight = fly(SHORT, mine, vehicle=VEHICLE, seed=5, out=tmp_path)
    assert (direct.outcome, flight.outcome) == (FlightOutcome.DONE, FlightOutcome.DONE)
    assert first_difference_s(flight.records, direct.records) is None
    assert len(flight.records) == SHORT.samples


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_a_library_flies_the_bits_of_its_law_on_every_route(tmp_path):
    law = load_law("flagship")
    save_c(law, tmp_path / "law.c")
    subprocess.run(["gcc", "-O1", "-shared", "-fPIC", "law.c", "-o", "law.so"], cwd=tmp_path, check=True)
    library = parse_controller(f"{tmp_path}/law.so")
    expected = fly_direct(SHORT, law, vehicle=VEHICLE, seed=5)
    flight = fly(SHORT, library, vehicle=VEHICLE, seed=5, out=tmp_path)
    assert first_difference_s(flight.records, expected) is None
    looped, failure = fly_by_messages(SHORT, make_stepper(library, VEHICLE), vehicle=VEHICLE, seed=5)
    assert failure is None
    assert looped.tobytes() == expected.tobytes()


@pytest.mark.parametrize(
    ("end", "outcome", "words"),
    [
        ("raise ValueError('lost')", FlightOutcome.CONTROLLER_RAISED, "step() raised ValueError: lost (mine.py:13)"),
        ("return gyro * float('nan')", FlightOutcome.CONTROLLER_NOT_FINITE, "nan, nan, nan N m"),
        ("os.kill(os.getpid(), 11)", FlightOutcome.CONTROLLER_DIED, "ended by SIGSEGV"),
        ("time.sleep(60)", FlightOutcome.CONTROLLER_HUNG, "the controller hung"),
    ],
)
def test_each_end_of_an_object_over_udp_has_a_name_and_its_records(entry, tmp_path, end, outcome, words):
    flight = fly(SHORT, entry(end), vehicle=VEHICLE, out=tmp_path)
    assert flight.outcome is outcome
    assert words in flight.message
    assert len(flight.records) == SHORT.samples  # the fail-safe flies on
    assert not flight.has_expected_outcome


def test_an_object_that_cannot_be_made_is_bad_input(tmp_path):
    (tmp_path / "mine.py").write_text("make = lambda: 1 / 0\n")
    with pytest.raises(ConfigError, match=r"^controller .*: make\(\) raised ZeroDivisionError: .* \(mine.py:1\)$"):
        fly(SHORT, parse_controller(f"{tmp_path}/mine.py:make"), vehicle=VEHICLE, out=tmp_path)


def test_an_object_that_is_late_in_real_time_is_told(entry, tmp_path):
    slow = ENTRY.replace("if self.samples == 50:", "if True:")
    (tmp_path / "mine.py").write_text(slow.format(end="time.sleep(0.012)"))
    mine = parse_controller(f"{tmp_path}/mine.py:make")
    flight = fly(SHORT, mine, vehicle=VEHICLE, out=tmp_path, real_time=True, default_ports=False)
    assert flight.outcome is FlightOutcome.CONTROLLER_LATE


def test_repeat_flies_an_object_again_and_says_where_it_is_not_the_same(entry, tmp_path):
    def run(*options):
        return CliRunner().invoke(app, [*options, "--json"])

    scenario = tmp_path / "short.toml"
    scenario.write_text('description = "short"\nduration_s = 0.4\n')
    mine = entry("self.angle[0] += 1e-9 * random.random()")
    first = run("fly", str(scenario), "--controller", mine.source, "--output", str(tmp_path / "a"))
    about, _ = read_bag(find_bag(tmp_path / "a"))
    assert (about["controller"], json.loads(first.stdout)["controller"]) == (mine.to_dict(), mine.to_dict())
    repeat = ("replay", str(tmp_path / "a"), "--controller", mine.source)
    alone = run(*repeat[:2], "--output", str(tmp_path / "b"))
    assert (alone.exit_code, f"--controller {mine.source}" in alone.stderr) == (2, True)
    again = run(*repeat, "--output", str(tmp_path / "b"))
    assert f"is the one that flew, by its SHA-256 {mine.digest[:16]}" in again.stderr
    assert again.exit_code == 1
    assert "differs from" in again.stderr
    assert "from 0.200 s on" in again.stderr
    entry("pass")
    changed = run(*repeat, "--output", str(tmp_path / "c"))
    assert changed.exit_code == 2
    assert "has changed since" in changed.stderr
