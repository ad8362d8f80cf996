"""Many flights of one scenario: vehicles, seeds, gusts and initial attitudes differ, and each is judged as it flies."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from firmware_model.scenario import Scenario
from firmware_model.signals import Vector
from firmware_model.vehicle import Vehicle
from gustproof.closed_loop import fly_direct
from gustproof.law import Law
from gustproof.metrics import Metrics, measure
from gustproof.requirements import RequirementResult, judge


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

    Raises
    ------
    ValueError
        As `fly_direct`.
    """
    return [_flown(case.of(scenario), law, case) for case in cases]


def _flown(scenario: Scenario, law: Law, case: Case) -> Judged:
    records = fly_direct(scenario, law, vehicle=case.vehicle, seed=case.seed)
    return Judged(
        metrics=measure(records, case.vehicle, scenario, 0.0), requirements=judge(records, scenario, case.vehicle)
    )
