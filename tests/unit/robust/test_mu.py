"""Mu and worst-case gain against closed forms, and bounds that must bracket."""

import math
from itertools import product

import numpy as np
import pytest
from control import ss

from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.rotational import Envelope, rotation, uncertain_airframe
from gustproof.design.designs import design_problem, load_design
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lti import margins
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, discretize_zoh, gain
from gustproof.robust.mu import scalings, singular_value
from gustproof.robust.mu.scalings import best_scalings
from gustproof.robust.mu.singular_value import disk_margin_bounds, mu
from gustproof.robust.mu.sweep import add_performance_block
from gustproof.robust.mu.worst_gain import restrict, wcgain
from gustproof.robust.mu.worst_margin import wcmargin
from gustproof.robust.uncertain.elements import ureal
from gustproof.robust.uncertain.uncertain_system import Uncertain, fill_diagram, lft, system_from_matrix
from gustproof.robust.uncertain.uncertainty import FullBlock, RealBlock

TIGHT = 1e-3
"""Relative; the accuracy that the scalings are asked for."""
SCALARS = (FullBlock(name="a"), FullBlock(name="b"))


def oscillator(stiffness: Uncertain | float, damping: Uncertain | float) -> Uncertain:
    """x'' = u - damping x' - stiffness x, from u to x."""
    row = np.array([[0.0, 0.0, 1.0]]) - np.array([[1.0]]) @ (
        real_or(stiffness) @ np.array([[1.0, 0.0, 0.0]]) + real_or(damping) @ np.array([[0.0, 1.0, 0.0]])
    )
    rest = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    return system_from_matrix(np.array([[0.0], [1.0], [0.0]]) @ row + rest, 2)


def real_or(value: Uncertain | float) -> Uncertain:
    return value if isinstance(value, Uncertain) else Uncertain(M=gain([[value]]))


def attitude_loop(angle: float, rate: float) -> Uncertain:
    vehicle, design = load_vehicle("paper"), load_design("D2")
    problem = design_problem(design, vehicle)
    result = hinfsyn(problem.plant(), problem.n_meas, problem.n_con, gamma=design.gamma)
    dynamics = rotation(vehicle.inertia_B, Envelope(angle=angle, rate=rate))
    airframe = uncertain_airframe(dynamics, leak=design.leak, rate_damping=0.05)
    return lft(fill_diagram(problem, {"airframe": airframe}), result.lti)


@pytest.mark.parametrize("seed", range(4))
def test_one_complex_block_has_the_largest_singular_value_and_two_their_best_balance(seed):
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(2, 2)) + 1j * rng.normal(size=(2, 2))
    whole = best_scalings(M, (FullBlock(name="a", n_outputs=2, n_inputs=2),), gain=False).level(M)
    assert whole == pytest.approx(np.linalg.norm(M, 2), rel=1e-9)
    # two scalar blocks: mu = min over d of the norm of [[a, b d], [c / d, e]], and d^2 = |c / b| is the minimiser
    d = math.sqrt(abs(M[1, 0] / M[0, 1]))
    expected = np.linalg.norm(M * [[1.0, d], [1.0 / d, 1.0]], 2)
    assert best_scalings(M, SCALARS, gain=False, accuracy=TIGHT).level(M) == pytest.approx(expected, rel=TIGHT)


def test_mu_of_two_complex_scalars_and_a_constant_matrix_is_the_analytic_one():
    M = np.array([[0.5, 4.0], [-0.3, 0.8]])
    d = math.sqrt(abs(M[1, 0] / M[0, 1]))
    expected = np.linalg.norm(M * [[1.0, d], [1.0 / d, 1.0]], 2)
    found = mu(Uncertain(M=gain(M), blocks=SCALARS), accuracy=TIGHT)
    assert found.lower == pytest.approx(expected, rel=2.0 * TIGHT)
    assert found.upper == pytest.approx(expected, rel=TIGHT)
    assert found.lower <= expected <= found.upper


def test_real_blocks_profit_from_being_real():
    # rank one, so mu of repeated blocks is analytic: 1 - delta (m1 + m2) = 0 with real delta
    blocks = (RealBlock(name="k", low=-1.0, high=1.0, nominal=0.0, repeats=2),)
    M = np.outer([1.0, 1.0], [0.3, 0.5]).astype(complex)
    assert best_scalings(M, blocks, gain=False, accuracy=TIGHT).level(M) == pytest.approx(0.8, rel=TIGHT)
    turned = 1j * M
    assert best_scalings(turned, blocks, gain=False, accuracy=TIGHT).level(turned) < 0.01
    assert best_scalings(turned, blocks, gain=False, accuracy=TIGHT, real=False).level(turned) == pytest.approx(
        0.8, rel=TIGHT
    )


def test_scalings_are_judged_by_what_they_prove_not_by_who_made_them():
    rng = np.random.default_rng(5)
    M = rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))
    blocks = (RealBlock(name="k", low=-1.0, high=1.0, nominal=0.0), *SCALARS)
    level, other = best_scalings(M, blocks, gain=False, accuracy=TIGHT).level, M + 0.5
    assert level(other) > level(M)
    # whatever the scalings, no Delta of norm 1 / level makes the loop singular
    for seed in range(200):
        draw = np.random.default_rng(seed)
        Delta = np.diag([draw.uniform(-1.0, 1.0), *np.exp(2j * np.pi * draw.uniform(size=2))])
        real_eigenvalues = [abs(e) for e in np.linalg.eigvals(other @ Delta) if abs(e.imag) < 1e-12]
        assert max(real_eigenvalues, default=0.0) <= level(other)
        assert max(abs(np.linalg.eigvals(M @ np.diag([0.0, *np.diag(Delta)[1:]])))) <= level(M)


@pytest.mark.slow
def test_real_parameters_alone_are_bracketed_even_where_mu_jumps():
    for stiffness, damping, name, edge in (
        (ureal("k", range=(-1.0, 3.0)), 0.2, "k", -0.5),
        (4.0, ureal("c", range=(-0.3, 0.7)), "c", -0.4),
    ):
        loop = oscillator(stiffness, damping)
        alone = Uncertain(M=loop.M.subsystem(slice(0, loop.n_z), slice(0, loop.n_w)), blocks=loop.blocks)
        found = mu(alone)
        assert found.delta[name] == pytest.approx(edge, rel=0.01)
        assert found.lower <= 1.0 / abs(edge) <= found.upper
        assert found.gap < 0.05
        sampled = mu(Uncertain(M=discretize_zoh(alone.M, 0.01), blocks=alone.blocks))
        assert sampled.upper == pytest.approx(found.upper, rel=0.05)  # the hold is a little delay


def test_the_worst_gain_of_a_resonance_is_at_the_least_damping():
    found = wcgain(oscillator(1.0, ureal("c", range=(0.1, 0.3))))
    assert found.lower == pytest.approx(1.0 / (0.1 * math.sqrt(1.0 - 0.1**2 / 4.0)), rel=1e-6)
    assert found.delta == {"c": -1.0}
    assert found.lower <= found.upper <= 1.03 * found.lower


@pytest.mark.slow
@pytest.mark.parametrize(("angle", "rate", "lower"), [(0.3, 0.5, 0.279), (0.5, 1.0, 0.321), (0.8, 1.5, 0.434)])
def test_no_member_of_the_family_exceeds_the_worst_gain_and_the_bracket_is_within_five_percent(angle, rate, lower):
    system = attitude_loop(angle, rate)
    found = wcgain(system)
    assert found.lower == pytest.approx(lower, rel=0.005)
    assert found.gap < 0.05
    assert hinf_norm(system.member(found.delta)).gain == pytest.approx(found.lower, rel=1e-9)
    assert all(hinf_norm(system.substitute(values)).gain <= found.upper for values in system.sample(50, 1))


def test_a_band_holds_everywhere_inside_and_ends_where_the_level_is_met():
    system = attitude_loop(0.1, 0.5)
    blocks = add_performance_block(system)
    scalings = best_scalings(system.M.response(2.0)[0], blocks, gain=True)
    low, high = scalings.band(system.M, 0.255, 2.0)
    assert 0.0 < low < 2.0 < high < math.inf
    levels = [scalings.level(M) for M in system.M.response(np.geomspace(low * 1.001, high * 0.999, 50))]
    assert max(levels) < 0.255
    assert scalings.level(system.M.response(high * 1.01)[0]) > 0.255
    assert scalings.band(system.M, 0.2, 2.0) == (2.0, 2.0)


@pytest.mark.slow
def test_branch_and_bound_narrows_the_bracket_and_keeps_the_truth_inside():
    stiffness, damping = ureal("k", range=(0.3, 1.7)), ureal("c", range=(0.05, 0.35))
    system = oscillator(stiffness, damping)
    truth = 1.0 / (0.05 * math.sqrt(0.3 - 0.05**2 / 4.0))
    one, many = wcgain(system, accuracy=1e-3, boxes=1), wcgain(system, accuracy=1e-3, boxes=3)
    assert many.lower == pytest.approx(truth, rel=1e-6)
    assert truth <= many.upper <= one.upper
    assert many.gap < 0.01


@pytest.mark.slow
def test_branch_and_bound_brings_mu_of_real_parameters_down_to_what_a_delta_reaches():
    """M / (s + 1) with a real matrix: singular first at rest, where scalings leave an eighth; D found by search."""
    M = [[-1.4, -1.2, -1.3, -0.6], [1.4, -1.6, 0.9, 1.3], [-0.4, -0.7, 0.5, 1.2], [2.2, 0.9, 1.6, -0.5]]
    blocks = tuple(RealBlock(name=name, low=-1.0, high=1.0, nominal=0.0) for name in "abcd")
    system = Uncertain(M=Lti(A=-np.eye(4), B=np.eye(4), C=M, D=np.zeros((4, 4))), blocks=blocks)
    corners = [np.linalg.eigvals(M @ np.diag(d)) for d in product((-1.0, -0.5, 0.0, 0.5, 1.0), repeat=4)]
    truth = max(float(np.max(e.real[np.abs(e.imag) < 1e-9], initial=0.0)) for e in corners)  # a pole at 0
    one, many = mu(system), mu(system, boxes=4)
    assert one.gap > 0.12
    assert many.gap < 0.025
    assert many.lower <= truth * (1.0 + 1e-9) <= many.upper < one.upper
    assert not singular_value._is_stable_within(system, 0.98 / truth, 0.02, 1)


def test_full_blocks_are_restricted_with_the_box():
    blocks = (RealBlock(name="k", low=-1.0, high=1.0, nominal=0.0), *SCALARS)
    system = Uncertain(M=gain(np.random.default_rng(2).normal(size=(3, 3))), blocks=blocks)
    inner = restrict(system, {"k": (-0.25, 0.25)}, radius=0.25)
    assert inner.M.response(1.0) == pytest.approx(0.25 * system.M.response(1.0))
    found = mu(system, accuracy=TIGHT)
    assert singular_value._is_stable_within(system, 0.99 / found.upper, TIGHT, 1)
    assert not singular_value._is_stable_within(system, 1.01 / found.lower, TIGHT, 1)


def test_a_box_of_parameters_is_a_family_of_the_same_members():
    system = attitude_loop(0.3, 0.5)
    inner = restrict(system, {"t": (0.0, 1.0), "v": (-0.5, 0.5), "r": (-1.0, -0.5), "q": (-1.0, 1.0)})
    expected = system.member({"t": 0.75, "v": 0.25, "r": -0.75, "q": 0.1}).response(3.0)
    assert inner.member({"t": 0.5, "v": 0.5, "r": 0.0, "q": 0.1}).response(3.0) == pytest.approx(expected, rel=1e-9)


def test_the_spinning_satellite_has_a_tenth_of_a_disk_margin():
    # Zhou, Doyle and Glover, section 9.6: 1 / |1 + a j| for complex perturbations at a = 10, here in symmetric form
    loop = Lti(A=[[0.0, 10.0], [-10.0, 0.0]], B=np.eye(2), C=[[1.0, 10.0], [-10.0, 1.0]], D=np.zeros((2, 2)))
    low, high = disk_margin_bounds(loop)
    assert low <= high <= 1.002 * low
    assert low == pytest.approx(0.0997, rel=0.002)


def test_the_disk_margin_of_one_loop_is_its_distance_from_the_critical_point():
    # 8 / (s (s + 1) (s + 4))
    loop = Lti(
        A=[[0.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, -4.0]],
        B=[[0.0], [0.0], [1.0]],
        C=[[8.0, 0.0, 0.0]],
        D=[[0.0]],
    )
    s = 1j * np.geomspace(0.01, 100.0, 200_000)
    L = 8.0 / (s * (s + 1.0) * (s + 4.0))
    distance = np.min(np.abs(2.0 * (1.0 + L) / (1.0 - L)))  # one over |S - 1/2|
    low, high = disk_margin_bounds(loop)
    assert low <= distance * (1.0 + 1e-6)
    assert distance <= high * (1.0 + 1e-6)
    assert low >= high / (1.0 + 2.0 * TIGHT)
    assert margins.disk_margin(loop) == pytest.approx(distance, rel=1e-6)
    # what it guarantees lies within the classical margins
    classical = margins.loop_margins(loop)
    assert (2.0 + low) / (2.0 - low) <= classical.gain_margin
    assert 2.0 * math.atan(low / 2.0) <= classical.phase_margin


def test_what_has_no_mu_is_refused():
    with pytest.raises(ValueError, match="nothing uncertain"):
        mu(Uncertain(M=gain(np.zeros((0, 0)))))
    with pytest.raises(ValueError, match="unstable at Delta = 0"):
        mu(oscillator(ureal("k", range=(-3.0, 1.0)), 0.2))
    with pytest.raises(ValueError, match="no worst gain"):
        wcgain(ss(-1.0, 1.0, 1.0, 0.0))
    with pytest.raises(ValueError, match="no worst gain"):
        wcgain(Uncertain(M=gain([[1.0]]), blocks=()))


def test_an_unstable_member_makes_the_worst_gain_infinite():
    found = wcgain(oscillator(1.0, ureal("c", range=(-0.1, 0.3))), boxes=2)
    assert math.isinf(found.upper)


INTEGRATOR = Lti(A=[[0.0, 1.0], [0.0, -2.0]], B=[[0.0], [1.0]], C=[[2.0, 0.0]], D=[[0.0]])


def test_the_worst_margin_of_a_gain_is_that_of_its_largest_value():
    found = wcmargin(ureal("gain", range=(0.5, 1.5)) @ INTEGRATOR)
    low, high = found.lower, found.upper
    worst = disk_margin_bounds(Lti(A=INTEGRATOR.A, B=INTEGRATOR.B, C=1.5 * INTEGRATOR.C, D=INTEGRATOR.D))
    assert low <= worst[1]
    assert high >= worst[0]
    assert high <= 1.01 * low


def test_a_family_with_unstable_members_has_no_margin_and_bad_loops_are_named():
    third_order = Lti(A=[[0, 1, 0], [0, 0, 1], [-1, -3, -3]], B=[[0], [0], [1]], C=[[1, 0, 0]], D=[[0]])
    assert wcmargin(ureal("gain", range=(2.0, 9.0)) @ third_order).upper == 0.0
    with pytest.raises(ValueError, match="no blocks"):
        wcmargin(Uncertain(M=INTEGRATOR))
    with pytest.raises(ValueError, match="must be square"):
        wcmargin(ureal("gain", range=(0.5, 1.5)) @ gain([[1.0, 1.0]]))
    with pytest.raises(ValueError, match="unstable at Delta = 0"):
        wcmargin(ureal("gain", range=(8.5, 9.5)) @ third_order)


def test_a_curvature_that_has_no_factor_is_named(monkeypatch):
    monkeypatch.setattr(scalings.scipy.linalg.lapack, "dposv", lambda _hessian, gradient: (None, gradient, 1))
    one = np.ones((1, 1, 1), dtype=np.complex128)
    with pytest.raises(np.linalg.LinAlgError, match="Hessian matrix is not positive definite"):
        scalings._centre(np.zeros(1), 1.0, [one[0]], [one])
