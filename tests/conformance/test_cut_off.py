"""Killed flights and full disks: the journal survives, and `report` completes the recording."""

import os
import random
import re
import resource
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from typer.testing import CliRunner

from firmware_model.autopilot.modes import Mode
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.recording.durable_file import is_growing
from gustproof.cli.app import app
from gustproof.flight.recording.bag import read_bag
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.recorder import recover
from gustproof.law.form import load_law

SCRIPT = 'description = "cut off"\nduration_s = 20.0\n[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 15.4\n'
NAME = "gusty-hinf-d1-seed3"
A_SECOND = 250  # samples
ENOUGH_S = 120.0  # for starting and compiling on a loaded machine
pytestmark = pytest.mark.usefixtures("started_as_users")

KILLER = Path(__file__).with_name("killer")
POWER_LOSS = ("controller", "fly", "vehicle")
KILLS = [POWER_LOSS, ("vehicle",), ("fly",), ("controller",), POWER_LOSS] * 2
MOMENTS = random.Random(4).sample(range(1, 5000), len(KILLS))


def fly(tmp_path: Path, *arguments: str, **options: object) -> subprocess.CompletedProcess[str]:
    (tmp_path / "gusty.toml").write_text(SCRIPT)
    command = [sys.executable, "-m", "gustproof", "fly", "gusty.toml", "--law", "hinf-d1", "--seed", "3", *arguments]
    return subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, timeout=ENOUGH_S, check=False, **options
    )


def wait_for_the_processes_of(run: Path) -> None:
    """Wait until no process of a flight is left: without their parent they end in order.

    A process that is killed loses its command line a moment before its hold on the journal.
    """

    def are_left() -> bool:
        lines = (" ".join(process.info["cmdline"] or ()) for process in psutil.process_iter(["cmdline"]))
        return any(str(run) in line for line in lines) or any(map(is_growing, run.glob("*.journal")))

    deadline = time.monotonic() + ENOUGH_S
    while are_left():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory):
    path = tmp_path_factory.mktemp("script") / "gusty.toml"
    path.write_text(SCRIPT)
    return fly_direct(load_scenario(path), load_law("hinf-d1"), vehicle=load_vehicle("paper"), seed=3)


@pytest.mark.parametrize(("victims", "moment"), list(zip(KILLS, MOMENTS, strict=True)), ids=str)
def test_a_kill_at_any_moment_loses_a_second_at_most(tmp_path, undisturbed, victims, moment):
    run = tmp_path / "run"
    (temporary := tmp_path / "temporary").mkdir()
    path = os.pathsep.join(filter(None, (str(KILLER), os.environ.get("PYTHONPATH"))))
    kill = {"PYTHONPATH": path, "KILL": " ".join((*victims, str(moment))), "TMPDIR": str(temporary)}
    if "fly" in victims:
        assert fly(tmp_path, "--output", str(run), env={**os.environ, **kill}).returncode == -9
        wait_for_the_processes_of(run)
        told = recover(run)[0].to_dict()
        assert (told["outcome"], told["scenario"], told["law"], told["seed"]) == ("cut_off", "gusty", "hinf-d1", 3)
    else:  # this process can run the command: it is not killed
        (tmp_path / "gusty.toml").write_text(SCRIPT)
        flown = ["fly", str(tmp_path / "gusty.toml"), "--law", "hinf-d1", "--seed", "3", "--output", str(run)]
        assert CliRunner().invoke(app, flown, env=kill).exit_code == 3
    about, records = read_bag(run / NAME)
    assert about["law"]["name"] == "hinf-d1"
    assert sorted(path.name for path in run.iterdir()) == [NAME, f"{NAME}.tlog"]
    assert list(temporary.iterdir()) == []
    if "vehicle" in victims:
        assert moment - A_SECOND < len(records) <= moment
    else:
        assert len(records) >= moment
    by_the_law = records[records["mode"] == Mode.OFFBOARD.value]
    assert len(by_the_law) >= min(moment, len(records))
    assert by_the_law.tobytes() == undisturbed[: len(by_the_law)].tobytes()


def full_disk_is_told_and_nothing_is_lost(ended, run: Path, why: str) -> None:
    assert ended.returncode == 3
    *progress, line = ended.stderr.strip().splitlines()
    assert all(re.fullmatch(r"gustproof: gusty, hinf-d1.* \d+ s", told) for told in progress), progress
    assert why in line
    assert f"what was flown is in {run / NAME}.journal" in line
    assert sorted(path.name for path in run.iterdir() if path.suffix != ".tlog") == [f"{NAME}.journal"]


def is_recovered(run: Path, undisturbed) -> None:
    shown = CliRunner().invoke(app, ["report", str(run), "-o", str(run.with_suffix(".html"))])
    assert shown.exit_code == 0, shown.stderr
    _, records = read_bag(run / NAME)
    assert len(records) > 10 * A_SECOND
    assert records.tobytes() == undisturbed[: len(records)].tobytes()
    assert not (run / f"{NAME}.journal").exists()


def test_files_at_their_largest_size_end_the_flight_in_one_line_and_keep_it(tmp_path, undisturbed):
    size = 1_500_000

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    run = tmp_path / "run"
    ended = fly(tmp_path, "--output", str(run), "--no-tlog", preexec_fn=limit)
    full_disk_is_told_and_nothing_is_lost(ended, run, "File too large")
    is_recovered(run, undisturbed)


@pytest.fixture
def small_disk(tmp_path):
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1500k", "tmpfs", str(place)]
    try:
        subprocess.run(mount, check=True, capture_output=True, timeout=30)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no small disk can be mounted here")
    yield place
    subprocess.run(["umount", str(place)], check=True, timeout=30)


def test_a_full_disk_ends_the_flight_in_one_line_and_keeps_it(tmp_path, small_disk, undisturbed):
    run = small_disk / "run"
    ended = fly(tmp_path, "--output", str(run))
    full_disk_is_told_and_nothing_is_lost(ended, run, "No space left on device")
    subprocess.run(["mount", "-o", "remount,size=64m", str(small_disk)], check=True, timeout=30)
    is_recovered(run, undisturbed)
