from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from gustproof.flight.routes import recorder
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.flight import Flight, FlightPlan
from gustproof.flight.routes.processes import fly_plan
from gustproof.law.form import Law


def _fly_any(fly_here: Callable[..., Flight], plan: FlightPlan, out: Path, **_: Any) -> Flight:
    """Fly in this process what two processes fly to the same bits; a script of modes and kills needs both."""
    scenario, controller, vehicle, seed = plan[:4]
    if scenario.needs_messages:
        return fly_plan(plan, out)
    if isinstance(controller, Law):
        return fly_here(plan, out)
    flown = fly_controller(scenario, controller, vehicle=vehicle, seed=seed)
    return fly_here(plan, out, flown.records, flown.outcome)


@pytest.fixture(scope="module")
def _flown_here(fly_here: Callable[..., Flight]) -> Any:
    """Let commands fly in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder, "fly_plan", partial(_fly_any, fly_here))
        yield
