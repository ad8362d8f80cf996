"""The predictive law against independent solutions of its problem."""

import sys

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.guide.examples import mpc
from gustproof.guide.examples.mpc import BLOCKS, MpcGains, design_axis, predictions

PAPER, DT = load_vehicle("paper"), 0.004
GAINS = MpcGains(bandwidth=120.0, rate_time=0.1, disturbance_bandwidth=14.0, torque_bandwidth=5.0)
DESIGN = design_axis(GAINS, 0.25, 0.05, 0.02, DT)


def test_gain_solves_the_problem_without_limits():
    """A dense least-squares problem over two seconds has the same first command."""
    z, count, weight = np.array([0.02, -0.3, 0.5, -0.2]), 500, (120.0**3 * 0.25 * DT) ** -2
    # states by the initial state and by all commands
    by_state, by_command, rows, targets = np.eye(4), np.zeros((4, count)), [], []
    for k in range(count):
        rows += [by_command[0], 0.1 * by_command[1]]
        targets += [-by_state[0] @ z, -0.1 * by_state[1] @ z]
        change = -by_command[3]
        change[k] += 1.0
        rows.append(np.sqrt(weight) * change)
        targets.append(np.sqrt(weight) * by_state[3] @ z)
        by_state, by_command = DESIGN.A @ by_state, DESIGN.A @ by_command
        by_command[:, k] += DESIGN.B
    found = np.linalg.lstsq(np.array(rows), np.array(targets))[0]
    assert found[0] == pytest.approx(-DESIGN.K @ z, rel=1e-6)


def test_filter_finds_a_constant_moment_without_offset():
    held, moment, pending = np.zeros(3), 0.4, 0.0
    state = np.array([0.0, 0.0, moment])  # rate, torque, moment: the truth is the filter's own model
    for _ in range(1000):
        held = held + DESIGN.filter_gain * (state[0] - held[0])
        command = -2.0 * state[0]
        state = DESIGN.filter_A @ state + DESIGN.filter_B * pending
        held = DESIGN.filter_A @ held + DESIGN.filter_B * pending
        pending = command
    assert held[2] == pytest.approx(moment, rel=1e-6)


def test_correction_is_that_of_another_solver():
    pytest.importorskip("osqp", reason="OSQP is not installed")
    designs, limits = [DESIGN] * 3, (10.0, 10.0, 6.0)
    programme = mpc._Programme(designs, limits)
    states = [(0.2, -0.3, 1.0, 1.0), (-0.3, 0.5, 1.0, 1.0), (0.001, 0.0, 0.0, 0.0)]
    disturbances = (0.5, -0.3, 0.1)
    for _ in range(3):  # warm-started by its own solution
        found = programme.correct(states, disturbances)
    by_state, by_move = predictions(DESIGN)
    for k, (z, d, limit) in enumerate(zip(states, disturbances, limits, strict=True)):
        rest = by_state @ np.array(z) - d
        # in the commands themselves the limits are bounds
        exact = lsq_linear(np.linalg.inv(by_move), np.linalg.inv(by_move) @ rest, (-limit, limit), tol=1e-12)
        assert abs(rest[0]) > limit or k == 2
        command = min(max(rest[0] + found[k], -limit), limit)
        assert command == pytest.approx(exact.x[0], abs=2e-3 * limit)


def test_without_active_limits_the_correction_is_exactly_0():
    pytest.importorskip("osqp", reason="OSQP is not installed")
    programme = mpc._Programme([DESIGN] * 3, (10.0, 10.0, 10.0))
    programme._solver = None  # it is not asked
    assert programme.correct([(1e-3, 0.01, 0.0, 0.0)] * 3, (0.1, 0.1, 0.1)) == (0.0, 0.0, 0.0)
    by_state, _ = predictions(DESIGN)
    # beyond the quick bound, but within the limits
    z = 0.9 * 10.0 / np.abs(by_state @ [1.0, -1.0, 0.0, 0.0]).max() * np.array([1.0, -1.0, 0.0, 0.0])
    assert np.abs(by_state).max(axis=0) @ np.abs(z) > 10.0
    assert programme.correct([tuple(z), (0.0,) * 4, (0.0,) * 4], (0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    assert by_state.shape == (BLOCKS, 4)


def test_missing_solver_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "osqp", None)
    with pytest.raises(ConfigError, match=r"^controller mpc: .*pip install 'gustproof\[mpc\]'$"):
        mpc.make(PAPER)
