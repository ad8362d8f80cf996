"""Many flights of one scenario: vehicles, seeds, gusts and initial attitudes differ, and each is judged as it flies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from pydantic import SkipValidation
from pydantic.dataclasses import dataclass as checked_dataclass

from firmware_model.autopilot.parameters import published_hover, published_limit
from firmware_model.config.scenario import Angle, Scenario
from firmware_model.config.vehicle import NonNegative, Vehicle
from firmware_model.numerics.soa import aligned
from firmware_model.physics.disturbances import replayed, waves
from firmware_model.sim import inner_loop
from firmware_model.sim.state import Array, VehicleInitial, vehicle_initial
from gustproof.law.form import Law, Output
from gustproof.law.references import references
from gustproof.law.step import sparse_law
from gustproof.scoring.metrics import Metrics, Tally, figures
from gustproof.scoring.requirements import RequirementResult, judged, no_readings, rules
from gustproof.simulate.direct import check
from gustproof.simulate.kernels import LANES, Batch, Shared, fly_free, fly_held, room


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

    def start(self, scenario: Scenario) -> VehicleInitial:
        """Return what `new_world` begins with in the scenario `of` this flight, which takes long to be made."""
        scale = self.gust_scale * scenario.gust_scale
        return vehicle_initial(
            self.vehicle, scenario, self.seed, gust_scale=scale, attitude_deg=self.initial_attitude_deg
        )


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
    return make_batch_simulator(scenario, law)(cases)


def make_batch_simulator(scenario: Scenario, law: Law) -> Callable[[Sequence[Case]], list[Judged]]:
    """Return what flies any number of cases as `fly_many` does, however often; what they share has been made.

    Raises
    ------
    ValueError
        As `fly_direct`.
    """
    check(scenario, law)
    torque = law.output is Output.TORQUE
    shared = Shared(
        sample_us=scenario.sample_us, dt=scenario.dt, waves=waves(scenario), replay=replayed(scenario),
        reference=references(scenario), rules=rules(scenario), law=sparse_law(law),
        kind=inner_loop.TORQUE if torque else inner_loop.RATES, bound=1.0 if torque else np.inf,
    )  # fmt: skip
    return partial(_fly_batches, scenario, law, shared)


def _fly_batches(scenario: Scenario, law: Law, shared: Shared, cases: Sequence[Case]) -> list[Judged]:
    parts = [cases[i : i + LANES] for i in range(0, len(cases), LANES)]
    return [flown for part in parts for flown in _fly_batch(scenario, law, shared, part)]


def _fly_batch(scenario: Scenario, law: Law, shared: Shared, cases: Sequence[Case]) -> list[Judged]:
    """Fly up to `LANES` cases; empty lanes repeat the last."""
    filled = [*cases, *[cases[-1]] * (LANES - len(cases))]
    params, states, changes = zip(*(case.start(scenario) for case in filled), strict=True)
    vehicles, torque = [case.vehicle for case in filled], law.output is Output.TORQUE
    batch = Batch(
        params=_side_by_side(params), state=_side_by_side(states), changes=_in_order(changes),
        seeds=np.array([case.seed for case in filled]),
        scale=_side_by_side([published_limit(each) for each in vehicles]) if torque else np.ones(3 * LANES),
        thrust=np.array([np.nan if torque else published_hover(each) for each in vehicles]),
        torque_limit=_side_by_side([each.torque_limit for each in vehicles]),
        readings=no_readings(scenario, LANES), **room(law, scenario.delay_samples),
    )  # fmt: skip
    fly = fly_free if scenario.free else fly_held
    fly(shared, batch)
    columns = batch.tallies.T.tolist()
    return [
        Judged(
            metrics=figures(Tally._make(columns[w]), scenario.samples, scenario.dt, 0.0),
            requirements=judged(scenario, batch.readings[:, :, w], scenario.samples),
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
