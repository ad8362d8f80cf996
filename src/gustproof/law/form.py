"""The one form of every flying law, and its file.

    u  = C x + D y,      command = sat(u),
    x+ = A x + B y + G f(x) + H (sat(u) - u),

with `y` = (gyro p, q, r [rad/s]; reference phi, theta, psi [rad]; specific force x, y, z [m/s^2] B). `f(x) = T(E)
omega` are the exact Euler kinematics at the law's own estimates `E = x[0:3]` [rad] and `omega = x[3:6]` [rad/s]. With
`G = 0` a law is linear; `H` is its anti-windup. A law without accelerometer has no columns for it in B and D. PID,
H-infinity and self-scheduled laws differ in these numbers only, so a comparison compares gains.
"""

import json
import math
from dataclasses import dataclass, field
from enum import Enum
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import checked_name, parse_json, read_text, write_text
from firmware_model.config.validation import sanitize_line
from gustproof.errors import LawFileError
from gustproof.types import readonly_copy

LAWS = Path(__file__).parent / "data"
FORMAT = "gustproof-law-1"
MEASUREMENT_SIZE = 9
"""Numbers in `y`: gyro, reference, specific force."""
REFERENCE_LIMIT = "reference_limit_deg"
"""Provenance parameter of the largest reference that a law holds."""
_MATRICES = ("A", "B", "C", "D", "G", "H")
_GYRO_REFERENCE_SIZE = 6

Matrix = NDArray[np.float64]


class Output(Enum):
    """Commanded quantity of a law.

    Examples
    --------
    >>> from gustproof import load_law
    >>> load_law("hinf-rates").output
    <Output.RATES: 'rates'>
    """

    TORQUE = "torque"
    """[N*m] B, sent as SET_ACTUATOR_CONTROL_TARGET."""
    RATES = "rates"
    """[rad/s] B, sent as SET_ATTITUDE_TARGET and tracked by the autopilot's own loop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Origin of a law: enough to derive it again.

    Examples
    --------
    >>> from gustproof import load_law
    >>> load_law("hinf-d1").provenance.vehicle
    'paper'
    """

    design: str
    """Design or method, in words."""
    vehicle: str
    """Vehicle of the design."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Figures of the design by name: weights, levels, margins; names carry units other than SI."""
    version: str = ""
    """Version of gustproof that made the law."""

    def __post_init__(self) -> None:
        """Check that texts are texts and figures are numbers."""
        for key in ("design", "vehicle", "version"):
            if not isinstance(getattr(self, key), str):
                raise ValueError(f"provenance.{key}: is {getattr(self, key)!r}, must be a text")
        if not isinstance(self.parameters, dict):
            raise ValueError(f"provenance.parameters: is {self.parameters!r}, must be an object")
        for key, value in self.parameters.items():
            if isinstance(value, bool) or not isinstance(value, Real):
                raise ValueError(f"provenance.parameters.{key}: is {value!r}, must be a number")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Law:
    """A discrete law of n states; matrices are checked on construction, then read-only.

    Raises
    ------
    ValueError
        If the name is not allowed in a file name, a shape does not fit, a number is not finite, or a limit or `dt` is
        not positive.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from gustproof import load_law
    >>> law = load_law("pid-default")
    >>> weaker = replace(law, name="weaker", C=0.9 * law.C)
    >>> (weaker.order, weaker.dt)
    (6, 0.004)
    """

    name: str
    """Short name, part of file names."""
    A: Matrix
    """(n, n) state to next state."""
    B: Matrix
    """(n, 6 or 9) measurements and reference to next state."""
    C: Matrix
    """(3, n) state to command."""
    D: Matrix
    """(3, 6 or 9) measurements and reference to command, as many columns as B."""
    G: Matrix
    """(n, 3) Euler rates of the law's own estimates to next state; 0 for a linear law."""
    H: Matrix
    """(n, 3) saturation excess to next state."""
    dt: float
    """[s] sample time."""
    limits: Matrix
    """(3,) [N*m or rad/s] B, largest command about each axis."""
    output: Output
    """Commanded quantity."""
    provenance: Provenance
    """Origin of the law."""

    def __post_init__(self) -> None:
        """Check name, shapes and values; set the arrays read-only."""
        try:
            checked_name(self.name)
        except ValueError as error:
            raise ValueError(f"name: {error} (given {self.name!r})") from None
        n = np.asarray(self.A).shape[0] if np.ndim(self.A) == 2 else 0
        m = MEASUREMENT_SIZE if np.shape(self.D)[1:] == (MEASUREMENT_SIZE,) else _GYRO_REFERENCE_SIZE
        shapes = {"A": (n, n), "B": (n, m), "C": (3, n), "D": (3, m), "G": (n, 3), "H": (n, 3), "limits": (3,)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly_copy(name, getattr(self, name), shape))
        if not (np.isfinite(self.dt) and self.dt > 0.0):
            raise ValueError(f"dt is {self.dt!r}, must be positive and finite")
        if not np.all(self.limits > 0.0):
            raise ValueError(f"limits are {self.limits.tolist()}, must be positive")
        if np.any(self.G) and n < 6:
            raise ValueError(f"G is not 0 but A has order {n}; attitude and rates need x[0:6]")

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.A.shape[0])

    @property
    def uses_accelerometer(self) -> bool:
        """True if the law reads the accelerometer."""
        return bool(self.D.shape[1] == MEASUREMENT_SIZE)

    @property
    def takes_references(self) -> bool:
        """True if the law reads an attitude reference; any other holds level."""
        return bool(self.B[:, 3:6].any() or self.D[:, 3:6].any())

    @property
    def reference_limit_deg(self) -> float:
        """[deg] largest reference about each axis that the law holds in simulation; infinite if unknown."""
        return self.provenance.parameters.get(REFERENCE_LIMIT, math.inf)

    @property
    def is_scheduled(self) -> bool:
        """True if the law carries the exact kinematics of its own attitude estimate."""
        return bool(np.any(self.G))

    def to_dict(self) -> dict[str, Any]:
        """Return the law as JSON for `parse_law`; every number is kept to the bit."""
        return {
            "format": FORMAT,
            "name": self.name,
            "output": self.output.value,
            "dt": self.dt,
            "limits": self.limits.tolist(),
            **{name: getattr(self, name).tolist() for name in _MATRICES},
            "provenance": {
                "design": self.provenance.design,
                "vehicle": self.provenance.vehicle,
                "parameters": self.provenance.parameters,
                "version": self.provenance.version,
            },
        }

    def save(self, path: str | Path) -> None:
        """Write the law as JSON; every number is kept to the bit."""
        write_text(Path(path), _format_document(self.to_dict()))


def load_law(name_or_path: str | Path) -> Law:
    """Read a law file, or a shipped law by its name.

    Raises
    ------
    LawFileError
        If there is no such law, it is not JSON, or a key, shape or value is not allowed.

    Examples
    --------
    >>> from gustproof import load_law
    >>> load_law("hinf-d1").A.shape
    (9, 9)
    """
    path = Path(name_or_path)
    if path.suffix != ".json":
        if str(name_or_path) not in list_laws():
            known = ", ".join(list_laws())
            raise LawFileError(
                f"no law named '{sanitize_line(str(name_or_path))}': give a .json file or one of {known}"
            )
        path = LAWS / f"{name_or_path}.json"
    try:
        document = parse_json(read_text(path))
    except OSError as error:
        raise LawFileError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise LawFileError(f"{path}: not JSON: {sanitize_line(str(error))}") from None
    return parse_law(document, str(path))


def parse_law(document: Any, source: str) -> Law:
    """Return the law in a JSON document; error texts begin with `source`.

    Raises
    ------
    LawFileError
        If a key, shape or value is not allowed.
    """
    try:
        return _parse_law(document)
    except (ValueError, TypeError) as error:
        raise LawFileError(f"{source}: {sanitize_line(str(error))}") from None


def list_laws() -> tuple[str, ...]:
    """Return the names of the shipped laws.

    Examples
    --------
    >>> from gustproof import list_laws
    >>> "flagship" in list_laws()
    True
    """
    return tuple(sorted(path.stem for path in LAWS.glob("*.json")))


def _parse_law(document: Any) -> Law:
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ValueError(f"format: must be '{FORMAT}'")
    keys = {"format", "name", "output", "dt", "limits", "provenance", *_MATRICES}
    if unknown := sorted(set(document) - keys):
        raise ValueError(f"{unknown[0]}: unknown key")
    if missing := sorted(keys - set(document)):
        raise ValueError(f"{missing[0]}: missing")
    provenance = document["provenance"]
    if not isinstance(provenance, dict):
        raise ValueError("provenance: must be an object")
    if unknown := sorted(set(provenance) - {"design", "vehicle", "parameters", "version"}):
        raise ValueError(f"provenance.{unknown[0]}: unknown key")
    outputs = [output.value for output in Output]
    if document["output"] not in outputs:
        raise ValueError(f"output: is {document['output']!r}, must be one of {', '.join(outputs)}")
    if isinstance(document["dt"], bool) or not isinstance(document["dt"], int | float):
        raise ValueError(f"dt: is {document['dt']!r}, must be a number")
    return Law(
        name=document["name"],
        **{name: document[name] for name in _MATRICES},
        dt=float(document["dt"]),
        limits=document["limits"],
        output=Output(document["output"]),
        provenance=Provenance(**provenance),
    )


def _format_document(document: dict[str, Any]) -> str:
    """Return JSON with one matrix row a line, for readers and diffs."""
    lines = []
    for key, value in document.items():
        if key in _MATRICES:
            rows = ",\n    ".join(json.dumps(row) for row in value)
            lines.append(f'  "{key}": [\n    {rows}\n  ]')
        else:
            lines.append(f'  "{key}": {json.dumps(value, ensure_ascii=False)}')
    return "{\n" + ",\n".join(lines) + "\n}\n"
