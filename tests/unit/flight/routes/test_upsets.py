"""A vehicle upside down, a gyro at its range and physics beyond its steps are told by name."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.events import GyroRange
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.recording.journal import RECORD
from gustproof.flight.routes.outcome import FlightOutcome, blame_physics, describe, infer_outcome
from gustproof.flight.routes.upsets import describe_upsets, divergence_s

VEHICLE = load_vehicle("paper")
SCENARIO = replace(load_scenario("calm"), duration_s=4.0)


@pytest.fixture
def records() -> np.ndarray:
    flown = np.zeros(SCENARIO.samples, dtype=RECORD)
    flown["time_us"] = 4000 * np.arange(len(flown))
    flown["q_NB"][:, 0] = 1.0
    flown["mode"] = 6 << 16
    return flown


def lean(records, sample: int, tilt_deg: float, axis: int = 1) -> None:
    half = math.radians(0.5 * tilt_deg)
    records["q_NB"][sample] = math.cos(half), 0.0, 0.0, 0.0
    records["q_NB"][sample, axis] = math.sin(half)


def test_quiet_flight_has_no_upset(records):
    lean(records, 7, 89.9)
    lean(records, 8, 180.0, axis=3)  # yaw alone is no tilt
    assert describe_upsets(records, SCENARIO, VEHICLE) == ()
    assert describe_upsets(records[:0], SCENARIO, VEHICLE) == ()


@pytest.mark.parametrize("axis", [1, 2])
@pytest.mark.parametrize("tilt_deg", [90.1, -120.0, 180.0])
def test_first_tilt_past_the_horizon_is_told_with_its_time(records, axis, tilt_deg):
    for sample in (300, 500):
        lean(records, sample, tilt_deg, axis)
    assert describe_upsets(records, SCENARIO, VEHICLE) == ("tilted past 90 deg at 1.2 s",)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_time_of_the_gyro_at_its_range_is_told_by_the_range_of_that_time(records, axis):
    clipped = GyroRange(kind="gyro_range", at_s=2.0, range_rad_s=0.1)
    records["gyro_B"][100:600, axis] = -np.float32(0.1)
    records["gyro_B"][3, axis] = np.float32(VEHICLE.gyro.range)
    script = replace(SCENARIO, event=(clipped,))
    assert describe_upsets(records, script, VEHICLE) == ("gyro at its range for 0.404 s",)
    records["gyro_B"][:] *= 0.999
    assert describe_upsets(records, script, VEHICLE) == ()


@pytest.mark.parametrize("name", ["q_NB", "omega_B", "velocity_N", "position_N"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_flight_without_numbers_has_diverged_whatever_its_end(records, name, value):
    records[name][250:, -1] = value
    assert divergence_s(records, SCENARIO) == 1.0
    for told in (FlightOutcome.DONE, FlightOutcome.CONTROLLER_LOST, FlightOutcome.CONTROLLER_NOT_FINITE):
        assert blame_physics(told, records, SCENARIO) is FlightOutcome.DIVERGED
    assert blame_physics(FlightOutcome.INTERRUPTED, records, SCENARIO) is FlightOutcome.INTERRUPTED
    assert infer_outcome(records, SCENARIO) is FlightOutcome.DIVERGED
    words = describe(FlightOutcome.DIVERGED, SCENARIO, records)
    assert words == "diverged at 1 s: faster than the simulation can follow"


@pytest.mark.parametrize(("rate", "diverged"), [(2_800.0, False), (2_900.0, True), (-2_900.0, True), (1e10, True)])
def test_rates_beyond_the_steps_of_the_physics_are_a_divergence(records, rate, diverged):
    assert SCENARIO.physics_rate_hz == 1000
    records["omega_B"][10, 2] = rate
    assert (infer_outcome(records, SCENARIO) is FlightOutcome.DIVERGED) is diverged
    assert blame_physics(FlightOutcome.DONE, records, SCENARIO) is infer_outcome(records, SCENARIO)
