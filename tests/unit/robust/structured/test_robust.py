"""Delays, and robust structured control: its certificate against sampled members, its members against their family."""

import control
import numpy as np
import pytest

from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import as_lti
from gustproof.robust.lti.state_space import lft as close_known
from gustproof.robust.mu.worst_gain import wcgain
from gustproof.robust.structured.blocks import Structure, tunable_gain
from gustproof.robust.structured.goals import DecayGoal
from gustproof.robust.structured.hinfstruct import hinfstruct
from gustproof.robust.structured.robust import robust_hinfstruct
from gustproof.robust.uncertain.delays import delay_controls
from gustproof.robust.uncertain.elements import ultidyn, ureal
from gustproof.robust.uncertain.interpolation import interpolate_block
from gustproof.robust.uncertain.uncertain_system import Uncertain, lft

LAG = control.ss([[1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]])
"""1 / (s - 1) with disturbance, noise and a price of the control."""


def driven_through(actuator: Uncertain) -> Uncertain:
    """Return the plant with its control through an uncertain actuator."""
    return as_lti(LAG) @ (np.diag([1.0, 1.0, 0.0]) + np.eye(3)[:, 2:] @ actuator @ np.eye(3)[2:])


def dynamic() -> Uncertain:
    """Return 1 plus an unknown system of norm up to 0.5."""
    return 1.0 + 0.5 * np.eye(1) @ ultidyn("unmodelled")


@pytest.mark.slow
@pytest.mark.parametrize("actuator", [ureal("gain", range=(0.5, 1.5)), dynamic()], ids=["parameter", "dynamics"])
def test_worst_members_are_added_until_the_certified_gain_stops_falling(actuator):
    P = driven_through(actuator)
    nominal = hinfstruct(LAG, 1, 1, starts=1)
    result = robust_hinfstruct(P, 1, 1, starts=1)
    before = wcgain(lft(P, nominal.lti))
    assert result.gamma < 0.99 * before.upper
    assert result.gamma == min(result.history) == result.certified.upper
    assert result.norm <= result.gamma <= 1.05 * result.norm
    assert len(result.corners) > 1
    # members drawn at random know nothing of the search
    for values in P.sample(30, seed=4):
        assert hinf_norm(close_known(as_lti(P.substitute(values)), result.lti)).gain <= result.gamma * (1.0 + 1e-9)
    assert "D-G scalings" in result.checks[-1]


@pytest.mark.slow
def test_hard_goals_hold_for_every_member_designed_for():
    P = driven_through(ureal("gain", range=(0.5, 1.5)))
    result = robust_hinfstruct(P, 1, 1, starts=1, hard_goals=[DecayGoal(minimum=12.0)])
    assert len(result.corners) > 1
    for delta in result.corners:
        assert np.max(close_known(P.member(delta), result.lti).poles().real) <= -12.0


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("omega", [0.0, 0.3, 5.0])
def test_a_worst_block_becomes_a_stable_system_with_its_value(omega, dt):
    rng = np.random.default_rng(1)
    left, right = (rng.normal(size=shape) + 1j * rng.normal(size=shape) for shape in ((2, 1), (1, 3)))
    value = (left.real @ right.real if omega == 0.0 else left @ right) + 0.0j
    system = interpolate_block(value, omega, dt)
    assert system.is_stable()
    assert system.dt == dt
    assert np.allclose(system.response([omega])[0], value, rtol=0.0, atol=1e-9)
    assert hinf_norm(system).gain == pytest.approx(np.linalg.norm(value, 2), rel=1e-6)


def test_a_plant_without_blocks_has_nothing_to_be_robust_against():
    with pytest.raises(ValueError, match="no uncertain blocks"):
        robust_hinfstruct(Uncertain(M=as_lti(LAG)), 1, 1)
    block = tunable_gain("K", inputs=(0, 1), outputs=(0,))
    with pytest.raises(ValueError, match="K must be 1 x 1"):
        robust_hinfstruct(driven_through(dynamic()), 1, 1, structure=Structure(blocks=(block,), n_meas=2, n_con=1))


def test_a_sampled_delay_is_exact_and_a_continuous_one_has_the_phase_of_its_order():
    sampled = as_lti(control.sample_system(LAG, 0.05))
    late = delay_controls(sampled, 1, 0.15)
    omega = np.array([0.1, 3.0, 40.0])
    turn = np.exp(-0.15j * omega)
    assert late.order == sampled.order + 3
    before, after = sampled.response(omega), late.response(omega)
    assert np.allclose(after[:, :, 2], turn[:, None] * before[:, :, 2], rtol=1e-9, atol=1e-12)
    assert np.allclose(after[:, :, :2], before[:, :, :2], rtol=1e-9, atol=1e-12)
    pade = delay_controls(LAG, 1, 0.15, order=3)
    omega = np.array([0.1, 3.0, 20.0])  # 20 rad/s * .15 s = 3
    ratio = pade.response(omega)[:, 0, 2] / as_lti(LAG).response(omega)[:, 0, 2]
    assert np.allclose(np.abs(ratio), 1.0)
    assert np.all(np.abs(np.angle(ratio * np.exp(0.15j * omega))) < np.radians(1.0))


@pytest.mark.slow
def test_a_delay_has_its_price():
    prompt, late = (hinfstruct(P, 1, 1, starts=1) for P in (LAG, delay_controls(LAG, 1, 0.05)))
    assert late.norm > 1.2 * prompt.norm
    # the sampled loop is late by its hold as well: about half a sample
    sampled = delay_controls(control.sample_system(LAG, 0.01), 1, 0.04)
    assert hinfstruct(sampled, 1, 1, starts=1).norm == pytest.approx(late.norm, rel=0.05)


@pytest.mark.parametrize(("seconds", "dt"), [(0.0, 0.0), (-1.0, 0.1), (0.04, 0.1), (0.15, 0.1), (np.nan, 0.0)])
def test_a_delay_is_positive_and_a_whole_number_of_samples(seconds, dt):
    P = control.sample_system(LAG, dt) if dt else LAG
    with pytest.raises(ValueError, match="the delay is"):
        delay_controls(P, 1, seconds)
