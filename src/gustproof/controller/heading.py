"""Heading for a law's estimate: the gyro's turn since the start, held near the autopilot's heading.

An autopilot's heading wanders by tenths of a degree within a minute of gusts: acceleration and GPS move it more than
north does. The gyro drifts less in a minute, and more in an hour.
"""

import math

from firmware_model.types import Vector
from gustproof.law.step import euler_rates

_TIME_CONSTANT_S = 100.0  # of the pull to the autopilot's heading: its wander in gusts lasts tens of seconds
_WANDER = math.radians(1.0)  # more than that is an error of the gyro's turn, and goes as roll and pitch do
_LONGEST_STEP_S = 1.0  # a longer silence is no motion to interpolate


class SlowHeading:
    """Heading [rad] since a start at the autopilot's `attitude` [rad]: add each sample, correct by each ATTITUDE."""

    def __init__(self, attitude: Vector) -> None:
        self.turned = 0.0
        self._roll, self._pitch, self._start = attitude
        self._rate: float | None = None

    def add(self, gyro_B: Vector, step_s: float) -> None:
        """Turn with the rates [rad/s] of a sample, `step_s` after the last one."""
        _, _, rate = euler_rates((self._roll, self._pitch, 0.0), gyro_B)
        if self._rate is not None:
            self.turned += 0.5 * (self._rate + rate) * min(step_s, _LONGEST_STEP_S)
        self._rate = rate

    def correct(self, attitude: Vector, share: float, step_s: float) -> None:
        """Move towards the autopilot's heading, `step_s` after the last correction.

        It moves by `share` of what exceeds the heading's wander.
        """
        self._roll, self._pitch, yaw = attitude
        away = yaw - self._start - self.turned
        away -= 2.0 * math.pi * round(away / (2.0 * math.pi))
        within = min(max(away, -_WANDER), _WANDER)
        self.turned += within * step_s / _TIME_CONSTANT_S + (away - within) * share
