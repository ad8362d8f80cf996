"""Balanced reduction: published singular values, error within its bound, and each refusal."""

import control
import numpy as np
import pytest

from gustproof.errors import DesignError
from gustproof.robust.lti.balred import Reduction, balred
from gustproof.robust.lti.norms import Peak, hinf_norm
from gustproof.robust.lti.state_space import Lti, as_lti, gain


def random_system(seed: int, dt: float) -> Lti:
    rng = np.random.default_rng(seed)
    n, m, p = rng.integers(2, 9), rng.integers(1, 3), rng.integers(1, 3)
    A = rng.normal(size=(n, n))
    if dt:
        A *= rng.uniform(0.7, 1.3) / np.abs(np.linalg.eigvals(A)).max()
    return Lti(A=A, B=rng.normal(size=(n, m)), C=rng.normal(size=(p, n)), D=rng.normal(size=(p, m)), dt=dt)


def difference(first: Lti, second: Lti) -> control.StateSpace:
    return first.to_control() - second.to_control()


def test_the_example_of_slicots_ab09ad():
    # SLICOT, AB09AD, "Program Results": Hankel singular values of a two-area power system
    A = np.zeros((7, 7))
    A[0, [0, 2, 3]] = -0.04165, 4.92, -4.92
    A[1, [0, 1]] = A[5, [4, 5]] = -5.21, -12.5
    A[2, [1, 2]] = A[6, [5, 6]] = 3.33, -3.33
    A[3, [0, 4]] = 0.545, -0.545
    A[4, [3, 4, 6]] = 4.92, -0.04165, 4.92
    B, C = np.zeros((7, 2)), np.zeros((3, 7))
    B[1, 0] = B[5, 1] = 12.5
    C[0, 0] = C[1, 3] = C[2, 4] = 1.0
    result = balred(Lti(A=A, B=B, C=C, D=np.zeros((3, 2))), 5)
    assert str(result).splitlines()[2] == "Hankel: 2.51, 2.08, 1.92, 0.767, 0.547, 0.0253 and 1 more"
    printed = [2.5139, 2.0846, 1.9178, 0.7666, 0.5473, 0.0253, 0.0246]
    np.testing.assert_allclose(result.hankel, printed, atol=5e-5)
    assert result.bound == pytest.approx(2.0 * (0.0253 + 0.0246), abs=2e-4)


def test_the_example_of_moore():
    # B. C. Moore, IEEE TAC 26 (1981), 17-32: (s + 4) / ((s + 1) (s + 3) (s + 5) (s + 10))
    G = as_lti(control.tf2ss(control.tf([1.0, 4.0], np.poly([-1.0, -3.0, -5.0, -10.0]))))
    np.testing.assert_allclose(balred(G, 2).hankel, [0.0159, 0.272e-2, 0.127e-3, 0.8e-5], rtol=5e-3)


@pytest.mark.parametrize("method", Reduction)
@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(6))
def test_the_error_is_within_its_bound_and_unstable_states_are_kept(seed, dt, method):
    G = random_system(seed, dt)
    poles = G.poles()
    unstable = int(np.sum(np.abs(poles) >= 1.0 if dt else poles.real >= 0.0))
    for order in range(unstable, G.order + 1):
        result = balred(G, order, method=method)
        assert (result.kept, result.order) == (unstable, order)
        assert result.error <= result.bound * (1.0 + 1e-9) + 1e-9
        own = as_lti(result.system).poles()
        assert int(np.sum(np.abs(own) >= 1.0 if dt else own.real >= 0.0)) == unstable
        if not unstable:
            off = hinf_norm(difference(G, as_lti(result.system))).gain
            assert off == pytest.approx(result.error, rel=1e-6, abs=1e-9)
            lower = result.hankel[order] if order < G.order else 0.0
            assert result.error >= lower * (1.0 - 1e-9)  # no system of that order is closer
    similar = Lti(A=G.A.T, B=G.C.T, C=G.B.T, D=G.D.T, dt=dt)
    np.testing.assert_allclose(balred(similar, G.order).hankel, result.hankel, rtol=1e-7)


def test_the_full_order_is_the_system_itself_with_unstable_poles():
    G = Lti(A=[[0.0, 1.0, 0.0], [0.0, -3.0, 1.0], [0.0, 0.0, 2.0]], B=np.ones((3, 1)), C=np.eye(3), D=np.zeros((3, 1)))
    omega = [0.1, 1.0, 10.0]
    np.testing.assert_allclose(as_lti(balred(G, 3).system).response(omega), G.response(omega), rtol=1e-9)


def test_states_in_units_far_apart_do_not_spoil_the_system():
    G = random_system(3, 0.1)
    units = 10.0 ** np.linspace(-5.0, 5.0, G.order)
    scaled = Lti(A=G.A * units[:, None] / units, B=G.B * units[:, None], C=G.C / units, D=G.D, dt=G.dt)
    omega = np.linspace(0.0, 30.0, 7)
    response = as_lti(balred(scaled, G.order).system).response(omega)
    np.testing.assert_allclose(response, G.response(omega), rtol=1e-9, atol=1e-9)


def test_a_reduced_system_is_for_python_control_and_keeps_the_names_of_its_signals():
    G = control.ss(np.diag([-1.0, -50.0]), [[1.0], [1.0]], [[1.0, 1.0]], 0.0, inputs="torque", outputs="rate")
    small = balred(G, 1).system
    assert (small.nstates, small.input_labels, small.output_labels) == (1, ["torque"], ["rate"])
    assert control.feedback(small, 1.0).dcgain() == pytest.approx(1.02 / 2.02, rel=0.02)


def test_matching_keeps_the_gain_at_rest_and_truncation_the_one_at_infinity():
    G = random_system(5, 0.0)
    stable = Lti(A=G.A - 5.0 * np.eye(G.order), B=G.B, C=G.C, D=G.D)
    match, cut = balred(stable, 2, method="match"), balred(stable, 2)
    np.testing.assert_allclose(as_lti(match.system).response(0.0), stable.response(0.0), rtol=1e-9)
    np.testing.assert_array_equal(cut.system.D, stable.D)


def test_states_that_nothing_sees_are_dropped():
    G = Lti(A=np.diag([-1.0, -2.0]), B=np.ones((2, 1)), C=[[1.0, 0.0]], D=[[0.0]])
    result = balred(G, 2)
    assert (result.order, result.hankel.size) == (1, 1)
    assert result.hankel[0] == pytest.approx(0.5)


def test_small_singular_values_keep_their_digits():
    # two lags apart by 1e6 in gain: a Gramian in one matrix would know the small one to 1e-4 only
    G = Lti(A=np.diag([-1.0, -2.0]), B=[[1.0, 0.0], [0.0, 1e-6]], C=[[1.0, 0.0], [0.0, 1e-6]], D=np.zeros((2, 2)))
    np.testing.assert_allclose(balred(G, 1).hankel, [0.5, 0.25e-12], rtol=1e-12)


def test_a_gain_has_nothing_to_lose():
    result = balred(gain([[2.0]]), 0)
    assert (result.order, result.error, result.bound) == (0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("order", "method", "match"),
    [(0, "truncate", "must be from 1"), (3, "truncate", "to 2"), (1, "hankel", "must be truncate or match")],
)
def test_bad_input_is_refused(order, method, match):
    with pytest.raises(ValueError, match=match):
        balred(Lti(A=np.diag([1.0, -1.0]), B=np.ones((2, 1)), C=np.ones((1, 2)), D=[[0.0]]), order, method=method)


def test_poles_that_can_not_be_separated_are_refused(monkeypatch):
    # Schur's form of a defective matrix scatters its poles: here the stable half holds an unstable one
    defective = Lti(A=-np.eye(2), B=np.ones((2, 1)), C=np.ones((1, 2)), D=[[0.0]])
    monkeypatch.setattr(Lti, "is_stable", lambda _: False)
    with pytest.raises(DesignError, match="too close to be separated"):
        balred(defective, 1)


def test_a_system_that_overflows_is_refused():
    with pytest.raises(DesignError, match="too badly scaled"):
        balred(Lti(A=[[-1.0, 1e300], [0.0, -2.0]], B=[[1e9], [1e9]], C=[[1e9, 1.0]], D=[[0.0]]), 1)


def test_an_error_above_its_bound_is_not_returned(monkeypatch):
    monkeypatch.setattr("gustproof.robust.lti.balred.hinf_norm", lambda _: Peak(gain=1e9, omega=0.0))
    with pytest.raises(DesignError, match="rounding spoilt the reduction"):
        balred(Lti(A=np.diag([-1.0, -2.0]), B=np.ones((2, 1)), C=np.ones((1, 2)), D=[[0.0]]), 1)
