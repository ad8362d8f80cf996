"""The attitude design problem against its equations."""

import numpy as np

from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.generalized import Weights, rates_problem, torque_problem
from gustproof.robust.lti.weights import constant_weight, first_order_weight

PAPER = load_vehicle("paper")
WEIGHTS = Weights(
    W_d=constant_weight((0.65, 0.65, 0.3)),
    W_n=constant_weight((0.0036,) * 3),
    W_e=constant_weight((2.0,) * 3),
    W_u=constant_weight((0.3,) * 3),
)


def test_the_plant_is_that_of_the_equations():
    P = torque_problem(PAPER, WEIGHTS, leak=0.05, rate_damping=0.02).plant()
    identity, zero, J = np.eye(3), np.zeros((3, 3)), np.diag(1.0 / np.array(PAPER.inertia_B))
    A = np.block([[-0.05 * identity, identity, zero], [zero, -0.02 * identity, J], [zero, zero, -20.0 * identity]])
    B = np.block([[zero, zero, zero], [J @ np.diag([0.65, 0.65, 0.3]), zero, zero], [zero, zero, 20.0 * identity]])
    C = np.block([[2.0 * identity, zero, zero], [zero, zero, zero], [zero, identity, zero]])
    D = np.block([[zero, zero, zero], [zero, zero, 0.3 * identity], [zero, 0.0036 * identity, zero]])
    for ours, expected in ((P.A, A), (P.B, B), (P.C, C), (P.D, D)):
        assert np.allclose(ours, expected, rtol=1e-15)


def test_states_of_a_frequency_dependent_weight_stand_after_those_of_the_vehicle():
    shaped = Weights(
        W_d=first_order_weight((0.65,) * 3, 1.0, (0.1,) * 3), W_n=WEIGHTS.W_n, W_e=WEIGHTS.W_e, W_u=WEIGHTS.W_u
    )
    P = torque_problem(PAPER, shaped, leak=0.05, rate_damping=0.02).plant()
    assert P.order == 12
    assert np.array_equal(P.A[:9, :9], torque_problem(PAPER, WEIGHTS, leak=0.05, rate_damping=0.02).plant().A)


def test_holding_a_reference_asks_for_no_rate_in_the_model():
    tracking = Weights(
        W_d=WEIGHTS.W_d, W_n=WEIGHTS.W_n, W_e=WEIGHTS.W_e, W_u=WEIGHTS.W_u, W_r=constant_weight((0.3,) * 3)
    )
    problem = torque_problem(PAPER, tracking, leak=0.05, rate_damping=0.02)
    held = problem.system(problem.w, ("attitude", "rates")).response(0.0)[0, :, 6:]
    assert np.allclose(held[:3], 0.3 * np.eye(3), rtol=1e-12)
    assert np.allclose(held[3:], 0.0, atol=1e-15)
    assert problem.n_meas == 6


def test_a_rates_problem_has_no_actuator_states():
    assert rates_problem(PAPER, WEIGHTS, leak=0.05, tau=0.08).plant().order == 6
