"""The found limit in the real autopilot: the same winds and seeds, its own loops in place of their model."""

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.errors import FlightError
from gustproof.flight.routes.batch import Case, CaseResult, fly_many
from gustproof.flight.routes.external import ExternalAutopilot, ExternalPlan, fly_external
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.law.form import Law
from gustproof.studies.wind_limit.kept import Kept, shares


class RealFlight(NamedTuple):
    """Largest figure over its limit in one wind and seed."""

    wind: str
    """Wind in words."""
    seed: int
    """Seed of gusts and noise."""
    real: float
    """[-] in the real autopilot."""
    model: float
    """[-] with the law that stands for its loops."""


def fly_real(
    winds: Sequence[Scenario],
    vehicle: Vehicle,
    autopilot: ExternalAutopilot,
    law: Law,
    kept: Sequence[Kept],
    seeds: Sequence[int],
    progress: Callable[[str], None] = lambda _text: None,
) -> list[RealFlight]:
    """Fly winds with each seed in a real autopilot, and with the law that stands for its loops.

    Raises
    ------
    ConfigError
        If the autopilot can't be started as requested.
    FlightError
        If a flight breaks off.
    """
    found = list[RealFlight]()
    for wind in winds:
        models = fly_many(wind, law, [Case(vehicle=vehicle, seed=seed) for seed in seeds])
        for seed, model in zip(seeds, models, strict=True):
            progress(f"{autopilot.name}: {wind.description}, seed {seed}")
            with TemporaryDirectory() as folder:
                flight = fly_external(ExternalPlan(wind, autopilot, vehicle, seed, real_time=False), Path(folder))
            if flight.outcome is FlightOutcome.INTERRUPTED:
                raise KeyboardInterrupt  # taken by the flight
            if flight.outcome is not FlightOutcome.DONE or flight.metrics is None:
                raise FlightError(flight.message)
            real = CaseResult(metrics=flight.metrics, requirements=flight.requirements)
            found.append(RealFlight(wind.description, seed, max(shares(kept, real)), max(shares(kept, model))))
    return found
