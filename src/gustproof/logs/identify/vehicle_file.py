"""Vehicle file of an identification: what the log shows with its interval, the rest from a known vehicle.

A log in N m shows inertias. One in shares of the autopilot's full scale shows only torque over inertia. Then inertias
are given, or taken from a known vehicle, and torque limits follow from them.

A vehicle of another mass is scaled as models are in free flight (Froude): lengths as the cube root of mass, times as
the root of length.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from firmware_model.config.uncertainty import make_vehicle_set
from firmware_model.config.vehicle import FullScale, Vehicle, load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.types import AXES, Vector
from gustproof.logs.identify.air import IdentifiedAir
from gustproof.logs.identify.identification import Identification, Interval
from gustproof.logs.read.flight_log import CommandUnit
from gustproof.version import __version__

_DEFAULT_LIKE = "iris"
_ASSUMED_SPREAD = 0.3
_DELAY_TOLD = 0.002  # [s]
_NARROWEST = 1e-3  # of a spread, beside its number
_ROUNDED = 1e-5  # of a number that is written with six digits
_COMMAND_ORIGINS = {
    FullScale.MEASURED: "measured: 1.0 of the autopilot's command gives torque_limit, whatever the rotors say",
    FullScale.ROTORS: "1.0 of an autopilot's command gives what the rotors say",
    FullScale.UNKNOWN: "the log does not tell what 1.0 of an autopilot's command gives, and the rotors are assumed",
}
_POWERS = {
    "mass": 3.0,
    "inertia_B": 5.0,
    "torque_limit": 4.0,
    "span": 1.0,
    "gust_gain": 3.5,
    "heave_drag": 2.5,
    "drag_area": 2.0,
    "rotors.position_B": 1.0,
    "rotors.thrust_max": 3.0,
    "rotors.drag_ratio": 1.0,
    "gear.half_length": 1.0,
    "gear.half_width": 1.0,
    "gear.height": 1.0,
    "gear.sag": 1.0,
}
"""Powers of length by which numbers grow with a vehicle."""
_UNITS = {
    "mass": "[kg]",
    "inertia_B": "[kg*m^2]",
    "actuator_lag": "[s]",
    "torque_limit": "[N*m]",
    "span": "[m]",
    "gust_gain": "[N*m/(m/s)]",
    "gust_yaw_ratio": "[-]",
    "heave_drag": "[N/(m/s)]",
    "drag_area": "[m^2]",
    "rate_damping": "[1/s]",
    "gyro.snr_db": "[dB]",
    "rotors.thrust_max": "[N]",
    "command.delay": "[s]",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """Numbers that no log shows, as far as they are known."""

    like: str | None = None
    """Vehicle, by name or file, whose numbers stand for those that are missing."""
    mass: float | None = None
    """[kg]."""
    thrust_max: float | None = None
    """[N] of one rotor."""
    inertia_B: Vector | None = None
    """[kg*m^2] B."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleFile:
    """Vehicle file, checked."""

    text: str
    """Content as TOML."""
    vehicle: Vehicle
    """Vehicle with all numbers nominal."""
    findings: tuple[str, ...]
    """Doubts, a line each."""


@dataclass(slots=True, kw_only=True)
class _Draft:
    """Document of a file with the origin of its numbers."""

    document: dict[str, Any]
    """Content of the file, numbers with the units of a vehicle's fields."""
    origin: str
    """Origin of numbers that have none of their own."""
    origins: dict[str, str]
    """Origins by dotted key."""
    findings: list[str]
    """Doubts, a line each."""

    def set(self, key: str, value: Any, origin: str) -> None:
        """Set a number and its origin."""
        section, _, name = key.rpartition(".")
        (self.document[section] if section else self.document)[name] = value
        self.origins[key] = origin


def make_vehicle_file(name: str, found: Identification, known: Known, air: IdentifiedAir | None = None) -> VehicleFile:
    """Return the file of the identified vehicle; `air` adds what the wind tells of it.

    Raises
    ------
    ConfigError
        If neither roll nor pitch is identified, numbers are missing, or no such vehicle is possible.
    """
    if found.actuator_lag is None or all(full_scale_gain(found, k) is None for k in (0, 1)):
        advice = next((axis.advice for axis in found.axes if axis.advice), "nothing excites them")
        raise ConfigError(f"{found.source}: no vehicle: neither roll nor pitch is identified: {advice}")
    draft = _start(found, known)
    _add_inertia(draft, found, known)
    _add_command(draft, found, known)
    draft.set("actuator_lag", _spread(found.actuator_lag), "measured")
    _add_damping(draft, found)
    _add_gyro(draft, found)
    if air is not None and air.yaw_ratio is not None:
        draft.set("gust_yaw_ratio", air.yaw_ratio, "measured: moment in yaw beside roll and pitch")
    draft.findings.append(
        f"the wind's speed is a guess: a log shows gust_gain times wind, and gust_gain is {draft.origin}"
    )
    if found.delay is not None and found.delay.nominal > _DELAY_TOLD:
        draft.findings.append(
            f"torque begins {1e3 * found.delay.nominal:.1f} ms after its command is logged: the file keeps it as "
            "command.delay, and every loop on the vehicle has it"
        )
    document = {"source": f"{found.source}, identified by gustproof {__version__}; the rest {draft.origin}"}
    document |= {key: value for key, value in draft.document.items() if key not in ("name", "source", "description")}
    vehicle = make_vehicle_set({"name": name, **document}, name).nominal
    return VehicleFile(text=_render(document, draft), vehicle=vehicle, findings=tuple(draft.findings))


def full_scale_gain(found: Identification, k: int) -> Interval | None:
    """Return the angular acceleration [rad/s^2] of a full command about an axis, `None` if it is not identified.

    Where motors alone are logged, a full command is all of one sign at full thrust, and the others off.
    """
    gain = found.axes[k].gain
    if gain is None or found.motor_gains is None:
        return gain
    motors = found.motor_gains[k]
    share = float(np.maximum(motors, 0.0).sum() / np.abs(motors).sum())
    return Interval(share * gain.low, share * gain.nominal, share * gain.high)


def _in_newton_metres(found: Identification) -> bool:
    return found.command_unit is CommandUnit.NEWTON_METRES


def _start(found: Identification, known: Known) -> _Draft:
    """Return the document of the vehicle that the rest is taken from, of the mass that is known."""
    like = load_vehicle(known.like or _DEFAULT_LIKE)
    factor, origin = _compare_mass(found, known, like)
    document = _scale(to_jsonable_python(like, exclude_none=True), factor ** (1.0 / 3.0))
    draft = _Draft(document=document, origin=origin, origins={}, findings=[])
    if known.like is None and found.actuator_lag is not None:
        _slow_down(document["stabilizer"], found.actuator_lag.nominal / like.actuator_lag)
    if known.mass is not None:
        draft.set("mass", known.mass, "given")
    elif known.like is None:
        draft.findings.append(
            f"the mass of {document['mass']:.3g} kg is {origin}: gains and margins do not depend on it, torques and "
            "winds do: weigh the vehicle and give it"
        )
    if known.thrust_max is not None:
        of = document["rotors"]["thrust_max"]
        draft.set("rotors.thrust_max", known.thrust_max, "given")
        limits = [limit * known.thrust_max / of for limit in document["torque_limit"]]
        draft.set("torque_limit", limits, f"{origin}; by the thrust given")
    rotors = len(document["rotors"]["position_B"])
    if found.motor_gains is not None and found.motor_gains.shape[1] != rotors:
        draft.findings.append(
            f"the log has {found.motor_gains.shape[1]} motors, the file {rotors}: rotors are {origin}"
        )
    return draft


def _compare_mass(found: Identification, known: Known, like: Vehicle) -> tuple[float, str]:
    """Return the factor on the mass of the vehicle that the rest is taken from, and the origin of what it gives."""
    if known.inertia_B is not None and _in_newton_metres(found):
        raise ConfigError(f"{found.source}: its commands are in N m, which measure the inertia: it can't be given")
    if known.like is not None:
        return 1.0, f"taken from {like.name}"
    if known.mass is not None:
        return known.mass / like.mass, f"assumed: {like.name} scaled to this mass"
    rows = known.inertia_B or (_measured_inertia(found) if _in_newton_metres(found) else None)
    if rows is None:
        return 1.0, f"assumed: of {like.name}, as neither mass nor inertia is given"
    ratio = [row / of for row, of in zip(rows[:2], like.inertia_B[:2], strict=True) if row is not None]
    return float(np.mean(ratio)) ** 0.6, f"assumed: {like.name} scaled to this inertia"


def _scale(document: dict[str, Any], factor: float, prefix: str = "") -> dict[str, Any]:
    """Return the document of a vehicle whose lengths are `factor` times as large."""

    def scale(key: str, value: Any) -> Any:
        if isinstance(value, dict):
            return _scale(value, factor, f"{key}.")
        return (np.array(value) * factor ** _POWERS[key]).tolist() if key in _POWERS and factor != 1.0 else value

    return {name: scale(f"{prefix}{name}", value) for name, value in document.items()}


def _slow_down(stabilizer: dict[str, Any], factor: float) -> None:
    """Slow the on-board loops as the actuators are slower."""
    slower = max(factor, 1.0)
    stabilizer["angle_p"] /= slower
    stabilizer["rate_p"] = [gain / slower for gain in stabilizer["rate_p"]]
    stabilizer["rate_i"] = [gain / slower**2 for gain in stabilizer["rate_i"]]


def _measured_inertia(found: Identification) -> tuple[float | None, ...]:
    return tuple(None if axis.gain is None else 1.0 / axis.gain.nominal for axis in found.axes)


def _add_inertia(draft: _Draft, found: Identification, known: Known) -> None:
    """Set inertias with their spreads, those of the gains, and the torque limits of commands without a unit."""
    gains = [full_scale_gain(found, k) for k in range(3)]
    if _in_newton_metres(found):
        nominal, origin = _complete_inertia(found, draft.document["inertia_B"]), "measured"
    else:
        nominal, origin = (
            list(known.inertia_B or draft.document["inertia_B"]),
            "given" if known.inertia_B else draft.origin,
        )
        draft.findings.append(
            f"the log's commands have no unit: torque over inertia is measured, and inertia_B is {origin}"
        )
        origin += "; spread of the measured gain"
    missing = [axis for axis, gain in zip(AXES, gains, strict=True) if gain is None]
    if missing:
        origin += f"; {' and '.join(missing)} assumed, 30 % either way"
    spreads = [_inertia_spread(row, gain) for row, gain in zip(nominal, gains, strict=True)]
    rows = _fit_body(spreads, draft)
    draft.set("inertia_B", [_spread(row) for row in rows], origin)
    if not _in_newton_metres(found):
        _add_torque(draft, gains, rows)


def _add_torque(draft: _Draft, gains: list[Interval | None], rows: list[Interval]) -> None:
    """Set the torque limits by the measured gains.

    An axis of roll and pitch that is not identified turns as quickly as the other. A yaw that is not is as much off the
    known vehicle's as those are.
    """
    quick = [gain.nominal for gain in gains[:2] if gain is not None]
    limits = [row.nominal * (quick[0] if gain is None else gain.nominal) for gain, row in zip(gains, rows, strict=True)]
    if gains[2] is None:
        known = draft.document["torque_limit"]
        limits[2] = known[2] * (limits[0] + limits[1]) / (known[0] + known[1])
    draft.set("torque_limit", limits, "measured gain times inertia: what 1.0 of the command gives")


def _add_command(draft: _Draft, found: Identification, known: Known) -> None:
    """Set what the log tells of the command: the source of its full scale, its delay, the axes that are guessed."""
    if _in_newton_metres(found) or found.motor_gains is not None:
        scale = FullScale.ROTORS if known.like is not None and _in_newton_metres(found) else FullScale.UNKNOWN
    else:
        scale = FullScale.MEASURED
    command: dict[str, Any] = {"autopilot": found.system, "full_scale": scale.value, "delay": _delay(found)}
    if found.thrust_range != 1.0:
        command["thrust_range"] = found.thrust_range
    unmeasured = [axis for axis, estimate in zip(AXES, found.axes, strict=True) if estimate.gain is None]
    if unmeasured:
        command["unmeasured"] = unmeasured
    draft.set("command", command, _COMMAND_ORIGINS[scale])
    draft.origins |= {"command.delay": "from a command to its torque at the nominal lag"}


def _delay(found: Identification) -> float | dict[str, float]:
    """Return the delay [s] at the nominal lag, with the interval of both together: they are known as a sum."""
    if found.delay is None or found.lateness is None or found.actuator_lag is None:
        return 0.0
    lag, delay = found.actuator_lag.nominal, max(found.delay.nominal, 0.0)
    low, high = max(found.lateness.low - lag, _NARROWEST * delay), found.lateness.high - lag
    return _spread(Interval(low, delay, high)) if low < delay < high else delay


def _complete_inertia(found: Identification, base: list[float]) -> list[float]:
    """Return the measured inertias (3,) [kg*m^2]; of axes not identified, those of a body shaped as `base`."""
    measured = _measured_inertia(found)
    factor = float(np.mean([row / of for row, of in zip(measured, base, strict=True) if row is not None]))
    return [factor * of if row is None else row for row, of in zip(measured, base, strict=True)]


def _inertia_spread(inertia: float, gain: Interval | None) -> Interval:
    if gain is None:
        return Interval(inertia * (1.0 - _ASSUMED_SPREAD), inertia, inertia * (1.0 + _ASSUMED_SPREAD))
    return Interval(inertia * gain.nominal / gain.high, inertia, inertia * gain.nominal / gain.low)


def _fit_body(rows: list[Interval], draft: _Draft) -> list[Interval]:
    """Return the inertias within those of a rigid body: none is larger than the sum of the other two."""
    fitted, most_written = list(rows), 1.0 - _ROUNDED
    for k, row in enumerate(rows):
        one, other = (fitted[j] for j in range(3) if j != k)
        most = (one.nominal + other.nominal) * (1.0 - 2.0 * _NARROWEST)
        least = max(one.low - other.high, other.low - one.high)
        if row.nominal > most:
            draft.findings.append(
                f"measured inertia about {AXES[k]} {row.nominal:.4g} is more than the sum of the other two, which no "
                f"body has: {most:.4g} is written"
            )
        nominal = min(row.nominal, most)
        low = min(max(row.low, least), nominal * (1.0 - _NARROWEST))
        fitted[k] = Interval(low, nominal, min(max(row.high, nominal), most_written * (one.high + other.high)))
    return fitted


def _add_damping(draft: _Draft, found: Identification) -> None:
    """Set the damping of each axis; one that is not identified has the mean of roll and pitch, or of yaw alone."""
    known = [axis.damping for axis in found.axes if axis.damping is not None]
    if not known:
        return
    tilt = [axis.damping for axis in found.axes[:2] if axis.damping is not None] or known
    usual = Interval(*(float(np.mean(each)) for each in zip(*tilt, strict=True)))
    rows = [axis.damping or usual for axis in found.axes]
    values = [
        _spread(Interval(max(row.low, _NARROWEST * row.nominal), *row[1:])) if row.nominal > 0.0 else 0.0
        for row in rows
    ]
    draft.set("rate_damping", values, "measured about each axis")


def _add_gyro(draft: _Draft, found: Identification) -> None:
    """Set the gyro's ratio of its reference rate to the noise of a 250 Hz sample."""
    noise = np.array([axis.noise for axis in found.axes if axis.noise is not None]) * math.sqrt(125.0)
    if not len(noise):
        return
    ratio = 20.0 * np.log10(draft.document["gyro"]["reference_rate"] / noise)
    nominal = 20.0 * math.log10(draft.document["gyro"]["reference_rate"] / math.sqrt(np.mean(noise**2)))
    low, high = float(ratio.min()), float(ratio.max())
    value = {"nominal": nominal, "low": low, "high": high} if low < nominal - 0.1 and high > nominal + 0.1 else nominal
    draft.set(
        "gyro.snr_db",
        value,
        f"measured: {'all' if len(noise) == 3 else f'{len(noise)} of 3'} axes, and the spread between them",
    )


def _spread(interval: Interval) -> dict[str, float]:
    """Return an interval as a spread, low < nominal < high."""
    low, nominal, high = interval
    return {
        "nominal": nominal,
        "low": min(low, nominal * (1.0 - _NARROWEST)),
        "high": max(high, nominal * (1.0 + _NARROWEST)),
    }


def _render(document: Mapping[str, Any], draft: _Draft) -> str:
    sections = {key: value for key, value in document.items() if isinstance(value, dict) and "nominal" not in value}
    lines = [_line(key, key, value, draft) for key, value in document.items() if key not in sections]
    for section, table in sections.items():
        lines += ["", f"[{section}]  # {draft.origins.get(section, draft.origin)}"]
        lines += [_line(f"{section}.{key}", key, value, draft) for key, value in table.items()]
    return "\n".join(lines) + "\n"


def _line(path: str, key: str, value: Any, draft: _Draft) -> str:
    own = draft.origins.get(path, "" if "." in path or key == "source" else draft.origin)
    comment = f"  # {_UNITS.get(path, '')} {own}".rstrip() if own else ""
    if isinstance(value, list) and isinstance(value[0], dict):
        rows = "".join(f"    {_toml(each)},\n" for each in value)
        return f"{key} = [{comment}\n{rows}]"
    return f"{key} = {_toml(value)}{comment}"


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    # JSON's strings are TOML's, except for DEL, which only JSON allows unescaped
    text = json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(float(f"{value:.6g}")) if isinstance(value, float) else text
