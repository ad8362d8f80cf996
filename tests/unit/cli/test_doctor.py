"""The checkup tells what is wrong and what to do, and work that takes long is told of."""

import json
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from firmware_model.numerics.kept_code import KeptCode
from firmware_model.process import realtime, udp
from firmware_model.sim import vehicle_loop
from gustproof.cli import options
from gustproof.cli.app import app
from gustproof.cli.options import progress, working
from gustproof.flight.routes import checkup
from gustproof.flight.routes.checkup import Check, Status, check_folder, check_port, check_real_time
from gustproof.law import step


def doctor(monkeypatch, *checks: Check, options: tuple[str, ...] = ()):
    found = [*checks]
    monkeypatch.setattr(checkup, "CHECKS", (("nothing", lambda: found),))
    return CliRunner().invoke(app, ["doctor", *options])


def test_each_line_has_its_status_and_a_remedy(monkeypatch):
    warning = Check("ports", Status.WARNING, "taken", "free it")
    result = doctor(monkeypatch, Check("versions", Status.OK, "all there"), warning)
    assert result.exit_code == 0
    first, second, third, last = result.stdout.splitlines()
    assert first.split() == ["OK", "versions", "all", "there"]
    assert second.split() == ["warning", "ports", "taken"]
    assert third.split() == ["do:", "free", "it"]
    assert last == "next: gustproof fly gust-roll"


def test_a_fault_has_status_1_and_json_its_name(monkeypatch):
    result = doctor(monkeypatch, Check("test flight", Status.FAULT, "fell", "look"), options=("--json",))
    assert result.exit_code == 1
    assert result.stderr == "gustproof: 1 of 1 checks failed: test flight\n"
    told = json.loads(result.stdout)
    assert told == {
        "sound": False,
        "checks": [{"name": "test flight", "status": "fault", "found": "fell", "advice": "look"}],
    }


def test_an_old_package_is_a_fault_with_its_remedy(monkeypatch):
    assert checkup.check_versions().status is Status.OK
    monkeypatch.setattr(checkup, "requires", lambda _: ["numpy>=99.1", "no-such-package>=1", "scipy>=1; extra == 'x'"])
    found = checkup.check_versions()
    assert found.status is Status.FAULT
    assert found.advice == "pip install --upgrade 'numpy>=99.1' 'no-such-package>=1'"


def test_a_folder_is_told_by_what_it_lacks(tmp_path: Path, monkeypatch):
    assert check_folder(tmp_path).status is Status.OK
    monkeypatch.setattr(checkup, "_FREE_DISK", 1 << 62)
    assert check_folder(tmp_path).status is Status.WARNING
    monkeypatch.setattr(checkup.os, "access", lambda *_: False)
    assert "not writable" in check_folder(tmp_path).found


@pytest.mark.parametrize(("own", "status"), [(True, Status.WARNING), (False, Status.OK)])
def test_a_taken_port_matters_if_it_is_our_own(own, status, monkeypatch):
    with udp.bind(0) as taken:
        port = taken.getsockname()[1]
        monkeypatch.setitem(checkup._PORTS, port, "someone listens here")
        monkeypatch.setattr(checkup, "_OWN_PORTS", (port,) if own else ())
        found = check_port(port)
    assert found.status is status
    assert found.found.startswith("taken")
    assert check_port(port).found == "free; someone listens here"


def test_refused_real_time_is_a_warning(monkeypatch):
    monkeypatch.setattr(realtime, "request_fifo_scheduling", lambda: False)
    assert check_real_time().status is Status.WARNING
    monkeypatch.setattr(realtime, "request_fifo_scheduling", lambda: True)
    assert check_real_time().status is Status.OK


def test_without_machine_code_the_cache_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr(checkup, "find_damaged", list)
    monkeypatch.setattr(checkup, "find_cache", lambda _: None)
    assert "NUMBA_CACHE_DIR" in checkup.check_cache().advice
    monkeypatch.setattr(checkup, "find_cache", lambda _: KeptCode(tmp_path / "new", False, False))
    assert checkup.check_cache().found.endswith("cold, so the first flight compiles")
    monkeypatch.setattr(checkup, "find_cache", lambda _: KeptCode(tmp_path, True, True))
    assert (checkup.check_cache().status, "temporary" in checkup.check_cache().found) == (Status.WARNING, True)
    assert "set NUMBA_CACHE_DIR" in checkup.describe_temporary_cache()
    monkeypatch.setattr(checkup, "find_cache", lambda _: KeptCode(tmp_path, True, False))
    assert checkup.check_cache().found == f"{tmp_path}: warm"
    assert checkup.describe_temporary_cache() == ""
    monkeypatch.setattr(checkup, "find_damaged", lambda: [tmp_path / "x.nbi", tmp_path / "y.nbc"])
    assert "x.nbi: damaged, or written by others" in checkup.check_cache().found
    monkeypatch.setattr(checkup.os, "access", lambda *_: False)
    assert checkup.check_cache().status is Status.WARNING


def test_a_build_is_found_where_its_variable_says(tmp_path, monkeypatch):
    (kind, find), *_ = checkup._FINDERS.items()
    monkeypatch.setenv("PX4_BUILD", str(tmp_path))
    assert checkup.check_autopilot(kind, find).found.startswith(
        f"not found, and needed for --autopilot px4 alone: {tmp_path}"
    )
    (tmp_path / "etc").mkdir()
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "px4").touch()
    assert checkup.check_autopilot(kind, find).found == f"{tmp_path}: its version is told when it flies"


def test_long_work_is_told_of_where_there_is_no_terminal(capsys, monkeypatch):
    monkeypatch.setattr(options, "_FIRST_LINE_S", 0.01)
    monkeypatch.setattr(options, "_NEXT_LINES_S", 0.01)
    with progress("starts", quiet=False) as shown:
        shown(0.25, "a quarter\x1b")
        time.sleep(0.1)
    first, *_ = told = capsys.readouterr().err.splitlines()
    assert len(told) > 1
    assert first.startswith("gustproof: a quarter\\x1b: 25%, ")
    time.sleep(0.05)
    assert capsys.readouterr().err == ""  # it ends with its work
    with working("proving", quiet=False):
        time.sleep(0.1)
    assert capsys.readouterr().err.startswith("gustproof: proving: 0 s\n")
    with working("proving", quiet=True), progress("starts", quiet=True) as shown:
        shown(0.5, "half")
        time.sleep(0.05)
    assert capsys.readouterr().err == ""


def test_long_work_has_a_bar_in_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    with working("proving", quiet=False):
        time.sleep(0.2)
    with progress("flying", quiet=False) as shown:
        shown(0.5, "half")
        time.sleep(0.2)
    told = capsys.readouterr().err
    assert "proving" in told
    assert "50 %" in told


def test_short_work_is_silent(capsys):
    with working("proving", quiet=False):
        pass
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("found", "cold"), [(None, False), (KeptCode(Path(), True, False), False), (KeptCode(Path(), False, False), True)]
)
def test_what_is_compiled_first_is_told(found, cold, monkeypatch):
    monkeypatch.setattr(step, "find_cache", lambda _: found)
    monkeypatch.setattr(vehicle_loop, "find_cache", lambda _: found)
    assert step.is_cold() is checkup.is_cold() is cold
