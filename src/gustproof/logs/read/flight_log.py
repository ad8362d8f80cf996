"""One flight as its log has it, in SI units and body axes front, right, down (B), whatever the file's format."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from gustproof.types import Array

ABSENT = "not in this log: "
"""Begins the finding that names the signals that a log lacks, and may do without."""


TAKEN = ", taken for "
"""Stands in each finding about a unit or a range that the file does not tell, before what it is taken for."""


def assumptions(findings: Iterable[str]) -> list[str]:
    """Return the findings about units and ranges that a file does not tell."""
    return [line for line in findings if TAKEN in line]


class CommandUnit(Enum):
    """Unit of a log's torque command."""

    NEWTON_METRES = "N m"
    """Physical torque."""
    NORMALISED = "1"
    """Share of the autopilot's full scale, -1 to 1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LogSignal:
    """A quantity against time; samples need not be even, and lost ones are absent."""

    time: Array
    """(n,) [s] strictly increasing, on the clock that all signals of the log share."""
    values: Array
    """(n, k) in SI units."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightLog:
    """Signals and facts of one log; a signal that the log lacks is `None`."""

    source: str
    """Name of the file."""
    system: str
    """Writer of the log: px4, ardupilot, betaflight, gustproof, crazyflie or csv."""
    gyro: LogSignal
    """(n, 3) [rad/s] B."""
    command: LogSignal | None = None
    """(n, 3) B, torque commanded about roll, pitch and yaw, in `command_unit`."""
    command_unit: CommandUnit = CommandUnit.NORMALISED
    """Unit of `command`."""
    motors: LogSignal | None = None
    """(n, m) [0..1] command of each motor."""
    accelerometer: LogSignal | None = None
    """(n, 3) [m/s^2] B, specific force."""
    attitude: LogSignal | None = None
    """(n, 3) [rad] Euler angles phi, theta, psi as the autopilot estimates them."""
    reference: LogSignal | None = None
    """(n, 3) [rad] commanded Euler angles."""
    rate_reference: LogSignal | None = None
    """(n, 3) [rad/s] B, rates commanded to the rate loops."""
    is_gyro_raw: bool = False
    """True if the gyro is known to be logged before the autopilot's filters."""
    airborne: tuple[tuple[float, float], ...] | None = None
    """[s] start and end of each stretch in the air, none if it never was; `None` if not told: all of it is taken."""
    notches: Mapping[str, LogSignal] = field(default_factory=dict)
    """(n, m) [Hz] of notches of the gyro that moved, by the beginning of their parameters' names; 0 if not known."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Parameters of the autopilot by name, [in its own units], as logged; and medians of `notches`, see `crop`."""
    findings: tuple[str, ...] = ()
    """Shortcomings of the log, a line each: absent, clipped, lost or too slow signals."""

    @property
    def aloft(self) -> float:
        """[s] time in the air; 0 if it is not told."""
        return sum((end - begin for begin, end in self.airborne or ()), 0.0)

    def in_air(self, signal: LogSignal) -> Array:
        """Return the values (m, k) of a signal in the air; none if it is not told."""
        spans = [(signal.time >= begin) & (signal.time <= end) for begin, end in self.airborne or ()]
        return np.concatenate([signal.values[:0], *(signal.values[span] for span in spans)])
