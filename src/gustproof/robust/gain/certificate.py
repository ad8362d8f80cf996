"""Certificate of a gain: what its maker found, and the evidence that anyone can check again."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from firmware_model.config.files import write_text
from gustproof.checker.evidence import FORMAT, seal
from gustproof.robust.shown import Shown, shorten_statement


class Sealed(Shown):
    """A statement with evidence that anyone can check again, and its file."""

    __slots__ = ()
    statement: str
    evidence: Any

    @property
    def claim(self) -> str:
        """The statement in short figures: bounds are rounded up, what it assumes down."""
        return shorten_statement(self.statement)

    def to_dict(self) -> dict[str, Any]:
        """Return format, evidence and checksum as JSON values; the check makes the claim from the evidence."""
        document = {"format": FORMAT, "evidence": self.evidence}
        return {**document, "seal": seal(document)}

    def save(self, path: str | Path) -> None:
        """Write the certificate as JSON, every number to the bit."""
        write_text(Path(path), json.dumps(self.to_dict(), indent=1, ensure_ascii=False) + "\n")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Certificate(Sealed):
    """A proved gain of a closed loop, with the evidence for it; boxes of flights are `FlightCertificate`.

    `proven` is the verdict of the exact check, never that of a solver.

    Examples
    --------
    >>> from gustproof import Certificate
    >>> nothing = Certificate(
    ...     statement="the L2 gain is not bounded", gain=None, lower_bound=0.0, proven=False, assumes={}, evidence={},
    ...     residual=None,
    ... )
    >>> sorted(nothing.to_dict())
    ['evidence', 'format', 'seal']
    """

    statement: str
    """The claim, in words."""
    gain: float | None
    """[-] claimed L2 gain; `None` if unknown."""
    lower_bound: float
    """[-] gain reached in simulation."""
    proven: bool
    """True if the check accepted the evidence. False is an ordinary result: nothing is known then."""
    assumes: dict[str, Any]
    """Assumptions by name: plant, leak, delay in samples, envelope, horizon, noise and its probability."""
    evidence: Mapping[str, object]
    """Every input of the check, as JSON values."""
    residual: float | None
    """[-] least eigenvalue or slack of the quantities that must be positive, in floating point; `None` without
    evidence."""

    def lines(self) -> list[str]:
        """Return the verdict and the claim."""
        return ["proven" if self.proven else "NOT proven", f"claim: {self.claim}"]

    @property
    def is_whole(self) -> bool:
        """True if the gain is proven: it has no parts."""
        return self.proven
