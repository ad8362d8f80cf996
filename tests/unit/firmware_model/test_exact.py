import math
from fractions import Fraction

import numpy as np
import pytest

from firmware_model.exact import exp, multiply, power, right_inverse, sin_cos, tangent


@pytest.mark.parametrize("x", [-40.0, -1.0, -1e-9, 0.0, 1e-300, 0.1, 1.0, 5.0])
def test_exp_is_within_a_bit_of_the_c_library(x: float) -> None:
    assert abs(exp(x) - math.exp(x)) <= math.ulp(math.exp(x))


def test_exp_of_one_is_the_double_nearest_to_e() -> None:
    assert exp(1.0) == 2.718281828459045


@pytest.mark.parametrize(
    ("x", "exponent", "expected"), [(4.0, 0.5, 2.0), (2.0, 10.0, 1024.0), (2.0, 0.5, math.sqrt(2))]
)
def test_power_is_rounded_once(x: float, exponent: float, expected: float) -> None:
    assert power(x, exponent) == expected


@pytest.mark.parametrize("x", [-7.0, -math.pi, -0.3, 0.0, 1e-12, 0.5, math.pi / 2, 3.0, 6.28])
def test_sine_cosine_and_tangent_are_within_a_bit_of_the_c_library(x: float) -> None:
    sine, cosine = sin_cos(x)
    assert abs(sine - math.sin(x)) <= math.ulp(math.sin(x))
    assert abs(cosine - math.cos(x)) <= math.ulp(math.cos(x))
    assert tangent(x) == sine / cosine


def test_product_keeps_what_a_sum_of_doubles_cancels() -> None:
    A = [[1e16, 1.0, -1e16], [0.1, 0.2, 0.3]]
    B = [[1.0], [1.0], [1.0]]
    exact = Fraction(0.1) + Fraction(0.2) + Fraction(0.3)
    assert multiply(A, B).tolist() == [[1.0], [float(exact)]]


def test_inverse_of_a_square_matrix_is_rounded_from_the_exact_one() -> None:
    hilbert = [[1.0, 0.5], [0.5, 0.25 + 2.0**-40]]  # determinant 2^-40
    assert right_inverse(hilbert).tolist() == [[2.0**38 + 1.0, -(2.0**39)], [-(2.0**39), 2.0**40]]


def test_inverse_of_a_wide_matrix_is_the_pseudo_inverse() -> None:
    A = np.random.default_rng(1).normal(size=(4, 8))
    np.testing.assert_allclose(right_inverse(A), np.linalg.pinv(A), rtol=0.0, atol=1e-13)


def test_linearly_dependent_rows_have_no_inverse() -> None:
    with pytest.raises(ZeroDivisionError):
        right_inverse([[1.0, 2.0, 3.0], [2.0, 4.0, 6.0]])
