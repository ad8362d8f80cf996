"""Stabilising Riccati solutions: the equation, the closed loop, and failures by name."""

import numpy as np
import pytest
import scipy.linalg

from gustproof.errors import DesignError
from gustproof.robust.lti.riccati import RiccatiError, RiccatiFailure, stabilizing_solution


def regulator(A, B, Q):
    A, B, Q = np.atleast_2d(A), np.atleast_2d(B), np.atleast_2d(Q)
    return np.block([[A, -B @ B.T], [-Q, -A.T]])


def test_the_scalar_regulator_has_its_closed_form():
    # 2 a x - x^2 + q = 0
    assert stabilizing_solution(regulator(2.0, 1.0, 5.0))[0, 0] == pytest.approx(5.0, rel=1e-13)


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_the_solution_agrees_with_scipy_however_the_state_is_scaled(scale):
    rng = np.random.default_rng(3)
    T = np.diag([1.0, scale, 1.0, 1.0 / scale])
    A, B, C = T @ rng.normal(size=(4, 4)) @ np.linalg.inv(T), T @ rng.normal(size=(4, 2)), rng.normal(size=(3, 4))
    C = C @ np.linalg.inv(T)
    X = stabilizing_solution(regulator(A, B, C.T @ C))
    expected = scipy.linalg.solve_continuous_are(A, B, C.T @ C, np.eye(2))
    assert np.allclose(T @ X @ T, T @ expected @ T, rtol=1e-9)
    assert np.max(np.linalg.eigvals(A - B @ B.T @ X).real) < 0.0


def test_the_order_of_the_states_changes_the_solution_by_rounding_alone():
    # a chain of integrators, whose QR steps depend on the order that it stands in
    A, B, Q = np.diag(np.ones(4), 1), np.eye(5)[:, -1:], np.diag([1.0, 0.0, 0.0, 0.0, 0.0])
    order = np.array([4, 3, 2, 1, 0])
    X = stabilizing_solution(regulator(A, B, Q))
    turned = stabilizing_solution(regulator(A[np.ix_(order, order)], B[order], Q[np.ix_(order, order)]))
    assert np.allclose(turned[np.ix_(order, order)], X, rtol=1e-12)
    assert np.allclose(A.T @ X + X @ A - X @ B @ B.T @ X + Q, 0.0, atol=1e-12)


def test_a_level_below_the_norm_puts_eigenvalues_on_the_axis():
    # the bounded-real equation of 1 / (s + 1), whose norm is 1, at the level 1/2
    with pytest.raises(RiccatiError, match="imaginary axis") as raised:
        stabilizing_solution(np.array([[-1.0, 4.0], [-1.0, 1.0]]))
    assert raised.value.failure is RiccatiFailure.AXIS


def test_an_unstable_mode_that_nothing_reaches_is_named():
    with pytest.raises(RiccatiError, match="not stabilisable") as raised:
        stabilizing_solution(regulator(np.diag([1.0, -2.0]), [[0.0], [1.0]], np.eye(2)))
    assert raised.value.failure is RiccatiFailure.COMPLEMENT


def test_an_equation_that_overflows_is_refused_and_does_not_hang():
    with pytest.raises(DesignError, match="overflows"):
        stabilizing_solution(np.array([[-1.0, np.inf], [-1.0, 1.0]]))
