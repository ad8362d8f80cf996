import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.errors import FlightError
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.scoring.phases import PhaseFigures
from gustproof.studies.campaign import comparison


def test_external_autopilots_are_compared_without_waiting_for_a_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    plans = list[Any]()

    def fly(plan: Any, _: object) -> None:
        plans.append(plan)
        raise FlightError("enough")

    monkeypatch.setattr("gustproof.flight.routes.controllers.fly_external", fly)
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


@pytest.mark.parametrize(
    ("error", "outcome", "tilt_s", "failed"),
    [
        (59.9, FlightOutcome.DONE, None, False),
        (60.0, FlightOutcome.DONE, None, True),
        (math.nan, FlightOutcome.DONE, None, True),
        (1.0, FlightOutcome.DIVERGED, None, True),
        (1.0, FlightOutcome.DONE, 0.0, True),
    ],
)
def test_a_flight_that_fell_or_erred_by_60_degrees_failed_and_counts_as_60(
    monkeypatch: pytest.MonkeyPatch, error: float, outcome: FlightOutcome, tilt_s: float | None, failed: bool
) -> None:
    monkeypatch.setattr(comparison, "_steady_error", lambda *_: error)
    monkeypatch.setattr(comparison, "first_tilt_s", lambda _: tilt_s)
    flight: Any = SimpleNamespace(records=[], scenario=None, outcome=outcome)
    for rmse, told in ((59.0, 59.0), (61.0, 60.0), (math.nan, 60.0)):
        figures: Any = SimpleNamespace(rmse_deg=rmse, torque_slew_rms=3.0, realtime_factor=0.0)
        view: Any = SimpleNamespace(control_rmse_deg=2.0)
        expected = (60.0 if failed else error, told, 2.0, 3.0, None, failed, ())
        assert comparison._read_flight(flight, figures, view) == expected
        figures.realtime_factor = 5.0
        assert comparison._read_flight(flight, figures, None)[2:5] == (None, 3.0, 5.0)


def test_a_row_has_medians_over_seeds_of_geometric_means_over_scenarios() -> None:
    def flown(*errors: float, factor: float | None = None, failed: bool = False) -> list[comparison._Flown]:
        return [comparison._Flown(each, 2.0 * each, factor, 3.0 * each, factor, failed) for each in errors]

    first = [flown(1.0, 4.0), flown(4.0, 9.0), flown(2.0, 2.0)]
    mine = [flown(2.0, 8.0, factor=7.0), flown(1.0, 9.0, factor=5.0, failed=True)]
    point: Any = SimpleNamespace(Ms=1.5, delay_margin=math.inf)
    calm = load_scenario("calm")
    both = [calm, replace(calm, name="windy")]
    row = comparison._make_row("mine", mine, first, both, point)
    assert (row.steady_rmse_deg, row.rmse_deg, row.torque_slew_rms) == pytest.approx((3.5, 7.0, 10.5))
    assert (row.own_rmse_deg, row.realtime_factor, row.seeds, row.failed) == (6.0, 6.0, 2, 2)
    assert (row.Ms, row.delay_margin_s) == (1.5, None)
    assert row.ratio is not None
    assert row.ratio.value == pytest.approx(math.sqrt(2.0 * 0.5))
    assert row.by_scenario == pytest.approx({"calm": math.sqrt(2.0 / 4.0), "windy": math.sqrt(72.0 / 36.0)})
    assert row.to_dict()["error_ratio_high"] is None
    alone = comparison._make_row("first", first, None, both, None)
    assert alone.by_scenario == pytest.approx({"calm": 2.0, "windy": 72.0 ** (1 / 3)})
    assert (alone.ratio, alone.change, alone.Ms, alone.own_rmse_deg) == (None, None, None, None)
    assert comparison._make_row("first", [flown(1.0)], None, [calm], None).by_scenario == {}


def test_phases_are_paired_seed_by_seed_and_those_that_were_not_flown_count_as_failed() -> None:
    scenario = load_scenario("rotor-failure")  # before, and after

    def flown(*after: float) -> list[list[comparison._Flown]]:
        lost = [None if math.isnan(each) else PhaseFigures(each, 2.0 * each, 3.0, each / 10.0) for each in after]
        both = [(PhaseFigures(0.0, 0.1, 1.0 + seed, 0.0), each) for seed, each in enumerate(lost)]
        return [[comparison._Flown(1.0, 1.0, None, 1.0, None, failed=False, phases=each)] for each in both]

    first, mine = flown(1.0, 2.0, 5.0), flown(2.0, 4.0)
    before, after = comparison._make_row("mine", mine, first, [scenario], None).phases
    assert (before.name, before.duration_s, after.name, after.duration_s) == ("before", 5.0, "rotor failure 1", 15.0)
    assert (after.rmse_deg, after.peak_deg, after.torque_slew_rms) == (3.0, 6.0, 3.0)
    assert before.rmse_ratio is None  # it was 0
    assert before.torque_slew_rms == 1.5
    for ratio, expected in ((after.rmse_ratio, 2.0), (after.slew_ratio, 1.0), (after.saturated_more_s, 0.15)):
        assert ratio is not None
        assert ratio.value == pytest.approx(expected)
    told = after.to_dict()
    assert told["rmse_ratio"] == {"value": pytest.approx(2.0), "low": 0.0, "high": None}
    assert told["saturated_more_s"] == {"value": pytest.approx(0.15), "low": None, "high": None}
    alone = comparison._make_row("first", first, None, [scenario], None).phases[1]
    assert (alone.rmse_deg, alone.rmse_ratio, alone.slew_ratio, alone.saturated_more_s) == (2.0, None, None, None)
    fell = comparison._make_row("mine", flown(math.nan, math.nan), first, [scenario], None).phases[1]
    assert (fell.rmse_deg, fell.peak_deg, fell.torque_slew_rms, fell.slew_ratio) == (60.0, 60.0, None, None)
    assert fell.rmse_ratio is not None
    assert fell.rmse_ratio.value == pytest.approx(60.0 / math.sqrt(2.0))
