"""Many flights of one scenario with other vehicles, seeds, gusts and initial attitudes, each judged as it flies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import NamedTuple

import numpy as np
from pydantic import SkipValidation
from pydantic.dataclasses import dataclass as checked_dataclass

from firmware_model.autopilot.parameters import published_hover, published_limit
from firmware_model.config.fields import NonNegative
from firmware_model.config.scenario import Angle, NoiseRotation, Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.numerics.compiled import find_cache
from firmware_model.numerics.soa import aligned_zeros
from firmware_model.physics.disturbances import make_replay, make_waves
from firmware_model.sim import inner_loop
from firmware_model.sim.state import Array, CommonStart, common_start, noise_rows
from firmware_model.types import Vector
from gustproof.flight.controllers.library import Library, load_library
from gustproof.flight.controllers.user_controller import UserController
from gustproof.flight.routes.direct import check_compatible
from gustproof.flight.routes.kernels import LANES, Batch, BatchSetup, allocate_batch, fly_free, fly_on_stand
from gustproof.flight.scoring.metrics import Metrics, Tally, command_limit, metrics_from_tally
from gustproof.flight.scoring.requirements import (
    RequirementResult,
    initial_readings,
    reads_share,
    results_from_readings,
    rules,
)
from gustproof.law.form import Law, Output
from gustproof.law.references import references
from gustproof.law.step import SparseLaw, no_law, sparse_law


@checked_dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """Variation of a flight within a scenario.

    Examples
    --------
    >>> from gustproof import Case, load_vehicle
    >>> calm = Case(vehicle=load_vehicle("paper"), seed=7, gust_scale=0.5)
    >>> calm.gust_scale
    0.5
    """

    vehicle: SkipValidation[Vehicle]
    """Vehicle."""
    seed: int
    """Seed of gusts and noise."""
    gust_scale: NonNegative = 1.0
    """[-] factor on the scenario's gusts."""
    initial_attitude_deg: tuple[Angle, Angle, Angle] | None = None
    """[deg] initial roll, pitch, yaw; the scenario's by default."""
    turns: tuple[NoiseRotation, ...] = ()
    """Turns of gusts and noise, after those of the scenario."""

    def apply_to(self, scenario: Scenario) -> Scenario:
        """Return the scenario with this variation."""
        begins = scenario.initial_attitude_deg if self.initial_attitude_deg is None else self.initial_attitude_deg
        scale, turns = self.gust_scale * scenario.gust_scale, (*scenario.turn, *self.turns)
        return replace(scenario, gust_scale=scale, initial_attitude_deg=begins, turn=turns)


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseResult:
    """Result of one case."""

    metrics: Metrics
    """Figures."""
    requirements: tuple[RequirementResult, ...]
    """Result of each requirement of the scenario."""


def fly_many(scenario: Scenario, law: Law | UserController, cases: Sequence[Case]) -> list[CaseResult]:
    """Fly a scenario once for each of `cases`, without messages, and return their results.

    A user's controller must be a C library in double precision; others fly one by one, see `fly_controller`.

    Figures and readings equal those of the flights' records to the bit, however flights are batched. It raises what
    `fly_direct` raises.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from gustproof import Case, fly_many, load_law, load_scenario, load_vehicle
    >>> scenario = replace(load_scenario("paper-turbulence"), duration_s=1.0)
    >>> cases = [Case(vehicle=load_vehicle("paper"), seed=seed) for seed in range(100)]
    >>> len(fly_many(scenario, load_law("hinf-d1"), cases))
    100
    """
    return make_batch_simulator(scenario, law)(cases)


def is_cold(scenario: Scenario) -> bool:
    """Return whether the flights of a scenario still have to be compiled, once after an installation."""
    found = find_cache(_find_kernel(scenario))
    return found is not None and not found.warm


def _find_kernel(scenario: Scenario) -> Callable[[BatchSetup, Batch], None]:
    return fly_free if scenario.free else fly_on_stand


def make_batch_simulator(
    scenario: Scenario, controller: Law | UserController
) -> Callable[[Sequence[Case]], list[CaseResult]]:
    """Return a function that flies cases as `fly_many` does, with their common data made once."""
    law, terms, step = _find_step(controller)

    def fly(cases: Sequence[Case]) -> list[CaseResult]:
        # a batch has one count of rotors, and draws as many numbers for each flight as for that of most turns
        order = sorted(range(len(cases)), key=lambda i: (cases[i].vehicle.rotors.count, len(cases[i].turns)))
        results: dict[int, CaseResult] = {}
        known: dict[tuple[int, float], _Common] = {}  # while `cases` keep their vehicles alive: it tells them by id
        for _, group in groupby(order, key=lambda i: cases[i].vehicle.rotors.count):
            numbers = list(group)
            for part in (numbers[i : i + LANES] for i in range(0, len(numbers), LANES)):
                results |= zip(part, _fly_batch(scenario, law, shared, [cases[i] for i in part], known), strict=True)
        return [results[i] for i in range(len(cases))]

    check_compatible(scenario, law)
    torque = law.output is Output.TORQUE
    shared = BatchSetup(
        sample_us=scenario.sample_us, dt=scenario.dt, waves=make_waves(scenario), replay=make_replay(scenario),
        reference=references(scenario), rules=rules(scenario), reads_share=reads_share(scenario),
        law=terms, step=step,
        kind=inner_loop.TORQUE if torque else inner_loop.RATES, bound=1.0 if torque else np.inf,
    )  # fmt: skip
    return fly


def _find_step(controller: Law | UserController) -> tuple[Law | Library, SparseLaw, int]:
    """Return a law and its terms, or the library of a user's controller; address of its step."""
    if isinstance(controller, Law):
        return controller, _without_padding(sparse_law(controller)), 0
    library = load_library(controller)
    if library.is_single:
        raise ValueError(f"law '{library.name}' is in single precision, must be called from Python")
    return library, no_law(), library.step


def _without_padding(law: SparseLaw) -> SparseLaw:
    """Return the terms without zeros, which change no sum: here sums of any length are fast."""
    counts = law.terms[:, 1] != 0.0
    return law._replace(ends=np.append(0, np.cumsum(counts))[law.ends], terms=law.terms[counts])


class _Common(NamedTuple):
    """Common data of the cases of one vehicle and gust scale."""

    start: CommonStart
    """Before seeds and attitudes."""
    limit: Vector
    """[N*m] B, published limit of the torque."""
    hover: float
    """[-] published hover thrust."""
    saturated: Array
    """(3,) [N*m] torque at its limit, see `command_limit`."""


def _fly_batch(
    scenario: Scenario,
    law: Law | Library,
    shared: BatchSetup,
    cases: Sequence[Case],
    known: dict[tuple[int, float], _Common],
) -> list[CaseResult]:
    """Fly up to `LANES` cases; empty lanes repeat the last. `known` is filled, see `_find_common`."""
    filled = [*cases, *[cases[-1]] * (LANES - len(cases))]
    mixes = _make_mixes(scenario, filled)
    common = [_find_common(scenario, law, case, known) for case in filled]
    states = [
        each.start.draw(mix, case.initial_attitude_deg) for each, mix, case in zip(common, mixes, filled, strict=True)
    ]
    mix, torque = np.moveaxis(mixes, 0, 2), law.output is Output.TORQUE
    batch = Batch(
        params=_stack_lanes([each.start.params for each in common]), state=_stack_lanes(states),
        changes=_merge_changes([each.start.changes for each in common]),
        seeds=np.ascontiguousarray(mix[:, 0], dtype=np.int64), mix=np.ascontiguousarray(mix[:, 1:]),
        scale=_stack_lanes([each.limit for each in common]) if torque else np.ones(3 * LANES),
        thrust=np.array([np.nan if torque else each.hover for each in common]),
        torque_limit=_stack_lanes([each.saturated for each in common]),
        readings=initial_readings(scenario, LANES), **allocate_batch(law, shared.law, scenario.delay_samples, len(mix)),
    )  # fmt: skip
    fly = _find_kernel(scenario)
    fly(shared, batch)
    samples, dt = scenario.samples, scenario.dt
    return [
        CaseResult(metrics=metrics_from_tally(Tally._make(tally), samples, dt, 0.0), requirements=requirements)
        for _, tally, requirements in zip(
            cases, batch.tallies.T.tolist(), results_from_readings(scenario, batch.readings, samples), strict=False
        )
    ]


def _make_mixes(scenario: Scenario, cases: Sequence[Case]) -> Array:
    """Return the seeds and factors (cases, n, 3) of `mixed_normals`, as many rows for each as the most turned needs.

    Rows past those that a case needs change no noise.
    """
    mixes = [noise_rows(case.seed, (*scenario.turn, *case.turns)) for case in cases]
    width = max(map(len, mixes))
    return np.array([[*rows, *[(0.0, 1.0, 0.0)] * (width - len(rows))] for rows in mixes])


def _find_common(
    scenario: Scenario, law: Law | Library, case: Case, known: dict[tuple[int, float], _Common]
) -> _Common:
    """Return what a case has in common with those of its vehicle and gust scale, from `known` or added to it."""
    kind = id(case.vehicle), case.gust_scale
    if kind not in known:
        start = common_start(case.vehicle, scenario, gust_scale=case.gust_scale * scenario.gust_scale)
        published = published_limit(case.vehicle), published_hover(case.vehicle)
        known[kind] = _Common(start, *published, command_limit(case.vehicle, law))
    return known[kind]


def _stack_lanes(rows: Sequence[Sequence[float] | Array]) -> Array:
    """Return the numbers of all flights as a flat array with a column for each flight."""
    block = aligned_zeros(len(rows) * len(rows[0]))
    block.reshape(-1, len(rows))[:] = np.array(rows).T
    return block


def _merge_changes(changes: Sequence[Array]) -> Array:
    """Return the scripted changes of all flights in order of time: sample, offset among all constants, value."""
    rows = [
        (sample, offset * LANES + lane, value)
        for lane, rows_of_lane in enumerate(changes)
        for sample, offset, value in rows_of_lane.tolist()
    ]
    return np.array(sorted(rows, key=lambda row: row[0])).reshape(-1, 3)
