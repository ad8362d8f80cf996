"""The gap metrics: printed values, the axioms of a metric, and refused input."""

import itertools
import math

import control
import numpy as np
import pytest

from gustproof.robust.coprime.gapmetric import gapmetric
from gustproof.robust.coprime.ncfsyn import ncfsyn
from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.state_space import Lti, as_lti, gain

TIGHT = 1e-6


def transfer(numerator, denominator) -> Lti:
    return as_lti(control.tf2ss(control.tf(numerator, denominator)))


@pytest.mark.parametrize(
    ("first", "second", "gap", "nugap"),
    [
        # MATLAB's page on gapmetric; its gap is an upper bound within its tolerance of 1e-3
        (([1.0], [1.0, -0.001]), ([1.0], [1.0, 0.001]), 0.0021, 0.0020),
        (([1.0, 2.0], [1.0, 5.0, 10.0]), ([1.0, 1.0], [1.0, 3.0, 10.0]), 0.1391, 0.1390),
    ],
)
def test_values_of_the_robust_control_toolbox(first, second, gap, nugap):
    found = gapmetric(transfer(*first), transfer(*second))
    assert gap - 1e-3 < found.gap <= gap
    assert found.nugap == pytest.approx(nugap, abs=5e-5)


P1, P2, P3 = ([100.0], [2.0, 1.0]), ([100.0], [2.0, -1.0]), ([100.0], [1.0, 2.0, 1.0])
SLOW, FAST = ([1.0, -1.0], [1.0, 1.0]), ([2.0, -1.0], [1.0, 1.0])


@pytest.mark.parametrize(
    ("first", "second", "gap", "nugap"),
    [(P1, P2, 0.02, 0.02), (P1, P3, 0.8988, 0.8988), (P2, P3, 0.8941, 0.8941), (SLOW, FAST, 0.3333, 0.3162)],
)
def test_values_of_zhou_and_doyle(first, second, gap, nugap):
    # K. Zhou, J. C. Doyle, Essentials of Robust Control, Prentice Hall 1998, chapter 17, examples
    found = gapmetric(transfer(*first), transfer(*second))
    assert found == (pytest.approx(gap, abs=5e-5), pytest.approx(nugap, abs=5e-5))


def test_chordal_distance_of_gains_is_closed_form():
    a, b = 2.0, -0.5
    expected = abs(a - b) / math.sqrt((1.0 + a**2) * (1.0 + b**2))
    assert gapmetric(gain([[a]]), gain([[3.0]])).nugap == pytest.approx(1.0 / math.sqrt(5.0 * 10.0), rel=1e-9)
    assert expected == pytest.approx(1.0)  # 2 and -1/2 are antipodes
    assert gapmetric(gain([[a]]), gain([[b]])) == (1.0, 1.0)


def test_chordal_distance_of_lags_is_the_largest_over_frequencies():
    first, second = transfer([50.0], [1.0, 50.0]), transfer([400.0], [1.0, 58.0, 400.0])
    omega = np.geomspace(1e-2, 1e4, 20001)
    a, b = (system.response(omega)[:, 0, 0] for system in (first, second))
    chordal = np.abs(a - b) / np.sqrt((1.0 + np.abs(a) ** 2) * (1.0 + np.abs(b) ** 2))
    assert gapmetric(first, second).nugap == pytest.approx(chordal.max(), rel=1e-6)


def test_a_winding_number_makes_plants_far_apart_that_are_close_at_every_frequency():
    # no gain between 0 and 3 stabilises the first, and the chordal distance is .6 at rest, less elsewhere
    first, second = transfer([1.0], [1.0, -3.0]), transfer([1.0], [1.0, 3.0])
    omega = np.geomspace(1e-4, 1e4, 2001)
    a, b = (system.response(omega)[:, 0, 0] for system in (first, second))
    chordal = np.abs(a - b) / np.sqrt((1.0 + np.abs(a) ** 2) * (1.0 + np.abs(b) ** 2))
    assert chordal.max() == pytest.approx(0.6, abs=1e-3)
    assert gapmetric(first, second) == (1.0, 1.0)


def plants(seed: int, count: int, dt: float = 0.0) -> list[Lti]:
    """Return neighbours of one random plant."""
    rng = np.random.default_rng(seed)
    n, m, p = 3, rng.integers(1, 3), rng.integers(1, 3)
    base = [rng.normal(size=shape) for shape in ((n, n), (n, m), (p, n), (p, m))]
    found = []
    for _ in range(count):
        A, B, C, D = (matrix + 0.1 * rng.normal(size=matrix.shape) for matrix in base)
        found.append(Lti(A=A, B=B, C=C, D=D, dt=dt))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_both_are_metrics_and_the_gap_is_the_larger(seed):
    family = plants(seed, 3)
    far = {(i, k): gapmetric(family[i], family[k]) for i, k in itertools.permutations(range(3), 2)}
    for (i, k), found in far.items():
        assert 0.0 < found.nugap <= found.gap <= 1.0
        np.testing.assert_allclose(found, far[k, i], rtol=1e-5)
    for i, j, k in itertools.permutations(range(3), 3):
        for kind in range(2):
            assert far[i, k][kind] <= far[i, j][kind] + far[j, k][kind] + TIGHT
    assert gapmetric(family[0], family[0]).gap < TIGHT


@pytest.mark.parametrize("seed", range(3))
def test_similarity_duality_and_sampling_leave_the_distances(seed):
    first, second = plants(seed, 2)
    found = gapmetric(first, second)
    T = np.random.default_rng(seed).normal(size=(3, 3))
    similar = Lti(A=np.linalg.solve(T, first.A @ T), B=np.linalg.solve(T, first.B), C=first.C @ T, D=first.D)
    np.testing.assert_allclose(gapmetric(similar, second), found, rtol=1e-5)
    dual = [Lti(A=G.A.T, B=G.C.T, C=G.B.T, D=G.D.T) for G in (first, second)]
    assert gapmetric(*dual).nugap == pytest.approx(found.nugap, rel=1e-6)  # the gap of transposed plants is another
    np.testing.assert_allclose(gapmetric(*(tustin(G, 0.1) for G in (first, second))), found, rtol=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_a_controller_stabilises_every_plant_within_its_margin(seed):
    first, second = plants(seed, 2)
    result = ncfsyn(first)
    if gapmetric(first, second).nugap < result.margin:
        loop = control.feedback(second.to_control(), result.K, sign=1)
        assert np.all(loop.poles().real < 0.0)


@pytest.mark.parametrize(
    ("other", "match"),
    [(gain(np.eye(2)), "1 x 1 and 2 x 2"), (tustin(transfer([1.0], [1.0, 1.0]), 0.1), "sample times differ")],
)
def test_bad_input_is_refused(other, match):
    with pytest.raises(ValueError, match=match):
        gapmetric(transfer([1.0], [1.0, 1.0]), other)
