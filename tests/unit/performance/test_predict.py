"""What is foretold of whole laws is what is foretold of their axes, and what flies."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.law.cascade import cascade_law
from gustproof.law.form import Law, load_law
from gustproof.performance.covariance import axis_models, axis_performance
from gustproof.performance.predict import predict
from gustproof.scoring.metrics import measure
from gustproof.simulate.direct import fly_direct
from gustproof.synthesis.pid.indi import IndiGains, indi_axis

VEHICLE, SCENARIO = load_vehicle("paper"), load_scenario("paper-turbulence")


def test_three_axes_at_once_are_three_axes() -> None:
    gains = IndiGains(angle_p=4.0, rate_p=12.0, cutoff=20.0, damping=0.5)
    axes = [indi_axis(gains, inertia, VEHICLE.actuator_lag, 1, SCENARIO.dt) for inertia in VEHICLE.inertia_B]
    law = cascade_law("test", axes, VEHICLE, SCENARIO.dt, load_law("indi").provenance)
    each = [axis_performance(m, axis) for m, axis in zip(axis_models(VEHICLE, SCENARIO), axes, strict=True)]
    whole = predict(law, VEHICLE, SCENARIO)
    assert whole is not None
    assert whole.rmse == pytest.approx(math.sqrt(np.mean([axis.rmse**2 for axis in each])), rel=1e-9)
    assert whole.slew == pytest.approx(math.sqrt(np.mean([axis.slew**2 for axis in each])), rel=1e-9)


def levelled(law: Law) -> Law:
    """Return the law with a torque of its own against the attitude that the accelerometer tells of, at hover."""
    toward_level = np.array([[-2.943, 0.0], [0.0, -1.962], [0.0, 0.0]])
    B, D = np.hstack([law.B, np.zeros((law.order, 2))]), np.hstack([law.D, toward_level])
    return replace(law, B=B, D=D, rate_limit=None)


@pytest.mark.compiled
@pytest.mark.parametrize("law", [load_law("hinf-scheduled"), load_law("indi"), levelled(load_law("pid-fair"))])
def test_what_is_foretold_flies(law: Law) -> None:
    vehicle = replace(VEHICLE, accelerometer=replace(VEHICLE.accelerometer, noise_density=0.005))
    foretold = predict(law, vehicle, SCENARIO)
    assert foretold is not None
    flights = [
        measure(fly_direct(SCENARIO, law, vehicle=vehicle, seed=seed), vehicle, SCENARIO, 1.0) for seed in range(20)
    ]
    # 60 independent walks and turbulences: the root of their mean square scatters by some 8 %.
    flown = math.sqrt(np.mean([flight.rmse_deg**2 for flight in flights]))
    assert flown == pytest.approx(math.degrees(foretold.rmse), rel=0.2)
    assert np.mean([flight.torque_slew_rms for flight in flights]) == pytest.approx(foretold.slew, rel=0.01)


def test_the_accelerometer_bounds_the_attitude_that_gyros_let_walk() -> None:
    long = replace(SCENARIO, duration_s=600.0)
    gyros, level = (predict(law, VEHICLE, long) for law in (load_law("pid-fair"), levelled(load_law("pid-fair"))))
    assert gyros is not None
    assert level is not None
    assert level.rmse < gyros.rmse


def test_a_law_of_rates_has_no_torque_to_foretell() -> None:
    assert predict(load_law("hinf-rates"), VEHICLE, SCENARIO) is None
