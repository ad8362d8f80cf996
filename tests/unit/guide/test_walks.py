"""Every command of every page is run in one folder, where what one leaves feeds the next.

As it stands, or with fewer flights; flights are flown in this process, whose bits are those of two. Commands for a
real autopilot's build run up to their refusal without one. The tutorial and the page on vehicles have walks of their
own beside this one, the programs of users and the protocol in tests/conformance.
"""

import re
import shlex
import shutil
import signal
import subprocess
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.layout_engine import ConstrainedLayoutEngine
from typer.testing import CliRunner, Result

import gustproof
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import VEHICLES, load_vehicle
from firmware_model.process import realtime, udp
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from gustproof.cli.app import app
from gustproof.design import methods
from gustproof.design import tune as tuning
from gustproof.guide import site
from gustproof.robust.gain import lft_gain
from gustproof.robust.gain.certificate import Certificate
from gustproof.robust.gain.worst_schedule import worst_schedule
from gustproof.show.live import live
from gustproof.show.report import laws as report_of_laws
from gustproof.show.reproduce import run as paper
from gustproof.studies.campaign import executors
from gustproof.studies.rate import judge as judging
from gustproof.studies.rate import placement
from gustproof.studies.wind_limit import wind_flight

pytestmark = [pytest.mark.slow]
GUIDE = Path(str(files("gustproof.guide")))
README = Path(__file__).parents[3] / "README.md"
WALKED_BESIDE = ("tutorial", "vehicle")
PAGES = (
    "log", "px4", "ardupilot", "theory", "scenario", "commands", "campaign", "wind", "prove", "controllers",
    "protocol", "figures", "export", "matlab", "autopilots", "outside", "ground-station", "viewers", "install",
    "README", "tutorial", "vehicle", "course",
)  # fmt: skip
FEWER = (
    (r"--runs 1000", "--runs 20"),
    (r"mc\.parquet:471", "mc.parquet:7"),
    (r"^campaign (?!rerun|.*--runs).*", r"\g<0> --runs 4"),
    (r"^wind-limit .*", r"\g<0> --risk 0.3"),
    (r"^worst-case .*", r"\g<0> --flights 100 --horizon 2"),
    (r"^(compare course .*)", r"\1 --runs 2"),
    (r"^(reproduce .*pdf.*)", r"\1 --seeds 1"),
    (r"^tune (.*--slew.*)", r"tune \1 --law lqg"),
    (r"(design hinfstruct D2) 6", r"\1 3 --starts 1"),
    (r"--angle-rad 0\.\d --rate-rad-s 0\.5", "--angle-rad 0.01 --rate-rad-s 0.01"),
)
"""Fewer flights, starts of a search, states, and a smaller envelope, by what stands on the page."""
INSTEAD = (
    (
        r"^identify flight\.(ulg|bin)(.*)",
        r"identify my-log\2 --like paper",
    ),  # known rotors: no autopilot flew it
    (r"^judge flight\.ulg$", "judge px4"),
    (r"--(from|over) flight\.ulg", r"--\1 px4"),  # no autopilot's parameters are in that log
    (r"--(from|over) flight\.bin", r"--\1 ardupilot"),
    (r"flight\.(ulg|bin)", "my-log"),  # readers of these logs have tests with judges of their own
    (r"^autopilot(?! params)", "autopilot --instance 209"),  # other tests use the usual ports beside this one
    (r"^replay runs/fly-001", "replay runs/fly-002"),  # the first one fails its requirement
)
NEEDS_BUILD = re.compile(r"--(build|inside) ")
WITH_PNG = "reproduce --output paper --seeds 3"
"""Run with figures as PDF; tests of `reproduce` draw them as PNG."""
ELSEWHERE = re.compile(r"\"exec: ")
IN_ROOMS = {
    "certify gain hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 -o certificate.json": "cli/test_certify.py",
    "certify check certificate.json": "cli/test_certify.py",
    "certify check certificate.json --design hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5": "cli/test_certify.py",
    "certify gain hinf-d1 --angle-rad 0.3 --rate-rad-s 0.5 --exact-rho --leak 0.05": "cli/test_certify.py",
    "design hinfstruct D2 6 -o reduced.json": "design/test_fixed_order.py",
}
"""Searches of seconds that a test of another room runs, on a smaller envelope or from fewer starts."""
EXPORTED_C = "export flagship -o law.c"
"""Its code is compiled by the next line of the page."""
FOR_THE_PAPER = "analyse my.params"
"""The gains of this page are flown on the paper's vehicle, those of pages before it are for another."""
NOT_PROVED = Certificate(statement="", gain=3.0, lower_bound=2.0, proven=False, assumes={}, evidence={}, residual=0.0)
INTERRUPTED = re.compile(r"^autopilot --instance")
OUTPUTS = {"-o", "--output", "--report", "--px4", "--ardupilot", "--figure", "--schemas"}
FAILS = ("fly coning --law hinf-d1", "fly worst.toml --law hinf-d1", "judge ", "certify box shaped.json")
"""Commands with status 1: a requirement fails, gains are fragile, a true attitude has no bound. Others end with 0."""


def read_page(page: str) -> str:
    return (README if page == "README" else GUIDE / f"{page}.md").read_text(encoding="utf-8")


def commands(page: str, marks: str = "[^\n]*") -> list[str]:
    """Return the commands of gustproof on a page, without its name; `marks` are those of their blocks."""
    shown = "".join(re.findall(rf"^```console{marks}\n(.*?)^```", read_page(page), flags=re.M | re.S))
    parts = [part.strip() for line in shown.splitlines() for part in line.removeprefix("$ ").split("&&")]
    return [part.removeprefix("gustproof ") for part in parts if part.startswith("gustproof ")]


def block(page: str, language: str) -> str:
    (first, *_) = re.findall(rf"^```{language}\n(.*?)^```", read_page(page), flags=re.M | re.S)
    return str(first)


def adapted(line: str, *rules: tuple[str, str]) -> str:
    for pattern, instead in rules:
        line = re.sub(pattern, instead, line)
    return line


def kind(line: str) -> str:
    """Return how a command of a page is run."""
    if line in BESIDE:
        return "in a walk beside this one"
    if line in LONGER:
        return "with an output too"
    if NEEDS_BUILD.search(line):
        return "without its build"
    if ELSEWHERE.search(line):
        return "with programs, in tests/conformance"
    if line in IN_ROOMS:
        return "in a test of its room"
    if adapted(line, *INSTEAD) != line:
        return "with something in its place"
    return "as it stands" if adapted(line, *FEWER) == line else "shorter"


LINES = list(dict.fromkeys(line for page in PAGES for line in commands(page)))
BESIDE = {line for page in WALKED_BESIDE for line in commands(page, "")} | {each for each in LINES if "my-air" in each}
LONGER = {line for line in LINES if any(each.startswith(f"{line} -o ") for each in LINES)} | {WITH_PNG}
_RUN = (line for line in LINES if not (line in BESIDE | LONGER | set(IN_ROOMS) or ELSEWHERE.search(line)))
OURS = list({adapted(line, *INSTEAD, *FEWER): line for line in _RUN}.values())
"""Commands that are run here; once, if two pages show the same but for what is put in its place."""


def meet(endpoint: Any, *_: object) -> None:
    """Carry datagrams between a controller and a vehicle on a virtual clock, without a socket."""
    calm = replace(load_scenario("calm"), duration_s=76.0 if endpoint._recorder else 0.2)
    vehicle, now_us = VehicleEndpoint(load_vehicle("paper"), calm, 1, lambda _: None, lockstep=True), 0
    there, here = endpoint.vehicle, (0, ("127.0.0.1", 2))
    while not endpoint.finished:
        asked, told = endpoint.poll(now_us), []
        for datagram, _ in asked:
            vehicle.receive(datagram, here, now_us)
        told = vehicle.poll(now_us)
        for datagram, _ in told:
            endpoint.receive(datagram, there, now_us)
        now_us += 10 if asked and told else 1_000


def prepare(folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Leave what the pages say a reader has, and keep this process and its machine as they are."""
    for name in ("day.toml", "mine.toml"):
        (folder / name).write_text(block("scenario", "toml"), encoding="utf-8")
    (folder / "mine.py").write_text(block("controllers", "python"), encoding="utf-8")
    shutil.copy(VEHICLES / "paper.toml", folder / "my-twin.toml")
    patch.chdir(folder)
    patch.setenv("HOME", str(folder))
    patch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))
    patch.setattr("webbrowser.open", lambda address: (folder / "opened").write_text(address))
    patch.setattr(site, "load_pages", cache(site.load_pages))
    patch.setattr(live, "_ABSENCE_S", 0.0)
    patch.setattr(live.LivePage, "wait", lambda _: 0)
    assert gustproof.process_pool is executors.process_pool  # found once and kept, so before it is replaced
    patch.setattr(executors, "process_pool", pool_here)
    patch.setattr(paper, "load_scenario", lambda name: replace(load_scenario(name), duration_s=1.0))
    patch.setattr(placement, "PEAKS", (1.36,))
    patch.setattr(placement, "SLEWS", (20.0,))
    patch.setattr(paper, "LAWS", ("hinf-d1", "pid-fair", "flagship"))
    patch.setattr(methods, "musyn", partial(methods.musyn, iterations=1))
    for proof in ("certify_gain", "certify_lft"):  # of a law just designed; `certify` proves on its own
        patch.setattr(methods, proof, lambda *_, **__: NOT_PROVED)
    patch.setattr(lft_gain, "worst_schedule", partial(worst_schedule, duration=10.0))
    patch.setattr(tuning, "_SLEWS", (0.5, 2.0))
    patch.setattr(tuning, "_PEAKS", (1.3, 1.6))
    patch.setattr(report_of_laws, "_FREQUENCIES", np.geomspace(1.0, 100.0, 50))
    patch.setattr(ConstrainedLayoutEngine, "execute", lambda *_: None)  # half of a figure's time; its tests lay it out
    patch.setattr(wind_flight, "MINUTE_S", 5.0)
    patch.setattr(judging, "_FLIGHTS", 100)
    patch.setattr(judging, "_SEARCH_S", 1.0)
    patch.setattr(judging, "_prove", lambda *_: (None, "left out"))  # as in the tests of judge, beside those of proofs
    patch.setattr(realtime, "freeze_gc", lambda **_: None)
    patch.setattr(realtime, "request_fifo_scheduling", lambda: False)
    patch.setattr(udp, "serve_lockstep", meet)
    patch.setattr(udp, "serve", lambda endpoint, *_, **__: endpoint.interrupt())
    assert run("fly doublets --law flagship --output my-log")[1] == []  # as the tutorial does


@contextmanager
def pool_here(_: int) -> Iterator[Any]:
    """Yield a pool without workers: what is submitted is done at once."""

    def submit(function: Any, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future

    yield SimpleNamespace(death_errors=(), max_pending=1, submit=submit)


def outputs(line: str) -> list[str]:
    """Return the files and folders that a command is told to write."""
    options = OUTPUTS | ({"--law"} if line.startswith("export ") else set())
    return [name for option, name in pairwise(shlex.split(adapted(line, *INSTEAD, *FEWER))) if option in options]


def run(line: str) -> tuple[Result, list[str]]:
    """Run a command, and return how it ended and which of its outputs are missing.

    What an earlier command left in the place of an output is removed.
    """
    if line == FOR_THE_PAPER:
        run("tune paper --from px4 --at-once -o my.params")
    for path in map(Path, outputs(line)):
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        if path.suffix == ".c":
            path.with_suffix(".h").unlink(missing_ok=True)
    words = shlex.split(adapted(line, *INSTEAD, *FEWER))
    result = CliRunner().invoke(app, words)
    if result.exit_code == 2 and "--force overwrites it" in result.stderr:  # a file beside, of another page's command
        result = CliRunner().invoke(app, [*words, "--force"])
    if line == EXPORTED_C:
        subprocess.run(shlex.split(re.findall(r"^\$ (gcc .*)", read_page("controllers"), flags=re.M)[0]), check=True)
    return result, [name for name in outputs(line) if not Path(name).exists()]


@pytest.fixture(scope="module")
def _reader(_flown_here: None, start_as_users: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let all commands run in one folder, in the order of the pages."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    with pytest.MonkeyPatch.context() as patch:
        start_as_users(patch)
        prepare(tmp_path_factory.mktemp("walk"), patch)
        yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("_reader")
@pytest.mark.parametrize("line", OURS)
def test_a_command_of_the_guide_does_what_its_page_says(line: str) -> None:
    result, missing = run(line)
    if NEEDS_BUILD.search(line):
        assert result.exit_code == 2
        assert re.search(r"no (PX4|ArduCopter) built for simulation .*: give --build", result.stderr), result.stderr
        return
    if INTERRUPTED.search(adapted(line, *INSTEAD)):
        assert result.exit_code == 130
        return
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code in ({0, 1} if line.startswith(FAILS) else {0}), result.output
    assert missing == []


def test_every_command_is_run_and_it_is_known_how() -> None:
    assert Counter(map(kind, LINES)) == {
        "as it stands": 61,
        "shorter": 17,
        "in a test of its room": 5,
        "with something in its place": 12,
        "with an output too": 4,
        "in a walk beside this one": 20,
        "without its build": 9,
        "with programs, in tests/conformance": 5,
    }


def test_the_programs_of_the_pages_are_flown_in_conformance() -> None:
    flown = (Path(__file__).parents[2] / "conformance" / "test_programs.py").read_text(encoding="utf-8")
    programs = [re.findall(r'exec: .*?([\w.]+)"', line)[0] for line in LINES if ELSEWHERE.search(line)]
    assert len(programs) == 5
    assert all(f'"client{Path(program).suffix or ".c"}"' in flown for program in programs)


@pytest.mark.parametrize(("line", "file"), IN_ROOMS.items())
def test_the_test_of_a_room_runs_the_command_of_the_page(line: str, file: str) -> None:
    text = (Path(__file__).parents[1] / file).read_text(encoding="utf-8")
    assert line in LINES
    name, *words = shlex.split(line)
    assert [word for word in (name, *words) if word.startswith("-") and f'"{word}"' not in text] == []
