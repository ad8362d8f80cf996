"""Certificates: a claim, its assumptions, and evidence that anyone can check again."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from firmware_model.config.files import parse_json, read_text, write_text
from gustproof.certify.check.evidence import FORMAT, seal


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """A proved gain of a closed loop, with the evidence for it; boxes of flights are `FlightCertificate`.

    `proven` is the verdict of the exact check, never that of a solver.

    Examples
    --------
    >>> from gustproof import Certificate
    >>> nothing = Certificate(
    ...     statement="the L2 gain is not bounded", gain=None, lower_bound=0.0, proven=False, assumes={}, evidence={},
    ...     residual=None,
    ... )
    >>> sorted(nothing.to_dict())[:3]
    ['assumes', 'evidence', 'format']
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
    evidence: dict[str, Any]
    """Every input of the check, as JSON values."""
    residual: float | None
    """[-] least eigenvalue or slack of the quantities that must be positive, in floating point; `None` without
    evidence."""

    def to_dict(self) -> dict[str, Any]:
        """Return the certificate as JSON values, sealed."""
        document = {"format": FORMAT, **asdict(self)}
        return {**document, "seal": seal(document)}

    def save(self, path: str | Path) -> None:
        """Write the certificate as JSON, every number to the bit."""
        write_text(Path(path), json.dumps(self.to_dict(), indent=1, ensure_ascii=False) + "\n")


def load_certificate(path: str | Path) -> Certificate:
    """Read the certificate file of a gain without checking its claim; `certify.check.evidence.check` does that.

    Raises
    ------
    ValueError
        If the file is not JSON, or a key is missing or unknown.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import Certificate, load_certificate
    >>> made = Certificate(
    ...     statement="none", gain=None, lower_bound=0.0, proven=False, assumes={}, evidence={}, residual=None
    ... )
    >>> with TemporaryDirectory() as folder:
    ...     made.save(Path(folder) / "proof.json")
    ...     read = load_certificate(Path(folder) / "proof.json")
    >>> read == made
    True
    """
    document = parse_json(read_text(Path(path)))
    if not isinstance(document, dict) or document.pop("format", None) != FORMAT:
        raise ValueError(f"{path}: format: must be '{FORMAT}'")
    document.pop("seal", None)
    try:
        return Certificate(**document)
    except TypeError as error:
        raise ValueError(f"{path}: {error}") from None
