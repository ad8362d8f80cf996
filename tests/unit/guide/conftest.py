from pathlib import Path
from typing import Any

import pytest

from gustproof.flight.routes import recorder
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.flight import Flight, FlightPlan
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.processes import fly_plan
from gustproof.law.form import Law


def _fly_here(plan: FlightPlan, out: Path, **_: Any) -> Flight:
    """Fly in this process what two processes fly to the same bits; a script of modes and kills needs both."""
    scenario, controller, vehicle, seed = plan[:4]
    if scenario.needs_messages:
        return fly_plan(plan, out)
    if isinstance(controller, Law):
        records, outcome = fly_direct(scenario, controller, vehicle=vehicle, seed=seed), FlightOutcome.DONE
    else:
        flown = fly_controller(scenario, controller, vehicle=vehicle, seed=seed)
        records, outcome = flown.records, flown.outcome
    journal = out / f"{plan.name}.journal"
    journal.touch()
    return Flight(
        scenario=scenario, controller=controller, vehicle=vehicle, seed=seed, records=records, outcome=outcome,
        message="flown", realtime_factor=1.0, journal=journal,
    )  # fmt: skip


@pytest.fixture(scope="module")
def _flown_here() -> Any:
    """Let commands fly in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder, "fly_plan", _fly_here)
        yield
