"""Parameters of an autopilot's loops: defaults, ranges, and the axis that the loops are built from."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.types import Vector
from gustproof.autopilots.filters import AxisLoop
from gustproof.law.cascade import AxisLaw
from gustproof.law.form import Matrix


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

    loop: AxisLoop
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


class Autopilot(NamedTuple):
    """Parameters of an autopilot's rate and attitude loops, and how to read a file of them."""

    name: str
    """Name for users."""
    version: str
    """Version whose equations and defaults these are."""
    rate_hz: int
    """[Hz] rate of its loops in simulation."""
    settings: Mapping[str, Setting]
    """Parameters of the loops."""
    family: tuple[str, ...]
    """Beginnings of names among which a name that is not known is told."""
    known: str
    """Regular expression of names among these that are not of the loops, or that remarks deal with."""
    full_torque: Callable[[Vehicle, Mapping[str, float]], Vector]
    """Vehicle and parameters to the torque [N*m] of a command of 1.0 about each axis."""
    build: Callable[[int, Mapping[str, float], float, float], LoopSignals]
    """Axis 0 to 2, parameters, that torque [N*m] and the rate [Hz] to the loop."""
    thrust_steps: int
    """Steps from no thrust to the largest in which outputs are told in simulation; 0 if they are not rounded."""
    remarks: Callable[[Mapping[str, float]], list[str]]
    """Parameters [in their units], with those not of the loops, to what the form does not hold of them."""


def complete(autopilot: Autopilot, parameters: Mapping[str, float]) -> dict[str, float]:
    """Return all parameters of the loops, those not given at their defaults.

    Raises
    ------
    ConfigError
        If a value is out of range.
    """
    for name, value in parameters.items():
        setting = autopilot.settings.get(name)
        if setting is not None and not setting.low <= value <= setting.high:
            raise ConfigError(f"{name}: is {value:g}, must be {setting.low:g} to {setting.high:g}")
    return {name: parameters.get(name, setting.default) for name, setting in autopilot.settings.items()}
