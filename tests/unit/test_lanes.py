"""Many flights in one call are the flights that they would be one by one."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.rotations import euler_angles
from firmware_model.scenario import load_scenario
from firmware_model.vehicle import load_vehicle
from gustproof.closed_loop import fly_direct
from gustproof.lanes import Case, fly_many
from gustproof.law import load_law
from gustproof.metrics import measure
from gustproof.requirements import judge

VEHICLE, LAW = load_vehicle("paper"), load_law("hinf-scheduled")
SHORT = replace(load_scenario("paper-turbulence"), duration_s=0.4)


def test_a_case_scales_the_gusts_and_begins_in_its_attitude():
    case = Case(vehicle=VEHICLE, seed=3, gust_scale=2.0, initial_attitude_deg=(5.0, -3.0, 120.0))
    flown = fly_direct(case.of(SHORT), LAW, vehicle=VEHICLE, seed=3)
    plain = fly_direct(SHORT, LAW, vehicle=VEHICLE, seed=3)
    np.testing.assert_allclose(np.degrees(euler_angles(flown["q_NB"][:1]))[0], (5.0, -3.0, 120.0), rtol=1e-12)
    np.testing.assert_array_equal(flown["gust_B"], 2.0 * plain["gust_B"])
    assert Case(vehicle=VEHICLE, seed=3).of(SHORT) == SHORT


@pytest.mark.compiled
def test_each_case_is_judged_as_its_own_flight():
    cases = [
        Case(
            vehicle=replace(VEHICLE, mass=9.0 + 0.1 * i),
            seed=i,
            gust_scale=1.0 + 0.1 * i,
            initial_attitude_deg=(i, 0.0, -i),
        )
        for i in range(3)
    ]
    for case, judged in zip(cases, fly_many(SHORT, LAW, cases), strict=True):
        scenario = case.of(SHORT)
        records = fly_direct(scenario, LAW, vehicle=case.vehicle, seed=case.seed)
        assert judged.metrics == measure(records, case.vehicle, scenario, 0.0)
        assert judged.requirements == judge(records, scenario, case.vehicle)
