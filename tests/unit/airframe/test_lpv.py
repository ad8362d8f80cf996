"""The paper's A(rho) against rigid-body mechanics written another way: the angular momentum and the rotation matrix."""

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.lpv import (
    HOVER,
    PARAMETERS,
    linear_plant,
    lpv_matrix,
    rate_loop,
    scheduling_parameters,
)

PAPER, IRIS = load_vehicle("paper"), load_vehicle("iris")
INERTIA = np.array(PAPER.inertia_B)


def rotation(E):
    """R_NB of ZYX Euler angles, as a product of three turns."""
    (s1, s2, s3), (c1, c2, c3) = np.sin(E), np.cos(E)
    turn_x = np.array([[1, 0, 0], [0, c1, -s1], [0, s1, c1]])
    turn_y = np.array([[c2, 0, s2], [0, 1, 0], [-s2, 0, c2]])
    turn_z = np.array([[c3, -s3, 0], [s3, c3, 0], [0, 0, 1]])
    return turn_z @ turn_y @ turn_x


@pytest.mark.parametrize("seed", range(5))
def test_a_of_rho_times_the_state_is_the_rigid_body(seed):
    rng = np.random.default_rng(seed)
    E, omega = rng.uniform(-1.2, 1.2, 3), rng.uniform(-3.0, 3.0, 3)
    derivative = lpv_matrix(scheduling_parameters(E, omega), INERTIA) @ np.concatenate([E, omega])
    # Euler: I omega' = -omega x I omega
    assert np.allclose(derivative[3:], -np.cross(omega, INERTIA * omega) / INERTIA, rtol=1e-12)
    # R_NB' = R_NB [omega x], the left side by a central difference along the claimed angle rates
    h = 1e-6
    moved = (rotation(E + h * derivative[:3]) - rotation(E - h * derivative[:3])) / (2.0 * h)
    cross = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
    assert np.allclose(moved, rotation(E) @ cross, atol=1e-8)  # h^2 and rounding / h


def test_the_row_as_printed_in_the_paper_is_not_the_rigid_body():
    omega = np.array([0.4, -0.2, 1.1])
    rho = scheduling_parameters(np.zeros(3), omega)
    printed = lpv_matrix(rho, INERTIA)
    printed[4, 5] = (INERTIA[2] - INERTIA[0]) / INERTIA[1] * omega[2] / 2.0
    truth = -np.cross(omega, INERTIA * omega) / INERTIA
    assert (printed[3:, 3:] @ omega)[1] != pytest.approx(truth[1], rel=0.1)


def test_at_hover_angles_integrate_rates():
    A = lpv_matrix(HOVER, INERTIA)
    assert np.array_equal(A, np.block([[np.zeros((3, 3)), np.eye(3)], [np.zeros((3, 6))]]))


def test_the_edge_that_table_two_allows_is_refused():
    with pytest.raises(ValueError, match="rho4"):
        lpv_matrix((0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0), INERTIA)


def test_parameters_keep_the_table_inside_it_and_not_outside():
    inside = scheduling_parameters([[0.1, -0.2, 3.0]], [[1.4, 0.0, -1.4]])
    fast = scheduling_parameters([0.0, 0.0, 0.0], [0.0, 2.0, 0.0])
    assert inside.shape == (1, len(PARAMETERS))
    low, high = np.array([(each.low, each.high) for each in PARAMETERS]).T
    assert np.all((low <= inside) & (inside <= high))
    assert ((low <= fast) & (fast <= high)).tolist() == [True] * 5 + [False, True]


def test_a_yaw_torque_turns_about_yaw_by_its_own_inertia():
    plant = linear_plant(PAPER)
    response = plant.response(0.5)[0]
    s = 0.5j
    expected = 1.0 / (0.1 * s * (s + PAPER.rate_damping_B[2]) * (1.0 + PAPER.actuator_lag * s))
    assert response[2, 2] == pytest.approx(expected, rel=1e-12)
    assert response[2, 5] == pytest.approx(expected * (1.0 + PAPER.actuator_lag * s), rel=1e-12)


def test_each_rate_decays_with_the_damping_of_its_axis():
    assert np.array_equal(linear_plant(IRIS).A[3:6, 3:6], -np.diag(IRIS.rate_damping_B))


def test_a_rate_loop_settles_on_its_command():
    response = rate_loop(PAPER, leak=0.05, tau=0.08).response(0.0)[0]
    assert np.allclose(response[3:, :3], np.eye(3), rtol=1e-12)
    assert response[3, 3] == pytest.approx(0.08 / 0.25, rel=1e-12)
