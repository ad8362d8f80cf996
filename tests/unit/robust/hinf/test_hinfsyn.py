"""The least level of the designs, what a returned controller must do, each ill-posed problem by name."""

import contextlib
import dataclasses

import control
import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.design.designs import Weight, design_problem, load_design
from gustproof.errors import DesignError
from gustproof.robust.hinf.h2syn import h2syn
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, as_lti, gain, lft

SOLVERS_AGREE = 1e-3
"""Relative; slycot's bisection stops near 1e-6, and the issue asks for 1e-3."""
PUBLISHED = 2e-4
"""Absolute accuracy to which the design figures are known."""


def design_plant(name: str, **changes: object) -> Lti:
    design = dataclasses.replace(load_design(name), **changes)
    return design_problem(design, load_vehicle(design.vehicle)).plant()


def random_plant(seed: int) -> tuple[Lti, int, int]:
    """Return a plant with full D matrices, its number of measurements and of controls."""
    rng = np.random.default_rng(seed)
    n, p2, m2 = rng.integers(2, 6), rng.integers(1, 3), rng.integers(1, 3)
    m1, p1 = rng.integers(p2, 5), rng.integers(m2, 5)
    return (
        Lti(
            A=rng.normal(size=(n, n)),
            B=rng.normal(size=(n, m1 + m2)),
            C=rng.normal(size=(p1 + p2, n)),
            D=rng.normal(size=(p1 + p2, m1 + m2)),
        ),
        int(p2),
        int(m2),
    )


@pytest.mark.parametrize(("name", "gamma_opt"), [("D1", 0.2136), ("D2", 0.2327)])
def test_the_least_level_is_the_known_one_and_slycots(name, gamma_opt):
    P = design_plant(name)
    ours = hinfsyn(P, 3, 3, gamma=0.25)
    _, _, theirs, _ = control.hinfsyn(P.to_control(), 3, 3)
    assert ours.gamma_opt == pytest.approx(gamma_opt, abs=PUBLISHED)
    assert ours.gamma_opt == pytest.approx(theirs, rel=SOLVERS_AGREE)
    assert ours.norm < 0.25
    assert ours.order == 9


def test_the_least_level_of_d5_is_the_floor_that_the_leak_sets():
    assert hinfsyn(design_plant("D5"), 3, 3).gamma_opt == pytest.approx(30.0 * 0.0036 / 0.05, rel=SOLVERS_AGREE)


def test_a_small_leak_alone_sets_the_level():
    gamma_opt = hinfsyn(design_plant("D1", leak=0.005, rate_damping=0.005), 3, 3).gamma_opt
    assert gamma_opt * 0.005 / (1.0 * 0.0036) == pytest.approx(1.0, rel=SOLVERS_AGREE)


def test_no_controller_is_better_than_the_least_level():
    P = design_plant("D2")
    best = hinfsyn(P, 3, 3, backoff=1.0001)
    assert best.gamma_opt * (1.0 - 1e-6) <= best.norm < best.gamma


def test_the_controller_estimates_the_plants_states_in_their_order():
    # driven by what it commands, an H-infinity estimate follows the plant: attitude to the worst-case disturbance aside
    P = design_plant("D1")
    result = hinfsyn(P, 3, 3, gamma=0.25)
    A = result.lti.A
    assert np.allclose(A[:3, 3:6] + result.lti.B[:3], np.eye(3), atol=0.01)
    assert np.allclose(A[6:, 6:], np.diag(np.diag(A[6:, 6:])), atol=1e-9)


def test_a_feedthrough_from_control_to_measurement_changes_the_controller_not_the_loop():
    P, n_meas, n_con = random_plant(3)
    D = P.D.copy()
    D[-n_meas:, -n_con:] = 0.0
    without = Lti(A=P.A, B=P.B, C=P.C, D=D)
    first, second = hinfsyn(P, n_meas, n_con), hinfsyn(without, n_meas, n_con)
    omega = np.geomspace(0.01, 100.0, 7)
    ours = lft(P, first.lti).response(omega)
    assert np.allclose(ours, lft(without, second.lti).response(omega), rtol=1e-6, atol=1e-9)


def test_python_controls_objects_go_in_and_come_out():
    result = hinfsyn(design_plant("D1").to_control(), 3, 3, gamma=0.25)
    assert isinstance(result.K, control.StateSpace)
    assert np.array_equal(as_lti(result.K).A, result.lti.A)


def beside_each_other(plants: list[tuple[Lti, int, int]], rng: np.random.Generator) -> tuple[Lti, list[dict]]:
    """Return one plant of several that share nothing, shuffled, and where each one's states and signals are."""
    counts = {
        "x": [P.order for P, _, _ in plants],
        "w": [P.n_inputs - m2 for P, _, m2 in plants],
        "u": [m2 for _, _, m2 in plants],
        "z": [P.n_outputs - p2 for P, p2, _ in plants],
        "y": [p2 for _, p2, _ in plants],
    }
    total = {name: sum(count) for name, count in counts.items()}
    order = {name: np.split(rng.permutation(total[name]), np.cumsum(count)[:-1]) for name, count in counts.items()}
    places = [{name: order[name][k] for name in order} for k in range(len(plants))]
    A, B = np.zeros((total["x"], total["x"])), np.zeros((total["x"], total["w"] + total["u"]))
    C, D = np.zeros((total["z"] + total["y"], total["x"])), np.zeros((total["z"] + total["y"], B.shape[1]))
    for (P, _, _), at in zip(plants, places, strict=True):
        x, inputs = at["x"], np.concatenate([at["w"], total["w"] + at["u"]])
        outputs = np.concatenate([at["z"], total["z"] + at["y"]])
        A[np.ix_(x, x)], B[np.ix_(x, inputs)] = P.A, P.B
        C[np.ix_(outputs, x)], D[np.ix_(outputs, inputs)] = P.C, P.D
    return Lti(A=A, B=B, C=C, D=D), places


@pytest.mark.parametrize("seed", range(0, 30, 3))
def test_the_controller_of_plants_that_share_nothing_is_their_controllers(seed):
    plants = [random_plant(seed + k) for k in range(3)]
    P, places = beside_each_other(plants, np.random.default_rng(seed))
    whole = hinfsyn(P, sum(p2 for _, p2, _ in plants), sum(m2 for _, _, m2 in plants))
    parts = [hinfsyn(*plant, gamma=whole.gamma) for plant in plants]
    assert whole.gamma_opt == pytest.approx(max(part.gamma_opt for part in parts), rel=1e-6)
    assert whole.norm == pytest.approx(max(part.norm for part in parts), rel=1e-6)
    omega, between = np.geomspace(0.01, 100.0, 9), {name: getattr(whole.lti, name).copy() for name in "ABCD"}
    responses = whole.lti.response(omega)
    for part, at in zip(parts, places, strict=True):
        alone = part.lti.response(omega)
        assert np.allclose(responses[:, at["u"][:, None], at["y"]], alone, rtol=1e-6, atol=1e-6 * np.abs(alone).max())
        for name, rows, columns in (("A", "x", "x"), ("B", "x", "y"), ("C", "u", "x"), ("D", "u", "y")):
            between[name][np.ix_(at[rows], at[columns])] = 0.0
    assert not any(matrix.any() for matrix in between.values())


def test_what_no_control_reaches_changes_no_controller():
    P, n_meas, n_con = random_plant(3)
    lag = (Lti(A=[[-1.0]], B=[[1.0, 0.0]], C=[[0.1]], D=[[0.0, 0.0]]), 0, 0)  # from one w to z; another w does nothing
    both, (at, alone) = beside_each_other([(P, n_meas, n_con), lag], np.random.default_rng(0))
    ours, theirs = hinfsyn(both, n_meas, n_con), hinfsyn(P, n_meas, n_con)
    omega = np.geomspace(0.01, 100.0, 9)
    part = theirs.lti.response(omega)
    assert np.allclose(ours.lti.response(omega)[:, at["u"][:, None], at["y"]], part, rtol=1e-6, atol=1e-9)
    assert not ours.lti.A[np.ix_(at["x"], alone["x"])].any()
    assert not ours.lti.A[np.ix_(alone["x"], at["x"])].any()


def test_a_level_below_the_least_is_refused_with_both_numbers():
    with pytest.raises(DesignError, match=r"gamma = 0\.2: the least level is 0\.21"):
        hinfsyn(design_plant("D1"), 3, 3, gamma=0.2)


def test_a_plant_that_no_arithmetic_can_hold_is_refused_by_name():
    for seed in range(100):
        rng = np.random.default_rng(seed)
        n, decades = int(rng.integers(1, 5)), rng.choice([40, 150])
        A, B, C, D = (
            rng.normal(size=shape) * 10.0 ** rng.uniform(-decades, decades, size=shape)
            for shape in ((n, n), (n, 3), (3, n), (3, 3))
        )
        with contextlib.suppress(DesignError), np.errstate(all="ignore"):
            result = hinfsyn(Lti(A=A, B=B, C=C, D=D), 1, 1)
            assert result.norm < result.gamma


def discretize_tustin(P: Lti, dt: float) -> Lti:
    M = np.linalg.inv(np.eye(P.order) - P.A * dt / 2.0)
    C = dt**0.5 * P.C @ M
    return Lti(
        A=M @ (np.eye(P.order) + P.A * dt / 2.0), B=dt**0.5 * M @ P.B, C=C, D=P.D + dt / 2.0 * P.C @ M @ P.B, dt=dt
    )


LAG = {"A": [[-1.0]], "B": [[1.0, 0.0, 1.0]], "C": [[1.0], [0.0], [1.0]]}
GOOD_D = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"D": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]}, "D12 lacks full column rank"),
        ({"D": [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]}, "D21 lacks full row rank"),
        ({"A": [[1.0]], "B": [[1.0, 0.0, 0.0]]}, "not stabilisable by u: mode at 1 "),
        ({"A": [[0.0]], "C": [[1.0], [0.0], [0.0]]}, "not detectable from y: mode at 0 "),
        ({"A": [[0.0]], "C": [[0.0], [0.0], [1.0]]}, "zero on the imaginary axis from u to z: at 0 "),
        ({"A": [[0.0]], "B": [[0.0, 0.0, 1.0]]}, "zero on the imaginary axis from w to y: at 0 "),
    ],
)
def test_an_ill_posed_problem_is_refused_by_the_condition_that_fails(changes, message):
    P = Lti(**{**LAG, "D": GOOD_D, **changes})
    with pytest.raises(DesignError, match=message):
        hinfsyn(P, 1, 1)


def test_problems_from_which_other_programs_do_not_return_are_refused_by_name():
    # mixed sensitivity without a weight on the control: python-control's issues 973 and 152
    G = as_lti(control.tf2ss(control.tf([1.0, 1.0], [1.0, 0.5, 4.0])))
    W = as_lti(control.tf2ss(control.tf([2.0, -2.2, 1.0], [3.0, 0.2, 0.01])))
    mixsyn_973 = Lti(
        A=np.block([[G.A, np.zeros((2, 2))], [-W.B @ G.C, W.A]]),
        B=np.block([[np.zeros((2, 1)), G.B], [W.B, np.zeros((2, 1))]]),
        C=np.block([[-W.D @ G.C, W.C], [-G.C, np.zeros((1, 2))]]),
        D=np.vstack([[W.D.item(), 0.0], [1.0, 0.0]]),
    )
    hinfsyn_152 = Lti(
        A=[[-0.01, -0.992], [0.0, -0.75]],
        B=[[0.992, 0.0], [0.0, 1.0]],
        C=[[1.0, -0.8], [0.0, -1.0]],
        D=[[0.8, 0.0], [1.0, 0.0]],
    )
    for P in (mixsyn_973, hinfsyn_152):
        with pytest.raises(DesignError, match="D12 lacks full column rank: control 1 is not weighted in z"):
            hinfsyn(P, 1, 1)


def test_without_a_leak_the_attitude_is_not_detectable_from_rates():
    P = design_plant("D1")
    A = P.A.copy()
    A[:3, :3] = 0.0
    with pytest.raises(DesignError, match="not detectable"):
        hinfsyn(Lti(A=A, B=P.B, C=P.C, D=P.D), 3, 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n_meas": 3, "n_con": 1}, "leave no w, z, u or y"),
        ({"n_meas": 1, "n_con": 1, "gamma": -1.0}, "gamma is -1.0"),
        ({"n_meas": 1, "n_con": 1, "gamma": float("nan")}, "gamma is nan"),
        ({"n_meas": 1, "n_con": 1, "backoff": 1.0}, "backoff is 1.0"),
    ],
)
def test_a_callers_mistake_is_a_value_error(arguments, message):
    with pytest.raises(ValueError, match=message):
        hinfsyn(Lti(**LAG, D=GOOD_D), **arguments)


def test_discrete_plant_has_the_level_of_its_bilinear_image():
    P, n_meas, n_con = random_plant(4)
    discrete = discretize_tustin(P, 0.1)
    ours, continuous = hinfsyn(discrete, n_meas, n_con), hinfsyn(P, n_meas, n_con)
    assert ours.gamma_opt == pytest.approx(continuous.gamma_opt, rel=1e-6)
    assert ours.lti.dt == 0.1
    loop = lft(discrete, ours.lti)
    assert loop.is_stable()
    assert hinf_norm(loop).gain == pytest.approx(ours.norm, rel=1e-9)


@pytest.mark.parametrize("pole", [-1.0, 1.0, 0.0])
def test_discrete_plant_with_a_pole_on_the_circle_is_solved(pole):
    P = Lti(A=[[pole]], B=[[1.0, 0.0, 1.0]], C=[[1.0], [0.0], [1.0]], D=GOOD_D, dt=0.5)
    result = hinfsyn(P, 1, 1)
    assert lft(P, result.lti).is_stable()
    assert result.norm < result.gamma


def test_discrete_plant_with_poles_at_both_ends_is_refused():
    P = Lti(A=np.diag([1.0, -1.0]), B=np.ones((2, 3)), C=np.ones((3, 2)), D=GOOD_D, dt=0.5)
    with pytest.raises(DesignError, match="poles at z = -1 and at z = 1"):
        hinfsyn(P, 1, 1)


def test_plant_without_states_is_refused():
    with pytest.raises(ValueError, match="at least one state"):
        hinfsyn(gain(GOOD_D), 1, 1)


def test_a_noise_spectrum_that_rises_raises_the_floor():
    shaped = Weight(low=(0.0072,) * 3, high=(0.0036,) * 3, corner=0.1)
    result = hinfsyn(design_plant("D1", W_n=shaped, gamma=None), 3, 3)
    assert result.order == 12
    assert result.gamma_opt == pytest.approx(0.0072 / 0.02, rel=SOLVERS_AGREE)


@pytest.mark.parametrize("seed", range(6))
def test_level_is_left_by_duality_similarity_and_units(seed):
    P, n_meas, n_con = random_plant(seed)
    level = hinfsyn(P, n_meas, n_con).gamma_opt
    rng = np.random.default_rng(seed)
    T = rng.normal(size=(P.order, P.order))
    similar = Lti(A=np.linalg.solve(T, P.A @ T), B=np.linalg.solve(T, P.B), C=P.C @ T, D=P.D)
    dual = Lti(A=P.A.T, B=P.C.T, C=P.B.T, D=P.D.T)
    rows, columns = np.ones(P.n_outputs), np.ones(P.n_inputs)
    rows[-n_meas:], columns[-n_con:] = 10.0 ** rng.uniform(-5, 5, n_meas), 10.0 ** rng.uniform(-5, 5, n_con)
    x = 10.0 ** rng.uniform(-5, 5, P.order)
    scaled = Lti(
        A=P.A * x / x[:, None],
        B=P.B * columns / x[:, None],
        C=rows[:, None] * P.C * x,
        D=rows[:, None] * P.D * columns,
    )
    assert hinfsyn(similar, n_meas, n_con).gamma_opt == pytest.approx(level, rel=1e-6)
    assert hinfsyn(dual, n_con, n_meas).gamma_opt == pytest.approx(level, rel=1e-6)
    assert hinfsyn(scaled, n_meas, n_con).gamma_opt == pytest.approx(level, rel=1e-6)


@pytest.mark.parametrize("distance", [1e-4, 1e-9, 1e-12])
def test_zero_left_of_the_axis_costs_nothing_and_one_right_of_it_does(distance):
    # u reaches z through (s - zero) / (s + 1)^2: a controller can cancel the zero or must leave what it blocks
    levels = {}
    for zero in (-distance, distance):
        P = Lti(
            A=[[0.0, 1.0], [-1.0, -2.0]],
            B=[[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]],
            C=[[-1.0 - zero, -2.0 + 1.0], [1.0, 0.0]],
            D=[[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
        )
        levels[zero] = hinfsyn(P, 1, 1).gamma_opt
    assert levels[-distance] <= levels[distance] * (1.0 + 1e-6)


def test_level_that_rounding_hides_is_refused_by_name():
    rng = np.random.default_rng(0)
    for _ in range(200):
        n, zero = 4, 10.0 ** rng.uniform(-11, -8)
        T, F, C = rng.normal(size=(n, n)), rng.normal(size=(2, n)), rng.normal(size=(3, n))
        A, B, D = rng.normal(size=(n, n)), rng.normal(size=(n, 4)), rng.normal(size=(4, 4))
        A[:, 0], C[:, 0] = 0.0, 10.0 ** rng.uniform(-11, -8) * rng.normal(size=3)
        A[0, 0] = -zero
        A, C = T @ A @ np.linalg.inv(T) + B[:, 2:] @ F, C @ np.linalg.inv(T) + D[:3, 2:] @ F
        P = Lti(A=A, B=B, C=np.vstack([C, rng.normal(size=(1, n))]), D=D)
        try:
            hinfsyn(P, 1, 2)
        except DesignError as refusal:
            if "cannot be told: rounding hides" in str(refusal):
                return
    pytest.fail("no plant was refused so")


def test_singular_plant_is_solved_on_request_and_its_cost_told():
    P = Lti(**LAG, D=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    result = hinfsyn(P, 1, 1, regularize=True)
    assert result.regularization > 0.0
    assert 0.0 < result.gamma_excess < 1e-3 * result.gamma_opt
    assert hinf_norm(lft(P, result.lti)).gain == pytest.approx(result.norm, rel=1e-9)
    assert result.norm_error <= 1e-6 * result.norm


def test_regular_plant_is_not_regularised():
    P, n_meas, n_con = random_plant(1)
    plain, asked = hinfsyn(P, n_meas, n_con), hinfsyn(P, n_meas, n_con, regularize=True)
    assert np.array_equal(plain.lti.A, asked.lti.A)
    assert asked.regularization == asked.gamma_excess == 0.0


def test_regularisation_does_not_help_a_plant_that_cannot_be_stabilised():
    P = Lti(A=[[1.0]], B=[[1.0, 0.0, 0.0]], C=LAG["C"], D=np.zeros((3, 3)))
    with pytest.raises(DesignError, match="not stabilisable by u"):
        hinfsyn(P, 1, 1, regularize=True)


@pytest.mark.parametrize(
    ("D", "message"),
    [
        ([[0, 0, 0], [0, 0.1, 0]], "control 'fin' is not weighted"),
        ([[0, 0, 0.1], [0, 0, 0]], "measurement 'yaw' has no"),
    ],
)
def test_a_cause_is_told_by_the_names_of_the_signals(D, message):
    names = {"inputs": ["gust", "noise", "fin"], "outputs": ["z", "yaw"]}
    P = control.ss(-1.0, [[1.0, 0.0, 1.0]], [[1.0], [1.0]], D, **names)
    for synthesis in (hinfsyn, h2syn):
        with pytest.raises(DesignError, match=message):
            synthesis(P, 1, 1)
