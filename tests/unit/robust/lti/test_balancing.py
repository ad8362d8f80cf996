"""Balanced units: what they leave alone, what they make alike, and that the units something came in do not matter."""

import numpy as np
import pytest

from gustproof.robust.lti.balancing import balance_states, balancing_units
from gustproof.robust.lti.state_space import Lti

PAIR = [slice(0, 1), slice(1, 2)]


def random_system(seed: int, n: int = 4) -> Lti:
    rng = np.random.default_rng(seed)
    shapes = {"A": (n, n), "B": (n, 2), "C": (3, n), "D": (3, 2)}
    return Lti(**{name: rng.normal(size=shape) for name, shape in shapes.items()})


@pytest.mark.parametrize("seed", range(5))
def test_units_of_states_that_a_system_came_in_are_found_again_to_a_factor_of_two(seed):
    G, units = random_system(seed), 10.0 ** np.random.default_rng(seed).uniform(-6.0, 6.0, size=4)
    scaled = Lti(A=G.A * units / units[:, None], B=G.B / units[:, None], C=G.C * units, D=G.D)
    ours, expected = balance_states(scaled), balance_states(G)
    for name in "ABC":
        ratio = np.abs(getattr(ours, name) / getattr(expected, name))
        assert np.all((ratio > 0.3) & (ratio < 3.0))


def test_balancing_rounds_nothing():
    G = random_system(1)
    balanced = balance_states(Lti(A=G.A, B=1e5 * G.B, C=1e-5 * G.C, D=G.D))
    units = G.C[0] * 1e-5 / balanced.C[0]
    assert np.array_equal(np.exp2(np.rint(np.log2(units))), units)
    assert np.array_equal(balanced.A * units[:, None] / units, G.A)


def test_a_group_has_one_unit_and_its_own_block_does_not_count():
    # a group of two rows and one column, then a group of one row and two columns, then an external channel
    M = np.array([[1e9, 2.0, 0.0, 1.0], [0.0, 0.0, 2.0, 0.0], [8.0e6, 0.0, 0.0, 1.0], [1.0, 1.0, 1.0, 0.0]])
    units = balancing_units(M, [slice(0, 2), slice(2, 3)], [slice(0, 1), slice(1, 3)])
    assert units.shape == (2,)
    assert 8.0e6 * units[0] / units[1] < 2.0**13
    assert np.array_equal(np.exp2(np.rint(np.log2(units))), units)


def test_numbers_near_the_ends_of_what_a_float_holds_are_balanced_too():
    M = np.array([[0.0, 1e300], [1e-300, 0.0]])
    units = balancing_units(M, PAIR, PAIR)
    assert np.max(np.abs(M * units / units[:, None])) < 1e10


@pytest.mark.parametrize("M", [np.zeros((2, 2)), np.diag([1.0, 2.0]), np.array([[0.0, 1.0], [0.0, 0.0]])])
def test_what_cannot_be_balanced_keeps_finite_units(M):
    units = balancing_units(M, PAIR, PAIR)
    assert np.isfinite(units).all()
    assert np.all(units > 0.0)


def test_a_complex_matrix_counts_by_its_sizes():
    M = np.array([[0.0, 1e6j], [1e-6, 0.0]])
    assert np.max(np.abs(M * balancing_units(M, PAIR, PAIR) / balancing_units(M, PAIR, PAIR)[:, None])) < 3.0


def test_a_gain_without_states_stays():
    G = Lti(A=np.zeros((0, 0)), B=np.zeros((0, 1)), C=np.zeros((1, 0)), D=[[2.0]])
    assert balance_states(G) is G
