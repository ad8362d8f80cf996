"""Analytic gradients against finite differences, and the search's norms against independent ones."""

from dataclasses import replace

import numpy as np
import pytest

from gustproof.robust.lti.norms import h2_norm, hinf_norm
from gustproof.robust.lti.state_space import Lti, gain, lft
from gustproof.robust.structured import objective
from gustproof.robust.structured.blocks import full_structure
from gustproof.robust.structured.goals import (
    DiskMarginGoal,
    GainGoal,
    LoopLocation,
    NormKind,
    RollOffGoal,
    SensitivityGoal,
    StabilityGoal,
)
from gustproof.robust.structured.loop import (
    PoleMeasure,
    abscissa,
    augment_plant,
    close_loop,
    loop_h2_norm,
    loop_peak,
    peak_slopes,
    pole_slopes,
)
from gustproof.robust.structured.objective import Problem

STEP = 1e-6
"""Relative; central differences are then good to some 1e-9 of the third derivative."""
DIFFERENCES = 2e-5
"""Relative accuracy to which differences confirm a gradient."""


def random_plant(seed: int, *, feedthrough: bool) -> Lti:
    """Return a stable plant with 2 measurements, 2 controls and, if asked, full D matrices (D22 too)."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(4, 4))
    D = 0.3 * rng.normal(size=(5, 4))
    if not feedthrough:
        D[:, :2] = 0.0
        D[3:] = 0.0
    return Lti(A=A - 4.0 * np.eye(4), B=rng.normal(size=(4, 4)), C=rng.normal(size=(5, 4)), D=D)


def controller(seed: int, order: int, *, strictly_proper: bool = False) -> np.ndarray:
    M = 0.1 * np.random.default_rng([seed, 7]).normal(size=(order + 2, order + 2))
    M[:order, :order] -= np.eye(order)
    if strictly_proper:
        M[order:, order:] = 0.0
    return M


def differences(function, M: np.ndarray) -> np.ndarray:
    gradient = np.zeros(M.shape)
    for index in np.ndindex(M.shape):
        step = np.zeros(M.shape)
        step[index] = STEP
        gradient[index] = (function(M + step) - function(M - step)) / (2.0 * STEP)
    return gradient


@pytest.mark.parametrize("order", [0, 2])
@pytest.mark.parametrize("seed", range(4))
def test_the_gradient_of_the_h_infinity_norm_is_that_of_finite_differences(seed, order):
    plant, M = augment_plant(random_plant(seed, feedthrough=True), 2, 2, order), controller(seed, order)
    loop = close_loop(plant, M)
    top = loop_peak(loop, [])
    slope = peak_slopes(loop, top, 0.0)[0]
    expected = differences(
        lambda K: loop_peak(close_loop(plant, K), [top.omega] if np.isfinite(top.omega) else []).gain, M
    )
    assert slope.value == pytest.approx(top.gain, rel=1e-9)
    assert np.allclose(slope.gradient, expected, rtol=0.0, atol=DIFFERENCES * np.max(np.abs(expected)))


@pytest.mark.parametrize("seed", range(4))
def test_the_gradient_of_the_abscissa_is_that_of_finite_differences(seed):
    plant, M = augment_plant(random_plant(seed, feedthrough=True), 2, 2, 2), controller(seed, 2)
    loop = close_loop(plant, M)
    slope = pole_slopes(loop.A, loop.B2, loop.C2, PoleMeasure(), 0.0)[0]
    expected = differences(lambda K: abscissa(close_loop(plant, K).A), M)
    assert slope.value == pytest.approx(abscissa(loop.A))
    assert np.allclose(slope.gradient, expected, rtol=0.0, atol=DIFFERENCES * np.max(np.abs(expected)))


WEIGHT = Lti(A=-np.eye(2), B=np.eye(2), C=np.eye(2), D=0.1 * np.eye(2))
GOALS = [
    GainGoal(limit=1e-3, inputs=(1,), outputs=(0, 2), weight=WEIGHT),
    GainGoal(limit=1e-3, measure=NormKind.RMS, outputs=(0, 1)),
    SensitivityGoal(limit=0.1),
    SensitivityGoal(limit=0.1, location=LoopLocation.OUTPUT, channels=(1,)),
    DiskMarginGoal(minimum=20.0),
    RollOffGoal(corner=10.0, limit=1e-3, slope=2),
    StabilityGoal(margin=3.0),
]
"""Each far from kept, so that its price counts."""


@pytest.mark.parametrize("goal", GOALS, ids=lambda goal: type(goal).__name__)
@pytest.mark.parametrize("minimax", [True, False])
def test_every_goal_has_the_gradient_of_finite_differences(goal, minimax):
    structure = full_structure(2, 2, 2)
    models = tuple(random_plant(seed, feedthrough=False) for seed in (1, 2))
    problem = Problem(models=models, structure=structure, target=GainGoal(), hard_goals=(goal,))
    M = controller(3, 2, strictly_proper=isinstance(goal, GainGoal))
    fixed = np.arange(M.size).reshape(M.shape)[2:, 2:].ravel() if isinstance(goal, GainGoal) else []
    objective = problem.objective()
    theta = M.ravel()
    scale = objective.goal_values(theta)[0]
    assert np.isfinite(scale)
    # the target is scaled so that it does not hide the goal
    objective = objective.use_minimax(1e6 * scale) if minimax else objective.use_penalty(1e6 * scale, 3.0)
    assert objective.value(theta) > 1.0
    free = [k for k in range(theta.size) if k not in fixed]
    expected = []
    for k in free:
        step = np.zeros(theta.size)
        step[k] = STEP
        expected.append((objective.value(theta + step) - objective.value(theta - step)) / (2.0 * STEP))
    gradient = objective.branches(theta, 0.0)[0].gradient[free]
    assert np.allclose(gradient, expected, rtol=0.0, atol=DIFFERENCES * np.max(np.abs(expected)))


def test_branches_near_the_largest_hold_other_peaks_and_other_models():
    structure = full_structure(0, 2, 2)
    model = random_plant(1, feedthrough=False)
    louder = Lti(A=model.A, B=model.B * [1.02, 1.02, 1.0, 1.0], C=model.C, D=model.D)
    problem = Problem(models=(model, louder), structure=structure, target=GainGoal(), hard_goals=())
    objective, theta = problem.objective(), np.full(4, 0.1)
    branches = objective.branches(theta, 0.05)
    values = [branch.value for branch in branches]
    assert values[0] == pytest.approx(objective.value(theta))
    assert values == sorted(values, reverse=True)
    assert min(abs(value * 1.02 / values[0] - 1.0) for value in values) < 1e-6


@pytest.mark.parametrize("seed", range(6))
def test_the_searchs_norms_are_the_independent_ones(seed):
    P, M = random_plant(seed, feedthrough=False), controller(seed, 2, strictly_proper=True)
    K = Lti(A=M[:2, :2], B=M[:2, 2:], C=M[2:, :2], D=M[2:, 2:])
    loop, G = close_loop(augment_plant(P, 2, 2, 2), M), lft(P, K)
    assert loop_peak(loop, []).gain == pytest.approx(hinf_norm(G).gain, rel=1e-6)
    strictly_proper = Lti(A=G.A, B=G.B, C=G.C, D=np.zeros(G.D.shape))
    assert loop_h2_norm(loop) == pytest.approx(h2_norm(strictly_proper), rel=1e-9)


def test_a_flat_peak_is_found():
    # near an optimum the gain is flat and eigenvalues leave the axis by rounding: a dense grid is the judge
    poles, gains = [1.0, 10.0, 100.0], [1.0, 1.0, 1.0]
    A = np.diag([-p for p in poles])
    G = Lti(
        A=A,
        B=np.sqrt(2.0 * np.array(poles))[:, None],
        C=-np.diag(gains) @ np.diag(np.sqrt(2.0 * np.array(poles))),
        D=np.ones((3, 1)),
    )
    P = Lti(
        A=G.A,
        B=np.hstack([G.B, np.zeros((3, 1))]),
        C=np.vstack([G.C, np.zeros((1, 3))]),
        D=np.block([[G.D, np.zeros((3, 1))], [np.zeros((1, 2))]]),
    )
    loop = close_loop(augment_plant(P, 1, 1, 0), np.zeros((1, 1)))
    assert loop_peak(loop, []).gain == pytest.approx(np.sqrt(3.0), rel=1e-9)


def test_peaks_that_the_search_misses_count_in_its_results(monkeypatch):
    monkeypatch.setattr(objective, "loop_peak", lambda loop, warm: replace(loop_peak(loop, warm), gain=0.9))
    model, theta = random_plant(1, feedthrough=False), np.full(4, 0.1)
    hard = (GainGoal(name="gain", limit=2.0), GainGoal(name="power", limit=2.0, measure=NormKind.RMS))
    problem = Problem(models=(model,), structure=full_structure(0, 2, 2), target=GainGoal(), hard_goals=hard)
    searched, checked = (problem.objective().goal_values(theta, checked=each) for each in (False, True))
    norm = hinf_norm(lft(model, gain(0.1 * np.ones((2, 2))))).gain
    assert (searched[0], searched[1]["gain"]) == (0.9, 0.45)
    assert checked[0] == pytest.approx(norm, rel=1e-8)
    assert checked[1]["gain"] == pytest.approx(0.5 * norm, rel=1e-8)
    assert checked[1]["power"] == searched[1]["power"]
