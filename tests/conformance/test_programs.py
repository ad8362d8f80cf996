"""External programs fly by `fly --controller`: the guide's clients, and programs that end as they should not."""

import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import psutil
import pytest
from typer.testing import CliRunner

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.cli.app import app
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.flight.protocol_check.inspection import check_controller
from gustproof.flight.recording.bag import read_bag
from gustproof.flight.routes import processes
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.outcome import FlightOutcome

CLIENTS = Path(str(files("gustproof.guide") / "clients"))
RAW_CLIENT = Path(__file__).parent / "clients" / "programs" / "raw_client.py"
NAMES = ("client.py", "client.c", "client.mjs")
SECOND = replace(load_scenario("paper-turbulence"), name="second", duration_s=1.0)


def run(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return the folder of the clients' flights."""
    return tmp_path_factory.mktemp("flights")


def client_command(name: str, folder: Path) -> str:
    """Return the command of a client; without its compiler or interpreter the test is skipped, and counted."""
    needed = {"client.py": sys.executable, "client.c": "cc", "client.mjs": "node"}[name]
    if shutil.which(needed) is None:
        pytest.skip(f"{needed} is not here")
    if name != "client.c":
        return f"exec: '{needed}' '{CLIENTS / name}'"
    binary = folder / "client"
    flags = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run([needed, *flags, str(CLIENTS / name), "-lm", "-o", str(binary)], check=True)
    return f"exec: '{binary}'"


@pytest.mark.parametrize("name", NAMES)
def test_client_of_the_guide_flies_and_is_found_sound(name, folder):
    command = client_command(name, folder)
    (folder / "second.toml").write_text('description = "calm air"\nduration_s = 1.0\n')
    result = run("fly", folder / "second.toml", "--controller", command, "--output", folder / name, "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert (told["outcome"], told["controller"]["source"]) == ("done", command)
    assert 0.0 < told["rmse_deg"] < 0.1
    about, records = read_bag(Path(told["bag"]))
    assert (len(records), about["controller"], about["law"]) == (250, told["controller"], None)
    assert len(list((folder / name).glob("*.tlog"))) == 1
    found = check_controller(parse_controller(command), vehicle=load_vehicle("paper"))
    assert {finding.name for finding in found} <= {"not-judged"}  # on a busy machine nobody's deadlines are


def test_a_program_flies_for_a_search_as_it_does_for_fly(folder):
    controller, script = parse_controller(client_command("client.c", folder)), replace(SECOND, duration_s=0.2)
    searched = fly_controller(script, controller, vehicle=load_vehicle("paper"))
    flown = processes.fly(script, controller, vehicle=load_vehicle("paper"), out=folder / "flown")
    assert (searched.outcome, searched.message) == (FlightOutcome.DONE, flown.message)
    assert searched.records.tobytes() == flown.records.tobytes()


def test_flights_of_clients_are_shown_on_a_page_and_repeated_to_the_bit(folder):
    flown = [folder / name for name in NAMES if (folder / name).exists()]
    page = folder / "page.html"
    assert run("report", *flown, "-o", page).exit_code == 0
    for each in flown:
        assert each.name.removesuffix(".c") in page.read_text()
    if folder / "client.c" in flown:
        again = ("--controller", client_command("client.c", folder), "--output", folder / "again")
        result = run("replay", folder / "client.c", *again)
        assert (result.exit_code, "equal to" in result.stderr) == (0, True)


def fly(fault: str, out: Path, words: str = ""):
    entry = parse_controller(f"exec: '{sys.executable}' -S '{RAW_CLIENT}' {fault} {words}")
    return processes.fly(SECOND, entry, vehicle=load_vehicle("paper"), out=out)


def test_program_that_dies_in_flight_is_named_with_its_last_words(tmp_path):
    flight = fly("died", tmp_path)
    assert flight.outcome is FlightOutcome.CONTROLLER_DIED
    assert "ended with status 1: ValueError: the solver found no solution" in flight.message
    assert len(flight.records) == SECOND.samples
    assert flight.records["mode"][100] != flight.records["mode"][101]


def test_flight_that_a_program_does_not_begin_is_given_up_and_says_how_far_it_came(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "_START_TIMEOUT_S", 1.0)
    flight = fly("never-arms", tmp_path)
    assert flight.outcome is FlightOutcome.NOT_STARTED
    assert "it did not arm the vehicle" in flight.message


GUARD = "gustproof.flight.endpoint.guard"
STUBBORN = """
import os, signal, subprocess, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
child = subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(60)"])
print(os.getpid(), child.pid, os.environ["GUSTPROOF_ADDRESS"], *sys.argv[1:], file=sys.stderr, flush=True)
open(sys.argv[2], "w").write(f"{os.getpid()} {child.pid}")
time.sleep(60)
"""


def end_guard(guard: subprocess.Popen[str], told: Path, ending: str) -> dict:
    """End a guard once its program runs, and return what it says."""
    guard.stdin.write("127.0.0.1:9\n")
    guard.stdin.flush()
    end = time.monotonic() + 30.0
    while not (told.exists() and told.read_text().count(" ")) and time.monotonic() < end:
        time.sleep(0.02)
    if ending == "abandoned":
        guard.stdin.close()
    else:
        guard.send_signal(signal.SIGTERM if ending == "terminated" else signal.SIGQUIT)
    return json.loads(guard.stdout.read())


@pytest.mark.parametrize("ending", ["terminated", "abandoned", "killed at once"])
def test_guard_ends_a_stubborn_program_with_all_that_it_has_started(ending, tmp_path):
    told = tmp_path / "pids"
    with subprocess.Popen(
        [sys.executable, "-m", GUARD, sys.executable, "-S", "-c", STUBBORN, "{address}", told],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True,
    ) as guard:  # fmt: skip
        said = end_guard(guard, told, ending)
    pids = [int(word) for word in told.read_text().split()]
    assert said["status"] == -signal.SIGKILL
    assert "was ended by SIGKILL: " in said["message"]
    assert said["message"].split()[-3:] == ["127.0.0.1:9", "127.0.0.1:9", str(told)]
    for pid in pids:
        assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


def test_program_that_is_not_there_is_told_before_anything_starts(tmp_path):
    result = run("fly", "calm", "--controller", "exec: no-such-program", "--output", str(tmp_path / "out"))
    assert result.exit_code == 2
    assert "there is no program 'no-such-program'" in result.stderr
    assert list(tmp_path.iterdir()) == []
