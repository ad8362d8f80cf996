"""hinfstruct: published plants, the designs at fixed order, structures, limits, several models, determinism."""

import json
from pathlib import Path

import control
import numpy as np
import pytest
from control import sample_system, ss, tf

from firmware_model.config.vehicle import load_vehicle
from gustproof.design.designs import design_problem, load_design
from gustproof.errors import DesignError
from gustproof.robust.lti.bilinear import bilinear_transform
from gustproof.robust.lti.norms import h2_norm, hinf_norm
from gustproof.robust.lti.state_space import Lti, as_lti, lft
from gustproof.robust.structured.blocks import (
    Structure,
    balanced_truncation,
    decoupled_structure,
    full_structure,
    observer_structure,
    tunable_gain,
    tunable_observer,
    tunable_pid,
    tunable_ss,
)
from gustproof.robust.structured.goals import (
    NORM,
    ControllerSizeGoal,
    GainGoal,
    LoopLocation,
    NormKind,
    RollOffGoal,
    SensitivityGoal,
    StabilityGoal,
    extract_channel,
)
from gustproof.robust.structured.hinfstruct import SearchStart, _Search, hinfstruct
from gustproof.robust.structured.objective import Problem
from gustproof.robust.structured.search import Minimum, minimize

GOLDEN = json.loads((Path(__file__).parents[3] / "golden" / "compleib.json").read_text(encoding="utf-8"))["plants"]
NEAR = 1.005
"""A local search may end this far above the least value known; it may be below."""
SEED = 2
"""With it one start is enough for most plants, which spares the gate the default five."""
STARTS = {"DIS4": 2, "NN8": 2, "REA1": 2}
"""Starts for a plant that wants more."""
SEEDS = {"DIS3": 1}
"""Another seed for a plant that would want more starts with that one."""


def compleib(name: str) -> tuple[control.StateSpace, int, int]:
    A, B1, B, C1, D12, C = (np.array(GOLDEN[name][key], dtype=float) for key in ("A", "B1", "B", "C1", "D12", "C"))
    D = np.zeros((C1.shape[0] + C.shape[0], B1.shape[1] + B.shape[1]))
    D[: C1.shape[0], B1.shape[1] :] = D12
    return control.ss(A, np.hstack([B1, B]), np.vstack([C1, C]), D), C.shape[0], B.shape[1]


def design_plant(name: str) -> Lti:
    design = load_design(name)
    return design_problem(design, load_vehicle(design.vehicle)).plant()


def roll(inertia: float = 1.0) -> Lti:
    """Return the roll axis of design D2, its inertia times a factor."""
    P, states, channels = design_plant("D2"), np.array([0, 3, 6]), np.array([0, 3, 6])
    A = P.A[np.ix_(states, states)].copy()
    B = P.B[np.ix_(states, channels)].copy()
    A[1, 2], B[1] = A[1, 2] / inertia, B[1] / inertia
    return Lti(A=A, B=B, C=P.C[np.ix_(channels, states)], D=P.D[np.ix_(channels, channels)])


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(GOLDEN))
def test_static_output_feedback_of_compleib_is_as_good_as_known(name):
    P, n_meas, n_con = compleib(name)
    result = hinfstruct(P, n_meas, n_con, order=0, starts=STARTS.get(name, 1), seed=SEEDS.get(name, SEED))
    K = result.K
    assert K.nstates == 0
    assert result.gamma <= NEAR * GOLDEN[name]["gamma"]
    # the claim is python-control's norm, not ours
    G, D_K = as_lti(P), K.D
    B1, B2, C1, C2 = G.B[:, :-n_con], G.B[:, -n_con:], G.C[:-n_meas], G.C[-n_meas:]
    closed = control.ss(G.A + B2 @ D_K @ C2, B1, C1 + G.D[:-n_meas, -n_con:] @ D_K @ C2, 0.0)
    assert np.all(closed.poles().real < 0.0)
    assert control.norm(closed, "inf") == pytest.approx(result.gamma, rel=1e-4)


@pytest.mark.slow
def test_a_gain_that_would_grow_without_end_is_kept_below_1e4():
    """COMPleib's AC16 is its AC15 with all states measured; the least norm is at infinite gains."""
    plant = {key: np.array(value, dtype=float) for key, value in GOLDEN["AC15"].items()}
    B, C = np.hstack([plant["B1"], plant["B"]]), np.vstack([plant["C1"], np.eye(4)])
    D = np.zeros((10, 6))
    D[:6, 4:] = plant["D12"]
    limit = ControllerSizeGoal(limit=1e4)
    result = hinfstruct(Lti(A=plant["A"], B=B, C=C, D=D), 4, 2, starts=1, hard_goals=[limit])
    assert np.linalg.norm(result.lti.D, 2) <= 1e4
    assert result.gamma <= NEAR * 14.8561  # the least found with gains up to 1.6e5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["D1", "D2"])
def test_two_states_an_axis_come_within_two_percent_of_any_controller(name):
    P = design_plant(name)
    # Two starts: one of them may end in a crease at 2 to 7 %, and which does is a matter of rounding.
    result = hinfstruct(P, 3, 3, structure=decoupled_structure(2, 3, 3), starts=2)
    assert result.order == 6
    assert result.gamma <= 1.02 * result.gamma_opt
    assert hinf_norm(lft(P, result.lti)).gain == pytest.approx(result.gamma, rel=1e-3)
    assert result.starts[result.winner].target == min(start.target for start in result.starts)
    # no axis reads or drives another
    response = result.lti.response([0.1, 10.0])
    assert np.all(response[:, ~np.eye(3, dtype=bool)] == 0.0)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_controller_to_the_bit():
    first, second = (hinfstruct(*compleib("HE1"), starts=1, seed=5) for _ in range(2))
    other = hinfstruct(*compleib("HE1"), starts=1, seed=6)
    assert np.array_equal(first.theta, second.theta)
    assert not np.array_equal(first.theta, other.theta)


@pytest.mark.slow
def test_more_states_never_hurt_and_no_structure_beats_hinfsyn():
    results = [hinfstruct(roll(), 1, 1, structure=decoupled_structure(order, 1, 1), starts=2) for order in (0, 1, 2)]
    static, first, second = (result.gamma for result in results)
    assert static > first > second >= results[1].gamma_opt * (1.0 - 1e-6)


def test_blocks_are_tuned_by_name_and_what_is_not_there_stays_zero():
    structure = Structure(
        blocks=(
            tunable_pid("roll", input=0, output=0, cutoff=50.0),
            tunable_gain("pitch", inputs=(1,), outputs=(1,)),
            tunable_ss("yaw", 1, inputs=(2,), outputs=(2,), strictly_proper=True),
        ),
        n_meas=3,
        n_con=3,
    )
    result = hinfstruct(design_plant("D2"), 3, 3, structure=structure, starts=1)
    assert set(result.blocks) == {"roll", "pitch", "yaw"}
    s = 3.0j
    k_p, k_i, k_d, pitch, a, b, c = result.theta
    expected = np.diag([k_p + k_i / s + k_d * s / (s / 50.0 + 1.0), pitch, c * b / (s - a)])
    assert np.allclose(result.lti.response([3.0])[0], expected, rtol=1e-9, atol=1e-12)
    assert np.allclose(result.blocks["pitch"].D, pitch)


def test_an_observer_block_holds_an_attitude_and_its_rate():
    block = tunable_observer("K", 3, input=0, output=0, leak=0.05)
    theta = block.draw(np.random.default_rng(2))
    K = block.system(theta)
    assert np.array_equal(K.A[0], [-0.05, 1.0, 0.0])
    assert K.B[0, 0] == 0.0
    assert K.B[1, 0] == -K.A[1, 1]


def test_every_system_has_observer_coordinates():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(3, 3))
    K = Lti(A=A - 3.0 * np.eye(3), B=rng.normal(size=(3, 1)), C=rng.normal(size=(1, 3)), D=rng.normal(size=(1, 1)))
    block = tunable_observer("K", 3, input=0, output=0, leak=0.1)
    theta = block.fit(K)
    assert theta is not None
    omega = np.geomspace(0.01, 100.0, 9)
    assert np.allclose(block.system(theta).response(omega), K.response(omega), rtol=1e-6)


def test_truncation_keeps_the_order_asked_for_and_what_matters():
    large = Lti(A=np.diag([-1.0, -2.0, -300.0]), B=np.ones((3, 1)), C=np.array([[1.0, 2.0, 1e-3]]), D=np.zeros((1, 1)))
    omega = np.geomspace(0.01, 10.0, 7)
    assert np.allclose(balanced_truncation(large, 2).response(omega), large.response(omega), atol=1e-4)
    padded = balanced_truncation(large, 5)
    assert padded.order == 5
    assert np.allclose(padded.response(omega), large.response(omega), rtol=1e-6)


@pytest.mark.slow
def test_the_worst_of_several_models_counts():
    models = [roll(factor) for factor in (0.8, 1.0, 1.2)]
    structure = observer_structure(2, 1, leak=0.05)
    robust = hinfstruct(models, 1, 1, structure=structure, starts=1)
    nominal = hinfstruct(models[1], 1, 1, structure=structure, starts=1)
    norms = [hinf_norm(lft(model, robust.lti)).gain for model in models]
    assert robust.gamma == pytest.approx(max(norms), rel=1e-3)
    assert robust.gamma < max(hinf_norm(lft(model, nominal.lti)).gain for model in models)


def sensitivity_peak(K: Lti) -> float:
    P = roll().to_control()
    loop = P[2, 2] * K.to_control()  # positive feedback: S = 1 / (1 - G K)
    return float(control.norm(control.feedback(1.0, loop, 1), "inf"))


@pytest.mark.slow
def test_a_limit_on_ms_is_kept_and_has_its_price():
    P, structure = roll(), full_structure(1, 1, 1)
    free = hinfstruct(P, 1, 1, structure=structure, starts=1)
    limit = 1.0 + 0.5 * (sensitivity_peak(free.lti) - 1.0)
    held = hinfstruct(P, 1, 1, structure=structure, starts=1, hard_goals=[SensitivityGoal(limit=limit)])
    assert sensitivity_peak(held.lti) <= limit * (1.0 + 1e-6)
    assert held.hard_goals["Ms"] <= 1.0
    assert held.gamma > free.gamma


@pytest.mark.slow
def test_least_rms_error_at_a_limit_on_torque_rms_uses_up_the_limit():
    structure = Structure(
        blocks=(tunable_ss("K", 1, inputs=(0,), outputs=(0,), strictly_proper=True),), n_meas=1, n_con=1
    )
    error, torque = (
        GainGoal(measure=NormKind.RMS, outputs=(0,)),
        GainGoal(name="torque", measure=NormKind.RMS, outputs=(1,)),
    )
    # the error alone would ask for endless gain
    loose = hinfstruct(roll(), 1, 1, structure=structure, starts=1, soft_goal=GainGoal(measure=NormKind.RMS))
    closed = lft(roll(), loose.lti)
    limit = 0.7 * h2_norm(closed.subsystem(slice(1, 2), slice(0, 2)))
    limited = GainGoal(name="torque", limit=limit, measure=torque.measure, outputs=torque.outputs)
    tight = hinfstruct(roll(), 1, 1, structure=structure, starts=1, soft_goal=error, hard_goals=[limited])
    closed = lft(roll(), tight.lti)
    assert h2_norm(closed.subsystem(slice(0, 1), slice(0, 2))) == pytest.approx(tight.target, rel=1e-6)
    assert 0.99 * limit < h2_norm(closed.subsystem(slice(1, 2), slice(0, 2))) <= limit
    assert tight.target > h2_norm(lft(roll(), loose.lti).subsystem(slice(0, 1), slice(0, 2)))


@pytest.mark.slow
def test_controller_stability_and_roll_off_are_kept():
    limits = [StabilityGoal(margin=1.0), RollOffGoal(corner=300.0, limit=60.0)]
    result = hinfstruct(roll(), 1, 1, structure=decoupled_structure(2, 1, 1), starts=1, hard_goals=limits)
    assert np.max(result.lti.poles().real) <= -1.0
    P, K = roll(), result.lti
    loop = P.to_control()[2, 2] * K.to_control()
    command = K.to_control() * control.feedback(1.0, loop, 1)
    omega = np.geomspace(300.0, 3e5, 50)
    # the weight levels off at 1,000 times the corner, so the line ends there 3 dB above its slope
    line = 60.0 * 300.0 / omega * np.sqrt(1.0 + (omega / 3e5) ** 2)
    assert np.all(np.abs(command(1j * omega)) <= line * (1.0 + 1e-3))


def test_progress_is_told_with_each_start_and_python_controls_objects_come_out():
    told: list[tuple[float, str]] = []
    result = hinfstruct(*compleib("NN2"), starts=1, progress=lambda fraction, text: told.append((fraction, text)))
    assert isinstance(result.K, control.StateSpace)
    assert np.array_equal(as_lti(result.K).D, result.lti.D)
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert "best so far 2.2" in told[-2][1]
    assert sum(", step 2 at " in text for _, text in told) >= 2  # within a start too, which may take a minute


def test_a_limit_that_cannot_be_kept_is_an_error_that_names_it():
    with pytest.raises(DesignError, match=r"Ms 1\.[0-9]+ of its limit"):
        hinfstruct(roll(), 1, 1, order=1, starts=1, hard_goals=[SensitivityGoal(limit=0.9)])


def test_a_gain_that_ran_off_counts_if_it_is_worth_it_or_all_did():
    P, _, _ = compleib("NN2")
    problem = Problem(models=(as_lti(P),), structure=full_structure(0, 1, 1), target=NORM, hard_goals=())
    search = _Search(problem, np.random.default_rng(1))

    def put(*ends: tuple[float, float]) -> None:
        search.tried = [SearchStart(name="", target=target, failure="") for target, _ in ends]
        search._found = [np.array([gain]) for _, gain in ends]

    put((2.0, 1e9), (3.0, -1.0), (np.inf, 0.0))
    assert (search.best, search.least, search._is_confirmed()) == (1, 3.0, False)
    put((2.0, 1e9), (3.0, -1.0), (3.0, -1.0))  # two agree, but a diverged one is better
    assert (search.best, search._is_confirmed()) == (1, False)
    put((2.9999, 1e9), (3.0, -1.0), (3.0, -1.0))
    assert (search.best, search._is_confirmed()) == (1, True)
    put((2.0, -1e9), (2.0, -1e9))
    assert (search.best, search._is_confirmed()) == (0, False)
    assert search._checked_norm(0) > 2.0
    put((2.0, 1e9))
    assert search._checked_norm(0) == np.inf  # unstable


def test_white_noise_straight_to_what_is_minimised_is_an_error():
    with pytest.raises(DesignError, match="white noise passes straight through"):
        hinfstruct(roll(), 1, 1, order=1, starts=1, soft_goal=GainGoal(measure=NormKind.RMS))


def test_a_plant_that_no_gain_stabilises_is_an_error():
    double = Lti(A=[[0.0, 1.0], [0.0, 0.0]], B=[[0.0, 0.0], [1.0, 1.0]], C=[[1.0, 0.0], [1.0, 0.0]], D=np.zeros((2, 2)))
    with pytest.raises(DesignError, match=r"in 6 starts and 24 more for a stable loop: random 1: unstable"):
        hinfstruct(double, 1, 1, starts=2)


def test_a_stable_loop_that_no_start_finds_is_sought_further(monkeypatch):
    def refuse_to_stabilise(function, theta, *, steps, **options):
        if steps == 300:  # those of a start
            return Minimum(theta=theta, value=function.value(theta))
        return minimize(function, theta, steps=steps, **options)

    monkeypatch.setattr("gustproof.robust.structured.hinfstruct.minimize", refuse_to_stabilise)
    P = Lti(A=[[30.0]], B=[[1.0, 1.0]], C=[[1.0], [0.0], [1.0]], D=[[0.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    result = hinfstruct(P, 1, 1, starts=1)
    assert result.starts[0].failure.startswith("unstable, abscissa 3")
    assert result.starts[result.winner].name.startswith("attempt ")
    assert result.theta[0] < -30.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n_meas": 3, "n_con": 1}, "leave no w, z, u or y"),
        ({"n_meas": 1, "n_con": 1, "starts": 0}, "starts is 0"),
        ({"n_meas": 1, "n_con": 1, "order": -1}, "order is -1"),
        ({"n_meas": 1, "n_con": 1, "structure": full_structure(0, 2, 1)}, "K must be 1 x 1"),
        ({"n_meas": 1, "n_con": 1, "hard_goals": [SensitivityGoal(limit=-1.0)]}, "limit -1.0"),
        ({"n_meas": 1, "n_con": 1, "hard_goals": [SensitivityGoal(channels=(3,))]}, "channels"),
    ],
)
def test_a_callers_mistake_is_a_value_error(arguments, message):
    with pytest.raises(ValueError, match=message):
        hinfstruct(roll(), **arguments)


def test_sample_times_must_agree_and_a_block_needs_its_port():
    sampled = Lti(A=[[0.5]], B=[[1.0, 1.0]], C=[[1.0], [1.0]], D=np.zeros((2, 2)), dt=0.01)
    with pytest.raises(ValueError, match="sample time"):
        hinfstruct(sampled, 1, 1, structure=full_structure(1, 1, 1))
    with pytest.raises(ValueError, match="P has the sample time"):
        hinfstruct([sampled, roll()], 1, 1)
    with pytest.raises(ValueError, match="block 'K' has the sample time"):
        Structure(blocks=(tunable_pid("K", input=0, output=0, cutoff=9.0),), n_meas=1, n_con=1, dt=0.01)
    with pytest.raises(ValueError, match="pole at z = -1"):
        hinfstruct(Lti(A=[[-1.0]], B=sampled.B, C=sampled.C, D=sampled.D, dt=0.01), 1, 1)
    with pytest.raises(ValueError, match="block 'K' has measurement 1"):
        Structure(blocks=(tunable_gain("K", inputs=(1,), outputs=(0,)),), n_meas=1, n_con=1)


@pytest.mark.parametrize("dt", [0.0, 0.02])
def test_tracking_and_rejection_are_lines_for_the_sensitivity(dt):
    G = ss(tf(2.0, [1.0, 1.0]))
    known = as_lti(sample_system(G, dt) if dt else G)
    # w drives u, z is u; u = K y is positive feedback of the negative output
    B, C = np.hstack([known.B, known.B]), np.vstack([0.0 * known.C, -known.C])
    P = Lti(A=known.A, B=B, C=C, D=[[0.0, 0.3], [0.0, 0.0]], dt=dt)
    tracking = SensitivityGoal(name="tracking", location=LoopLocation.OUTPUT, corner=4.0, lowest=0.01, limit=1.5)
    rejection = SensitivityGoal(name="rejection", corner=5.0, lowest=0.1)
    pid = Structure(n_meas=1, n_con=1, blocks=(tunable_pid("C", input=0, output=0, cutoff=50.0, dt=dt),), dt=dt)
    K = pid.controller(np.array([2.5, 2.5, 0.01]))
    if not dt:
        found = hinfstruct(P, 1, 1, structure=pid, starts=1, hard_goals=[tracking, rejection])
        K = as_lti(found.K)
        assert max(found.hard_goals.values()) <= 1.0
    omega = np.geomspace(1e-4, 0.99 * np.pi / dt if dt else 1e4, 400)
    S = np.abs(1.0 / (1.0 + known.response(omega) * K.response(omega)))[:, 0, 0]
    own = (bilinear_transform(P), bilinear_transform(K)) if dt else (P, K)
    for goal in (tracking, rejection):
        s, corner = (2.0 / dt * np.tan(0.5 * dt * each) if dt else each for each in (omega, goal.corner))
        line = np.abs((goal.limit * 1j * s + corner * goal.lowest) / (1j * s + corner))
        weighted, limit = extract_channel(goal, own[0], 1, 1, dt)
        assert hinf_norm(lft(weighted, own[1])).gain / limit == pytest.approx(np.max(S / line), rel=2e-3)
    with pytest.raises(ValueError, match="corner 4, lowest 3 and limit 2: the corner must be positive"):
        hinfstruct(P, 1, 1, structure=pid, starts=1, hard_goals=[SensitivityGoal(corner=4.0, lowest=3.0)])
