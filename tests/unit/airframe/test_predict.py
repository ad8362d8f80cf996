"""What is foretold of whole laws is what is foretold of their axes, and what flies."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import Vehicle, load_vehicle
from gustproof.airframe.covariance import augmented_axis, axis_models, axis_performance, mean_second_moments
from gustproof.airframe.predict import Prediction, predict
from gustproof.design.cascades.indi import IndiGains, indi_axis
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import measure
from gustproof.law.cascade import AxisLaw, cascade_law
from gustproof.law.form import Law, load_law
from gustproof.law.step import step
from gustproof.robust.lti.state_space import lft

VEHICLE, SCENARIO = load_vehicle("paper"), load_scenario("paper-turbulence")


def indi() -> tuple[Law, list[AxisLaw]]:
    """Return a law, and the laws of its axes."""
    gains = IndiGains(angle_p=4.0, rate_p=12.0, cutoff=20.0, damping=0.5)
    axes = [indi_axis(gains, inertia, VEHICLE.actuator_lag, 1, SCENARIO.dt) for inertia in VEHICLE.inertia_B]
    return cascade_law("test", axes, VEHICLE, SCENARIO.dt, load_law("indi").provenance), axes


def with_noise(rate: float | None, snr_db: float = 35.0) -> Vehicle:
    """Return the vehicle whose gyro noise is stated at a rate [rad/s]."""
    assert rate is not None
    return replace(VEHICLE, gyro=replace(VEHICLE.gyro, reference_rate=rate, snr_db=snr_db))


def foretell(law: Law, vehicle: Vehicle = VEHICLE) -> Prediction:
    """Return the prediction of a torque law."""
    found = predict(law, vehicle, SCENARIO)
    assert found is not None
    return found


def test_three_axes_at_once_are_three_axes() -> None:
    law, axes = indi()
    each = [axis_performance(m, axis) for m, axis in zip(axis_models(VEHICLE, SCENARIO), axes, strict=True)]
    whole = foretell(law)
    assert whole.rmse == pytest.approx(math.sqrt(np.mean([axis.rmse**2 for axis in each])), rel=1e-9)
    assert whole.slew == pytest.approx(math.sqrt(np.mean([axis.slew**2 for axis in each])), rel=1e-9)


@pytest.mark.parametrize("snr_db", [35.0, 20.0])
def test_the_noise_is_under_the_rate_that_it_leads_to(snr_db: float) -> None:
    law, axes = indi()
    found = foretell(law, with_noise(0.2, snr_db))
    squares = []
    for model, axis in zip(axis_models(with_noise(found.own_rate, snr_db), SCENARIO), axes, strict=True):
        free = augmented_axis(model)
        C = free.C.copy()
        C[0] = np.eye(free.order)[1]  # the rate in place of the attitude
        squares.append(mean_second_moments([model], lft(replace(free, C=C), axis.controller(SCENARIO.dt)))[0, 0])
    assert found.own_rate == pytest.approx(math.sqrt(np.mean(squares)), rel=1e-9)


@pytest.mark.parametrize("name", ["flagship", "pid-default", "hinf-scheduled", "aided"])
def test_the_error_there_is_that_of_a_vehicle_with_such_noise(name: str) -> None:
    found = foretell(load_law(name))
    there = foretell(load_law(name), with_noise(found.own_rate))
    assert found.own_rate_rmse == pytest.approx(there.rmse, rel=1e-9)
    # wherever the noise of the file is stated
    assert (there.own_rate, there.own_rate_rmse) == pytest.approx((found.own_rate, found.own_rate_rmse), rel=1e-9)


def test_noise_that_leads_to_more_rate_than_it_is_stated_under_has_no_level() -> None:
    loud = foretell(load_law("flagship"), with_noise(0.2, snr_db=-40.0))
    assert loud.own_rate is loud.own_rate_rmse is None
    assert math.isfinite(loud.rmse)


def test_without_gyro_noise_both_levels_are_one() -> None:
    quiet = predict(load_law("flagship"), VEHICLE, replace(SCENARIO, gyro=replace(SCENARIO.gyro, noise=False)))
    assert quiet is not None
    assert quiet.own_rate_rmse == quiet.rmse


def test_the_guide_has_what_is_foretold_at_both_levels_of_noise() -> None:
    text = " ".join((Path(__file__).parents[3] / "src/gustproof/guide/laws.md").read_text(encoding="utf-8").split())
    for name in ("flagship", "pid-fair", "flagship-robust"):
        rmse = foretell(load_law(name)).own_rate_rmse
        assert rmse is not None
        assert f"`{name}` has {math.degrees(rmse):.3f}°".replace(" 0.", " .") in text
    flagship, robust, fair = (foretell(load_law(name)).rmse for name in ("flagship", "flagship-robust", "pid-fair"))
    gains = f"predicts {1.0 - flagship / fair:.0%} for `flagship` and {1.0 - robust / fair:.0%} for `flagship-robust`"
    assert gains.replace("%", " %") in text


def levelled(law: Law) -> Law:
    """Return the law with a torque of its own against the attitude that the accelerometer tells of, at hover."""
    toward_level = np.array([[-2.943, 0.0], [0.0, -1.962], [0.0, 0.0]])
    B, D = np.hstack([law.B, np.zeros((law.order, 2))]), np.hstack([law.D, toward_level])
    return replace(law, B=B, D=D, rate_limit=None)


@pytest.mark.slow
@pytest.mark.parametrize("law", [load_law("hinf-scheduled"), load_law("indi"), levelled(load_law("pid-fair"))])
def test_what_is_foretold_flies(law: Law) -> None:
    vehicle = replace(VEHICLE, accelerometer=replace(VEHICLE.accelerometer, noise_density=0.005))
    foretold = foretell(law, vehicle)
    flights = [
        measure(fly_direct(SCENARIO, law, vehicle=vehicle, seed=seed), vehicle, SCENARIO, 1.0) for seed in range(20)
    ]
    # 60 independent walks and turbulences: the root of their mean square scatters by some 8 %.
    flown = math.sqrt(np.mean([flight.rmse_deg**2 for flight in flights]))
    assert flown == pytest.approx(math.degrees(foretold.rmse), rel=0.2)
    assert np.mean([flight.torque_slew_rms for flight in flights]) == pytest.approx(foretold.slew, rel=0.01)


def test_a_flight_has_the_rate_that_its_noise_is_stated_under() -> None:
    law = load_law("flagship")
    found = foretell(law)
    vehicle = with_noise(found.own_rate)
    flights = [fly_direct(SCENARIO, law, vehicle=vehicle, seed=seed) for seed in range(20)]
    rate = math.sqrt(np.mean([np.mean(flight["omega_B"] ** 2) for flight in flights]))
    assert rate == pytest.approx(found.own_rate, rel=0.1)
    rmse = math.sqrt(np.mean([measure(flight, vehicle, SCENARIO, 1.0).rmse_deg ** 2 for flight in flights]))
    assert math.radians(rmse) == pytest.approx(found.own_rate_rmse, rel=0.1)


def test_the_accelerometer_bounds_the_attitude_that_gyros_let_walk() -> None:
    long = replace(SCENARIO, duration_s=600.0)
    gyros, level = (predict(law, VEHICLE, long) for law in (load_law("pid-fair"), levelled(load_law("pid-fair"))))
    assert gyros is not None
    assert level is not None
    assert level.rmse < gyros.rmse


def test_a_law_of_rates_has_no_torque_to_foretell() -> None:
    assert predict(load_law("hinf-rates"), VEHICLE, SCENARIO) is None


def test_what_a_law_sees_is_its_own_estimate_in_flight() -> None:
    law, _ = indi()
    script = replace(SCENARIO, duration_s=10.0)
    found = predict(law, VEHICLE, script)
    assert found is not None
    assert found.seen_rmse is not None
    squares = []
    for seed in range(1, 5):
        flown = fly_direct(script, law, vehicle=VEHICLE, seed=seed)
        x = np.zeros(law.order)
        for gyro in flown["gyro_B"]:
            x, _ = step(law, x, np.concatenate([gyro, np.zeros(3)]))
            squares.append(x[:3] ** 2)
    assert math.sqrt(np.mean(squares)) == pytest.approx(found.seen_rmse, rel=0.1)
    assert found.seen_rmse < found.rmse  # the drift is not seen


def test_a_law_without_an_attitude_sees_none() -> None:
    assert foretell(load_law("hinf-d1")).seen_rmse is None
