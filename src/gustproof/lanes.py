"""Many flights of one scenario: vehicles, seeds, gusts and initial attitudes differ, and each is judged as it flies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from pydantic import SkipValidation
from pydantic.dataclasses import dataclass as checked_dataclass

from firmware_model import commands
from firmware_model.disturbances import replayed, waves
from firmware_model.params import published_hover, published_limit
from firmware_model.rows import aligned
from firmware_model.scenario import Angle, Scenario
from firmware_model.vehicle import NonNegative, Vehicle
from firmware_model.world import Array, Start, start
from gustproof.batch import LANES, fly_free, fly_held
from gustproof.closed_loop import check, references
from gustproof.law import Law, Output
from gustproof.law_step import Sums, sums
from gustproof.metrics import TALLY, Metrics, Tally, figures
from gustproof.requirements import RequirementResult, judged, no_readings, rules


@checked_dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What makes a flight of a scenario differ from the others."""

    vehicle: SkipValidation[Vehicle]
    """Vehicle."""
    seed: int
    """Seed of gusts and noise."""
    gust_scale: NonNegative = 1.0
    """[-] the scenario's gusts times this."""
    initial_attitude_deg: tuple[Angle, Angle, Angle] | None = None
    """[deg] roll, pitch, yaw in which the flight begins; the scenario's by default."""

    def of(self, scenario: Scenario) -> Scenario:
        """Return the scenario that this flight flies."""
        begins = scenario.initial_attitude_deg if self.initial_attitude_deg is None else self.initial_attitude_deg
        return replace(scenario, gust_scale=self.gust_scale * scenario.gust_scale, initial_attitude_deg=begins)

    def start(self, scenario: Scenario) -> Start:
        """Return what `new_world` begins with in the scenario `of` this flight, which takes long to be made."""
        scale = self.gust_scale * scenario.gust_scale
        return start(self.vehicle, scenario, self.seed, gust_scale=scale, attitude_deg=self.initial_attitude_deg)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """What is kept of a flight."""

    metrics: Metrics
    """Figures."""
    requirements: tuple[RequirementResult, ...]
    """What became of each requirement of the scenario."""


def fly_many(scenario: Scenario, law: Law, cases: Sequence[Case]) -> list[Judged]:
    """Fly a scenario once for each of `cases`, without messages, and return what became of each.

    Figures and readings are those of the flights' records to the bit, in whatever batches they are flown.

    Raises
    ------
    ValueError
        As `fly_direct`.
    """
    return flier(scenario, law)(cases)


def flier(scenario: Scenario, law: Law) -> Callable[[Sequence[Case]], list[Judged]]:
    """Return what flies any number of cases as `fly_many` does, however often; what they share has been made.

    Raises
    ------
    ValueError
        As `fly_direct`.
    """
    check(scenario, law)
    tables = waves(scenario), replayed(scenario), references(scenario), rules(scenario)
    return partial(_fly_batches, _Shared(scenario, law, sums(law), *tables))


class _Shared(NamedTuple):
    """What all flights of a scenario and a law have in common; units where it is made."""

    scenario: Scenario
    law: Law
    sums: Sums
    waves: Array
    replay: Array
    reference: Array
    rules: Array


def _fly_batches(shared: _Shared, cases: Sequence[Case]) -> list[Judged]:
    return [flown for i in range(0, len(cases), LANES) for flown in _fly_batch(shared, cases[i : i + LANES])]


def _fly_batch(shared: _Shared, cases: Sequence[Case]) -> list[Judged]:
    """Fly up to `LANES` cases; empty lanes repeat the last."""
    scenario, law = shared.scenario, shared.law
    filled = [*cases, *[cases[-1]] * (LANES - len(cases))]
    params, states, changes = zip(*(case.start(scenario) for case in filled), strict=True)
    torque = law.output is Output.TORQUE
    limit = _side_by_side([case.vehicle.torque_limit for case in filled])
    tallies, readings = aligned(TALLY * LANES), no_readings(scenario, LANES)
    fly = fly_free if scenario.free else fly_held
    fly(
        _side_by_side(params), _side_by_side(states), shared.waves, shared.replay, _in_order(changes),
        np.array([case.seed for case in filled]),
        scenario.sample_us, scenario.dt, shared.sums, law.feels_force, shared.reference,
        _side_by_side([published_limit(case.vehicle) for case in filled]) if torque else np.ones(3 * LANES),
        commands.TORQUE if torque else commands.RATES, 1.0 if torque else np.inf,
        np.array([np.nan if torque else published_hover(case.vehicle) for case in filled]),
        scenario.delay_samples, limit, shared.rules, tallies, readings,
    )  # fmt: skip
    columns = tallies.reshape(TALLY, LANES).T.tolist()
    return [
        Judged(
            metrics=figures(Tally._make(columns[w]), scenario.samples, scenario.dt, 0.0),
            requirements=judged(scenario, readings[:, :, w], scenario.samples),
        )
        for w in range(len(cases))
    ]


def _side_by_side(rows: Sequence[Sequence[float] | Array]) -> Array:
    """Return the numbers of all flights, flat, each flight a column."""
    block = aligned(len(rows) * len(rows[0]))
    np.stack(rows, axis=1, out=block.reshape(-1, len(rows)))
    return block


def _in_order(changes: Sequence[Array]) -> Array:
    """Return what events change in all flights, in order of time: sample, place among all constants, value."""
    rows = [
        (sample, place * LANES + lane, value)
        for lane, turns in enumerate(changes)
        for sample, place, value in turns.tolist()
    ]
    return np.array(sorted(rows, key=lambda row: row[0])).reshape(-1, 3)
