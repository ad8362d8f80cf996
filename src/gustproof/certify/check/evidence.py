"""Check of a certificate's evidence in exact arithmetic, with the standard library only.

The check multiplies and factors matrices of rational numbers; it uses no solver, no design and no law. It proves a
statement about the numbers in the evidence. The maker must show that they are those of a vehicle and a law.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

from gustproof.certify.check.dissipation import (
    corner,
    gain_inequality,
    lyapunov_matrix,
    rate_bounded_blocks,
    rate_bounded_inequalities,
    vertices,
)
from gustproof.certify.check.invariant_box import SIGNALS, AxisNorms, axis_norms, map_box
from gustproof.lti.rational import exp_lower_bound, is_positive_definite, scale, to_rational, transpose

FORMAT = "gustproof-certificate-1"
COMMAND_SHARE = Fraction(999, 1000)
"""[-] share of its limit that a command may reach; the rest covers floating-point rounding."""


class Refusal(Exception):
    """Evidence that does not prove the claim; the text names the condition that failed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """Verdict of a check."""

    accepted: bool
    """True if the evidence proves the claim."""
    reason: str
    """The proved statement, or the condition that failed."""


def check_certificate(certificate_json: str) -> CheckResult:
    """Return whether the evidence of a certificate, given as the text of its file, proves its claim.

    The seal must fit: one changed digit anywhere is refused, even one that would leave the proof valid. Any text gets a
    verdict; nothing is raised.

    Examples
    --------
    >>> from gustproof import check_certificate
    >>> check_certificate('{"format": "gustproof-certificate-1", "seal": "none"}').accepted
    False
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
        return check_evidence(document["gain"], document["evidence"])
    except Refusal as refusal:
        return CheckResult(accepted=False, reason=str(refusal))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, ZeroDivisionError, OverflowError) as error:
        return CheckResult(accepted=False, reason=f"the evidence is malformed: {type(error).__name__}: {error}")
    except RecursionError:
        return CheckResult(accepted=False, reason="the evidence is malformed: nested too deeply")


def check_evidence(level: float, evidence: dict[str, Any]) -> CheckResult:
    """Return whether `evidence` proves `level`, before it is sealed in a certificate.

    Raises
    ------
    Refusal
        If `evidence` proves no such thing.
    """
    if evidence["kind"] not in _PROOFS:
        raise Refusal(f"unknown kind of evidence '{evidence['kind']}'")
    return CheckResult(accepted=True, reason=_PROOFS[evidence["kind"]](Fraction(level), evidence))


def seal(document: dict[str, Any]) -> str:
    """Return the SHA-256 of a document of JSON values, independent of layout and key order."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _prove_gain(level: Fraction, evidence: dict[str, Any]) -> str:
    """Prove an L2 gain; see `gain_inequality`."""
    if level <= 0:
        raise Refusal("the level is not positive")
    if not is_positive_definite(lyapunov_matrix(evidence, evidence["P"])):
        raise Refusal("P is not positive definite")
    _check_multipliers(evidence, evidence["blocks"])
    if not is_positive_definite(gain_inequality(level, evidence)):
        raise Refusal("the matrix inequality does not hold")
    return f"the L2 gain is below {float(level):.6g}: the matrix inequality holds exactly"


def _prove_rate_bounded(level: Fraction, evidence: dict[str, Any]) -> str:
    """Prove an L2 gain with bounds on the speeds of some parameters; see `rate_bounded_inequalities`."""
    if level <= 0:
        raise Refusal("the level is not positive")
    slow = rate_bounded_blocks(evidence)
    if any(Fraction(evidence["blocks"][i]["speed"]) < 0 for i in slow):
        raise Refusal("a bound on a speed is negative")
    for signs in product((-1, 1), repeat=len(slow)):
        P = corner([to_rational(term) for term in evidence["P"]], signs)
        if not is_positive_definite(lyapunov_matrix(evidence, P)):
            raise Refusal(f"P is not positive definite at the corner {signs}")
    for scalings in evidence["vertices"]:
        _check_multipliers(evidence, scalings)
    for vertex, matrix in zip(vertices(len(slow)), rate_bounded_inequalities(level, evidence), strict=True):
        if not is_positive_definite(matrix):
            raise Refusal(f"the matrix inequality does not hold at the corner {vertex.signs}, speeds {vertex.speeds}")
    return f"the L2 gain is below {float(level):.6g}: the matrix inequality holds exactly at every corner"


def _check_multipliers(evidence: dict[str, Any], scalings: list[dict[str, Any]]) -> None:
    """Raise `Refusal` for scalings that are no multipliers of the evidence's blocks."""
    for block, item in zip(evidence["blocks"], scalings, strict=True):
        D_i, G_i = to_rational(item["D"]), to_rational(item["G"])
        if not len(D_i) == len(G_i) == block["size"]:
            raise Refusal(f"the scalings of block {block['name']} do not have its size")
        if not is_positive_definite(D_i):
            raise Refusal(f"D of block {block['name']} is not positive definite")
        if transpose(G_i) != scale(-1, G_i):
            raise Refusal(f"G of block {block['name']} is not skew")


def _prove_boundedness(level: Fraction, evidence: dict[str, Any]) -> str:
    """Prove that a flight stays inside a box; see `gustproof.certify.check.invariant_box`."""
    norms = [axis_norms(evidence, axis) for axis in range(3)]
    return check_box(level, evidence, norms)


def check_box(level: Fraction, evidence: dict[str, Any], norms: list[AxisNorms]) -> str:
    """Return the proved statement if the evidence's box closes over `level` times its moment with these norms.

    Raises
    ------
    Refusal
        If a signal leaves the box, a command its limit, or the noise is not covered.
    """
    if level <= 0:
        raise Refusal("the share of the moment is not positive")
    box, law = to_rational(evidence["box"]), evidence["law"]
    if [len(row) for row in box] != [len(SIGNALS)] * 3 or min(map(min, box)) < 0:
        raise Refusal("the box does not bound every signal of every axis")
    deviations = Fraction(evidence["deviations"])
    # 2 Q(z) <= exp(-z^2 / 2) for each signal, signal at the sample's end and measurement of each sample
    count = 3 * (len(SIGNALS) + 3) * (evidence["samples"] + 1)
    if evidence["noise"] != 0 and exp_lower_bound(deviations**2 / 2) * Fraction(evidence["risk"]) < count:
        raise Refusal("the noise exceeds so many deviations with a larger probability")
    for axis, (inside, follows) in enumerate(zip(box, map_box(evidence, norms, level, box), strict=True)):
        for name, bound, value in zip(SIGNALS, inside, follows, strict=True):
            if not value <= bound:
                raise Refusal(f"axis {axis}: the bound of {name} does not close: {float(value)} above {float(bound)}")
        limit = Fraction(law["limits"][axis])
        if not inside[SIGNALS.index("command")] <= limit * COMMAND_SHARE:
            raise Refusal(f"axis {axis}: the command may reach its limit")
    return f"{float(level):.6g} of the moment keeps every signal in the box, every command inside its limit"


_PROOFS: dict[str, Callable[[Fraction, dict[str, Any]], str]] = {
    "gain": _prove_gain,
    "slow gain": _prove_rate_bounded,
    "closure": _prove_boundedness,
}
