"""Check of a certificate's evidence: exact arithmetic, and for norms doubles with bounds of their rounding.

The check multiplies and factors matrices of rational numbers; it uses no solver and no design. A gain is proved of the
numbers in the evidence. Given a loop that was derived again, it is proved of that loop, and of every loop within the
rounding of its numbers. A flight's box is proved of a law file and a vehicle file: the check derives the loop again.
Statement and assumptions are made from the evidence.
"""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import product
from typing import NamedTuple

from gustproof.checker.directed_rounding import float_up, print_down, print_up
from gustproof.checker.dissipation import (
    corner,
    gain_inequality,
    lyapunov_matrix,
    rate_bounded_blocks,
    rate_bounded_inequalities,
    stability_inequality,
    vertices,
)
from gustproof.checker.evidence_types import (
    AnyEvidence,
    AnyGainEvidence,
    Assumptions,
    BlockTable,
    ChanceEvidence,
    ConstrainedGainEvidence,
    Figures,
    FlightEvidence,
    GainEvidence,
    LoopEvidence,
    MultiplierTable,
    PartTable,
    SlowGainEvidence,
    SystemMatrices,
)
from gustproof.checker.flight_box import KIND, Proof, prove_flight_box
from gustproof.checker.gaussian_box import KIND as CHANCE
from gustproof.checker.gaussian_box import prove_chance
from gustproof.checker.quadratic_constraints import check_multipliers, check_sizes, count_states, kind_of
from gustproof.checker.rational import RationalMatrix, is_positive_definite, to_rational
from gustproof.checker.system import Refusal, finite, read_object

FORMAT = "gustproof-certificate-1"
_MOST = 400
"""Most states and channels of a gain's system and filters; bounds the time of a check."""
ROUNDING = Fraction(1, 1 << 40)
"""[-] share of the largest number in its row and column by which rounding may have moved a number of a derived loop.

It covers two thousand roundings of that size.
"""


class DerivedLoop(NamedTuple):
    """Loop of a gain, derived from its design: what the evidence must prove, whatever loop it holds itself."""

    system: SystemMatrices
    """Matrices A, B, C and D, closed by Delta."""
    blocks: list[tuple[str, int]]
    """Names and sizes of Delta's blocks."""
    speeds: list[float | None]
    """[1/s] speed of each normalised parameter, already above rounding; `None` for any speed."""
    parts: list[PartTable]
    """Entries that make a block other than a real parameter: kind, and largest delay [s] or oddness."""
    radius: dict[str, RationalMatrix] | None = None
    """Distances of the numbers of A, B, C and D from those of the loop; `None` for `ROUNDING` of the largest each."""

    @property
    def source(self) -> str:
        """Files that it was derived from, in words."""
        return "the design" if self.radius is None else "the law's file and its design"


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """Verdict of a check."""

    accepted: bool
    """True if the evidence proves the claim."""
    reason: str
    """The proved statement, or the condition that failed."""
    figures: Figures = field(default_factory=Figures)
    """Proved figures: the gain, or part, estimate_deg, truth_deg, moment_class and torque_nm of a flight's box."""
    assumes: Assumptions = field(default_factory=dict)
    """Assumptions, made from the evidence and, of a flight's box, from law and vehicle."""


def check_certificate(
    certificate_json: str,
    *,
    law: str | None = None,
    vehicle: str | None = None,
    scenario: str | None = None,
    loop: DerivedLoop | None = None,
) -> CheckResult:
    """Return whether the evidence of a certificate, given as the text of its file, proves its claim.

    A certificate of a flight's box needs the texts of its `law` and `vehicle` files too, and one of its chance that of
    the `scenario` file. That of a gain is checked for the `loop`, if one is given, in place of the one that it holds.
    Whatever is given and is no part of a proof of this kind is refused: nothing would bind the proof to it. The seal
    is a checksum, no signature: it shows damage, not forgery. Any text gets a verdict; nothing is raised.

    Examples
    --------
    >>> from gustproof import check_certificate
    >>> check_certificate('{"format": "gustproof-certificate-1", "seal": "none"}').accepted
    False
    """
    try:
        document = json.loads(certificate_json, object_pairs_hook=read_object, parse_constant=_refuse_constant)
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise Refusal(f"format is not '{FORMAT}'")
        claimed = document.pop("seal", None)
        if claimed != seal(document):
            raise Refusal("the seal does not fit: something was changed after the certificate was made")
        if set(document) != {"format", "evidence"}:
            raise Refusal("a certificate holds evidence alone: its claim is made from that")
        return _check_kind(document["evidence"], law, vehicle, scenario, loop)
    except Refusal as refusal:
        return _refuse(str(refusal))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, ArithmeticError) as error:
        return _refuse(f"the evidence is malformed: {type(error).__name__}: {error}")
    except RecursionError:
        return _refuse("the evidence is malformed: nested too deeply")
    except MemoryError:
        return _refuse("the evidence is larger than the memory")


def _check_kind(
    evidence: AnyEvidence,
    law: str | None,
    vehicle: str | None,
    scenario: str | None,
    loop: DerivedLoop | None,
) -> CheckResult:
    """Return the verdict on evidence of any kind, of the files and the loop that belong to its kind."""
    if evidence["kind"] in (KIND, CHANCE) and loop is not None:
        raise Refusal("the certificate is about a flight, not about the gain of a design")
    if evidence["kind"] == KIND:
        _refuse_files("a flight's box", {"--air": scenario})
        return _accept(_check_flight_box(evidence, law, vehicle))
    if evidence["kind"] == CHANCE:
        return _accept(_check_chance(evidence, law, vehicle, scenario))
    if evidence["kind"] not in _KEYS:
        raise Refusal(f"unknown kind of evidence '{evidence['kind']}'")
    _refuse_files("a gain", {"--law": law, "--vehicle": vehicle, "--air": scenario})
    return check_evidence(evidence, loop)


def _refuse(reason: str) -> CheckResult:
    """Return a refusal in ASCII: text of the certificate that it quotes must not look like other text."""
    return CheckResult(accepted=False, reason=reason.encode("ascii", "backslashreplace").decode())


def _refuse_files(about: str, given: dict[str, str | None]) -> None:
    """Raise `Refusal` for files that the proof does not use: it would say nothing about them."""
    if names := [name for name, text in given.items() if text is not None]:
        raise Refusal(f"a certificate of {about} is bound to no such file: leave out {names[0]}")


def _refuse_constant(name: str) -> None:
    raise Refusal(f"{name} is no number")


def _check_flight_box(evidence: FlightEvidence, law: str | None, vehicle: str | None) -> Proof:
    if law is None or vehicle is None:
        raise Refusal("a flight's box is proved of its law and vehicle files: give both (--law, --vehicle)")
    return prove_flight_box(evidence, law, vehicle)


def _check_chance(evidence: ChanceEvidence, law: str | None, vehicle: str | None, scenario: str | None) -> Proof:
    if law is None or vehicle is None or scenario is None:
        raise Refusal("a flight's chance is proved of its three files: give all three (--law, --vehicle, --air)")
    return prove_chance(evidence, law, vehicle, scenario)


def _accept(proof: Proof) -> CheckResult:
    return CheckResult(accepted=True, reason=proof.statement, figures=proof.figures, assumes=proof.assumes)


def check_evidence(evidence: AnyGainEvidence, loop: DerivedLoop | None = None) -> CheckResult:
    """Return what the `evidence` of a gain proves, before it is sealed in a certificate; of `loop` if one is given.

    Raises
    ------
    Refusal
        If `evidence` proves nothing.
    """
    if evidence["kind"] not in _KEYS:
        raise Refusal(f"unknown kind of evidence '{evidence['kind']}'")
    keys = _KEYS[evidence["kind"]]
    if set(evidence) != keys:
        raise Refusal(f"the evidence has other entries: {', '.join(sorted(set(evidence) ^ keys))}")
    _check_blocks(evidence["blocks"])
    if evidence["kind"] == "slow gain" and any(set(block) != _SLOW for block in evidence["blocks"]):
        raise Refusal(f"a block of slow parameters has other entries than {', '.join(sorted(_SLOW))}")
    level = finite("level", evidence["level"])
    if level <= 0:
        raise Refusal("the level is not positive")
    plant, share = (
        "the continuous linear system of the evidence, bound to no design or law, closed by Delta",
        Fraction(0),
    )
    if loop is not None:
        _check_blocks_of(loop, evidence["blocks"])
        evidence = evidence.copy()
        evidence["system"], evidence["radius"] = loop.system, loop.radius
        plant = f"the continuous linear system derived from {loop.source}, and all within its rounding, closed by Delta"
        share = ROUNDING
    _check_sizes(evidence)
    _prove(level, evidence, share)
    reason = _state_gain(level, evidence, "the system in this certificate" if loop is None else "the derived loop")
    assumes = {"plant": plant, **_describe_system(evidence)}
    return CheckResult(accepted=True, reason=reason, figures={"gain": float_up(level)}, assumes=assumes)


def _describe_system(evidence: LoopEvidence) -> Assumptions:
    """Return the assumptions on a gain's system and its blocks."""
    blocks = evidence["blocks"]
    assumes: Assumptions = {
        "system_sha256": seal(evidence["system"]),
        "blocks": [f"{block['name']} x {block['size']}" for block in blocks],
        "speeds_per_s": [block.get("speed") for block in blocks],
    }
    if parts := _describe_parts(blocks):
        assumes["parts"] = parts
    return assumes


def is_name(name: object) -> bool:
    """Return whether a block may be called so: an ASCII word, of which no look-alikes make another statement."""
    return isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_.-]{0,31}", name) is not None


def _check_blocks(blocks: Sequence[BlockTable]) -> None:
    """Raise `Refusal` unless blocks have names, no sentences, and sizes: both are part of the statement."""
    if not blocks:
        raise Refusal("the evidence names no block, so nothing varies")
    for block in blocks:
        name, size = block["name"], block["size"]
        if not is_name(name):
            raise Refusal(f"a block is named {name!a}, must have a name of ASCII letters, digits, '_', '-' and '.'")
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise Refusal(f"block {name} has size {size!r}, must be a positive whole number")
    if len({block["name"] for block in blocks}) < len(blocks):
        raise Refusal("two blocks have the same name")


def _check_sizes(evidence: AnyGainEvidence) -> None:
    """Raise `Refusal` for sizes that disagree, or for more than the check takes, before any is used.

    A gain's numbers are numbers: `true` would count as 1.
    """
    blocks, system = evidence["blocks"], evidence["system"]
    if set(system) != set("ABCD"):
        raise Refusal("the system has other entries than A, B, C and D")
    order, channels = len(system["A"]), max(len(system["D"]), len(system["D"][0]))
    total = sum(block["size"] for block in blocks)
    if total > min(len(system["D"]), len(system["D"][0])):
        raise Refusal(f"the blocks have {total} channels, more than the system")
    for block in blocks:
        if evidence["kind"] != "slow gain":
            check_sizes(block)
    if order + channels + sum(map(count_states, blocks)) > _MOST:
        raise Refusal(f"the system and its filters have more than {_MOST} states and channels")
    _refuse_truths({key: value for key, value in evidence.items() if key != "blocks"})
    _refuse_truths([{key: value for key, value in block.items() if key != "odd"} for block in blocks])


def _refuse_truths(value: object) -> None:
    """Raise `Refusal` for a `true` or `false`, which would count as a number."""
    if isinstance(value, bool):
        raise Refusal("a number is 'true' or 'false'")
    for entry in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _refuse_truths(entry)


def _check_blocks_of(loop: DerivedLoop, blocks: Sequence[BlockTable]) -> None:
    """Raise `Refusal` unless the evidence is about the loop's parameters, and about all of their speeds."""
    if [(block["name"], block["size"]) for block in blocks] != loop.blocks:
        raise Refusal("the evidence is about other parameters than those of the derived loop")
    for block, speed in zip(blocks, loop.speeds, strict=True):
        bound = block.get("speed")
        if bound is not None and (speed is None or finite("speed", bound) < finite("speed", speed)):
            raise Refusal(f"{block['name']} of the derived loop is faster than the evidence allows")
    for block, part in zip(blocks, loop.parts, strict=True):
        if not _covers(block, part):
            raise Refusal(f"{block['name']} of the derived loop is more than the evidence allows")


def _covers(block: BlockTable, part: PartTable) -> bool:
    """Return whether the constraint of a block holds of a part: of its own kind, no larger and as odd."""
    if kind_of(block) != kind_of(part) or (block.get("odd") and not part["odd"]):
        return False
    return "largest" not in part or finite("the delay", block["largest"]) >= finite("the delay", part["largest"])


def _state_gain(level: Fraction, evidence: LoopEvidence, subject: str) -> str:
    real = [block for block in evidence["blocks"] if kind_of(block) == "real"]
    slow = [(block["name"], speed) for block in real if (speed := block.get("speed")) is not None]
    speeds = ", ".join(f"'{name}' below {print_down(speed)} 1/s" for name, speed in slow)
    names = ", ".join(f"'{block['name']}'" for block in real)
    every = [f"every normalised Delta(t) of {names}"] if real else []
    every += _describe_parts(evidence["blocks"])
    return (
        f"the L2 gain of {subject} from w to z is below {print_up(level)} for {', and '.join(every)}"
        f"{f', with speeds of {speeds}' if slow else ''}: the matrix inequality holds exactly"
    )


def _describe_parts(blocks: Sequence[BlockTable]) -> list[str]:
    """Return a clause for each part that is no real parameter."""
    return [_describe_part(block) for block in blocks if kind_of(block) != "real"]


def _describe_part(block: BlockTable) -> str:
    name, kind = f"'{block['name']}'", kind_of(block)
    if kind == "delay":
        return f"{name}: every constant delay of all its channels in [0, {block['largest']!r}] s"
    if kind == "varying delay":
        return f"{name}: every delay of all its channels that varies at will in [0, {block['largest']!r}] s"
    if kind == "sector":
        return f"{name}: functions phi(q, t) of each channel between 0 and q"
    return f"{name}: {'odd ' if block['odd'] else ''}functions phi(q) of each channel with slopes in [0, 1]"


def seal(document: Mapping[str, object]) -> str:
    """Return the SHA-256 of a document of JSON values, independent of layout and key order."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _prove(level: Fraction, evidence: AnyGainEvidence, share: Fraction) -> None:
    if evidence["kind"] == "gain":
        _prove_gain(level, evidence, share)
    elif evidence["kind"] == "slow gain":
        _prove_rate_bounded(level, evidence, share)
    else:
        _prove_constrained(level, evidence, share)


def _prove_gain(level: Fraction, evidence: GainEvidence, share: Fraction) -> None:
    """Prove an L2 gain; see `gain_inequality`."""
    if any(kind_of(block) != "real" for block in evidence["blocks"]):
        raise Refusal("a gain of this kind is of real parameters alone")
    if not is_positive_definite(lyapunov_matrix(evidence, evidence["P"])):
        raise Refusal("P is not positive definite")
    _check_multipliers(evidence, evidence["blocks"])
    if not gain_inequality(level, evidence, share).is_positive_definite():
        raise Refusal("the matrix inequality does not hold")


def _prove_rate_bounded(level: Fraction, evidence: SlowGainEvidence, share: Fraction) -> None:
    """Prove an L2 gain with bounds on the speeds of some parameters; see `rate_bounded_inequalities`."""
    slow = rate_bounded_blocks(evidence)
    if any(finite("a speed", speed) < 0 for speed in slow.values()):
        raise Refusal("a bound on a speed is negative")
    for signs in product((-1, 1), repeat=len(slow)):
        P = corner([to_rational(term) for term in evidence["P"]], signs)
        if not is_positive_definite(lyapunov_matrix(evidence, P)):
            raise Refusal(f"P is not positive definite at the corner {signs}")
    for scalings in evidence["vertices"]:
        _check_multipliers(evidence, scalings)
    forms = rate_bounded_inequalities(level, evidence, share)
    for vertex, form in zip(vertices(len(slow)), forms, strict=True):
        if not form.is_positive_definite():
            raise Refusal(f"the matrix inequality does not hold at the corner {vertex.signs}, speeds {vertex.speeds}")


def _prove_constrained(level: Fraction, evidence: ConstrainedGainEvidence, share: Fraction) -> None:
    """Prove an L2 gain with parts of which only integral quadratic constraints are known; see `quadratic_constraints`.

    The system and the filters are stable alone, parts are well posed in their order, and the inequality holds. Theorem
    1 of Megretski and Rantzer (1997) then joins them to a stable loop. The integral of the form bounds the gain.
    """
    if not is_positive_definite(lyapunov_matrix(evidence, evidence["stability"])):
        raise Refusal("the matrix of stability is not positive definite")
    if not stability_inequality(evidence, share).is_positive_definite():
        raise Refusal("the loop without its parts is not proved stable")
    _check_multipliers(evidence, evidence["blocks"])
    if not gain_inequality(level, evidence, share).is_positive_definite():
        raise Refusal("the matrix inequality does not hold")


def _check_multipliers(evidence: LoopEvidence, scalings: Sequence[MultiplierTable]) -> None:
    """Raise `Refusal` for scalings that are no multipliers of the evidence's blocks."""
    for block, item in zip(evidence["blocks"], scalings, strict=True):
        check_multipliers(block, item)


_SLOW = {"name", "size", "speed"}
_COMMON = frozenset({"kind", "level", "system", "coordinates", "P", "blocks"})
_KEYS = {
    "gain": _COMMON,
    "slow gain": _COMMON | {"Y", "vertices"},
    "constrained gain": _COMMON | {"stability"},
}
"""Entries of the evidence of each kind."""
