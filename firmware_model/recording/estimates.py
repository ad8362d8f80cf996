"""Recording of an external autopilot's own attitude and wind: one record for each attitude that it sent in flight.

The file has the form of the journal: a line of JSON, then records of little-endian float64.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import TEXT, open_regular
from firmware_model.recording.journal import JournalWriter
from firmware_model.types import Quaternion, Vector

ESTIMATE = np.dtype(
    [
        ("time_us", "<f8"),  # [us] model time of the estimate
        ("q_NB", "<f8", 4),  # attitude B to N as the autopilot estimates it, scalar first
        ("setpoint_q_NB", "<f8", 4),  # attitude set-point of its loops; NaN where unknown
        ("told_wind_N", "<f8", 3),  # [m/s] wind as the autopilot estimates it, blowing toward; NaN where it tells none
    ]
)
ATTITUDE_SUFFIX = ".attitude"
"""Suffix of the file, beside the journal."""
_BUFFER = 50  # records, a second
_HEADER = {"kind": "attitude of a guest autopilot"}


class Estimate(NamedTuple):
    """Attitude of an external autopilot, estimated and to be held, and its wind."""

    time_us: int
    """[us] the autopilot's clock, whole milliseconds; the simulation's, if it follows that."""
    q_NB: Quaternion
    """Estimated attitude, B to N, scalar first."""
    setpoint_q_NB: Quaternion
    """Attitude set-point of its loops, as it last reported it; NaN before."""
    told_wind_N: Vector = (math.nan,) * 3
    """[m/s] its estimate of the wind, blowing toward, as it last reported it; NaN before."""


class EstimateWriter(JournalWriter):
    """Writer of a new file of estimates; as a context manager it leaves the file complete."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, _HEADER, _BUFFER, ESTIMATE)

    def append_estimate(self, estimate: Estimate) -> None:
        """Append one estimate."""
        self.append((estimate.time_us, *estimate.q_NB, *estimate.setpoint_q_NB, *estimate.told_wind_N))


def read_estimates(path: Path) -> NDArray[np.void]:
    """Return the complete estimates (n,) of `ESTIMATE` in a file; none if there is no such file."""
    try:
        with open_regular(path) as file:
            file.readline(TEXT)
            content = file.read()
    except FileNotFoundError:
        return np.empty(0, dtype=ESTIMATE)
    return np.frombuffer(content, dtype=ESTIMATE, count=len(content) // ESTIMATE.itemsize)
