import faulthandler
import gc
import runpy
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path

import coverage
import pytest
import typer.testing
from hypothesis import settings

from firmware_model.config.whole_file import OVERWRITES
from firmware_model.process.fork import run_in_copy

settings.register_profile("busy", deadline=None)  # no test may hang on the pace of a machine
settings.load_profile("busy")
UNITS = Path(__file__).with_name("unit")

gc.disable()  # up to the first test


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Keep from the collector what is imported and collected: to look through it takes 3 s of each process, in vain.

    Later it looks seldom: tests make few cycles, and memory is not short.
    """
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(50_000, 50)
        gc.enable()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[object]:
    """Measure coverage of unit tests that are not slow: the others would take half as long again, and reach no more.

    All measurements are paused: in a worker pytest-cov starts two, one in the other, and its `no_cover` pauses one.
    """
    paused: list[coverage.Coverage] = []
    if UNITS not in item.path.parents or item.get_closest_marker("slow"):
        while each := coverage.Coverage.current():
            each.stop()
            paused.append(each)
    try:
        return (yield)
    finally:
        for each in reversed(paused):
            each.start()


def pytest_configure() -> None:
    """Let Ctrl-C and a hang-up reach the programs that tests start, also where this run began with `&` or nohup."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda *_: None)  # this process goes on: what it starts has the default again


@pytest.fixture(autouse=True)
def files_may_be_written_over() -> Iterator[None]:
    """Undo what an option's parser leaves behind where a test calls it outside a command."""
    token = OVERWRITES.set(True)
    yield
    OVERWRITES.reset(token)


@pytest.fixture(autouse=True, scope="session")
def commands_are_assembled_once() -> Iterator[None]:
    """Assemble the command line once, not for each line: that takes 20 ms."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.testing, "_get_command", cache(typer.testing._get_command))
        yield


@pytest.fixture(autouse=True, scope="session")
def start_as_users() -> Iterator[Callable[[pytest.MonkeyPatch], None]]:
    """Begin the processes of a flight as copies of this one, which has loaded what they need.

    To start Python and load the libraries takes .4 s of CPU, a flight .05 s. Yield what starts them as for users
    instead, as a test needs that patches what they use. What it starts by a command line of its own is not copied.
    """
    from gustproof.flight.routes.processes import launch

    with pytest.MonkeyPatch.context() as patch:
        _patch_launch(patch, _launch)
        yield partial(_patch_launch, launch=launch)


@pytest.fixture
def started_as_users(start_as_users, monkeypatch) -> None:
    """Start the processes of a flight as for users: a copy has the command line of the tests."""
    start_as_users(monkeypatch)


def _patch_launch(patch: pytest.MonkeyPatch, launch: Callable[..., subprocess.Popen[str]]) -> None:
    for module in ("routes.processes", "routes.external", "protocol_check.inspection"):
        patch.setattr(f"gustproof.flight.{module}.launch", launch)


def _launch(module: str, *arguments: str, **_: bool) -> subprocess.Popen[str]:
    run = run_in_copy(module, partial(_run, module), arguments)

    def begin() -> None:
        sys.settrace(None)  # before any file that coverage has not met: another thread may hold its lock
        run()

    with warnings.catch_warnings(action="ignore", category=DeprecationWarning):  # a worker's other thread only reads
        return subprocess.Popen(
            [sys.executable, "-m", module, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=begin,
        )  # fmt: skip


def _run(module: str, words: Sequence[str]) -> int:
    """Run a module as Python would that was started with it, and return its exit status."""
    faulthandler.disable()
    sys.argv = [module, *words]
    warnings.filterwarnings("ignore", "'.*' found in sys.modules", RuntimeWarning)
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    except SystemExit as ending:
        return ending.code if isinstance(ending.code, int) else ending.code is not None
    return 0
