"""Edges of the proof about a flight: each limit may be reached and not passed, and what has no bound is refused."""

import json
import math
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest

from gustproof.checker import (
    attitude_offset,
    dissipation,
    estimate_box,
    evidence,
    flight_box,
    gaussian_loop,
    gravity_aided_box,
    gravity_aided_norms,
    kernel_norms,
    quadratic_constraints,
    rational,
    single_precision,
    system,
    truth_drift,
)
from gustproof.checker.estimate_box import EstimateCase
from gustproof.checker.flight_box import FlightClaim
from gustproof.checker.kernel_norms import axis_norms
from gustproof.checker.single_precision import Form
from gustproof.checker.system import LoopSystem, Refusal, read_system
from gustproof.checker.truth_drift import Disturbance

STEP = 0.125


SAMPLES = {"torque": (480, 320, 352), "rates": (256, 288, 288)}
"""Simulated samples by axis: just enough, so that the tail counts."""


def law_document(output: str = "torque") -> dict[str, Any]:
    """Return a strapdown law of nine states; its samples are so long that every term of the theorems is felt."""
    A, B, C, D, G = (np.zeros(shape) for shape in ((9, 9), (9, 6), (3, 9), (3, 6), (9, 3)))
    S, T = np.zeros((3, 9)), np.zeros((3, 6))
    for i, gain in enumerate((0.5, 0.375, 0.4375)):
        A[i, i], A[i, 3 + i], B[i, i], G[i, i] = 1.0, -STEP / 2, STEP / 2, STEP
        B[3 + i, i] = 1.0
        A[6 + i, [i, 3 + i, 6 + i]], B[6 + i, i], G[6 + i, i] = (0.125, -0.0625, 0.5), 0.25, 0.03125
        C[i, [i, 3 + i, 6 + i]], D[i, i] = (-gain, -0.25 * gain, 0.125 * gain), -0.5 * gain
        S[i, [i, 3 + i, 6 + i]], T[i, i] = (-0.75, 0.25, 0.0625), 0.375 + 0.125 * i
    limit = {"S": S.tolist(), "T": T.tolist(), "limits": [3.0, 2.5, 2.0]}
    matrices = {name: M.tolist() for name, M in zip("ABCDG", (A, B, C, D, G), strict=True)}
    limits = {"limits": [4.0, 3.0, 2.0], "rate_limit": limit, "provenance": {"vehicle": "paper"}}
    return {"format": system.LAW_FORMAT, "name": "round", "output": output, "dt": STEP, **matrices, **limits}


VEHICLE = """
inertia_B = [2.0, {nominal = 1.5, low = 1.0, high = 2.0}, 1.0]
rate_damping = 0.25
actuator_lag = 0.25
torque_limit = [3.5, 3.25, 3.0]
heave_drag = 1.5
gust_gain = 0.0625
[gyro]
range = 30.0
[rotors]
position_B = [[0.25, 0.5, -0.125], [-0.25, -0.5, -0.125], [0.25, -0.5, -0.125], [-0.25, 0.5, -0.125]]
[stabilizer]
rate_p = [1.0, 1.25, 0.75]
rate_i = [0.5, 0.375, 0.25]
rate_d = [0.125, 0.0625, 0.1875]
derivative_cutoff = 0.5
"""


def loop(output: str = "torque", **changes: Any) -> LoopSystem:
    found = read_system(json.dumps(law_document(output)), VEHICLE)
    damping = (Fraction(1, 4), Fraction(1, 2), Fraction(3, 8))
    return found._replace(**{"damping": damping, **changes})


CASE = EstimateCase([Fraction(1, 8), Fraction(1, 16), Fraction(3, 32)], Fraction(1, 64), Fraction(9, 2))


QUIET = EstimateCase(CASE.moment, Fraction(0), Fraction(0))


def some_box(width: int) -> list[list[Fraction]]:
    """Return a box in which no two bounds are alike."""
    return [[Fraction(7 + 5 * i + (3 + i) * k, 256) for k in range(width)] for i in range(3)]


def some_claim(**changes: Any) -> FlightClaim:
    evidence = {
        "kind": flight_box.KIND,
        "law_sha256": "",
        "vehicle_sha256": "",
        "moment": [0.25, 0.125, 0.1875],
        "part": 0.5,
        "moment_class": "slope",
        "slope": [0.5, 0.0, 0.75],
        "horizon": 30.05,
        "noise": 2.0**-10,
        "risk": 0.0078125,
        "inertia_spread": 0.125,
        "lag_spread": 0.0625,
        "cells": [2, 3],
        "samples": 448,
        "box": [[float(value) / 16 for value in row] for row in some_box(10)],
    }
    return flight_box.read_claim({**evidence, **changes})


def weighed(form: dissipation.Ball) -> list[list[Fraction]]:
    """Return a number for each row of middle and radius, which any of its entries moves."""
    return [[sum(((j + 1) * value for j, value in enumerate(row)), Fraction(0)) for row in half] for half in form]


@pytest.mark.parametrize(
    ("module", "values"),
    [
        (kernel_norms, {"UP": 1 + 2**-40, "_ULP": 2**-52, "_MOST_LEFT": 1e-3, "_DIVERGED": 1e30}),
        (kernel_norms, {"LONGEST": 65536, "MOST_CELLS": 64, "_MOST_WORK": 4194304}),
        (estimate_box, {"COMMAND_SHARE": Fraction(999, 1000), "_FLOAT32": 2.0**-22, "_DOUBLE": 2.0**-46}),
        (estimate_box, {"_TINY": 2.0**-140}),
        (flight_box, {"RISK_PERIOD": 600, "LEAST_RISK": Fraction(1, 10**12), "LONGEST": 1000000}),
        (system, {"_MOST_STATES": 48, "_GRAVITY_AIDED": 8, "_GRAVITY": 10}),
        (gravity_aided_box, {"_TILT": 2.0**-22, "LEAK": 0.0625}),
        (gravity_aided_norms, {"_ULP": 2**-52, "_DIVERGED": 1e30, "_SPARE": 1e-6, "_BLOCK": 1024}),
        (truth_drift, {"_CHUNKS": 32, "_LARGEST": 1, "_ROUNDS": 200, "_ROUNDING": 2.0**-44}),
        (quadratic_constraints, {"LEAD": Fraction(707, 5000), "LAG": Fraction(257, 400)}),
        (gaussian_loop, {"_EPS": 2.0**-44, "_MOST_ORDER": 30, "_CHUNKS": 240, "_FAR": 12}),
        (evidence, {"ROUNDING": Fraction(1, 1 << 40), "FORMAT": "gustproof-certificate-1"}),
        (attitude_offset, {"_MOST_LEFT": 1e-3, "_SPARE": 1e-6, "_ULP": 2**-52}),
        (single_precision, {"_U": 2.0**-24, "_EXACT": 2.0**-35, "_FINE": 2.0**-12, "_TINY": 2.0**-110}),
        (single_precision, {"_KINEMATICS": (14, 7, 13), "_ROUNDS": 100, "_WIDER": Fraction(51, 50), "_SMALL": 0.75}),
    ],
)
def test_a_constant_is_that_of_the_proofs_text(module, values):
    """Each covers more than it must, so that no flight shows a smaller one: its value stands here a second time."""
    assert {name: getattr(module, name) for name in values} == values


def test_a_series_has_as_many_terms_as_it_says():
    for x in (Fraction(1), Fraction(7, 2)):
        term, total = Fraction(1), Fraction(1)
        for k in range(1, 200):
            term *= x / k
            total += term
        assert rational.exp_lower_bound(x) == total
    above = rational.exp_lower_bound(Fraction(1, 16)) - gaussian_loop._ROOT
    assert 0 <= above < Fraction(1, 1 << 96)


def test_tails_are_known_beyond_one_deviation():
    assert gaussian_loop._tail(Fraction(1, 2), Fraction(1)) == gaussian_loop._tail(Fraction(2), Fraction(2)) == 1
    for z in (Fraction(5, 4), Fraction(3, 2), Fraction(2)):  # 8 z^2 is whole, but for the first
        sixteenths = math.floor(8 * z * z)
        below = Fraction(math.isqrt(sixteenths << 29), 1 << 16)
        exact = Fraction(4, 5) / (below * gaussian_loop._ROOT**sixteenths)
        assert gaussian_loop._tail(z, Fraction(1)) == rational.round_up(exact, 128)


def float_tail(z: float) -> float:
    return 0.8 * math.exp(-0.5 * z * z) / z


def test_a_least_angle_is_found_by_halves_and_each_end_counts(monkeypatch):
    one = [Fraction(1)]
    with monkeypatch.context() as patch:
        patch.setattr(gaussian_loop, "_tail", lambda *_: Fraction(0))
        assert gaussian_loop.least_angle(one, 1, Fraction(float_tail(6.0))) == 6
        step = 12.0 / 2**15  # a ten thousandth of the bound: the search ends
        assert gaussian_loop.least_angle(one, 1, Fraction(float_tail(9999.25 * step))) == Fraction(10_000 * step)
        found = float(gaussian_loop.least_angle(one, 50, Fraction(1, 1000)))
        assert 50 * float_tail(found) <= 1e-3 < 50 * float_tail(found * (1.0 - 1e-4))
    with monkeypatch.context() as patch:
        patch.setattr(gaussian_loop, "_tail", lambda *_: Fraction(1, 100))
        assert gaussian_loop.least_angle(one, 2, Fraction(1, 50)) < 12
        with pytest.raises(Refusal, match="no bound of the air is known"):
            gaussian_loop.least_angle(one, 2, Fraction(1, 51))
    narrow, wide = (gaussian_loop.least_angle([sigma], 1, Fraction(1, 1000)) for sigma in (Fraction(1), Fraction(10)))
    assert wide == pytest.approx(10 * narrow, rel=2e-3)


def test_definiteness_of_small_and_odd_matrices():
    one, two = Fraction(1), Fraction(2)
    assert rational.is_positive_definite([])
    assert rational.is_positive_definite([[one / 3]])
    assert rational.is_positive_definite([[one, one], [one, two]])
    assert not rational.is_positive_definite([[Fraction(0)]])
    assert not rational.is_symmetric([[one, two]])
    assert not rational.is_symmetric([[one], [one]])
    eps = Fraction(1, 10**40)  # less than a double tells
    for least in (eps, Fraction(0), -eps):
        row = [one, two, two + least]
        assert rational.is_positive_definite([[one, one, one], [one, two, two], row]) is (least > 0)
    assert rational.multiply([], []) == []
    for A, B in (([[one, two]], [[one]]), ([[one, two]], [[one], [one, two]])):
        with pytest.raises(ValueError, match="zip"):
            rational.multiply(A, B)
    for rows in ([[[one]], [[one, two]]], [[[one]], [[one], [two]]]):
        with pytest.raises(ValueError, match="zip"):
            rational.add(*rows)
    with pytest.raises(ValueError, match="zip"):
        rational.transpose([[one, two], [one]])
    with pytest.raises(ValueError, match="zip"):
        rational.inverse([[one, two], [one]])
    with pytest.raises(ValueError, match="not finite"):
        rational.to_rational([[1.0, float("nan")]])
    for bound in (rational.sin_upper_bound, rational.cos_lower_bound):
        with pytest.raises(ValueError, match="must be in"):
            bound(Fraction(-1, 10**9))
    assert rational.multiply([[]], []) == [[]]
    with pytest.raises(ValueError, match="different lengths"):
        rational.to_rational([[1.0, 2.0], [1.0]])


def plain_norms(of: LoopSystem) -> list[kernel_norms.AxisNorms]:
    return [axis_norms(of, axis, 512) for axis in range(3)]


def test_a_box_closes_at_equality_and_no_bound_may_be_less():
    of, box = loop(), [[value / 64 for value in row] for row in some_box(10)]
    estimate_box.check_box(of, QUIET, box, box)
    for axis, k in product(range(3), range(10)):
        less = [
            [value - (i == axis and j == k) * value / 10**9 for j, value in enumerate(row)] for i, row in enumerate(box)
        ]
        with pytest.raises(Refusal, match=rf"axis {axis}: the bound {k} does not close"):
            estimate_box.check_box(of, QUIET, less, box)


@pytest.mark.parametrize("axis", range(3))
def test_each_limit_may_be_reached_and_not_passed(axis):
    of, box = loop(), [[value / 64 for value in row] for row in some_box(10)]
    share, row = estimate_box.COMMAND_SHARE, box[axis]
    noise = CASE.deviations * CASE.noise

    def at(values: Any, value: Fraction) -> tuple[Fraction, ...]:
        return tuple(value / share if i == axis else v for i, v in enumerate(values))

    for name, key in (("limits", kernel_norms.COMMAND), ("torque_limits", estimate_box.DEMAND)):
        for factor, kept in ((1, True), (1 - Fraction(1, 10**9), False)):
            limited = of._replace(**{name: at(getattr(of, name), factor * row[key])})
            assert estimate_box.is_within_limits(limited, row, axis) is kept
            if not kept:
                with pytest.raises(Refusal, match=f"axis {axis}: the command may reach its limit"):
                    estimate_box.check_box(limited, CASE, box, box)
    fastest = max(r[estimate_box.PEAK_RATE] for r in box) + noise
    estimate_box.check_box(of._replace(gyro_range=fastest / share), CASE, box, box)
    with pytest.raises(Refusal, match="axis 2: the rate may leave the gyro's range"):
        estimate_box.check_box(of._replace(gyro_range=fastest * (1 - Fraction(1, 10**9)) / share), CASE, box, box)


@pytest.mark.parametrize("axis", range(3))
def test_the_commanded_rate_may_reach_its_limit_and_not_pass_it(axis):
    of, box = loop(), [[value / 64 for value in row] for row in some_box(10)]
    S, T = of.rate_limit.S[axis], of.rate_limit.T[axis]
    states = [box[j % 3][3 + j // 3] for j in range(9)]
    gyro = [row[-1] + estimate_box.gyro_rounding(CASE, row) + CASE.deviations * CASE.noise for row in box]
    reached = sum(abs(a) * b for a, b in zip([*S, *T], [*states, *gyro], strict=True))
    for factor, kept in ((1, True), (1 - Fraction(1, 10**12), False)):
        limit = factor * reached / estimate_box.COMMAND_SHARE
        limits = tuple(limit if i == axis else Fraction(100) for i in range(3))
        limited = of._replace(rate_limit=of.rate_limit._replace(limits=limits))
        assert estimate_box.is_rate_unlimited(limited, CASE, box) is kept
    assert estimate_box.is_rate_unlimited(of._replace(rate_limit=None), CASE, box)


def test_a_law_without_schedule_has_no_excess_and_wide_angles_are_refused():
    of, box = loop(), some_box(10)
    linear = of._replace(G=tuple((Fraction(0),) * 3 for _ in range(9)))
    assert estimate_box.estimate_excess(linear, box) == [0, 0, 0]
    assert single_precision._excess_difference(linear, box, box) == [0, 0, 0]
    assert estimate_box.estimate_excess(of, box) == estimate_box.excess(
        [row[3] for row in box], [row[4] for row in box]
    )
    for E in ([Fraction(1), Fraction(0), Fraction(5)], [Fraction(0), Fraction(1), Fraction(0)]):
        estimate_box.trigonometry(E)
        with pytest.raises(ValueError, match=r"must be in \[0, 1\]"):
            estimate_box.trigonometry([value * Fraction(10**9 + 1, 10**9) for value in E])


@pytest.mark.parametrize("output", list(SAMPLES))
@pytest.mark.parametrize("name", "ABCDG")
def test_roundings_do_not_depend_on_signs(output, name):
    of = loop(output)
    turned = of._replace(**{name: tuple(tuple(-value for value in row) for row in getattr(of, name))})
    box = some_box(12)
    e = [Fraction(k, 64) for k in (1, 2, 3)]
    for axis in range(3):
        found = [estimate_box._rounding(one, CASE, box, e, axis) for one in (of, turned)]
        assert found[0] == found[1]
        assert min(found[0][0]) >= 0


def test_underflow_counts_where_nothing_else_does():
    row = [Fraction(0)] * 10
    assert estimate_box.gyro_rounding(QUIET, row) == Fraction(2) ** -140
    of = loop()
    found = estimate_box.map_box(of, plain_norms(of), QUIET._replace(moment=[Fraction(0)] * 3), [row] * 3)
    assert all(2.0**-141 < float(bounds[kernel_norms.COMMAND]) < 2.0**-136 for bounds in found)


def test_bounds_that_are_not_finite_are_refused():
    of = loop()
    box = [[Fraction(10) ** 300] * 3 + [Fraction(0)] * 7 for _ in range(3)]
    box[1][estimate_box.PEAK_RATE] = box[2][estimate_box.PEAK_RATE] = Fraction(10) ** 150
    with np.errstate(over="ignore"), pytest.raises(ValueError, match="not finite"):
        estimate_box.map_box(of, plain_norms(of), CASE._replace(moment=[Fraction(10) ** 308] * 3), box)


def test_norms_are_refused_where_they_have_no_bound(monkeypatch):
    of = loop()
    for samples in (0, -1, 65537):
        with pytest.raises(Refusal, match="must be 1 to 65536"):
            axis_norms(of, 0, samples)
    with pytest.raises(Refusal, match="unstable or too slow"):
        axis_norms(of, 0, 1)
    unstable = of._replace(D=tuple(tuple(-9 * value for value in row) for row in of.D))
    with pytest.raises(Refusal, match="have no bound: the loop is unstable"):
        axis_norms(unstable, 0, 4096)
    with monkeypatch.context() as patch:
        patch.setattr(kernel_norms, "_DIVERGED", 1.0)  # the size of the input itself
        with pytest.raises(Refusal, match="have no bound: the loop is unstable"):
            axis_norms(of, 1, 1)
    monkeypatch.setattr(kernel_norms, "LONGEST", 512)
    assert axis_norms(of, 0, 512)
    wide = of._replace(cells=(3, 5))
    monkeypatch.setattr(kernel_norms, "_MOST_WORK", 512 * 15)
    assert len(axis_norms(wide, 1, 512).entries) == 15
    monkeypatch.setattr(kernel_norms, "_MOST_WORK", 511 * 15)
    with pytest.raises(Refusal, match="512 samples of 3 x 5 cells are too many"):
        axis_norms(wide, 2, 512)


@pytest.mark.parametrize(("lag", "refused"), [(Fraction(1, 32), False), (Fraction(1, 33), True)])
def test_a_sample_too_long_for_the_series_is_refused(lag, refused):
    of = loop(lag=lag)
    if refused:
        with pytest.raises(Refusal, match="a sample is too long for the vehicle's time constants"):
            kernel_norms.sample_map(of, 0, float(1 / lag))
    else:
        entry = kernel_norms.sample_map(of, 0, float(1 / lag))[1][1]
        assert entry == pytest.approx(np.exp(-4.0), rel=1e-15)
    assert kernel_norms.sample_map(of._replace(dt=Fraction(4), damping=(Fraction(1, 8),) * 3), 0, 0.125)
    with pytest.raises(Refusal, match="too long"):
        kernel_norms.sample_map(of._replace(damping=(Fraction(33),) * 3), 0, 4.0)
    with pytest.raises(Refusal, match="too long"):
        kernel_norms.sample_map(of._replace(dt=Fraction(5), damping=(Fraction(1, 8),) * 3), 0, 0.125)


class Looked:
    """A step of one of three states, which counts how often it is taken."""

    shape = (1, 3, 3)

    def __init__(self, size: float) -> None:
        self.size, self.steps = size, 0

    def __matmul__(self, x: Any) -> Any:
        self.steps += 1
        return np.concatenate([np.full_like(x[:, :1], self.size), x[:, 1:]], axis=1)


@pytest.mark.parametrize(("size", "steps"), [(1e30, 65), (9e29, 200)])
def test_a_loop_that_diverges_is_left_at_the_next_look(size, steps):
    step, x = Looked(size), np.ones((1, 3, 5))
    run = kernel_norms._Run(0, np.zeros((1, 6, 5)), np.zeros((1, 6)), np.zeros_like(x), x)
    if size < 1e30:
        kernel_norms._simulate(step, np.zeros(3), run, 200)
    else:
        with pytest.raises(Refusal, match="have no bound: the loop is unstable"):
            kernel_norms._simulate(step, np.zeros(3), run, 200)
    assert step.steps == steps


def test_a_run_that_goes_on_has_the_bits_of_one_from_the_start():
    loop, found = read_system(json.dumps(law_document()), VEHICLE), []
    for asked in ([960], [1920, 480, 960]):  # what is shorter than the last run begins anew
        kernel_norms._runs.cache_clear()
        found.append([axis_norms.__wrapped__(loop, 0, samples) for samples in asked][-1])
    assert all(np.array_equal(one, other) for one, other in zip(*found, strict=True))


def last_of(left: float, peak: float = 1.0) -> tuple[Any, ...]:
    """Return sums of a loop of one state and two inputs, with `left` of a unit after one sample."""
    total, square = np.full((1, 4, 3), peak), np.ones((1, 4))
    return total, square, np.full((1, 1, 3), left), 1


def test_tails_are_added_in_full_and_refused_if_they_are_large(monkeypatch):
    nothing, centre = np.zeros((1, 1)), np.ones((1, 2))
    total, square, last, samples = last_of(1e-4)
    norms = kernel_norms._add_tails(total, square, last, samples, nothing, centre, centre, -2.0)
    whole = 1.0 + 1e-4 / (1.0 - 1e-4)
    assert norms.entries == pytest.approx(whole, rel=1e-9)
    assert norms.noise == pytest.approx(whole, rel=1e-9)
    assert norms.demand_gyro == 2.0
    for left, kept in ((0.999e-3, True), (1.001e-3, False)):
        total, square, last, samples = last_of(left)
        if kept:
            kernel_norms._add_tails(total, square, last, samples, nothing, centre, centre, 0.0)
        else:
            with pytest.raises(Refusal, match=r"after 1 samples 0\.001 of a unit is left"):
                kernel_norms._add_tails(total, square, last, samples, nothing, centre, centre, 0.0)
    with monkeypatch.context() as patch:
        patch.setattr(kernel_norms, "_MOST_LEFT", kernel_norms.UP * 2.0**-10)
        kernel_norms._add_tails(*last_of(2.0**-10), nothing, centre, centre, 0.0)
    # a state that the rate never sees has a weight all the same
    total = np.tile(np.array([1.0, 0.0, 2.0, 3.0, 4.0])[None, :, None], (1, 1, 4))
    last = np.array([[[1e-5, 3e-5, 0.0, 0.0], [5e-14, 1e-5, 0.0, 0.0]]])
    norms = kernel_norms._add_tails(total, total[:, :, 3], last, 1, np.zeros((1, 2)), centre, centre, 0.0)
    left = np.array([1e-5 + 5e-5, 3e-5 + 1e4])
    assert norms.entries[0, 2] == pytest.approx(2.0 + left * 2.0 / (1.0 - 6e-5), rel=1e-9)
    total, square, last, samples = last_of(0.0)
    two, units = np.ones((2, 5, 4)), np.ones((2, 2))
    uneven = np.array([[0.15, 0.1], [0.0, 0.0]])  # a quarter in the first cell, twice
    with pytest.raises(Refusal, match="rounding spoils the norms"):
        kernel_norms._add_tails(two, two[:, :, 0], np.zeros((2, 2, 4)), 1, uneven, units, units, 0.0)
    for defect, words in ((0.199 - 1e-9, "of a unit is left"), (0.2, "rounding spoils"), (0.201, "rounding spoils")):
        with pytest.raises(Refusal, match=words):
            kernel_norms._add_tails(total, square, last, samples, np.full((1, 1), defect), centre, centre, 0.0)


def test_each_rounding_of_the_tails_is_upward(monkeypatch):
    monkeypatch.setattr(kernel_norms, "UP", 2.0)
    centre, defect = np.ones((1, 2)), 2.0**-20
    norms = kernel_norms._add_tails(*last_of(0.0), np.full((1, 1), defect), centre, centre, 0.0)
    wrong = 2.0 * 2.0 * defect
    finite, left = 2.0 + 2 * wrong, 2.0 * wrong
    assert norms.entries[0, 0, 0] == pytest.approx(2.0 * (finite + left * 2.0 * finite / (1.0 - left)), rel=1e-12)


def refused(law: dict[str, Any] | None = None, vehicle: str = VEHICLE, *, words: str) -> None:
    with pytest.raises(Refusal, match=words):
        read_system(json.dumps(law or law_document()), vehicle)


def test_texts_that_no_proof_is_about_are_refused_by_name():
    law = law_document()
    for name in ("two\nlines", "a 'quote'"):
        refused({**law, "name": name}, words="holds no quote")
    refused({**law, "output": "attitude"}, words="commands attitude, the proof is about torque and rates")
    refused({**law, "schedule": {}}, words="is scheduled on attitude and rates")
    refused({**law, "B": [[*row, 0.0, 0.0] for row in law["B"]]}, words="matrices of wrong shapes")
    refused({**law, "D": [[*row, 0.0, 0.0] for row in law["D"]]}, words="matrices of wrong shapes")
    refused({**law, "C": [row[:6] for row in law["C"]]}, words="matrices of wrong shapes")
    refused({**law, "C": law["C"][:2]}, words="matrices of wrong shapes")
    refused({**law, "D": law["D"][:1]}, words="matrices of wrong shapes")
    refused({**law, "G": [row[:2] for row in law["G"]]}, words="matrices of wrong shapes")
    for name in "ST":
        for less in (law["rate_limit"][name][:2], [row[:-4] for row in law["rate_limit"][name]]):
            refused({**law, "rate_limit": {**law["rate_limit"], name: less}}, words="a rate limit of wrong shape")
    for name, i, j in product("ABCDG", (0, 1, 2), (0, 1, 2)):
        if i != j:
            changed = [list(row) for row in law[name]]
            changed[i][j] = 2.0**-60
            refused({**law, name: changed}, words="couples its axes")
    refused({**law, "dt": 0.0}, words="dt must be 1 positive number$")
    refused({**law, "limits": [1.0, 0.0, 1.0]}, words="limits must be 3 positive numbers")
    refused({**law, "limits": [1.0, 1.0]}, words="limits must be 3 positive numbers")
    for old, new, words in (
        ("actuator_lag = 0.25", "actuator_lag = 0.0", "actuator_lag must be 1 positive"),
        ("range = 30.0", "range = -30.0", "gyro.range must be 1 positive"),
        ("inertia_B = [2.0,", "inertia_B = [", "inertia_B must be 3 positive"),
        ("torque_limit = [3.5,", "torque_limit = [0.0,", "torque_limit must be 3 positive"),
        ("rate_damping = 0.25", "rate_damping = -0.25", "rate_damping is -0.25, must not be negative"),
        ("rate_damping = 0.25", "rate_damping = [0.25, 0.5, -0.25]", "rate_damping is -0.25, must not be negative"),
        ("rate_damping = 0.25", "rate_damping = [0.25, 0.5]", "rate_damping must be a number, or three"),
    ):
        assert old in VEHICLE
        refused(vehicle=VEHICLE.replace(old, new), words=words)
    tracks = law_document("rates")
    for old, new, words in (
        ("rate_p = [1.0,", "rate_p = [", "must be three numbers each"),
        ("rate_i = [0.5,", "rate_i = [-0.5,", "stabilizer.rate_i is -0.5"),
        ("derivative_cutoff = 0.5", "derivative_cutoff = 0.0", "derivative_cutoff must be 1 positive"),
    ):
        assert old in VEHICLE
        refused(tracks, VEHICLE.replace(old, new), words=words)
    assert read_system(json.dumps(law), VEHICLE.replace("rate_damping = 0.25", "rate_damping = 0.0")).damping == (
        0,
        0,
        0,
    )
    spread = "rate_damping = [0.25, { nominal = 0.5, low = 0.25, high = 1.0 }, 0.0]"
    assert read_system(json.dumps(law), VEHICLE.replace("rate_damping = 0.25", spread)).damping == (0.25, 0.5, 0)
    assert (
        read_system(json.dumps(law_document("rates")), VEHICLE.replace("[1.0, 1.25", "[0.0, 1.25")).rate_loop.p[0] == 0
    )


def test_laws_have_two_to_sixteen_states_an_axis():
    for n, words in (
        (3, "has 3 states"),
        (8, "has 8 states, must have 2 to 16 for"),
        (51, "has 51"),
        (6, ""),
        (48, ""),
    ):
        sizes = {"A": (n, n), "B": (n, 6), "C": (3, n), "G": (n, 3)}
        law = law_document() | {name: np.zeros(size).tolist() for name, size in sizes.items()} | {"rate_limit": None}
        if words:
            refused(law, words=words)
        else:
            assert len(read_system(json.dumps(law), VEHICLE).A) == n


def test_damping_by_drag_needs_rotors_above_the_centre():
    text = VEHICLE.replace("rate_damping = 0.25", "")
    low = text.replace("-0.125]", "0.0]")
    refused(vehicle=low, words="the rotors must be above the centre of mass")
    refused(vehicle=text.replace("[0.25, 0.5, -0.125], ", ""), words="three numbers for each of four or more rotors")
    at_rest = text.replace("heave_drag = 1.5", "heave_drag = 0.0").replace("gust_gain = 0.0625", "gust_gain = 0.0")
    assert read_system(json.dumps(law_document()), at_rest).damping == (0, 0, 0)


def test_a_strapdown_law_is_one_in_every_coefficient():
    of = loop()
    assert system.is_strapdown(of)
    for name, i, j in [("A", i, j) for i in range(6) for j in range(9)] + [
        (name, i, i % 3) for name in "BG" for i in range(6)
    ]:
        rows = [list(row) for row in getattr(of, name)]
        rows[i][j] += Fraction(1, 2**50)
        assert not system.is_strapdown(of._replace(**{name: tuple(map(tuple, rows))})), (name, i, j)
    assert system.is_strapdown(of._replace(A=(*of.A[:6], *[tuple(2 * v for v in row) for row in of.A[6:]])))


@pytest.mark.parametrize("value", [True, "1", None, float("nan"), float("inf"), -float("inf"), [1.0], 10**400])
def test_what_is_no_finite_number_is_refused(value):
    with pytest.raises((Refusal, OverflowError)):
        system.finite("x", value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"part": 0.0}, "part is 0.0"),
        ({"part": 1.0 + 2.0**-52}, "part is 1.0"),
        ({"noise": -1e-9}, "noise is -1e-09, must not be negative"),
        ({"risk": 1.0}, "risk is 1.0"),
        ({"risk": 9e-13}, "risk is 9e-13"),
        ({"risk": 0.0}, "risk is 0.0"),
        ({"noise": 0.0}, "0 without noise"),
        ({"horizon": 0.0}, "horizon is 0.0 s"),
        ({"horizon": 1000001.0}, "at most 1000000 s"),
        ({"inertia_spread": 1.0}, "a spread is a share"),
        ({"lag_spread": 1.0}, "a spread is a share"),
        ({"inertia_spread": -(2.0**-50)}, "a spread is a share"),
        ({"lag_spread": -(2.0**-50)}, "a spread is a share"),
        ({"cells": [1, 65]}, "must be 1 to 64"),
        ({"cells": [0, 1]}, "must be 1 to 64"),
        ({"cells": [1]}, "must be two whole numbers"),
        ({"cells": [1, True]}, "must be whole numbers"),
        ({"slope": [0.0, 0.0, 0.0]}, "belongs to moments of class"),
        ({"moment": [0.0, 0.0, -(2.0**-50)]}, "negative"),
        ({"moment": "abc"}, "must be 3 numbers"),
        ({"moment": [0.0, 0.0, 0.0]}, "must be positive"),
        ({"more": 1}, "other entries: more$"),
        ({"kind": "gain"}, "unknown kind"),
    ],
)
def test_a_number_out_of_its_domain_is_refused(changes, words):
    with pytest.raises(Refusal, match=words):
        some_claim(**changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"part": 1.0},
        {"risk": 1e-12 + 1e-27},
        {"risk": 1.0 - 2.0**-50},
        {"horizon": 1000000.0},
        {"cells": [1, 64]},
        {"cells": [64, 1]},
        {"moment": [0.0, 0.0, 2.0**-50]},
        {"moment": [1.0, 0.0, 0.0]},
        {"horizon": 2.0**-50},
        {"inertia_spread": 1.0 - 2.0**-50, "lag_spread": 0.0},
    ],
)
def test_a_number_at_the_end_of_its_domain_is_taken(changes):
    some_claim(**changes)


def test_the_least_risk_is_taken(monkeypatch):
    monkeypatch.setattr(flight_box, "LEAST_RISK", Fraction(1, 1 << 40))  # its own value is no double
    some_claim(risk=2.0**-40)


def test_the_risk_is_shared_by_all_samples_and_signals(monkeypatch):
    counts = []
    monkeypatch.setattr(flight_box, "least_deviations", lambda count, risk: counts.append((count, risk)) or Fraction(1))
    flight_box.make_case(loop(), some_claim())
    flight_box.make_case(loop(), some_claim(horizon=None))
    assert counts == [(3 * 12 * (241 + 2), Fraction(1, 256)), (3 * 12 * (4800 + 2), Fraction(1, 256))]


def test_deviations_that_do_not_cover_the_risk_are_refused(monkeypatch):
    count, risk = Fraction(1000), Fraction(1, 8)
    for factor, kept in ((1, True), (1 - Fraction(1, 10**12), False)):
        asked: list[Fraction] = []
        value = factor * count / risk
        monkeypatch.setattr(estimate_box, "exp_lower_bound", lambda x, a=asked, value=value: a.append(x) or value)
        if kept:
            found = estimate_box.least_deviations(count, risk)
            assert asked == [found**2 / 2]
        else:
            with pytest.raises(Refusal, match=r"risk of 0\.125"):
                estimate_box.least_deviations(count, risk)


@pytest.mark.parametrize(("above", "steps"), [(-0.0007, 1), (-0.0015, 0), (0.0, 1)])
def test_degrees_are_rounded_up_with_a_thousandth_of_a_step_to_spare(above, steps):
    angle = Fraction(math.radians((1000.0 + above) * 1e-6))
    assert flight_box.degrees_up(angle) == (1000 + steps) / 1e6


def test_the_truth_without_horizon_is_not_bounded():
    of = loop()
    assert "without a horizon" in flight_box._truth_deg(of, some_claim(horizon=None))[1]
    long = some_claim(horizon=1e6, noise=0.0, risk=0.0, moment_class="any", slope=[0.0] * 3)
    assert "no bound below a radian" in flight_box._truth_deg(of, long)[1]


def test_an_offset_beyond_a_radian_is_refused_and_slow_ones_are_simulated_longer(monkeypatch):
    of, box, simulated = loop(), [[value / 4096 for value in row] for row in some_box(10)], []
    disturbance = Disturbance([Fraction(0)] * 3, [Fraction(0)] * 3, 9, Fraction(0))
    angle = Fraction(1) - max(row[kernel_norms.X0] for row in box)

    def bound(*_: Any, samples: int, steps: int) -> attitude_offset.Offset:
        simulated.append((samples, steps))
        if samples < 8:
            raise Refusal("too slow")
        return attitude_offset.Offset([angle] * 3, [Fraction(0)] * 3)

    monkeypatch.setattr(attitude_offset, "bound_offset", bound)
    assert attitude_offset.strapdown_box(of, [], QUIET, box, disturbance, 2)[0][2][kernel_norms.X0] == 1
    assert simulated == [(2, 9), (4, 9), (8, 9), (8, 9)]
    attitude_offset.strapdown_box(of, [], QUIET, box, disturbance._replace(steps=19), 8)
    assert simulated[4:] == [(8, 19), (8, 14)]  # the middle is a number of samples
    with pytest.raises(ValueError, match="zip"):
        attitude_offset.strapdown_box(of, [], QUIET, box[:2], disturbance, 8)
    angle += Fraction(1, 10**9)
    with pytest.raises(Refusal, match="no bound below a radian"):
        attitude_offset.strapdown_box(of, [], QUIET, box, disturbance, 2)
    monkeypatch.setattr(kernel_norms, "LONGEST", 7)
    with pytest.raises(Refusal, match="samples are 8, must be 1 to 7"):
        attitude_offset.strapdown_box(of, [], QUIET, box, disturbance, 2)


def test_each_signal_of_the_offset_counts_in_its_deviations_and_its_work(monkeypatch):
    """Two signals of three axes at each sample, and two samples more; a simulation is doubled, not more."""
    of, box, counts, work = loop(), [[value / 4096 for value in row] for row in some_box(10)], [], []
    disturbance = Disturbance([Fraction(0)] * 3, [Fraction(0)] * 3, 9, Fraction(1, 128))

    def bound(*_: Any, samples: int, **__: Any) -> attitude_offset.Offset:
        if samples < 4:
            raise Refusal("too slow")
        return attitude_offset.Offset([Fraction(0)] * 3, [Fraction(0)] * 3)

    monkeypatch.setattr(attitude_offset, "bound_offset", bound)
    monkeypatch.setattr(attitude_offset, "least_deviations", lambda *given: counts.append(given) or Fraction(4))
    monkeypatch.setattr(attitude_offset, "check_work", lambda _, samples: work.append(samples))
    attitude_offset.strapdown_box(of, [], CASE, box, disturbance, 2)
    assert counts == [(Fraction(66), Fraction(1, 256))]
    assert work == [4]


def made_run(left: float, cells: int = 2) -> tuple[attitude_offset._Run, kernel_norms.AxisNorms]:
    """Return a run of two states with `left` of them after it, and norms; no two numbers are alike."""
    rng = np.random.default_rng(5)

    def some(*shape: int) -> Any:
        return rng.uniform(0.5, 1.5, shape)

    run = attitude_offset._Run(
        Phi=some(cells, 5, 5),
        total=some(cells, 2, 7),
        square=some(cells, 2),
        peak=some(cells, 5),
        first=some(cells, 7),
        largest=some(cells, 7),
        settled=1e-3 * some(cells, 7),
        last=left * some(cells, 5, 7),
    )
    centre = np.ones((cells, 2))
    norms = kernel_norms.AxisNorms(
        some(cells, 8, 5), some(cells, 8), some(cells, 8), some(cells, 8), centre, centre, 0.0
    )
    return run, norms


@pytest.mark.parametrize("steps", [3, 7, 40])
@pytest.mark.parametrize(("up", "ulp"), [(1.0 + 2.0**-40, 2.0**-52), (2.0, 2.0**-36)])
def test_norms_of_the_offset_are_those_of_its_formula(steps, up, ulp, monkeypatch):
    """The module's text, written again: with numbers of which each is felt, the coarse ones for their roundings."""
    (run, norms), samples = made_run(1e-5), 7
    monkeypatch.setattr(attitude_offset, "_simulate", lambda *_: run)
    monkeypatch.setattr(attitude_offset, "UP", up)
    for module in (attitude_offset, kernel_norms):
        monkeypatch.setattr(module, "_ULP", ulp)
    found = attitude_offset._sum_signals(loop(), norms, 0, samples, steps)
    defect = 21 * ulp * np.einsum("cij,cj->ci", np.abs(run.Phi), run.peak)
    reach = run.largest[:, :5] + run.first[:, :5]
    reach = reach + 1e-6 * np.max(reach, axis=1)[:, None]
    left = [np.abs(run.last[c]) + (norms.entries[c, :5] @ defect[c])[:, None] for c in range(2)]
    share = max(np.max(reach[c] @ left[c][:, :5] / reach[c]) for c in range(2))
    for c in range(2):
        own = 16.0 * ulp * (np.max(run.largest[c]) + 4.0 * np.max(run.peak[c]))
        longest = reach[c] * up / (1.0 - share)
        wrong = (samples + 1) * up * (longest @ defect[c] + own)
        settled = run.settled[c] + longest @ left[c] + wrong
        beyond = max(steps - samples, 0)
        tail = (norms.entries[c, 0] + norms.entries[c, 4]) @ left[c]
        tail += (samples + 1) * np.sum(norms.entries[c, :5] @ defect[c])
        total = run.total[c] + [(samples + 1) * wrong + beyond * settled, tail]
        noise = np.sqrt(run.square[c]) + np.array([(samples + 1) * wrong + math.sqrt(beyond) * settled[-1], tail[-1]])
        grown = up + samples * ulp
        assert found.total[c] == pytest.approx(grown * total, rel=2e-13)
        assert found.noise[c] == pytest.approx(grown * noise, rel=2e-13)


def test_an_offset_of_which_much_is_left_or_rounded_is_refused(monkeypatch):
    def found(run: attitude_offset._Run, norms: kernel_norms.AxisNorms) -> Any:
        monkeypatch.setattr(attitude_offset, "_simulate", lambda *_: run)
        return attitude_offset._sum_signals(loop(), norms, 0, 7, 9)

    run, norms = made_run(2.0**-12)
    with monkeypatch.context() as patch:
        patch.setattr(attitude_offset, "_MOST_LEFT", 1.0)
        assert found(run, norms)
        rough = run._replace(peak=run.peak * np.array([[1.0], [2.0**28]]))  # the second cell alone
        with pytest.raises(Refusal, match="rounding spoils the norms of the offset"):
            found(rough, norms)
        # both at equality, in a loop without rounding, and one beyond it
        patch.setattr(attitude_offset, "UP", 1.0)
        nothing = {name: 0.0 * getattr(run, name) for name in ("Phi", "first", "peak")}
        last = 2.0**-12 * np.eye(5, 7)[None].repeat(2, axis=0)
        exact = run._replace(**nothing, largest=np.ones((2, 7)), last=last)
        patch.setattr(attitude_offset, "_SPARE", 8 * 2.0**-48)
        patch.setattr(attitude_offset, "_MOST_LEFT", 2.0**-12)
        assert found(exact, norms)
        patch.setattr(attitude_offset, "_SPARE", 8 * 2.0**-48 * (1 - 2.0**-50))
        with pytest.raises(Refusal, match="rounding spoils the norms of the offset"):
            found(exact, norms)
    with pytest.raises(Refusal, match="of the offset is left: the loop is too slow"):
        found(run, norms)


def test_an_offset_starts_with_what_a_unit_moves_at_once():
    """Without a sample simulated: units of each state, of the excess, and of the gyro, which the first sample reads."""
    law = law_document()
    for i in range(3):
        law["B"][i][i], law["B"][3 + i][i] = 0.25, 0.75
    of = read_system(json.dumps(law), VEHICLE)._replace(inertia_spread=Fraction(1, 16), cells=(3, 1))
    run = attitude_offset._simulate(of, 1, 0)
    m, half = run.Phi.shape[1], STEP / 2
    first, off = np.zeros(m + 2), np.zeros(m + 2)
    first[kernel_norms.X0], off[kernel_norms.X1] = 1.0, 1.0
    first[-2], off[-2] = abs(2 * half - STEP), 0.0  # the law's own attitude moves by the excess too
    first[-1], off[-1] = abs(half - 0.25), abs(1.0 - 0.75)
    for cell in range(3):
        assert run.total[cell].tolist() == [first.tolist(), off.tolist()]
        assert run.square[cell].tolist() == [first[-1] ** 2, off[-1] ** 2]
        assert run.first[cell].tolist() == first.tolist()


def test_noise_over_too_short_or_long_a_flight_is_refused():
    of, zeros = loop(), [Fraction(0)] * 3
    for steps, words in ((44, "too short to bound"), (45, ""), (10**9, "may turn the attitude by a radian")):
        disturbance = Disturbance(zeros, zeros, steps, Fraction(1, 128))
        if words:
            with pytest.raises(Refusal, match=words):
                truth_drift._noise(of, CASE, disturbance)
        else:
            assert truth_drift._noise(of, CASE._replace(noise=Fraction(1, 2**12)), disturbance).walk > 0
    assert truth_drift._noise(of, QUIET, Disturbance(zeros, zeros, 1, Fraction(0))) == (0, 0)


def test_the_noise_has_least_deviations_that_cover_its_risk(monkeypatch):
    """The bounds of exp and of the root are round numbers here, at which every comparison is an equality."""
    of, zeros, half = loop(), [Fraction(0)] * 3, Fraction(1, 256)
    case = CASE._replace(noise=Fraction(1))

    asked = []

    def exp(x: Fraction) -> Fraction:
        if x > 6:  # of the mean square
            asked.append(x)
            return 3 / half
        return Fraction(21, 5) * x / half if x <= 2 else Fraction(10**9)  # equal up to two deviations

    monkeypatch.setattr(truth_drift, "exp_lower_bound", exp)
    monkeypatch.setattr(truth_drift, "sqrt_upper_bound", lambda _: Fraction(1))
    found = truth_drift._noise(of, case, Disturbance(zeros, zeros, 64, 2 * half))
    spread = Fraction(math.ceil(1e4 * math.sqrt(math.log(3 / half) / (0.15 * 64))), 10**4)
    assert asked == [Fraction(3, 20) * 64 * spread**2]
    assert found == (1, 2 * (Fraction(1, 2) + Fraction(1, 16)))  # two deviations: half a radian in the vector part
    with pytest.raises(Refusal, match="may turn the attitude by a radian"):
        truth_drift._noise(of, case._replace(noise=1 + Fraction(1, 10**9)), Disturbance(zeros, zeros, 64, 2 * half))
    monkeypatch.setattr(truth_drift, "exp_lower_bound", lambda x: exp(x) * (1 - Fraction(x <= 2, 10**9)))
    with pytest.raises(Refusal, match="may turn the attitude by a radian"):  # two deviations do not do any longer
        truth_drift._noise(of, case, Disturbance(zeros, zeros, 64, 2 * half))
    monkeypatch.setattr(truth_drift, "exp_lower_bound", lambda x: (1 - Fraction(1, 10**9)) * exp(x))
    with pytest.raises(Refusal, match="too short to bound"):
        truth_drift._noise(of, case, Disturbance(zeros, zeros, 64, 2 * half))


def test_the_mean_square_of_the_noise_may_be_twice_its_value():
    zeros, n = [Fraction(0)] * 3, 45
    case = CASE._replace(noise=Fraction(1, 2**12))
    for share, kept in ((0.99995, True), (1.00005, False)):
        risk = Fraction(6.0 * math.exp(-0.15 * n * share**2))
        if kept:
            mean = truth_drift._noise(loop(), case, Disturbance(zeros, zeros, n, risk)).mean
            assert float(mean / case.noise) == pytest.approx(math.sqrt(2.0), rel=1e-12)
        else:
            with pytest.raises(Refusal, match="too short to bound"):
                truth_drift._noise(loop(), case, Disturbance(zeros, zeros, n, risk))


def test_rotations_of_more_than_a_radian_are_refused():
    third, vector = Fraction(1, 3), [Fraction(1)] * 3
    truth_drift._tilt([third] * 3, vector)
    with pytest.raises(Refusal, match="below a radian"):
        truth_drift._tilt([third, third, third + Fraction(1, 10**9)], vector)
    nothing = [Fraction(0)] * 3

    def no_excess(_: Any, __: Any) -> list[Fraction]:
        return nothing

    one = [Fraction(1), Fraction(0), Fraction(0)]
    assert truth_drift._rotate(one, nothing, no_excess) == one
    with pytest.raises(Refusal, match="below a radian"):
        truth_drift._rotate([value * Fraction(10**9 + 1, 10**9) for value in one], nothing, no_excess)


def test_a_sample_too_long_for_the_rates_is_refused(monkeypatch):
    of, zeros = loop(), [Fraction(0)] * 3
    box, none = [[value / 16 for value in row] for row in some_box(10)], truth_drift._Noise(Fraction(0), Fraction(0))
    slope = 2 * Fraction(1, 100) / of.dt
    monkeypatch.setattr(truth_drift, "slope_of_T", lambda *_: [slope / 2, slope, slope / 3])
    assert truth_drift._kinematic_error(of, QUIET, box, none, zeros, zeros)
    slope *= Fraction(10**9 + 1, 10**9)
    with pytest.raises(Refusal, match="a sample is too long for the rates"):
        truth_drift._kinematic_error(of, QUIET, box, none, zeros, zeros)


def test_a_flight_near_a_limit_or_at_a_large_angle_has_no_bound_in_floats():
    of = loop()
    box = [[value / 16 for value in row] for row in some_box(10)]
    form = Form(frozenset(), Fraction(0), [Fraction(0)] * 9)
    single_precision._check_form(of, QUIET, box, form)
    for axis in (0, 1):
        tilted = [list(row) for row in box]
        tilted[axis][kernel_norms.X0] = Fraction(3, 4)
        single_precision._check_form(of, QUIET, tilted, form)
        tilted[axis][kernel_norms.X0] += Fraction(1, 10**9)
        with pytest.raises(Refusal, match="an angle needs reduction"):
            single_precision._check_form(of, QUIET, tilted, form)
        with pytest.raises(Refusal, match="an angle needs reduction"):
            single_precision.bound_rounding(of, [], QUIET, tilted, form, [])
        linear = of._replace(G=tuple((Fraction(0),) * 3 for _ in range(9)))
        single_precision._check_form(linear, QUIET, tilted, form)
    turned = [list(row) for row in box]
    turned[2][kernel_norms.X0] = Fraction(4, 5)
    single_precision._check_form(of, QUIET, turned, form)
    for limited in (
        *(of._replace(torque_limits=tuple(Fraction(1, 1000 ** (i == j)) for i in range(3))) for j in range(3)),
        of._replace(torque_limits=(Fraction(1, 1000),) * 3),
        of._replace(rate_limit=of.rate_limit._replace(limits=(Fraction(1, 1000),) * 3)),
    ):
        with pytest.raises(Refusal, match="too near a limit"):
            single_precision._check_form(limited, QUIET, box, form)


@pytest.mark.parametrize("axis", range(3))
def test_the_rounding_of_a_limited_rate_stays_below_the_share_kept_free(axis):
    of, box = loop(), [[value / 16 for value in row] for row in some_box(10)]
    form = Form(frozenset(), Fraction(3, 4), [Fraction(k, 64) for k in range(9)])
    sizes, gyro = single_precision._sizes(of, CASE, box, form)
    weighed = [2 * abs(a) * b for a, b in zip(of.rate_limit.S[axis], sizes, strict=True)]
    weighed += [abs(a) * b for a, b in zip(of.rate_limit.T[axis], gyro, strict=True)]
    least = 19 * Fraction(2) ** -24 * sum(weighed) * 1000
    for factor, exact in ((1, True), (1 - Fraction(1, 10**9), False)):
        limits = tuple(factor * least if i == axis else Fraction(100) for i in range(3))
        limited = of._replace(rate_limit=of.rate_limit._replace(limits=limits))
        assert single_precision._is_rate_sum_exact(limited, CASE, box, form) is exact
    assert single_precision._is_rate_sum_exact(of._replace(rate_limit=None), CASE, box, form)


def test_copies_are_exact_in_floats_and_sums_are_not():
    of, box = loop(), [[value / 16 for value in row] for row in some_box(10)]
    form = Form(frozenset(), Fraction(0), [Fraction(0)] * 9)
    none = [[Fraction(0)] * 3] * 12
    tiny = Fraction(2) ** -110
    assert single_precision._row_error(of, QUIET, box, form, none, 3) == tiny  # the gyro's last sample
    for factor, copied in ((-1, True), (2, False), (Fraction(1, 2), False)):
        B = tuple(tuple(factor * value for value in row) for row in of.B)
        error = single_precision._row_error(of._replace(B=B), QUIET, box, form, none, 3)
        assert (error == tiny) is copied
    reads = [[Fraction(0), Fraction(0), Fraction(i == 3)] for i in range(12)]
    assert single_precision._row_error(of, QUIET, box, form, reads, 3) > tiny
    G = tuple(
        tuple(Fraction(1) if (i, j) == (3, 0) else value for j, value in enumerate(row)) for i, row in enumerate(of.G)
    )
    assert single_precision._row_error(of._replace(G=G), QUIET, box, form, none, 3) > tiny


def test_roundings_in_floats_do_not_depend_on_signs():
    of, box = loop(), [[value / 16 for value in row] for row in some_box(10)]
    none = [[Fraction(0)] * 3] * 12
    signs = {
        name: [[-value if value != 1 else value for value in row] for row in getattr(of, name)] for name in "ABCDG"
    }
    turned = of._replace(**{name: tuple(map(tuple, rows)) for name, rows in signs.items()})  # but for copies
    for wide in (frozenset[int](), frozenset({0, 3, 6})):
        form = Form(wide, Fraction(0), [Fraction(0)] * 9)
        for i in range(12):
            errors = [single_precision._row_error(one, QUIET, box, form, none, i) for one in (of, turned)]
            assert errors[0] == errors[1]


def test_underflow_counts_in_every_sum_of_floats():
    of, nothing = loop(), [[Fraction(0)] * 10] * 3
    for wide in (frozenset[int](), frozenset(range(9))):
        form = Form(wide, Fraction(0), [Fraction(0)] * 9)
        errors = [single_precision._row_error(of, QUIET, nothing, form, [[Fraction(0)] * 3] * 12, i) for i in range(12)]
        assert errors == [Fraction(2) ** -110] * 12


def test_roundings_may_use_up_what_the_wider_box_leaves(monkeypatch):
    of, box = loop(), [[value / 16 for value in row] for row in some_box(10)]
    form = Form(frozenset(), Fraction(0), [Fraction(0)] * 9)
    spare = [[value / 50 for value in row] for row in box]
    monkeypatch.setattr(single_precision, "_fixed_point", lambda *_: spare)
    single_precision.bound_rounding(of, [], QUIET, box, form, [[Fraction(0)] * 3] * 12)
    for axis, k in product(range(3), range(10)):
        more = [list(row) for row in spare]
        more[axis][k] *= Fraction(10**9 + 1, 10**9)
        monkeypatch.setattr(single_precision, "_fixed_point", lambda *_, more=more: more)
        with pytest.raises(Refusal, match="not small beside the box"):
            single_precision.bound_rounding(of, [], QUIET, box, form, [[Fraction(0)] * 3] * 12)


def test_roundings_that_are_not_small_are_refused():
    of = loop()
    box = [[value / 16 for value in row] for row in some_box(10)]
    form = Form(frozenset(), Fraction(1 << 20), [Fraction(1)] * 9)
    of = of._replace(rate_limit=None)
    with pytest.raises(Refusal, match="not small beside the box"):
        single_precision.bound_rounding(of, plain_norms(of), QUIET, box, form, [[Fraction(0)] * 3] * 12)
    assert single_precision._is_below([[Fraction(1), Fraction(2)]], [[Fraction(1), Fraction(2)]])
    assert not single_precision._is_below([[Fraction(1), Fraction(2)]], [[Fraction(1), Fraction(1)]])
    assert not single_precision._is_below([[Fraction(0)], [Fraction(2)]], [[Fraction(1)], [Fraction(1)]])


ONE, PAIR = [Fraction(1)], [Fraction(1)] * 2


SMALL = [[value / 64 for value in row] for row in some_box(10)]


@pytest.mark.parametrize(
    "compare",
    [
        lambda: estimate_box.check_box(loop(), QUIET, SMALL, SMALL[:2]),
        lambda: estimate_box.check_box(loop(), QUIET, SMALL, [row[:-1] for row in SMALL]),
        lambda: estimate_box.weigh(ONE, PAIR),
        lambda: single_precision._is_below([ONE], [ONE, ONE]),
        lambda: single_precision._is_below([ONE], [PAIR]),
        lambda: single_precision._is_rate_sum_exact(
            loop(rate_limit=loop().rate_limit._replace(limits=(Fraction(100),) * 2)),
            QUIET,
            SMALL,
            Form(frozenset(), Fraction(0), [Fraction(0)] * 9),
        ),
        lambda: truth_drift.blind_angles(loop(), PAIR, 1),
        lambda: truth_drift._over_inertia(loop(), PAIR * 2),
        lambda: truth_drift._rotate(PAIR, ONE, lambda *_: ONE),
        lambda: truth_drift._rotate([Fraction(1, 8)], [Fraction(1, 8)], lambda *_: PAIR),
        lambda: truth_drift._tilt([Fraction(0)] * 3, PAIR * 2),
    ],
)
def test_no_row_is_compared_or_added_up_to_the_length_of_a_shorter_one(compare):
    with pytest.raises(ValueError, match="zip"):
        compare()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "whatever the constant inertia within 12.5 % and the lag within 6.25 %, with gyro noise"),
        ({"inertia_spread": 0.0}, "whatever the constant inertia within 0 % and the lag within 6.25 %"),
        (
            {"inertia_spread": 0.0, "lag_spread": 0.0, "noise": 0.0, "risk": 0.0},
            "with nominal inertia and lag, without gyro noise",
        ),
    ],
)
def test_a_statement_tells_the_spreads_and_the_noise_that_it_holds_for(changes: dict[str, float], words: str):
    system = read_system(json.dumps(law_document()), VEHICLE)
    figures = {"estimate_deg": [1.0, 2.0, 3.0], "torque_nm": [0.5, 0.5, 0.5], "truth_deg": [None] * 3}
    assert words in flight_box._statement(system, some_claim(**changes), figures, "no bound of the true attitude")
