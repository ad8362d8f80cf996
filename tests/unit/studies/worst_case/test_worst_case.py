"""The search finds what a linear analysis can't see, keeps its budget, and what it finds flies to the same figure."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.files import write_toml
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.hover import linear_law
from gustproof.airframe.lpv import linear_plant
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.loopback import fly_loopback
from gustproof.flight.scoring.metrics import measure
from gustproof.law.form import load_law
from gustproof.prove.boundedness import FlightCertificate, certify_boundedness
from gustproof.robust.lti.state_space import Lti, delay, discretize_zoh, lft
from gustproof.robust.uncertain.uncertainty import Spreads
from gustproof.studies.worst_case import moment_search as module
from gustproof.studies.worst_case.moment_search import PAPER_BUDGET, WorstCase, worst_case

VEHICLE = load_vehicle("paper")


@pytest.fixture(scope="module")
def box() -> FlightCertificate:
    return certify_boundedness("flagship", "paper", moment=PAPER_BUDGET, horizon=6.0)


@cache
def found(law: str) -> WorstCase:
    return worst_case(load_law(law), vehicle=VEHICLE, flights=100)


@pytest.mark.slow
def test_the_papers_law_is_turned_far_beyond_all_that_its_linear_loop_allows() -> None:
    worst = found("hinf-d1")
    assert worst.peak_deg >= 40.0  # the coning attack at 3 rad/s alone gives 51
    assert worst.linear_deg < 16.0


@pytest.mark.slow
def test_a_search_from_random_starts_alone_finds_coning_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "starts", lambda *_: iter(()))
    worst = worst_case(load_law("hinf-d1"), vehicle=VEHICLE, flights=150)
    assert worst.start.startswith("random")
    assert worst.peak_deg >= 40.0


@pytest.mark.slow
@pytest.mark.parametrize("law", ["hinf-scheduled", "hinf-rates"])
def test_a_law_with_the_exact_kinematics_suffers_about_what_its_linear_loop_does(law: str) -> None:
    worst = found(law)
    # The linear worst case is bang-bang and among the starts; the coupling of the axes at 1 deg adds some percent.
    assert 0.95 * worst.linear_deg < worst.peak_deg < 1.1 * worst.linear_deg


def test_what_is_found_keeps_the_budget_and_is_flown_again_from_its_file(tmp_path: Path) -> None:
    worst = found("hinf-d1")
    write_toml(worst.scenario, tmp_path / "worst.toml")
    scenario = load_scenario(tmp_path / "worst.toml")
    assert scenario == worst.scenario
    records = fly_direct(scenario, load_law("hinf-d1"), vehicle=worst.vehicle, seed=worst.seed)
    assert measure(records, worst.vehicle, scenario).peak_deg == worst.peak_deg == max(worst.peaks_deg)
    assert np.all(np.abs(records["moment_B"]) <= PAPER_BUDGET)


def test_what_is_found_flies_to_the_same_bits_over_datagrams() -> None:
    scenario, law = replace(found("hinf-d1").scenario, duration_s=2.0), load_law("hinf-d1")
    direct = fly_direct(scenario, law, vehicle=VEHICLE, seed=1)
    looped = fly_loopback(scenario, law, vehicle=VEHICLE, seed=1)
    np.testing.assert_array_equal(direct["q_NB"], looped["q_NB"])
    assert np.any(direct["moment_B"] != 0.0)


def test_the_linear_figure_is_the_l1_norm_of_the_linear_loop() -> None:
    law, worst = load_law("hinf-d1"), found("hinf-d1")
    full = linear_plant(VEHICLE)
    plant = discretize_zoh(full, law.dt)
    late = delay(3, law.dt)  # on the command only, the plant's first inputs
    D = np.zeros((6, 6))
    delayed = Lti(
        A=np.block([[plant.A, plant.B[:, :3] @ late.C], [np.zeros((3, 9)), late.A]]),
        B=np.block([[plant.B[:, 3:], np.zeros((9, 3))], [np.zeros((3, 3)), late.B]]),
        C=np.hstack([np.eye(6, 9), np.zeros((6, 3))]), D=D, dt=law.dt,
    )  # fmt: skip
    loop = lft(delayed, linear_law(law))
    x, total = loop.B.copy(), np.zeros((3, 3))
    for _ in range(worst.scenario.samples):
        total += np.abs(loop.C @ x)
        x = loop.A @ x
    # float32 commands of the flown responses, summed over 15,000 samples
    assert math.degrees(np.max(total @ PAPER_BUDGET)) == pytest.approx(worst.linear_deg, rel=1e-3)


def test_the_vehicle_is_searched_within_its_spreads_and_stays_a_body() -> None:
    worst = worst_case(
        load_law("pid-fair"),
        vehicle=VEHICLE,
        flights=100,
        duration_s=3.0,
        spreads=Spreads(inertia=0.2, actuator_lag=0.3),
    )
    ratios = np.array(worst.vehicle.inertia_B) / VEHICLE.inertia_B
    assert np.all((ratios >= 0.8) & (ratios <= 1.2))
    assert 0.7 <= worst.vehicle.actuator_lag / VEHICLE.actuator_lag <= 1.3
    assert 2.0 * max(worst.vehicle.inertia_B) <= sum(worst.vehicle.inertia_B)
    assert worst.vehicle != VEHICLE


def test_the_same_arguments_give_the_same_result_and_progress_only_grows() -> None:
    told: list[float] = []
    law = load_law("hinf-d1")
    first = worst_case(law, vehicle=VEHICLE, flights=100, duration_s=2.0, seed=3, progress=told.append)
    assert worst_case(law, vehicle=VEHICLE, flights=100, duration_s=2.0, seed=3) == first
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert worst_case(law, vehicle=VEHICLE, flights=100, duration_s=2.0, seed=4) != first


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"budget": (0.65, 0.0, 0.3)}, "budget"),
        ({"budget": (0.65, math.inf, 0.3)}, "budget"),
        ({"flights": 99}, "flights"),
    ],
)
def test_a_search_that_makes_no_sense_is_refused(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        worst_case(load_law("hinf-d1"), vehicle=VEHICLE, **change)


def test_a_spread_is_a_fraction() -> None:
    with pytest.raises(ValueError, match="inertia spread"):
        Spreads(inertia=1.0)


def test_the_search_finds_nothing_outside_the_truths_bound_and_most_of_the_flagships_box(
    box: FlightCertificate,
) -> None:
    assert box.certified_fraction == 1.0
    worst = worst_case(load_law("flagship"), vehicle=VEHICLE, budget=PAPER_BUDGET, duration_s=6.0, flights=100)
    assert box.truth_deg is not None
    assert box.estimate_deg is not None
    assert all(0.0 < peak < bound for peak, bound in zip(worst.peaks_deg, box.truth_deg, strict=True))
    assert all(peak >= 0.9 * bound for peak, bound in zip(worst.peaks_deg, box.estimate_deg, strict=True))
