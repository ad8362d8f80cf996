"""The cost of an axis by hand, and its slope."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gustproof.logs.identify.likelihood import (
    DAMPING,
    DAMPING_PRIOR,
    DELAY,
    GAINS,
    AxisData,
    Fit,
    RatePrediction,
    axis_cost,
    linearise,
)
from gustproof.logs.identify.stretches import Stretch


@pytest.mark.parametrize("damping", [0.0, DAMPING_PRIOR, 3.0 * DAMPING_PRIOR])
def test_cost_is_minus_the_log_likelihood_of_normal_errors_and_of_the_prior(damping):
    theta = np.zeros(GAINS + 1)
    theta[DAMPING], theta[GAINS] = damping, 0.5
    errors, variance = np.array([[2.0, 2.0], [-1.0, 4.0], [0.5, -1.0]]), np.array([4.0, 0.25, 1.0])
    left = np.array([1.0, -3.0, 1.0])  # after the gain's share
    density = np.prod(np.exp(-0.5 * left**2 / variance) / np.sqrt(variance))  # times (2 pi)^(-3/2)
    prior = math.exp(-0.5 * (damping / DAMPING_PRIOR) ** 2)
    found = RatePrediction(response=np.zeros((3, 1)), errors=errors, variance=variance)
    assert axis_cost(theta, found) == pytest.approx(-math.log(density * prior))


def test_the_score_is_the_slope_of_the_cost_by_each_parameter():
    n, rng = 60, np.random.default_rng(5)
    time = 0.004 * np.arange(n)
    stretch = Stretch(
        command_time=time, command=np.column_stack([rng.standard_normal(n), np.ones(n)]), gyro_time=time,
        bins=np.arange(n), time=time, count=np.ones(n), rate=0.1 * rng.standard_normal((n, 3)),
    )  # fmt: skip
    data = AxisData(stretches=[stretch], axis=1, channels=[0, 1], square=False)
    theta = np.array([math.log(0.03), 0.0043, 0.8, *np.log([1e-2, 0.7, 3.0, 20.0, 50.0]), 2.0, 0.1])
    score = linearise(data, theta, data.predict(theta)).scores.sum(axis=0)
    score[DAMPING] -= theta[DAMPING] / DAMPING_PRIOR**2  # of the prior
    for i in range(data.size):
        step = 1e-5 * np.eye(data.size)[i]
        costs = [axis_cost(near, data.predict(near)) for near in (theta - step, theta + step)]
        assert score[i] == pytest.approx((costs[0] - costs[1]) / 2e-5, rel=5e-3, abs=5e-3)


@pytest.mark.parametrize(("command", "low", "high"), [(0.0, 0.999, 1.001), (30.0, 0.0, 0.1)])
def test_a_delay_is_assumed_as_far_as_the_command_moves_too_little(command: float, low: float, high: float) -> None:
    n, rng = 200, np.random.default_rng(6)
    time = 0.004 * np.arange(n)
    stretch = Stretch(
        command_time=time, command=np.column_stack([command * rng.standard_normal(n), np.ones(n)]), gyro_time=time,
        bins=np.arange(n), time=time, count=np.ones(n), rate=0.1 * rng.standard_normal((n, 3)),
    )  # fmt: skip
    data = AxisData(stretches=[stretch], axis=1, channels=[0, 1], square=False)
    theta = np.array([math.log(0.03), 0.0043, 0.8, *np.log([1e-2, 0.7, 3.0, 20.0, 50.0]), 2.0, 0.1])
    fit = Fit(theta=theta, axes=[data], found=[data.predict(theta)], cost=0.0, free=np.ones(data.size, dtype=bool))
    assert low <= fit.assumed_delay() <= high
    assert replace(fit, free=np.arange(data.size) != DELAY).assumed_delay() == 0.0
