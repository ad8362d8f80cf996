"""The limits: the recursions written out agree, no law is below them, and they move as delay, noise and slew do."""

import dataclasses
import math

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.covariance import AxisModel, augmented_axis, axis_models
from gustproof.airframe.limits import central_controller, full_information_limit, output_feedback_limit
from gustproof.airframe.predict import predict
from gustproof.errors import DesignError
from gustproof.law.form import load_law


def models(**changes: int) -> tuple[AxisModel, AxisModel, AxisModel]:
    scenario = dataclasses.replace(load_scenario("paper-turbulence"), **changes)
    return axis_models(load_vehicle("paper"), scenario)


def least_cost(model: AxisModel, weight: float, *, noisy: bool) -> float:
    """Return the least mean of squared attitude and weighted change of command that any causal law has, from rest.

    Kalman's filter forward and the regulator backward, step by step with gains that vary (Astrom, Introduction to
    Stochastic Control Theory, 1970, chapter 8); where not `noisy`, the state is known.
    """
    flight = augmented_axis(model)
    A, B, C, noise = flight.A, flight.B[:, -1:], flight.C[2:], flight.B[:, :-1]
    W, n, last = noise @ noise.T, flight.order, -flight.C[1:2]
    P = np.zeros((n, n))
    P[n - model.gust.order :, n - model.gust.order :] = model.gust_covariance
    start, filtered = P, []
    for _ in range(model.samples):
        known = P @ C.T @ C @ P / (C @ P @ C.T + model.noise**2) if noisy else P
        filtered.append(P - known)
        P = A @ filtered[-1] @ A.T + W
    S, cost = np.zeros((n, n)), 0.0
    for P in reversed(filtered):
        price = weight + (B.T @ S @ B)[0, 0]
        F = (B.T @ S @ A - weight * last) / price
        cost += price * (F @ P @ F.T)[0, 0] + np.sum(S * W)
        S = flight.C[:1].T @ flight.C[:1] + weight * last.T @ last + A.T @ S @ A - price * F.T @ F
    return float((cost + np.sum(S * start)) / model.samples)


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "noisy"), [(output_feedback_limit, True), (full_information_limit, False)])
def test_gains_that_vary_with_time_are_hardly_better(limit, noisy) -> None:
    axis = models()[:1]
    found = limit(axis, 20.0)
    cost = found.rmse**2 + found.weight * (found.slew * axis[0].plant.dt) ** 2
    least = least_cost(axis[0], found.weight, noisy=noisy)
    # By weak duality, least - weight change^2 bounds the squared error of every causal law at this slew.
    assert least < cost < 1.001 * least


@pytest.mark.parametrize("slew", [10.0, 20.0, 40.0])
def test_the_limits_stand_in_order_at_the_slew_asked_for(slew: float) -> None:
    axes = models()
    gyro, clairvoyant = output_feedback_limit(axes, slew), full_information_limit(axes, slew)
    assert gyro.slew == pytest.approx(slew, rel=1e-4)
    assert clairvoyant.slew == pytest.approx(slew, rel=1e-4)
    assert 0.0 < clairvoyant.rmse < gyro.rmse < output_feedback_limit(axes, 0.9 * slew).rmse


@pytest.mark.parametrize("name", ["pid-default", "pid-fair", "indi", "hinf-d2", "hinf-scheduled"])
def test_no_gyro_only_law_is_below_the_limit_at_its_slew(name: str) -> None:
    foretold = predict(load_law(name), load_vehicle("paper"), load_scenario("paper-turbulence"))
    assert foretold is not None
    assert foretold.rmse > output_feedback_limit(models(), foretold.slew).rmse


def test_with_slew_for_free_a_gyro_leaves_the_integral_of_its_noise() -> None:
    axes = models()
    walk = axes[0].noise * axes[0].plant.dt * math.sqrt(axes[0].samples / 2.0)
    # The gusts are strong against the noise: to filter it at the frequencies of the walk would let them through.
    assert output_feedback_limit(axes, math.inf).rmse == pytest.approx(walk, rel=1e-3)


def test_what_a_clairvoyant_leaves_is_the_delay() -> None:
    at_once, late, later = (full_information_limit(models(delay_samples=n), math.inf).rmse for n in (0, 1, 3))
    assert 0.0 < at_once < late < later


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_further_command_does_not_surprise_the_estimator(delay: int) -> None:
    axis = models(delay_samples=delay)[0]
    omega = np.geomspace(1.0, 700.0, 40)
    flight, J = augmented_axis(axis), central_controller(axis, 1e-6).response(omega)
    G = flight.response(omega)[:, 2, -1]
    answer = J[:, 1, 1] + J[:, 1, 0] * G * J[:, 0, 1] / (1.0 - G * J[:, 0, 0])
    np.testing.assert_allclose(answer, 0.0, atol=1e-9 * np.max(np.abs(J[:, 1, 0] * G * J[:, 0, 1])))


def test_too_little_slew_to_hold_attitude_is_refused() -> None:
    with pytest.raises(DesignError, match=r"no law holds attitude in this turbulence at slew 0\.001"):
        output_feedback_limit(models(), 0.001)
