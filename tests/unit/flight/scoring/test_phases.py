"""Phases of a flight: where a scenario is cut, what each is called, and what is measured in it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.scenario import list_scenarios, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.numerics.rotations import from_euler
from firmware_model.recording.journal import RECORD
from gustproof.flight.scoring.phases import BEFORE, find_phases, measure_phases
from gustproof.flight.scoring.requirements import judge
from gustproof.types import Records

GUST = load_scenario("gust-roll")  # from 2 to 2.6 of 10 s


def flown(offset_deg: float = 0.0, gust_deg: float = 4.0) -> Records:
    """Return a flight of GUST whose pitch error is .1 deg to and fro, and `gust_deg` in the gust; yaw has an offset."""
    records = np.zeros(GUST.samples, dtype=RECORD)
    records["time_us"] = 4000 * np.arange(GUST.samples)
    pitch = 0.1 * (-1.0) ** np.arange(GUST.samples)
    pitch[500:650] = gust_deg
    records["q_NB"] = [from_euler(0.0, math.radians(each), math.radians(offset_deg)) for each in pitch]
    random, limit = np.random.default_rng(1), load_vehicle("paper").torque_limit
    records["torque_command_B"] = random.normal(0.0, 0.5, (GUST.samples, 3)) * limit
    return records


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("paper-turbulence", []),
        ("attitude-steps", [BEFORE, "reference 10, 0, 0 deg", "reference 0, 10, 0 deg", "reference 0, 0, 10 deg"]),
        ("rotor-failure", [BEFORE, "rotor failure 1"]),
        ("gust-front", [BEFORE, "mode hold", "gust to the east 8 m/s, ramp", "after gust to the east 8 m/s, ramp"]),
    ],
)
def test_what_happens_in_part_of_a_flight_cuts_and_names_its_phases(name: str, told: list[str]) -> None:
    assert [phase.name for phase in find_phases(load_scenario(name))] == told


@pytest.mark.parametrize("name", list_scenarios())
def test_phases_cover_a_flight_once(name: str) -> None:
    scenario = load_scenario(name)
    windows = sorted(window for phase in find_phases(scenario) for window in phase.windows)
    if windows:
        assert [begin for begin, _ in windows[1:]] == [end for _, end in windows[:-1]]
        assert (windows[0][0], windows[-1][1]) == (0.0, scenario.duration_s)


def test_what_happens_again_is_one_phase_and_what_adds_up_is_another() -> None:
    doublets = {phase.name: phase.windows for phase in find_phases(load_scenario("doublets"))}
    assert doublets["reference 8, 0, 0 deg"] == ((1.0, 2.0), (11.0, 12.0), (21.0, 22.0))
    delays = [phase.name for phase in find_phases(load_scenario("link-delay"))]
    assert delays[1:4] == ["link delay", "2 times link delay", "3 times link delay"]


def test_slew_and_saturation_are_those_of_a_requirement_on_the_same_window() -> None:
    records, vehicle, phases = flown(), load_vehicle("paper"), find_phases(GUST)
    for metric, name in ((Metric.TORQUE_SLEW, "torque_slew_rms"), (Metric.SATURATED, "saturated_s")):
        windows = [
            Requirement(metric=metric, from_s=a, to_s=b, at_most=1.0) for ((a, b),) in (p.windows for p in phases)
        ]
        required = judge(records, replace(GUST, require=tuple(windows)), vehicle)
        found = [getattr(each, name) for each in measure_phases(records, GUST, vehicle, phases)]
        assert found == pytest.approx([each.value for each in required])
        assert min(found) > 0.0


def test_error_is_that_of_its_phase_and_a_constant_heading_error_is_not_in_it() -> None:
    vehicle, phases = load_vehicle("paper"), find_phases(GUST)
    for offset in (0.0, 2.0):
        before, gust, after = measure_phases(flown(offset), GUST, vehicle, phases)
        assert before is not None
        assert gust is not None
        assert after is not None
        assert gust.rmse_deg == pytest.approx(4.0 / math.sqrt(3.0), rel=0.03)  # the median is one of the two
        assert gust.peak_deg == pytest.approx(4.0, rel=0.03)
        assert before.peak_deg == pytest.approx(0.2, abs=1e-6)
        assert (before.rmse_deg, after.rmse_deg) == pytest.approx((0.2 / math.sqrt(6.0),) * 2, rel=1e-6)


def test_a_phase_that_was_not_flown_to_its_end_before_the_failure_has_no_figures() -> None:
    vehicle, phases, records = load_vehicle("paper"), find_phases(GUST), flown()
    whole = measure_phases(records, GUST, vehicle, phases)
    assert [each is None for each in measure_phases(records[:2000], GUST, vehicle, phases)] == [False, False, True]
    fell = measure_phases(records, GUST, vehicle, phases, until_s=2.3)
    assert fell[1:] == (None, None)
    assert fell[0] is not None
    assert whole[0] is not None
    assert fell[0].saturated_s == whole[0].saturated_s
    assert measure_phases(records[:0], GUST, vehicle, phases) == (None, None, None)
