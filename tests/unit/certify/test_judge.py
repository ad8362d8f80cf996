"""The judge, function by function, on a loop of round numbers: every figure to its last digits, every edge.

Its parts are compared with flights and with other means in `test_boundedness`. Here each number, sign and comparison of
the judge has a figure that moves with it. `python tests/unit/certify/test_judge.py` writes the figures anew, where a
change is meant; its commit says why.
"""

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterator
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gustproof.certify.check import (
    attitude_offset,
    dissipation,
    estimate_box,
    evidence,
    flight_box,
    gaussian_loop,
    kernel_norms,
    levelled_box,
    levelled_norms,
    quadratic_constraints,
    single_precision,
    system,
    truth_drift,
)
from gustproof.certify.check.estimate_box import Case
from gustproof.certify.check.flight_box import Claim
from gustproof.certify.check.kernel_norms import axis_norms
from gustproof.certify.check.single_precision import Form
from gustproof.certify.check.system import LoopSystem, Refusal, read_system
from gustproof.certify.check.truth_drift import Disturbance
from gustproof.lti import rational

Figures = Iterator[tuple[str, Any]]
"""Figures by name, made one after the other: a test stops at the first that is wrong."""
Wave = np.ndarray[Any, np.dtype[np.complex128]]
PINNED = Path(__file__).parents[2] / "golden" / "judge.json"
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
    return {"name": "round", "output": output, "dt": STEP, "limits": [4.0, 3.0, 2.0], **matrices, "rate_limit": limit}


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


def spread_loop(output: str = "torque") -> LoopSystem:
    return loop(output, inertia_spread=Fraction(1, 8), lag_spread=Fraction(1, 16), cells=(2, 3))


CASE = Case([Fraction(1, 8), Fraction(1, 16), Fraction(3, 32)], Fraction(1, 64), Fraction(9, 2))
QUIET = Case(CASE.moment, Fraction(0), Fraction(0))


def some_box(width: int) -> list[list[Fraction]]:
    """Return a box in which no two bounds are alike."""
    return [[Fraction(7 + 5 * i + (3 + i) * k, 256) for k in range(width)] for i in range(3)]


def some_claim(**changes: Any) -> Claim:
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


def flat(value: Any) -> Any:
    """Return the numbers of nested rows as floats; words and other constants as they are."""
    if isinstance(value, dict):
        return {str(key): flat(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [flat(item) for item in value]
    return float(value) if isinstance(value, Fraction | float) else value


def figures_of_rational() -> Figures:
    x = Fraction(5, 7)
    yield "round_up", [rational.round_up(x), rational.round_up(x, 3), rational.round_up(-x, 3)]
    yield "sqrt", [rational.sqrt_upper_bound(Fraction(k, 7)) ** 2 * 2**60 - Fraction(2**60 * k, 7) for k in (1, 3, 40)]
    yield "sin", [str(rational.sin_upper_bound(x)), str(rational.sin_upper_bound(Fraction(1)))]
    yield "cos", [str(rational.cos_lower_bound(x)), str(rational.cos_lower_bound(Fraction(1)))]
    yield "exp", [rational.exp_lower_bound(Fraction(k)) for k in (0, 1, 40, 80)]
    yield "add", rational.add([[x, x]], [[1, 2]], [[3, 4]])
    yield "scale", rational.scale(3, [[x, 1]])


def figures_of_system(output: str) -> Figures:
    plain = read_system(json.dumps(law_document(output)), VEHICLE)
    without = read_system(json.dumps(law_document(output)), VEHICLE.replace("rate_damping", "# rate_damping"))
    spread = spread_loop(output)
    bounds = [spread.inverse_inertia, spread.inverse_lag, spread.gyroscopic]
    yield from {"read": plain, "damping": without.damping, "bounds": bounds}.items()


def figures_of_norms(output: str, *, spread: bool) -> Figures:
    for axis in range(3):
        of = spread_loop(output) if spread else loop(output)
        norms = axis_norms(of, axis, SAMPLES[output][axis])
        yield (
            f"axis {axis}",
            [
                np.sum(norms.entries, axis=2),
                np.sum(norms.entries, axis=1),
                norms.excess,
                norms.gyro,
                norms.noise,
                norms.inverse_inertia,
                norms.inverse_lag,
                norms.demand_gyro,
            ],
        )


def figures_of_box(output: str) -> Figures:
    of = spread_loop(output)
    norms = [axis_norms(of, axis, SAMPLES[output][axis]) for axis in range(3)]
    box = some_box(norms[0].excess.shape[1] + 1)
    e = estimate_box.estimate_excess(of, box)
    for name, case in (("noisy", CASE), ("quiet", QUIET)):
        rounding = [estimate_box._rounding(of, case, box, e, axis) for axis in range(3)]
        yield (
            name,
            [
                estimate_box.map_box(of, norms, case, box),
                e,
                rounding,
                [estimate_box.acceleration(of, case, box, axis) for axis in range(3)],
                [estimate_box.gyro_rounding(case, row) for row in box],
            ],
        )


def figures_of_drift() -> Figures:
    of, box = spread_loop(), some_box(10)
    box = [[value / 8 for value in row] for row in box]
    case = CASE._replace(noise=Fraction(1, 1 << 12), moment=[value / 16 for value in CASE.moment])
    unseen, slope = [Fraction(k, 512) for k in (3, 5, 7)], [Fraction(k, 256) for k in (11, 13, 17)]
    zeros = [Fraction(0)] * 3
    wide, rates = [Fraction(k, 16) for k in (5, 7, 9)], [Fraction(k, 16) for k in (11, 12, 13)]
    change, off = [Fraction(k, 8) for k in (3, 4, 5)], [Fraction(k, 32) for k in (1, 2, 4)]
    yield "angles", truth_drift._angles(wide, rates, change)
    yield "slope of T", truth_drift.slope_of_T(wide, rates, off)
    yield "excess", [estimate_box.excess(wide, rates), truth_drift._excess_N(wide, rates)]
    yield "tilt", truth_drift._tilt(off, rates)
    yield "turn", truth_drift._turn(off, off[::-1], truth_drift._excess_N)
    for name, disturbance in {
        "all": Disturbance(unseen, slope, 48, Fraction(1, 128)),
        "held": Disturbance(zeros, zeros, 6000, Fraction(1, 1024)),
    }.items():
        noise = truth_drift._noise(of, case, disturbance)
        less = noise._replace(mean=noise.mean / 4, walk=noise.walk / 4)
        estimate = [row[kernel_norms.X0] for row in box]
        yield (
            name,
            [
                noise,
                truth_drift._step_errors(of, case, box, disturbance, less, estimate),
                truth_drift._kinematic_error(of, case, box, less, estimate, off),
                truth_drift._noise_error(of, less, Fraction(1, 32), Fraction(3, 8)),
                [truth_drift._rate_slope(of, case, box, axis) for axis in range(3)],
                [truth_drift._drag_slope(of, case, box, axis) for axis in range(3)],
                [truth_drift._jerk(of, case, box, disturbance, axis) for axis in range(3)],
            ],
        )
    still = case._replace(noise=Fraction(0), deviations=Fraction(0))
    yield (
        "truth",
        [
            truth_drift.truth_bound(of, case, box, Disturbance(unseen, slope, 48, Fraction(1, 128))),
            truth_drift.truth_bound(of, still, box, Disturbance(zeros, zeros, 4, Fraction(0))),
            truth_drift.blind_angles(of, unseen, 7),
        ],
    )
    disturbance = Disturbance(unseen, slope, 48, Fraction(1, 128))
    joint = truth_drift.Joint([value / 8 for value in off], [value / 16 for value in off[::-1]], Fraction(1, 512))
    noise = truth_drift._noise(of, case, disturbance)
    yield (
        "joint",
        [
            truth_drift.truth_bound(of, case, box, disturbance, joint),
            truth_drift._walk_error(of, case, noise, Fraction(1, 8), 48, joint.risk),
        ],
    )


def figures_of_offset(output: str) -> Figures:
    law = json.loads(json.dumps(law_document(output)))
    for i in range(3):
        law["A"][i][i], law["B"][i][i], law["A"][3 + i][i], law["G"][i][i] = 0.9375, 0.0703125, -0.0625, 0.109375
    of = read_system(json.dumps(law), VEHICLE)._replace(inertia_spread=Fraction(1, 16), cells=(2, 1))
    samples = 2 * max(SAMPLES[output])
    norms = [axis_norms(of, axis, samples) for axis in range(3)]
    box = [[value / 1024 for value in row] for row in some_box(norms[0].excess.shape[1] + 1)]
    noisy, quiet = (
        case._replace(moment=[value / 64 for value in CASE.moment], noise=case.noise / 64) for case in (CASE, QUIET)
    )
    for name, case, steps in (("noisy", noisy, 4 * samples), ("quiet", quiet, samples)):
        yield name, attitude_offset.bound_offset(of, norms, case, box, samples=samples, steps=steps)
    disturbance = Disturbance([Fraction(0)] * 3, [Fraction(0)] * 3, 2 * samples, Fraction(1, 128))
    linear = of._replace(G=tuple((Fraction(0),) * 3 for _ in range(9)))
    yield "box", attitude_offset.strapdown_box(of, norms, noisy, box, disturbance, samples)
    yield "box of a linear law", attitude_offset.strapdown_box(linear, norms, quiet, box, disturbance, samples)
    for axis in range(3):
        sums = attitude_offset._sum_signals(of, norms[axis], axis, samples, 3 * samples)
        yield f"norms, axis {axis}", [np.sum(sums.total, axis=0), np.sum(sums.total, axis=2), sums.noise]


def figures_of_single(output: str) -> Figures:
    of = loop(output)
    norms = [axis_norms(of, axis, 512) for axis in range(3)]
    box = [[value / 16 for value in row] for row in some_box(norms[0].excess.shape[1] + 1)]
    case = CASE._replace(noise=Fraction(1, 1 << 12))
    form = Form(frozenset({0, 1, 7}), Fraction(3, 4), [Fraction(k, 64) for k in range(9)])
    reference = [[Fraction(k % 3, 8), Fraction(0), Fraction(k % 4 - 2, 16)] for k in range(12)]
    errors = [single_precision._row_error(of, case, box, form, reference, i) for i in range(12)]
    difference = [[value / 4 for value in row] for row in box]
    yield "rows", errors
    yield "sizes", single_precision._sizes(of, case, box, form)
    yield "excess terms", single_precision._excess_terms(box)
    yield "excess difference", single_precision._excess_difference(of, box, difference)
    yield "start", [single_precision._start_error(form, state) for state in range(9)]
    yield "map", single_precision._map(of, norms, box, difference, errors, form)
    yield "bounds", single_precision.bound_rounding(of, norms, case, box, form, reference)


def figures_of_claim() -> Figures:
    of = loop()
    for name, changes in {
        "slope": {},
        "any": {"moment_class": "any", "slope": [0.0] * 3, "noise": 0.0, "risk": 0.0, "horizon": 3.05},
        "held": {"moment_class": "held", "slope": [0.0] * 3, "inertia_spread": 0.0},
        "for ever": {"horizon": None, "lag_spread": 0.0},
    }.items():
        made = some_claim(**changes)
        spread = flight_box.spread_system(of, made)
        case = flight_box.make_case(spread, made)
        words = made._replace(moment_class=made.moment_class.value)
        yield name, [words, case, *flight_box.describe(spread, made)]


# -- the inequalities of a gain --


def sample_matrix(rows: int, columns: int, seed: int, unit: float = 16.0) -> list[list[float]]:
    """Return small round numbers, no two rows or columns alike, not symmetric."""
    return [[((7 * i + 5 * j + 11 * seed + i * j) % 13 - 6) / unit for j in range(columns)] for i in range(rows)]


def symmetric(size: int, seed: int) -> list[list[float]]:
    M = sample_matrix(size, size, seed, 64.0)
    return [[M[i][j] + M[j][i] + (i == j) * (1.5 + 0.25 * i) for j in range(size)] for i in range(size)]


def skew(size: int, seed: int) -> list[list[float]]:
    M = sample_matrix(size, size, seed, 64.0)
    return [[M[i][j] - M[j][i] for j in range(size)] for i in range(size)]


def lft_evidence(k: int) -> dict[str, Any]:
    """Return a system of three states, `k` channels of Delta, two w and two z, in other coordinates."""
    sizes = {"A": (3, 3), "B": (3, k + 2), "C": (k + 2, 3), "D": (k + 2, k + 2)}
    system_of = {name: sample_matrix(*size, seed) for seed, (name, size) in enumerate(sizes.items())}
    return {"system": system_of, "coordinates": [[2.0, 0.5, -0.25], [0.0, 1.0, 0.5], [0.0, 0.0, 0.5]]}


def real_block(name: str, size: int, seed: int) -> dict[str, Any]:
    return {"name": name, "size": size, "D": symmetric(size, seed), "G": skew(size, seed)}


def gain_evidence() -> dict[str, Any]:
    return {**lft_evidence(3), "P": symmetric(3, 4), "blocks": [real_block("a", 1, 5), real_block("b", 2, 6)]}


def slow_evidence() -> dict[str, Any]:
    speeds = {"a": (1, 0.75), "b": (2, None), "c": (1, 1.25)}
    blocks = [{"name": name, "size": size, "speed": speed} for name, (size, speed) in speeds.items()]
    scalings = [[real_block("", size, v + s) for s, (size, _) in enumerate(speeds.values())] for v in range(16)]
    return {
        **lft_evidence(4),
        "P": [symmetric(3, seed) for seed in range(4)],
        "Y": sample_matrix(2, 9, 8),
        "blocks": blocks,
        "vertices": [[{key: item[key] for key in "DG"} for item in vertex] for vertex in scalings],
    }


PARTS: list[dict[str, Any]] = [
    {
        "name": "s",
        "size": 2,
        "kind": "slope",
        "odd": True,
        "poles": [0.5],
        "T": [2.0, 1.5],
        "causal": [[0.25, -0.5]],
        "anticausal": [[0.125, 0.0625]],
    },
    real_block("r", 1, 3),
    {"name": "v", "size": 1, "kind": "varying delay", "largest": 0.5, "X": [[1.25]]},
    {
        "name": "d",
        "size": 1,
        "kind": "delay",
        "largest": 0.25,
        "poles": [2.0],
        "X": symmetric(2, 1),
        "Y": symmetric(2, 2),
    },
    {"name": "c", "size": 1, "kind": "sector", "T": [0.75]},
]


def constrained_evidence() -> dict[str, Any]:
    """Return a loop of all kinds of parts; each sees at once the outputs of earlier ones, but for the varying delay."""
    evidence = lft_evidence(6)
    D = evidence["system"]["D"]
    for row, first in ((0, 0), (1, 0), (3, 0), (4, 4), (5, 5)):
        D[row][first:6] = [0.0] * (6 - first)
        D[row][2] = 0.0
    D[3] = [0.0] * 8
    states = 3 + 4 + 5
    coordinates = [[float(i == j) + (j == i + 1) * 0.5 for j in range(states)] for i in range(states)]
    return {
        **evidence,
        "coordinates": coordinates,
        "P": symmetric(states, 3),
        "stability": symmetric(states, 5),
        "blocks": PARTS,
    }


def weighed(form: dissipation.Ball) -> list[list[Fraction]]:
    """Return a number for each row of middle and radius, which any of its entries moves."""
    return [[sum(((j + 1) * value for j, value in enumerate(row)), Fraction(0)) for row in half] for half in form]


def figures_of_inequalities() -> Figures:
    level, shares = Fraction(5, 4), {"exact": Fraction(0), "wide": Fraction(1, 64)}
    for name, share in shares.items():
        yield f"gain, {name}", weighed(dissipation.gain_inequality(level, gain_evidence(), share))
        slow = dissipation.rate_bounded_inequalities(level, slow_evidence(), share)
        yield f"slow gain, {name}", [weighed(form) for form in slow]
        constrained = constrained_evidence()
        yield f"constrained gain, {name}", weighed(dissipation.gain_inequality(level, constrained, share))
        yield f"stability, {name}", weighed(dissipation.stability_inequality(constrained, share))


def figures_by_kind(output: str) -> dict[str, Figures]:
    return {
        f"system of {output}": figures_of_system(output),
        f"norms of {output}": figures_of_norms(output, spread=False),
        f"norms of {output}, spread": figures_of_norms(output, spread=True),
        f"box of {output}": figures_of_box(output),
        f"offset of {output}": figures_of_offset(output),
        f"single precision of {output}": figures_of_single(output),
    }


def figures(output: str | None = None) -> dict[str, Figures]:
    """Return the figures by part of the judge: of one kind of law, or of what does not depend on it."""
    if output is not None:
        return figures_by_kind(output)
    return {
        "rational": figures_of_rational(),
        "drift": figures_of_drift(),
        "claim": figures_of_claim(),
        "inequalities": figures_of_inequalities(),
    }


def assert_alike(found: Any, pinned: Any, where: str) -> None:
    """Compare nested rows: words exactly, numbers but for the order of sums in doubles, which differs by machine.

    An offset is a small difference of large sums.
    """
    if isinstance(pinned, dict):
        assert set(found) == set(pinned), where
        for key, value in pinned.items():
            assert_alike(found[key], value, f"{where}, {key}")
    elif isinstance(pinned, list):
        assert len(found) == len(pinned), where
        for k, value in enumerate(pinned):
            assert_alike(found[k], value, f"{where}, {k}")
    elif isinstance(pinned, float):
        rel = 1e-11 if where.startswith("offset") else 3e-14
        assert found == pytest.approx(pinned, rel=rel, abs=0.0), where
    else:
        assert found == pinned, where


@pytest.mark.parametrize("output", [None, *SAMPLES])
def test_every_term_moves_a_figure(output):
    pinned = json.loads(PINNED.read_text(encoding="utf-8"))
    for part, made in figures(output).items():
        names = []
        for name, value in made:
            assert_alike(json.loads(json.dumps(flat(value))), pinned[part][name], f"{part}, {name}")
            names.append(name)
        assert names == list(pinned[part])


@pytest.mark.parametrize(
    ("module", "values"),
    [
        (kernel_norms, {"UP": 1 + 2**-40, "_ULP": 2**-52, "_MOST_LEFT": 1e-3, "_DIVERGED": 1e30}),
        (kernel_norms, {"LONGEST": 65536, "MOST_CELLS": 64, "_MOST_WORK": 4194304}),
        (estimate_box, {"COMMAND_SHARE": Fraction(999, 1000), "_FLOAT32": 2.0**-22, "_DOUBLE": 2.0**-46}),
        (estimate_box, {"_TINY": 2.0**-140}),
        (flight_box, {"RISK_PERIOD": 600, "LEAST_RISK": Fraction(1, 10**12), "LONGEST": 1000000}),
        (system, {"_MOST_STATES": 48, "_LEVELLED": 8, "_GRAVITY": 10}),
        (levelled_box, {"_TILT": 2.0**-22, "LEAK": 0.0625}),
        (levelled_norms, {"_ULP": 2**-52, "_DIVERGED": 1e30, "_SPARE": 1e-6, "_BLOCK": 1024}),
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


# -- the box --


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


# -- the norms --


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
    if size < 1e30:
        kernel_norms._simulate(step, np.zeros(3), x, 200)
    else:
        with pytest.raises(Refusal, match="have no bound: the loop is unstable"):
            kernel_norms._simulate(step, np.zeros(3), x, 200)
    assert step.steps == steps


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


# -- the system --


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


# -- the claim --


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


# -- the drift --


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
    assert truth_drift._turn(one, nothing, no_excess) == one
    with pytest.raises(Refusal, match="below a radian"):
        truth_drift._turn([value * Fraction(10**9 + 1, 10**9) for value in one], nothing, no_excess)


def test_a_sample_too_long_for_the_rates_is_refused(monkeypatch):
    of, zeros = loop(), [Fraction(0)] * 3
    box, none = [[value / 16 for value in row] for row in some_box(10)], truth_drift._Noise(Fraction(0), Fraction(0))
    slope = 2 * Fraction(1, 100) / of.dt
    monkeypatch.setattr(truth_drift, "slope_of_T", lambda *_: [slope / 2, slope, slope / 3])
    assert truth_drift._kinematic_error(of, QUIET, box, none, zeros, zeros)
    slope *= Fraction(10**9 + 1, 10**9)
    with pytest.raises(Refusal, match="a sample is too long for the rates"):
        truth_drift._kinematic_error(of, QUIET, box, none, zeros, zeros)


# -- single precision --


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


# -- the inequalities --


def ball(middle: list[list[Any]], radius: list[list[Any]]) -> dissipation.Ball:
    return dissipation.Ball(*([[Fraction(value) for value in row] for row in half] for half in (middle, radius)))


def test_a_ball_is_definite_where_its_proof_is_no_equality():
    one = Fraction(1)
    for off, definite in ((one - Fraction(1, 2**62), True), (one - Fraction(1, 2**63), False), (2 * one, False)):
        assert ball([[1]], [[off]]).is_positive_definite() is definite
    for off, definite in ((one / 2, True), (one, False)):
        assert ball([[1, 0], [0, 1]], [[0, 0], [0, off]]).is_positive_definite() is definite
    assert ball([[4, 0], [0, 16]], [[3, 0], [0, 12]]).is_positive_definite()
    assert not ball([[4, 2], [2, 16]], [[3, 0], [0, 12]]).is_positive_definite()
    for i, j in ((0, 1), (1, 0)):
        radius = [[Fraction(0)] * 2 for _ in range(2)]
        radius[i][j] = Fraction(3, 2)
        assert not ball([[1, 0], [0, 1]], radius).is_positive_definite()
    tiny = Fraction(1, 10**30)
    assert not ball([[1, 1], [1, 1]], [[tiny] * 2] * 2).is_positive_definite()
    assert ball([[1, 1], [1, 1 + tiny]], [[0, 0], [0, 0]]).is_positive_definite()  # exactly, which no double tells


def test_any_congruence_proves_and_none_proves_more(monkeypatch):
    """With W the identity the numbers of the last comparison are those of the ball."""
    monkeypatch.setattr(np.linalg, "cholesky", lambda M: np.eye(len(M)))
    flat = [[Fraction(1)] * 3] * 3
    for diagonal, definite in ((Fraction(7), True), (Fraction(9, 2), False)):
        middle = [[diagonal if i == j else Fraction(1) for j in range(3)] for i in range(3)]
        assert dissipation.Ball(middle, flat).is_positive_definite() is definite
    assert not ball([[3, 2, 2], [2, 3, 2], [2, 2, 3]], [[0, 0, 0], [0, 0, 0], [0, 0, 1]]).is_positive_definite()


def test_a_shorter_ball_holds_the_longer_one():
    third, unit = Fraction(1, 3), Fraction(1, 2**96)
    found = dissipation._shorten(ball([[third, -third]], [[0, third]]))
    assert found.radius == [[unit, third + unit]]
    assert found.middle == [[rational.round_up(third, 96), rational.round_up(-third, 96)]]
    assert 0 < found.middle[0][0] - third < unit


def test_a_product_of_balls_holds_all_products_of_their_members():
    A, B = ball([[1, -2]], [[0.25, 0.5]]), ball([[-3], [0.5]], [[0.125], [2]])
    found = dissipation.ball_product(A, B)
    assert found.middle == [[-4]]
    assert found.radius == [[0.125 + 4 + 0.75 + 0.25 + 0.03125 + 1]]


def test_the_form_of_exact_numbers_is_exact():
    level, zero = Fraction(5, 4), Fraction(0)
    slow = dissipation.rate_bounded_inequalities(level, slow_evidence())
    constrained = constrained_evidence()
    forms = [dissipation.gain_inequality(level, evidence) for evidence in (gain_evidence(), constrained)]
    for form in (*slow, *forms, dissipation.stability_inequality(constrained)):
        assert not any(map(any, form.radius))
        assert rational.is_symmetric(form.middle)
    numbers = dissipation.widen([[Fraction(2), zero], [Fraction(-8), Fraction(4)]], Fraction(1, 64))
    assert numbers.radius == [[Fraction(1, 8), Fraction(1, 16)], [Fraction(1, 8), Fraction(1, 8)]]


@pytest.mark.parametrize(
    ("row", "column", "words"),
    [
        (0, 0, "block s sees at once what a later part"),
        (1, 1, "block s sees at once"),
        (1, 2, "block s sees at once what a later part or a parameter"),
        (0, 5, "block s sees at once"),
        (4, 2, "block d sees at once"),
        (4, 4, "block d sees at once"),
        (4, 5, "block d sees at once"),
        (5, 5, "block c sees at once"),
        (3, 0, "input of block v may jump"),
        (3, 7, "input of block v may jump"),
        (5, 4, ""),
        (5, 3, ""),
        (4, 1, ""),
        (2, 2, ""),
        (2, 5, ""),
        (0, 6, ""),
    ],
)
def test_a_part_sees_at_once_the_outputs_of_earlier_parts_alone(row, column, words):
    evidence = constrained_evidence()
    evidence["system"]["D"][row][column] = 2.0**-60
    if words:
        with pytest.raises(Refusal, match=words):
            dissipation.stability_inequality(evidence)
    else:
        dissipation.stability_inequality(evidence)


@pytest.mark.parametrize("row", [0, 1])
def test_no_channel_of_a_varying_delay_may_jump(row):
    block = {"name": "v", "size": 2, "kind": "varying delay", "largest": 0.5, "X": symmetric(2, 1)}
    made = {**lft_evidence(2), "stability": symmetric(3, 5), "blocks": [block]}
    made["system"]["D"] = [[0.0, 0.0, float(i == row), 0.0] for i in range(4)]
    with pytest.raises(Refusal, match="input of block v may jump"):
        dissipation.stability_inequality(made)


def test_no_rounding_lets_a_part_see_what_it_does_not():
    """A zero of its rows of D is none of rounding's; in those of a parameter it is."""
    system_of = dissipation._System(constrained_evidence(), Fraction(1, 64))
    D = constrained_evidence()["system"]["D"]
    wide = system_of._keep_zeros(dissipation.widen(rational.to_rational(D), Fraction(1, 64)))
    for i, row in enumerate(D):
        for value, off in zip(row, wide.radius[i], strict=True):
            assert (off > 0) is (bool(value) or i in (2, 6, 7))


@pytest.mark.parametrize("name", "ABCD")
@pytest.mark.parametrize("less", ["a row", "a column", "a number"])
def test_matrices_of_wrong_shapes_are_refused(name, less):
    evidence = gain_evidence()
    M = evidence["system"][name]
    evidence["system"][name] = {
        "a row": M[:-1],
        "a column": [row[:-1] for row in M],
        "a number": [*M[:-1], M[-1][:-1]],
    }[less]
    with pytest.raises(ValueError, match=r"wrong shapes|different lengths"):
        dissipation.gain_inequality(Fraction(1), evidence)


@pytest.mark.parametrize(("inputs", "outputs"), [(2, 3), (3, 2)])
def test_delta_has_no_more_channels_than_the_system(inputs, outputs):
    evidence = gain_evidence()
    matrices = evidence["system"]
    matrices["B"] = [row[:inputs] for row in matrices["B"]]
    matrices["C"], matrices["D"] = matrices["C"][:outputs], [row[:inputs] for row in matrices["D"][:outputs]]
    with pytest.raises(ValueError, match="wrong shapes"):
        dissipation.gain_inequality(Fraction(1), evidence)


def test_a_loop_may_have_one_channel_and_no_other_signal():
    block = {"name": "v", "size": 1, "kind": "varying delay", "largest": 0.5, "X": [[1.0]]}
    matrices = {"A": [[-1.0]], "B": [[0.5]], "C": [[1.0]], "D": [[0.0]]}
    made = {"system": matrices, "coordinates": [[1.0]], "stability": [[1.0]], "blocks": [block]}
    assert dissipation.stability_inequality(made).is_positive_definite()
    (form,) = dissipation._System(made, Fraction(0)).constraint_terms([block])  # (p / 2 - x)^2 / 4 - p^2
    assert form.middle == [[Fraction(1, 4), Fraction(-1, 8)], [Fraction(-1, 8), Fraction(-15, 16)]]


ONE, PAIR = [Fraction(1)], [Fraction(1)] * 2
SMALL = [[value / 64 for value in row] for row in some_box(10)]


def judged_system() -> dissipation._System:
    return dissipation._System(constrained_evidence(), Fraction(0))


@pytest.mark.parametrize(
    "compare",
    [
        lambda: estimate_box.check_box(loop(), QUIET, SMALL, SMALL[:2]),
        lambda: estimate_box.check_box(loop(), QUIET, SMALL, [row[:-1] for row in SMALL]),
        lambda: estimate_box._weigh(ONE, PAIR),
        lambda: single_precision._weigh(ONE, PAIR),
        lambda: single_precision._is_below([ONE], [ONE, ONE]),
        lambda: single_precision._is_below([ONE], [PAIR]),
        lambda: single_precision._is_rate_sum_exact(
            loop(rate_limit=loop().rate_limit._replace(limits=(Fraction(100),) * 2)),
            QUIET,
            SMALL,
            Form(frozenset(), Fraction(0), [Fraction(0)] * 9),
        ),
        lambda: dissipation.widen([PAIR, ONE], Fraction(1, 64)),
        lambda: dissipation._join(ball([[1], [1]], [[0]]), ball([[1]], [[0]])),
        lambda: dissipation._join(ball([[1]], [[0], [0]]), ball([[1]], [[0]])),
        lambda: judged_system()._keep_zeros(ball([[1] * 8] * 8, [[0] * 8] * 5)),
        lambda: judged_system()._keep_zeros(ball([[1] * 8] * 8, [[0] * 7] * 8)),
        lambda: list(judged_system().constraint_terms(PARTS[:-1])),
        lambda: evidence._check_multipliers(lag_evidence(), []),
        lambda: quadratic_constraints._real_form({}, {"D": [[1.0, 0.0], [0.0, 1.0]], "G": [[0.0, 0.0]]}),
        lambda: quadratic_constraints._real_form({}, {"D": [[1.0, 0.0], [0.0, 1.0]], "G": [[0.0], [0.0]]}),
        lambda: quadratic_constraints._repeat([ONE], ONE, PAIR, 1),
        lambda: truth_drift.blind_angles(loop(), PAIR, 1),
        lambda: truth_drift._over_inertia(loop(), PAIR * 2),
        lambda: truth_drift._turn(PAIR, ONE, lambda *_: ONE),
        lambda: truth_drift._turn([Fraction(1, 8)], [Fraction(1, 8)], lambda *_: PAIR),
        lambda: truth_drift._tilt([Fraction(0)] * 3, PAIR * 2),
    ],
)
def test_no_row_is_compared_or_added_up_to_the_length_of_a_shorter_one(compare):
    with pytest.raises(ValueError, match="zip"):
        compare()


def test_corners_of_slow_parameters_take_every_sign():
    assert list(dissipation.vertices(1)) == [((-1,), (-1,)), ((-1,), (1,)), ((1,), (-1,)), ((1,), (1,))]
    assert len(set(dissipation.vertices(2))) == 16
    terms = [[[Fraction(10**k)]] for k in range(4)]
    assert dissipation.corner(terms, (-1, 1)) == [[1 - 10 + 100 - 1000]]
    assert dissipation.corner(terms, (-1, -1)) == [[1 - 10 - 100 + 1000]]
    for count in (3, 5):
        with pytest.raises(ValueError, match="a term for each set"):
            dissipation.corner((terms * 2)[:count], (1, 1))


def seen(block: dict[str, Any], s: complex, q: Wave, p: Wave) -> float:
    """Return the form of a part for waves q and p, with its filter at s."""
    filter_of = quadratic_constraints.make_filter(block)
    A, B, M = (
        np.array(rows, dtype=float)
        for rows in (filter_of.A, filter_of.B, quadratic_constraints.constraint_form(block, block))
    )
    waves = np.concatenate([q, p])
    signals = np.concatenate([np.linalg.solve(s * np.eye(len(A)) - A, B @ waves), waves])
    return float((signals.conj() @ M @ signals).real)


def test_forms_with_two_poles_are_those_of_their_formulas():
    """Of slope and delay, by frequency, for waves of two channels."""
    q, p = np.array([1.0 + 0.5j, -0.25j]), np.array([0.5, 0.75 - 0.25j])
    slope = {**PARTS[0], "poles": [0.5, 3.0], "causal": [[0.25, -0.5], [0.5, 0.125]]}
    slope["anticausal"] = [[0.125, 0.0625], [-0.25, 0.75]]
    delay = {**PARTS[3], "size": 2, "poles": [0.5, 3.0], "X": symmetric(6, 1), "Y": symmetric(6, 2)}
    for omega in (0.0625, 0.5, 4.0):
        s = 1j * omega
        F, e = [a / (s + a) for a in slope["poles"]], q - p
        sums = np.array(slope["T"]) * p.conj() * e
        for each, c, d in zip(F, slope["causal"], slope["anticausal"], strict=True):
            sums = sums - c * p.conj() * each * e - d * e.conj() * each * p
        assert seen(slope, s, q, p) == pytest.approx(2.0 * np.sum(sums).real)
        lag, lead, z = float(quadratic_constraints.LAG), float(quadratic_constraints.LEAD), s * delay["largest"]
        W = z * (2.0 * lead * z + 1.0) / (lead * z**2 + lag * z + 1.0)
        covered, plain, late = (np.concatenate([wave, *(each * wave for each in F)]) for wave in (W * q, q, p))
        X, Y = np.array(delay["X"]), np.array(delay["Y"])
        expected = covered.conj() @ X @ covered - late.conj() @ (X + Y) @ late - 2.0 * late.conj() @ Y @ plain
        assert seen(delay, s, q, p) == pytest.approx(expected.real)


@pytest.mark.parametrize(
    ("part", "changes", "words"),
    [
        (1, {"G": [[0.5]]}, "G of block r is not skew"),
        (1, {"size": 2, "D": [[1.0, 0.5], [0.5, 1.0]], "G": [[0.0, 0.5], [-0.5, 0.0]]}, None),
        (1, {"G": [[0.0], [0.0]]}, "scalings of block r do not have its size"),
        (3, {}, None),
        (3, {"X": [[1.0]]}, "X of block d does not have its size"),
        (4, {"T": [0.0]}, "T of block c is not positive"),
        (0, {"causal": [[1.875, 0.0]]}, None),
        (0, {"causal": [[1.0, 1.4375]]}, None),
        (0, {"causal": [[1.0, 1.5]]}, "larger than the slope allows"),
        (0, {"odd": False}, "causal of block s is negative"),
        (0, {"odd": False, "causal": [[0.25, 0.0]]}, None),
        (
            0,
            {"odd": False, "poles": [0.5, 3.0], "causal": [[0.25, 0.5], [0.0, -0.25]]},
            "causal of block s is negative",
        ),
        (0, {"odd": False, "causal": [[0.0, 0.5]], "anticausal": [[0.5, -0.5]]}, "anticausal of block s is negative"),
    ],
)
def test_multipliers_are_those_that_the_part_allows(part, changes, words):
    block = {**PARTS[part], **changes}
    if words is None:
        quadratic_constraints.check_multipliers(block, block)
    else:
        with pytest.raises(Refusal, match=words):
            quadratic_constraints.check_multipliers(block, block)


# -- the evidence of a gain --


def lag_evidence(**changes: Any) -> dict[str, Any]:
    """Return a proof that `x' = -(1 + delta / 2) x + w`, z = x, has a gain below 4; it is 2."""
    block = {"name": "rate", "size": 1, "D": [[1.0]], "G": [[0.0]]}
    matrices = {"A": [[-1.0]], "B": [[-0.5, 1.0]], "C": [[1.0], [1.0]], "D": [[0.0, 0.0], [0.0, 0.0]]}
    common = {"kind": "gain", "level": 4.0, "system": matrices, "coordinates": [[1.0]], "P": [[2.0]]}
    return {**common, "blocks": [block], **changes}


def slow_lag_evidence(**changes: Any) -> dict[str, Any]:
    evidence = lag_evidence(kind="slow gain", P=[[[2.0]], [[0.0]]], Y=[[0.0] * 3])
    block = evidence["blocks"][0]
    scalings = [[{"D": block.pop("D"), "G": block.pop("G")}]] * 4
    return {**evidence, "blocks": [{**block, "speed": 1.0}], "vertices": scalings, **changes}


def late_lag_evidence(kind: str = "sector", **changes: Any) -> dict[str, Any]:
    """Return a proof about `x' = -x + p / 2 + w`, z = x, with p a function of x in a sector or of slopes in [0, 1]."""
    block: dict[str, Any] = {"name": "part", "size": 1, "kind": kind, "T": [1.0]}
    if kind == "slope":
        block |= {"odd": True, "poles": [], "causal": [], "anticausal": []}
    matrices = {"A": [[-1.0]], "B": [[0.5, 1.0]], "C": [[1.0], [1.0]], "D": [[0.0, 0.0], [0.0, 0.0]]}
    return lag_evidence(kind="constrained gain", system=matrices, stability=[[1.0]], blocks=[block]) | changes


LAG_LOOP = evidence.DerivedLoop(system=lag_evidence()["system"], blocks=[("rate", 1)], speeds=[None], parts=[{}])


def test_evidence_proves_what_it_says_it_proves():
    found = evidence.check_evidence(lag_evidence())
    assert found.reason == (
        "the L2 gain from w to z is below 4 for every normalised Delta(t) of rate: the matrix inequality holds exactly"
    )
    assert (found.accepted, found.figures) == (True, {"gain": 4.0})
    assert found.assumes == {
        "plant": "the continuous linear system of the evidence, closed by Delta",
        "system_sha256": evidence.seal(lag_evidence()["system"]),
        "blocks": ["rate x 1"],
        "speeds_per_s": [None],
    }
    found = evidence.check_evidence(slow_lag_evidence())
    assert "of rate, with speeds of rate below 1 1/s: the matrix" in found.reason
    assert found.assumes["speeds_per_s"] == [1.0]
    blocks = [{"name": "fast", "speed": None}, {"name": "slow", "speed": 0.5}]
    said = evidence._state_gain(Fraction(4), {"blocks": blocks})
    assert "every normalised Delta(t) of fast, slow, with speeds of slow below 0.5 1/s: the matrix" in said
    found = evidence.check_evidence(late_lag_evidence())
    sector = "part: functions phi(q, t) of each channel between 0 and q"
    assert found.assumes["parts"] == [sector]
    assert f"is below 4 for {sector}: the matrix" in found.reason
    found = evidence.check_evidence(late_lag_evidence("slope"))
    assert found.assumes["parts"] == ["part: odd functions phi(q) of each channel with slopes in [0, 1]"]
    plain = late_lag_evidence("slope")
    plain["blocks"][0]["odd"] = False
    assert evidence.check_evidence(plain).assumes["parts"] == [
        "part: functions phi(q) of each channel with slopes in [0, 1]"
    ]
    both = late_lag_evidence()
    both["blocks"] = [{"name": "rate", "size": 1, "D": [[1.0]], "G": [[0.0]]}, *both["blocks"]]
    both["system"] = {
        "A": [[-1.0]],
        "B": [[0.0, 0.5, 1.0]],
        "C": [[0.0], [1.0], [1.0]],
        "D": [[0.0] * 3] * 3,
    }
    assert f"for every normalised Delta(t) of rate, and {sector}" in evidence.check_evidence(both).reason


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: lag_evidence(kind="constrained gain"), "other entries: stability$"),
        (lambda: lag_evidence(kind="slow gain"), "other entries: Y, vertices$"),
        (lambda: lag_evidence(more=1), "other entries: more$"),
        (lambda: lag_evidence(blocks=[]), "names no block"),
        (lambda: lag_evidence(level=0), "level is not positive"),
        (lambda: lag_evidence(level=1.99), "the matrix inequality does not hold"),
        (lambda: lag_evidence(P=[[0.0]]), "P is not positive definite"),
        (lambda: lag_evidence(blocks=[{"name": "rate", "size": 0}]), "size 0, must be"),
        (lambda: lag_evidence(blocks=[{"name": "rate", "size": True}]), "size True, must be"),
        (lambda: lag_evidence(blocks=[{"name": "rate", "size": 1.0}]), "size 1.0, must be"),
        (lambda: lag_evidence(blocks=[{"name": "", "size": 1}]), "must have a name"),
        (lambda: lag_evidence(blocks=[{"name": "a b", "size": 1}]), "must have a name"),
        (lambda: lag_evidence(blocks=[{"name": 33 * "a", "size": 1}]), "must have a name"),
        (lambda: lag_evidence(blocks=late_lag_evidence()["blocks"]), "real parameters alone"),
        (
            lambda: slow_lag_evidence(blocks=[{"name": "rate", "size": 1, "speed": 1.0, "D": 1}]),
            "than name, size, speed",
        ),
        (lambda: slow_lag_evidence(blocks=[{"name": "rate", "size": 1, "speed": -1.0}]), "speed is negative"),
        (lambda: slow_lag_evidence(P=[[[2.0]], [[2.0]]]), r"P is not positive definite at the corner \(-1,\)"),
        (lambda: slow_lag_evidence(P=[[[2.0]], [[-2.0]]]), r"P is not positive definite at the corner \(1,\)"),
        (lambda: slow_lag_evidence(level=1.99), r"does not hold at the corner \(-1,\), speeds \(-1,\)"),
        (lambda: late_lag_evidence(stability=[[0.0]]), "matrix of stability is not positive definite"),
        (lambda: late_lag_evidence(system={**late_lag_evidence()["system"], "A": [[1.0]]}), "is not proved stable"),
        (lambda: late_lag_evidence(level=0.99), "the matrix inequality does not hold"),
    ],
)
def test_evidence_that_proves_nothing_is_refused(made, words):
    with pytest.raises(Refusal, match=words):
        evidence.check_evidence(made())


@pytest.mark.parametrize("make", [lag_evidence, late_lag_evidence])
def test_scalings_that_are_none_are_refused(make):
    wrong = make()
    wrong["blocks"][0] |= {"D": [[-1.0]]} if make is lag_evidence else {"T": [-1.0]}
    with pytest.raises(Refusal, match="not positive"):
        evidence.check_evidence(wrong)
    if make is lag_evidence:
        slow = slow_lag_evidence()
        slow["vertices"] = [*slow["vertices"][:3], [{"D": [[-1.0]], "G": [[0.0]]}]]
        with pytest.raises(Refusal, match="not positive"):
            evidence.check_evidence(slow)


def test_an_entry_more_or_less_than_there_are_blocks_corners_and_speeds_is_refused():
    slow = slow_lag_evidence()
    four, item = slow["vertices"], slow["vertices"][0][0]
    for vertices in (four[:3], [*four, four[0]], [[]] * 4, [[item, item]] * 4):
        with pytest.raises(ValueError, match="zip"):
            evidence.check_evidence({**slow, "vertices": vertices})
    for changes in ({"speeds": []}, {"parts": []}, {"speeds": [None, None]}, {"parts": [{}, {}]}):
        with pytest.raises(ValueError, match="zip"):
            evidence.check_evidence(lag_evidence(), LAG_LOOP._replace(**changes))


def two_blocks(**second: Any) -> list[dict[str, Any]]:
    return [{"name": "a", "size": 1, "speed": 1.0}, {"name": "b", "size": 1, "speed": 1.0, **second}]


def test_one_block_of_two_that_is_none_is_refused():
    with pytest.raises(Refusal, match="than name, size, speed"):
        evidence.check_evidence(slow_lag_evidence(blocks=two_blocks(D=[[1.0]])))
    with pytest.raises(Refusal, match="speed is negative"):
        evidence.check_evidence(slow_lag_evidence(blocks=two_blocks(speed=-1.0)))
    mixed = [*lag_evidence()["blocks"], *late_lag_evidence()["blocks"]]
    with pytest.raises(Refusal, match="real parameters alone"):
        evidence.check_evidence(lag_evidence(blocks=mixed))
    with pytest.raises(Refusal, match="unknown kind of evidence 'oath'"):
        evidence.check_evidence(lag_evidence(kind="oath"))


@pytest.mark.parametrize(("speed", "taken"), [(0.5, True), (1.0, True), (1.0 + 2.0**-50, False), (None, False)])
def test_a_derived_loop_is_no_faster_than_its_evidence(speed, taken):
    of = LAG_LOOP._replace(speeds=[speed])
    assert evidence.check_evidence(lag_evidence(), of).accepted
    if taken:
        assert evidence.check_evidence(slow_lag_evidence(), of).accepted
    else:
        with pytest.raises(Refusal, match="rate of the derived loop is faster"):
            evidence.check_evidence(slow_lag_evidence(), of)


def test_a_derived_loop_has_the_parts_of_its_evidence():
    of = evidence.DerivedLoop(late_lag_evidence()["system"], [("part", 1)], [None], [{"kind": "slope", "odd": True}])
    with pytest.raises(Refusal, match="part of the derived loop is more than the evidence allows"):
        evidence.check_evidence(late_lag_evidence(), of)
    assert evidence.check_evidence(late_lag_evidence("slope"), of).accepted


def test_numbers_of_the_evidence_itself_are_exact(monkeypatch):
    shares = []
    names = ("gain_inequality", "rate_bounded_inequalities", "stability_inequality")
    for name in names:
        made = getattr(evidence, name)
        monkeypatch.setattr(evidence, name, lambda *given, made=made: shares.append(given[-1]) or made(*given))
    for make in (lag_evidence, slow_lag_evidence, late_lag_evidence):
        assert evidence.check_evidence(make()).accepted
    assert shares == [0] * 4


def test_a_parameter_that_rests_is_slow_and_each_corner_has_its_proof():
    rests = slow_lag_evidence()
    rests["blocks"][0]["speed"] = 0.0
    assert evidence.check_evidence(rests).accepted
    for at in range(4):
        scalings = [dict(D=[[1.0 if k != at else 9.0]], G=[[0.0]]) for k in range(4)]
        with pytest.raises(Refusal, match="does not hold at the corner"):
            evidence.check_evidence(slow_lag_evidence(vertices=[[item] for item in scalings]))


@pytest.mark.parametrize("name", ["a", "A_1", "x.y-z", 32 * "a"])
def test_a_word_is_a_name(name):
    assert evidence.is_name(name)
    assert not any(map(evidence.is_name, (f"{name} ", f"{name}\n", f"{name}:", 32 * name + "a", [name], None)))


def test_a_derived_loop_is_the_one_of_its_evidence():
    found = evidence.check_evidence(lag_evidence(system=None), LAG_LOOP)
    assert found.assumes["plant"] == (
        "the continuous linear system derived from the design, and all within its rounding, closed by Delta"
    )
    assert found.assumes["system_sha256"] == evidence.seal(LAG_LOOP.system)
    for blocks in ([("rate", 2)], [("other", 1)], []):
        with pytest.raises(Refusal, match="about other parameters"):
            evidence.check_evidence(lag_evidence(), LAG_LOOP._replace(blocks=blocks))
    wide = {**LAG_LOOP.system, "A": [[-0.5]]}
    with pytest.raises(Refusal, match="does not hold"):
        evidence.check_evidence(lag_evidence(), LAG_LOOP._replace(system=wide))


def test_every_kind_of_proof_covers_the_rounding_of_a_derived_loop(monkeypatch):
    monkeypatch.setattr(evidence, "ROUNDING", Fraction(1, 2))  # as much as no evidence here bears
    loops = {
        lag_evidence: LAG_LOOP,
        slow_lag_evidence: LAG_LOOP._replace(speeds=[1.0]),
        late_lag_evidence: LAG_LOOP._replace(
            system=late_lag_evidence()["system"], blocks=[("part", 1)], parts=[{"kind": "sector"}]
        ),
    }
    for make, of in loops.items():
        with pytest.raises(Refusal, match=r"does not hold|not proved stable"):
            evidence.check_evidence(make(), of)
    monkeypatch.setattr(evidence, "ROUNDING", Fraction(1, 2**40))
    for make, of in loops.items():
        assert evidence.check_evidence(make(), of).accepted


@pytest.mark.parametrize(
    ("block", "part", "covered"),
    [
        ({}, {}, True),
        ({"kind": "real"}, {}, True),
        ({}, {"kind": "sector"}, False),
        ({"kind": "sector"}, {"kind": "slope", "odd": True}, False),
        ({"kind": "slope", "odd": True}, {"kind": "slope", "odd": True}, True),
        ({"kind": "slope", "odd": True}, {"kind": "slope", "odd": False}, False),
        ({"kind": "slope", "odd": False}, {"kind": "slope", "odd": True}, True),
        ({"kind": "delay", "largest": 0.5}, {"kind": "delay", "largest": 0.5}, True),
        ({"kind": "delay", "largest": 0.5}, {"kind": "delay", "largest": 0.25}, True),
        ({"kind": "delay", "largest": 0.5}, {"kind": "delay", "largest": 0.5 + 2.0**-50}, False),
    ],
)
def test_a_part_is_covered_by_its_own_kind_if_it_is_no_larger(block, part, covered):
    assert evidence._covers(block, part) is covered


def test_delays_are_described_by_what_they_may_do():
    block = {"name": "d", "kind": "delay", "largest": 0.25}
    assert evidence._describe_part(block) == "d: every constant delay of all its channels in [0, 0.25] s"
    varies = evidence._describe_part({**block, "kind": "varying delay"})
    assert varies == "d: every delay of all its channels that varies at will in [0, 0.25] s"


def test_a_file_is_sealed_and_holds_evidence_alone():
    def judge(document: Any) -> evidence.CheckResult:
        return evidence.check_certificate(json.dumps(document))

    made: dict[str, Any] = {"format": evidence.FORMAT, "evidence": lag_evidence()}
    assert judge({**made, "seal": evidence.seal(made)}).accepted
    assert evidence.seal({"b": [1.5], "a": "\u00e4"}) == hashlib.sha256(b'{"a":"\\u00e4","b":[1.5]}').hexdigest()
    more = {**made, "claim": 1}
    for document, words in (
        ([], "format is not"),
        ({**made, "format": "other"}, "format is not"),
        (made, "seal does not fit"),
        ({**more, "seal": evidence.seal(more)}, "evidence alone"),
    ):
        found = judge(document)
        assert (found.accepted, words in found.reason) == (False, True)
    for text in ("", "[" * 100_000, '{"format": "gustproof-certificate-1", "evidence": 1', json.dumps(made)[:-1]):
        found = evidence.check_certificate(text)
        assert (found.accepted, found.reason[:26]) == (False, "the evidence is malformed:")
    for text, words in (('{"a": NaN}', "NaN is no number"), ('{"a": 1, "a": 1}', "a key stands twice")):
        assert evidence.check_certificate(text).reason.startswith(words)
    box = {"format": evidence.FORMAT, "evidence": {"kind": "boundedness"}}
    text = json.dumps({**box, "seal": evidence.seal(box)})
    for files in ({}, {"law": ""}, {"vehicle": ""}):
        assert "give both" in evidence.check_certificate(text, **files).reason
    assert "the law file is not the one" in evidence.check_certificate(text, law="", vehicle="").reason
    chance = {"format": evidence.FORMAT, "evidence": {"kind": evidence.CHANCE}}
    text, names = json.dumps({**chance, "seal": evidence.seal(chance)}), ("law", "vehicle", "scenario")
    for missing in names:
        files = {name: "" for name in names if name != missing}
        assert "give all three" in evidence.check_certificate(text, **files).reason
    assert "give all three" not in evidence.check_certificate(text, **dict.fromkeys(names, "")).reason


def test_a_verdict_stands_and_is_asked_for_by_name():
    with pytest.raises(TypeError, match="positional"):
        evidence.check_certificate("", "law")
    with pytest.raises(TypeError, match="positional"):
        evidence.CheckResult(False, "refused")
    found = evidence.check_certificate("")
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.accepted = True
    assert not hasattr(found, "__dict__")


if __name__ == "__main__":
    parts = {part: dict(made) for output in (None, *SAMPLES) for part, made in figures(output).items()}
    PINNED.write_text(json.dumps(flat(parts), indent=1) + "\n", encoding="utf-8")
