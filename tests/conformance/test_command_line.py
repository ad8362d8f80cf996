"""Commands as a shell runs them: `fly` ended from outside, and the checkup of this installation."""

import json
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from gustproof.flight.recording.bag import read_bag
from gustproof.flight.routes import checkup

LONG = 'description = "long enough to be ended before its end"\nduration_s = {}\n'
ENOUGH_S = 120.0  # for starting and compiling on a loaded machine


def start(tmp_path: Path, *, duration_s: float) -> subprocess.Popen[str]:
    (tmp_path / "long.toml").write_text(LONG.format(duration_s))
    arguments = ["fly", "long.toml", "--law", "hinf-d1", "--output", "run", "--json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "gustproof", *arguments],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # Background processes of a shell ignore Ctrl-C, and so do their children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    deadline = time.monotonic() + ENOUGH_S
    while not any(path.stat().st_size > 1_000_000 for path in (tmp_path / "run").glob("*.journal")):
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return process


def end_by(process: subprocess.Popen[str], number: signal.Signals) -> tuple[str, str]:
    started = psutil.Process(process.pid).children(recursive=True)
    assert len(started) == 2
    process.send_signal(number)
    output, errors = process.communicate(timeout=ENOUGH_S)
    assert not any(child.is_running() for child in started)
    return output, errors


def spent_by_ended_s() -> float:
    """Return the time that processes which have ended took of the CPU [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_flight_leaves_a_whole_bag_one_line_and_no_process(
    tmp_path: Path, number: signal.Signals
) -> None:
    ended_s = spent_by_ended_s()
    process = start(tmp_path, duration_s=86_400.0)
    tree = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
    spent_s = sum(sum(each.cpu_times()[:2]) for each in tree)
    output, errors = end_by(process, number)
    assert process.returncode == 130
    assert spent_by_ended_s() - ended_s - spent_s < 5.0  # of CPU, so that the end does not wait for work
    assert errors.strip().splitlines() == ["gustproof: interrupted; the recording so far is in run"]
    told = json.loads(output)
    _, records = read_bag(tmp_path / told["bag"])
    assert told["outcome"] == "interrupted"
    assert len(records) > 1000


def test_a_killed_controller_ends_in_the_fail_safe_status_3_and_a_whole_bag(tmp_path: Path) -> None:
    process = start(tmp_path, duration_s=120.0)  # its fail-safe is flown and recorded to the end
    (controller,) = [child for child in psutil.Process(process.pid).children() if child.name() == "endpoint"]
    controller.kill()
    output, errors = process.communicate(timeout=ENOUGH_S)
    assert process.returncode == 3
    assert len(errors.strip().splitlines()) == 1
    _, records = read_bag(tmp_path / json.loads(output)["bag"])
    assert set(records["mode"].tolist()) == {6 << 16, 7 << 16}  # OFFBOARD, then STABILIZED


def test_the_checkup_flies_the_bits_of_the_flight_without_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    found = checkup.check_flight()
    assert found.status is checkup.Status.OK, found
    assert "the same bits" in found.found
    monkeypatch.setattr(checkup, "first_difference_s", lambda *_: 0.5)
    assert checkup.check_flight().status is checkup.Status.FAULT
