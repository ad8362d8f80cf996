"""The shrunk flight still does the harm asked for, with less."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.scenario import GyroFault, Scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import Dryden, MomentSine, MomentStep
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.flight.routes.controllers import fly_controller
from gustproof.law.form import load_law
from gustproof.studies.worst_case.moment_search import PAPER_BUDGET, WorstCase, peaks_deg, worst_case
from gustproof.studies.worst_case.shrink import SmallestCase, shrink_case

VEHICLE, LAW = load_vehicle("paper"), load_law("flagship")
MOMENTS = (
    MomentStep(kind="step", amplitude_nm=(0.0, 0.6123, 0.0)),
    MomentStep(kind="step", amplitude_nm=(0.0123, 0.0, 0.0), start_s=0.2),
    MomentSine(kind="sine", amplitude_nm=(0.0, 0.0, 0.0123), rate_rad_s=3.21),
    MomentStep(kind="step", amplitude_nm=(0.0, 0.01, 0.0), start_s=1.4),
)
MAKER = """
class Bent:
    def reset(self):
        self.angle = [0.0, 0.0, 0.0]

    def step(self, gyro, reference, force, dt):
        self.angle = [a + dt * w for a, w in zip(self.angle, gyro)]
        if self.angle[1] > 0.05:
            raise RuntimeError("bent")
        return [2.0 * (r - a) - w for r, a, w in zip(reference, self.angle, gyro)]


def make():
    return Bent()
"""


def flown(vehicle=VEHICLE, **changes) -> WorstCase:
    script = {"duration_s": 1.6, "moment": MOMENTS, "gyro": GyroFault(noise=False), **changes}
    scenario = Scenario(name="worst", description="by hand", **script)
    peaks = peaks_deg(fly_controller(scenario, LAW, vehicle=vehicle).records, scenario, vehicle)
    return WorstCase(
        scenario=scenario, vehicle=vehicle, seed=1, peak_deg=max(peaks), peaks_deg=peaks, linear_deg=0.0, start="hand",
        start_deg=0.0, flights=1,
    )  # fmt: skip


def shrunk(found: WorstCase, target_deg: float, **options) -> SmallestCase:
    small = shrink_case(found, LAW, vehicle=VEHICLE, budget=PAPER_BUDGET, target_deg=target_deg, **options)
    again = fly_controller(small.scenario, LAW, vehicle=small.vehicle, seed=small.seed).records
    assert max(peaks_deg(again, small.scenario, small.vehicle)) == small.peak_deg >= target_deg
    assert np.all(np.abs(again["moment_B"]) <= PAPER_BUDGET)
    return small


def test_only_what_does_the_harm_is_left() -> None:
    found, shown = flown(replace(VEHICLE, actuator_lag=0.055)), []
    small = shrunk(found, 0.5 * found.peak_deg, progress=shown.append)
    (term,) = small.scenario.moment
    assert (small.terms, small.terms_before, small.vehicle) == (1, 4, VEHICLE)
    assert term.amplitude_nm[0] == term.amplitude_nm[2] == 0.0
    assert term.amplitude_nm[1] == float(f"{term.amplitude_nm[1]:.3g}")  # few digits
    assert 0.4 < small.strength[1] < 0.6  # the loop is close to linear
    assert small.strength[0] == small.strength[2] == 0.0
    assert small.scenario.duration_s < found.scenario.duration_s
    assert small.flights <= 200
    assert shown == sorted(shown)


def test_a_vehicle_that_matters_stays_and_flights_are_counted() -> None:
    found = flown(replace(VEHICLE, actuator_lag=0.09))
    assert shrunk(found, 0.999 * found.peak_deg).vehicle == found.vehicle
    assert shrunk(found, 0.5 * found.peak_deg, flights=4).flights == 4


def test_turbulence_is_weakened_too() -> None:
    wind = Dryden(kind="dryden", wind_speed_20ft_mps=6.0, airspeed_mps=15.0)
    found = flown(moment=(), wind=(wind,))
    (weaker,) = shrunk(found, 0.5 * found.peak_deg).scenario.wind
    assert 2.5 < weaker.wind_speed_20ft_mps < 3.6


def test_a_target_that_is_not_reached_is_refused() -> None:
    found = flown()
    with pytest.raises(ValueError, match=r"reaches .* deg, not 90 deg"):
        shrink_case(found, LAW, vehicle=VEHICLE, budget=PAPER_BUDGET, target_deg=90.0)


def test_a_controller_that_breaks_off_under_a_moment_is_found_and_shrunk(tmp_path: Path) -> None:
    (tmp_path / "bent.py").write_text(MAKER)
    entry = parse_controller(f"{tmp_path / 'bent.py'}:make")
    budget = (0.05, 0.05, 0.05)
    with pytest.raises(ValueError, match="controller 'bent' breaks off before the search: the controller raised"):
        worst_case(entry, vehicle=VEHICLE, budget=(1.0, 1.0, 1.0), duration_s=1.0, flights=100)
    scenario = Scenario(name="worst", description="by hand", duration_s=1.6, moment=MOMENTS)
    found = replace(flown(), scenario=scenario, peak_deg=math.inf)
    small = shrink_case(found, entry, vehicle=VEHICLE, budget=PAPER_BUDGET, target_deg=2.0, flights=60)
    assert small.peak_deg == math.inf or small.peak_deg >= 2.0
    assert small.terms == 1
    calm = worst_case(entry, vehicle=VEHICLE, budget=budget, duration_s=0.4, flights=100)
    assert 0.0 < calm.peak_deg < 2.9
