from pathlib import Path
from typing import Any

import pytest

from gustproof.law.form import Law
from gustproof.simulate import recorder
from gustproof.simulate.direct import fly_direct
from gustproof.simulate.flight import Flight, FlightPlan, by_kind
from gustproof.simulate.outcome import FlightOutcome
from gustproof.simulate.pilots import fly_pilot
from gustproof.simulate.processes import fly_plan


def _fly_here(plan: FlightPlan, out: Path, **_: Any) -> Flight:
    """Fly in this process what two processes fly to the same bits; a script of link events needs both."""
    scenario, pilot, vehicle, seed = plan[:4]
    if scenario.has_link_script:
        return fly_plan(plan, out)
    if isinstance(pilot, Law):
        records, outcome = fly_direct(scenario, pilot, vehicle=vehicle, seed=seed), FlightOutcome.DONE
    else:
        flown = fly_pilot(scenario, pilot, vehicle=vehicle, seed=seed)
        records, outcome = flown.records, flown.outcome
    journal = out / f"{plan.name}.journal"
    journal.touch()
    return Flight(
        scenario=scenario, **by_kind(pilot), vehicle=vehicle, seed=seed, records=records, outcome=outcome,
        message="flown", realtime_factor=1.0, journal=journal,
    )  # fmt: skip


@pytest.fixture(scope="module")
def _flown_here() -> Any:
    """Let commands fly in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder, "fly_plan", _fly_here)
        yield
