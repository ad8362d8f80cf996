"""Results of an identification: numbers with intervals, and the curves that support them.

Model of one axis, of the rate `omega` [rad/s] under the command `u` and a disturbance `m` [rad/s^2]:

    omega' = gain * v - damping * omega + m,      lag * v' = u(t - delay) - v,      gyro = omega + noise.
"""

from dataclasses import dataclass
from typing import NamedTuple

from gustproof.logs.read.flight_log import CommandUnit
from gustproof.types import Array


class Interval(NamedTuple):
    """Estimate with a 95 % confidence interval."""

    low: float
    nominal: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisEstimate:
    """Estimates of one axis."""

    gain: Interval | None
    """[rad/s^2 per unit of command] `None` if the log does not excite the axis."""
    damping: Interval | None
    """[1/s] `None` as for the gain; below 0 where the model lacks something."""
    noise: float | None
    """[rad/s/sqrt(Hz)] one-sided density of the gyro's noise; `None` if a filter took it away before it was logged."""
    disturbance_rms: float | None
    """[rad/s^2] rms of the disturbance's angular acceleration; `None` as for the gain, and if none is seen."""
    disturbance_corner: float | None
    """[rad/s] frequency at which the disturbance's spectrum falls to a half; `None` likewise."""
    held_out_r2: float | None
    """[-] share of the angular acceleration's variance in every third piece that a fit to the others predicts."""
    advice: str = ""
    """Reason why the axis is not identified, and the manoeuvre that would excite it; empty if it is."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """Estimates of a vehicle from one log."""

    source: str
    """Name of the log's file."""
    system: str
    """Writer of the log, as of `FlightLog`."""
    thrust_range: float
    """[-] share of the largest thrust that the motors spanned, by the log's parameters."""
    dt: float
    """[s] sample time of the analysis."""
    command_unit: CommandUnit
    """Unit of the command."""
    actuator_lag: Interval | None
    """[s] time constant; `None` if no axis is excited."""
    delay: Interval | None
    """[s] from the logged command to the start of its effect."""
    lateness: Interval | None
    """[s] lag and delay together: most logs tell their sum better than either."""
    axes: tuple[AxisEstimate, AxisEstimate, AxisEstimate]
    """Roll, pitch and yaw."""
    motor_gains: Array | None
    """(3, m) [rad/s^2 per unit] of each motor's thrust (command squared); `None` without motors."""
    motor_intervals: Array | None
    """(3, m, 2) low and high of `motor_gains`."""
    omega: Array
    """(f,) [rad/s] frequencies of the responses."""
    response: Array
    """(3, f) complex, measured from command to angular acceleration."""
    model: Array
    """(3, f) complex, likewise of the model."""
    coherence: Array
    """(3, f) [0..1] of command and angular acceleration."""
    time: Array
    """(n,) [s] of the series below, evenly spaced in each airborne stretch."""
    acceleration: Array
    """(n, 3) [rad/s^2] measured, low-passed."""
    predicted: Array
    """(n, 3) [rad/s^2] likewise from command and model alone."""
    findings: tuple[str, ...]
    """Doubts, a line each, those of the log first."""
