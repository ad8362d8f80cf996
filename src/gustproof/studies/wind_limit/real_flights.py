"""The found limit in the real autopilot: the same winds and seeds, its own loops in place of their model."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.routes.batch import Case, CaseResult, fly_many
from gustproof.flight.routes.controllers import fly_to_end
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
            flight, figures = fly_to_end(wind, autopilot, vehicle, seed)
            real = CaseResult(metrics=figures, requirements=flight.requirements)
            found.append(RealFlight(wind.description, seed, max(shares(kept, real)), max(shares(kept, model))))
    return found
