"""The flagship: the best at its price, sound where the vehicle is off, and better than the fair PID in flight."""

import dataclasses
import itertools
import math
import statistics

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.covariance import AxisPerformance, axis_models, axis_performance
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.airframe.predict import predict
from gustproof.airframe.tradeoff import linear_laws
from gustproof.design.cascades.flagship import ROBUST_LIMITS, SHIPPED_LIMITS, flagship_law, tune_flagship
from gustproof.design.cascades.pid_biquad import BiquadGains, biquad_axis
from gustproof.design.cascades.tuning import SPREADS, corner_vehicles
from gustproof.errors import DesignError
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import measure
from gustproof.flight.scoring.requirements import judge
from gustproof.law.form import load_law
from gustproof.robust.lti.margins import margins
from gustproof.studies.rate.law_margins import hover_margins

AXES = ("roll", "pitch", "yaw")


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("paper")


@pytest.fixture(scope="module")
def turbulence():
    return load_scenario("paper-turbulence")


@pytest.fixture(scope="module")
def shapes():
    """Those of the shipped law, which `test_shipped` derives again."""
    parameters = load_law("flagship").provenance.parameters
    return [BiquadGains(*(parameters[f"{axis}_{name}"] for name in BiquadGains._fields)) for axis in AXES]


def judged(model, shape) -> AxisPerformance:
    return axis_performance(model, biquad_axis(shape, model.inertia, model.plant.dt))


def flown(law, scenario, vehicle, seeds=(1, 2, 3)):
    return [measure(fly_direct(scenario, law, vehicle=vehicle, seed=seed), vehicle, scenario, 1.0) for seed in seeds]


def test_the_price_is_kept_and_fully_spent(vehicle, turbulence, shapes):
    figures = [judged(model, shape) for model, shape in zip(axis_models(vehicle, turbulence), shapes, strict=True)]
    assert 1.355 < max(each.sensitivity_peak for each in figures) <= SHIPPED_LIMITS.sensitivity_peak
    assert (
        0.999 * SHIPPED_LIMITS.slew
        < math.sqrt(statistics.mean(each.slew**2 for each in figures))
        <= SHIPPED_LIMITS.slew
    )


def test_at_the_corners_of_inertia_and_lag_the_peaks_are_kept(vehicle, turbulence, shapes):
    for corner in corner_vehicles(vehicle, SPREADS):
        for model, shape, inertia in zip(axis_models(corner, turbulence), shapes, vehicle.inertia_B, strict=True):
            peak = axis_performance(model, biquad_axis(shape, inertia, turbulence.dt)).sensitivity_peak
            # the grid of the search holds .1 % back, and a corner's peak is sharper than that of the vehicle's own
            assert peak <= 1.005 * SHIPPED_LIMITS.corner_peak


@pytest.mark.slow
def test_no_neighbour_of_the_shapes_is_better_at_the_same_price(vehicle, turbulence, shapes):
    models = axis_models(vehicle, turbulence)
    off = [axis_models(corner, turbulence) for corner in corner_vehicles(vehicle, SPREADS)]
    at_best = [judged(model, shape) for model, shape in zip(models, shapes, strict=True)]
    spent = sum(each.slew**2 for each in at_best)
    rng, feasible = np.random.default_rng(1), 0
    for axis, size in itertools.product(range(3), np.geomspace(1e-4, 0.1, 40)):
        other = BiquadGains(*(np.array(shapes[axis]) * np.exp(size * rng.normal(size=9))).tolist())
        law = biquad_axis(other, models[axis].inertia, turbulence.dt)
        figures = axis_performance(models[axis], law)
        kept = figures.sensitivity_peak <= SHIPPED_LIMITS.sensitivity_peak and figures.slew <= at_best[axis].slew
        if kept and all(axis_performance(m[axis], law).sensitivity_peak <= SHIPPED_LIMITS.corner_peak for m in off):
            feasible += 1
            # .1 % of the peaks is kept back from the search; it is worth less than .1 % of error.
            assert figures.rmse >= at_best[axis].rmse * (1.0 - 1e-3)
    assert spent <= 3.0 * SHIPPED_LIMITS.slew**2
    assert feasible > 3


def test_no_linear_law_of_any_order_has_three_percent_less_error_at_that_price(vehicle, turbulence, shapes):
    models = axis_models(vehicle, turbulence)
    figures = [judged(model, shape) for model, shape in zip(models, shapes, strict=True)]
    ours = math.sqrt(statistics.mean(each.rmse**2 for each in figures))
    least = linear_laws(models).minimize_error(SHIPPED_LIMITS.sensitivity_peak, SHIPPED_LIMITS.slew).rmse
    assert 0.97 * ours < least < ours


def test_demands_that_no_shape_meets_are_refused(vehicle, turbulence):
    demands, corners = dataclasses.replace(SHIPPED_LIMITS, corner_peak=1.01), corner_vehicles(vehicle, SPREADS)
    with pytest.raises(DesignError, match=r"no shaped cascade found at sensitivity peak 1\.36, 1\.01 off nominal"):
        tune_flagship(vehicle, turbulence, demands, corners)


def test_it_holds_attitude_better_than_the_fair_pid_at_the_same_price(vehicle, turbulence):
    laws = [load_law(name) for name in ("flagship", "pid-fair")]
    flights = [flown(law, turbulence, vehicle) for law in laws]
    ours, fair = (statistics.median(flight.rmse_deg for flight in each) for each in flights)
    assert ours <= 0.8 * fair
    assert statistics.median(flight.torque_slew_rms for flight in flights[0]) <= 20.0
    margins = [hover_margins(law, vehicle, turbulence) for law in laws]
    assert max(each.Ms for each in margins) <= 1.36


def test_with_actuators_of_more_than_twice_the_lag_it_holds_attitude(turbulence, vehicle):
    slow = dataclasses.replace(vehicle, actuator_lag=0.12)
    assert max(flight.rmse_deg for flight in flown(load_law("flagship"), turbulence, slow)) <= 0.2


def test_coning_does_not_turn_it(vehicle):
    flights = flown(load_law("flagship"), load_scenario("coning"), vehicle, seeds=(1,))
    assert flights[0].peak_roll_deg <= 0.01


def test_it_follows_steps_of_the_reference_without_reaching_its_limits(vehicle):
    scenario = load_scenario("attitude-steps")
    records = fly_direct(scenario, load_law("flagship"), vehicle=vehicle)
    assert all(result.is_met for result in judge(records, scenario, vehicle))
    assert np.max(np.abs(records["torque_command_B"])) <= 5.0


@pytest.mark.slow
def test_robust_flagship_is_as_robust_as_the_fair_pid_and_better_in_error(vehicle, turbulence):
    law = flagship_law(vehicle, turbulence, name="flagship-robust", limits=ROBUST_LIMITS)
    fair = load_law("pid-fair")
    plant = hover_plant(vehicle, turbulence)
    ours, theirs = (margins(plant, loop_law(each)).input for each in (law, fair))
    assert min(axis.gain_margin for axis in ours) >= max(7.3, min(axis.gain_margin for axis in theirs))
    delays = [
        min(axis.delay_margin for axis in axes) / turbulence.dt + turbulence.delay_samples for axes in (ours, theirs)
    ]
    assert delays[0] >= max(11.0, delays[1])
    assert max(axis.Ms for axis in ours) <= 1.36
    cost, fair_cost = predict(law, vehicle, turbulence), predict(fair, vehicle, turbulence)
    assert cost.slew <= fair_cost.slew
    assert math.degrees(cost.rmse) <= 0.097 < 0.86 * math.degrees(fair_cost.rmse)
