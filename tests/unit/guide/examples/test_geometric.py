"""The geometric PID by hand."""

import math

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.guide.examples.geometric import GeometricGains, GeometricPid

PAPER, DT = load_vehicle("paper"), 0.004
GAINS = GeometricGains(attitude=9.0, rate=7.0, integral=8.0, acceleration=0.5, cutoff=10.0)


def test_torque_of_two_samples_by_hand():
    flying, J = GeometricPid(PAPER, [GAINS] * 3), np.array(PAPER.inertia_B)
    flying.step((0.2, -0.1, 0.3), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), DT)
    found = flying.step((0.4, -0.2, 0.1), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), DT)
    first, second = np.array([0.2, -0.1, 0.3]), np.array([0.4, -0.2, 0.1])
    # e_R is the sine of the turn about its axis; two small turns add up to second order
    e_first, e_second = 0.5 * DT * first, DT * first + 0.5 * DT * second
    e_I = DT * (first + 9.0 / 7.0 * e_first)
    share = 1.0 - math.exp(-2.0 * math.pi * 10.0 * DT)
    acceleration = share * (second - share * first) / DT
    spring = 9.0 * e_second + 7.0 * second + 8.0 * e_I + 0.5 * acceleration
    assert found == pytest.approx(-J * spring + np.cross(second, J * second), rel=1e-5)


def test_integral_of_a_saturated_axis_is_emptied():
    flying, level = GeometricPid(PAPER, [GAINS] * 3), (0.0, 0.0, 0.0)
    for _ in range(250):
        assert flying.step((30.0, 0.0, 0.0), level, level, DT)[0] == -PAPER.torque_limit[0]
    # without back-calculation the integral would ask for .25 * 8 * 30 N m
    assert abs(flying._e_I[0]) < 0.25 * 30.0


def test_torque_towards_a_far_reference_is_that_of_the_rate_limit():
    flying, limit = GeometricPid(PAPER, [GAINS] * 3), PAPER.stabilizer.rate_limit
    level, steep = (0.0, 0.0, 0.0), GeometricGains(attitude=90.0, rate=7.0, integral=8.0, acceleration=0.0, cutoff=10.0)
    near = flying.step(level, (1.2, 0.0, 0.0), level, DT)
    assert near[0] == pytest.approx(9.0 * PAPER.inertia_B[0] * math.sin(1.2))
    far = GeometricPid(PAPER, [steep] * 3).step(level, (1.2, 0.0, 0.0), level, DT)
    assert far == pytest.approx((7.0 * PAPER.inertia_B[0] * limit, 0.0, 0.0), abs=1e-12)
