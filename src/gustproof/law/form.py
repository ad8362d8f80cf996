"""The one form of every flying law, and its file.

    s  = S x + T y,      e = W(E) clip(s) - s,
    w  = Delta (J x + K y + L w),
    u  = C x + D y + U e + P w,      command = clip(u),
    x+ = A x + B y + G f(x) + H (command - u) + V e + Q w,

with `y` = (gyro p, q, r [rad/s]; reference phi, theta, psi [rad]; roll, pitch [rad] by gravity). `f(x) = T(E) omega`
are the exact Euler kinematics at the law's own estimates `E = x[0:3]` [rad] and `omega = x[3:6]` [rad/s]. With `G = 0`
a law is linear; `H` is its anti-windup. A law without accelerometer has no columns for gravity in B and D. PID,
H-infinity and self-scheduled laws differ in these numbers only, so a comparison compares gains.

At an estimated pitch beyond 60 deg Euler rates change much within a sample. There the angles of the exact rotation by
`omega dt` take the place of `E + f dt` in `x+`, with pitch within a quarter turn. Proofs are for less pitch.

`s` [rad/s] is the rate commanded from attitude; see `RateLimit`. Where it is within its limit, `e` is exactly 0 and the
law is that of A to H alone. A law may have no such limit: then S, T, U and V are absent.

`w` schedules a law on its own attitude and the measured rates, see `Schedule`. Delta is 0 at level rest, so that linear
analysis at hover is again that of A to H alone. A law may have no schedule: then J, K, L, P and Q are absent.
"""

import json
import math
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from functools import cache
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import (
    checked_name,
    list_shipped,
    parse_json,
    read_text,
    shipped_path,
    tell_kind,
    write_text,
)
from firmware_model.config.validation import sanitize_line
from firmware_model.config.vehicle import Vehicle, list_vehicles, load_vehicle, vehicle_digest
from firmware_model.errors import ConfigError
from gustproof.robust.shown import Shown
from gustproof.types import readonly_copy
from gustproof.version import __version__

LAWS = Path(__file__).parent / "data"
FORMAT = "gustproof-law-1"
_FAMILY, _WRONG_FORMAT = FORMAT.rstrip("0123456789"), f"format: must be '{FORMAT}'"
SAMPLE_TIMES = 1.0 / 2000.0, 1.0 / 10.0
"""[s] least and largest sample time: of the rates that a scenario may have."""
GYRO_REFERENCE_SIZE, GRAVITY_AIDED_SIZE = 6, 8
"""Columns of B and D: gyro and reference; these with roll and pitch by gravity."""
_MATRICES = ("A", "B", "C", "D", "G", "H")
_RATE_MATRICES = ("S", "T", "U", "V")
SCHEDULE_MATRICES = ("J", "K", "L", "P", "Q")
ANGLES, BODY_RATES = ("phi", "theta"), ("p", "q", "r")
"""Parameters of a schedule: estimated angles [rad], measured rates [rad/s] B."""

Matrix = NDArray[np.float64]


class LawFileError(ConfigError):
    """A law file is wrong; the text is one line: file, key, allowed values."""


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


@cache
def _shipped_digest(name: str) -> str:
    return vehicle_digest(load_vehicle(name))


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
    vehicle_digest: str = ""
    """SHA-256 of the numbers of the vehicle; absent for a shipped one."""

    @classmethod
    def of(cls, vehicle: Vehicle, design: str, parameters: dict[str, float]) -> "Provenance":
        """Return the origin of a law that is made now for a vehicle."""
        found = cls(design=design, vehicle=vehicle.name, parameters=parameters, version=__version__)
        digest = vehicle_digest(vehicle)
        shipped = vehicle.name in list_vehicles() and digest == _shipped_digest(vehicle.name)
        return found if shipped else replace(found, vehicle_digest=digest)

    @property
    def shipped_vehicle(self) -> str | None:
        """Name of the vehicle of the design if that is a shipped one."""
        return None if self.vehicle_digest or self.vehicle not in list_vehicles() else self.vehicle

    def fits(self, vehicle: Vehicle) -> bool:
        """Return whether a vehicle has the numbers of the design's, whatever its name is.

        Where the law tells no numbers, the names are compared; a law of no vehicle fits each.
        """
        digest = self.vehicle_digest or (self.shipped_vehicle and _shipped_digest(self.shipped_vehicle))
        return digest == vehicle_digest(vehicle) if digest else self.vehicle in ("", vehicle.name)

    def __post_init__(self) -> None:
        """Check that texts are texts and figures are numbers."""
        for key in ("design", "vehicle", "version", "vehicle_digest"):
            if not isinstance(getattr(self, key), str):
                raise ValueError(f"provenance.{key}: is {getattr(self, key)!r}, must be a text")
        if not isinstance(self.parameters, dict):
            raise ValueError(f"provenance.parameters: is {self.parameters!r}, must be an object")
        for key, value in self.parameters.items():
            if isinstance(value, bool) or not isinstance(value, Real):
                raise ValueError(f"provenance.parameters.{key}: is {value!r}, must be a number")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateLimit:
    """Limit of the rate commanded from attitude, the `MC_*RATE_MAX` of PX4's cascade; m axes of n states.

    Without it a large attitude error demands more rate than the actuators can stop again, and the vehicle tumbles.
    `s = S x + T y` are Euler rates, clipped at `limits`. At a large tilt body rates are others: `W = T^-1`, taken at
    the part of roll and pitch beyond `Law.attitude_limits`, turns the ones into the others. The excess `e` of what is
    left over `s` enters command and states by U and V.

    The limit is inactive, `e = 0` to the bit, while `|s| <= limits` and the estimates of roll and pitch are within
    `Law.attitude_limits`. Linear analysis is for that case.

    Examples
    --------
    >>> from gustproof import load_law
    >>> load_law("flagship").rate_limit.limits.tolist()
    [3.0, 3.0, 3.0]
    """

    S: Matrix
    """(m, n) state to commanded rate."""
    T: Matrix
    """(m, 6 or 8) measurements and reference to commanded rate, as many columns as B."""
    U: Matrix
    """(m, m) excess of the commanded rate to command."""
    V: Matrix
    """(n, m) excess of the commanded rate to next state."""
    limits: Matrix
    """(m,) [rad/s] largest commanded rate about each axis."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Schedule:
    """Dependence of a law on k parameters, a linear fractional transformation with them as Delta.

    `Delta = diag(delta)`. Of an angle `delta = tan(angle / 2) / tan(limit / 2)`, of a rate `rate / limit`. The Euler
    kinematics are rational in these tangents. A parameter beyond its limit counts as at it, so that |delta| <= 1.

    Angles are the law's own estimates `E` before the sample, rates the gyro's at the sample. Both hold over it: for
    parameters at rest the law is the trapezoidal rule's image of the continuous one.

    With |L| < 1 the equation of `w` has one solution for every Delta. Elimination finds it without pivots: the
    symmetric part of `I - Delta L` is positive definite, and so is that of what remains at each step.

    References
    ----------
    A. Packard, Gain scheduling via linear fractional transformations, Systems & Control Letters 22 (1994), 79-92.

    Examples
    --------
    >>> import numpy as np
    >>> from dataclasses import replace
    >>> from gustproof import Schedule, load_law
    >>> law, one = load_law("hinf-d1"), np.zeros((1, 1))
    >>> stiffer = Schedule(
    ...     parameters=("p",), limits=np.ones(1), J=np.zeros((1, 9)), K=np.eye(1, 6), L=one, P=-np.eye(3, 1),
    ...     Q=np.zeros((9, 1)),
    ... )
    >>> replace(law, schedule=stiffer).schedule.parameters
    ('p',)
    """

    parameters: tuple[str, ...]
    """(k,) parameter of each row: phi, theta, p, q or r."""
    limits: Matrix
    """(k,) [rad or rad/s] largest magnitude of each."""
    J: Matrix
    """(k, n) state to the input of Delta."""
    K: Matrix
    """(k, 6 or 8) measurements and reference to the input of Delta, as many columns as B."""
    L: Matrix
    """(k, k) output of Delta to its input; its largest singular value is below 1."""
    P: Matrix
    """(3, k) output of Delta to command."""
    Q: Matrix
    """(n, k) output of Delta to next state."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Law(Shown):
    """A discrete law of n states; matrices are checked on construction, then read-only.

    Raises
    ------
    ValueError
        If the name is not allowed in a file name, a shape does not fit, or a number is not finite. Limits must be
        positive, and `dt` that of 10 to 2000 Hz.

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
    """(n, 6 or 8) measurements and reference to next state."""
    C: Matrix
    """(3, n) state to command."""
    D: Matrix
    """(3, 6 or 8) measurements and reference to command, as many columns as B."""
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
    rate_limit: RateLimit | None = None
    """Limit of the rate commanded from attitude; `None` for a law without it."""
    schedule: Schedule | None = None
    """Dependence on attitude and rates; `None` for a law without it."""

    def __post_init__(self) -> None:
        """Check name, shapes and values; set the arrays read-only."""
        try:
            checked_name(self.name)
        except ValueError as error:
            raise ValueError(f"name: {error} (given {self.name!r})") from None
        n = np.asarray(self.A).shape[0] if np.ndim(self.A) == 2 else 0
        m = GRAVITY_AIDED_SIZE if np.shape(self.D)[1:] == (GRAVITY_AIDED_SIZE,) else GYRO_REFERENCE_SIZE
        shapes = {"A": (n, n), "B": (n, m), "C": (3, n), "D": (3, m), "G": (n, 3), "H": (n, 3), "limits": (3,)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly_copy(name, getattr(self, name), shape))
        if not SAMPLE_TIMES[0] <= self.dt <= SAMPLE_TIMES[1]:
            raise ValueError(f"dt is {self.dt!r}, must be from {SAMPLE_TIMES[0]} to {SAMPLE_TIMES[1]} s")
        if not np.all(self.limits > 0.0):
            raise ValueError(f"limits are {self.limits.tolist()}, must be positive")
        if self.has_kinematics and n < 6:
            raise ValueError(f"G is not 0 but A has order {n}; attitude and rates need x[0:6]")
        object.__setattr__(self, "rate_limit", self.rate_limit and _check_rate_limit(self.rate_limit, n, m))
        object.__setattr__(self, "schedule", self.schedule and _checked_schedule(self.schedule, n, m))

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.A.shape[0])

    @property
    def uses_accelerometer(self) -> bool:
        """True if the law reads the accelerometer."""
        return bool(self.D.shape[1] == GRAVITY_AIDED_SIZE)

    @property
    def takes_references(self) -> bool:
        """True if the law reads an attitude reference; any other holds level."""
        return bool(self.B[:, 3:6].any() or self.D[:, 3:6].any())

    @property
    def attitude_limits(self) -> Matrix:
        """(3,) [rad] attitude estimates that alone command the limited rates; infinite without `rate_limit`."""
        if self.rate_limit is None:
            return np.full(3, math.inf)
        return np.abs(self.rate_limit.limits / np.diag(self.rate_limit.S[:, :3]))

    @property
    def has_kinematics(self) -> bool:
        """True if the law's attitude estimate follows the exact kinematics, by `G`."""
        return bool(np.any(self.G))

    @property
    def is_scheduled(self) -> bool:
        """True if the law turns by its own attitude estimate: it has exact kinematics of it, or a schedule."""
        return self.has_kinematics or self.schedule is not None

    def lines(self) -> list[str]:
        """Return what the law reads, commands and comes from; its matrices are attributes."""
        limits = ", ".join(f"{limit:.3g}" for limit in self.limits)
        unit, origin = "N m" if self.output is Output.TORQUE else "rad/s", self.provenance
        reads = ["gyro", *["reference"] * self.takes_references, *["accelerometer"] * self.uses_accelerometer]
        turns = f", scheduled on {', '.join(self.schedule.parameters)}" if self.schedule else ""
        return [
            f"law {self.name}",
            f"commands: {self.output.value}, roll, pitch, yaw up to {limits} {unit}",
            f"reads: {', '.join(reads)}, each {1000.0 * self.dt:g} ms",
            f"states: {self.order}{', attitude by exact kinematics' if self.has_kinematics else ''}{turns}",
            f"made: {origin.design}, for vehicle {origin.vehicle or 'unknown'}",
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the law as JSON for `parse_law`; every number is kept to the bit."""
        return {
            "format": FORMAT,
            "name": self.name,
            "output": self.output.value,
            "dt": self.dt,
            "limits": self.limits.tolist(),
            **{name: getattr(self, name).tolist() for name in _MATRICES},
            **({} if self.rate_limit is None else {"rate_limit": _to_lists(self.rate_limit, _RATE_MATRICES)}),
            **({} if self.schedule is None else {"schedule": _schedule_to_dict(self.schedule)}),
            "provenance": {
                "design": self.provenance.design,
                "vehicle": self.provenance.vehicle,
                "parameters": self.provenance.parameters,
                "version": self.provenance.version,
                **({"vehicle_digest": digest} if (digest := self.provenance.vehicle_digest) else {}),
            },
        }

    def save(self, path: str | Path) -> None:
        """Write the law as JSON; every number is kept to the bit."""
        write_text(Path(path), _format_document(self.to_dict()))


def doubt_vehicle(law: Law, vehicle: Vehicle) -> str:
    """Return in words that a law was designed for a vehicle of other numbers; empty if it was not."""
    if law.provenance.fits(vehicle):
        return ""
    made_for = law.provenance.vehicle
    other = f"not '{vehicle.name}'" if made_for != vehicle.name else "but of other numbers"
    return f"law '{law.name}' was designed for vehicle '{made_for}', {other}"


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
    path = law_path(name_or_path)
    try:
        document = parse_json(read_text(path))
    except OSError as error:
        raise LawFileError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise LawFileError(f"{path}: not JSON: {sanitize_line(str(error))}{tell_kind(path)}") from None
    if isinstance(document, dict) and not str(document.get("format")).startswith(_FAMILY):
        raise LawFileError(f"{path}: {_WRONG_FORMAT}{tell_kind(path)}")
    return parse_law(document, str(path))


def law_path(name_or_path: str | Path) -> Path:
    """Return the path of a law file, or of a shipped one by its name.

    Raises
    ------
    LawFileError
        If none of that name is shipped.
    """
    try:
        return shipped_path("law", name_or_path, LAWS, ".json")
    except ConfigError as error:
        raise LawFileError(str(error)) from None


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


def find_vehicle(controller: Any, vehicle: Vehicle | None, scenario: Any = None) -> Vehicle:
    """Return the vehicle to fly: the given one, or the shipped one that a law was made for.

    Raises
    ------
    ValueError
        If none is given, and the controller is no law of a shipped one; or if one of the three is a name.
    """
    for kind, value in (("scenario", scenario), ("law", controller), ("vehicle", vehicle)):
        if isinstance(value, str):
            raise ValueError(f"'{value}' is a name: a flight takes a {kind}, such as load_{kind}('{value}')")
    if vehicle is not None:
        return vehicle
    own = controller.provenance.shipped_vehicle if isinstance(controller, Law) else None
    if own is None:
        raise ValueError(f"'{controller.name}' is a law of no shipped vehicle: vehicle must be given")
    return load_vehicle(own)


def list_laws() -> tuple[str, ...]:
    """Return the names of the shipped laws.

    Examples
    --------
    >>> from gustproof import list_laws
    >>> "flagship" in list_laws()
    True
    """
    return list_shipped(LAWS, ".json")


def _to_lists(part: RateLimit | Schedule, matrices: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(part, name).tolist() for name in ("limits", *matrices)}


def _schedule_to_dict(schedule: Schedule) -> dict[str, Any]:
    return {"parameters": list(schedule.parameters), **_to_lists(schedule, SCHEDULE_MATRICES)}


def _check_rate_limit(rate_limit: RateLimit, n: int, m: int) -> RateLimit:
    """Return the limit with read-only arrays of the law's shapes; `n` states, `m` measurements."""
    shapes = {"S": (3, n), "T": (3, m), "U": (3, 3), "V": (n, 3), "limits": (3,)}
    copies = {name: readonly_copy(f"rate_limit.{name}", getattr(rate_limit, name), shapes[name]) for name in shapes}
    if not np.all(copies["limits"] > 0.0):
        raise ValueError(f"rate_limit.limits are {copies['limits'].tolist()}, must be positive")
    if not (n >= 3 and np.all(np.diag(copies["S"]))):
        raise ValueError("rate_limit.S must command a rate from the attitude x[0:3] of each axis")
    return RateLimit(**copies)


def _checked_schedule(schedule: Schedule, n: int, m: int) -> Schedule:
    """Return the schedule with read-only arrays of the law's shapes; `n` states, `m` measurements."""
    names = schedule.parameters
    if not isinstance(names, list | tuple) or not names or any(name not in (*ANGLES, *BODY_RATES) for name in names):
        raise ValueError(f"schedule.parameters: are {names!r}, must be of {', '.join((*ANGLES, *BODY_RATES))}")
    k = len(names)
    shapes = {"limits": (k,), "J": (k, n), "K": (k, m), "L": (k, k), "P": (3, k), "Q": (n, k)}
    copies = {name: readonly_copy(f"schedule.{name}", getattr(schedule, name), shapes[name]) for name in shapes}
    for name, limit in zip(names, copies["limits"].tolist(), strict=True):
        most = math.pi if name in ANGLES else math.inf
        if not 0.0 < limit < most:
            raise ValueError(f"schedule.limits: {name} up to {limit:g}, must be above 0 and below {most:.4g}")
    if n < 6:
        raise ValueError(f"schedule: A has order {n}; attitude and rates need x[0:6]")
    if not (size := float(np.linalg.norm(copies["L"], 2))) < 1.0:
        raise ValueError(f"schedule.L has the largest singular value {size:.6g}, must be below 1")
    return Schedule(parameters=tuple(names), **copies)


def _parse_part(name: str, kind: type[Any], document: Any) -> Any:
    """Return the optional part of a law, `RateLimit` or `Schedule`, in an object of all its keys."""
    keys = {key.name for key in fields(kind)}
    if not isinstance(document, dict) or set(document) != keys:
        raise ValueError(f"{name}: must be an object of {', '.join(sorted(keys))}")
    return kind(**document)


_OPTIONAL = {"rate_limit": RateLimit, "schedule": Schedule}


def _check_keys(document: Any) -> None:
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ValueError(_WRONG_FORMAT)
    keys = {"format", "name", "output", "dt", "limits", "provenance", *_MATRICES}
    if unknown := sorted(set(document) - keys - set(_OPTIONAL)):
        raise ValueError(f"{unknown[0]}: unknown key")
    if missing := sorted(keys - set(document)):
        raise ValueError(f"{missing[0]}: missing")
    for key in (*_MATRICES, "limits", *_OPTIONAL):
        if _has_truth(document.get(key)):
            raise ValueError(f"{key}: has true or false in the place of a number")


def _has_truth(value: Any) -> bool:
    """Return whether true or false, which would count as 1 and 0, stands anywhere in a part of a document."""
    if isinstance(value, dict | list):
        return any(_has_truth(each) for each in (value.values() if isinstance(value, dict) else value))
    return isinstance(value, bool)


def _parse_law(document: Any) -> Law:
    _check_keys(document)
    provenance = document["provenance"]
    if not isinstance(provenance, dict):
        raise ValueError("provenance: must be an object")
    if unknown := sorted(set(provenance) - {"design", "vehicle", "parameters", "version", "vehicle_digest"}):
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
        **{key: _parse_part(key, kind, document[key]) for key, kind in _OPTIONAL.items() if key in document},
    )


def _format_document(document: dict[str, Any]) -> str:
    """Return JSON with one matrix row a line, for readers and diffs."""
    return _format_object(document, "") + "\n"


def _format_object(document: dict[str, Any], margin: str) -> str:
    lines = []
    for key, value in document.items():
        if key in (*_MATRICES, *_RATE_MATRICES, *SCHEDULE_MATRICES):
            rows = f",\n{margin}    ".join(json.dumps(row) for row in value)
            text = f"[\n{margin}    {rows}\n{margin}  ]"
        else:
            text = _format_object(value, "  ") if key in _OPTIONAL else json.dumps(value, ensure_ascii=False)
        lines.append(f'{margin}  "{key}": {text}')
    return "{\n" + ",\n".join(lines) + f"\n{margin}}}"
