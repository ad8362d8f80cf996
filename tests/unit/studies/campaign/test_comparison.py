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


def test_progress_tells_who_flies_and_stops_with_the_last_that_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """A copy is alike after some seeds; a fifth worse is known sooner."""

    def fly(_: object, __: object, controller: float, seed: int) -> comparison._Flown:
        return comparison._Flown(controller * (1.0 + 1e-4 * seed), 1.0, None, 1.0, None, failed=False)

    monkeypatch.setattr(comparison, "_fly", fly)
    monkeypatch.setattr(comparison, "_measure_point", lambda *_: None)
    told, seeds = list[tuple[float, str]](), range(1, 41)
    controllers: Any = {"one": 1.0, "copy": 1.0, "worse": 1.2}
    rows = comparison.compare(
        [load_scenario("calm")], load_vehicle("paper"), controllers, seeds, lambda *each: told.append(each)
    )
    flights = [sum(name == text.split(",")[0] for _, text in told) for name in controllers]
    assert flights == [row.seeds for row in rows]
    assert flights[0] == max(flights[1:]) < 40
    assert told[:3] == [
        (0.0, "one, seed 1"),
        (pytest.approx(1 / 120), "copy, seed 1"),
        (pytest.approx(2 / 120), "worse, seed 1"),
    ]
