"""Many flights in one call are the flights that they would be one by one, to the bit."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.events import ActuatorEffect, AttitudeReference, GpsLoss, GyroBias, Payload, RotorFailure
from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.scenario import NoiseRotation, list_scenarios, load_scenario
from firmware_model.config.vehicle import Battery, load_vehicle
from firmware_model.config.waveforms import GustCosine, GustReplay, GustStep, MomentStep, VonKarman
from firmware_model.numerics.rotations import euler_angles
from firmware_model.numerics.soa import loader, single
from firmware_model.physics.ground import ground_params, ground_wrench
from firmware_model.physics.rigid_body import Body
from firmware_model.sim.layout import X_BODY
from firmware_model.sim.state import initial_state
from gustproof.flight.routes.batch import Case, fly_many
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.kernels import LANES, fly_on_stand
from gustproof.flight.scoring.metrics import measure
from gustproof.flight.scoring.requirements import judge
from gustproof.law.form import list_laws, load_law
from gustproof.law.step import STEEP

VEHICLE, LAW = load_vehicle("paper"), load_law("hinf-scheduled")
SHORT = replace(load_scenario("paper-turbulence"), duration_s=0.4)
EVENTS = (
    AttitudeReference(kind="attitude", at_s=0.08, euler_deg=(6.0, -4.0, 10.0)),
    GyroBias(kind="gyro_bias", at_s=0.1, bias_rad_s=(0.01, 0.0, -0.01), over_s=0.1),
    ActuatorEffect(kind="actuator_effect", at_s=0.12, share=(0.7, 1.0, 0.9)),
    Payload(kind="payload", at_s=0.2, mass_kg=0.1, inertia_kgm2=(0.001, 0.0, 0.0)),
)
WINDS = (
    GustStep(kind="step", speed_mps=9.0, from_deg=30.0, start_s=0.1),
    GustCosine(kind="one_minus_cosine", amplitude_mps=(0.0, 30.0, 5.0), start_s=0.02, length_s=0.2),
    GustReplay(kind="replay", rows=((0.0, 1.0, 0.0, 0.5), (1.0, -1.0, 2.0, 0.0))),
)
EVENTFUL = replace(SHORT, event=EVENTS, wind=(*SHORT.wind, *WINDS), delay_samples=2)


def every_requirement():
    """Return one of each metric, over all axes and over one where it can be, in a window of its own."""
    for number, metric in enumerate(Metric):
        within = 0.5 if metric in (Metric.SETTLING, Metric.RECOVERY) else None
        for axis in (None, "pitch"):
            if (axis is None and metric is Metric.OVERSHOOT) or (axis and metric in (Metric.RHO, Metric.DRIFT)):
                continue
            begin = 0.08 if metric is Metric.OVERSHOOT else 0.012 * number
            yield Requirement(metric=metric, axis=axis, from_s=begin, to_s=0.36, within_deg=within, at_most=1.0)


def cases(number: int, *, sway: float = 1.0):
    """Return cases that differ in all that can differ."""
    return [
        Case(
            vehicle=replace(
                VEHICLE, mass=9.0 + 0.05 * i, inertia_B=(0.25 + 0.001 * i, 0.2, 0.1 + 0.0005 * i),
                actuator_lag=0.02 + 0.0005 * i, gyro=replace(VEHICLE.gyro, bias_B=(1e-4 * i, 0.0, -1e-4 * i)),
                torque_limit=(0.5 + 0.01 * i, 0.5, 0.2),
            ),
            seed=100 + i, gust_scale=0.5 + 0.05 * i,
            initial_attitude_deg=(sway * i, -0.5 * sway * i, 12.0 * sway * (i % 15)),
            turns=tuple(NoiseRotation(seed=7 * i + k, angle_rad=0.3 + 0.1 * k) for k in range(i % 3)),
        )
        for i in range(number)
    ]  # fmt: skip


def touches(case, scenario):
    """Whether a flight begins on the ground, be it with one foot."""
    body = loader(Body)(single(initial_state(case.vehicle, scenario, case.seed).state), X_BODY)
    return bool(ground_wrench(ground_params(case.vehicle), body)[2] > 0.0)


def one_by_one(scenario, law, many):
    for case in many:
        flown = case.apply_to(scenario)
        records = fly_direct(flown, law, vehicle=case.vehicle, seed=case.seed)
        yield measure(records, case.vehicle, flown), judge(records, flown, case.vehicle)


def assert_same(scenario, law, many):
    together = fly_many(scenario, law, many)
    assert len(together) == len(many)
    for judged, (metrics, requirements) in zip(together, one_by_one(scenario, law, many), strict=True):
        assert judged.metrics == metrics
        assert [r.requirement for r in judged.requirements] == list(scenario.require)
        np.testing.assert_array_equal([r.value for r in judged.requirements], [r.value for r in requirements])


def test_a_case_scales_the_gusts_and_begins_in_its_attitude():
    case = Case(vehicle=VEHICLE, seed=3, gust_scale=2.0, initial_attitude_deg=(5.0, -3.0, 120.0))
    flown = fly_direct(case.apply_to(SHORT), LAW, vehicle=VEHICLE, seed=3)
    plain = fly_direct(SHORT, LAW, vehicle=VEHICLE, seed=3)
    np.testing.assert_allclose(np.degrees(euler_angles(flown["q_NB"][:1]))[0], (5.0, -3.0, 120.0), rtol=1e-12)
    np.testing.assert_array_equal(flown["gust_B"], 2.0 * plain["gust_B"])
    assert Case(vehicle=VEHICLE, seed=3).apply_to(SHORT) == SHORT


@pytest.mark.slow
@pytest.mark.parametrize("translation", ["held", "free"])
@pytest.mark.parametrize("law", list_laws())
def test_flights_side_by_side_are_those_one_by_one_with_every_law(law, translation):
    assert_same(replace(SHORT, translation=translation), load_law(law), cases(3))


def test_flights_of_a_scheduled_law_are_the_same_side_by_side(turn):
    law = turn(load_law("hinf-scheduled"), 0.1)
    limited = replace(law, rate_limit=replace(law.rate_limit, limits=np.full(3, 0.05)))
    for flown in (replace(law, rate_limit=None), limited):
        assert_same(SHORT, flown, cases(3, sway=2.0))


def test_flights_over_the_vertical_are_the_same_side_by_side():
    kick = MomentStep(kind="step", amplitude_nm=(2.0, 17.0, 3.0), start_s=0.1)
    scenario, law = replace(SHORT, duration_s=1.0, moment=(kick,)), load_law("flagship")
    steep = fly_direct(scenario, law, vehicle=VEHICLE)["q_NB"]
    assert np.max(np.abs(euler_angles(steep)[:, 1])) > STEEP
    assert_same(scenario, law, cases(3))


@pytest.mark.parametrize("translation", ["held", "free"])
def test_flights_in_air_of_von_karman_are_the_same_side_by_side(translation):
    air = VonKarman(kind="von_karman", intensity="moderate")
    many = [replace(case, vehicle=replace(case.vehicle, span=0.3 + 0.3 * i)) for i, case in enumerate(cases(3))]
    assert_same(replace(SHORT, wind=(air,), translation=translation), load_law("flagship"), many)


@pytest.mark.parametrize("name", ["payload-drop", "shear"])
def test_free_flights_of_a_law_of_rates_are_the_same_side_by_side(name):
    assert_same(load_scenario(name), load_law("hinf-rates"), cases(3))


@pytest.mark.parametrize("law", ["hinf-scheduled", "hinf-rates"])
def test_flights_that_touch_the_ground_are_the_same_beside_those_that_do_not(law):
    scenario = replace(SHORT, translation="free", altitude_m=0.32, duration_s=2.0)
    many = cases(LANES + 3)
    touching = [touches(case, case.apply_to(scenario)) for case in many]
    assert 8 < sum(touching) < LANES - 8
    assert_same(scenario, load_law(law), many)


def test_flights_that_a_payload_pulls_to_the_ground_are_the_same_side_by_side():
    law = load_law("hinf-rates")  # with the thrust of the vehicle that was built
    load = Payload(kind="payload", at_s=0.1, mass_kg=3.0, inertia_kgm2=(0.05, 0.05, 0.05))
    scenario = replace(SHORT, translation="free", altitude_m=0.6, duration_s=2.0, event=(load,))
    fallen = fly_direct(scenario, law, vehicle=VEHICLE, seed=1)["position_N"][:, 2]
    assert fallen[0] == -0.6
    assert fallen[-1] > -VEHICLE.gear.height
    assert_same(scenario, law, cases(3))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in list_scenarios() if not load_scenario(name).has_link_script])
def test_flights_side_by_side_are_those_one_by_one_in_every_scenario_without_messages(name):
    assert_same(load_scenario(name), LAW, cases(3))


@pytest.mark.slow
@pytest.mark.parametrize("translation", ["held", "free"])
@pytest.mark.parametrize("law", ["hinf-scheduled", "hinf-rates"])
def test_events_winds_and_all_that_can_be_required_are_the_same_side_by_side(law, translation):
    scenario = replace(EVENTFUL, require=tuple(every_requirement()), translation=translation)
    assert_same(scenario, load_law(law), cases(LANES + 3))


@pytest.mark.parametrize("law", ["hinf-scheduled", "hinf-rates"])
def test_vehicles_with_other_rotors_and_failures_are_the_same_side_by_side(law):
    octo, quad = load_vehicle("octo"), VEHICLE
    five = replace(octo.rotors, position_B=octo.rotors.position_B[:5], spin=octo.rotors.spin[:5])
    vehicles = [octo, quad, replace(octo, rotors=five), quad, octo]
    many = [Case(vehicle=each, seed=i) for i, each in enumerate(vehicles)]
    failures = tuple(
        RotorFailure(kind="rotor_failure", at_s=at_s, rotor=rotor, share=share)
        for at_s, rotor, share in ((0.1, 1, 0.0), (0.2, 4, 0.6), (0.3, 1, 1.0))
    )
    free = replace(SHORT, translation="free")
    assert_same(replace(free, event=failures), load_law(law), many)
    assert_same(replace(free, event=failures, altitude_m=0.3), load_law(law), many)
    assert_same(SHORT, load_law(law), many)


@pytest.mark.parametrize("law", ["flagship", "hinf-rates"])
def test_vehicles_with_and_without_batteries_are_the_same_side_by_side(law):
    small = Battery(cells=3, capacity_ah=0.0005, resistance_ohm=0.05, hover_current_a=12.0)
    octo, batteries = load_vehicle("octo"), (None, small, replace(small, capacity_ah=1.0, resistance_ohm=0.1))
    many = [
        Case(vehicle=replace(each, battery=battery), seed=i)
        for i, each in enumerate((VEHICLE, octo))
        for battery in batteries
    ]
    free = replace(SHORT, translation="free")
    failure = RotorFailure(kind="rotor_failure", at_s=0.1, rotor=1, share=0.5)
    assert_same(free, load_law(law), many)
    assert_same(replace(free, event=(failure,), altitude_m=0.3), load_law(law), many)
    found = {result.metrics for result in fly_many(free, load_law(law), many)}
    assert len(found) == len(many)


@pytest.mark.parametrize("rate", [125, 1000])
@pytest.mark.parametrize("delay", [0, 3])
def test_other_rates_and_delays_are_the_same_side_by_side(rate, delay):
    scenario = replace(SHORT, control_rate_hz=rate, physics_rate_hz=2000, delay_samples=delay)
    assert_same(scenario, replace(LAW, dt=1.0 / rate), cases(2))


def test_a_flight_that_diverges_is_told_by_its_figures_and_disturbs_no_other():
    wild = Case(vehicle=replace(VEHICLE, inertia_B=(1e-160, 1e-160, 1e-160)), seed=1, gust_scale=1e200)
    [before] = fly_many(SHORT, LAW, cases(1))
    alone, lost, after = fly_many(SHORT, LAW, [*cases(1), wild, *cases(1)])
    assert alone == after == before
    assert np.isnan(lost.metrics.rmse_deg)
    assert np.isnan(lost.metrics.peak_deg)
    assert not lost.metrics.rho_in_bounds


def test_a_law_of_another_rate_and_a_script_of_messages_are_refused():
    with pytest.raises(ValueError, match="steps every"):
        fly_many(SHORT, replace(LAW, dt=0.001), cases(1))
    with pytest.raises(ValueError, match="must be flown with messages"):
        fly_many(load_scenario("controller-crash"), LAW, cases(1))
    with pytest.raises(ValueError, match=r"event\.0: gps_lost is of real autopilots"):
        fly_many(replace(SHORT, event=(GpsLoss(kind="gps_lost", at_s=0.1),)), LAW, cases(1))


def test_no_cases_are_no_flights():
    assert fly_many(SHORT, LAW, []) == []


def test_a_kernel_is_compiled_once_for_all_that_it_flies():
    """To compile it takes longer than a thousand flights: no array of a batch may be laid out in two ways."""
    for turns in ((), (NoiseRotation(seed=2, angle_rad=0.3),)):
        fly_many(SHORT, LAW, [Case(vehicle=VEHICLE, seed=1, turns=turns), Case(vehicle=VEHICLE, seed=2)])
    assert len(fly_on_stand.signatures) == 1
