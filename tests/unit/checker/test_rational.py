"""Exact arithmetic: definiteness to the last bit, and bounds on the right side of the functions they bound."""

import math
from fractions import Fraction

import numpy as np
import pytest

from gustproof.checker import rational
from gustproof.checker.rational import (
    cos_lower_bound,
    exp_lower_bound,
    identity,
    inverse,
    is_positive_definite,
    multiply,
    sin_upper_bound,
    sqrt_upper_bound,
    to_rational,
    transpose,
    zeros,
)


def test_a_float_is_the_rational_number_that_it_is():
    assert to_rational([[0.1]]) == [[Fraction(3602879701896397, 36028797018963968)]]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_not_a_number_is_refused(bad):
    with pytest.raises(ValueError, match="not finite"):
        to_rational([[bad]])


def test_an_inverse_is_exact_and_there_is_none_of_a_singular_matrix():
    A = to_rational([[0.0, 1e-300, 3.0], [7.0, 0.1, -2.0], [1.0, 0.5, 1e300]])
    assert multiply(A, inverse(A)) == multiply(inverse(A), A) == identity(3)
    with pytest.raises(ValueError, match="the matrix is singular"):
        inverse(to_rational([[1.0, 2.0], [0.5, 1.0]]))


def test_rows_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match="rows of different lengths"):
        to_rational([[1.0], [1.0, 2.0]])


def test_definiteness_is_decided_where_floating_point_cannot():
    tiny = Fraction(1, 10**40)
    assert is_positive_definite([[Fraction(1), Fraction(1)], [Fraction(1), 1 + tiny]])
    assert not is_positive_definite([[Fraction(1), Fraction(1)], [Fraction(1), Fraction(1)]])
    assert not is_positive_definite([[Fraction(1), Fraction(1)], [Fraction(1), 1 - tiny]])


def test_definiteness_agrees_with_eigenvalues():
    rng = np.random.default_rng(1)
    for shift in (-0.3, 0.0, 0.5, 3.0):
        for _ in range(20):
            S = rng.normal(size=(6, 6))
            S = S + S.T + shift * 3.0 * np.eye(6)
            assert is_positive_definite(to_rational(S.tolist())) == bool(np.linalg.eigvalsh(S)[0] > 0.0)


def test_short_numbers_prove_only_what_is_definite(monkeypatch):
    """The least eigenvalue is near 0, on either side, by more or less than the numbers can tell."""
    rng, proved = np.random.default_rng(2), 0
    monkeypatch.setattr(rational, "_BITS", 24)
    for exponent in range(4, 40):
        L = rng.integers(-9, 9, (4, 3))
        for sign in (-1, 1):
            middle = (2**40 * (L @ L.T) + sign * 2**exponent * np.eye(4, dtype=int)).tolist()
            short = rational._has_positive_pivots(middle)
            assert not short or sign > 0
            assert rational.is_positive_definite(to_rational(middle)) is (sign > 0)
            proved += short
    assert 5 < proved < 30


def test_short_numbers_prove_what_is_above_their_rounding(monkeypatch):
    assert rational._has_positive_pivots([[2]])
    assert not rational._has_positive_pivots([[1]])
    near = 2**50 * np.array([[2**100, 2**100], [2**100, 2**100 + 1]], dtype=object)  # no double tells it from singular
    assert rational._has_positive_pivots(near.tolist())
    monkeypatch.setattr(rational, "_BITS", 4)
    assert rational._has_positive_pivots([[1000, 0], [0, 500]])
    assert not rational._has_positive_pivots([[1000, 0], [0, 50]])


def test_minors_are_exact():
    assert rational._has_positive_minors([[1, 0], [0, 1]])
    assert not rational._has_positive_minors([[1, 1], [1, 1]])
    large, c = 3**80, 10**30
    for d in (c**2, c**2 + 1):  # the determinant is large * (d - c**2)
        matrix = [[large, large, 0], [large, large + 1, c], [0, c, d]]
        assert rational._has_positive_minors(matrix) == (d > c**2)


def test_an_asymmetric_matrix_is_refused():
    with pytest.raises(ValueError, match="not symmetric"):
        is_positive_definite(to_rational([[1.0, 0.5], [0.25, 1.0]]))


def test_products_and_transposes_are_those_of_matrices():
    A, B = to_rational([[1.0, 2.0], [3.0, 4.0]]), to_rational([[0.5], [-1.0]])
    assert multiply(A, B) == to_rational([[-1.5], [-2.5]])
    assert transpose(A) == to_rational([[1.0, 3.0], [2.0, 4.0]])
    assert multiply(A, identity(2)) == A
    assert multiply(A, zeros(2, 2)) == zeros(2, 2)


@pytest.mark.parametrize("x", [0.0, 0.01, 0.3, 0.7, 1.0])
def test_bounds_lie_on_their_side_and_close(x):
    for bound, true in ((sin_upper_bound(Fraction(x)), math.sin(x)), (sqrt_upper_bound(Fraction(x)), math.sqrt(x))):
        assert true - 1e-15 <= float(bound) <= true + 1e-6
    assert math.cos(x) - 1e-6 <= float(cos_lower_bound(Fraction(x))) <= math.cos(x) + 1e-15
    assert (
        math.exp(20.0 * x) * (1.0 - 1e-12)
        <= float(exp_lower_bound(Fraction(20.0 * x)))
        <= math.exp(20.0 * x) * (1 + 1e-12)
    )


def test_the_series_is_not_used_where_it_would_not_bound():
    with pytest.raises(ValueError, match=r"\[0, 1\]"):
        sin_upper_bound(Fraction(2))
    with pytest.raises(ValueError, match=r"\[0, 1\]"):
        cos_lower_bound(Fraction(2))
