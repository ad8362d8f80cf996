"""Certified gains where parameters are slow: what speed buys, the paper's loop, and evidence that bears no change."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.rotational import Envelope
from gustproof.checker.evidence import check_certificate as check
from gustproof.checker.evidence import seal
from gustproof.design.designs import design_problem, load_design
from gustproof.prove.attitude_gain import attitude_loop, attitude_speeds, envelope_speeds
from gustproof.robust.gain.certificate import Certificate
from gustproof.robust.gain.lft_gain import certify_lft, derived_loop
from gustproof.robust.gain.symmetry import mirror_group
from gustproof.robust.gain.worst_schedule import worst_schedule, worst_triangle_schedule
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.uncertain.elements import ureal
from gustproof.robust.uncertain.uncertain_system import Uncertain, append, system_from_matrix

GOLDEN = Path(__file__).parents[2] / "golden" / "slow_gain_d2.json"


def spring(spread: float = 0.9) -> Uncertain:
    """Return `x'' + .2 x' + (1 + spread delta) x = w`, z = x: each frozen member is stable, switching destabilises."""
    stiffness = ureal("stiffness", range=(1.0 - spread, 1.0 + spread))
    force = np.array([[0.0], [1.0], [0.0]]) @ stiffness @ np.array([[-1.0, 0.0, 0.0]])
    return system_from_matrix(force + np.array([[0.0, 1.0, 0.0], [0.0, -0.2, 1.0], [1.0, 0.0, 0.0]]), 2)


def frozen(loop: Uncertain, delta: float) -> float:
    system = loop.member({"stiffness": delta})
    responses = system.response(np.linspace(1e-3, 3.0, 4000))
    return float(np.max(np.abs(responses)))


@pytest.fixture(scope="module")
def certificate() -> Certificate:
    return certify_lft(spring(), assumes={}, speeds={"stiffness": 1e-3})


@pytest.mark.slow
def test_a_slow_spring_has_a_bound_where_a_fast_one_has_none(certificate):
    assert not certify_lft(spring(), assumes={}).proven
    assert worst_schedule(spring()).gain > 1e3  # it is unstable: no proof could be had
    assert certificate.proven
    assert check(json.dumps(certificate.to_dict())).accepted
    softest = frozen(spring(), -1.0)
    assert softest * 0.9 < certificate.lower_bound <= certificate.gain
    assert softest <= certificate.gain


@pytest.fixture(scope="module")
def faster() -> Certificate:
    return certify_lft(spring(), assumes={}, speeds={"stiffness": 0.01})


@pytest.mark.slow
def test_the_bound_grows_with_the_speed_until_there_is_none(certificate, faster):
    assert faster.proven
    assert faster.gain > certificate.gain
    assert not certify_lft(spring(), assumes={}, speeds={"stiffness": 10.0}).proven


@pytest.mark.slow
def test_no_simulation_of_ten_thousand_exceeds_the_bound(faster):
    """The stiffness ramps up and down as fast as it may, w follows the resonance or not; 80 s, energy left unspent."""
    rng, runs, dt = np.random.default_rng(5), 10_000, 0.04
    delta = np.where(rng.random(runs) < 0.5, -1.0, rng.uniform(-1.0, 1.0, runs))
    direction, turning = rng.choice([-1.0, 0.0, 1.0], runs), rng.uniform(0.0, 0.05, runs)
    off, phase = rng.normal(0.0, 0.05, runs) * rng.integers(2, size=runs), rng.uniform(0.0, 6.3, runs)
    x, v, sums = np.zeros(runs), np.zeros(runs), np.zeros((2, runs))
    for _ in range(2000):
        direction = np.where(rng.random(runs) < turning * dt, -direction, direction)
        delta = np.clip(delta + 0.01 * direction * dt, -1.0, 1.0)
        stiffness = 1.0 + 0.9 * delta
        phase += (np.sqrt(stiffness) + off) * dt
        w = np.cos(phase)
        middle = x + 0.5 * dt * v  # leapfrog, the damping taken at the middle
        v = ((1.0 - 0.1 * dt) * v + dt * (w - stiffness * middle)) / (1.0 + 0.1 * dt)
        x = middle + 0.5 * dt * v
        sums += middle**2, w**2
    gains = np.sqrt(sums[0] / sums[1])
    assert 0.7 * faster.gain < np.max(gains) <= faster.gain


@pytest.mark.slow
def test_one_changed_bit_anywhere_is_refused(certificate, leaves, changed):
    document = certificate.to_dict()
    paths = [path for path, _ in leaves(document)]
    assert len(paths) > 40
    for path in paths:
        assert not check(json.dumps(changed(document, path))).accepted, path


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        (("evidence", "level"), 4.0, "inequality does not hold at the corner"),
        (("evidence", "level"), -4.0, "not positive"),
        (("evidence", "blocks", 0, "speed"), 0.5, "inequality does not hold at the corner"),
        (("evidence", "blocks", 0, "speed"), -1e-3, "speed is negative"),
        (("evidence", "system", "A", 1, 0), -0.5, "inequality does not hold at the corner"),
        (("evidence", "P", 0), [[-1.0, 0.0], [0.0, -1.0]], "P is not positive definite at the corner"),
        (("evidence", "P"), [[[1.0, 0.0], [0.0, 1.0]]], "malformed"),
        (("evidence", "Y"), [[0.0] * 4], "inequality does not hold at the corner"),
        (("evidence", "vertices", 1, 0, "D"), [[-1.0]], "not positive definite"),
        (("evidence", "vertices", 1, 0, "G"), [[0.1]], "not skew"),
        (("evidence", "vertices"), [], "malformed"),
    ],
)
def test_a_false_proof_is_refused_even_with_a_new_seal(certificate, path, value, reason, changed):
    document = changed(certificate.to_dict(), path, value)
    del document["seal"]
    verdict = check(json.dumps({**document, "seal": seal(document)}))
    assert not verdict.accepted
    assert reason in verdict.reason


def test_a_proof_for_every_corner_is_asked_for(certificate):
    document = certificate.to_dict()
    document["evidence"]["vertices"] = document["evidence"]["vertices"][:2]
    del document["seal"]
    assert not check(json.dumps({**document, "seal": seal(document)})).accepted


def test_a_loop_that_is_unstable_at_rest_has_no_multipliers():
    unstable = system_from_matrix(np.diag([1.0, 1.0]) @ append(ureal("rate", range=(0.5, 1.5)), 1.0), 1)
    with pytest.raises(ValueError, match="continuous and stable"):
        certify_lft(unstable, assumes={}, speeds={"rate": 1.0})


@pytest.mark.parametrize(
    ("speeds", "message"), [({"stifness": 1.0}, "speeds name 'stifness'"), ({}, "must be one a block, not all None")]
)
def test_speeds_are_of_parameters_of_the_loop(speeds, message):
    with pytest.raises(ValueError, match=message):
        certify_lft(spring(), assumes={}, speeds=speeds)


def paper_loop() -> Uncertain:
    problem = design_problem(load_design("D2"), load_vehicle("paper"))
    controller = hinfsyn(problem.plant(), 3, 3, gamma=0.25).lti
    return attitude_loop(problem, controller, Envelope(angle=0.1, rate=0.5), scheduled=False)


@pytest.mark.slow
def test_the_papers_law_gains_a_quarter_from_what_the_kinematics_allow_roll_and_pitch():
    """The certificate was found once (`gustproof certify gain hinf-d2 ... --slow`); here it is judged and compared."""
    loop, evidence = paper_loop(), json.loads(GOLDEN.read_text())["evidence"]
    verdict = check(GOLDEN.read_text(), loop=derived_loop(loop, envelope_speeds(0.1, 0.5, leak=0.05)))
    assert verdict.accepted
    assert 1.99 <= verdict.figures["gain"] <= 2.0  # 2.604 with a constant matrix, arbitrarily fast
    faster = check(GOLDEN.read_text(), loop=derived_loop(loop, None))
    assert "t of the derived loop is faster than the evidence allows" in faster.reason
    edge = math.tan(0.05)
    speeds = [turn * (1.0 + edge**2) / (2.0 * edge) for turn in attitude_speeds(0.1, 0.5, leak=0.05)]
    told = {block["name"]: block["speed"] for block in evidence["blocks"]}
    assert told == {"t": pytest.approx(speeds[0]), "v": pytest.approx(speeds[1]), "r": None, "q": None}
    assert (
        worst_triangle_schedule(loop, list(told.values()), duration=20.0).gain <= 1.01 * 1.1509280560232018
    )  # as found then


def test_the_attitude_turns_no_faster_than_its_bound():
    rng = np.random.default_rng(3)
    phi, theta = rng.uniform(-0.3, 0.3, (2, 20_000))
    p, q, r = rng.uniform(-0.5, 0.5, (3, 20_000))
    turn = np.sin(phi) * q + np.cos(phi) * r
    of_phi, of_theta = attitude_speeds(0.3, 0.5, leak=0.05)
    assert np.max(np.abs(p + np.tan(theta) * turn - 0.05 * phi)) <= of_phi
    assert np.max(np.abs(np.cos(phi) * q - np.sin(phi) * r - 0.05 * theta)) <= of_theta


def test_the_mirrors_of_a_loop_leave_it_as_it_is():
    loop = paper_loop()
    group = mirror_group(loop)
    assert {mirror.delta for mirror in group} == {
        (1, 1, 1, 1),
        (-1, 1, -1, 1),
    }  # left for right: roll and yaw rate turn
    for mirror in group:
        turned = loop.member({block.name: 0.5 * sign for block, sign in zip(loop.blocks, mirror.delta, strict=True)})
        held = loop.member({block.name: 0.5 for block in loop.blocks})
        np.testing.assert_allclose(turned.A * np.outer(mirror.x, mirror.x), held.A, atol=1e-8)
        np.testing.assert_allclose(turned.B * np.outer(mirror.x, mirror.w), held.B, atol=1e-8)


def test_parts_that_do_not_meet_are_mirrored_apart():
    assert len(mirror_group(append(spring(), 1.0))) == 4
