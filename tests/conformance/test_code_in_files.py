"""Code that arrives by file does not run: bags, tables, journals, certificates, laws, folders with modules.

Whatever runs leaves the file `PWNED`. Programs, libraries and Python files that a bag or a table names need the same
`--controller` or `--build` on the command line.
"""

import ctypes
import json
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import load_vehicle
from firmware_model.recording.journal import RECORD, WIDTH, JournalWriter
from gustproof.cli.app import app
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.flight.recording.bag import write_bag
from gustproof.flight.routes.flight import FlightPlan
from gustproof.law.form import load_law
from gustproof.studies.campaign.plan import AnyController, Campaign, parse_campaign
from gustproof.studies.campaign.runner import fly_campaign
from gustproof.studies.campaign.worker import ChunkResult, failed_rows

SCENARIO = replace(load_scenario("calm"), duration_s=0.1)
VEHICLE = load_vehicle("paper")
PWNED = "PWNED"
RUN = "from gustproof.__main__ import main; main()"
TOUCH = f"open({PWNED!r}, 'w').close()\n"
LOADS_NUMBA = ["gustproof.flight.controllers.library", "firmware_model.numerics.soa", "gustproof.law.step"]


class Evil:
    """Object whose pickle makes a folder."""

    def __reduce__(self):
        return os.mkdir, (PWNED,)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Work in a folder with all that a bag could name: a program, Python, a package, a library, three autopilots."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [*sys.path])
    monkeypatch.setenv("HOME", str(tmp_path))
    Path("mine.py").write_text(TOUCH + "make = object\n")
    Path("pkg").mkdir()
    Path("pkg/__init__.py").write_text(TOUCH)
    Path("pkg/mod.py").write_text("make = object\n")
    Path("law.so").write_bytes(b"\x7fELF evil_facts\0")
    for program in ("program", "build/bin/px4", "build/arducopter", "build/betaflight_SITL.elf"):
        path = Path(program)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"#!/bin/sh\ntouch '{tmp_path / PWNED}'\n")
        path.chmod(0o755)
    Path("build/etc").mkdir()
    yield tmp_path
    assert not (tmp_path / PWNED).exists()


@pytest.fixture(autouse=True)
def loads_nothing(monkeypatch):
    """Let a library that is loaded leave its mark: there may be no compiler here to make one."""
    monkeypatch.setattr(ctypes, "CDLL", lambda name, *_, **__: Path(PWNED).touch() or SimpleNamespace(name=name))


def run(*words: str):
    return CliRunner().invoke(app, [*words])


CONTROLLERS = ("exec: ./program", "mine.py:make", "pkg.mod:make", "./law.so")
AUTOPILOTS = ("px4", "ardupilot", "betaflight")


def given(source: str) -> dict[str, Any]:
    """Return an entry as a bag has it, without the look at its file that would import the package above a module."""
    if source == "pkg.mod:make":
        return {"kind": "python", "source": source, "name": "mod", "digest": "0" * 64}
    return parse_controller(source).to_dict()


def plan_of(source: str) -> dict[str, Any]:
    if source in AUTOPILOTS:
        autopilot = ExternalAutopilot(kind=source, build="build")
        return json.loads(json.dumps(FlightPlan(SCENARIO, autopilot, VEHICLE, 1, real_time=False).metadata()))
    note = json.loads(json.dumps(FlightPlan(SCENARIO, load_law("hinf-d1"), VEHICLE, 1, real_time=False).metadata()))
    return {**note, "law": None, "controller": given(source)}


def make_bag(source: str) -> None:
    records = np.zeros(25, RECORD)
    records["time_us"] = np.arange(25) * 4000.0
    records["q_NB"][:, 0] = 1.0
    write_bag(Path("bag"), records, {**plan_of(source), "outcome": "done", "realtime_factor": 1.0})


def make_table(*laws: AnyController, cases: int = 4) -> None:
    """Write a table without a flight."""

    def submit(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future

    def task(metadata: str, chunk: Any) -> ChunkResult:
        return ChunkResult(failed_rows(parse_campaign(json.loads(metadata), "test"), chunk, "not flown"), 1.0)

    plan = Campaign(scenario=SCENARIO, laws=laws, vehicles=load_vehicle_set("paper"), spreads={}, cases=cases)
    pool: Any = SimpleNamespace(death_errors=(), max_pending=1, submit=submit)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gustproof.studies.campaign.plan.load_library", lambda _: SimpleNamespace(is_single=True))
        fly_campaign(plan, Path("mc.parquet"), pool, chunk_runs=4, task=task)


def user(source: str) -> AnyController:
    if source in AUTOPILOTS:
        return ExternalAutopilot(kind=source, build="build")
    return parse_controller(source)


@pytest.mark.parametrize("source", [*CONTROLLERS, *AUTOPILOTS])
def test_a_bag_starts_and_loads_nothing_and_says_what_to_type(source):
    make_bag(source)
    result = run("replay", "bag", "--output", "out")
    assert (result.exit_code, len(result.stderr.splitlines())) == (2, 1)
    line = f"--autopilot {source} --build build" if source in AUTOPILOTS else f"--controller {source.split()[0]}"
    assert line in result.stderr.replace("'", "")
    assert not Path("out").exists()
    assert run("report", "bag", "-o", "page.html").exit_code == 0
    for other in ("exec: sh", "mine.py:other"):
        assert run("replay", "bag", "--controller", other, "--output", "out").exit_code == 2


def test_another_build_or_kind_than_the_bag_names_is_refused():
    make_bag("px4")
    for words in (("px4",), ("ardupilot", "--build", "build"), ("px4", "--build", "build", "--params", "tuned")):
        result = run("replay", "bag", "--autopilot", *words, "--output", "out")
        assert (result.exit_code, "flown by" in result.stderr) == (2, True)


@pytest.mark.parametrize("words", [("--controller", "mine.py:make"), ("--autopilot", "px4", "--build", "build")])
def test_a_law_s_bag_takes_no_other_controller(words):
    note = FlightPlan(SCENARIO, load_law("hinf-d1"), VEHICLE, 1, real_time=False).metadata()
    write_bag(Path("bag"), np.zeros(3, RECORD), note)
    result = run("replay", "bag", *words, "--output", "out")
    assert (result.exit_code, f"flown by 'hinf-d1', not by {words[0]}" in result.stderr) == (2, True)


@pytest.mark.parametrize("source", ["mine.py:make", "./law.so", *AUTOPILOTS])
def test_a_table_starts_and_loads_nothing_but_is_read_anywhere(source, monkeypatch, tmp_path):
    make_table(load_law("hinf-d1"), user(source))
    result = run("campaign", "rerun", "mc.parquet:4", "--output", "out")
    assert (result.exit_code, "if you trust it, add: --" in result.stderr) == (2, True)
    more = run("campaign", "fly", "calm", "--runs", "9", "-o", "mc.parquet")
    assert more.exit_code == 2
    for gone in ("mine.py", "law.so"):
        Path(gone).unlink()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert run("report", "../mc.parquet", "-o", "page.html").exit_code == 0


@pytest.mark.parametrize("source", ["mine.py:make", "./law.so", *AUTOPILOTS])
def test_a_table_that_grows_flies_only_what_is_given(source, monkeypatch):
    # by the plan alone: to fly the law beside it would take a pool
    from gustproof.studies.campaign.growth import grow_campaign

    make_table(user(source))
    plan = Campaign(
        scenario=SCENARIO, laws=(load_law("hinf-d1"),), vehicles=load_vehicle_set("paper"), spreads={}, cases=4
    )
    grown = grow_campaign(Path("mc.parquet"), plan)
    assert grown.flies_in_lanes
    assert [getattr(law, "given", None) for law in grown.laws] == [False, None]
    with pytest.raises(Exception, match="if you trust it, add: --"):
        grow_campaign(Path("mc.parquet"), replace(plan, cases=9))
    with pytest.raises(Exception, match="if you trust it, add: --"):
        fly_campaign(replace(grown, cases=9), Path("other.parquet"), SimpleNamespace(max_pending=1), chunk_runs=4)


@pytest.mark.parametrize("source", CONTROLLERS)
def test_a_journal_is_recovered_without_what_it_names(source):
    Path("out").mkdir()
    with JournalWriter(Path("out/x.journal"), {"note": plan_of(source)}, 250) as writer:
        for _ in range(3):
            writer.append(np.zeros(WIDTH))
    assert run("report", "out").exit_code in (0, 1, 3)


def arrow_pickle(path: Path) -> None:
    """Write a table whose column is an extension type of Python, which old readers unpickled."""
    marks = {"ARROW:extension:name": "arrow.py_extension_type", "ARROW:extension:metadata": pickle.dumps(Evil(), 0)}
    field = pa.field("run", pa.int64(), metadata=marks)
    pq.write_table(pa.table([[1]], pa.schema([field], {"gustproof": '{"runs": 1, "laws": [{}]}'})), path)


FILES: dict[str, tuple[str, str | bytes | Callable[[Path], object], tuple[str, ...]]] = {
    "law is a pickle": ("law.json", pickle.dumps(Evil()), ("analyse", "law.json")),
    "law of Python objects": ("law.json", '{"py/object": "os.mkdir", "py/reduce": ["PWNED"]}', ("analyse", "law.json")),
    "MATLAB law is a pickle": ("law.mat", pickle.dumps(Evil()), ("analyse", "law.mat")),
    "law's name is a controller": ("law.json", '{"name": "exec: ./program"}', ("fly", "calm", "--law", "law.json")),
    "law is a controller": ("law.json", "", ("analyse", "mine.py:make")),
    "scenario names a command": ("s.toml", f'description = "$(touch {PWNED})"\nduration_s = 0', ("fly", "s.toml")),
    "wind table is a pipe": (
        "s.toml",
        f'description = "x"\nduration_s = 1.0\n[[wind]]\nkind = "table"\nfile = "|touch {PWNED}"\n',
        ("scenario", "check", "s.toml"),
    ),
    "vehicle of Python": (
        "v.toml",
        'name = "!!python/object/apply:os.mkdir [PWNED]"',
        ("tune", "v.toml", "-o", "l.json"),
    ),
    "certificate is a pickle": ("c.json", pickle.dumps(Evil()), ("certify", "check", "c.json")),
    "certificate names Python": ("c.json", '{"law": "mine.py:make", "kind": "pkg"}', ("certify", "check", "c.json")),
    "table of pickles": ("mc.parquet", arrow_pickle, ("report", "mc.parquet", "-o", "page.html")),
    "table is a pickle": ("mc.parquet", pickle.dumps(Evil()), ("campaign", "rerun", "mc.parquet:0")),
    "log is a pickle": ("log.ulg", pickle.dumps(Evil()), ("judge", "log.ulg")),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_data_whatever_is_in_it(name):
    file, content, words = FILES[name]
    if callable(content):
        content(Path(file))
    else:
        Path(file).write_bytes(content.encode() if isinstance(content, str) else content)
    result = run(*words)
    assert (result.exit_code, result.exception and type(result.exception)) == (2, SystemExit)


# Folders: in processes of their own, as their paths are what is tried. One folder has all at once.

SHADOWS = (
    *("json", "socket", "random", "queue", "re", "logging", "pathlib", "enum", "typing", "dataclasses", "copyreg"),
    *("numpy", "numba", "llvmlite", "scipy", "pydantic", "pymavlink", "loky", "typer", "rich", "yaml", "coverage"),
    *("gustproof", "firmware_model", "sitecustomize", "usercustomize", "conftest", "multiprocessing", "subprocess"),
)


@pytest.fixture
def downloads(tmp_path):
    """Return a folder whose files would run if it were on the path, or if its settings were read."""
    place = tmp_path / "downloads"
    place.mkdir()
    run_me = f"import os, pathlib; pathlib.Path({str(tmp_path / PWNED)!r}).touch()\n"
    for name in SHADOWS:
        (place / f"{name}.py").write_text(run_me)
    (place / "evil.pth").write_text(run_me)
    (place / "evil_plugin.py").write_text(run_me)
    about = place / "evil-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n")
    groups = ("pydantic", "numba_extensions", "typer", "distributed.preload")
    (about / "entry_points.txt").write_text("".join(f"[{group}]\ninit = evil_plugin:init\n" for group in groups))
    (place / ".numba_config.yaml").write_text("cache_dir: cache\ndisable_jit: 1\n")
    (place / "matplotlibrc").write_text("backend: module://evil_plugin\n")
    for name in (".env", "pyvenv.cfg", "gustproof.toml", ".gustproof"):
        (place / name).write_text(f"home = {place}\nPYTHONSTARTUP=json.py\nNUMBA_CACHE_DIR=cache\n")
    (place / "short.toml").write_text('description = "short"\nduration_s = 0.1\n')
    return place


@pytest.mark.parametrize(
    "words",
    [
        ("fly", "short.toml", "--law", "hinf-d1", "-o", "out", "--no-tlog", "--json"),
        (
            "campaign",
            "fly",
            "short.toml",
            "--law",
            "hinf-d1",
            "--runs",
            "1",
            "--workers",
            "1",
            "-o",
            "mc.parquet",
            "--json",
        ),
    ],
    ids=lambda words: words[0],
)
def test_a_folder_of_modules_and_settings_runs_nothing(downloads, words):
    # as the installed command starts it: with the folder of the program first, not the current one
    start = [sys.executable, "-c", "import sys; del sys.path[0]; sys.argv[0] = 'gustproof'\n" + RUN, *words]
    done = subprocess.run(start, cwd=downloads, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)


def test_a_module_run_by_python_leaves_the_current_folder(downloads):
    for name in ("gustproof", "firmware_model"):  # which Python itself looks for there
        (downloads / f"{name}.py").unlink()
    command = [sys.executable, "-m", "gustproof", "vehicle", "list", "--json"]
    done = subprocess.run(command, cwd=downloads, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, "paper" in done.stdout) == (0, True), done.stderr


@pytest.mark.parametrize("module", LOADS_NUMBA)
@pytest.mark.parametrize("yaml", ["", "import yaml; "])
def test_settings_of_numba_in_a_folder_are_never_read(module, yaml, tmp_path):
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: evil\ndisable_jit: 1\n")
    told = "numba.config.CACHE_DIR, numba.config.DISABLE_JIT, numba.config.NUMBA_NUM_THREADS, 'yaml' in sys.modules"
    script = f"{yaml}import {module}, numba, sys; numba.core.config.reload_config(); print({told})"
    start = [sys.executable, "-W", "error", "-P", "-c", script]
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1"}
    environment.pop("NUMBA_DISABLE_JIT", None)
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        start, cwd=tmp_path, capture_output=True, text=True, env=environment, timeout=300, check=False
    )
    assert done.stdout.split() == ["0", "1", str(bool(yaml))], done.stderr
