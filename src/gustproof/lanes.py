"""Many flights of one scenario: vehicles, seeds, gusts and initial attitudes differ, and each is judged as it flies."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from firmware_model import commands
from firmware_model.params import published_hover, published_limit
from firmware_model.rows import aligned
from firmware_model.scenario import Scenario
from firmware_model.signals import Vector
from firmware_model.vehicle import Vehicle
from firmware_model.world import Array, World, new_world
from gustproof.batch import LANES, fly_free, fly_held
from gustproof.closed_loop import check, references
from gustproof.law import Law, Output
from gustproof.law_step import sums
from gustproof.metrics import TALLY, Metrics, Tally, figures
from gustproof.requirements import RequirementResult, judged, no_readings, rules


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What makes a flight of a scenario differ from the others."""

    vehicle: Vehicle
    """Vehicle."""
    seed: int
    """Seed of gusts and noise."""
    gust_scale: float = 1.0
    """[-] the scenario's gusts times this."""
    initial_attitude_deg: Vector | None = None
    """[deg] roll, pitch, yaw in which the flight begins; the scenario's by default."""

    def of(self, scenario: Scenario) -> Scenario:
        """Return the scenario that this flight flies."""
        begins = scenario.initial_attitude_deg if self.initial_attitude_deg is None else self.initial_attitude_deg
        return replace(scenario, gust_scale=self.gust_scale * scenario.gust_scale, initial_attitude_deg=begins)


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
    check(scenario, law)
    return [flown for i in range(0, len(cases), LANES) for flown in _fly_batch(scenario, law, cases[i : i + LANES])]


def _fly_batch(scenario: Scenario, law: Law, cases: Sequence[Case]) -> list[Judged]:
    """Fly up to `LANES` cases; empty lanes repeat the last."""
    filled = [*cases, *[cases[-1]] * (LANES - len(cases))]
    worlds = [new_world(case.vehicle, case.of(scenario), case.seed) for case in filled]
    torque = law.output is Output.TORQUE
    limit = _side_by_side([case.vehicle.torque_limit for case in filled])
    tallies, readings = aligned(TALLY * LANES), no_readings(scenario, LANES)
    fly = fly_free if scenario.free else fly_held
    fly(
        _side_by_side([world.params for world in worlds]), _side_by_side([world.state for world in worlds]),
        worlds[0].waves, worlds[0].replay, _changes(worlds), np.array([case.seed for case in filled]),
        scenario.sample_us, scenario.dt, sums(law), law.feels_force, references(scenario),
        _side_by_side([published_limit(case.vehicle) for case in filled]) if torque else np.ones(3 * LANES),
        commands.TORQUE if torque else commands.RATES, 1.0 if torque else np.inf,
        np.array([np.nan if torque else published_hover(case.vehicle) for case in filled]),
        scenario.delay_samples, limit, rules(scenario), tallies, readings,
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


def _changes(worlds: Sequence[World]) -> Array:
    """Return what events change in all flights, in order of time: sample, place among all constants, value."""
    rows = [
        (sample, place * LANES + lane, value)
        for lane, world in enumerate(worlds)
        for sample, place, value in world.changes.tolist()
    ]
    return np.array(sorted(rows, key=lambda row: row[0])).reshape(-1, 3)
