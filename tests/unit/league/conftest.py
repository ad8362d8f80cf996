from concurrent.futures import BrokenExecutor, Future
from types import SimpleNamespace
from typing import Any

import pytest

from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.league import tasks


class Here:
    """Pool that works at once, in this process; the tasks in `deadly` kill their worker."""

    death_errors = (BrokenExecutor,)
    max_pending = 3

    def __init__(self, deadly: str = "") -> None:
        self.deadly, self.labels = deadly, []

    def submit(self, function: Any, task: Any) -> Future:
        future: Future = Future()
        self.labels.append(task.label)
        if self.deadly and self.deadly in task.label:
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(function(task))
        return future


@pytest.fixture
def here() -> type[Here]:
    return Here


@pytest.fixture
def unflown(monkeypatch) -> None:
    """Let no flight be flown, as a conformance test flies some: all errors are .4 deg, the reference's .1 deg."""

    def refuse(*_: Any, **__: Any) -> None:
        raise DesignError("not weighed")

    def fly(_: Any, law: Law) -> Any:
        error = 0.1 if law.name == "pid-fair" else 0.4
        return lambda cases: [SimpleNamespace(requirements=[SimpleNamespace(value=error)]) for _ in cases]

    monkeypatch.setattr(tasks, "measure_price", refuse)
    monkeypatch.setattr(tasks, "make_batch_simulator", fly)
