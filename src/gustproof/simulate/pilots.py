"""Fly any pilot in this process and name the end of its flight."""

from dataclasses import dataclass

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.entries.entry import Pilot
from gustproof.law.form import Law
from gustproof.simulate.direct import fly_direct
from gustproof.simulate.loopback import fly_loopback
from gustproof.simulate.outcome import FlightOutcome, describe, infer_outcome
from gustproof.types import Records


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PilotFlight:
    """Records and end of a pilot's flight."""

    records: Records
    """(n,) journal records; fewer than the scenario has samples if the flight broke off."""
    outcome: FlightOutcome
    """End of the flight."""
    message: str
    """Outcome in one line, for people."""


def fly_pilot(scenario: Scenario, pilot: Pilot, *, vehicle: Vehicle, seed: int = 1) -> PilotFlight:
    """Fly a scenario with a law or an entry and return what was flown, whatever its end."""
    if not isinstance(pilot, Law):
        raise NotImplementedError
    route = fly_loopback if scenario.has_link_script else fly_direct
    records = route(scenario, pilot, vehicle=vehicle, seed=seed)
    outcome = infer_outcome(records, scenario)
    return PilotFlight(records=records, outcome=outcome, message=describe(outcome, scenario, records))
