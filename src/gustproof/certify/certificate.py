"""Certificates: a claim, its assumptions, and evidence that anyone can check again."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from firmware_model.config.files import parse_json, read_text, write_text
from gustproof.certify.check.evidence import FORMAT, seal


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """A claim about a closed loop, with the evidence for it.

    `proven` is the verdict of the exact check, never that of a solver.

    Examples
    --------
    >>> from gustproof import certify_boundedness, load_law, load_vehicle
    >>> law, vehicle = load_law("hinf-d1"), load_vehicle("paper")
    >>> certificate = certify_boundedness(law, vehicle, moment=(0.5, 0.5, 0.2), horizon=0.1)
    >>> (certificate.proven, certificate.assumes["delay_samples"])
    (True, 1)
    """

    statement: str
    """The claim, in words."""
    gain: float | None
    """[-] claimed level: an L2 gain, or the share of the moment that a closure covers; `None` if unknown."""
    lower_bound: float
    """[-] reached in simulation: a gain, or the share of a closure's angles; 0 without a search."""
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
    """Read a certificate file without checking its claim; `check_certificate` does that.

    Raises
    ------
    ValueError
        If the file is not JSON, or a key is missing or unknown.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import certify_boundedness, load_certificate, load_law, load_vehicle
    >>> law, vehicle = load_law("hinf-d1"), load_vehicle("paper")
    >>> made = certify_boundedness(law, vehicle, moment=(0.5, 0.5, 0.2), horizon=0.1)
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
