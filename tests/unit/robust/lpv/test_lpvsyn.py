"""Scheduled controllers: published levels, the gain that their loops keep, and each refusal."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.rotational import Envelope, rotation, uncertain_airframe
from gustproof.design.designs import design_problem, load_design
from gustproof.errors import DesignError
from gustproof.robust.gain.lft_gain import certify_lft
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lpv.lpvsyn import lpvsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, as_lti, gain
from gustproof.robust.lti.state_space import lft as close_known
from gustproof.robust.uncertain.elements import ultidyn, ureal
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain, fill_diagram, lft, system_from_matrix

WEIGHTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.0, 0.1, 0.0]])


def lag(rho, D=WEIGHTS) -> Lti:
    return Lti(A=[[-rho[0]]], B=[[1.0, 0.0, 1.0]], C=[[1.0], [0.0], [1.0]], D=D)


def lags(*values) -> dict:
    return {(value,): lag((value,)) for value in values}


def turned_plant(rho) -> Lti:
    """Return the weighted plant of Wu et al.: two unstable states, actuators that turn with rho, weights."""
    c, s = np.cos(rho[0]), np.sin(rho[0])
    A, B, C, D = np.zeros((8, 8)), np.zeros((8, 7)), np.zeros((6, 8)), np.zeros((6, 7))
    A[:4, :4] = [[0.75, 2.0, c, s], [0.0, 0.5, -s, c], [0.0, 0.0, -10.0, 0.0], [0.0, 0.0, 0.0, -10.0]]
    A[4:6, 4:6], A[6:, 6:] = (
        -1000.0 * np.eye(2),
        -0.2 * np.eye(2),
    )  # W_n = 10 (s + 10) / (s + 1000), W_r = 20 / (s + .2)
    B[1, 0], B[2, 5], B[3, 6] = 3.0, 10.0, 10.0
    B[4:6, 3:5], B[6:, 1:3] = np.sqrt(9900.0) * np.eye(2), np.sqrt(20.0) * np.eye(2)
    D[:2, 5:], D[4:, 3:5] = np.eye(2) / 280.0, 10.0 * np.eye(2)
    C[2:4, :2], C[2:4, 6:] = np.eye(2), -np.sqrt(20.0) * np.eye(2)
    C[4:] = C[2:4]
    C[4:, 4:6] = -np.sqrt(9900.0) * np.eye(2)
    return Lti(A=A, B=B, C=C, D=D)


@pytest.mark.slow
def test_the_gridded_example_of_wu_yang_packard_and_becker():
    # LPVTools, "Synthesis for gridded LPV systems", after Wu et al. 1996: normlpv = 0.9250 with a backoff of 1.02.
    # MATLAB's solver stops at 1 % of the least level, so the least is within .9250 / 1.02 and 1 % below
    grid = {(float(rho),): turned_plant((rho,)) for rho in np.linspace(-np.pi, np.pi, 7)}
    result = lpvsyn(
        grid,
        2,
        2,
        speeds=(5.0,),
        basis=lambda rho: (1.0, np.cos(rho[0]), np.sin(rho[0])),
        plant=turned_plant,
        backoff=1.02,
    )
    assert result.gamma_opt == pytest.approx(0.9250 / 1.02, rel=0.01)
    assert result.gamma_opt < 0.9250 / 1.02
    assert result.norm <= result.gamma < 0.9250
    assert result.norm_between <= result.gamma
    frozen = hinf_norm(close_known(turned_plant((0.4,)), as_lti(result.at((0.4,))))).gain
    assert frozen <= result.gamma


def tutorial_plant() -> Uncertain:
    """Return `rho / (s + rho)` with W_u = (10 s + 10) / (s + 100), W_e = (s + 25) / (5 s + 5) and W_d = .1."""
    rho, step = ureal("rho", range=(1.0, 10.0)), np.sqrt(990.0)
    A = np.array([[0.0, 0.0, 0.0], [0.0, -100.0, 0.0], [-np.sqrt(4.8), 0.0, -1.0]])
    B = np.array([[0.0, 0.0, 0.0], [0.0, 0.1 * step, step], [np.sqrt(4.8), 0.0, 0.0]])
    C = np.array([[-0.2, 0.0, np.sqrt(4.8)], [0.0, -step, 0.0], [-1.0, 0.0, 0.0]])
    D = np.array([[0.2, 0.0, 0.0], [0.0, 1.0, 10.0], [1.0, 0.0, 0.0]])
    turning = np.eye(6)[:, [0]] @ (rho @ np.array([[-1.0, -step, 0.0, 0.0, 1.0, 11.0]]))
    return system_from_matrix(as_uncertain(gain(np.block([[A, B], [C, D]]))) + turning, 3)


def test_the_lft_example_of_lpvtools():
    # LPVTools, "Modeling LFT LPV Systems": GAMbLFT = 2.1480 with its default backoff of 1.2
    plant = tutorial_plant()
    result = lpvsyn(plant, 1, 1)
    assert result.gamma_opt == pytest.approx(2.1480 / 1.2, rel=2e-3)
    assert result.norm < result.gamma
    loop = lft(plant, result.scheduled, 1, 1)
    for rho in (1.0, 3.0, 10.0):
        assert hinf_norm(loop.member(loop.delta({"rho": rho}))).gain <= result.norm
    certificate = certify_lft(loop, assumes={})
    assert certificate.proven
    assert certificate.gain <= result.norm * (1.0 + 1e-3)


@pytest.mark.slow
def test_scheduling_on_the_attitude_of_d2_costs_a_third_over_hover():
    # hinfsyn's least level at hover is .233. Over .3 rad and .5 rad/s certify_gain proves .396 for its self-scheduled
    # law, 7.61 for the law as it is; the loop of this one it proves to .282
    design = load_design("D2")
    problem = design_problem(design, load_vehicle(design.vehicle))
    body = rotation(load_vehicle(design.vehicle).inertia_B, Envelope(angle=0.3, rate=0.5))
    dynamics = uncertain_airframe(body, leak=design.leak, rate_damping=design.rate_damping)
    plant = fill_diagram(problem, {"airframe": dynamics})
    result = lpvsyn(plant, problem.n_meas, problem.n_con)
    assert result.order == 9
    assert result.gamma_opt == pytest.approx(0.3136, rel=0.01)
    assert result.norm <= result.gamma
    loop = lft(plant, result.scheduled, problem.n_meas, problem.n_con)
    for values in loop.sample(5, 0):
        assert hinf_norm(loop.substitute(values)).gain <= result.norm


def test_one_plant_everywhere_has_the_level_of_hinfsyn():
    result = lpvsyn(dict.fromkeys(((1.0,), (2.0,)), lag((1.5,))), 1, 1)
    least = hinfsyn(lag((1.5,)), 1, 1).gamma_opt
    # a single parameter may be a number
    assert lpvsyn(dict.fromkeys((1.0, 2.0), lag((1.5,))), 1, 1).gamma_opt == result.gamma_opt
    assert result.gamma_opt == pytest.approx(least, rel=1e-3)
    assert result.gamma_opt >= least * (1.0 - 1e-4)
    assert hinf_norm(close_known(lag((1.5,)), result.lti)).gain <= result.norm


def test_slower_parameters_and_a_free_matrix_never_cost_and_no_point_is_better_than_its_own_optimum():
    grid = lags(0.5, 1.0, 3.0)
    still, slow, fast = (lpvsyn(grid, 1, 1, speeds=speeds).gamma_opt for speeds in ((0.0,), (1.0,), (100.0,)))
    constant = lpvsyn(grid, 1, 1).gamma_opt
    each = max(hinfsyn(P, 1, 1).gamma_opt for P in grid.values())
    assert each <= still * (1.0 + 1e-4)
    for less, more in itertools.pairwise((still, slow, fast, constant)):
        assert less <= more * (1.0 + 1e-4)
    assert lpvsyn(grid, 1, 1, speeds=(1.0,), speeds_measured=True).gamma_opt <= slow * (1.0 + 1e-4)


def test_similarity_and_scaled_channels_leave_the_level():
    grid = {rho: as_states(P, [[2.0]]) for rho, P in lags(1.0, 3.0).items()}
    scaled = {
        rho: Lti(A=P.A, B=P.B * [1.0, 1.0, 9.0], C=P.C * [[1.0], [1.0], [7.0]], D=P.D * [1, 1, 9.0] * [[1], [1], [7.0]])
        for rho, P in grid.items()
    }
    expected = lpvsyn(lags(1.0, 3.0), 1, 1, speeds=(1.0,)).gamma_opt
    for other in (grid, scaled):
        assert lpvsyn(other, 1, 1, speeds=(1.0,)).gamma_opt == pytest.approx(expected, rel=1e-3)


def as_states(P: Lti, T) -> Lti:
    return Lti(A=np.linalg.solve(T, P.A @ T), B=np.linalg.solve(T, P.B), C=P.C @ T, D=P.D)


def test_two_parameters_a_full_d22_and_controllers_between():
    def plant(rho) -> Lti:
        D = WEIGHTS.copy()
        D[2, 2] = 0.3
        return Lti(A=[[-rho[0], rho[1]], [0.0, -1.0]], B=[[1, 0, 0], [0, 0, 1]], C=[[1, 0], [0, 0], [1, 0]], D=D)

    grid = {rho: plant(rho) for rho in itertools.product((0.5, 1.0), (1.0, 2.0))}
    result = lpvsyn(grid, 1, 1, speeds=(0.5, 0.5))
    assert result.points == tuple(grid)
    for rho in ((0.5, 1.0), (0.7, 1.9)):
        loop = close_known(
            plant(rho), as_lti(result.at(rho))
        )  # the coefficients are linear in rho: interpolation is exact
        assert hinf_norm(loop).gain <= result.gamma
    np.testing.assert_array_equal(result.at(result.points[2]).A, result.K.A)


def test_a_point_outside_the_grid_is_refused():
    result = lpvsyn(lags(1.0, 2.0), 1, 1)
    with pytest.raises(ValueError, match="outside the grid"):
        result.at((2.5,))


@pytest.mark.parametrize(
    ("grid", "options", "match"),
    [
        (lags(1.0), {}, "two points"),
        ({(1.0,): lag((1.0,)), (1.0, 2.0): lag((1.0,))}, {}, "of the same parameters"),
        ({(1.0,): lag((1.0,)), (2.0,): gain(np.eye(3))}, {}, "differ in states"),
        ({rho: lag((1.0,)) for rho in ((1.0, 1.0), (2.0, 2.0))}, {}, "the product"),
        (lags(1.0, 2.0), {"backoff": 1.0}, "backoff is 1.0"),
        (lags(1.0, 2.0), {"speeds": (1.0, 2.0)}, "must be 1 finite"),
        (lags(1.0, 2.0), {"speeds": (-1.0,)}, "not negative"),
        (lags(1.0, 2.0), {"speeds_measured": True}, "need bounds on the speeds"),
        (lags(1.0, 2.0), {"n_meas": 3}, "do not fit"),
        (
            {(k,): Lti(A=[[0.5]], B=np.ones((1, 3)), C=np.ones((3, 1)), D=WEIGHTS, dt=0.1) for k in (1, 2)},
            {},
            "discrete",
        ),
        (tutorial_plant(), {"speeds": (1.0,)}, "takes no speeds"),
        (tutorial_plant(), {"n_meas": 3}, "do not fit"),
        (ultidyn("delta") @ gain(np.eye(1)), {}, "real parameters, and no other"),
        (as_uncertain(lag((1.0,))), {}, "real parameters, and no other"),
        (replace(tutorial_plant(), M=replace(tutorial_plant().M, dt=0.1)), {}, "the plant is discrete"),
        (tutorial_plant(), {"backoff": np.inf}, "backoff is inf"),
        (tutorial_plant(), {"basis": lambda rho: (1.0, *rho)}, "takes no speeds, basis or plant"),
        ({}, {}, "two points"),
    ],
)
def test_bad_input_is_refused(grid, options, match):
    with pytest.raises(ValueError, match=match):
        lpvsyn(grid, **({"n_meas": 1, "n_con": 1} | options))


@pytest.mark.parametrize(
    ("rows", "match"),
    [(([0, 0, 0], [0, 0, 0], [0, 0.1, 0]), "D12 at"), (([0, 0, 0], [0, 0, 0.1], [0, 0, 0]), "D21 at")],
)
def test_a_plant_without_weight_or_noise_is_refused(rows, match):
    with pytest.raises(DesignError, match=match):
        lpvsyn({(k,): lag((k,), np.array(rows, dtype=float)) for k in (1.0, 2.0)}, 1, 1)


def turned_lag(C: float, weight: float) -> Uncertain:
    """Return an unstable lag whose pole is a parameter, measured with the gain `C`, its control weighted."""
    A, rest = ureal("pole", range=(1.0, 3.0)) @ [[1.0, 0, 0, 0]], [[0, 0, 0, weight], [C, 0, 0.1, 0]]
    return system_from_matrix([[1.0], [0], [0], [0]] @ A + [[0, 1.0, 0, 1.0], [1.0, 0, 0, 0], *rest], 1)


@pytest.mark.parametrize(
    ("plant", "match"), [(turned_lag(0.0, 0.1), "no solution"), (turned_lag(1.0, 0.0), "D12|singular|rank|no solution")]
)
def test_an_lft_without_solution_is_refused(plant, match):
    with pytest.raises(DesignError, match=match):
        lpvsyn(plant, 1, 1)


def test_a_feedthrough_that_nothing_lowers_is_the_least_level():
    grid = {(k,): lag((k,), np.array([[9.0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]])) for k in (1.0, 2.0)}
    assert lpvsyn(grid, 1, 1).gamma_opt == pytest.approx(9.0, rel=0.05)


def test_a_plant_that_nothing_stabilises_is_refused():
    grid = {(k,): Lti(A=[[k]], B=[[1.0, 0.0, 0.0]], C=[[1.0], [0.0], [1.0]], D=WEIGHTS) for k in (1.0, 2.0)}
    with pytest.raises(DesignError, match="no solution"):
        lpvsyn(grid, 1, 1)
