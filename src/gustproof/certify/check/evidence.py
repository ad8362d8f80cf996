"""Check of a certificate's evidence: exact arithmetic, and for norms doubles with bounds of their rounding.

The check multiplies and factors matrices of rational numbers; it uses no solver and no design. A gain is proved of the
numbers in the evidence; the maker must show that they are those of a design. A flight's box is proved of a law file and
a vehicle file. The check derives the loop from them again, and makes statement and assumptions from the evidence.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field
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
from gustproof.certify.check.flight_box import KIND, prove_flight_box
from gustproof.certify.check.system import Refusal
from gustproof.lti.rational import is_positive_definite, scale, to_rational, transpose

FORMAT = "gustproof-certificate-1"


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """Verdict of a check."""

    accepted: bool
    """True if the evidence proves the claim."""
    reason: str
    """The proved statement, or the condition that failed."""
    figures: dict[str, Any] = field(default_factory=dict)
    """Proved figures of a flight's box: part, estimate_deg, truth_deg, moment_class, torque_nm."""
    assumes: dict[str, Any] = field(default_factory=dict)
    """Assumptions of a flight's box, made from evidence, law and vehicle."""


def check(certificate_json: str, *, law: str | None = None, vehicle: str | None = None) -> CheckResult:
    """Return whether the evidence of a certificate, given as the text of its file, proves its claim.

    A certificate of a flight's box needs the texts of its `law` and `vehicle` files too. The seal is a checksum, no
    signature: it shows damage, not forgery. Any text gets a verdict; nothing is raised.

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
        kind = document["evidence"]["kind"]
        if kind == KIND:
            return _check_flight_box(document, law, vehicle)
        if kind not in _PROOFS:
            raise Refusal(f"unknown kind of evidence '{kind}'")
        if document["proven"] is not True:
            raise Refusal("the certificate does not claim to be proven")
        return check_evidence(document["gain"], document["evidence"])
    except Refusal as refusal:
        return CheckResult(accepted=False, reason=str(refusal))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, ZeroDivisionError, OverflowError) as error:
        return CheckResult(accepted=False, reason=f"the evidence is malformed: {type(error).__name__}: {error}")
    except RecursionError:
        return CheckResult(accepted=False, reason="the evidence is malformed: nested too deeply")


def _check_flight_box(document: dict[str, Any], law: str | None, vehicle: str | None) -> CheckResult:
    if set(document) != {"format", "evidence"}:
        raise Refusal("a certificate of a flight's box holds evidence alone: its claim is made from that")
    if law is None or vehicle is None:
        raise Refusal("a flight's box is proved of its law and vehicle files: give both")
    proof = prove_flight_box(document["evidence"], law, vehicle)
    return CheckResult(accepted=True, reason=proof.statement, figures=proof.figures, assumes=proof.assumes)


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


_PROOFS: dict[str, Callable[[Fraction, dict[str, Any]], str]] = {
    "gain": _prove_gain,
    "slow gain": _prove_rate_bounded,
}
