"""A box at a risk: its deviations are those of the linear model, its bound holds, and flights stay in it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import GyroFault, Scenario, load_scenario
from firmware_model.config.vehicle import NoiseModel, Vehicle, load_vehicle
from firmware_model.config.waveforms import Constant
from gustproof.airframe.chance import attitude_box, exceedance, least_bound, sample_deviations
from gustproof.airframe.covariance import axis_models, initial_covariance
from gustproof.airframe.predict import close_vehicle, predict
from gustproof.flight.routes.batch import Case, fly_many
from gustproof.law.form import Law, load_law

VEHICLE, SCENARIO, LAW = load_vehicle("paper"), load_scenario("paper-turbulence"), load_law("flagship")
SHORT = replace(SCENARIO, duration_s=1.0)
FLIGHTS = 4000


def simulate(scenario: Scenario) -> np.ndarray:
    """Return the angles (N + 1, 3, flights) [rad] of flights of the linear model."""
    rng = np.random.default_rng(1)
    models = axis_models(VEHICLE, scenario)
    closed = close_vehicle(models, LAW, VEHICLE, scenario)
    P, starts = initial_covariance(models, closed.order)
    values, vectors = np.linalg.eigh(P)
    x = (vectors * np.sqrt(np.maximum(values, 0.0))) @ rng.standard_normal((closed.order, FLIGHTS))
    angles = []
    for _ in range(scenario.samples + 1):
        angles.append(x[starts])
        x = closed.A @ x + closed.B @ rng.standard_normal((closed.n_inputs, FLIGHTS))
    return np.array(angles)


def test_deviations_are_those_of_a_monte_carlo_run_of_the_same_model() -> None:
    sigmas = sample_deviations(LAW, VEHICLE, SHORT)
    assert sigmas.shape == (251, 3, 4)
    assert not np.any(sigmas[0])
    flown = np.std(simulate(SHORT), axis=2)
    # The deviation of a deviation is 1.1 %; 5 of them.
    assert flown[25::25] == pytest.approx(sigmas[25::25, :, 0], rel=0.056)


@pytest.mark.parametrize("law", ["flagship", "hinf-scheduled", "aided"])
def test_their_mean_square_is_the_predicted_one(law: str) -> None:
    sigmas = sample_deviations(load_law(law), VEHICLE, SHORT)
    found = predict(load_law(law), VEHICLE, SHORT)
    assert found is not None
    assert math.sqrt(np.mean(sigmas[:-1, :, 0] ** 2)) == pytest.approx(found.rmse, rel=1e-9)


def test_the_share_of_runs_that_leave_a_box_is_below_the_bound() -> None:
    peaks = np.max(np.abs(simulate(SHORT)), axis=0)
    sigmas = sample_deviations(LAW, VEHICLE, SHORT)[:, :, 0]
    for axis in range(3):
        for risk in (0.05, 0.2, 0.9):
            bound = least_bound(sigmas[:, axis], risk)
            assert np.mean(peaks[axis] > bound) <= risk
            # and the bound is not empty: half of it is left often
            assert np.mean(peaks[axis] > 0.5 * bound) > risk / 10.0


def test_the_bound_of_one_number_is_the_gaussian_tail() -> None:
    assert exceedance(np.array([2.0, 0.0]), 2.0 * 1.959963985) == pytest.approx(0.05, rel=1e-6)
    assert least_bound(np.array([2.0]), 0.05) == pytest.approx(2.0 * 1.959963985, rel=1e-6)


def test_a_bound_is_the_least_one_at_its_risk_and_falls_with_it() -> None:
    sigmas = np.linspace(0.1, 1.0, 1000)
    bounds = [least_bound(sigmas, risk) for risk in (1e-9, 1e-6, 1e-3, 0.5)]
    assert bounds == sorted(bounds, reverse=True)
    assert len(set(bounds)) == 4
    assert exceedance(sigmas, bounds[2]) <= 1e-3 < exceedance(sigmas, (1.0 - 1e-8) * bounds[2])


def test_a_box_falls_with_risk_and_grows_with_the_horizon() -> None:
    boxes = [attitude_box(LAW, VEHICLE, SHORT, risk).attitude_deg for risk in (1e-6, 1e-3, 0.1)]
    longer = attitude_box(LAW, VEHICLE, replace(SHORT, duration_s=2.0), 1e-3).attitude_deg
    assert np.all(np.diff(boxes, axis=0) < 0.0)
    assert np.all(np.array(longer) > boxes[1])


def test_a_box_has_room_for_the_path_between_samples() -> None:
    sigmas = sample_deviations(LAW, VEHICLE, SHORT)
    box = attitude_box(LAW, VEHICLE, SHORT, 1e-3).attitude_deg
    for axis in range(3):
        at_samples = math.degrees(least_bound(sigmas[:, axis, 0], 0.99e-3 / 3.0))
        # Angular acceleration is torque by inertia at least; the chord of a sample is h^2 / 8 of it.
        bend = math.degrees(0.004**2 / 8.0 * np.max(sigmas[:, axis, 2]) / VEHICLE.inertia_B[axis])
        assert at_samples + 4.0 * bend < box[axis] < 1.01 * at_samples


def test_the_flagship_stays_within_its_box_for_a_minute() -> None:
    box = attitude_box(LAW, VEHICLE, SCENARIO, 1e-3)
    assert max(box.attitude_deg) < 1.1
    assert (box.risk, box.horizon_s) == (1e-3, 60.0)
    assert "not a proof" in box.assumes["model"]


def test_gusts_of_another_scale_move_the_vehicle_so_much_more() -> None:
    quiet = replace(SHORT, gyro=GyroFault(noise=False))
    one, three = (predict(LAW, VEHICLE, replace(quiet, gust_scale=scale)) for scale in (1.0, 3.0))
    assert one is not None
    assert three is not None
    assert three.rmse == pytest.approx(3.0 * one.rmse, rel=1e-9)


@pytest.mark.slow
def test_flights_of_a_campaign_stay_in_the_box() -> None:
    box = attitude_box(LAW, VEHICLE, SCENARIO, 1e-3).attitude_deg
    flights = fly_many(SCENARIO, LAW, [Case(vehicle=VEHICLE, seed=seed) for seed in range(1, 2001)])
    peaks = np.array([[f.metrics.peak_roll_deg, f.metrics.peak_pitch_deg, f.metrics.peak_yaw_deg] for f in flights])
    assert np.count_nonzero(np.any(peaks > box, axis=1)) <= 2
    # .89, .82 and .79 of it
    assert np.all(np.max(peaks, axis=0) > 0.7 * np.array(box))


UNSTABLE = replace(LAW, C=-LAW.C, D=-LAW.D, rate_limit=None)
BIASED = replace(VEHICLE, gyro=replace(VEHICLE.gyro, bias_B=(0.0, 0.0, 1e-5)))
COLOURED = replace(VEHICLE, gyro=replace(VEHICLE.gyro, noise_model=NoiseModel.STATE_DEPENDENT))
TILTED = replace(SHORT, initial_attitude_deg=(0.0, 0.0, 1.0))
WINDY = replace(SHORT, wind=(*SHORT.wind, Constant(kind="constant", speed_mps=3.0, from_deg=0.0)))


@pytest.mark.parametrize(
    ("law", "vehicle", "scenario", "risk", "reason"),
    [
        (LAW, VEHICLE, SHORT, 0.0, "risk is 0.0"),
        (LAW, VEHICLE, SHORT, 1.0, "risk is 1.0"),
        (LAW, VEHICLE, SHORT, math.nan, "risk is nan"),
        (load_law("hinf-rates"), VEHICLE, SHORT, 0.1, "commands rates"),
        (LAW, VEHICLE, load_scenario("calm"), 0.1, "'calm' has no turbulence"),
        (LAW, VEHICLE, TILTED, 0.1, "not its initial_attitude_deg"),
        (LAW, VEHICLE, WINDY, 0.1, "not its wind"),
        (LAW, BIASED, SHORT, 0.1, "no white noise"),
        (LAW, COLOURED, SHORT, 0.1, "no white noise"),
        (LAW, VEHICLE, replace(SHORT, duration_s=4001.0), 0.1, "1,000,250 samples"),
        (replace(LAW, limits=np.array([0.3, 10.0, 10.0])), VEHICLE, SHORT, 0.1, "axis 0 may reach"),
        (LAW, replace(VEHICLE, torque_limit=(10.0, 10.0, 0.05)), SHORT, 0.1, "axis 2 may reach"),
        (load_law("pid-default"), VEHICLE, SCENARIO, 0.1, "a model of small angles"),
        (UNSTABLE, VEHICLE, SCENARIO, 0.1, "diverges"),
    ],
)
def test_what_the_model_does_not_contain_is_refused(
    law: Law, vehicle: Vehicle, scenario: Scenario, risk: float, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        attitude_box(law, vehicle, scenario, risk)
