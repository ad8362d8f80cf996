"""The one form that every flying law has, its compiled step, and its file.

    u  = C x + D y,      command = sat(u),
    x+ = A x + B y + G f(x) + H (sat(u) - u),

with `y` = (gyro p, q, r [rad/s]; reference phi, theta, psi [rad]; specific force x, y, z [m/s^2] B) and `f(x) = T(E)
omega`, the exact Euler kinematics at the law's own estimates `E = x[0:3]` [rad] and `omega = x[3:6]` [rad/s]. With
`G = 0` a law is linear; `H` is its anti-windup. A law that has no use for the accelerometer leaves its three columns
out of B and D. PID, H-infinity and self-scheduled laws differ in these numbers only, so a comparison compares gains.
"""

import json
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_model.compiled import compiled, kernel
from firmware_model.elementary import sin_cos
from firmware_model.sensors import float32
from firmware_model.signals import Vector
from gustproof.arrays import frozen
from gustproof.errors import LawFileError

LAWS = Path(__file__).parent / "laws"
FORMAT = "gustproof-law-1"
MEASURED = 9
"""Numbers in `y`: gyro, reference, specific force."""
_MATRICES = ("A", "B", "C", "D", "G", "H")
_WITHOUT_FORCE = 6

Matrix = NDArray[np.float64]


class Output(Enum):
    """What a law commands."""

    TORQUE = "torque"
    """[N*m] B, flown by SET_ACTUATOR_CONTROL_TARGET."""
    RATES = "rates"
    """[rad/s] B, flown by SET_ATTITUDE_TARGET and tracked by the autopilot's own loop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Where a law comes from: enough to derive it again."""

    design: str
    """Design or method, in words."""
    vehicle: str
    """Vehicle that it was designed for."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Figures of the design by name: weights, levels, margins; units in the names where not SI."""
    version: str = ""
    """Version of gustproof that made it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Law:
    """A discrete law of n states; matrices are checked on construction and read-only after it.

    Raises
    ------
    ValueError
        If a shape does not fit, a number is not finite, or a limit or the sample time is not positive.
    """

    name: str
    """Short name."""
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
    """(n, 3) what the limit cut off to next state."""
    dt: float
    """[s] sample time."""
    limits: Matrix
    """(3,) [N*m or rad/s] B, largest command about each axis."""
    output: Output
    """What is commanded."""
    provenance: Provenance
    """Where it comes from."""

    def __post_init__(self) -> None:
        """Check shapes and values, and set the arrays read-only."""
        n = np.asarray(self.A).shape[0] if np.ndim(self.A) == 2 else 0
        m = MEASURED if np.shape(self.D)[1:] == (MEASURED,) else _WITHOUT_FORCE
        shapes = {"A": (n, n), "B": (n, m), "C": (3, n), "D": (3, m), "G": (n, 3), "H": (n, 3), "limits": (3,)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen(name, getattr(self, name), shape))
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
    def feels_force(self) -> bool:
        """Whether the law reads the accelerometer."""
        return bool(self.D.shape[1] == MEASURED)

    @property
    def scheduled(self) -> bool:
        """Whether the law carries the exact kinematics of its own attitude estimate."""
        return bool(np.any(self.G))

    def document(self) -> dict[str, Any]:
        """Return the law as JSON has it, from which `law_from` makes it again; every number is kept to the bit."""
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
        Path(path).write_text(_layout(self.document()), encoding="utf-8")


def load_law(name_or_path: str | Path) -> Law:
    """Read a law file, or a shipped law by its name.

    Raises
    ------
    LawFileError
        If there is no such law, it is not JSON, or a key, shape or value is not allowed.
    """
    path = Path(name_or_path)
    if path.suffix != ".json":
        if str(name_or_path) not in shipped_laws():
            known = ", ".join(shipped_laws())
            raise LawFileError(f"no law named '{name_or_path}': give a .json file or one of {known}")
        path = LAWS / f"{name_or_path}.json"
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise LawFileError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise LawFileError(f"{path}: not JSON: {error}") from None
    return law_from(document, str(path))


def law_from(document: Any, source: str) -> Law:
    """Return the law that a document says; `source` stands in front of each mistake.

    Raises
    ------
    LawFileError
        If a key, shape or value is not allowed.
    """
    try:
        return _law_from(document)
    except (ValueError, TypeError) as error:
        raise LawFileError(f"{source}: {error}") from None


def shipped_laws() -> tuple[str, ...]:
    """Return the names of the shipped laws."""
    return tuple(sorted(path.stem for path in LAWS.glob("*.json")))


@kernel
def euler_rates(E: Any, omega: Any) -> tuple[float, float, float]:
    """Return `T(E) omega` [rad/s], the exact ZYX Euler kinematics; `cos(theta)` is kept above 0.05 in magnitude.

    The floor bounds the law where the kinematics are singular; within |theta| < 87 deg they are exact.
    """
    sin_phi, cos_phi = sin_cos(E[0])
    sin_theta, cos_theta = sin_cos(E[1])
    if abs(cos_theta) < 0.05:
        cos_theta = 0.05 if cos_theta >= 0.0 else -0.05
    psi_dot = (sin_phi * omega[1] + cos_phi * omega[2]) / cos_theta
    return omega[0] + sin_theta * psi_dot, cos_phi * omega[1] - sin_phi * omega[2], psi_dot


@kernel
def law_kernel(A: Matrix, B: Matrix, C: Matrix, D: Matrix, G: Matrix, H: Matrix, limits: Matrix, x: Matrix,
               y: Matrix, command: Matrix, work: Matrix) -> None:  # fmt: skip
    """Write the command for `y` and move `x` to the next sample; `work` is (n + 3,) scratch.

    Of `y`, as much is read as B and D have columns.
    """
    n = x.size
    scheduled = False
    for i in range(n):
        for j in range(3):
            scheduled = scheduled or G[i, j] != 0.0
    for i in range(3):
        u = 0.0
        for j in range(n):
            u += C[i, j] * x[j]
        for j in range(D.shape[1]):
            u += D[i, j] * y[j]
        command[i] = min(max(u, -limits[i]), limits[i])
        work[n + i] = command[i] - u
    rates = (0.0, 0.0, 0.0)
    if scheduled:
        rates = euler_rates((x[0], x[1], x[2]), (x[3], x[4], x[5]))
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += A[i, j] * x[j]
        for j in range(B.shape[1]):
            s += B[i, j] * y[j]
        s += G[i, 0] * rates[0] + G[i, 1] * rates[1] + G[i, 2] * rates[2]
        s += H[i, 0] * work[n] + H[i, 1] * work[n + 1] + H[i, 2] * work[n + 2]
        work[i] = s
    for i in range(n):
        x[i] = work[i]


@compiled
def _step(A: Matrix, B: Matrix, C: Matrix, D: Matrix, G: Matrix, H: Matrix, limits: Matrix, x: Matrix,
          y: Matrix, command: Matrix, work: Matrix) -> None:  # fmt: skip
    law_kernel(A, B, C, D, G, H, limits, x, y, command, work)


def step(law: Law, x: Matrix, y: Matrix) -> tuple[Matrix, Matrix]:
    """Return the next state (n,) and the command (3,) [N*m or rad/s] B for `y`, (9,), or (6,) without accelerometer.

    Raises
    ------
    ValueError
        If `y` is neither, or lacks the specific force that the law reads.
    """
    if y.shape not in ((law.D.shape[1],), (MEASURED,)):
        raise ValueError(f"y has shape {y.shape}, must be {(law.D.shape[1],)}")
    x_next, command = x.copy(), np.empty(3)
    _step(law.A, law.B, law.C, law.D, law.G, law.H, law.limits, x_next, y, command, np.empty(x.size + 3))
    return x_next, command


class FlyingLaw:
    """A law in flight, asked to hold level at first, from its stated initial state: all states 0.

    Its steps give the bits of `step`; everything is in two arrays that stay, as Python hands them over fastest.
    `scale` (3,) [N*m or rad/s] B is what 1.0 on the wire means.
    """

    def __init__(self, law: Law, scale: Vector) -> None:
        columns = np.column_stack([law.C, law.D, law.limits, scale, np.zeros((3, 4))])
        self._gains = np.vstack([np.hstack([law.A, law.B, law.G, law.H]), columns])
        self._memory = np.zeros(2 * law.order + MEASURED + 6)
        self._order = law.order

    def restart(self) -> None:
        """Go back to the initial state; the reference stays."""
        self._memory[: self._order] = 0.0

    def set_reference(self, euler: Vector) -> None:
        """Ask for another attitude from the next step on: roll, pitch, yaw [rad]."""
        self._memory[self._order + 3 : self._order + 6] = euler

    def step(self, gyro_B: Vector, force_B: Vector) -> Vector:
        """Return the command for rates [rad/s] and specific force [m/s^2] as float32 fractions of `scale`; move on."""
        fractions: Vector = _fly(self._gains, self._memory, *gyro_B, *force_B)
        return fractions


@compiled
def _fly(
    gains: Matrix, memory: Matrix, p: float, q: float, r: float, force_x: float, force_y: float, force_z: float
) -> Vector:
    n = gains.shape[0] - 3
    end = gains.shape[1] - 6  # of the columns of B
    states, outputs = gains[:n], gains[n:]
    x, y, command, work = memory[:n], memory[n : n + 9], memory[n + 9 : n + 12], memory[n + 12 :]
    y[0], y[1], y[2] = p, q, r
    y[6], y[7], y[8] = force_x, force_y, force_z
    law_kernel(
        states[:, :n], states[:, n:end], outputs[:, :n], outputs[:, n:end],
        states[:, end : end + 3], states[:, end + 3 :], outputs[:, end], x, y, command, work,
    )  # fmt: skip
    scale = outputs[:, end + 1]
    return float32(command[0] / scale[0]), float32(command[1] / scale[1]), float32(command[2] / scale[2])


def _law_from(document: Any) -> Law:
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
        name=str(document["name"]),
        **{name: document[name] for name in _MATRICES},
        dt=float(document["dt"]),
        limits=document["limits"],
        output=Output(document["output"]),
        provenance=Provenance(**provenance),
    )


def _layout(document: dict[str, Any]) -> str:
    """Return JSON with one matrix row a line, so that a person can read it and a diff shows what changed."""
    lines = []
    for key, value in document.items():
        if key in _MATRICES:
            rows = ",\n    ".join(json.dumps(row) for row in value)
            lines.append(f'  "{key}": [\n    {rows}\n  ]')
        else:
            lines.append(f'  "{key}": {json.dumps(value, ensure_ascii=False)}')
    return "{\n" + ",\n".join(lines) + "\n}\n"
