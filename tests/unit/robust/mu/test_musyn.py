"""musyn: bounds that others confirm, histories that fall, filters that are what they claim, named errors."""

import itertools

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.rotational import Envelope, rotation, uncertain_airframe
from gustproof.design.designs import design_problem, load_design
from gustproof.errors import DesignError
from gustproof.prove.attitude_gain import certify_gain
from gustproof.robust.gain import lft_gain
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, gain
from gustproof.robust.mu import musyn as module
from gustproof.robust.mu.minimum_phase import MinimumPhase, fit_factors, fit_least_order, is_positive_real
from gustproof.robust.mu.musyn import musyn
from gustproof.robust.mu.scaled_plant import constant_filters, dynamic_filters, transform
from gustproof.robust.mu.singular_value import mu
from gustproof.robust.uncertain.elements import ureal
from gustproof.robust.uncertain.uncertain_system import Uncertain, append, fill_diagram, lft
from gustproof.robust.uncertain.uncertainty import FullBlock, RealBlock

SLACK = 1.02
"""Accuracy of the sweeps that confirm a bound."""


def lag(gain_range: tuple[float, float] = (0.5, 1.5)) -> Uncertain:
    """x' = -x / 10 + w1 + k u, z = (x, u / 5), y = x + w2 / 10 with an uncertain gain k."""
    nominal = Lti(
        A=[[-0.1]], B=[[1.0, 0.0, 1.0]], C=[[1.0], [0.0], [1.0]], D=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.2], [0.0, 0.1, 0.0]]
    )
    low, high = gain_range
    return nominal @ append(np.eye(2), ureal("k", range=(low, high)))


@pytest.mark.parametrize(
    "measure", [pytest.param("mu", marks=pytest.mark.slow), pytest.param("wcgain", marks=pytest.mark.slow), "l2gain"]
)
def test_bounds_bracket_and_the_history_falls(measure):
    found = musyn(lag(), 1, 1, order=1, measure=measure, tolerance=0.5)
    uppers = [step.upper for step in found.history]
    assert len(uppers) > 1
    assert all(after < before for before, after in itertools.pairwise(uppers))
    assert found.norm == found.lower <= found.upper == found.gamma <= uppers[-1]
    loop = lft(lag(), found.lti)
    if measure == "mu":  # the loop alone is asked again, without musyn's filters
        assert mu(loop).upper <= SLACK * uppers[-1]
    else:
        members = [hinf_norm(loop.member({"k": delta})).gain for delta in np.linspace(-1.0, 1.0, 9)]
        assert max(members) <= found.upper
        assert max(members) == pytest.approx(found.lower, rel=0.01)
    assert found.filter_orders == found.history[-1].filter_orders
    assert found.order == found.history[-1].order
    assert len(found.checks) == 3


@pytest.mark.slow
def test_a_linear_controller_of_design_d2_is_certified_over_an_envelope_where_that_of_hinfsyn_is_seven_times_worse(
    monkeypatch,
):
    design, envelope = load_design("D2"), Envelope(angle=0.3, rate=0.5)
    vehicle = load_vehicle("paper")
    problem = design_problem(design, vehicle)
    airframe = uncertain_airframe(rotation(vehicle.inertia_B, envelope), leak=design.leak, rate_damping=0.05)
    nominal = hinfsyn(problem.plant(), 3, 3, gamma=design.gamma).lti
    found = musyn(fill_diagram(problem, {"airframe": airframe}), 3, 3, measure="l2gain", tolerance=0.5, start=nominal)
    assert found.history[0].upper == pytest.approx(7.667, abs=0.001)
    assert found.order == 9
    monkeypatch.setattr(lft_gain, "lower_bound", lambda *_: 0.0)  # a search of seconds that no proof needs
    certificate = certify_gain(problem, found.lti, angle=0.3, rate=0.5, level=1.1)
    assert certificate.proven
    assert found.lower <= found.upper <= 1.1


def test_the_start_is_kept_if_nothing_is_better_and_is_never_worse_than_given():
    K = gain([[-2.0]])
    found = musyn(lag(), 1, 1, measure="l2gain", tolerance=0.5, start=K)
    assert found.history[0].order == 0
    assert found.upper <= found.history[0].upper
    again = musyn(lag(), 1, 1, measure="l2gain", tolerance=0.5, start=found.lti)
    assert again.upper <= found.upper * (1.0 + 1e-6)


@pytest.mark.slow
def test_a_start_is_found_where_h_infinity_controllers_have_no_finite_bound():
    D = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
    unstable = Lti(A=[[1.0]], B=[[1.0, 0.0, 1.0]], C=[[1.0], [0.0], [1.0]], D=D)
    P = unstable @ append(np.eye(2), ureal("k", range=(0.3, 1.7)))
    for part in (P.M, P.nominal_system()):
        loop = lft(P, hinfsyn(part, 1, 1, backoff=module._BACKOFF).lti)
        assert module._upper_bound(loop, "l2gain") == np.inf
    found = musyn(P, 1, 1, order=1, measure="l2gain", tolerance=0.5)
    members = [hinf_norm(lft(P, found.lti).member({"k": d})).gain for d in (-1.0, 0.0, 1.0)]
    assert max(members) <= found.upper < 10.0


def test_a_start_without_a_finite_mu_is_refused(monkeypatch):
    """A mu of stability, which helps the other measures, is no other problem than mu itself."""

    def fail(*_arguments):
        raise DesignError("no start has a finite bound")

    monkeypatch.setattr(module, "_best_start", fail)
    with pytest.raises(DesignError, match="no start has a finite bound"):
        musyn(lag(), 1, 1)


def test_progress_is_told():
    told = []
    musyn(lag(), 1, 1, measure="l2gain", tolerance=0.5, progress=lambda share, text: told.append((share, text)))
    assert told[0][0] == 0.0
    assert told[-1][0] == 1.0
    assert all("l2gain" in text for _, text in told)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"P": lag().nominal_system()}, "no blocks"),
        ({"n_meas": 4}, "has no 4 y"),
        ({"order": -1}, "out of range"),
        ({"iterations": -1}, "out of range"),
        ({"tolerance": 1.0}, "out of range"),
        ({"measure": "norm"}, "out of range"),
        ({"blocks": (FullBlock(name="again"),)}, "uncertain already"),
        ({"P": Lti(A=[[0.5]], B=[[1, 1, 1]], C=[[1], [1], [1]], D=np.zeros((3, 3)), dt=0.1), "blocks": ()}, "discrete"),
        ({"P": lag().M, "blocks": (FullBlock(name="k"),), "measure": "l2gain"}, "no real parameter"),
    ],
)
def test_bad_input_is_named(change, told):
    with pytest.raises(ValueError, match=told):
        musyn(**({"P": lag(), "n_meas": 1, "n_con": 1} | change))


def test_ill_posed_problems_and_hopeless_uncertainty_are_design_errors():
    blind = lag() @ np.diag([1.0, 0.0, 1.0])
    with pytest.raises(DesignError, match="D21"):
        musyn(blind, 1, 1)
    # the sign of the gain is unknown, and the plant unstable: no linear controller holds all members
    unstable = Lti(A=[[1.0]], B=[[1.0, 0.0, 1.0]], C=[[1.0], [0.0], [1.0]], D=[[0, 0, 0], [0, 0, 0.2], [0, 0.1, 0]])
    unknown = unstable @ append(np.eye(2), ureal("k", range=(-1.0, 3.0)))
    with pytest.raises(DesignError, match="no start has a finite bound"):
        musyn(unknown, 1, 1, order=0, measure="l2gain", tolerance=0.9)


def test_bounds_that_contradict_each_other_are_refused(monkeypatch):
    def wrong(loop, upper):
        return module.Bracket(lower=2.0 * upper, upper=upper, omega=1.0, delta={})

    monkeypatch.setattr(module, "_bad_member", wrong)
    with pytest.raises(DesignError, match="rounding spoilt the bounds"):
        musyn(lag(), 1, 1, measure="l2gain", tolerance=0.5)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_a_magnitude_of_the_order_is_found_again_and_its_system_is_minimum_phase(order):
    rng = np.random.default_rng(order)
    omega = np.geomspace(1e-2, 1e3, 60)
    theta = np.concatenate([rng.uniform(-1.0, 1.0, 2 * order), [0.3]])
    truth = MinimumPhase(order=order, theta=theta)
    target = 2.0 * truth.log_response(omega).real.astype(complex)
    a, b = fit_factors(omega, target, np.ones(omega.size), order)
    assert a is b
    np.testing.assert_allclose(a.log_response(omega).real, truth.log_response(omega).real, atol=0.02)
    system = a.system()
    np.testing.assert_allclose(system.response(omega)[:, 0, 0], np.exp(a.log_response(omega)), rtol=1e-9)
    inverse = Lti(A=system.A - system.B @ system.C / system.D, B=system.B, C=system.C, D=system.D)
    assert system.is_stable()
    assert inverse.is_stable()


def test_the_least_order_that_fits_is_taken():
    omega, flat = np.geomspace(1e-2, 1e2, 40), np.ones(40)
    a, _ = fit_least_order(
        omega, 2.0 * np.log(np.abs((1j * omega + 5) / (1j * omega + 1))) + 0j, flat, most=4, tolerance=0.01
    )
    assert a.order == 1
    a, _ = fit_least_order(omega, 0.7 * flat + 0j, flat, most=4, tolerance=0.01)
    assert a.order == 0


def test_a_multiplier_with_phase_is_factored_and_its_sign_is_told():
    omega = np.geomspace(1e-2, 1e2, 60)
    truth = [MinimumPhase(order=1, theta=np.array([z, p, 0.0])) for z, p in ((0.5, -0.5), (-0.2, 0.2))]
    target = truth[0].log_response(omega) + truth[1].log_response(omega).conj()
    a, b = fit_factors(omega, target, np.ones(omega.size), 1)
    np.testing.assert_allclose(a.log_response(omega) + b.log_response(omega).conj(), target, atol=0.01)
    assert is_positive_real(a, b)
    turned = [MinimumPhase(order=2, theta=np.array([s, 0.0, -s, 0.0, 0.0])) for s in (3.0, -3.0)]
    assert not is_positive_real(*turned)


def test_filters_are_small_exactly_where_their_multiplier_is_negative():
    rng = np.random.default_rng(5)
    a, b = (MinimumPhase(order=2, theta=np.concatenate([rng.uniform(-0.4, 0.4, 4), [0.1]])) for _ in range(2))
    d = MinimumPhase(order=1, theta=np.array([0.3, -0.3, 0.2]))
    filters = dynamic_filters([(a, b), (d, d)], [(1, 1), (1, 2)])
    omega = np.geomspace(0.1, 10.0, 7)
    signals = rng.normal(size=(5, 5)) @ np.eye(5) + 1j * rng.normal(size=(5, 5))
    for w, Psi in zip(omega, filters.response(omega), strict=True):
        W = np.exp(a.log_response(np.array([w])) + b.log_response(np.array([w])).conj())[0]
        D = np.exp(2.0 * d.log_response(np.array([w])).real)[0]
        for x in signals:
            (q, r0, r1), (p, s) = x[:3], x[3:]
            form = (np.conj(q + p) * W * (q - p)).real + D * (abs(r0) ** 2 + abs(r1) ** 2 - abs(s) ** 2)
            y = Psi @ x
            assert np.linalg.norm(y[:3]) ** 2 - np.linalg.norm(y[3:]) ** 2 == pytest.approx(form, abs=1e-9)


def test_constant_filters_are_the_factor_of_their_multiplier_and_undone_by_those_of_the_inverse():
    rng = np.random.default_rng(2)
    root, skew = rng.normal(size=(2, 2)), rng.normal()
    D, G = (root @ root.T + np.eye(2), np.array([[2.0]])), (np.array([[0.0, skew], [-skew, 0.0]]), np.zeros((1, 1)))
    T = constant_filters(D, G).D
    J = np.diag([1.0] * 3 + [-1.0] * 3)
    upper, across = np.zeros((3, 3)), np.zeros((3, 3))
    upper[:2, :2], upper[2:, 2:], across[:2, :2] = D[0], D[1], G[0]
    np.testing.assert_allclose(T.T @ J @ T, np.block([[upper, across], [across.T, -upper]]), atol=1e-12)
    P = Lti(A=-np.eye(2), B=rng.normal(size=(2, 4)), C=rng.normal(size=(4, 2)), D=0.1 * rng.normal(size=(4, 4)))
    back = transform(transform(P, gain(T), 3, 3), gain(np.linalg.inv(T)), 3, 3)
    np.testing.assert_allclose(back.response([0.5]), P.response([0.5]), atol=1e-9)


def test_repeated_parameters_are_split_for_the_fit():
    single = module._single_blocks(
        (RealBlock(name="k", low=0.0, high=2.0, nominal=1.0, repeats=3), FullBlock(name="f"))
    )
    assert [block.shape for block in single] == [(1, 1)] * 4


def two_parameters(c: float) -> Uncertain:
    """Two states and two parameters, the second state and parameter in units of 1 / c."""
    B = np.hstack([np.ones((2, 3)), [[0.0, 1.0], [0.0, 1.0]]])
    C = np.vstack([[[0.3, 0.1], [0.2, 0.3], [1.0, 1.0]], [[0.0, 0.0], [1.0, 0.0]]])
    D = np.zeros((5, 5))
    D[3, 4] = D[4, 3] = 0.1
    x, w = np.array([1.0, 1.0 / c]), np.array([1.0, 1.0 / c, 1.0, 1.0, 1.0])
    A = np.array([[-1.0, 0.2], [-0.3, -2.0]])
    M = Lti(A=A * x / x[:, None], B=B * w / x[:, None], C=C * x / w[:, None], D=D * w / w[:, None])
    return Uncertain(M=M, blocks=tuple(RealBlock(name=n, repeats=1, low=-1.0, high=1.0, nominal=0.0) for n in "ab"))


@pytest.mark.slow
@pytest.mark.parametrize("c", [1.0, 1e6])
def test_scalings_that_jump_with_frequency_end_the_refinement_and_units_do_not_matter(c):
    found = musyn(two_parameters(c), 1, 1, tolerance=0.02)
    assert found.upper == pytest.approx(0.2364, rel=0.01)
    assert found.lower <= found.upper


def test_no_iteration_returns_the_start_with_its_own_bounds():
    found = musyn(lag(), 1, 1, iterations=0)
    assert len(found.history) == 1
    assert found.lower <= found.upper <= found.history[0].upper
