from typing import Any

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.errors import FlightError
from gustproof.flight.routes.external import ExternalAutopilot
from gustproof.studies.campaign import comparison


def test_external_autopilots_are_compared_without_waiting_for_a_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    plans = list[Any]()

    def fly(plan: Any, _: object) -> None:
        plans.append(plan)
        raise FlightError("enough")

    monkeypatch.setattr(comparison, "fly_external", fly)
    autopilot = ExternalAutopilot(kind="px4")
    with pytest.raises(FlightError, match="enough"):
        comparison._fly(load_scenario("calm"), load_vehicle("paper"), autopilot, 3)
    assert [(plan.seed, plan.real_time) for plan in plans] == [(3, False)]
