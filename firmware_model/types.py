"""Values exchanged between vehicle and controller; frames and units stand with each field.

They are NamedTuples because each sample of a flight makes two, in half the time of frozen dataclasses.
"""

from typing import NamedTuple

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

AXES = ("roll", "pitch", "yaw")
"""Names of the body's axes, in order."""
NEVER_US = 1 << 62
"""[us] A time that never comes."""


class BatteryReading(NamedTuple):
    """A battery as its monitor sees it."""

    cells: int
    """Cells in series."""
    voltage: float
    """[V] of all cells."""
    current: float
    """[A]."""
    used_ah: float
    """[A*h] charge drawn."""
    remaining: float
    """[-] charge left, of the capacity."""


class ImuSample(NamedTuple):
    """One sample of the inertial measurement unit; every value is a float32, as on the wire."""

    time_us: int
    """[us] model time of the sample."""
    gyro_B: Vector
    """[rad/s] B."""
    specific_force_B: Vector
    """[m/s^2] B; (0, 0, -9.80665) at rest and level."""
    tilt_deg: tuple[float, float] | None = None
    """[deg] roll and pitch to track, by which the vehicle's position loop holds the place; `None` if it holds none."""


class TorqueCommand(NamedTuple):
    """Torques as fractions of the vehicle's published limits."""

    time_us: int
    """[us] stamp of the sample that this command answers."""
    torque_B: Vector
    """[-1..1] B, roll, pitch, yaw as float32 fractions of `torque_limit`."""
    throttle: float | None
    """[0..1] collective thrust as a fraction of the largest; `None`: altitude hold on board, at the height of entry."""


class AttitudeTarget(NamedTuple):
    """Attitude or body rates for the on-board loop to track."""

    time_us: int
    """[us] stamp of the sample that this command answers, whole milliseconds."""
    q_NB: Quaternion | None
    """Attitude, B to N, scalar first; `None` to track rates."""
    omega_B: Vector | None
    """[rad/s] B, rates to track, or feed-forward beside `q_NB`."""
    thrust: float | None
    """[0..1] collective thrust as a fraction of the largest; `None`: altitude hold on board, at the height of entry."""


class RotorCommand(NamedTuple):
    """Thrust of each rotor, as an autopilot outside this process commands it past all on-board loops."""

    time_us: int
    """[us] stamp of the sample that this command answers."""
    rotors: tuple[float, ...]
    """[0..1] thrust of each rotor as a fraction of its largest, in the order of the vehicle file."""
    clamped: bool
    """True to hold the vehicle of a test stand at rest while its rotors turn."""


class PositionTarget(NamedTuple):
    """Position and heading for the on-board position loop; on the test stand the vehicle only levels."""

    position_N: Vector
    """[m] N; with a `v_down` the third component is unused."""
    yaw: float
    """[rad] heading."""
    v_down: float | None
    """[m/s] steady descent, as for landing; `None`: fly to the height of `position_N`."""


class LevelFlight(NamedTuple):
    """Level attitude at the present heading, with altitude hold: a free vehicle drifts with the wind."""


class Trim(NamedTuple):
    """No torque, with altitude hold: the trimmed hover of a flight before its first command."""


class MotorsOff(NamedTuple):
    """Motors off; on the test stand the vehicle is clamped."""


Command = TorqueCommand | AttitudeTarget
"""Command of a controller."""
Setpoint = Command | RotorCommand | PositionTarget | LevelFlight | Trim | MotorsOff
"""Input of the on-board loops."""
