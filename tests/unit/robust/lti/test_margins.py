"""Margins against loops worked out by hand, and against what they promise: just inside stable, just outside not."""

import math

import numpy as np
import pytest
import scipy

from gustproof.robust.lti.margins import disk_margin, loop_margins, margins
from gustproof.robust.lti.state_space import Lti, discretize_zoh, gain, sensitivity, series

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


@pytest.mark.parametrize(
    ("G", "gain_margin", "reduction"),
    [
        # of L = -.5/(s + 1) the pole k/2 - 1 passes 0 at k = 2; of 2/(s - 1) the pole 1 - 2 k does at k = .5
        (Lti(A=[[-1.0]], B=[[1.0]], C=[[0.5]], D=[[0.0]]), 2.0, 0.0),
        (Lti(A=[[1.0]], B=[[1.0]], C=[[-2.0]], D=[[0.0]]), math.inf, 0.5),
        # of L = .3/(z - .5) the pole .5 - .3 k passes -1 at k = 5
        (Lti(A=[[0.5]], B=[[1.0]], C=[[-0.3]], D=[[0.0]], dt=0.1), 5.0, 0.0),
        # of L = (1 - .5 s)/(s + 1) the pole passes infinity at k = 2
        (Lti(A=[[-1.0]], B=[[1.0]], C=[[-1.5]], D=[[0.5]]), 2.0, 0.0),
    ],
)
def test_a_gain_that_moves_a_real_pole_over_the_border_is_a_margin(G, gain_margin, reduction):
    found = margins(G, gain([[1.0]], G.dt)).input[0]
    assert (found.gain_margin, found.gain_reduction_margin) == (pytest.approx(gain_margin), pytest.approx(reduction))


@pytest.mark.parametrize(("count", "reduction"), [(1, 0.0), (2, 0.0), (3, 1.0 / 6.0)])
@pytest.mark.parametrize("dt", [0.0, 0.01])
def test_integrators_have_no_margin_at_frequency_0(count, reduction, dt):
    # 3 (s + 1)^(count - 1) / s^count: of three, Routh asks for k > 1/6
    numerator = 3.0 * np.atleast_1d(np.poly([-1.0] * (count - 1)))[::-1]
    A, B = np.eye(count, k=1), np.eye(count)[:, -1:]
    L = Lti(A=A, B=B, C=numerator[None], D=[[0.0]])
    found = loop_margins(discretize_zoh(L, dt) if dt else L)
    assert found.gain_reduction_margin == pytest.approx(reduction, rel=0.02, abs=0.0)  # 0 itself, not rounding


@pytest.mark.parametrize("time", [1e-6, 1e-3, 1e3, 1e6])
def test_margins_do_not_depend_on_the_unit_of_time(time):
    # 1/s . 100/(s + 100), crossover .99995 rad/s, gain margin 100 at 0 phase
    A, B, C = np.array([[0.0, 1.0], [0.0, -100.0]]), np.array([[0.0], [100.0]]), np.array([[-1.0, 0.0]])
    found = margins(Lti(A=A / time, B=B / time, C=C, D=[[0.0]]), gain([[1.0]])).input[0]
    assert found.crossover * time == pytest.approx(0.99995, rel=1e-5)
    assert found.delay_margin / time == pytest.approx((math.pi / 2 - math.atan(0.0099995)) / 0.99995, rel=1e-5)


def test_systems_and_margins_show_themselves_in_a_few_lines():
    two = Lti(A=-np.eye(2), B=np.eye(2), C=np.eye(2), D=np.zeros((2, 2)))
    gains = Lti(A=np.empty((0, 0)), B=np.empty((0, 2)), C=np.empty((2, 0)), D=-np.eye(2))
    found = margins(two, gains)
    title, disks, *loops = str(found).splitlines()
    assert (title, disks) == ("Margins", "disk, all channels at once: 2 at the input, 2 at the output")
    assert loops[0] == "input 1: Ms 1, gains 0 to inf, phase 180 deg, delay inf ms, crossover 0 rad/s"
    assert [each.partition(":")[0] for each in loops] == ["input 1", "input 2", "output 1", "output 2"]
    assert repr(found.input[0]) == f"Margins of a loop: {loops[0].partition(': ')[2]}"
    assert repr(gains) == "Lti: 2 x 2, 0 states, continuous"
    swinging = Lti(A=np.diag([-9.0, 0.5]), B=np.eye(2), C=np.eye(2), D=np.zeros((2, 2)), dt=0.1)
    assert repr(swinging) == "Lti: 2 x 2, 2 states, 0.1 s\npoles: unstable, 0.5, -9"
    chain = discretize_zoh(Lti(A=-np.diag(np.arange(1.0, 9.0)), B=np.eye(8), C=np.eye(8), D=np.zeros((8, 8))), 0.1)
    assert str(chain).splitlines()[1] == "poles: stable, 0.9048, 0.8187, 0.7408, 0.6703, 0.6065, 0.5488 and 2 more"
    assert "<th>poles</th>" in chain._repr_html_()


@pytest.mark.parametrize("dt", [0.0, 0.004])
@pytest.mark.parametrize(("feedthrough", "zeta"), [(0.0, 1e-2), (0.0, 1e-5), (1.0, 1e-4), (-0.5, 1e-6)])
def test_a_resonance_narrower_than_any_step_counts(feedthrough: float, zeta: float, dt: float) -> None:
    """Beside a lag, a mode of peak gain 2 crosses unit gain twice in a few of its half widths."""
    omega, lag = 37.3, Lti(A=[[-1.0]], B=[[1.0]], C=[[0.4]], D=[[feedthrough]])
    mode = Lti(A=[[0.0, omega], [-omega, -2.0 * zeta * omega]], B=[[0.0], [omega]], C=[[4.0 * zeta, 0.0]], D=[[0.0]])
    L = Lti(
        A=scipy.linalg.block_diag(lag.A, mode.A),
        B=np.vstack([lag.B, mode.B]),
        C=np.hstack([lag.C, mode.C]),
        D=lag.D,
    )
    L = discretize_zoh(L, dt) if dt else L
    near = omega * (1.0 + zeta * np.linspace(-100.0, 100.0, 40_001))
    values = L.response(near)[:, 0, 0]
    at = np.flatnonzero(np.diff(np.signbit(np.abs(values) - 1.0)))
    found = loop_margins(L)
    assert len(at) >= 1
    assert found.phase_margin <= np.min(np.abs(np.angle(-values[at]))) + 1e-3
    assert found.delay_margin <= np.min((np.angle(-values[at]) % (2.0 * math.pi)) / near[at]) * 1.001
    real = np.flatnonzero(np.diff(np.signbit(values.imag)))
    factors = [-1.0 / value for value in values[real].real if value < 0.0]
    assert found.gain_margin <= min((each for each in factors if each > 1.0), default=math.inf) * 1.001


@pytest.mark.parametrize("dt", [1e-2, 1e-4, 1e-5])
def test_a_loop_far_slower_than_its_samples_keeps_its_margins(dt: float) -> None:
    slow = Lti(A=[[0.0, 1.0], [0.0, -0.01]], B=[[0.0], [1.0]], C=[[5e-5, 0.0]], D=[[0.0]])
    found, expected = loop_margins(discretize_zoh(slow, dt)), loop_margins(slow)
    assert found.crossover == pytest.approx(expected.crossover, rel=1e-3)
    assert found.phase_margin == pytest.approx(expected.phase_margin, rel=1e-3)
    assert found.delay_margin == pytest.approx(expected.delay_margin, rel=1e-3)
