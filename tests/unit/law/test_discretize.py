"""Tustin's rule, the law form, the self-schedule and saturation, on small controllers and on shipped designs."""

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.hover import linear_law
from gustproof.airframe.lpv import linear_plant
from gustproof.design.designs import design_problem, load_design
from gustproof.errors import DesignError
from gustproof.law.discretize import central_law
from gustproof.law.form import Law, Output, Provenance
from gustproof.law.step import step
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.state_space import Lti, discretize_zoh

DT = 0.004
ROUNDING = 1e-12


def central(name: str) -> Lti:
    problem = design_problem(load_design(name), load_vehicle("paper"))
    return hinfsyn(problem.plant(), 3, 3, gamma=load_design(name).gamma).lti


def law_of(K: Lti, *, scheduled: bool, limit: float = 10.0) -> Law:
    return central_law(
        "test", K, scheduled=scheduled, dt=DT, limits=np.full(3, limit), output=Output.TORQUE,
        provenance=Provenance(design="", vehicle=""),
    )  # fmt: skip


def test_tustins_rule_warps_frequency_and_keeps_the_response():
    K = Lti(A=[[-3.0, 20.0], [-20.0, -1.0]], B=[[1.0], [2.0]], C=[[1.0, 0.5]], D=[[0.3]])
    omega = np.array([0.5, 20.0, 200.0])
    sampled = tustin(K, 0.01).response(2.0 / 0.01 * np.arctan(omega * 0.01 / 2.0))
    assert np.allclose(sampled, K.response(omega), rtol=1e-10)


def test_states_keep_their_meaning_at_rest():
    K = Lti(A=[[-3.0, 20.0], [-20.0, -1.0]], B=[[1.0], [2.0]], C=[[1.0, 0.5]], D=[[0.3]])
    sampled = tustin(K, 0.01)
    assert np.allclose(np.linalg.solve(np.eye(2) - sampled.A, sampled.B), np.linalg.solve(-K.A, K.B), rtol=ROUNDING)


def test_a_pole_that_the_rule_can_not_map_is_refused():
    with pytest.raises(DesignError, match="500 rad/s"):
        tustin(Lti(A=[[500.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]]), DT)


@pytest.mark.parametrize("dt", [DT, 0.01])
def test_central_law_refuses_a_discrete_controller(dt):
    K = central("D1")
    with pytest.raises(ValueError, match=f"K is discrete, dt = {dt} s, must be continuous"):
        law_of(Lti(A=K.A, B=K.B, C=K.C, D=K.D, dt=dt).to_control(), scheduled=False)
    assert law_of(K.to_control(), scheduled=False).order == K.order


@pytest.mark.parametrize(("inputs", "has_reference"), [(3, False), (5, False), (6, True), (8, True)])
def test_the_limited_rate_is_asked_for_by_attitude_and_by_a_reference_if_there_is_one(inputs, has_reference):
    rng = np.random.default_rng(3)
    A, D = 0.1 * rng.normal(size=(7, 7)) - np.eye(7), 0.1 * rng.normal(size=(3, inputs))
    K = Lti(A=A, B=rng.normal(size=(7, inputs)), C=rng.normal(size=(3, 7)), D=D)
    law = central_law(
        "test", K, scheduled=True, dt=DT, limits=np.ones(3), output=Output.TORQUE,
        provenance=Provenance(design="", vehicle=""), rate_limits=np.full(3, 2.0),
    )  # fmt: skip
    S, T = law.rate_limit.S, law.rate_limit.T
    np.testing.assert_array_equal(np.diag(T[:, 3:6]), -np.diag(S[:, :3]) * has_reference)
    assert np.count_nonzero(S) == 3
    assert np.count_nonzero(T) == 3 * has_reference


def test_the_linear_law_is_tustins():
    K = central("D1")
    law, sampled = law_of(K, scheduled=False), tustin(K, DT)
    assert not law.is_scheduled
    assert np.allclose(law.A, sampled.A, rtol=ROUNDING, atol=1e-15)
    assert np.array_equal(law.B[:, 3:], np.zeros((9, 3)))


def test_the_self_scheduled_law_is_the_linear_one_at_level_attitude():
    K = central("D5")
    scheduled, linear = law_of(K, scheduled=True), law_of(K, scheduled=False)
    assert scheduled.is_scheduled
    assert np.allclose(linear_law(scheduled).A, linear.A, rtol=ROUNDING, atol=1e-15)
    x = np.zeros(9)
    x[3:] = np.random.default_rng(0).normal(size=6)  # level, but turning
    y = np.array([0.1, -0.2, 0.3, 0.0, 0.0, 0.0])
    for ours, expected in zip(step(scheduled, x, y), step(linear, x, y), strict=True):
        assert np.allclose(ours, expected, rtol=1e-9, atol=1e-12)


def test_the_self_scheduled_estimate_follows_the_exact_kinematics():
    # the two laws differ by dt (T(E) - I) omega in the attitude rows, and by its image elsewhere
    K = central("D5")
    scheduled, linear = law_of(K, scheduled=True), law_of(K, scheduled=False)
    x, y = np.zeros(9), np.zeros(6)
    phi, theta, q, r = 0.4, 0.3, 0.5, -0.7
    x[:6] = [phi, theta, 0.0, 0.0, q, r]
    psi_dot = (np.sin(phi) * q + np.cos(phi) * r) / np.cos(theta)
    excess = np.array([np.sin(theta) * psi_dot, np.cos(phi) * q - np.sin(phi) * r - q, psi_dot - r])
    difference = step(scheduled, x, y)[0] - step(linear, x, y)[0]
    assert np.allclose(difference, scheduled.G @ excess, rtol=1e-9, atol=1e-15)
    assert np.allclose(difference[:3], DT * excess, rtol=0.02)  # the leak and the estimator's gains change it a little


@pytest.mark.parametrize("name", ["D1", "D2", "D5", "D1-noise"])
def test_a_law_in_saturation_is_stable_by_itself_so_it_cannot_wind_up(name):
    K = central(name)
    assert K.is_stable()
    assert linear_law(law_of(K, scheduled=False)).is_stable()


def test_a_short_saturation_leaves_the_attitude_estimate_true():
    law, vehicle = law_of(central("D1"), scheduled=False, limit=2.5), load_vehicle("paper")
    plant = discretize_zoh(linear_plant(vehicle), DT)
    x, estimate = np.zeros(9), np.zeros(9)
    saturated = 0
    for k in range(1000):
        estimate, command = step(law, estimate, np.concatenate([plant.C[3:] @ x, np.zeros(3)]))
        saturated += command[0] == -2.5
        x = plant.A @ x + plant.B @ np.concatenate([command, [3.0 if k < 100 else 0.0, 0.0, 0.0]])
    assert saturated > 50
    assert abs(estimate[0] - x[0]) < 0.01  # of a peak near .6 rad
