"""What a worker does: fly a stretch of a campaign's runs, and return them as rows of its table."""

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import lru_cache
from itertools import chain
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from firmware_model.config.requirement import Requirement
from firmware_model.config.scenario import Scenario
from firmware_model.config.validation import sanitize_line
from firmware_model.errors import ConfigError
from gustproof.campaign.plan import Campaign, parse_campaign
from gustproof.campaign.sampling import Array
from gustproof.law.form import Law
from gustproof.scoring.metrics import Metrics, measure
from gustproof.scoring.requirements import judge
from gustproof.simulate.batch import Case, CaseResult, make_batch_simulator
from gustproof.simulate.direct import fly_direct
from gustproof.simulate.kernels import LANES
from gustproof.simulate.loopback import fly_loopback
from gustproof.versions import software_versions

FIGURES = tuple(field.name for field in fields(Metrics) if field.type is float and field.name != "realtime_factor")
"""Names of the figures of a run that are numbers, units as in `Metrics`."""
Simulator = Callable[[Sequence[Case]], list[CaseResult]]
Row = tuple[Any, ...]
_get_figures = attrgetter(*FIGURES)


class Chunk(NamedTuple):
    """Runs of one law, one after another."""

    first: int
    """Number of the first."""
    runs: int
    """How many they are."""


class ChunkResult(NamedTuple):
    """Rows of a stretch of runs."""

    table: Any
    """`pyarrow.Table` of `schema`."""
    wall_s: float
    """[s] wall time that they took."""


def fly_chunk(note: str, stretch: Chunk) -> ChunkResult:
    """Fly runs of the campaign that `note` says, and return their rows; the same on every machine of one kind.

    Raises
    ------
    ConfigError
        If this process has other versions than the campaign.
    """
    begin = time.perf_counter()
    campaign = _load_campaign(note)
    first, count = stretch.first % campaign.cases, stretch.runs
    delta, seeds = campaign.deltas(first, count), campaign.flight_seeds(first, count)
    law = campaign.law_of(stretch.first)
    fly, rows = _make_simulator(campaign.scenario, law), []
    for at in range(0, count, LANES):  # a batch's worlds are gone before the next: nothing piles up to be collected
        judged = _fly_cases(campaign, law, fly, delta[at : at + LANES], seeds[at : at + LANES])
        rows += [_make_row(campaign.scenario, each) for each in judged]
    return ChunkResult(_make_table(campaign, stretch, delta, seeds, rows), time.perf_counter() - begin)


def check_worker(note: str) -> int:
    """Return the number of runs of the campaign that `note` says: what a worker must be able to do before it flies."""
    return _load_campaign(note).runs


@lru_cache(maxsize=1)
def _load_campaign(note: str) -> Campaign:
    document = json.loads(note)
    if document["versions"] != software_versions():
        raise ConfigError(
            f"a worker has other versions than the campaign: {software_versions()}, not {document['versions']}"
        )
    return parse_campaign(document, "campaign")


def _fly_cases(
    campaign: Campaign, law: Law, fly: Simulator, delta: Array, seeds: Sequence[int]
) -> list[CaseResult | str]:
    """Return what became of each flight, or why it was none."""
    cases: list[Case | str] = []
    for row, seed in zip(delta.tolist(), seeds, strict=True):
        try:
            cases.append(campaign.flown(row, seed))
        except ConfigError as error:
            cases.append(sanitize_line(str(error)))
    with np.errstate(all="ignore"):  # a flight that diverges is a result
        flown = iter(_fly_bisecting(fly, [case for case in cases if isinstance(case, Case)]))
        return [case if isinstance(case, str) else _check_diverged(campaign, law, case, next(flown)) for case in cases]


def _fly_bisecting(fly: Simulator, cases: list[Case]) -> list[CaseResult | str]:
    """Return what became of each of `cases`; one that can't be flown is found by halving."""
    try:
        return list(fly(cases))
    except (ConfigError, ValueError) as error:
        if len(cases) == 1:
            return [sanitize_line(str(error))]
        half = len(cases) // 2
        return _fly_bisecting(fly, cases[:half]) + _fly_bisecting(fly, cases[half:])


def _make_simulator(scenario: Scenario, law: Law) -> Simulator:
    if scenario.has_link_script:
        return lambda cases: [_fly_by_message(case.apply_to(scenario), law, case) for case in cases]
    return make_batch_simulator(scenario, law)


def _fly_by_message(scenario: Scenario, law: Law, case: Case) -> CaseResult:
    records = fly_loopback(scenario, law, vehicle=case.vehicle, seed=case.seed)
    return CaseResult(
        metrics=measure(records, case.vehicle, scenario, 0.0), requirements=judge(records, scenario, case.vehicle)
    )


def _check_diverged(campaign: Campaign, law: Law, case: Case, judged: CaseResult | str) -> CaseResult | str:
    """Return `judged`, or when the flight diverged if it did."""
    if isinstance(judged, str) or all(map(math.isfinite, _get_figures(judged.metrics))):
        return judged
    if campaign.scenario.has_link_script:
        return "diverged"
    records = fly_direct(case.apply_to(campaign.scenario), law, vehicle=case.vehicle, seed=case.seed)
    numbers = np.column_stack([records["q_NB"], records["omega_B"], records["torque_command_B"]])
    lost = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
    return f"diverged at {records['time_us'][lost[0]] * 1e-6:g} s" if len(lost) else "diverged"


def requirement_columns(requirements: Sequence[Requirement]) -> list[str]:
    """Return a name for each requirement, unique and short."""
    return [
        "_".join(filter(None, ("require", str(number), required.metric.value, required.axis)))
        for number, required in enumerate(requirements)
    ]


def delta_column(spread: str) -> str:
    """Return the column of what was drawn of a spread."""
    return f"delta_{spread.replace('.', '_')}"


def schema(campaign: Campaign) -> Any:
    """Return the table's columns as a `pyarrow.Schema`."""
    numbers = [*map(delta_column, campaign.spreads), *FIGURES]
    required = requirement_columns(campaign.scenario.require)
    fields = [
        ("run", pa.int64()), ("case", pa.int64()), ("law", pa.string()), ("seed", pa.int64()),
        *((name, pa.float64()) for name in numbers), ("rho_in_bounds", pa.bool_()),
        *(column for name in required for column in ((name, pa.float64()), (f"{name}_held", pa.bool_()))),
        ("held", pa.bool_()), ("failure", pa.string()),
    ]  # fmt: skip
    return pa.schema(fields)


def failed_rows(campaign: Campaign, stretch: Chunk, failure: str) -> Any:
    """Return the rows of runs that left nothing but the reason why."""
    first, runs = stretch.first % campaign.cases, stretch.runs
    rows = [_make_row(campaign.scenario, failure)] * runs
    return _make_table(campaign, stretch, campaign.deltas(first, runs), campaign.flight_seeds(first, runs), rows)


def _make_row(scenario: Scenario, judged: CaseResult | str) -> Row:
    """Return what became of a run, by the columns of `schema` from the figures on."""
    if isinstance(judged, str):
        return (*[None] * (len(FIGURES) + 1), *[None, False] * len(scenario.require), False, judged)
    required = [(None if math.isnan(each.value) else each.value, each.is_met) for each in judged.requirements]
    return (
        *_get_figures(judged.metrics), judged.metrics.rho_in_bounds,
        *chain.from_iterable(required), all(held for _, held in required), None,
    )  # fmt: skip


def _make_table(campaign: Campaign, stretch: Chunk, delta: Array, seeds: Sequence[int], rows: Sequence[Row]) -> Any:
    first = stretch.first % campaign.cases
    arrays: list[Any] = [
        range(stretch.first, stretch.first + stretch.runs), range(first, first + stretch.runs),
        [campaign.law_of(stretch.first).name] * stretch.runs, seeds, *delta.T, *zip(*rows, strict=True),
    ]  # fmt: skip
    kinds = schema(campaign)
    return pa.Table.from_arrays([pa.array(a, kind.type) for a, kind in zip(arrays, kinds, strict=True)], schema=kinds)
