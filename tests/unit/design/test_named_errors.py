"""Errors of the toolbox that a sound plant never meets, each by its text."""

import dataclasses
import math
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.rotational import Envelope
from gustproof.design import rate_law, tune, weights_search
from gustproof.design.cascades.tuning import TuningLimits
from gustproof.design.derive import derive
from gustproof.design.designs import load_design
from gustproof.design.fixed_order import solve_structured
from gustproof.design.inner_loops import InnerLoop, InnerLoops
from gustproof.design.methods import solve_mu
from gustproof.errors import DesignError
from gustproof.robust.coprime import ncfsyn as coprime
from gustproof.robust.coprime.ncfsyn import ncfsyn
from gustproof.robust.hinf import h2syn as h2
from gustproof.robust.hinf import hinfsyn as hinf
from gustproof.robust.hinf.h2syn import h2syn
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lpv import lpvsyn as lpv
from gustproof.robust.lpv import reconstruction
from gustproof.robust.lpv.lpvsyn import lpvsyn
from gustproof.robust.lti import state_space
from gustproof.robust.lti.norms import Peak
from gustproof.robust.lti.state_space import Lti, gain
from gustproof.robust.mu import musyn
from gustproof.robust.structured import hinfstruct as structured
from gustproof.robust.structured.blocks import (
    Structure,
    decoupled_structure,
    tunable_gain,
    tunable_observer,
    tunable_pid,
)
from gustproof.robust.structured.goals import GainGoal, RollOffGoal
from gustproof.robust.structured.hinfstruct import hinfstruct
from gustproof.robust.uncertain.uncertain_system import Uncertain

PLANT = Lti(
    A=[[1.0]],
    B=[[1.0, 0.0, 1.0]],
    C=[[1.0], [0.0], [1.0]],
    D=[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
)
"""Its least level is 1 + sqrt(3); below 1 a Riccati solution is indefinite."""
HUGE = dataclasses.replace(PLANT, A=[[1e300]], B=1e300 * PLANT.B)
"""Numbers whose squares overflow."""


FAR = dataclasses.replace(PLANT, B=1e300 * PLANT.B, C=1e300 * PLANT.C)
"""Numbers whose units no float holds."""


def raise_ill_posed(*_arguments: object) -> None:
    raise ValueError("the loop is not well posed")


@pytest.mark.parametrize(
    ("gamma", "condition"),
    [(0.95, "a Riccati solution is not positive semidefinite"), (2.0, "the spectral radius of XY is not below gamma")],
)
def test_hinfsyn_names_the_condition_that_fails_at_a_level(monkeypatch, gamma, condition):
    monkeypatch.setattr(hinf, "_least_level", lambda _halves, _floor: (0.5, True))
    with pytest.raises(DesignError, match=f"rounding spoilt the controller at gamma = {gamma:g}: {condition}"):
        hinfsyn(PLANT, 1, 1, gamma=gamma)


def test_hinfsyn_gives_up_where_no_level_is_feasible(monkeypatch):
    monkeypatch.setattr(hinf, "_margin", lambda _halves, _gamma: -np.inf)
    with pytest.raises(DesignError, match="no controller at any level up to"):
        hinfsyn(PLANT, 1, 1)


@pytest.mark.parametrize(
    ("norm", "told"),
    [
        (lambda *_loop: (Peak(gain=9.0, omega=1.0), 0.0), "rounding spoilt the controller at gamma = 3: its norm is 9"),
        (lambda *_loop: (Peak(gain=2.9, omega=1.0), 0.2), r"at gamma = 3: its norm is 2\.9 \+- 0\.2"),
        (raise_ill_posed, "rounding spoilt the controller at gamma = 3: the loop is not well posed"),
    ],
)
def test_hinfsyn_returns_no_controller_whose_loop_fails_the_check(monkeypatch, norm, told):
    monkeypatch.setattr(hinf, "loop_norm", norm)
    with pytest.raises(DesignError, match=told):
        hinfsyn(PLANT, 1, 1, gamma=3.0)


def test_a_norm_that_prints_like_its_level_is_told_by_its_excess(monkeypatch):
    monkeypatch.setattr(hinf, "loop_norm", lambda *_loop: (Peak(gain=3.0 + 1e-7, omega=1.0), 0.0))
    with pytest.raises(DesignError, match="its norm is 3, 1e-07 above gamma"):
        hinfsyn(PLANT, 1, 1, gamma=3.0)


@pytest.mark.parametrize("synthesis", [hinfsyn, h2syn])
@pytest.mark.parametrize(
    ("sizes", "told"),
    [
        ((1, 1.0), "n_con is 1.0, must be an integer"),
        (("y", 1), "n_meas is 'y', must be an integer"),
        ((True, 1), "n_meas is True, must be an integer"),
    ],
)
def test_sizes_that_are_no_integers_are_refused_by_name(synthesis, sizes, told):
    with pytest.raises(ValueError, match=told):
        synthesis(PLANT, *sizes)


def test_a_level_whose_powers_no_float_holds_is_refused_by_name():
    with pytest.raises(ValueError, match=r"gamma is 1e\+300, must be positive, at most 1e\+100"):
        hinfsyn(PLANT, 1, 1, gamma=1e300)


def test_a_level_a_little_higher_is_taken_where_rounding_spoils_the_controller(monkeypatch):
    level, norm = 1.05 * hinfsyn(PLANT, 1, 1).gamma_opt, hinf.loop_norm
    spoilt = iter([True, True])
    monkeypatch.setattr(
        hinf, "loop_norm", lambda *loop: (Peak(gain=9.0, omega=1.0), 0.0) if next(spoilt, False) else norm(*loop)
    )
    assert hinfsyn(PLANT, 1, 1).gamma == pytest.approx(1.003 * level, rel=1e-12)


def test_hinfsyn_tells_no_level_that_other_coordinates_move(monkeypatch):
    monkeypatch.setattr(hinf, "loop_norm", lambda *_loop: (Peak(gain=9.0, omega=1.0), 0.0))
    levels = iter([2.75, 2.76])
    monkeypatch.setattr(hinf, "_least_level", lambda _halves, _floor: (next(levels), True))
    with pytest.raises(DesignError, match=r"the least level cannot be told: rounding makes it 2\.75 or 2\.76"):
        hinfsyn(PLANT, 1, 1)


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


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value", "ignore:divide by zero")
@pytest.mark.parametrize("synthesis", [hinfsyn, h2syn])
@pytest.mark.parametrize("plant", [HUGE, FAR])
def test_numbers_that_overflow_are_bad_scaling(synthesis, plant):
    with pytest.raises(DesignError, match="too badly scaled to solve"):
        synthesis(plant, 1, 1)


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
def test_far_units_of_the_outputs_alone_are_solved():
    # its two Riccati equations are quadratic: for outputs of 1e300 x, X Y is 1 / (1 - 1 / gamma^2), and 1 for H2
    plant = dataclasses.replace(PLANT, C=1e300 * PLANT.C)
    assert hinfsyn(plant, 1, 1).gamma_opt == pytest.approx(math.sqrt(2.0), rel=1e-6)
    assert h2syn(plant, 1, 1).norm == pytest.approx(math.sqrt(2.0) * 1e150, rel=1e-12)


@pytest.mark.filterwarnings("ignore:overflow")
def test_ncfsyn_names_a_plant_that_overflows():
    with pytest.raises(DesignError, match="the shaped plant is too badly scaled to solve"):
        ncfsyn(Lti(A=[[1e300]], B=[[1.0]], C=[[1.0]], D=[[0.0]]))


@pytest.mark.parametrize("zero", [4.0, -2.0])
def test_hinfsyn_names_the_feedthrough_by_which_the_controller_undoes_the_plant(zero):
    """The direct path of the least level is -2, and I + D_K D22 = 1 - 2 / 2. With stable zeros that level is 0."""
    plant = Lti(A=[[1.0]], B=[[1.0 - zero, 1.0]], C=[[3.0], [1.0]], D=[[2.0, 1.0], [1.0, 0.5]])
    with pytest.raises(DesignError, match=r"the loop is not well posed: I \+ D_K D22"):
        hinfsyn(plant, 1, 1)


def test_hinfsyn_solves_a_plant_whose_least_level_is_zero():
    """At some levels that the search tries, R - gamma^2 J is singular: those are too low."""
    plant = Lti(A=[[1.0]], B=[[3.0, 1.0]], C=[[3.0], [1.0]], D=[[2.0, 1.0], [1.0, 0.0]])
    result = hinfsyn(plant, 1, 1)
    assert result.norm < result.gamma < 1e-5


def test_a_level_that_is_not_rounding_is_taken_where_the_least_one_is(monkeypatch):
    """Of a plant whose level is 0 rounding finds some level; here each one below 1e-6 of the plant's size fails."""
    plant = Lti(A=[[1.0]], B=[[3.0, 1.0]], C=[[3.0], [1.0]], D=[[2.0, 1.0], [1.0, 0.0]])
    norm = hinf.loop_norm
    spoilt = iter([True] * 9)
    monkeypatch.setattr(
        hinf, "loop_norm", lambda *loop: (Peak(gain=9.0, omega=1.0), 0.0) if next(spoilt, False) else norm(*loop)
    )
    assert hinfsyn(plant, 1, 1).gamma == pytest.approx(9e-6, rel=1e-12)


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
    with pytest.raises(ValueError, match="the weight has 3 inputs, must have 2, one for each output"):
        hinfstruct(PLANT, 1, 1, soft_goal=GainGoal(weight=gain(np.eye(3))))
    with pytest.raises(ValueError, match="3 measurements can't be shared out among 2 controls"):
        decoupled_structure(1, 3, 2)
    with pytest.raises(ValueError, match=r"cutoff is 0\.0, must be positive"):
        tunable_pid("K", input=0, output=0, cutoff=0.0)
    with pytest.raises(ValueError, match="order is 1, must be 2 or more"):
        tunable_observer("K", 1, input=0, output=0, leak=0.05)


def test_hinfstruct_returns_no_controller_whose_loop_fails_the_check(monkeypatch):
    monkeypatch.setattr(structured, "hinf_norm", lambda _loop: Peak(gain=np.inf, omega=1.0))
    with pytest.raises(DesignError, match="rounding spoilt the controller: its closed loop is unstable"):
        hinfstruct(PLANT, 1, 1, starts=1)


def quiet(_fraction: float, _text: str) -> None:
    """Tell nothing of a search's progress."""


@pytest.mark.parametrize(
    ("solve", "told"),
    [
        (
            lambda design, problem: solve_structured(design, problem, order=6, starts=1, seed=1, progress=quiet),
            "design aided has an accelerometer: its law is the central controller alone",
        ),
        (
            lambda design, problem: solve_mu(design, problem, envelope=Envelope(angle=0.3, rate=0.5), progress=quiet),
            "design aided: certify supports gyro-only designs: the leak differs between axes",
        ),
    ],
)
def test_a_design_with_an_accelerometer_is_refused_where_only_gyros_do(solve, told):
    with pytest.raises(DesignError, match=told):
        derive(load_design("aided"), solve=solve)


def test_a_design_names_what_its_options_exclude_and_a_sample_that_is_too_long():
    loop = InnerLoop(omega=10.0, damping=0.7)
    loops = InnerLoops(name="stock", roll=loop, pitch=loop, yaw=loop)
    with pytest.raises(ValueError, match="inner is for a law with rate_loop_lag and without W_r"):
        dataclasses.replace(load_design("D1"), inner=loops)
    with pytest.raises(DesignError, match=r"design D1, sampled every 0\.1 s and one sample late: the loop is unstable"):
        derive(dataclasses.replace(load_design("D1"), dt=0.1))
    with pytest.raises(ValueError, match="dt"):
        dataclasses.replace(load_design("D1"), dt=4.0)  # ms, taken for s


def test_a_rate_law_whose_crossovers_stay_too_fast_is_refused(monkeypatch):
    loop = InnerLoop(omega=10.0, damping=0.7)
    fast = SimpleNamespace(sampled=SimpleNamespace(input=[SimpleNamespace(crossover=1e3)] * 3))
    monkeypatch.setattr(rate_law, "derive", lambda *_design: (None, fast))
    with pytest.raises(DesignError, match="design R1-stock: no weight of the command has the crossovers"):
        rate_law.derive_over(load_design("R1"), InnerLoops(name="stock", roll=loop, pitch=loop, yaw=loop))


def test_rate_laws_that_stay_too_sensitive_are_refused(monkeypatch):
    derived = SimpleNamespace(sampled=SimpleNamespace(input=()))
    monkeypatch.setattr(tune, "identify_rate_loop", lambda _vehicle: SimpleNamespace(tau=np.array([0.05])))
    monkeypatch.setattr(tune, "derive", lambda *_design: (None, derived))
    monkeypatch.setattr(tune, "worst_loop", lambda _axes: SimpleNamespace(Ms=1.5))
    with pytest.raises(DesignError, match=r"no law of rates has a sensitivity peak of 1\.3 over rate loops of 0\.05 s"):
        tune.tune_law("hinf-rates", load_vehicle_set("paper"), load_scenario("paper-turbulence"), sensitivity_peak=1.3)


def test_a_search_for_weights_without_any_law_is_refused(monkeypatch):
    def solve(*_problem: object) -> None:
        raise DesignError("no controller")

    monkeypatch.setattr(weights_search, "solve_central", solve)
    vehicle, limits = load_vehicle("paper"), TuningLimits(sensitivity_peak=1.4, slew=20.0)
    with pytest.raises(DesignError, match="design D1: no weights stabilise vehicle 'paper'"):
        weights_search.search_weights(load_design("D1"), vehicle, load_scenario("paper-turbulence"), limits, ())


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
    plant = state_space.PartedPlant(**parts, **D)
    with pytest.raises(DesignError, match=r"D11 at \(1.0,\) alone exceeds the level 3"):
        reconstruction._feedthrough(plant, (1.0,), 3.0)


def lag(pole: float, *, control: float = 1.0, seen: float = 1.0) -> Lti:
    D = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.0, 0.1, 0.0]])
    return Lti(A=[[pole]], B=[[1.0, 0.0, control]], C=[[1.0], [0.0], [seen]], D=D)


@pytest.mark.parametrize(
    ("plants", "told"),
    [
        ((lag(1.0, control=0.0, seen=0.0), lag(2.0, control=0.0, seen=0.0)), "the inequalities have no solution$"),
        ((lag(1.0), lag(1.0, control=-1.0)), "a frozen loop between the points of the grid is unstable"),
    ],
)
def test_lpvsyn_names_what_no_controller_does_on_a_grid(plants, told):
    with pytest.raises(DesignError, match=told):
        lpvsyn(dict(zip(((1.0,), (2.0,)), plants, strict=True)), 1, 1)


def test_lpvsyn_returns_no_controller_whose_loop_fails_the_check(monkeypatch):
    monkeypatch.setattr(lpv, "proven_level", lambda *_loop: 9.0)
    with pytest.raises(DesignError, match=r"rounding spoilt the controllers at gamma = .*: their gain is 9"):
        lpvsyn({(1.0,): lag(-1.0), (2.0,): lag(-2.0)}, 1, 1)
