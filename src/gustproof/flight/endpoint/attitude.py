"""Attitude for a law's estimate: the gyro's turn since the start, held near the autopilot's attitude.

An autopilot's attitude wanders by tenths of a degree within a minute of gusts: acceleration, GPS and compass move it
more than gravity and north do. The gyro drifts less in a minute, and more in an hour.

References
----------
R. Mahony, T. Hamel, J.-M. Pflimlin, Nonlinear Complementary Filters on the Special Orthogonal Group, 2008: the passive
filter, here with a gain that grows with the error, and without a bias of its own.
"""

import math

from firmware_model.numerics.rotations import conjugate, from_euler, multiply, normalize, to_euler
from firmware_model.types import Quaternion, Vector

# [s] of the pull to the autopilot's attitude, about N: its wander in gusts lasts tens of seconds.
_TIME_CONSTANTS_S = (200.0, 200.0, 200.0)
_BIASED_TIME_CONSTANTS_S = (10.0, 10.0, 200.0)  # where nobody has taken the bias from the rates
_WANDER = (math.radians(0.3), math.radians(0.3), math.radians(1.0))  # more is an error
_REGAIN_RATE = 1.0  # [1/s] of the pull of what is more
_LARGEST = 0.1  # [rad] of what is more that counts
_LONGEST_STEP_S = 1.0  # a longer silence is no motion to interpolate


class SlowAttitude:
    """Attitude since a start at the autopilot's `attitude` [rad]: add each sample, correct by each ATTITUDE."""

    def __init__(self, attitude: Vector) -> None:
        self._q_NB = from_euler(*attitude)
        self._start = attitude[2]
        self._gyro_B: Vector | None = None

    @property
    def angles(self) -> Vector:
        """Roll, pitch and heading [rad]; the heading is 0 at the start."""
        roll, pitch, yaw = to_euler(self._q_NB)
        return roll, pitch, yaw - self._start

    def add(self, gyro_B: Vector, step_s: float) -> None:
        """Turn with the rates [rad/s] of a sample, `step_s` after the last one."""
        if self._gyro_B is not None:
            quarter_s = 0.25 * min(step_s, _LONGEST_STEP_S)  # half of the turn at the mean of both
            x, y, z = (quarter_s * (before + now) for before, now in zip(self._gyro_B, gyro_B, strict=True))
            self._rotate(self._q_NB, (1.0, x, y, z))
        self._gyro_B = gyro_B

    def correct(self, attitude: Vector, earth_rate_N: Vector | None, step_s: float) -> None:
        """Move towards the autopilot's attitude [rad], `step_s` after the last correction.

        `earth_rate_N` [rad/s] is the part of the samples' rates that is no motion over the ground, if no bias is left.
        """
        pulls = _BIASED_TIME_CONSTANTS_S if earth_rate_N is None else _TIME_CONSTANTS_S
        w, *errors = multiply(from_euler(*attitude), conjugate(self._q_NB))
        halves = []
        earth_rate_N = earth_rate_N or (0.0, 0.0, 0.0)
        for half_sine, wander, time_constant_s, earth in zip(errors, _WANDER, pulls, earth_rate_N, strict=True):
            away = math.copysign(2.0, w) * half_sine  # the shorter way round
            within = min(max(away, -wander), wander)
            beyond = min(max(away - within, -_LARGEST), _LARGEST)
            halves.append(0.5 * step_s * (within / time_constant_s + beyond * _REGAIN_RATE - earth))
        self._rotate((1.0, halves[0], halves[1], halves[2]), self._q_NB)

    def _rotate(self, after: Quaternion, before: Quaternion) -> None:
        self._q_NB = normalize(multiply(after, before))
