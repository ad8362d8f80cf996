from concurrent.futures import BrokenExecutor, Future
from types import SimpleNamespace
from typing import Any

import pytest

from gustproof.errors import DesignError
from gustproof.studies.campaign import worker
from gustproof.studies.campaign.worker import FIGURES, Chunk, ChunkResult
from gustproof.studies.league import study

ERRORS_DEG = {"pid-fair": 0.1, "tumbler": 75.0}
"""[deg] errors by law; .4 deg of any other."""


def pretend(metadata: str, chunk: Chunk) -> ChunkResult:
    """Return the rows of flights that are not flown, as a conformance test flies some."""
    campaign = worker.load_campaign(metadata)
    figures = SimpleNamespace(**dict.fromkeys(FIGURES, 0.1), rho_in_bounds=True)
    error = ERRORS_DEG.get(campaign.law_of(chunk.first).name, 0.4)
    flown = SimpleNamespace(metrics=figures, requirements=[SimpleNamespace(value=error, is_met=True)])
    rows = [worker._make_row(campaign.scenario, flown)] * chunk.runs
    first = chunk.first % campaign.cases
    deltas, seeds = campaign.draw_deltas(first, chunk.runs), campaign.flight_seeds(first, chunk.runs)
    return ChunkResult(worker._make_table(campaign, chunk, deltas, seeds, rows), 1.0)


class Here:
    """Pool that works at once, in this process; what is in `deadly` kills its worker."""

    death_errors = (BrokenExecutor,)
    max_pending = 3

    def __init__(self, deadly: str = "") -> None:
        self.deadly, self.labels = deadly, []

    def submit(self, function: Any, *arguments: Any) -> Future:
        future: Future = Future()
        about, function = arguments[0], pretend if function is worker.fly_chunk else function
        name = worker.load_campaign(about).law_of(arguments[1].first).name if function is pretend else about.name
        self.labels.append(f"{function.__name__} {name}")
        if self.deadly == self.labels[-1]:
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(function(*arguments))
        return future


@pytest.fixture
def here() -> type[Here]:
    return Here


@pytest.fixture
def unflown(monkeypatch) -> None:
    """Let no operating point be measured."""

    def refuse(*_: Any, **__: Any) -> None:
        raise DesignError("not measured")

    monkeypatch.setattr(study, "measure_operating_point", refuse)
