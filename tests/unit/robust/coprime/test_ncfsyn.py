"""Loop shaping: published margins, what leaves them alone, and each error by name."""

import math

import control
import numpy as np
import pytest

from gustproof.errors import DesignError
from gustproof.robust.coprime.ncfsyn import check_shaped_loop, ncfsyn
from gustproof.robust.lti.state_space import Lti, as_lti, gain, lft, series

DT = 0.01


def transfer(numerator, denominator) -> Lti:
    return as_lti(control.tf2ss(control.tf(numerator, denominator)))


def random_plant(seed: int, dt: float = 0.0) -> Lti:
    rng = np.random.default_rng(seed)
    n, m, p = rng.integers(1, 6), rng.integers(1, 3), rng.integers(1, 3)
    A, B, C, D = (rng.normal(size=shape) for shape in ((n, n), (n, m), (p, n), (p, m)))
    return Lti(A=A, B=B, C=C, D=D, dt=dt)


def test_the_disturbance_process_of_skogestad_and_postlethwaite():
    # 2nd edition 2005, Example 9.3, plant (9.75) and weight (9.76): gamma_min 2.34 and the margins printed there
    G = series(transfer([200.0], [10.0, 1.0]), transfer([1.0], [0.0025, 0.1, 1.0]))
    W1 = transfer([1.0, 2.0], [1.0, 0.0])
    result = ncfsyn(G, W1, backoff=1.1)
    assert 1.0 / result.emax == pytest.approx(2.34, abs=0.005)
    assert result.order == 5
    shaped, robust = series(G, W1).to_control(), -(G.to_control() * result.K)
    for loop, expected in ((shaped, (1.62, 13.2, 13.7)), (robust, (3.48, 51.5, 10.3))):
        gain_margin, phase_margin, _, _, crossover, _ = control.stability_margins(loop)
        assert (gain_margin, phase_margin, crossover) == (
            pytest.approx(expected[0], abs=0.005),
            pytest.approx(expected[1], abs=0.05),
            pytest.approx(expected[2], abs=0.05),
        )


def test_the_lightly_damped_plant_of_the_robust_control_toolbox():
    # MATLAB, "Loop Shaping Using the Glover-McFarlane Method": gamma = 1.9903, in another release 1.9885
    shaping = series(transfer([1.0, 0.8], [1.0, 0.0]), transfer([1.0], [0.05, 1.0]))
    result = ncfsyn(transfer([16.0], [1.0, 0.16, 16.0]), -shaping, backoff=1.001)
    assert result.norm == pytest.approx(1.9903, abs=5e-5)
    assert 1.0 / result.emax < 1.9885


def test_margin_of_a_given_controller_of_the_robust_control_toolbox():
    # MATLAB, gapmetric, "Compute Gap Metric and Stability Margin": b = 0.1961
    margin = 1.0 / check_shaped_loop(transfer([1.0, 2.0], [1.0, 5.0, 10.0]), -transfer([4.4], [1.0, 0.0])).gain
    assert margin == pytest.approx(0.1961, abs=5e-5)


@pytest.mark.parametrize(("order", "least"), [(1, math.sqrt(2.0)), (2, math.sqrt(4.0 + 2.0 * math.sqrt(2.0)))])
def test_the_least_gamma_of_integrators_is_known(order, least):
    assert 1.0 / ncfsyn(transfer([1.0], [1.0, *([0.0] * order)])).emax == pytest.approx(least, rel=1e-9)


def test_a_plant_without_states_has_the_margin_of_its_gain():
    result = ncfsyn(gain([[3.0]]))
    assert (result.emax, result.order) == (1.0, 0)


@pytest.mark.parametrize("dt", [0.0, DT])
@pytest.mark.parametrize("seed", range(8))
def test_norm_is_between_the_least_and_the_level_and_keeps_under_similarity_and_duality(seed, dt):
    G = random_plant(seed, dt)
    result = ncfsyn(G)
    assert 1.0 / result.emax <= result.norm * (1.0 + 1e-6) <= result.gamma * (1.0 + 2e-6)
    assert result.margin * result.norm == pytest.approx(1.0)
    assert lft(_feedback_plant(G), result.lti).is_stable()
    T = np.random.default_rng(seed).normal(size=G.A.shape)
    similar = Lti(A=np.linalg.solve(T, G.A @ T), B=np.linalg.solve(T, G.B), C=G.C @ T, D=G.D, dt=dt)
    dual = Lti(A=G.A.T, B=G.C.T, C=G.B.T, D=G.D.T, dt=dt)
    for other in (similar, dual):
        assert ncfsyn(other).emax == pytest.approx(result.emax, rel=1e-6)


def _feedback_plant(G: Lti) -> Lti:
    """Return the plant with a disturbance at its input, as `lft` takes it."""
    return Lti(A=G.A, B=np.hstack([G.B, G.B]), C=np.vstack([G.C, G.C]), D=np.tile(G.D, (2, 2)), dt=G.dt)


def test_weights_of_inverse_gains_leave_the_shaped_loop():
    G, scale = random_plant(3), 7.0
    scaled = Lti(A=G.A, B=G.B * scale, C=G.C, D=G.D * scale)
    plain, weighted = ncfsyn(G), ncfsyn(scaled, gain(np.eye(G.n_inputs) / scale))
    assert weighted.emax == pytest.approx(plain.emax, rel=1e-9)
    np.testing.assert_allclose(weighted.lti.C * scale, plain.lti.C, rtol=1e-6)


def test_the_sign_is_that_of_positive_feedback():
    # K of a positive integrator is negative at rest: u = K y brings y back
    K = ncfsyn(transfer([1.0], [1.0, 0.0])).lti
    assert K.response(0.0)[0, 0, 0].real < 0.0


def test_discrete_and_continuous_designs_of_a_slow_plant_agree():
    G = transfer([1.0], [1.0, 0.5])
    sampled = as_lti(G.to_control().sample(DT))
    assert ncfsyn(sampled).emax == pytest.approx(ncfsyn(G).emax, abs=5e-3)


@pytest.mark.parametrize(
    ("G", "W1", "match"),
    [
        (transfer([1.0], [1.0, 0.0]), transfer([1.0, 0.0], [1.0, 1.0]), "mode on the axis"),
        (Lti(A=[[1.0]], B=[[0.0]], C=[[1.0]], D=[[1.0]]), None, "not stabilisable and detectable"),
        (Lti(A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]], dt=DT), None, "pole at -1"),
    ],
)
def test_a_plant_without_coprime_factors_is_refused(G, W1, match):
    with pytest.raises(DesignError, match=match):
        ncfsyn(G, W1)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"backoff": 1.0}, "backoff is 1.0"),
        ({"W1": gain(np.eye(2))}, "W1 is 2 x 2, must be 1 x 1"),
        ({"W2": gain(np.eye(3))}, "W2 is 3 x 3, must be 1 x 1"),
        ({"W1": Lti(A=[[0.5]], B=[[1.0]], C=[[1.0]], D=[[0.0]], dt=DT)}, "sample times differ"),
    ],
)
def test_bad_input_is_refused(arguments, match):
    with pytest.raises(ValueError, match=match):
        ncfsyn(transfer([1.0], [1.0, 1.0]), **arguments)


def test_a_controller_that_rounding_spoilt_is_not_returned():
    # two modes 1e-14 apart share one input: no solution of the equation has digits left
    G = Lti(A=np.diag([1.0, 1.0 + 1e-9]), B=[[1.0], [1.0]], C=[[1.0, 1.0]], D=[[0.0]])
    with pytest.raises(DesignError):
        ncfsyn(G, backoff=1.0 + 1e-12)
