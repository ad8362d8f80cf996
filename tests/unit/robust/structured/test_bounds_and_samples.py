"""Sampled plants, delays, and bounds on poles and on the controller: each checked apart from the search."""

import control
import numpy as np
import pytest
import scipy.linalg

from gustproof.robust.lti.norms import h2_norm, hinf_norm
from gustproof.robust.lti.state_space import Lti, as_lti, lft
from gustproof.robust.structured.blocks import Structure, full_structure, tunable_pid
from gustproof.robust.structured.goals import (
    ControllerSizeGoal,
    DecayGoal,
    GainGoal,
    NormKind,
    PoleRadiusGoal,
    RollOffGoal,
    SensitivityGoal,
    StabilityGoal,
)
from gustproof.robust.structured.hinfstruct import StructResult, hinfstruct
from gustproof.robust.structured.objective import Problem

STEP = 1e-6


def axis(dt: float = 0.0) -> Lti:
    """Return 1/s^2 with noisy angle and rate measured; with `dt`, sampled behind a hold."""
    A, B = np.array([[0.0, 1.0], [0.0, -0.1]]), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]])
    C = np.array([[1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    D = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.3], [0.0, 0.3, 0.0], [0.0, 0.3, 0.0]])
    held = scipy.linalg.expm(np.block([[A, B], [np.zeros((3, 5))]]) * dt)
    return Lti(A=held[:2, :2], B=held[:2, 2:], C=C, D=D, dt=dt) if dt else Lti(A=A, B=B, C=C, D=D)


def closed_poles(result: StructResult, P: Lti) -> np.ndarray:
    return lft(P, result.lti).poles()


@pytest.mark.slow
def test_a_sampled_plant_gets_a_sampled_controller_with_the_norm_of_its_own_loop():
    P = axis(0.05)
    result = hinfstruct(P, 2, 1, order=1, starts=1)
    K = result.lti
    assert K.dt == 0.05
    # python-control's feedback and numpy's frequency response, nothing of ours
    plant, k = P.to_control(), K.to_control()
    inner = control.feedback(control.ss([], [], [], np.eye(2), 0.05), plant[2:, 2] * k, 1)
    closed = plant[:2, :2] + plant[:2, 2] * k * inner * plant[2:, :2]
    omega = np.geomspace(1e-3, np.pi / 0.05, 4000)
    gains = np.linalg.norm(np.moveaxis(closed(np.exp(1j * omega * 0.05)), -1, 0), 2, axis=(1, 2))
    assert np.max(np.abs(closed_poles(result, P))) < 1.0
    assert result.norm == pytest.approx(np.max(gains), rel=1e-4)
    assert result.gamma_opt is None or result.gamma_opt <= result.norm * (1.0 + 1e-6)
    assert "stable" in result.checks[0]


@pytest.mark.slow
def test_fast_sampling_gives_the_continuous_norm():
    slow, fast = (hinfstruct(axis(dt), 2, 1, starts=1).norm for dt in (0.2, 1e-2))
    continuous = hinfstruct(axis(), 2, 1, starts=1).norm
    assert fast == pytest.approx(continuous, rel=2e-2)
    assert slow > fast


def test_a_sampled_pid_is_tuned_with_its_own_states():
    pid = tunable_pid("pid", input=0, output=0, cutoff=20.0, dt=0.05)
    structure = Structure(blocks=(pid,), n_meas=2, n_con=1, dt=0.05)
    result = hinfstruct(axis(0.05), 2, 1, structure=structure, starts=2)
    k_p, k_i, k_d = result.theta
    z = np.exp(0.2j)
    kept = np.exp(-1.0)
    expected = k_p + k_i * 0.05 / (z - 1.0) + 20.0 * k_d * (1.0 - (1.0 - kept) / (z - kept))
    assert result.blocks["pid"].dt == 0.05
    assert np.allclose(result.lti.response([4.0])[0], [[expected, 0.0]], rtol=1e-9)


def test_the_sampled_h2_norm_is_that_of_its_own_gramian():
    structure = full_structure(1, 2, 1, dt=0.05)
    goal = GainGoal(measure=NormKind.RMS)
    objective = Problem(models=(axis(0.05),), structure=structure, target=goal, hard_goals=()).objective()
    theta = np.array([0.4, 0.1, -0.2, 0.1, -0.6, -0.9])
    closed = lft(axis(0.05), structure.controller(theta))
    assert objective.goal_values(theta)[0] == pytest.approx(h2_norm(closed), rel=1e-9)


GOALS = [
    DecayGoal(minimum=5.0),
    PoleRadiusGoal(limit=0.1),
    ControllerSizeGoal(limit=0.1),
    ControllerSizeGoal(limit=0.1, entries=True),
    StabilityGoal(margin=60.0),
    GainGoal(limit=1e-3, measure=NormKind.RMS, outputs=(0,)),
    SensitivityGoal(limit=0.1),
    RollOffGoal(corner=10.0, limit=1e-3),
]
"""Each far from kept, so that its price counts."""


@pytest.mark.parametrize("dt", [0.0, 0.05])
@pytest.mark.parametrize("goal", GOALS, ids=lambda goal: f"{type(goal).__name__}{getattr(goal, 'entries', '')}")
def test_every_goal_has_the_gradient_of_finite_differences(goal, dt):
    structure = full_structure(1, 2, 1, dt=dt)
    theta = np.array([0.4 if dt else -2.0, 0.1, -0.2, 0.1, -0.6, -0.9])
    objective = Problem(models=(axis(dt),), structure=structure, target=GainGoal(), hard_goals=(goal,)).objective()
    objective = objective.use_minimax(1e9)
    assert objective.value(theta) > 1.0
    found = objective.branches(theta, 0.0)[0].gradient
    steps = STEP * np.eye(theta.size)
    expected = [(objective.value(theta + step) - objective.value(theta - step)) / (2.0 * STEP) for step in steps]
    assert np.allclose(found, expected, rtol=0.0, atol=2e-5 * np.max(np.abs(expected)))


@pytest.mark.slow
@pytest.mark.parametrize("goal", [DecayGoal(minimum=2.5), PoleRadiusGoal(limit=0.8)], ids=lambda goal: goal.name)
def test_a_minimum_decay_and_a_pole_radius_are_kept_at_a_price(goal):
    P = axis() if isinstance(goal, DecayGoal) else axis(0.05)
    free, held = (hinfstruct(P, 2, 1, starts=1, hard_goals=goals) for goals in ([], [goal]))
    before, after = closed_poles(free, P), closed_poles(held, P)
    if isinstance(goal, DecayGoal):
        assert np.max(before.real) > -goal.minimum >= np.max(after.real)
    else:
        assert np.max(np.abs(before)) > goal.limit >= np.max(np.abs(after))
    assert held.norm > free.norm
    assert held.hard_goals[goal.name] <= 1.0


@pytest.mark.slow
def test_a_bound_on_the_gain_is_kept_and_used_up():
    free = hinfstruct(axis(), 2, 1, starts=1)
    goal = ControllerSizeGoal(limit=0.7 * float(np.max(np.abs(free.lti.D))), entries=True)
    held = hinfstruct(axis(), 2, 1, starts=1, hard_goals=[goal])
    assert 0.99 * goal.limit < np.max(np.abs(held.lti.D)) <= goal.limit
    assert held.norm > free.norm
    assert hinf_norm(lft(axis(), held.lti)).gain == pytest.approx(held.norm, rel=1e-6)


def test_the_limits_of_the_new_goals_must_be_positive():
    for goal in (DecayGoal(minimum=0.0), PoleRadiusGoal(limit=-1.0), ControllerSizeGoal(limit=0.0)):
        with pytest.raises(ValueError, match=r"limit.*must be positive"):
            hinfstruct(axis(), 2, 1, starts=1, hard_goals=[goal])
    with pytest.raises(ValueError, match="half the sample rate"):
        hinfstruct(axis(0.05), 2, 1, starts=1, hard_goals=[RollOffGoal(corner=70.0)])
    weight = as_lti(control.ss(-1.0, 1.0, 1.0, 0.0))
    with pytest.raises(ValueError, match="weight with the sample time 0"):
        hinfstruct(axis(0.05), 2, 1, starts=1, soft_goal=GainGoal(outputs=(0,), weight=weight))
