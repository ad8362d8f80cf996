"""Recording of a guest's own attitude: one record for each estimate that it told in flight.

The file is like the journal: a line of JSON, then records of little-endian float64.
"""

from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import TEXT, open_regular
from firmware_model.guest.pilot import Estimate
from firmware_model.recording.durable_file import AppendOnlyFile

ESTIMATE = np.dtype(
    [
        ("time_us", "<f8"),  # [us] model time of the estimate
        ("q_NB", "<f8", 4),  # attitude B to N as the guest estimates it, scalar first
        ("setpoint_q_NB", "<f8", 4),  # attitude set-point of its loops; NaN where unknown
    ]
)
ATTITUDE_SUFFIX = ".attitude"
"""Suffix of the file, beside the journal."""
_BUFFER = 50  # records, a second
_HEADER = b'{"kind":"attitude of a guest autopilot"}\n'


class EstimateWriter:
    """Writer of a new file of estimates; as a context manager it leaves the file complete."""

    def __init__(self, path: Path) -> None:
        self._file, self._rows = AppendOnlyFile(path), list[float]()
        self._file.write(_HEADER)

    def append(self, estimate: Estimate) -> None:
        """Append one estimate."""
        self._rows += (estimate.time_us, *estimate.q_NB, *estimate.setpoint_q_NB)
        if len(self._rows) >= _BUFFER * ESTIMATE.itemsize // 8:
            self._flush()

    def _flush(self) -> None:
        rows, self._rows = self._rows, []
        self._file.write(np.array(rows, dtype="<f8").tobytes())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._flush()
        finally:
            self._file.close()


def read_estimates(path: Path) -> NDArray[np.void]:
    """Return the complete estimates (n,) of `ESTIMATE` in a file; none if there is no such file."""
    try:
        with open_regular(path) as file:
            file.readline(TEXT)
            content = file.read()
    except FileNotFoundError:
        return np.empty(0, dtype=ESTIMATE)
    return np.frombuffer(content, dtype=ESTIMATE, count=len(content) // ESTIMATE.itemsize)
