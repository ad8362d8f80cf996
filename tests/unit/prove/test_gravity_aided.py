"""Boxes of a law that reads tilt: the theorem sample by sample, its norms by another way, flown against, and forged."""

import json
import math
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.linalg

from firmware_model.config.scenario import AccelerometerFault, GyroFault, Scenario
from firmware_model.config.vehicle import load_vehicle, vehicle_path
from firmware_model.config.waveforms import MomentSquare
from gustproof.checker import gravity_aided_box, gravity_aided_norms, kernel_norms
from gustproof.checker.estimate_box import PEAK_RATE, EstimateCase
from gustproof.checker.evidence import check_certificate, seal
from gustproof.checker.gravity_aided_norms import ANGLE, LAG, LEAK, OFFSET, TURN
from gustproof.checker.kernel_norms import COMMAND, OMEGA, X0
from gustproof.checker.system import LoopSystem, Refusal, read_system
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import attitude
from gustproof.law.form import law_path, load_law
from gustproof.prove.boundedness import FlightCertificate, certify_boundedness

LAW_TEXT = law_path("aided").read_text(encoding="utf-8")
VEHICLE_TEXT = vehicle_path("paper").read_text(encoding="utf-8")
MOMENT = (0.65, 0.65, 0.3)
Numbers = np.ndarray[Any, np.dtype[np.float64]]


@pytest.fixture(scope="module")
def certificate() -> FlightCertificate:
    return certify_boundedness("aided", "paper", moment=MOMENT, horizon=None)


@pytest.fixture(scope="module")
def system() -> LoopSystem:
    return read_system(LAW_TEXT, VEHICLE_TEXT)


def judged(document: dict[str, Any], law: str = LAW_TEXT, vehicle: str = VEHICLE_TEXT) -> str:
    """Return the reason of the verdict on a document that is sealed anew."""
    rest = {key: value for key, value in document.items() if key != "seal"}
    verdict = check_certificate(json.dumps({**rest, "seal": seal(rest)}), law=law, vehicle=vehicle)
    assert not verdict.accepted
    return verdict.reason


def test_true_roll_and_pitch_stay_in_a_box_for_ever(certificate):
    assert certificate.proven
    assert certificate.certified_fraction == 1.0
    assert certificate.estimate_deg == pytest.approx((1.272098, 1.458632, 1.508150), abs=2e-6)
    roll, pitch, heading = certificate.truth_deg
    assert (roll, pitch) == pytest.approx((5.404229, 5.142217), abs=2e-6)
    assert max(roll, pitch) <= 5.5
    assert heading is None
    assert "the true roll and pitch stay within 5.405, 5.143 deg for ever, under a moment held" in certificate.statement
    assert "the true heading has no bound: an accelerometer does not observe it" in certificate.statement
    assert "accelerometer without bias and noise" in certificate.assumes["plant"]


def test_forgeries_of_the_box_are_refused(certificate):
    honest = certificate.to_dict()
    evidence = honest["evidence"]
    for axis, k in ((0, X0), (0, ANGLE), (1, ANGLE), (1, OFFSET), (0, TURN), (1, TURN), (2, LAG), (2, ANGLE)):
        box = [list(row) for row in evidence["box"]]
        box[axis][k] *= 0.999
        assert "does not close" in judged({**honest, "evidence": {**evidence, "box": box}})
    less = [row[:-1] for row in evidence["box"]]
    for changes, words in (
        ({"moment": [0.66, 0.65, 0.3]}, "does not close"),
        ({"moment_class": "any"}, "does not close"),
        ({"moment_class": "slope", "slope": [900.0, 0.0, 0.0]}, "does not close"),
        ({"box": less}, "does not bound every signal"),
        ({"samples": 2048}, "does not close"),
        ({"noise": 1e-9, "risk": 0.5}, "without noise"),
        ({"lag_spread": 0.1}, "without noise"),
    ):
        assert words in judged({**honest, "evidence": {**evidence, **changes}}), changes
    document = json.loads(LAW_TEXT)
    document["D"][0][6] = math.nextafter(document["D"][0][6], 0.0)
    assert "the law file is not the one" in judged(honest, law=json.dumps(document))


class Sample(NamedTuple):
    """One sample of a flight at random, all of it known."""

    box: list[list[Fraction]]
    """Bounds that its own moduli reach."""
    small: Numbers
    """(2,) [rad] what D holds beside the two sums by parts."""


def some_sample(rng: np.random.Generator) -> Sample:
    """Return a sample with rates, lag, offset and heading at random, integrated in 16 steps."""
    h, steps, size = 0.004, 16, rng.uniform(0.1, 1.0)
    start, X = size * rng.uniform(-0.1, 0.1, (2, 3))
    rate, slope = size * rng.uniform(-0.35, 0.35, 3), size * rng.uniform(-9.0, 9.0, 3)
    g, yaw = rate + size * rng.uniform(-0.05, 0.05, 3) * rng.integers(2), float(rng.uniform(-0.03, 0.03))
    e, E, turned, moved = kinematics(X, g) - g, start, np.zeros(3), np.zeros(3)
    for j in range(steps):
        omega = rate + slope * h * (j + 0.5) / steps
        speed = kinematics(E + 0.5 * h / steps * kinematics(E, omega), omega)
        E, turned, moved = E + h / steps * speed, turned + h / steps * omega, moved + h / steps * (speed - omega)
    X_after = X + E - start + h * size * rng.uniform(-0.05, 0.05, 3)
    step = -float(LEAK) * h * yaw + turned[2] + h * e[2]
    d = start - X
    common = np.array([[math.cos(step) - 1.0, math.sin(step)], [-math.sin(step), math.cos(step) - 1.0]]) @ d[:2]
    cosines = [math.cos((a[1] + b[1]) / 2.0) for a, b in ((start, X), (E, X_after))]
    flat = np.array([-math.log(cosines[1] / cosines[0]) * d[0], 0.0])
    box = np.zeros((3, 17))
    box[:, X0], box[:, X0 + 1], box[:, ANGLE] = np.abs(X), np.abs(g), np.abs([*start[:2], yaw])
    box[:, OFFSET], box[:, LAG] = np.abs(d), np.abs(turned / h - g)
    box[:2, TURN] = np.abs((E - X_after - d)[:2] - common) / h
    box[:, -1] = np.maximum(np.abs(rate), np.abs(rate + h * slope))
    exact = [[Fraction(value) for value in row] for row in box.tolist()]
    return Sample(exact, (moved - h * e)[:2] - common - flat)


def kinematics(E: Numbers, omega: Numbers) -> Numbers:
    sine, cosine = math.sin(E[0]), math.cos(E[0])
    turn = (sine * omega[1] + cosine * omega[2]) / math.cos(E[1])
    return np.array([omega[0] + math.sin(E[1]) * turn, cosine * omega[1] - sine * omega[2], turn])


def test_what_no_sum_by_parts_holds_is_small_in_every_sample(system):
    """The theorem's splitting of D, sample by sample, each against the bound of its own moduli."""
    rng, shares = np.random.default_rng(3), []
    for _ in range(150):
        box, small = some_sample(rng)
        e = gravity_aided_box.excess([row[X0] for row in box], [row[X0 + 1] for row in box])
        bounds = gravity_aided_box._small_terms(system, box, gravity_aided_box._bound_motion(system, box, e))
        shares.append(np.abs(small) / np.array(bounds[:2], dtype=float))
    assert np.max(shares) <= 1.0
    assert np.all(np.max(shares, axis=0) >= 0.7)


FIGURES = [
    [
        0.05340094869,
        0.3121211174,
        0.004604836917,
        0.04838116676,
        0.04430923506,
        0.006977315318,
        0.01031606714,
        0.0544042592,
    ],
    [
        0.06368598804,
        0.3196857221,
        0.005217066657,
        0.0471465619,
        0.0424739379,
        0.007543299731,
        0.01197543254,
        0.06494150409,
    ],
    [
        0.1088292641,
        0.3298869838,
        0.009952972164,
        0.01003218986,
        0.0003045026635,
        0.006508293936,
        0.01852669288,
        0.1113415933,
    ],
    [
        0.05393737001,
        0.3121422179,
        0.004711157148,
        0.05726922738,
        0.05309097557,
        0.008013300958,
        0.01122218175,
        0.05494068052,
    ],
    [
        0.06435651033,
        0.319706845,
        0.005345833114,
        0.05825593082,
        0.0534545405,
        0.008838294364,
        0.01310807588,
        0.06561202638,
    ],
    [
        0.1088292641,
        0.3298869838,
        0.009952972164,
        0.03003218989,
        0.02030450269,
        0.009008293938,
        0.01977669288,
        0.1113415933,
    ],
    [
        0.05362982179,
        0.3121301203,
        0.004650200215,
        0.05217340596,
        0.04805611101,
        0.007419335858,
        0.01070267604,
        0.05463313229,
    ],
    [
        0.06404359993,
        0.3196969877,
        0.005285742101,
        0.05307155866,
        0.04833025929,
        0.008233963535,
        0.01257950899,
        0.06529911598,
    ],
    [
        0.1088292641,
        0.3298869838,
        0.009952972164,
        0.02283218988,
        0.01310450268,
        0.008108293937,
        0.01932669288,
        0.1113415933,
    ],
    [0.008328216825, 0.01175627503],
]
"""By class and axis: rate, command, own angle, angle, offset, its change, lag, rate between samples; then truth."""


def mapped(system: LoopSystem, patch: pytest.MonkeyPatch) -> list[list[float]]:
    """Return what follows of a box of round numbers, of each class of moment, under a coarse tilt."""
    patch.setattr(gravity_aided_box, "_TILT", Fraction(1, 64))
    box = [[Fraction(7 + 5 * i + (3 + i) * k, 4096) for k in range(17)] for i in range(3)]
    norms, moment = (
        [gravity_aided_norms.gravity_aided_norms(system, axis, 32_768) for axis in range(3)],
        [Fraction(1, 8)] * 3,
    )
    found = []
    for free, slope in ((False, (0, 0, 0)), (True, (0, 0, 0)), (False, (40, 50, 60))):
        case = EstimateCase(moment, Fraction(0), Fraction(0), free, tuple(map(Fraction, slope)))
        follows = gravity_aided_box.map_gravity_aided_box(system, norms, case, box)
        found += [[float(row[k]) for k in (0, COMMAND, X0, ANGLE, OFFSET, TURN, LAG, PEAK_RATE)] for row in follows]
    return [*found, [float(angle) for angle in gravity_aided_box.gravity_aided_truth(system, box)]]


def test_every_term_of_the_theorem_stands(system, monkeypatch):
    """Figures pinned: a term left out, or another factor, moves one of them."""
    for found, pinned in zip(mapped(system, monkeypatch), FIGURES, strict=True):
        assert found == pytest.approx(pinned, rel=1e-7)


ROUGH = [
    [36296.66154, -50.21107226, 326.5309130, 717.7999860, 49.31318995],
    [36065.71686, -53.30943805, 321.1042709, 724.1860325, 71.18375328],
    [3487.046196, -308.2145632, 125.4553563, 470.6528188, -2.137134029],
]
"""By axis, of all norms above 0: logarithms, weighted by their places, of entries, excess, gyro, sums and changes."""


def roughly(system: LoopSystem, patch: pytest.MonkeyPatch) -> list[list[float]]:
    """Return norms from few samples, in blocks, with roundings so coarse that each is felt in each norm."""
    patch.setattr(gravity_aided_norms, "_BLOCK", 100)
    patch.setattr(gravity_aided_norms, "_ULP", 2.0**-36)
    patch.setattr(gravity_aided_norms, "UP", 1.0 + 2.0**-20)
    patch.setattr(gravity_aided_norms, "_SPARE", 1.0)
    patch.setattr(kernel_norms, "_ULP", 2.0**-36)
    found = []
    for axis in range(3):
        norms = gravity_aided_norms.gravity_aided_norms.__wrapped__(system, axis, 250)
        own = norms.axis
        parts = own.entries[0], own.excess[0], own.gyro[0], norms.sums, norms.changes
        found.append([float(np.sum(np.log(part[part > 0]) * (1 + np.flatnonzero(part)))) for part in parts])
        (inertia, d_inertia), (lag, d_lag) = own.inverse_inertia[0], own.inverse_lag[0]
        assert (inertia, lag) == (1.0 / float(system.inertia[axis]), 1.0 / float(system.lag))
        assert (d_inertia, d_lag) == (2.0**-33 * inertia, 2.0**-33 * lag)
        assert not own.noise.any()
        assert own.demand_gyro == 0.0
    return found


def test_every_rounding_of_the_norms_counts(system, monkeypatch):
    """Figures pinned, as those of the theorem: of sums, of what is left after them, and of the modes."""
    for found, pinned in zip(roughly(system, monkeypatch), ROUGH, strict=True):
        assert found == pytest.approx(pinned, rel=5e-8)


def modes(system: LoopSystem, axis: int) -> tuple[Numbers, Numbers, Numbers]:
    """Return Phi of an axis by another way, columns of the excess and the angle, and the row of the offset."""
    vehicle = load_vehicle("paper")
    h, n = float(system.dt), len(system.A) // 3
    own = slice(axis, 3 * n, 3)
    generator = np.zeros((4, 4))  # angle, rate, torque, command
    generator[0, 1] = 1.0
    generator[1, 1:3] = -vehicle.rate_damping_B[axis], 1.0 / vehicle.inertia_B[axis]
    generator[2, 2:] = np.array([-1.0, 1.0]) / vehicle.actuator_lag
    plant = scipy.linalg.expm(h * generator)
    A, B, C, D, G = (np.array(M, dtype=float) for M in (system.A, system.B, system.C, system.D, system.G))
    Phi = np.zeros((n + 4, n + 4))  # rate, torque, command, law, angle
    order = [n + 3, 0, 1, 2]
    for i, row in enumerate(plant[:3]):
        Phi[order[i], order] = row
    Phi[COMMAND, OMEGA], Phi[COMMAND, 3:-1] = D[axis, axis], C[axis, own]
    Phi[3:-1, OMEGA], Phi[3:-1, 3:-1] = B[own, axis], A[own, own]
    Phi[3:-1, 4] += G[own, axis]
    column = np.zeros((n + 4, 2))
    column[3:-1, 0], column[-1, 0], column[-1, 1] = G[own, axis], h, 1.0
    if axis == 2:
        Phi[-1, -1] -= h * float(LEAK)
    else:
        tilt_B, tilt_D = (np.array(M, dtype=float) for M in system.tilt)
        Phi[COMMAND, -1], Phi[3:-1, -1] = tilt_D[axis, axis], tilt_B[own, axis]
    return Phi, column, np.eye(n + 4)[-1] - np.eye(n + 4)[X0]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_norms_are_the_sums_over_all_time_and_not_by_far(system, axis):
    """Modes of another loop, summed over ten minutes."""
    Phi, column, offset = modes(system, axis)
    found = gravity_aided_norms.gravity_aided_norms(system, axis, 32_768)
    poles, T = np.linalg.eig(Phi)
    weights = np.linalg.solve(T, column.astype(complex))
    powers = poles[None] ** np.arange(150_000 if axis == 0 else 40_000)[:, None]
    m = len(Phi)
    for row, k in ((np.eye(m)[-1], m - 1), (offset, m)):
        both, angle = ((powers * (row @ T * weights[:, j])).sum(axis=1).real for j in (0, 1))
        for sums, bound in (
            (np.sum(np.abs(both)), found.axis.excess[0, k]),
            (np.sum(np.abs(angle)), found.sums[k]),
            (abs(angle[0]) + np.sum(np.abs(np.diff(angle))), found.changes[k]),
        ):
            assert sums <= bound
            assert axis == 1 or bound <= 1.03 * sums  # those of pitch are summed over a shorter time


def equal_roundings(whole: float, Phi: Numbers, _: Numbers) -> Numbers:
    return np.full((1, len(Phi[0])), whole / len(Phi[0]))


def test_a_loop_without_bound_or_with_modes_that_coincide_is_refused(system, monkeypatch):
    def of(**changes: Any) -> LoopSystem:
        return system._replace(**changes)

    turned = tuple(tuple(-value for value in row) for row in system.tilt.B)
    for changes, words in (
        ({"tilt": system.tilt._replace(B=turned)}, "the loop is unstable"),
        ({"D": tuple(tuple(-9 * value for value in row) for row in system.D)}, "the loop is unstable"),
        ({"tilt": None}, "reads no tilt"),
    ):
        with pytest.raises(Refusal, match=words):
            gravity_aided_norms.gravity_aided_norms(of(**changes), 0, 2048)
    with pytest.raises(Refusal, match="must be 1 to 65536"):
        gravity_aided_norms.gravity_aided_norms(system, 0, 65_537)
    for whole in (0.401, 0.7, 101.0):  # what a hundred samples and the first add up
        monkeypatch.setattr(gravity_aided_norms, "unit_roundings", partial(equal_roundings, whole / 101))
        with pytest.raises(Refusal, match="rounding spoils the norms"):
            gravity_aided_norms.gravity_aided_norms.__wrapped__(system, 0, 100)
    monkeypatch.undo()
    for basis in (np.ones((2, 2)), *(np.array([[1.0, 1.0], [1.0, 1.0 + gap]]) for gap in (1e-14, 7e-13))):  # coincide
        monkeypatch.setattr(np.linalg, "eig", lambda _, found=basis: (None, found))
        with pytest.raises(Refusal, match="modes are not separated"):
            gravity_aided_norms._settle(np.eye(2) / 2, np.ones((2, 1)), np.ones((2, 1)), np.zeros(2))
    monkeypatch.undo()
    monkeypatch.setattr(np.linalg, "inv", lambda _: np.diag([0.9, 0.8]))  # wrong by a fifth, which is added
    monkeypatch.setattr(np.linalg, "eig", lambda _: (None, np.eye(2)))
    found = gravity_aided_norms._settle(
        np.array([[0.3, 0.2], [0.0, 0.1]]), np.ones((2, 1)), np.ones((2, 1)), np.zeros(2)
    )
    assert found.sums == pytest.approx(np.array([[1.3608], [0.8576]]) / 0.50024, rel=1e-5)
    monkeypatch.undo()
    for pole in (1.0, 1.5):
        with pytest.raises(Refusal, match="the loop is unstable"):
            gravity_aided_norms._settle(np.diag([0.5, pole]), np.ones((2, 1)), np.ones((2, 1)), np.zeros(2))


def test_forms_of_a_law_that_no_proof_is_about_are_refused_by_name():
    law = json.loads(LAW_TEXT)

    def changed(name: str, *path: Any, value: Any) -> dict[str, Any]:
        document = json.loads(LAW_TEXT)
        inner = document[name]
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value
        return document

    for document, words in (
        (changed("B", 14, 7, value=1e-9), "couples its axes"),  # a state of roll that reads pitch
        (changed("D", 0, 7, value=1e-9), "couples its axes"),
        (changed("C", 1, 14, value=1e-9), "couples its axes"),
        (changed("A", 14, 1, value=1e-9), "couples its axes"),
        (changed("rate_limit", "T", 0, 6, value=1e-9), "commands rates from tilt as measured"),
        ({**law, "output": "rates"}, "reads the accelerometer and commands rates"),
        ({**law, "G": [[0.0] * 3] * 16}, "reads the accelerometer and has no kinematics"),
    ):
        with pytest.raises(Refusal, match=words):
            read_system(json.dumps(document), VEHICLE_TEXT)
    for span, kept in ((9.9, False), (10.0, True)):
        text = VEHICLE_TEXT.replace("range = 156.9", f"range = {span}")
        assert text != VEHICLE_TEXT
        if kept:
            assert read_system(LAW_TEXT, text).tilt is not None
        else:
            with pytest.raises(Refusal, match="range is below gravity"):
                read_system(LAW_TEXT, text)


def test_states_are_in_turn_by_axis_and_the_loop_is_the_same(system):
    law = load_law("aided")
    assert len(system.A) == 18
    A, B, C, tilt = (np.array(M, dtype=float) for M in (system.A, system.B, system.C, system.tilt.B))
    kept = [i for i in range(18) if i not in (14, 17)]
    assert np.array_equal(A[np.ix_(kept, kept)], law.A)
    assert np.array_equal(B[kept], law.B[:, :3])
    assert np.array_equal(C[:, kept], law.C)
    assert np.array_equal(tilt[kept], law.B[:, 6:])
    limit = np.array(system.rate_limit.S, dtype=float)
    assert np.array_equal(limit[:, kept], law.rate_limit.S)
    for matrix in (A[[14, 17]], A[:, [14, 17]].T, B[[14, 17]], C[:, [14, 17]].T, limit[:, [14, 17]].T):
        assert not matrix.any()


def test_flights_stay_in_the_box_and_reach_most_of_the_laws_own(certificate):
    """The simulator's own accelerometer closes the loop; the true angles reach a quarter of their bound."""
    box, reached = np.array(certificate.evidence["box"]), np.zeros((3, 3))
    calm = Scenario(
        name="square",
        description="moments that turn",
        duration_s=6.0,
        gyro=GyroFault(noise=False),
        accelerometer=AccelerometerFault(noise=False),
    )
    for rate in (0.8, 1.5, 3.0, 4.5, 6.5, 9.0):
        moment = tuple(
            MomentSquare(kind="square", amplitude_nm=tuple((np.array(MOMENT) * axis).tolist()), rate_rad_s=rate)
            for axis in np.eye(3)
        )
        records = fly_direct(replace(calm, moment=moment), load_law("aided"), vehicle=load_vehicle("paper"))
        signals = attitude(records), records["omega_B"], records["torque_command_B"]
        reached = np.maximum(reached, [np.max(np.abs(signal), axis=0) for signal in signals])
    truth = np.radians(certificate.truth_deg[:2])
    assert np.all(reached[0][:2] <= truth)
    assert np.all(reached[0][:2] >= 0.2 * truth)
    assert np.all(reached[1:] <= box[:, [PEAK_RATE, COMMAND]].T)
    assert np.all(reached[1:] >= 0.6 * box[:, [PEAK_RATE, COMMAND]].T)
