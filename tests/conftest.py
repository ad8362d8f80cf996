import gc
import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import coverage
import pytest
import typer.testing

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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Refuse a test that neither pass of the gate would run: the first takes plain ones from tests/unit alone."""
    for item in items:
        elsewhere = UNITS not in item.path.parents or any(map(item.get_closest_marker, ("compiled", "slow")))
        if elsewhere and item.get_closest_marker("plain"):
            raise pytest.UsageError(f"{item.nodeid}: marked plain, it would never run")


def pytest_configure(config: pytest.Config) -> None:
    """Let tests marked `traced` count for coverage, into files that begin with the environment's TRACE_TO."""
    if begin := os.environ.get("TRACE_TO"):
        config.pluginmanager.register(Tracer(begin))


class Tracer:
    """Measures the lines and branches of some tests, and costs the others nothing."""

    def __init__(self, begin: str) -> None:
        self._coverage, self._traced = coverage.Coverage(begin, data_suffix=True), False
        # Packages are imported before, and a worker may get no such test.
        self._coverage.set_option("run:disable_warnings", ["module-not-measured", "no-data-collected"])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        if item.get_closest_marker("traced") is None:
            return (yield)
        self._traced = True
        self._coverage.start()
        try:
            return (yield)
        finally:
            self._coverage.stop()

    def pytest_sessionfinish(self) -> None:
        if self._traced:
            self._coverage.save()


@pytest.fixture(autouse=True, scope="session")
def commands_are_assembled_once() -> Iterator[None]:
    """Assemble the command line once, not for each line: that takes 20 ms."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.testing, "_get_command", cache(typer.testing._get_command))
        yield
