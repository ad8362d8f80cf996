"""Edges of the proof of a gain: what proves is taken at equality, and nothing that proves less is taken."""

import dataclasses
import hashlib
import json
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from gustproof.checker import (
    dissipation,
    evidence,
    quadratic_constraints,
    rational,
)
from gustproof.checker.system import Refusal

Wave = np.ndarray[Any, np.dtype[np.complex128]]


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


def judged_system() -> dissipation._System:
    return dissipation._System(constrained_evidence(), Fraction(0))


@pytest.mark.parametrize(
    "compare",
    [
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
        "the L2 gain of the system in this certificate from w to z is below 4 for every normalised Delta(t) of 'rate': "
        "the matrix inequality holds exactly"
    )
    assert (found.accepted, found.figures) == (True, {"gain": 4.0})
    assert found.assumes == {
        "plant": "the continuous linear system of the evidence, bound to no design or law, closed by Delta",
        "system_sha256": evidence.seal(lag_evidence()["system"]),
        "blocks": ["rate x 1"],
        "speeds_per_s": [None],
    }
    found = evidence.check_evidence(slow_lag_evidence())
    assert "of 'rate', with speeds of 'rate' below 1 1/s: the matrix" in found.reason
    assert found.assumes["speeds_per_s"] == [1.0]
    blocks = [{"name": "fast", "speed": None}, {"name": "slow", "speed": 0.5}]
    said = evidence._state_gain(Fraction(4), {"blocks": blocks}, "a loop")
    assert "every normalised Delta(t) of 'fast', 'slow', with speeds of 'slow' below 0.5 1/s: the matrix" in said
    found = evidence.check_evidence(late_lag_evidence())
    sector = "'part': functions phi(q, t) of each channel between 0 and q"
    assert found.assumes["parts"] == [sector]
    assert f"is below 4 for {sector}: the matrix" in found.reason
    found = evidence.check_evidence(late_lag_evidence("slope"))
    assert found.assumes["parts"] == ["'part': odd functions phi(q) of each channel with slopes in [0, 1]"]
    plain = late_lag_evidence("slope")
    plain["blocks"][0]["odd"] = False
    assert evidence.check_evidence(plain).assumes["parts"] == [
        "'part': functions phi(q) of each channel with slopes in [0, 1]"
    ]
    both = late_lag_evidence()
    both["blocks"] = [{"name": "rate", "size": 1, "D": [[1.0]], "G": [[0.0]]}, *both["blocks"]]
    both["system"] = {
        "A": [[-1.0]],
        "B": [[0.0, 0.5, 1.0]],
        "C": [[0.0], [1.0], [1.0]],
        "D": [[0.0] * 3] * 3,
    }
    assert f"for every normalised Delta(t) of 'rate', and {sector}" in evidence.check_evidence(both).reason


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
    assert evidence._describe_part(block) == "'d': every constant delay of all its channels in [0, 0.25] s"
    varies = evidence._describe_part({**block, "kind": "varying delay"})
    assert varies == "'d': every delay of all its channels that varies at will in [0, 0.25] s"


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
