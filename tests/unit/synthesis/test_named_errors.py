"""Errors of the toolbox that a sound plant never meets, each by its text."""

import dataclasses
from typing import NamedTuple

import numpy as np
import pytest

from gustproof.errors import DesignError
from gustproof.lti.norms import Peak
from gustproof.lti.state_space import Lti, gain
from gustproof.model.lft import Uncertain
from gustproof.synthesis.coprime import ncfsyn as coprime
from gustproof.synthesis.coprime.ncfsyn import ncfsyn
from gustproof.synthesis.hinf import h2syn as h2
from gustproof.synthesis.hinf import hinfsyn as hinf
from gustproof.synthesis.hinf.h2syn import h2syn
from gustproof.synthesis.hinf.hinfsyn import hinfsyn
from gustproof.synthesis.lpv import reconstruction
from gustproof.synthesis.mu import musyn
from gustproof.synthesis.structured.blocks import Structure, tunable_gain
from gustproof.synthesis.structured.goals import RollOffGoal
from gustproof.synthesis.structured.hinfstruct import hinfstruct

pytestmark = pytest.mark.plain

PLANT = Lti(
    A=[[1.0]],
    B=[[1.0, 0.0, 1.0]],
    C=[[1.0], [0.0], [1.0]],
    D=[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
)
"""Its least level is 1 + sqrt(3); below 1 a Riccati solution is indefinite."""
HUGE = dataclasses.replace(PLANT, A=[[1e300]], B=1e300 * PLANT.B)
"""Numbers whose squares overflow."""


def raise_ill_posed(*_arguments: object) -> None:
    raise ValueError("the loop is not well posed")


@pytest.mark.parametrize(
    ("gamma", "condition"),
    [(0.95, "a Riccati solution is not positive semidefinite"), (2.0, "the spectral radius of XY is not below gamma")],
)
def test_hinfsyn_names_the_condition_that_fails_at_a_level(monkeypatch, gamma, condition):
    monkeypatch.setattr(hinf, "_least_level", lambda _halves, _floor: 0.5)
    with pytest.raises(DesignError, match=f"no controller at gamma = {gamma:g}: {condition}"):
        hinfsyn(PLANT, 1, 1, gamma=gamma)


def test_hinfsyn_gives_up_where_no_level_is_feasible(monkeypatch):
    monkeypatch.setattr(hinf, "_margin", lambda _halves, _gamma: -np.inf)
    with pytest.raises(DesignError, match="no controller at any level up to"):
        hinfsyn(PLANT, 1, 1)


@pytest.mark.parametrize(
    ("norm", "told"),
    [
        (lambda *_loop: (Peak(gain=9.0, omega=1.0), 0.0), "rounding spoilt the controller at gamma = 3: its norm is 9"),
        (raise_ill_posed, "rounding spoilt the controller at gamma = 3: the loop is not well posed"),
    ],
)
def test_hinfsyn_returns_no_controller_whose_loop_fails_the_check(monkeypatch, norm, told):
    monkeypatch.setattr(hinf, "loop_norm", norm)
    with pytest.raises(DesignError, match=told):
        hinfsyn(PLANT, 1, 1, gamma=3.0)


@pytest.mark.parametrize(
    ("norm", "told"),
    [(lambda _loop: 1e3, "its norm is 1000, not 4.06"), (raise_ill_posed, "the loop is not well posed")],
)
def test_h2syn_returns_no_controller_whose_loop_fails_the_check(monkeypatch, norm, told):
    monkeypatch.setattr(h2, "h2_norm", norm)
    with pytest.raises(DesignError, match=f"rounding spoilt the controller: {told}"):
        h2syn(PLANT, 1, 1)


def test_ncfsyn_returns_no_controller_whose_loop_fails_the_check(monkeypatch):
    monkeypatch.setattr(coprime, "check_shaped_loop", lambda _G, _K: Peak(gain=9.0, omega=1.0))
    with pytest.raises(DesignError, match=r"rounding spoilt the controller at gamma = .*: its norm is 9"):
        ncfsyn(Lti(A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]]))


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
@pytest.mark.parametrize("synthesis", [hinfsyn, h2syn])
def test_numbers_that_overflow_are_bad_scaling(synthesis):
    with pytest.raises(DesignError, match="too badly scaled to solve"):
        synthesis(HUGE, 1, 1)


def test_blocks_and_goals_name_what_does_not_fit():
    block = tunable_gain("K", inputs=(0,), outputs=(0,))
    with pytest.raises(ValueError, match="blocks are named K, K: each needs a unique name"):
        Structure(blocks=(block, block), n_meas=1, n_con=1)
    with pytest.raises(ValueError, match=r"blocks are named \(none\)"):
        Structure(blocks=(), n_meas=1, n_con=1)
    with pytest.raises(ValueError, match=r"has slope 3 and corner 10\.0: 1 or 2, and positive"):
        hinfstruct(PLANT, 1, 1, hard_goals=[RollOffGoal(slope=3, corner=10.0)])
    with pytest.raises(ValueError, match="P is 1 x 1: n_meas = 1 and n_con = 1 leave no w, z, u or y"):
        hinfstruct(gain([[1.0]]), 1, 1)


def test_musyn_gives_up_a_level_that_does_not_settle(monkeypatch):
    class Design(NamedTuple):
        gamma_opt: float = 2.0

    problem = musyn._Problem(plant=Uncertain(M=PLANT, blocks=()), n_meas=1, n_con=1, measure="mu")
    monkeypatch.setattr(musyn._Problem, "design", lambda *_arguments: Design())
    with pytest.raises(DesignError, match="the level of the scaled plant did not settle"):
        problem.least_level(gain(np.eye(2)), 1.0)


def test_lpvsyn_names_a_feedthrough_beyond_the_level():
    parts = {"A": PLANT.A, "B1": PLANT.B[:, :2], "B2": PLANT.B[:, 2:], "C1": PLANT.C[:2], "C2": PLANT.C[2:]}
    D = {"D11": np.diag([5.0, 0.0]), "D12": PLANT.D[:2, 2:], "D21": PLANT.D[2:, :2], "D22": PLANT.D[2:, 2:]}
    plant = reconstruction.Plant(**parts, **D)
    with pytest.raises(DesignError, match=r"D11 at \(1.0,\) alone exceeds the level 3"):
        reconstruction._feedthrough(plant, (1.0,), 3.0)
