"""Worker tasks: fly a chunk of a campaign's runs and return them as rows of its table."""

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
from gustproof.flight.controllers.external_autopilot import AnyController, ExternalAutopilot
from gustproof.flight.controllers.user_controller import Controller
from gustproof.flight.routes.batch import Case, CaseResult, make_batch_simulator
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.flight import Flight
from gustproof.flight.routes.kernels import LANES
from gustproof.flight.routes.outcome import ENTRY_FAILURES, FlightOutcome
from gustproof.flight.scoring.metrics import FIGURE_UNITS, Metrics, measure
from gustproof.flight.scoring.requirements import judge, requirement_unit
from gustproof.studies.campaign.plan import Campaign, flies_in_lanes, parse_campaign, trust
from gustproof.types import Array
from gustproof.version import software_versions

FIGURES = tuple(field.name for field in fields(Metrics) if field.type is float and field.name != "realtime_factor")
"""Names of a run's numeric figures, units as in `Metrics`."""
_LOST = FlightOutcome.KILLED, FlightOutcome.HUNG, FlightOutcome.PORT_TAKEN
"""Ends of a real autopilot's flight that say nothing of its loops."""
Simulator = Callable[[Sequence[Case]], list[CaseResult]]
Row = tuple[Any, ...]
_get_figures = attrgetter(*FIGURES)


class Chunk(NamedTuple):
    """Consecutive runs of one law."""

    first: int
    """Number of the first run."""
    runs: int
    """Number of runs."""


class ChunkResult(NamedTuple):
    """Rows of a chunk of runs."""

    table: Any
    """`pyarrow.Table` of `schema`."""
    wall_s: float
    """[s] wall time of the flights."""


def fly_chunk(metadata: str, chunk: Chunk) -> ChunkResult:
    """Fly a chunk of the campaign in `metadata` (JSON) and return its rows, equal on all machines of one kind.

    Raises
    ------
    ConfigError
        If this process has other software versions than the campaign, or another file of a controller.
    """
    begin = time.perf_counter()
    campaign = load_campaign(metadata)
    first, count = chunk.first % campaign.cases, chunk.runs
    delta, seeds = campaign.draw_deltas(first, count), campaign.flight_seeds(first, count)
    law = trust(campaign.law_of(chunk.first))
    fly, rows = _make_simulator(campaign, law), []
    width = LANES if flies_in_lanes(law) else 1
    for at in range(0, count, width):  # one batch at a time: its states are freed before the next
        results = _fly_cases(campaign, law, fly, delta[at : at + width], seeds[at : at + width])
        rows += [_make_row(campaign.scenario, result) for result in results]
    return ChunkResult(_make_table(campaign, chunk, delta, seeds, rows), time.perf_counter() - begin)


def check_worker(metadata: str) -> int:
    """Load the campaign in `metadata` (JSON) without flying and return its number of runs."""
    return load_campaign(metadata).runs


@lru_cache(maxsize=1)
def load_campaign(metadata: str) -> Campaign:
    """Return the campaign in `metadata` (JSON).

    Raises
    ------
    ConfigError
        If this process has other software versions than the campaign.
    """
    document = json.loads(metadata)
    if document["versions"] != software_versions():
        raise ConfigError(
            f"a worker has other versions than the campaign: {software_versions()}, not {document['versions']}"
        )
    return parse_campaign(document, "campaign")


def _fly_cases(
    campaign: Campaign, law: AnyController, fly: Simulator, delta: Array, seeds: Sequence[int]
) -> list[CaseResult | str]:
    """Return the result of each case, or the reason why it has none."""
    cases: list[Case | str] = []
    for row, seed in zip(delta.tolist(), seeds, strict=True):
        try:
            cases.append(campaign.make_case(row, seed))
        except ConfigError as error:
            cases.append(sanitize_line(str(error)))
    with np.errstate(all="ignore"):  # a flight that diverges is a result
        flown = iter(_fly_bisecting(fly, [case for case in cases if isinstance(case, Case)]))
        return [case if isinstance(case, str) else _check_diverged(campaign, law, case, next(flown)) for case in cases]


def _fly_bisecting(fly: Simulator, cases: list[Case]) -> list[CaseResult | str]:
    """Return the result of each of `cases`; bisect to isolate a case that raises."""
    try:
        return list(fly(cases))
    except (ConfigError, ValueError) as error:
        if len(cases) == 1:
            return [sanitize_line(str(error))]
        half = len(cases) // 2
        return _fly_bisecting(fly, cases[:half]) + _fly_bisecting(fly, cases[half:])


def _make_simulator(campaign: Campaign, law: AnyController) -> Simulator:
    scenario = campaign.scenario
    if isinstance(law, ExternalAutopilot):
        return lambda cases: [_fly_external(scenario, law, case) for case in cases]
    if not scenario.has_link_script and flies_in_lanes(law):
        return make_batch_simulator(scenario, law)

    def fly(case: Case) -> CaseResult:
        script, flight = case.apply_to(scenario), _fly_alone(campaign, law, case)
        if flight.outcome in ENTRY_FAILURES or flight.outcome is FlightOutcome.DIVERGED:
            raise ValueError(flight.message)
        metrics = measure(flight.records, case.vehicle, script, law=law)
        return CaseResult(metrics=metrics, requirements=judge(flight.records, script, case.vehicle, law=law))

    return lambda cases: [fly(case) for case in cases]


def _fly_alone(campaign: Campaign, controller: Controller, case: Case) -> Flight:
    """Return the flight of a case; the maker of an entry gets the nominal vehicle."""
    script, nominal = case.apply_to(campaign.scenario), campaign.vehicles.nominal
    return fly_controller(script, controller, vehicle=case.vehicle, seed=case.seed, nominal=nominal)


def _fly_external(scenario: Scenario, autopilot: ExternalAutopilot, case: Case) -> CaseResult:
    """Return the result of a case; an instance that died or hung is replaced once, as the machine may be to blame."""
    for is_last in (False, True):
        flight = fly_controller(case.apply_to(scenario), autopilot, vehicle=case.vehicle, seed=case.seed)
        if flight.outcome is FlightOutcome.DONE and flight.metrics is not None:
            return CaseResult(metrics=flight.metrics, requirements=flight.requirements)
        if is_last or flight.outcome not in _LOST:
            break
    raise ValueError(flight.message + (", for the second time" if is_last else ""))


def _check_diverged(campaign: Campaign, law: AnyController, case: Case, judged: CaseResult | str) -> CaseResult | str:
    """Return the result, or the time of divergence if the flight diverged."""
    if isinstance(judged, str) or all(map(math.isfinite, _get_figures(judged.metrics))):
        return judged
    if campaign.scenario.has_link_script or isinstance(law, ExternalAutopilot):
        return "diverged"
    flight = _fly_alone(campaign, law, case)
    if flight.outcome in ENTRY_FAILURES:
        return flight.message
    records = flight.records
    numbers = np.column_stack([records["q_NB"], records["omega_B"], records["torque_command_B"]])
    lost = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
    return f"diverged at {records['time_us'][lost[0]] * 1e-6:g} s" if len(lost) else "diverged"


def requirement_columns(requirements: Sequence[Requirement]) -> list[str]:
    """Return a short unique name for each requirement."""
    return [
        "_".join(filter(None, ("require", str(number), required.metric.value, required.axis)))
        for number, required in enumerate(requirements)
    ]


def delta_column(spread: str) -> str:
    """Return the column name of a spread's normalised delta."""
    return f"delta_{spread.replace('.', '_')}"


def schema(campaign: Campaign) -> Any:
    """Return the table's columns as a `pyarrow.Schema`; the metadata of a column of numbers hold its `unit`."""
    script = campaign.scenario.require
    identity = [("run", pa.int64()), ("case", pa.int64()), ("law", pa.string()), ("seed", pa.int64())]
    deltas = [_number_field(delta_column(name), "-") for name in campaign.spreads]
    figures = [*(_number_field(name, FIGURE_UNITS[name]) for name in FIGURES), ("rho_in_bounds", pa.bool_())]
    results = chain.from_iterable(
        (_number_field(name, requirement_unit(required)), (f"{name}_held", pa.bool_()))
        for name, required in zip(requirement_columns(script), script, strict=True)
    )
    return pa.schema([*identity, *deltas, *figures, *results, ("held", pa.bool_()), ("failure", pa.string())])


def _number_field(name: str, unit: str) -> Any:
    return pa.field(name, pa.float64(), metadata={"unit": unit})


def failed_rows(campaign: Campaign, chunk: Chunk, failure: str) -> Any:
    """Return the rows of runs without results, with the reason of the failure."""
    first, runs = chunk.first % campaign.cases, chunk.runs
    rows = [_make_row(campaign.scenario, failure)] * runs
    return _make_table(campaign, chunk, campaign.draw_deltas(first, runs), campaign.flight_seeds(first, runs), rows)


def _make_row(scenario: Scenario, judged: CaseResult | str) -> Row:
    """Return a run's row, from the figures' columns of `schema` on."""
    if isinstance(judged, str):
        return (*[None] * (len(FIGURES) + 1), *[None, False] * len(scenario.require), False, judged)
    required = [(None if math.isnan(each.value) else each.value, each.is_met) for each in judged.requirements]
    figures = (*_get_figures(judged.metrics), judged.metrics.rho_in_bounds)
    return (*figures, *chain.from_iterable(required), all(held for _, held in required), None)


def _make_table(campaign: Campaign, chunk: Chunk, delta: Array, seeds: Sequence[int], rows: Sequence[Row]) -> Any:
    first, case = chunk.first, chunk.first % campaign.cases
    runs, cases = range(first, first + chunk.runs), range(case, case + chunk.runs)
    laws = [campaign.law_of(first).name] * chunk.runs
    arrays: list[Any] = [runs, cases, laws, seeds, *delta.T, *zip(*rows, strict=True)]
    kinds = schema(campaign)
    return pa.Table.from_arrays([pa.array(a, kind.type) for a, kind in zip(arrays, kinds, strict=True)], schema=kinds)
