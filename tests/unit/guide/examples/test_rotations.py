"""Rotations in scalars against SciPy's, and by hand."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gustproof.guide.examples.rotations import (
    LEVEL,
    RotationEstimate,
    rotation_error,
    rotation_matrix,
    rotation_vector,
    shorten,
)

DRAWN = Rotation.random(20, rng=np.random.default_rng(1))


def as_tuple(rotation):
    return tuple(rotation.as_matrix().ravel().tolist())


def test_estimate_turns_exactly_at_a_constant_rate():
    estimate, rate, dt = RotationEstimate(), (1.0, -2.0, 0.5), 0.004
    for _ in range(400):
        found = estimate.update(rate, dt)
    # the first step is from rest: half of one
    expected = Rotation.from_rotvec(399.5 * dt * np.array(rate)).as_matrix()
    assert np.reshape(found, (3, 3)) == pytest.approx(expected, abs=1e-12)
    estimate.reset()
    assert estimate.update((0.0, 0.0, 0.0), dt) == LEVEL


def test_small_and_large_turns_meet():
    for angle in (0.9e-3, 1.1e-3):
        estimate = RotationEstimate()
        found = estimate.update((0.0, 2.0 * angle / 0.01, 0.0), 0.01)
        assert found[2] == pytest.approx(math.sin(angle), rel=1e-13)


def test_rotation_matrix_is_of_zyx_angles():
    euler = (0.3, -0.5, 2.0)
    expected = Rotation.from_euler("ZYX", euler[::-1]).as_matrix()
    assert np.reshape(rotation_matrix(euler), (3, 3)) == pytest.approx(expected, abs=1e-15)


def test_errors_of_a_quarter_turn_by_hand():
    quarter = rotation_matrix((math.pi / 2, 0.0, 0.0))
    assert rotation_error(quarter, LEVEL) == pytest.approx((1.0, 0.0, 0.0))
    assert rotation_error(LEVEL, quarter) == pytest.approx((-1.0, 0.0, 0.0))
    assert rotation_vector(quarter, LEVEL) == pytest.approx((math.pi / 2, 0.0, 0.0))


def test_errors_of_drawn_rotations():
    for R, R_d in zip(DRAWN[:10], DRAWN[10:], strict=True):
        E = R_d.as_matrix().T @ R.as_matrix()
        vee = 0.5 * np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]])
        assert rotation_error(as_tuple(R), as_tuple(R_d)) == pytest.approx(vee, abs=1e-14)
        expected = (R_d.inv() * R).as_rotvec()
        assert rotation_vector(as_tuple(R), as_tuple(R_d)) == pytest.approx(expected, abs=1e-12)


def test_only_a_long_vector_is_shortened():
    assert shorten((0.1, 0.2, -0.2), 0.31) == (0.1, 0.2, -0.2)
    assert shorten((3.0, 0.0, -4.0), 1.0) == pytest.approx((0.6, 0.0, -0.8))
