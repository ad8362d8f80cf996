"""Identities of the algebra of uncertain systems, on random ones."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gustproof.robust.lti.state_space import Lti, as_lti
from gustproof.robust.uncertain.uncertain_system import Uncertain, append, as_uncertain, lft, simplify
from gustproof.robust.uncertain.uncertainty import FullBlock, RealBlock

ROUNDING = 1e-8
"""Relative to the largest entry; loops are kept well posed, with a condition below some 1e4."""
WHERE = 0.7
"""[rad/s] frequency at which systems are compared."""


@st.composite
def systems(draw: st.DrawFn, size: int = 2, full: str = "") -> Uncertain:
    """A square system with states, two shared parameters and, where it has a name, a full block of its own."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, a, b = draw(st.integers(0, 3)), draw(st.integers(0, 2)), draw(st.integers(0, 3))
    blocks = [RealBlock(name="a", low=-1.0, high=2.0, nominal=0.0, repeats=a)] if a else []
    blocks += [RealBlock(name="b", low=0.0, high=2.0, nominal=1.0, repeats=b)] if b else []
    if full:
        blocks.append(FullBlock(name=full, n_outputs=1, n_inputs=2))
    w, z = (sum(block.shape[k] for block in blocks) for k in (0, 1))
    D = 0.2 * rng.normal(size=(z + size, w + size))
    D[z:, w:] += 2.0 * np.eye(size)
    B, C = rng.normal(size=(n, w + size)), 0.3 * rng.normal(size=(z + size, n))
    return Uncertain(M=Lti(A=rng.normal(size=(n, n)) - 3.0 * np.eye(n), B=B, C=C, D=D), blocks=tuple(blocks))


def deltas(*of: Uncertain) -> dict[str, object]:
    return append(*of).sample(1, 11)[0]


def value(system: Uncertain, delta: dict[str, object]) -> np.ndarray:
    names = {block.name for block in system.blocks}
    member = system.substitute({name: part for name, part in delta.items() if name in names})
    return as_lti(member).response(WHERE)[0]


def same(ours: np.ndarray, expected: np.ndarray) -> bool:
    return np.max(np.abs(ours - expected)) <= ROUNDING * max(1.0, np.max(np.abs(expected)))


@settings(max_examples=40)
@given(systems(full="F"), systems(full="G"))
def test_sum_product_and_append_are_those_of_the_members(X, Y):
    delta = deltas(X, Y)
    x, y = value(X, delta), value(Y, delta)
    assert same(value(X + Y, delta), x + y)
    assert same(value(X - Y, delta), x - y)
    assert same(value(X @ Y, delta), x @ y)
    assert same(value(append(X, Y), delta), np.block([[x, np.zeros((2, 2))], [np.zeros((2, 2)), y]]))


@settings(max_examples=40)
@given(systems(), systems(full="F"), systems(full="G"))
def test_products_distribute_over_sums(X, Y, Z):
    delta = deltas(X, Y, Z)
    assert same(value(X @ (Y + Z), delta), value(X @ Y + X @ Z, delta))


@settings(max_examples=40)
@given(systems())
def test_a_system_times_its_inverse_is_the_identity(X):
    delta = deltas(X)
    assert same(value(X @ X.inverse(), delta), np.eye(2))
    assert same(value(X.inverse().inverse(), delta), value(X, delta))


@settings(max_examples=40)
@given(systems(4, full="F"), systems(full="G"))
def test_a_star_product_is_the_closed_loop_formula(P, Q):
    delta = deltas(P, Q)
    p, q = value(P, delta), value(Q, delta)
    p11, p12, p21, p22 = p[:2, :2], p[:2, 2:], p[2:, :2], p[2:, 2:]
    loop = np.eye(2) - 0.02 * q @ p22
    expected = p11 + 0.02 * p12 @ np.linalg.solve(loop, q @ p21)
    assert same(value(lft(P, 0.02 * np.eye(2) @ Q, 2, 2), delta), expected)
    known = Q.nominal_system()
    scaled = as_uncertain(0.02 * np.eye(2)) @ known
    assert same(value(lft(P, scaled.M), delta), value(lft(P, scaled, 2, 2), delta))


@settings(max_examples=40)
@given(systems(full="F"), systems())
def test_reduction_changes_no_member_and_removes_what_cancels(X, Y):
    small = simplify(X + Y - Y)
    assert same(value(small, deltas(X, Y)), value(X, deltas(X, Y)))
    assert small.n_w <= X.n_w
    assert small.M.order <= X.M.order
