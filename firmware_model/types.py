"""What crosses the border between vehicle and controller, as values; frames and units stand with each field.

NamedTuples, as two are made for each sample of a flight, in half the time of a frozen dataclass.
"""

from typing import NamedTuple

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

NEVER_US = 1 << 62
"""[us] A time that never comes."""


class ImuSample(NamedTuple):
    """One sample of the inertial measurement unit; every value is a float32, as on the wire."""

    time_us: int
    """[us] model time of the sample."""
    gyro_B: Vector
    """[rad/s] B."""
    specific_force_B: Vector
    """[m/s^2] B; (0, 0, -9.80665) at rest and level."""


class TorqueCommand(NamedTuple):
    """Torques as fractions of the vehicle's published limits."""

    time_us: int
    """[us] stamp of the sample that this command answers."""
    torque_B: Vector
    """[-1..1] B, roll, pitch, yaw as float32 fractions of `torque_limit`."""
    throttle: float | None
    """[0..1] collective thrust as a fraction of the largest; `None`: the height is held on board, where that began."""


class AttitudeTarget(NamedTuple):
    """An attitude or body rates for the on-board loop to track."""

    time_us: int
    """[us] stamp of the sample that this command answers, whole milliseconds."""
    q_NB: Quaternion | None
    """Attitude, B to N, scalar first; `None` if rates are to be tracked."""
    omega_B: Vector | None
    """[rad/s] B, rates to track, or feed-forward beside `q_NB`."""
    thrust: float | None
    """[0..1] collective thrust as a fraction of the largest; `None`: the height is held on board, where that began."""


class PositionTarget(NamedTuple):
    """A place and a heading for the on-board position loop; on the test stand it only levels."""

    position_N: Vector
    """[m] N, where to go; the third is not used while `v_down` is given."""
    yaw: float
    """[rad] heading."""
    v_down: float | None
    """[m/s] steady descent, as for landing; `None`: go to the height of `position_N`."""


class LevelFlight(NamedTuple):
    """Level attitude at the present heading, height held: a free vehicle drifts with the wind."""


class Trim(NamedTuple):
    """No torque, height held, as in the trimmed hover that a flight begins in: what flies before the first command."""


class MotorsOff(NamedTuple):
    """Motors off; on the test stand the vehicle is clamped."""


Command = TorqueCommand | AttitudeTarget
"""What a controller sends."""
Setpoint = Command | PositionTarget | LevelFlight | Trim | MotorsOff
"""What the vehicle flies."""
