"""Parameters of an autopilot's loops: defaults, ranges, and the axis that the loops are built from."""

import math
import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

from firmware_model.config.scenario import sample_time
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.types import Vector
from gustproof.design.loops.filters import SampledAxisLoop
from gustproof.law.cascade import AxisLaw
from gustproof.law.form import Matrix

FLOWN = "_FLOWN"
"""End of the name of what a log tells of a notch that moves [Hz]."""
_FEW = 4  # names that a remark lists
_FASTEST = 2000  # [Hz] of loops that are judged
_NEARLY = 0.01  # below a whole number a value counts as that: ArduPilot's AP_Param::set_float
_TINY = 1e-9  # least value of what has no documented one
_AT_LIMIT = 1e-3  # relative distance within which a value is at a limit: the search stops as near


class Setting(NamedTuple):
    """A parameter: its default in the autopilot, and the values that are taken for no mistake."""

    default: float
    """Value without one in the file."""
    low: float
    """Least value."""
    high: float
    """Largest value."""


class LoopSignals(NamedTuple):
    """Loop of one axis, complete."""

    loop: SampledAxisLoop
    """States and their signals."""
    command: Matrix
    """Signal of the torque [N*m]."""
    commanded: Matrix
    """Signal of the rate commanded from attitude [rad/s]."""
    limit: float | None
    """[rad/s] largest commanded rate; `None` for none."""

    def axis_law(self, order: int, limit: float | None) -> AxisLaw:
        """Return the law of the axis with `order` states and another limit [rad/s]."""
        return self.loop.law(self.command, self.commanded, limit, order)


class AutopilotLoops(NamedTuple):
    """Parameters of an autopilot's rate and attitude loops, and how to read a file of them."""

    name: str
    """Name for users."""
    version: str
    """Version whose equations and defaults these are."""
    later: tuple[str, Mapping[str, float]]
    """Version from which on defaults are others, and these [in their units]."""
    rate_hz: int
    """[Hz] rate of its loops in simulation."""
    settings: Mapping[str, Setting]
    """Parameters of the loops."""
    whole: frozenset[str]
    """Settings that the autopilot keeps as whole numbers; it drops a fraction."""
    documented: Mapping[str, tuple[float | None, float | None]]
    """Least and largest value [in its unit] in the autopilot's own documents; `None` for 0 or no limit."""
    family: tuple[str, ...]
    """Beginnings of names; an unknown name with one of them is reported."""
    moving: str
    """Regular expression of what is told of notches that move, see `firmware_model.config.gyro_filters`."""
    known: str
    """Regular expression of names among these that are not of the loops, or that remarks deal with."""
    full_torque: Callable[[Vehicle, Mapping[str, float]], Vector]
    """Vehicle and parameters to the torque [N*m] of a command of 1.0 about each axis: measured, or by the rotors."""
    build: Callable[[int, Mapping[str, float], float, int], LoopSignals]
    """Axis 0 to 2, parameters, that torque [N*m] and the rate [Hz] to the loop."""
    thrust_steps: int
    """Steps from no thrust to the largest to which outputs are rounded in simulation; 0 if they are not rounded."""
    remarks: Callable[[Mapping[str, float], int], list[str]]
    """Parameters [in their units], with those not of the loops, and the rate [Hz] to what the form does not hold."""
    gains: str
    """Regular expression of the gains: without one of them a file is not judged."""
    filters: str
    """Regular expression of the filters that are named where they are at their defaults."""
    strangers: Mapping[str, str]
    """Regular expressions of names whose gains are others than those above, and what is said of them."""
    renamed: Mapping[str, str]
    """Regular expressions of old spellings, which are not read, and the names that they have now."""
    others: Mapping[str, str]
    """Regular expressions of names that another class of vehicle has, and the class."""
    hovers: str
    """Regular expression of names that a vehicle has which hovers, whatever class it is of."""
    classes: Mapping[str, Mapping[float, str]]
    """Parameters that tell the class of vehicle, and their values [-] of those that are no multicopters."""
    loop_rate: tuple[str, float, float]
    """Parameter of the loops' rate, its least and its largest value [Hz]."""
    rotors: Callable[[Mapping[str, float]], tuple[str, int] | None]
    """Parameters to those of the frame in words, and its number [-] of rotors; `None` if they do not tell it."""

    def find_rate(self, parameters: Mapping[str, float]) -> tuple[int, str]:
        """Return the rate [Hz] of the loops by their parameters, and a remark on it.

        Samples are whole microseconds: those of 300 Hz last 3333.

        Raises
        ------
        ConfigError
            If it is out of range.
        """
        name, low, high = self.loop_rate
        given = parameters.get(name, 0.0)
        if given == 0.0:  # PX4: as fast as the gyro
            return self.rate_hz, f"{name}: not given, the loops are taken at {self.rate_hz} Hz"
        if not low <= given <= high:
            raise ConfigError(f"{name}: loops of {given:g} Hz are not modelled, those of {low:g} to {high:g} Hz are")
        rate = round(1.0 / sample_time(min(round(given), _FASTEST)))
        more = f", where {given:g} is given" if rate != given else ""
        return rate, f"{name}: the loops are taken at {rate} Hz{more}"

    def check_gains(self, parameters: Mapping[str, float]) -> None:
        """Refuse parameters of another class of vehicle, of an old version, or without a gain.

        Raises
        ------
        ConfigError
            One line that names them.
        """
        for names, meaning in self.strangers.items():
            if found := _matches(names, parameters):
                raise ConfigError(f"{', '.join(found[:_FEW])}: {meaning}")
        if other := self.find_class(parameters):
            raise ConfigError(f"{other}, only multicopters are judged")
        if not _matches(self.gains, parameters):
            raise ConfigError(f"no gain of {self.name} among its parameters, {len(parameters)} in all")

    def find_class(self, parameters: Mapping[str, float]) -> str:
        """Return the parameters that tell another class of vehicle, and the class; empty for what hovers."""
        if not _matches(self.hovers, parameters):
            for names, other in self.others.items():
                if found := _matches(names, parameters):
                    return f"{', '.join(found[:_FEW])}: of a {other}"
        for name, others in self.classes.items():
            if other := others.get(parameters.get(name, 0.0), ""):
                return f"{name} {parameters[name]:g}: of a {other}"
        return ""

    def thrust_step(self, vehicle: Vehicle) -> float:
        """Return the step [N] to which a rotor's thrust is rounded in simulation; 0 if it is not rounded."""
        return vehicle.rotors.thrust_max / self.thrust_steps if self.thrust_steps else 0.0

    def find_range(self, name: str) -> tuple[float, float]:
        """Return the least and largest value [in its unit] of a parameter in documents; any positive one without."""
        low, high = self.documented.get(name, (None, None))
        return low or _TINY, high or math.inf

    def describe_limit(self, name: str, value: float) -> str:
        """Return what is to be said of a value at or beyond its documented limit; empty within."""
        low, high = self.documented.get(name, (None, None))
        if any(limit is not None and math.isclose(value, limit, rel_tol=_AT_LIMIT) for limit in (low, high)):
            return f"{self.name}'s limit"
        if high is not None and value > high:
            return f"above {self.name}'s limit, {high:g}"
        if low is not None and value < low:
            return f"below {self.name}'s limit, {low:g}"
        return ""


def _matches(names: str, parameters: Mapping[str, float]) -> list[str]:
    """Return the parameters whose whole name a regular expression matches."""
    return [name for name in parameters if re.fullmatch(names, name)]


def describe_defaults(autopilot: AutopilotLoops, parameters: Mapping[str, float]) -> list[str]:
    """Return a remark on the defaults that fill up parameters, if there are such, and on those of later versions."""
    missing = [name for name in autopilot.settings if name not in parameters]
    if not missing:
        return []
    first = [name for name in missing if re.fullmatch(f"{autopilot.gains}|{autopilot.filters}", name)] or missing[:_FEW]
    named = ", ".join(f"{name} {autopilot.settings[name].default:g}" for name in first)
    rest = len(missing) - len(first)
    filled = f"{named}{f' and {rest} others' if rest else ''}" if parameters else f"all {len(missing)} parameters"
    version, later = autopilot.later
    changed = [f"{name} {value:g} for {autopilot.settings[name].default:g}" for name, value in later.items()]
    changed = [each for name, each in zip(later, changed, strict=True) if name in missing]
    others = f"; since {version} {autopilot.name} has {', '.join(changed)}" if changed else ""
    return [f"defaults of {autopilot.name} {autopilot.version} fill up {filled}{others}"]


def drop_fractions(autopilot: AutopilotLoops, parameters: Mapping[str, float]) -> dict[str, float]:
    """Return parameters as the autopilot keeps them: those that are whole numbers there without their fractions."""
    return {
        name: float(math.trunc(value + math.copysign(_NEARLY, value))) if name in autopilot.whole else value
        for name, value in parameters.items()
    }


def complete(autopilot: AutopilotLoops, parameters: Mapping[str, float]) -> dict[str, float]:
    """Return all parameters of the loops, those not given at their defaults, and what a log tells of moving notches.

    Raises
    ------
    ConfigError
        If a value is out of range.
    """
    for name, value in parameters.items():
        setting = autopilot.settings.get(name)
        if setting is not None and not setting.low <= value <= setting.high:
            raise ConfigError(f"{name}: is {value:g}, must be {setting.low:g} to {setting.high:g}")
    values = {name: parameters.get(name, setting.default) for name, setting in autopilot.settings.items()}
    if any(name.endswith(FLOWN) for name in parameters):
        values |= {name: value for name, value in parameters.items() if re.fullmatch(autopilot.moving, name)}
    return values
