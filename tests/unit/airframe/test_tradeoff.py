"""The convex trade-off: its laws have what it says, it meets the limits at its ends, and no law of ours is below it."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.covariance import axis_models
from gustproof.airframe.limits import output_feedback_limit
from gustproof.airframe.predict import predict
from gustproof.airframe.tradeoff import linear_laws, orthonormal_basis
from gustproof.errors import DesignError
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import measure
from gustproof.law.cascade import AxisLaw, cascade_law
from gustproof.law.form import Provenance, load_law

VEHICLE, SCENARIO = load_vehicle("paper"), load_scenario("paper-turbulence")
MODELS = axis_models(VEHICLE, SCENARIO)


def test_the_functions_are_orthonormal() -> None:
    bank = orthonormal_basis(np.array([0.3, 0.9, 0.9, 0.99, 0.3]), 0.004)
    # Over time: what the first output has at 0 only, the others never have there.
    gramian = scipy.linalg.solve_discrete_lyapunov(bank.A, bank.B @ bank.B.T)
    np.testing.assert_allclose(bank.C @ gramian @ bank.C.T + bank.D @ bank.D.T, np.eye(6), atol=1e-12)


def test_more_functions_lower_the_curve_until_it_settles() -> None:
    few, more, many = (linear_laws(MODELS, functions=n).minimize_error(1.36, 20.0).rmse for n in (12, 24, 36))
    assert few > more > many > output_feedback_limit(MODELS, 20.0).rmse
    assert more < 1.01 * many


def test_it_hardly_matters_which_law_is_at_the_centre() -> None:
    here, there = (linear_laws(MODELS, around=around).minimize_error(1.36, 20.0).rmse for around in (2.0, 100.0))
    assert here == pytest.approx(there, rel=1e-3)


def test_a_bound_that_does_not_bind_leaves_the_limit() -> None:
    point = linear_laws(MODELS, functions=4).minimize_error(10.0, 20.0)
    limit = output_feedback_limit(MODELS, 20.0)
    assert point.rmse == pytest.approx(limit.rmse, rel=1e-4)
    assert point.sensitivity_peak > 3.0


def test_each_point_keeps_its_bounds_and_uses_them() -> None:
    peaks = (1.2, 1.36, 1.6)
    laws = linear_laws(MODELS, functions=24)
    points = [laws.minimize_error(peak, 20.0) for peak in peaks]
    for point, peak in zip(points, peaks, strict=True):
        assert point.sensitivity_peak == pytest.approx(peak, rel=1e-3)
        assert point.slew == pytest.approx(20.0, rel=1e-4)
    assert points[0].rmse > points[1].rmse > points[2].rmse


@pytest.mark.parametrize(("name", "room"), [("pid-fair", 0.25), ("indi", 0.15)])
def test_the_baselines_are_above_the_curve_at_their_price(name: str, room: float) -> None:
    foretold = predict(load_law(name), VEHICLE, SCENARIO)
    assert foretold is not None
    # Their sensitivity peak is 1.36 on each axis.
    assert linear_laws(MODELS, functions=24).minimize_error(1.36, foretold.slew).rmse < (1.0 - room) * foretold.rmse


def test_what_a_grid_of_frequencies_misses_is_kept_back() -> None:
    late = axis_models(VEHICLE, replace(SCENARIO, delay_samples=6))
    assert linear_laws(late, functions=24).minimize_error(1.36, 20.0).sensitivity_peak <= 1.001 * 1.36


def test_a_law_of_the_curve_flies_as_foretold() -> None:
    point = linear_laws(MODELS, functions=12).minimize_error(1.36, 20.0)
    order = 2 + max(K.order for K in point.controllers)
    axes = []
    for K in point.controllers:
        # In front an attitude and a rate of its own, as the law form has them, behind what fills up; both unused.
        own = slice(2, 2 + K.order)
        A, B, C = np.zeros((order, order)), np.zeros((order, 2)), np.zeros((1, order))
        A[own, own], B[own, :1], C[:, own] = K.A, K.B, K.C
        D = np.hstack([K.D, np.zeros((1, 1))])
        axes.append(AxisLaw(A=A, B=B, C=C, D=D, G=np.zeros((order, 1)), H=np.zeros((order, 1))))
    law = cascade_law("best", axes, VEHICLE, SCENARIO.dt, Provenance(design="test", vehicle="paper"))
    flights = [
        measure(fly_direct(SCENARIO, law, vehicle=VEHICLE, seed=seed), VEHICLE, SCENARIO, 1.0) for seed in range(20)
    ]
    # As in the test of the model: walks scatter by .58 / sqrt(3 * 20) in the root.
    flown = math.sqrt(np.mean([flight.rmse_deg**2 for flight in flights]))
    assert flown == pytest.approx(math.degrees(point.rmse), rel=0.2)
    assert np.mean([flight.torque_slew_rms for flight in flights]) == pytest.approx(20.0, rel=0.01)


def test_demands_that_no_law_meets_are_refused() -> None:
    with pytest.raises(DesignError, match=r"no law found at sensitivity peak 1\.02"):
        linear_laws(MODELS, functions=12).minimize_error(1.02, 1.5)
