"""Rotations against what a quarter turn does, and against scipy."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from firmware_model.numerics.rotations import (
    conjugate,
    euler_angles,
    from_euler,
    from_rotation_vector,
    multiply,
    rotate,
    to_euler,
)

QUARTER = math.pi / 2.0
CLOSE = 1e-15
"""A few roundings of numbers near 1."""


@pytest.mark.parametrize(
    ("turn_B", "v_B", "v_N"),
    [
        ((QUARTER, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),  # roll right: the right wing points down
        ((0.0, QUARTER, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),  # pitch up: the nose points up
        ((0.0, 0.0, QUARTER), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),  # yaw right: the nose points east
    ],
)
def test_a_quarter_turn_takes_the_axis_where_a_pilot_expects_it(
    turn_B: tuple[float, float, float], v_B: tuple[float, float, float], v_N: tuple[float, float, float]
) -> None:
    q_NB = from_rotation_vector(turn_B)
    np.testing.assert_allclose(rotate(q_NB, v_B), v_N, atol=CLOSE)
    np.testing.assert_allclose(rotate(conjugate(q_NB), v_N), v_B, atol=CLOSE)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turn_about_one_axis_is_that_euler_angle(axis: int) -> None:
    turn = [0.0, 0.0, 0.0]
    turn[axis] = 0.3
    np.testing.assert_allclose(to_euler(from_rotation_vector((turn[0], turn[1], turn[2]))), turn, atol=CLOSE)


def test_euler_angles_agree_with_scipy() -> None:
    rng = np.random.default_rng(1)
    angles = rng.uniform([-3.0, -1.5, -3.0], [3.0, 1.5, 3.0], size=(300, 3))
    quaternions = np.array([from_euler(*row) for row in angles])
    reference = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat(scalar_first=True)
    reference *= np.sign(np.sum(reference * quaternions, axis=1, keepdims=True))
    np.testing.assert_allclose(quaternions, reference, atol=CLOSE)
    # Near theta = 90 deg the arc sine magnifies roundings by 1 / cos(theta) squared.
    np.testing.assert_allclose([to_euler(tuple(q)) for q in quaternions], angles, atol=1e-13)


def test_the_product_rotates_by_the_second_factor_first() -> None:
    a, b, v = from_euler(0.1, 0.2, 0.3), from_euler(-0.4, 0.5, 0.6), (1.0, 2.0, 3.0)
    np.testing.assert_allclose(rotate(multiply(a, b), v), rotate(a, rotate(b, v)), atol=4 * CLOSE)


def test_euler_angles_of_a_history_have_yaw_without_jumps() -> None:
    psi = np.linspace(0.0, 12.0, 500)
    history = np.array([from_euler(0.0, 0.0, value) for value in psi])
    np.testing.assert_allclose(euler_angles(history), np.column_stack([0.0 * psi, 0.0 * psi, psi]), atol=1e-14)
