"""The law with an accelerometer: what it is worth beside laws of gyros alone, and what it can't know."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import AccelerometerFault, Scenario, load_scenario
from firmware_model.config.vehicle import GRAVITY, load_vehicle
from firmware_model.numerics.rotations import euler_angles
from gustproof.airframe.hover import loop_law
from gustproof.design.derive import derive
from gustproof.design.designs import design_problem, load_design
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import Metrics, measure
from gustproof.law.form import load_law
from gustproof.studies.rate.hover_loop import hover_loop

VEHICLE = load_vehicle("paper")
GYROS_ALONE = ("pid-fair", "hinf-scheduled", "flagship")
TEN_MINUTES = replace(load_scenario("bias"), duration_s=600.0, require=())
BREEZE = replace(
    TEN_MINUTES, translation="free", wind=tuple(replace(gust, wind_speed_20ft_mps=7.0) for gust in TEN_MINUTES.wind)
)


def flown(scenario: Scenario, law: str, seed: int = 1) -> np.ndarray:
    """Return roll, pitch, yaw (samples, 3) [deg] of a flight."""
    return np.degrees(euler_angles(fly_direct(scenario, load_law(law), vehicle=VEHICLE, seed=seed)["q_NB"]))


def figures(scenario: Scenario, law: str, seed: int) -> Metrics:
    return measure(fly_direct(scenario, load_law(law), vehicle=VEHICLE, seed=seed), VEHICLE, scenario)


@pytest.mark.parametrize("seed", [1, 2])
def test_ten_minutes_of_gyro_bias_tilt_it_by_less_than_two_degrees(seed):
    angles = np.abs(flown(TEN_MINUTES, "aided", seed))
    assert angles[:, :2].max() <= 2.0
    assert angles[-15_000:, :2].max() <= 1.0  # in the last minute the bias is known
    # neither sensor sees yaw: it goes as bias times time
    assert angles[-1, 2] == pytest.approx(np.degrees(0.002 * 600.0), rel=0.02)


@pytest.mark.parametrize("law", GYROS_ALONE)
def test_gyros_alone_turn_by_bias_times_time(law):
    assert np.abs(flown(TEN_MINUTES, law))[:, :2].max() >= 60.0


@pytest.mark.parametrize("seed", [1, 2])
def test_in_free_flight_the_tilt_stays_bounded_though_the_accelerometer_feels_the_gusts(seed):
    assert np.abs(flown(BREEZE, "aided", seed))[:, :2].max() <= 2.5
    assert np.abs(flown(replace(BREEZE, wind=TEN_MINUTES.wind), "aided", seed))[:, :2].max() <= 4.5


def test_gyros_alone_do_not_stay_level_in_free_flight():
    assert np.abs(flown(replace(BREEZE, duration_s=120.0), "hinf-scheduled"))[:, :2].max() >= 12.0


@pytest.mark.parametrize("seed", [1, 2])
def test_in_turbulence_it_is_better_than_the_fair_pid_at_its_price(seed):
    turbulence = load_scenario("paper-turbulence")
    ours, theirs = (figures(turbulence, law, seed) for law in ("aided", "pid-fair"))
    assert ours.rmse_deg <= 0.8 * theirs.rmse_deg
    assert ours.torque_slew_rms == pytest.approx(theirs.torque_slew_rms, rel=0.02)


def test_its_sensitivity_is_that_of_the_fair_pid_in_every_axis():
    turbulence = load_scenario("paper-turbulence")
    for law in ("aided", "pid-fair"):
        margins = hover_loop(load_law(law), VEHICLE, turbulence).margins
        assert margins is not None
        assert [loop.Ms for loop in margins.input] == pytest.approx([1.36] * 3, abs=0.01)


def test_coning_does_not_turn_it():
    assert np.abs(flown(load_scenario("coning"), "aided")[:, 0]).max() <= 0.05


def test_an_accelerometers_bias_is_a_tilt_of_bias_over_gravity():
    biased = replace(
        load_scenario("calm"),
        duration_s=600.0,
        require=(),
        accelerometer=AccelerometerFault(bias_mps2=(0.2, -0.1, 0.0)),
    )
    tilt = flown(biased, "aided")[-15_000:, :2].mean(axis=0)
    # f_y = -g sin(phi) and f_x = g sin(theta) are made 0
    np.testing.assert_allclose(tilt, np.degrees(np.array([-0.1, -0.2]) / GRAVITY), atol=0.05)


def test_the_design_leaks_in_yaw_alone_and_measures_roll_and_pitch():
    problem = design_problem(load_design("aided"), VEHICLE)
    attitude = problem.plant().A[:3, :3]
    np.testing.assert_array_equal(attitude, np.diag([0.0, 0.0, -0.05]))
    assert (problem.y, problem.z, problem.w) == (("gyro", "level"), ("z_e", "z_u", "z_m"), ("w_d", "w_n", "w_l"))
    level = problem.system(("w_l",), ("level",))
    np.testing.assert_array_equal(level.D, np.eye(2))


def test_what_is_left_of_the_moment_is_weighted_by_the_sensitivity():
    design = load_design("aided")
    problem = design_problem(design, VEHICLE)
    left = problem.system(("w_d", "u"), ("moment", "z_m")).response(np.array([2.0]))[0]
    np.testing.assert_allclose(left[3:], np.diag(design.W_m) @ left[:3], atol=1e-15)


def test_the_law_takes_roll_and_pitch_by_gravity_as_the_controller_is_told_them():
    law, report = derive(load_design("aided"))
    np.testing.assert_array_equal(law.B[:, 6:], loop_law(law).B[:, 3:])
    slow = np.array([1e-3, 0.1])
    np.testing.assert_allclose(loop_law(law).response(slow), report.result.lti.response(slow), rtol=1e-3, atol=1e-2)
    assert not law.B[:, 3:6].any()  # no reference
