"""No bound on an uncertain system depends on the units of its signals and states."""

import math

import numpy as np
import pytest
from control import ss

from gustproof.robust.gain.lft_gain import certify_lft
from gustproof.robust.gain.parts import Delay, Sector, Slope
from gustproof.robust.lti.margins import margins
from gustproof.robust.lti.state_space import Lti, gain
from gustproof.robust.mu.singular_value import disk_margin_bounds, mu
from gustproof.robust.mu.worst_gain import wcgain
from gustproof.robust.mu.worst_margin import wcmargin
from gustproof.robust.uncertain.elements import ureal
from gustproof.robust.uncertain.uncertain_system import Uncertain, lft, system_from_matrix
from gustproof.robust.uncertain.uncertainty import DeltaBlock, FullBlock, RealBlock, columns, rows
from gustproof.robust.uncertain.units import balance

UNITS = (1e-6, 1.0, 1e4, 1e6)
SAMPLE = range(4)
"""Seeds of random systems in the gate. Of the first 146, mu agreed for all; of the first 200, the worst gain did."""
SAME = 0.012
"""Relative: twice the accuracy asked for, and the resolution of a search."""


def real(name: str, repeats: int = 1) -> RealBlock:
    return RealBlock(name=name, repeats=repeats, low=-1.0, high=1.0, nominal=0.0)


def random_system(rng: np.random.Generator, blocks: tuple[DeltaBlock, ...], inputs: int, outputs: int) -> Uncertain:
    """A system of small gain at Delta, sometimes with channels that are coupled in one direction only."""
    n = int(rng.integers(0, 4))
    A = rng.normal(size=(n, n))
    A -= (max(np.linalg.eigvals(A).real, default=0.0) + 0.5) * np.eye(n)
    p, m = outputs + sum(block.shape[1] for block in blocks), inputs + sum(block.shape[0] for block in blocks)
    M = Lti(A=A, B=rng.normal(size=(n, m)), C=rng.normal(size=(p, n)), D=0.3 * rng.normal(size=(p, m)))
    size = np.max(np.linalg.norm(M.response(np.geomspace(0.01, 100.0, 200)), 2, axis=(1, 2)))
    scale = np.append(np.full(p - outputs, 0.6 / size), np.ones(outputs))[:, None]
    C, D = scale * M.C, scale * M.D
    if rng.uniform() < 0.3 and outputs:
        C[0], D[0, 1:] = 0.0, 0.0
    return Uncertain(M=Lti(A=A, B=M.B, C=C, D=D), blocks=blocks)


def in_other_units(system: Uncertain, rng: np.random.Generator, most: float = 6.0) -> Uncertain:
    """The same family: each state, each channel of a parameter and each full block in units of its own."""
    M, w, z = system.M, np.ones(system.M.n_inputs), np.ones(system.M.n_outputs)
    x = 10.0 ** rng.uniform(-most, most, size=M.order)
    for block, driven, read in zip(system.blocks, rows(system.blocks), columns(system.blocks), strict=True):
        own = 10.0 ** rng.uniform(-most, most, size=block.shape[0] if isinstance(block, RealBlock) else 1)
        w[driven] = z[read] = own if isinstance(block, RealBlock) else own[0]
    M = Lti(A=M.A * x / x[:, None], B=M.B * w / x[:, None], C=M.C * x / z[:, None], D=M.D * w / z[:, None])
    return Uncertain(M=M, blocks=system.blocks)


def of_external(system: Uncertain, output: float) -> Uncertain:
    """The family with its outputs in another unit, all in one."""
    scale = np.append(np.ones(system.n_z), np.full(system.n_outputs, output))[:, None]
    M = system.M
    return Uncertain(M=Lti(A=M.A, B=M.B, C=scale * M.C, D=scale * M.D), blocks=system.blocks)


def kinds(seed: int) -> tuple[DeltaBlock, ...]:
    return (
        (real("a"), real("b", 2)),
        (FullBlock(name="f"), FullBlock(name="g", n_outputs=2, n_inputs=1)),
        (real("a", 2), FullBlock(name="f", n_outputs=1, n_inputs=2)),
        (real("a"), FullBlock(name="f"), real("b")),
    )[seed % 4]


@pytest.mark.parametrize("c", UNITS)
def test_static_mu_of_two_complex_blocks_is_the_same_in_all_units(c):
    blocks = (FullBlock(name="a"), FullBlock(name="b"))
    found = mu(Uncertain(M=gain([[0.1, 0.5 * c], [0.3 / c, 0.2]]), blocks=blocks), accuracy=1e-3)
    d = math.sqrt(0.3 / 0.5)
    expected = np.linalg.norm(np.array([[0.1, 0.5 * d], [0.3 / d, 0.2]]), 2)  # the best D balances the two
    assert found.lower == pytest.approx(expected, rel=2e-3)
    assert found.upper == pytest.approx(expected, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SAMPLE)
def test_mu_does_not_change_with_units(seed):
    rng = np.random.default_rng(seed)
    system = random_system(rng, kinds(seed), 0, 0)
    one, other = (mu(each, accuracy=0.005) for each in (system, in_other_units(system, rng)))
    assert other.upper == pytest.approx(one.upper, rel=SAME, abs=1e-4)
    assert other.lower == pytest.approx(one.lower, rel=SAME, abs=1e-4)


@pytest.mark.parametrize("seed", SAMPLE)
def test_the_worst_gain_does_not_change_with_units_and_scales_with_those_of_the_output(seed):
    rng = np.random.default_rng(seed)
    system = random_system(rng, kinds(seed), 2, 1)
    unit = 10.0 ** rng.uniform(-6.0, 6.0)
    one, other = wcgain(system, accuracy=0.005), wcgain(of_external(in_other_units(system, rng), unit), accuracy=0.005)
    assert math.isfinite(one.upper)
    assert other.upper == pytest.approx(unit * one.upper, rel=SAME)
    assert other.lower == pytest.approx(unit * one.lower, rel=SAME)


@pytest.mark.parametrize("seed", SAMPLE[:2])
def test_disk_margins_do_not_change_with_units(seed):
    rng = np.random.default_rng(seed)
    L = random_system(rng, (), 2, 2).M
    L = Lti(A=L.A, B=0.4 * L.B, C=L.C, D=0.4 * L.D)
    x, unit = 10.0 ** rng.uniform(-6.0, 6.0, size=L.order), 10.0 ** rng.uniform(-6.0, 6.0, size=2)
    other = Lti(
        A=L.A * x / x[:, None], B=L.B * unit / x[:, None], C=L.C * x / unit[:, None], D=L.D * unit / unit[:, None]
    )
    bounds = disk_margin_bounds(L)
    assert disk_margin_bounds(other) == pytest.approx(bounds, rel=0.003)
    constant = margins(other, ss([], [], [], -np.eye(2))).input_disk
    assert constant <= (1.0 + 1e-3) * bounds[0]
    assert constant == pytest.approx(margins(L, ss([], [], [], -np.eye(2))).input_disk, rel=0.05)


def test_the_worst_margin_does_not_change_with_units():
    lag = ss([[0.0, 1.0], [0.0, -2.0]], [[0.0], [1.0]], [[2.0, 0.0]], 0.0)
    loop = ureal("gain", range=(0.5, 1.5)) @ lag
    other = in_other_units(loop, np.random.default_rng(3))
    one, scaled = (wcmargin(each) for each in (loop, other))
    assert (scaled.lower, scaled.upper) == pytest.approx((one.lower, one.upper), rel=0.005)


@pytest.mark.parametrize("c", [1e6, 1e8, -1e12])
def test_a_triangular_loop_has_the_margin_of_its_diagonal(c):
    # det(I + L) = 4 whatever c: S - I/2 has zeros on its diagonal
    L = ss([], [], [], [[1.0, 0.0], [c, 1.0]])
    assert disk_margin_bounds(L) == (2.0, 2.0)
    assert margins(L, ss([], [], [], -np.eye(2))).input_disk == pytest.approx(2.0)


@pytest.mark.slow
def test_the_two_carts_have_the_margin_of_their_worst_corner_and_a_finite_worst_gain():
    # MATLAB, "Robust Stability and Worst-Case Gain of Uncertain System": margin 2.8834 to 2.8864; by roots of the
    # polynomial at the corner (-, -, +) it is 2.8863. The worst gain, at (1, 1, -1), is a closed formula's.
    loop = two_carts()
    alone = Uncertain(M=loop.M.subsystem(slice(0, loop.n_z), slice(0, loop.n_w)), blocks=loop.blocks)
    found = mu(alone, accuracy=0.01)
    assert 1.0 / found.upper == pytest.approx(2.8863, rel=0.01)
    assert 1.0 / found.lower == pytest.approx(2.8863, rel=0.01)
    worst = wcgain(loop)
    assert worst.lower == pytest.approx(1.0475, rel=1e-3)
    assert worst.lower <= worst.upper <= 1.08


def two_carts() -> Uncertain:
    """From the reference to the position of the second cart; masses and spring 1 within 20 %."""
    m1, m2, k = (ureal(name, range=(0.8, 1.2)) for name in ("m1", "m2", "k"))
    force = k @ np.array([[1.0, -1.0, 0.0, 0.0, 0.0]])  # of (x1, x2, v1, v2, u)
    first = m1.inverse() @ (np.array([[0.0, 0.0, 0.0, 0.0, 1.0]]) - force)
    second = m2.inverse() @ force
    row = np.eye(5)[:, None, :]
    derivatives = np.eye(5, 2, -2) @ append_rows(first, second) + np.eye(5)[:, :2] @ np.vstack([row[2], row[3]])
    carts = system_from_matrix(derivatives + np.eye(5)[:, 4:] @ row[1], 4)
    f = 100.0 ** (1 / 3)
    once = Uncertain(M=Lti(A=[[-1000.0]], B=[[999000.0**0.5]], C=[[-f * 999000.0**0.5]], D=[[1000.0 * f]]))
    error = np.array([[1.0], [-1.0]]) @ carts @ np.array([[0.0, 1.0]]) + np.array([[0.0, 0.0], [1.0, 0.0]])
    return lft(error, (once @ once @ once).M)


def append_rows(first: Uncertain, second: Uncertain) -> Uncertain:
    return np.array([[1.0], [0.0]]) @ first + np.array([[0.0], [1.0]]) @ second


def test_static_systems_of_parameters_have_their_mu():
    # 1 + 2 a is singular at a = -.5, which is -.6 of the range from .25
    loop = lft(ureal("a", range=(-1.0, 1.5)) @ gain([[2.0]]), gain([[-1.0]]))
    found = mu(loop)
    assert found.lower == pytest.approx(1.0 / 0.6)
    assert found.delta == {"a": pytest.approx(-0.6)}
    assert found.lower <= found.upper <= 1.02 * found.lower


@pytest.mark.parametrize(
    ("M", "blocks", "expected"),
    [
        ([[0.5]], (real("a"),), 0.5),
        ([[0.3, 0.5], [0.3, 0.5]], (real("a", 2),), 0.8),
        ([[0.0, 2.0], [-2.0, 0.0]], (real("a", 2),), 0.0),  # eigenvalues +-2j
        ([[0.0, 2.0], [-2.0, 0.0]], (real("a"), real("b")), 2.0),  # 1 + 4 a b
        ([[0.4, 0.0], [1e6, -0.7]], (real("a"), real("b")), 0.7),
        ([[1.0, 1.0], [1.0, 1.0]], (real("a"), FullBlock(name="f")), 2.0),
        ([[0.0, 1.0], [0.0, 0.0]], (real("a"), FullBlock(name="f")), 0.0),
        ([[3.0, 4.0]], (FullBlock(name="f", n_outputs=2, n_inputs=1),), 5.0),
    ],
)
@pytest.mark.parametrize("c", [1.0, 1e6])
def test_mu_of_a_matrix_is_the_one_by_hand(M, blocks, expected, c):
    M = np.array(M)
    if M.shape == (2, 2):
        M = M * [[1.0, c], [1.0 / c, 1.0]]
    found = mu(Uncertain(M=gain(M), blocks=blocks), accuracy=0.005)
    assert found.lower == pytest.approx(expected, rel=2e-3, abs=1e-9)
    assert found.upper == pytest.approx(expected, rel=0.01, abs=0.01)


def test_units_are_powers_of_two_that_change_no_response():
    rng = np.random.default_rng(7)
    system = in_other_units(random_system(rng, kinds(3), 1, 1), rng)
    units = balance(system.M, system.blocks)
    assert np.all(np.frexp(np.concatenate([units.x, units.channels.z, units.channels.w]))[0] == 0.5)
    z, w = np.append(units.channels.z, 1.0), np.append(units.channels.w, 1.0)
    changed = units.change(system.M).response([0.3, 3.0]) * z[:, None] / w
    assert changed == pytest.approx(system.M.response([0.3, 3.0]), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("speeds", "part"),
    [(None, None), ({"a": 1.0}, None), (None, Delay(largest=0.5)), (None, Sector()), (None, Slope(poles=(3.0,)))],
)
def test_a_certified_gain_does_not_change_with_units_and_is_proved_of_the_loop_as_given(speeds, part):
    if part is None:
        M = Lti(
            A=[[-1.0, 0.2], [-0.3, -2.0]], B=np.ones((2, 3)), C=[[0.3, 0.1], [0.2, 0.3], [1.0, 1.0]], D=np.zeros((3, 3))
        )
        loop = Uncertain(M=M, blocks=(real("a"), real("b")))
    else:
        M = Lti(
            A=[[-3.0, 0.2], [0.1, -1.0]], B=[[-2.0, 1.0], [0.3, 0.2]], C=[[1.0, 0.1], [1.0, 0.5]], D=np.zeros((2, 2))
        )
        loop = Uncertain(M=M, blocks=(FullBlock(name="f"),))
    parts = None if part is None else {"f": part}
    other = of_external(in_other_units(loop, np.random.default_rng(1)), 1e-6)
    one, scaled = (certify_lft(each, assumes={}, speeds=speeds, parts=parts) for each in (loop, other))
    assert one.proven
    assert scaled.proven
    assert scaled.evidence["system"]["A"] == other.M.A.tolist()
    assert scaled.gain == pytest.approx(1e-6 * one.gain, rel=1e-3)
    assert scaled.lower_bound == pytest.approx(1e-6 * one.lower_bound, rel=1e-3)
    assert scaled.residual > 0.0


def test_a_loop_without_states_is_sent_to_the_worst_gain():
    loop = Uncertain(M=gain([[0.2, 1.0], [1.0, 0.3]]), blocks=(real("a"),))
    with pytest.raises(ValueError, match="has no states"):
        certify_lft(loop, assumes={})
    assert wcgain(loop).lower == pytest.approx(0.3 + 1.0 / 0.8)
