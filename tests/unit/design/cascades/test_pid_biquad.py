"""The shaped cascade: its realisations agree, and its search's slopes are those of its figures."""

import dataclasses
import math

import numpy as np
import pytest

from firmware_model.config.scenario import GyroFault, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import MomentStep
from gustproof.airframe.covariance import axis_models, axis_performance
from gustproof.design.cascades.biquad_search import AxisSearch
from gustproof.design.cascades.pid_biquad import BiquadGains, biquad_axis, biquad_response
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import attitude
from gustproof.law.cascade import cascade_law
from gustproof.law.form import Provenance

SHAPE = BiquadGains(
    angle_p=18.0, gain=28.0, lead_frequency=9.6, lead_damping=0.66, cutoff=115.0,
    zero_frequency=372.0, zero_damping=1.17, pole_frequency=170.0, pole_damping=0.27,
)  # fmt: skip
DT = 0.004
WEIGHT = 1e-9


@pytest.fixture(scope="module")
def search():
    models = axis_models(load_vehicle("paper"), load_scenario("paper-turbulence"))
    return AxisSearch(models[0], 1.36, [(models[1], 2.0)])


def trapezoidal(omega):
    z = np.exp(1j * omega * DT)
    return 2.0 / DT * (z - 1.0) / (z + 1.0)


def test_the_law_has_the_response_of_the_formula():
    omega = np.geomspace(0.1, 700.0, 50)
    law = biquad_axis(SHAPE, 0.25, DT)
    told = law.controller(DT).response(omega)[:, 0, 0]
    formula, _ = biquad_response(np.array(SHAPE), trapezoidal(omega))
    np.testing.assert_allclose(told, -0.25 * formula, rtol=1e-9)


def test_well_below_the_sample_rate_the_formula_is_the_cascade_written_out():
    s = 1j * np.geomspace(0.1, 20.0, 30)
    q = [s**2 + 2.0 * zeta * w * s + w**2 for w, zeta in (SHAPE[2:4], SHAPE[5:7], SHAPE[7:9])]
    written = SHAPE.gain * q[0] * q[1] / (s * (s + SHAPE.cutoff) * q[2]) * (1.0 + SHAPE.angle_p / s)
    told, _ = biquad_response(np.array(SHAPE), trapezoidal(s.imag))
    np.testing.assert_allclose(told, written, rtol=2e-3)  # (20 rad/s * 4 ms)^2 / 12 = 5e-4, a few times over


def test_slopes_of_response_cost_and_margins_are_those_of_differences(search):
    z = np.log(np.array(SHAPE))
    along = np.random.default_rng(1).normal(size=9)

    def slope(figure):
        return (figure(z + 1e-6 * along) - figure(z - 1e-6 * along)) / 2e-6

    assert search.cost(z, WEIGHT)[1] @ along == pytest.approx(slope(lambda z: search.cost(z, WEIGHT)[0]), rel=1e-6)
    room, slopes = search.margins(z)
    assert slopes.shape == (len(room), 9)
    np.testing.assert_allclose(slopes @ along, slope(lambda z: search.margins(z)[0]), rtol=1e-5, atol=1e-8)


def test_the_search_judges_a_shape_by_the_figures_of_its_law(search):
    model = axis_models(load_vehicle("paper"), load_scenario("paper-turbulence"))[0]
    figures = axis_performance(model, biquad_axis(SHAPE, model.inertia, DT))
    cost = math.log(figures.rmse**2 + WEIGHT * figures.slew**2)
    assert search.cost(np.log(np.array(SHAPE)), WEIGHT)[0] == pytest.approx(cost, rel=1e-9)
    room = search.margins(np.log(np.array(SHAPE)))[0][:120]
    assert 1.36 * math.exp(-np.min(room)) * (1.0 - 1e-3) == pytest.approx(figures.sensitivity_peak, rel=1e-3)


def test_an_unstable_loop_costs_more_than_any_sound_one(search):
    cost, slopes = search.cost(np.log(np.array(SHAPE._replace(gain=3000.0))), WEIGHT)
    assert cost > search.cost(np.log(np.array(SHAPE)), WEIGHT)[0] + 100.0
    assert np.all(np.isfinite(slopes))


def test_which_zeros_are_whose_does_not_change_the_law():
    swapped = SHAPE._replace(lead_frequency=372.0, lead_damping=1.17, zero_frequency=9.6, zero_damping=0.66)
    assert swapped.sort_zeros() == SHAPE == SHAPE.sort_zeros()
    omega = np.geomspace(0.1, 700.0, 20)
    told = [biquad_axis(shape, 0.25, DT).controller(DT).response(omega) for shape in (SHAPE, swapped)]
    np.testing.assert_allclose(told[0], told[1], rtol=1e-9)


def test_after_more_moment_than_the_limit_holds_the_integral_has_not_wound_up():
    vehicle, scenario = load_vehicle("paper"), load_scenario("calm")
    blow = [
        MomentStep(kind="step", amplitude_nm=(sign * 9.0, sign * 9.0, 0.0), start_s=at)
        for sign, at in ((1, 0.5), (-1, 1))
    ]
    scenario = dataclasses.replace(scenario, duration_s=4.0, gyro=GyroFault(noise=False), moment=tuple(blow))
    axes = [biquad_axis(SHAPE, inertia, DT) for inertia in vehicle.inertia_B]
    law = cascade_law("test", axes, vehicle, DT, Provenance(design="test", vehicle="paper"))
    ends = []
    for each in (law, dataclasses.replace(law, H=np.zeros_like(law.H))):
        records = fly_direct(scenario, each, vehicle=vehicle)
        assert np.max(np.abs(records["torque_command_B"])) == 10.0
        ends.append(np.max(np.abs(np.degrees(attitude(records)[3 * 250 :]))))
    assert ends[0] < 0.5
    assert ends[1] > 90.0
