"""Margins against loops worked out by hand, and against what they promise: just inside stable, just outside not."""

import math

import numpy as np
import pytest

from gustproof.lti.margins import disk_margin, loop_margins, margins
from gustproof.lti.state_space import Lti, discretize_zoh, gain, sensitivity, series

INTEGRATOR = Lti(A=[[0.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]])
MOTOR = Lti(
    A=[[0.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, -4.0]], B=[[0.0], [0.0], [1.0]], C=[[8.0, 0.0, 0.0]], D=[[0.0]]
)
"""8 / (s (s + 1) (s + 4)): phase -180 deg at 2 rad/s, where the gain is 8 / 20 exactly."""


def test_an_integrator_has_ninety_degrees():
    loop = loop_margins(INTEGRATOR)
    assert loop.crossover == pytest.approx(1.0, rel=1e-9)
    assert loop.phase_margin == pytest.approx(math.pi / 2.0, rel=1e-9)
    assert loop.delay_margin == pytest.approx(math.pi / 2.0, rel=1e-9)
    assert loop.gain_margin == math.inf
    assert loop.Ms == pytest.approx(1.0, rel=1e-9)


def test_the_gain_margin_is_where_the_phase_turns_over():
    assert loop_margins(MOTOR).gain_margin == pytest.approx(20.0 / 8.0, rel=1e-9)


def test_a_loop_that_needs_its_gain_has_a_reduction_margin():
    # 10 (s + 1) / (s (s - 1)): the phase is -180 deg at 1 rad/s, where the gain is 10
    unstable = Lti(A=[[0.0, 1.0], [0.0, 1.0]], B=[[0.0], [1.0]], C=[[10.0, 10.0]], D=[[0.0]])
    assert loop_margins(unstable).gain_reduction_margin == pytest.approx(0.1, rel=1e-9)


def test_the_delay_margin_is_the_delay_that_destabilises():
    margin = loop_margins(MOTOR).delay_margin
    dt = margin / 400.0
    for samples, stable in ((390, True), (410, False)):
        # the hold adds half a sample
        line = Lti(A=np.eye(samples, k=-1), B=np.eye(samples, 1), C=np.eye(1, samples, samples - 1), D=[[0.0]], dt=dt)
        assert sensitivity(series(line, discretize_zoh(MOTOR, dt))).is_stable() is stable


def test_the_disk_margin_of_an_integrator_is_two():
    # S - 1/2 = (s - 1) / (2 (s + 1))
    assert disk_margin(INTEGRATOR) == pytest.approx(2.0, rel=1e-6)


def test_every_loop_within_the_disk_margin_at_once_is_stable():
    coupled = series(
        Lti(A=-np.diag([1.0, 2.0]), B=np.eye(2), C=[[1.0, 5.0], [0.1, 1.0]], D=np.zeros((2, 2))), gain(8.0 * np.eye(2))
    )
    loop = series(coupled, Lti(A=-9.0 * np.eye(2), B=9.0 * np.eye(2), C=np.eye(2), D=np.zeros((2, 2))))
    alpha = disk_margin(loop)
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        delta = 0.999 * alpha * np.array(signs)
        factor = np.diag((1.0 + delta / 2.0) / (1.0 - delta / 2.0))
        assert sensitivity(series(loop, gain(factor))).is_stable()


def test_channels_of_a_decoupled_loop_are_those_of_each_on_its_own():
    plant = Lti(A=np.zeros((2, 2)), B=np.diag([1.0, 3.0]), C=np.eye(2), D=np.zeros((2, 2)))
    both = margins(plant, gain(-np.eye(2)))
    assert [loop.crossover for loop in both.input] == pytest.approx([1.0, 3.0], rel=1e-9)
    assert [loop.crossover for loop in both.output] == pytest.approx([1.0, 3.0], rel=1e-9)
    assert both.input_disk == pytest.approx(2.0, rel=1e-6)


def test_an_unstable_loop_has_no_margins():
    with pytest.raises(ValueError, match="unstable"):
        margins(INTEGRATOR, gain([[1.0]]))
