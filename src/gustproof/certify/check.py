"""The judge: accepts or refuses a certificate's evidence in exact arithmetic, with the standard library only.

It knows no solver, no design and no law: it multiplies and factors matrices of rational numbers. What it proves is a
statement about the numbers in the evidence; that these are those of a vehicle and a law is for the maker to show.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from gustproof.certify.enclosure import SIGNALS, Norms, axis_norms, mapped
from gustproof.numerics.rational import (
    Rational,
    add,
    exact,
    exp_below,
    identity,
    is_positive_definite,
    multiply,
    scale,
    transpose,
)

FORMAT = "gustproof-certificate-1"


class Refusal(Exception):
    """The evidence does not prove the claim; the text names the condition that failed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What the check found."""

    accepted: bool
    """Whether the evidence proves the claim."""
    reason: str
    """What was proved, or the condition that failed."""


def check(certificate_json: str) -> Verdict:
    """Return whether the evidence of a certificate, given as the text of its file, proves its claim.

    The seal must fit, so that one changed digit anywhere is refused, even one that would leave the proof standing.
    Any text gets a verdict; nothing is raised.
    """
    try:
        document = json.loads(certificate_json)
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise Refusal(f"format is not '{FORMAT}'")
        claimed = document.pop("seal", None)
        if claimed != seal(document):
            raise Refusal("the seal does not fit: something was changed after the certificate was made")
        if document["proven"] is not True:
            raise Refusal("the certificate does not claim to be proven")
        return judge(document["gain"], document["evidence"])
    except Refusal as refusal:
        return Verdict(accepted=False, reason=str(refusal))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, ZeroDivisionError, OverflowError) as error:
        return Verdict(accepted=False, reason=f"the evidence is malformed: {type(error).__name__}: {error}")
    except RecursionError:
        return Verdict(accepted=False, reason="the evidence is malformed: nested too deeply")


def judge(level: float, evidence: dict[str, Any]) -> Verdict:
    """Return whether `evidence` proves `level`, before it is sealed in a certificate.

    Raises
    ------
    Refusal
        If it does not.
    """
    if evidence["kind"] not in _PROOFS:
        raise Refusal(f"unknown kind of evidence '{evidence['kind']}'")
    return Verdict(accepted=True, reason=_PROOFS[evidence["kind"]](Fraction(level), evidence))


def seal(document: dict[str, Any]) -> str:
    """Return the SHA-256 of a document of JSON values, whatever its layout and the order of its keys."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()


def gain_inequality(level: Fraction, evidence: dict[str, Any]) -> Rational:
    """Return the matrix that is positive definite only if the L2 gain from w to z is below `level`.

    The system `x' = A x + B (p, w)`, `(q, z) = C x + D (p, w)` is closed by `p = Delta(t) q`, where Delta holds real
    numbers `|delta_i(t)| <= 1`, each times an identity, that change as fast as they like. With P and each `D_i`
    positive definite and each `G_i` skew, along every trajectory

        V' + |z|^2 - level^2 |w|^2 + sum_i (q_i' D_i q_i - p_i' D_i p_i + 2 q_i' G_i p_i) < 0,  V = x' P x,

    and no term of the sum is negative, for `q_i' G_i q_i = 0`. The matrix is minus this form in (x, p, w); that it is
    positive definite makes the loop well posed and exponentially stable too.

    References
    ----------
    C. Scherer, LPV control and full block multipliers, Automatica 37 (2001), 361-375 (D-G scalings are the multipliers
    of repeated real parameters).
    """
    A, B, C, D = (exact(evidence["system"][name]) for name in "ABCD")
    P = _lyapunov(evidence)
    blocks = evidence["blocks"]
    k = sum(item["size"] for item in blocks)
    n, m = len(A), len(D[0])
    x_and_input = [a + b for a, b in zip(A, B, strict=True)]
    states = transpose(identity(n + m)[:n])
    stored = multiply(states, multiply(P, x_and_input))
    output = [c + d for c, d in zip(C, D, strict=True)]
    q, z = output[:k], output[k:]
    p, w = identity(n + m)[n : n + k], identity(n + m)[n + k :]
    form = add(stored, transpose(stored), multiply(transpose(z), z), scale(-level * level, multiply(transpose(w), w)))
    start = 0
    for item in blocks:
        rows = slice(start, start + item["size"])
        D_i, G_i = exact(item["D"]), exact(item["G"])
        cross = multiply(transpose(q[rows]), multiply(G_i, p[rows]))
        form = add(
            form,
            multiply(transpose(q[rows]), multiply(D_i, q[rows])),
            scale(-1, multiply(transpose(p[rows]), multiply(D_i, p[rows]))),
            cross,
            transpose(cross),
        )
        start += item["size"]
    return scale(-1, form)


def _lyapunov(evidence: dict[str, Any]) -> Rational:
    """Return the Lyapunov matrix in the coordinates of the system, from those in which it was found."""
    coordinates = exact(evidence["coordinates"])
    return multiply(transpose(coordinates), multiply(exact(evidence["P"]), coordinates))


def _gain(level: Fraction, evidence: dict[str, Any]) -> str:
    """Prove an L2 gain; see `gain_inequality`."""
    if level <= 0:
        raise Refusal("the level is not positive")
    if not is_positive_definite(_lyapunov(evidence)):
        raise Refusal("P is not positive definite")
    for item in evidence["blocks"]:
        D_i, G_i = exact(item["D"]), exact(item["G"])
        if not len(D_i) == len(G_i) == item["size"]:
            raise Refusal(f"the scalings of block {item['name']} do not have its size")
        if not is_positive_definite(D_i):
            raise Refusal(f"D of block {item['name']} is not positive definite")
        if transpose(G_i) != scale(-1, G_i):
            raise Refusal(f"G of block {item['name']} is not skew")
    if not is_positive_definite(gain_inequality(level, evidence)):
        raise Refusal("the matrix inequality does not hold")
    return f"the L2 gain is below {float(level):.6g}: the matrix inequality holds exactly"


def _closure(level: Fraction, evidence: dict[str, Any]) -> str:
    """Prove that a flight stays inside a box; see `gustproof.certify.enclosure`."""
    norms = [axis_norms(evidence, axis) for axis in range(3)]
    return closed(level, evidence, norms)


def closed(level: Fraction, evidence: dict[str, Any], norms: list[Norms]) -> str:
    """Return what is proved if the evidence's box closes over `level` times its moment with these norms.

    Raises
    ------
    Refusal
        If a signal leaves the box, a command its limit, or the noise is not covered.
    """
    if level <= 0:
        raise Refusal("the part of the moment is not positive")
    box, law = exact(evidence["box"]), evidence["law"]
    if [len(row) for row in box] != [len(SIGNALS)] * 3 or min(map(min, box)) < 0:
        raise Refusal("the box does not bound every signal of every axis")
    deviations = Fraction(evidence["deviations"])
    # 2 Q(z) <= exp(-z^2 / 2) for each signal, late signal and measurement of each sample
    count = 3 * (len(SIGNALS) + 3) * (evidence["samples"] + 1)
    if evidence["noise"] != 0 and exp_below(deviations**2 / 2) * Fraction(evidence["risk"]) < count:
        raise Refusal("the noise exceeds so many deviations with a larger probability")
    for axis, (inside, follows) in enumerate(zip(box, mapped(evidence, norms, level, box), strict=True)):
        for name, bound, value in zip(SIGNALS, inside, follows, strict=True):
            if not value <= bound:
                raise Refusal(f"axis {axis}: the bound of {name} does not close: {float(value)} above {float(bound)}")
        limit = Fraction(law["limits"][axis])
        if not inside[SIGNALS.index("command")] <= limit * Fraction(999, 1000):
            raise Refusal(f"axis {axis}: the command may reach its limit")
    return f"{float(level):.6g} of the moment keeps every signal in the box, every command inside its limit"


_PROOFS: dict[str, Callable[[Fraction, dict[str, Any]], str]] = {"gain": _gain, "closure": _closure}
