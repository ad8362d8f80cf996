"""The shipped PID laws: derived again they are the same, and they fly as well as is said of them."""

import itertools
import statistics
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.law.form import Law, list_laws, load_law
from gustproof.scoring.metrics import Metrics, attitude, measure
from gustproof.simulate.direct import fly_direct
from gustproof.synthesis.shipped import DERIVATIONS

pytestmark = pytest.mark.compiled


def assert_same(law: Law, shipped: Law, *, rtol: float) -> None:
    for name in ("A", "B", "C", "D", "G", "H"):
        np.testing.assert_allclose(getattr(law, name), getattr(shipped, name), rtol=rtol, atol=1e-12, err_msg=name)
    assert (law.name, law.dt, law.output) == (shipped.name, shipped.dt, shipped.output)
    assert law.limits.tolist() == shipped.limits.tolist()
    assert law.provenance.design == shipped.provenance.design
    assert law.provenance.parameters == pytest.approx(shipped.provenance.parameters, rel=rtol)


def flown(law: str, scenario_name: str) -> list[Metrics]:
    vehicle, scenario = load_vehicle("paper"), load_scenario(scenario_name)
    return [
        measure(fly_direct(scenario, load_law(law), vehicle=vehicle, seed=seed), vehicle, scenario, 1.0)
        for seed in (1, 2, 3)
    ]


def test_the_default_pid_is_what_the_autotuner_makes() -> None:
    # Least squares on the same flight: only the order of sums may differ between machines.
    assert_same(DERIVATIONS["pid-default"](), load_law("pid-default"), rtol=1e-9)


def test_the_fair_pid_is_what_the_search_finds() -> None:
    # The search ends within 2e-5 of the same gains from any of four starts.
    assert_same(DERIVATIONS["pid-fair"](), load_law("pid-fair"), rtol=1e-3)


def test_the_indi_law_is_what_the_search_finds() -> None:
    # The search ends within 1e-8 of the same gains from either of two starts; between machines, as the PID's.
    assert_same(DERIVATIONS["indi"](), load_law("indi"), rtol=1e-3)


def test_the_indi_law_is_the_stronger_baseline_in_turbulence() -> None:
    indi, pid = flown("indi", "paper-turbulence"), flown("pid-fair", "paper-turbulence")
    for one, other in zip(indi, pid, strict=True):
        assert one.rmse_deg < 0.95 * other.rmse_deg
        assert one.torque_slew_rms == pytest.approx(other.torque_slew_rms, rel=0.02)
    assert max(flight.peak_roll_deg for flight in flown("indi", "coning")) <= 0.05


def test_the_flagship_is_what_the_search_finds() -> None:
    # From other starts it ends within 4e-5 of the same law.
    assert_same(DERIVATIONS["flagship"](), load_law("flagship"), rtol=1e-3)


def test_the_fair_pid_is_a_strong_baseline_in_turbulence() -> None:
    flights = flown("pid-fair", "paper-turbulence")
    assert statistics.median(flight.rmse_deg for flight in flights) <= 0.13
    assert statistics.median(flight.torque_slew_rms for flight in flights) <= 20.0
    assert statistics.median(flight.torque_rms_nm for flight in flights) <= 0.24


def test_coning_does_not_turn_the_fair_pid_but_the_default_one_over() -> None:
    assert max(flight.peak_roll_deg for flight in flown("pid-fair", "coning")) <= 0.05
    assert min(flight.peak_roll_deg for flight in flown("pid-default", "coning")) >= 90.0


def test_the_default_pid_is_slow_and_calm() -> None:
    flights = flown("pid-default", "paper-turbulence")
    assert statistics.median(flight.rmse_deg for flight in flights) >= 4.0
    assert statistics.median(flight.torque_slew_rms for flight in flights) <= 1.0


def test_every_shipped_law_is_derived() -> None:
    assert set(DERIVATIONS) == set(list_laws())


def error_at_the_end(law: str, steps_deg: list[tuple[float, ...]], seed: int) -> float:
    """Return how far [deg] Euler angles are from the last reference, of steps .4 s apart in turbulence, 4 s later."""
    scenario = replace(load_scenario("paper-turbulence"), duration_s=0.4 * len(steps_deg) + 4.0)
    reference = np.zeros((scenario.samples, 3))
    for number, step in enumerate(steps_deg):
        reference[100 * number :] = np.radians(step)
    records = fly_direct(scenario, load_law(law), vehicle=load_vehicle("paper"), seed=seed, reference=reference)
    off = np.degrees(attitude(records)[-250:] - reference[-1])
    return float(np.max(np.abs((off + 180.0) % 360.0 - 180.0)))


def test_the_flagship_holds_each_sequence_of_steps_within_its_reference_limit() -> None:
    limit = load_law("flagship").reference_limit_deg
    corners = list(itertools.product((-limit, limit), repeat=3))
    for seed in range(1, 9):
        sequence = [corners[k] for k in np.random.default_rng(seed).integers(8, size=8)]
        assert error_at_the_end("flagship", sequence, seed) <= 1.0


@pytest.mark.parametrize("step", [(60.0, 30.0, 0.0), (45.0, 15.0, 0.0)])
def test_the_flagship_needs_its_reference_limit_and_indi_does_not(step: tuple[float, ...]) -> None:
    assert error_at_the_end("flagship", [step], 1) >= 5.0
    assert error_at_the_end("pid-fair", [step], 1) <= 1.0
    assert error_at_the_end("indi", [step], 1) <= 1.0


@pytest.mark.parametrize("step", [*itertools.product((-60.0, 60.0), (-60.0, 60.0), (-180.0, 0.0, 180.0))])
def test_indi_holds_the_largest_steps_that_it_is_recommended_for(step: tuple[float, ...]) -> None:
    assert error_at_the_end("indi", [step], 1) <= 10.0


def test_aided_levels_from_any_attitude_and_reads_no_reference() -> None:
    assert not load_law("aided").takes_references
    for tilt in (60.0, 120.0, 170.0):
        scenario = replace(load_scenario("calm"), duration_s=60.0, initial_attitude_deg=(tilt, 0.0, 0.0))
        records = fly_direct(scenario, load_law("aided"), vehicle=load_vehicle("paper"))
        assert np.max(np.abs(np.degrees(attitude(records)[-250:, :2]))) <= 5.0
