"""Advice holds when it is followed: the loop is built again, and has the Ms and the error that were said."""

import math

import numpy as np
import pytest

from firmware_model.config.gyro_filters import butterworth
from firmware_model.config.parameter_files import read_parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.airframe.predict import predict
from gustproof.design.loops.models import AUTOPILOTS, autopilot_law
from gustproof.law.form import load_law
from gustproof.robust.lti.margins import margins
from gustproof.robust.lti.state_space import series
from gustproof.studies.rate.advice import FAMILIES, _Advisor, advise
from gustproof.studies.rate.judge import scenario_for

PAPER, AIR = load_vehicle("paper"), load_scenario("paper-turbulence")
TUNED = {name: float(value) for name, value in read_parameters("tuned", "px4").items()}
RATE_NAMES = {"roll": ("ROLL", "RLL"), "pitch": ("PITCH", "PIT"), "yaw": ("YAW", "YAW")}


def advice(kind, parameters, slew):
    law = autopilot_law(kind, parameters, PAPER).law
    return law, advise(law, PAPER, scenario_for(law, PAPER, AIR), slew=slew)


def follow(kind, law, told):
    """Return the law with the advised values and the rate gains scaled."""
    values = {**law.provenance.parameters, **{name: new for name, (_, new) in told.changes.items()}}
    for axis, gain in told.gains.items():
        px4, ardupilot = RATE_NAMES[axis]
        form = f"MC_{px4}RATE_{{}}" if kind == "px4" else f"ATC_RAT_{ardupilot}_{{}}"
        values |= {form.format(key): gain * values[form.format(key)] for key in "PID"}
    return autopilot_law(kind, values, PAPER).law


CASES = [
    ("px4", {**TUNED, "IMU_DGYRO_CUTOFF": 2.0}, 20.0),
    ("px4", {**TUNED, "MC_ROLLRATE_P": 1.0, "MC_PITCHRATE_P": 0.82}, 64.0),
    ("ardupilot", {}, 20.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "parameters", "slew"), CASES)
def test_advice_that_is_followed_brings_what_it_says(kind, parameters, slew):
    law, found = advice(kind, parameters, slew)
    assert found
    scenario = scenario_for(law, PAPER, AIR)
    for told in found:
        better = follow(kind, law, told)
        predicted = predict(better, PAPER, scenario)
        assert math.degrees(predicted.rmse) == pytest.approx(told.rmse_deg[1], rel=1e-6)
        assert predicted.slew == pytest.approx(told.slew[1], rel=1e-6)
        assert told.slew[1] <= slew
        loops = margins(hover_plant(PAPER, scenario), loop_law(better)).input
        for k, axis in enumerate(("roll", "pitch", "yaw")):
            if axis in told.Ms:
                assert loops[k].Ms == pytest.approx(told.Ms[axis], rel=0.02)
                assert loops[k].Ms < 2.05


def test_a_filter_s_cost_is_the_phase_that_the_loop_loses_by_it():
    parameters = {**TUNED, "IMU_GYRO_CUTOFF": 12.0}
    law, found = advice("px4", parameters, 80.0)
    (told,) = (each for each in found if each.family.label == "gyro filter")
    cost, crossover = told.phase
    scenario = scenario_for(law, PAPER, AIR)
    plant, off = hover_plant(PAPER, scenario), autopilot_law("px4", {**parameters, "IMU_GYRO_CUTOFF": 0.0}, PAPER).law
    with_it, without = (
        np.diagonal(series(plant, loop_law(each)).response(np.array([crossover]))[0]) for each in (law, off)
    )
    costs = np.degrees(np.angle(without / with_it))
    assert np.min(np.abs(costs - cost)) < 1e-6  # each axis counts at its own crossover
    # nearly that of the filter by itself, which the attitude does not pass
    b0, b1, b2, a1, a2 = butterworth(12.0, 250.0)
    z = np.exp(-1j * 0.004 * crossover)
    response = (b0 + b1 * z + b2 * z * z) / (1.0 + a1 * z + a2 * z * z)
    assert cost == pytest.approx(-math.degrees(np.angle(response)), rel=0.1)
    assert f"costs {cost:.2g} deg of phase" in told.describe()


@pytest.mark.slow
def test_the_spoilt_filter_is_what_matters_most():
    _, found = advice("px4", {**TUNED, "IMU_DGYRO_CUTOFF": 2.0}, 20.0)
    changed = [each for each in found if each.changes]
    assert list(changed[0].changes) == ["IMU_DGYRO_CUTOFF"]
    assert changed[0].phase[0] > 40.0
    _, found = advice("ardupilot", {}, 20.0)
    changed = [each for each in found if each.changes]
    assert list(changed[0].changes) == ["ATC_RAT_YAW_FLTE"]


def test_other_laws_and_loops_beyond_one_change_have_none():
    assert advise(load_law("pid-fair"), PAPER, AIR, slew=20.0) == ()


def test_every_family_is_of_parameters_that_the_model_has():
    for kind, families in FAMILIES.items():
        names = [name for family in families for name in family.names]
        assert set(names) <= set(AUTOPILOTS[kind].settings)
        assert len(names) == len(set(names))


def test_a_whole_number_is_advised_as_one():
    law = autopilot_law("ardupilot", {"INS_GYRO_FILTER": 53.0}, PAPER).law
    advisor = _Advisor("ardupilot", law.provenance.parameters, PAPER, AIR)
    tried = [change["INS_GYRO_FILTER"] for change in advisor._changes(FAMILIES["ardupilot"][0])]
    assert tried == [26.0, 37.0, 74.0, 106.0, 159.0, 0.0]
