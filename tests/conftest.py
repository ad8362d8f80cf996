import gc
from collections.abc import Iterator
from functools import cache

import pytest
import typer.testing

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


@pytest.fixture(autouse=True, scope="session")
def commands_are_assembled_once() -> Iterator[None]:
    """Assemble the command line once, not for each line: that takes 20 ms."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.testing, "_get_command", cache(typer.testing._get_command))
        yield
