"""The sampled loop that a certificate is about, derived from the text of a law file and of a vehicle file.

Part of the check: standard library only. Every number is the exact value of the double that flies.
"""

import hashlib
import json
import math
import tomllib
from collections.abc import Iterable, Iterator
from enum import Enum
from fractions import Fraction
from typing import NamedTuple, cast

from gustproof.checker.evidence_types import End, Entry, GyroTable, LawDocument, StabilizerTable, VehicleDocument
from gustproof.checker.rational import to_rational

TORQUE, RATES = "torque", "rates"
_GRAVITY_AIDED = 8
"""Columns of B and D of a law that reads the accelerometer: gyro, reference, tilt."""
_GRAVITY = Fraction(10)
"""[m/s^2] more than gravity."""
_MOST_STATES = 48
"""Largest order of a law; bounds the time of a check."""
_LONGEST_NAME = 64
"""Characters of a law's name in a statement."""
LAW_FORMAT = "gustproof-law-1"
LAW_KEYS = frozenset({"format", "name", "output", "dt", "limits", "A", "B", "C", "D", "G", "H", "provenance"}) | {
    *("rate_limit", "schedule")
}
"""Keys of a law file that the proofs know. H and a rate limit's U and V act only at a limit, which a box excludes."""


class Use(Enum):
    """Use of a field of the vehicle file in the proofs of a flight."""

    PROVED = "its nominal value is part of the proof"
    AIR = "its nominal value is part of the proof in a scenario's air, and of the damping where the file states none"
    STATED = "the certificate states the noise; with a scenario the file's own counts"
    EXCLUDED = "anything but 0 is refused where the law reads it"
    LATE = "more than a quarter of a sample, beside the one that the proof has, is refused; less is left out"
    IDLE = "it does not act on the attitude of a vehicle on a stand"


VEHICLE_FIELDS = {
    **dict.fromkeys(("name", "source", "description", "mass", "drag_area", "battery"), Use.IDLE),
    **dict.fromkeys(("inertia_B", "actuator_lag", "torque_limit", "rate_damping", "heave_drag"), Use.PROVED),
    **dict.fromkeys(("span", "gust_gain", "gust_yaw_ratio"), Use.AIR),
    **{f"gyro.{key}": Use.STATED for key in ("snr_db", "reference_rate", "noise_model")},
    **{"gyro.range": Use.PROVED, "gyro.bias_B": Use.EXCLUDED},
    **{"accelerometer.range": Use.PROVED, "accelerometer.noise_density": Use.STATED},
    "accelerometer.bias_B": Use.EXCLUDED,
    **{f"stabilizer.{key}": Use.PROVED for key in ("rate_p", "rate_i", "rate_d", "derivative_cutoff")},
    **{f"stabilizer.{key}": Use.IDLE for key in ("angle_p", "rate_limit")},
    "rotors.position_B": Use.PROVED,
    **{f"rotors.{key}": Use.IDLE for key in ("spin", "thrust_max", "drag_ratio")},
    **dict.fromkeys(("gear", "position"), Use.IDLE),
    **{f"command.{key}": Use.IDLE for key in ("autopilot", "full_scale", "thrust_range", "unmeasured")},
    "command.delay": Use.LATE,
}
"""Use of each field of a vehicle file, or of all fields of a part; a file with any other is refused."""


Row = tuple[Fraction, ...]
Rows = tuple[Row, ...]
"""A matrix by rows."""


class Refusal(Exception):
    """Evidence that does not prove the claim; the text names the condition that failed."""


class OnBoardRateLoop(NamedTuple):
    """Gains of the on-board rate loop: torque = p (c - g) + i z - d (g - f), with z' = c - g and f a low pass of g."""

    p: Row
    """(3,) [N*m*s/rad] B."""
    i: Row
    """(3,) [N*m/rad] B."""
    d: Row
    """(3,) [N*m*s/rad] B, of the gyro minus its low pass before the sample."""
    smoothing: Fraction
    """[-] weight of a new sample in the low pass."""


class CommandRateLimit(NamedTuple):
    """Limit of the rate commanded from attitude, `s = S x + T g`, and of the attitude that alone commands it."""

    S: Rows
    """(3, n) [rad/s] state to commanded rate."""
    T: Rows
    """(3, 3) [-] gyro to commanded rate."""
    limits: Row
    """(3,) [rad/s] largest commanded rate."""


class Tilt(NamedTuple):
    """Part of a law that reads roll and pitch of the specific force, which on a stand is gravity alone."""

    B: Rows
    """(n, 2) [1/rad] tilt to next state."""
    D: Rows
    """(3, 2) [N*m/rad] tilt to command."""


class LoopSystem(NamedTuple):
    """Numbers of a law and a vehicle, as far as a flight within the limits depends on them."""

    name: str
    """Name of the law."""
    A: Rows
    """(n, n) state to next state."""
    B: Rows
    """(n, 3) gyro to next state."""
    C: Rows
    """(3, n) state to command."""
    D: Rows
    """(3, 3) gyro to command."""
    G: Rows
    """(n, 3) Euler rates of the law's own estimates to next state."""
    dt: Fraction
    """[s] sample time."""
    limits: Row
    """(3,) [N*m or rad/s] B, largest command."""
    torque_limits: Row
    """(3,) [N*m] B, largest torque."""
    inertia: Row
    """(3,) [kg*m^2] B."""
    damping: Row
    """(3,) [1/s] B, damping moment per rate, divided by the inertia: the same at every inertia within its spread."""
    lag: Fraction
    """[s] time constant of the actuators."""
    gyro_range: Fraction
    """[rad/s] largest rate that the gyro measures."""
    rate_limit: CommandRateLimit | None
    """Limit of the rate commanded from attitude; `None` without one."""
    rate_loop: OnBoardRateLoop | None
    """On-board loop that tracks the commanded rates; `None` for a law that commands torque."""
    tilt: Tilt | None
    """Part that reads the accelerometer; `None` for a law of gyros alone."""
    inertia_spread: Fraction = Fraction(0)
    """[-] the moments of inertia are constant, unknown, and each within this share of its value."""
    lag_spread: Fraction = Fraction(0)
    """[-] the same of the lag."""
    cells: tuple[int, int] = (1, 1)
    """Number of cells that cover the spread of inertia and of lag."""

    @property
    def inverse_inertia(self) -> Row:
        """(3,) [1/(kg*m^2)] B, bounds of one over the inertia."""
        return tuple(1 / ((1 - self.inertia_spread) * value) for value in self.inertia)

    @property
    def inverse_lag(self) -> Fraction:
        """[1/s] bound of one over the lag."""
        return 1 / ((1 - self.lag_spread) * self.lag)

    @property
    def gyroscopic(self) -> Row:
        """(3,) [-] bounds of `|I_j - I_k| / I_i`."""
        low, high, inverse = 1 - self.inertia_spread, 1 + self.inertia_spread, self.inverse_inertia
        bounds = []
        for i in range(3):
            a, b = self.inertia[(i + 1) % 3], self.inertia[(i + 2) % 3]
            bounds.append(max(high * a - low * b, high * b - low * a) * inverse[i])
        return tuple(bounds)


def read_object(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return a JSON object; a key that stands twice would show a reader another number than the one that is proved."""
    document = dict(pairs)
    if len(document) != len(pairs):
        raise Refusal("a key stands twice in one object")
    return document


def sha256(text: str) -> str:
    """Return the SHA-256 of a text in UTF-8, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def read_system(law_text: str, vehicle_text: str) -> LoopSystem:
    """Return the loop of a law file (JSON) and a vehicle file (TOML, nominal values).

    Raises
    ------
    Refusal
        If the law has a schedule or couples its axes, or a number is out of range.
    """
    law, vehicle = _read_law(law_text), cast(VehicleDocument, tomllib.loads(vehicle_text))
    if law["output"] not in (TORQUE, RATES):
        raise Refusal(f"law '{law['name']}' commands {law['output']}, the proof is about torque and rates")
    if law.get("schedule") is not None:
        raise Refusal(
            f"law '{law['name']}' is scheduled on attitude and rates, the proof is about laws without schedule"
        )
    law, gravity_aided = _sort_states_by_axis(law), len(law["D"][0]) == _GRAVITY_AIDED
    _check_vehicle(vehicle, gravity_aided=gravity_aided)
    _check_delay(vehicle, law)
    n = len(law["A"])
    columns = {len(row) for matrix in (law["B"], law["D"]) for row in matrix}
    if columns != {_GRAVITY_AIDED if gravity_aided else 6}:
        raise Refusal(f"law '{law['name']}' has matrices of wrong shapes")
    if n % 3 or not 6 <= n <= _MOST_STATES:
        raise Refusal(f"law '{law['name']}' has {n} states, must have 2 to {_MOST_STATES // 3} for each of three axes")
    B, D = ([row[:3] for row in law["B"]], [row[:3] for row in law["D"]])
    tilt = [[row[6:] for row in matrix] for matrix in (law["B"], law["D"])] if gravity_aided else []
    rows = (law["A"], B, law["C"], D, law["G"], *tilt)
    matrices = [tuple(map(tuple, to_rational(matrix))) for matrix in rows]
    shapes = [(n, n), (n, 3), (3, n), (3, 3), (n, 3), (n, 2), (3, 2)]
    if any((len(M), len(M[0])) != shape for M, shape in zip(matrices, shapes, strict=False)):
        raise Refusal(f"law '{law['name']}' has matrices of wrong shapes")
    if any(value for M in matrices for i, row in enumerate(M) for j, value in enumerate(row) if (i - j) % 3):
        raise Refusal(f"law '{law['name']}' couples its axes, the proof takes them one at a time")
    inertia, dt = _positive("inertia_B", vehicle["inertia_B"], 3), _positive("dt", [law["dt"]])[0]
    torque_limits = tuple(_positive("torque_limit", vehicle["torque_limit"], 3))
    tracks = law["output"] == RATES
    limits = tuple(_positive("limits", law["limits"], 3))
    if not tracks:
        limits = tuple(min(pair) for pair in zip(limits, torque_limits, strict=True))
    return LoopSystem(
        name=ascii(law["name"])[1:-1],
        A=matrices[0],
        B=matrices[1],
        C=matrices[2],
        D=matrices[3],
        G=matrices[4],
        dt=dt,
        limits=limits,
        torque_limits=torque_limits,
        inertia=tuple(inertia),
        damping=_read_damping(vehicle, inertia),
        lag=_positive("actuator_lag", [vehicle["actuator_lag"]])[0],
        gyro_range=_positive("gyro.range", [vehicle["gyro"]["range"]])[0],
        rate_limit=_read_rate_limit(law, n),
        rate_loop=_read_rate_loop(vehicle["stabilizer"], inertia, dt) if tracks else None,
        tilt=_read_tilt(law, vehicle, matrices[5:]) if gravity_aided else None,
    )


def _read_law(text: str) -> LawDocument:
    """Return the law of a file whose name makes no other statement of the one that quotes it."""
    law: LawDocument = json.loads(text, object_pairs_hook=read_object)
    name = law["name"]
    if not name.isprintable() or set("'\\") & set(name) or len(name) > _LONGEST_NAME:
        raise Refusal(f"the law is named {name!a}: the statement quotes the name, so it holds no quote and is short")
    if law["format"] != LAW_FORMAT or set(law) - LAW_KEYS:
        raise Refusal(f"the law's file has another format than {LAW_FORMAT}, or keys that the proof does not know")
    return law


def _check_vehicle(vehicle: VehicleDocument, *, gravity_aided: bool) -> None:
    """Raise `Refusal` for fields that the proof does not know, and for a bias of a sensor that the law reads."""
    for name, value in _fields(vehicle):
        _check_spreads(name, value)
        use = VEHICLE_FIELDS.get(name, VEHICLE_FIELDS.get(name.split(".")[0]))
        if use is None:
            raise Refusal(f"the vehicle file has '{name}', of which the proof does not know how it acts")
        sensor = name.split(".")[0]
        read = sensor == "gyro" or gravity_aided
        if use is Use.EXCLUDED and read and any(finite(name, _nominal(entry)) for entry in cast(list[object], value)):
            raise Refusal(f"the {sensor} has a bias ({name}): the proof is about one without")


def _check_spreads(name: str, value: object) -> None:
    """Raise `Refusal` for a spread that another reader takes for other numbers: in a unit, or from high to low."""
    for entry in value if isinstance(value, list) else ():
        _check_spreads(name, entry)
    if isinstance(value, dict):
        if set(value) != {"low", "nominal", "high"}:
            raise Refusal(f"{name} is a table of {', '.join(sorted(value))}, must be one of low, nominal and high")
        low, nominal, high = (finite(name, value[key]) for key in ("low", "nominal", "high"))
        if not low < nominal < high:
            raise Refusal(f"{name} needs low < nominal < high")


def _check_delay(vehicle: VehicleDocument, law: LawDocument) -> None:
    """Raise `Refusal` if a log measured more delay than the one sample of the proof: flights then have another."""
    late = _not_negative("command.delay", _nominal(vehicle.get("command", {}).get("delay", 0)))
    if 4 * late > _positive("dt", [law["dt"]])[0]:
        raise Refusal(f"the command acts {float(late):g} s late beside one sample (command.delay): the proof has one")


def _fields(vehicle: VehicleDocument) -> Iterator[tuple[str, object]]:
    """Yield the dotted name and the value of each field of a vehicle file."""
    for name, value in vehicle.items():
        if isinstance(value, dict) and "nominal" not in value:
            yield from ((f"{name}.{key}", entry) for key, entry in value.items())
        else:
            yield name, value


def list_uncovered(
    vehicle_text: str, *, inertia: Fraction, lag: Fraction, noise: Fraction | None, dt: Fraction, gravity_aided: bool
) -> list[str]:
    """Return what the vehicle file states and a proof leaves out: spreads, and noise of sensors that the law reads.

    Parameters
    ----------
    vehicle_text
        Vehicle file (TOML).
    inertia, lag
        [-] shares within which the proof holds.
    noise
        [rad/s] rms of a gyro sample in the proof; `None` if it is the file's own.
    dt
        [s] sample time.
    gravity_aided
        True for a law that reads the accelerometer.
    """
    vehicle = cast(VehicleDocument, tomllib.loads(vehicle_text))
    covered = {"inertia_B": inertia, "actuator_lag": lag}
    uses = {Use.PROVED, Use.EXCLUDED, Use.LATE} | ({Use.STATED, Use.AIR} if noise is None else set())
    if "rate_damping" not in vehicle:
        uses.add(Use.AIR)
    left = [
        f"spread of {name}"
        for name, value in _fields(vehicle)
        if VEHICLE_FIELDS.get(name) in uses and _is_wider(value, covered.get(name, Fraction(0)))
    ]
    if noise is not None and noise < _gyro_noise(vehicle["gyro"], dt, "low", "high"):
        nominal = noise < _gyro_noise(vehicle["gyro"], dt, "nominal", "nominal")
        left.append("noise of the gyro" if nominal else "spread of the gyro's noise")
    if _nominal(vehicle.get("command", {}).get("delay", 0)):
        left.append("command.delay beside one sample")
    if gravity_aided and _nominal(vehicle.get("accelerometer", {}).get("noise_density", 0)):
        left.append("noise of the accelerometer")
    return left


def _is_wider(value: object, share: Fraction) -> bool:
    """Return whether a value, or one of several, is spread by more than a share of its nominal value."""
    if isinstance(value, list):
        return any(_is_wider(entry, share) for entry in value)
    if not isinstance(value, dict):
        return False
    # as decimals: the file and the command line mean those
    nominal, low, high, part = (
        Fraction(repr(float(x))) for x in (value["nominal"], value["low"], value["high"], share)
    )
    return low < (1 - part) * nominal or high > (1 + part) * nominal


def _gyro_noise(gyro: GyroTable, dt: Fraction, ratio: End, rate: End) -> float:
    """Return the rms [rad/s] of a gyro sample at these ends of the file's spreads; the file states it at 250 Hz."""
    if gyro.get("noise_model", "constant") != "constant":
        return math.inf
    snr, reference = (_at(value, end) for value, end in ((gyro["snr_db"], ratio), (gyro["reference_rate"], rate)))
    sigma: float = 10.0 ** (-snr / 20.0) * reference / math.sqrt(250.0 * float(dt))
    return sigma


def _at(value: Entry, end: End) -> float:
    return float(value[end] if isinstance(value, dict) else value)


def _read_tilt(law: LawDocument, vehicle: VehicleDocument, matrices: list[Rows]) -> Tilt:
    """Return the part of a law that reads tilt, of an accelerometer that measures gravity whole."""
    if law["output"] != TORQUE:
        raise Refusal(f"law '{law['name']}' reads the accelerometer and commands rates: no proof is known")
    if not any(map(any, law["G"])):
        raise Refusal(f"law '{law['name']}' reads the accelerometer and has no kinematics: no proof is known")
    span = vehicle.get("accelerometer", {}).get("range")
    if span is not None and _positive("accelerometer.range", [span])[0] < _GRAVITY:
        raise Refusal("the accelerometer's range is below gravity")
    return Tilt(*matrices)


def _sort_states_by_axis(law: LawDocument) -> LawDocument:
    """Return a law that reads tilt with its states in turn by axis: roll, pitch, yaw, as all others have them.

    An axis of fewer states gets some that stay 0. A state belongs to the axis that it commands or reads.
    """
    if len(law["D"][0]) != _GRAVITY_AIDED:
        return law
    axes: list[list[int | None]] = [[0, 3], [1, 4], [2, 5]]
    for i in range(6, len(law["A"])):
        axes[_axis_of(law, i)].append(i)
    most = max(map(len, axes))
    places = [axis[k] if k < len(axis) else None for k in range(most) for axis in axes]
    limit = law.get("rate_limit")
    return {
        **law,
        "A": [_columns(row, places) for row in _rows(law["A"], places)],
        "B": _rows(law["B"], places),
        "G": _rows(law["G"], places),
        "C": [_columns(row, places) for row in law["C"]],
        "rate_limit": limit and {**limit, "S": [_columns(row, places) for row in limit["S"]]},
    }


def _axis_of(law: LawDocument, i: int) -> int:
    reads = [*law["B"][i][:3], *law["B"][i][6:]]
    own = {a for a in range(3) if law["C"][a][i]} | {k % 3 for k, value in enumerate(reads) if value}
    if len(own) != 1:
        raise Refusal(f"law '{law['name']}' couples its axes, the proof takes them one at a time")
    return own.pop()


def _rows(matrix: list[list[float]], places: list[int | None]) -> list[list[float]]:
    return [[0.0] * len(matrix[0]) if place is None else matrix[place] for place in places]


def _columns(row: list[float], places: list[int | None]) -> list[float]:
    return [0.0 if place is None else row[place] for place in places]


def _read_stated_damping(given: object) -> Row:
    """Return the rate damping that a file states: one number for all axes, or one for each."""
    rows = given if isinstance(given, list) else [given] * 3
    if len(rows) != 3:
        raise Refusal("rate_damping must be a number, or three")
    return tuple(_not_negative("rate_damping", _nominal(row)) for row in rows)


def _read_damping(vehicle: VehicleDocument, inertia: list[Fraction]) -> Row:
    """Return the rate damping of the file, of all axes or each; without one, that of the rotors' drag, exactly.

    Each rotor has its part of the drag. Roll moves a rotor at (x, y) along its axis by y p, pitch by -x q. Yaw moves
    it in its plane by r sqrt(x^2 + y^2). The vehicle flies the nearest doubles, but for a few roundings.
    """
    if "rate_damping" in vehicle:
        return _read_stated_damping(vehicle["rate_damping"])
    name = "rotors.position_B"
    hubs = [[finite(name, _nominal(value)) for value in hub] for hub in vehicle["rotors"]["position_B"]]
    if [len(hub) for hub in hubs] != [3] * max(len(hubs), 4):
        raise Refusal(f"{name} must be three numbers for each of four or more rotors")
    x_square, y_square = (sum((hub[k] ** 2 for hub in hubs), Fraction(0)) / len(hubs) for k in (0, 1))
    height = -sum((hub[2] for hub in hubs), Fraction(0)) / len(hubs)
    if height <= 0:
        raise Refusal(f"{name}: the rotors must be above the centre of mass")
    along = _not_negative("heave_drag", _nominal(vehicle["heave_drag"]))
    across = _not_negative("gust_gain", _nominal(vehicle["gust_gain"])) / height
    moments = along * y_square, along * x_square, across * (x_square + y_square)
    return tuple(moment / value for moment, value in zip(moments, inertia, strict=True))


def _read_rate_loop(stabilizer: StabilizerTable, inertia: list[Fraction], dt: Fraction) -> OnBoardRateLoop:
    """Return the on-board rate loop; its coefficients are within 2^-48 of themselves, as doubles compute them."""
    gains = {
        name: [_not_negative(f"stabilizer.{name}", _nominal(value)) for value in stabilizer[name]]
        for name in ("rate_p", "rate_i", "rate_d")
    }
    if any(len(row) != 3 for row in gains.values()):
        raise Refusal("the gains of the stabilizer must be three numbers each")
    cutoff = _positive("stabilizer.derivative_cutoff", [stabilizer["derivative_cutoff"]])[0]
    smoothing = Fraction(1.0 - math.exp(-float(dt) * 2.0 * math.pi * float(cutoff)))
    p, i, d = (tuple(gain * value for gain, value in zip(row, inertia, strict=True)) for row in gains.values())
    return OnBoardRateLoop(p, i, tuple(value * smoothing / dt for value in d), smoothing)


def _read_rate_limit(law: LawDocument, n: int) -> CommandRateLimit | None:
    """Return the law's limit of the rate commanded from attitude, at the reference 0; `None` without one.

    A proven box lies within it, so the limit is inactive: the law is that of A to G alone.
    """
    limit = law.get("rate_limit")
    if limit is None:
        return None
    if any(value for row in limit["T"] for value in row[6:]):
        raise Refusal(f"law '{law['name']}' commands rates from tilt as measured, the proof is about its own attitude")
    S, T = (tuple(map(tuple, to_rational(rows))) for rows in (limit["S"], [row[:3] for row in limit["T"]]))
    if [(len(M), {len(row) for row in M}) for M in (S, T)] != [(3, {n}), (3, {3})]:
        raise Refusal(f"law '{law['name']}' has a rate limit of wrong shape")
    return CommandRateLimit(S, T, tuple(_positive("rate_limit.limits", limit["limits"], 3)))


def is_strapdown(system: LoopSystem) -> bool:
    """Return whether attitude and rate of the law are the gyro's trapezoid, exactly.

    `x0+ = x0 + dt T(x0) x1 + dt/2 (g - x1)` and `x1+ = g`, coefficient by coefficient.
    """
    half = system.dt / 2
    for i in range(3):
        own = {i: Fraction(1), 3 + i: -half}
        attitude = all(value == own.get(j, 0) for j, value in enumerate(system.A[i]))
        if not (attitude and system.B[i][i] == half and system.G[i][i] == system.dt):
            return False
        if any(system.A[3 + i]) or system.B[3 + i][i] != 1 or any(system.G[3 + i]):
            return False
    return True


def finite(name: str, value: object) -> Fraction:
    """Return a JSON number exactly; refuse anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise Refusal(f"{name} is {value!r}, must be a finite number")
    return Fraction(value)


def _nominal(value: object) -> object:
    """Return the nominal value of an entry of a vehicle file that may state a spread."""
    return value["nominal"] if isinstance(value, dict) else value


def _positive(name: str, values: Iterable[object], count: int = 1) -> list[Fraction]:
    numbers = [finite(name, _nominal(value)) for value in values]
    if len(numbers) != count or min(numbers) <= 0:
        raise Refusal(f"{name} must be {count} positive number{'s' if count > 1 else ''}")
    return numbers


def _not_negative(name: str, value: object) -> Fraction:
    number = finite(name, value)
    if number < 0:
        raise Refusal(f"{name} is {float(number)}, must not be negative")
    return number
