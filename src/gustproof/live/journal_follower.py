"""The rows of a journal while it is written: what the page shows of it, at no cost to the flight."""

import math
from collections.abc import Iterable
from io import BufferedReader
from pathlib import Path
from threading import Event

import numpy as np
from numpy.typing import NDArray

from firmware_model.recording.journal import RECORD
from gustproof.live.telemetry_buffer import SERIES, Row, TelemetryBuffer

Array = NDArray[np.float64]
_POLL_S = 0.02
_DIGITS = 6  # decimals: a millionth of the units shown


def follow_journal(
    path: Path, every: int, sample_us: int, feed: TelemetryBuffer, done: Event, names: Iterable[str] = SERIES
) -> None:
    """Feed the series `names` with each `every`th record of the journal at `path`, the first among them, until `done`.

    A record is a sample of `sample_us` [us].
    """
    while not path.exists():
        if done.wait(_POLL_S):
            return
    with path.open("rb") as file:
        groups = _GroupReader(file, every)
        ended = False
        while not ended:
            ended = done.wait(_POLL_S)
            rows = series_rows(groups.take(), sample_us)
            for name in names:
                feed.add(name, rows[name])


def series_rows(groups: NDArray[np.void], sample_us: int) -> dict[str, list[Row]]:
    """Return the rows of each series that groups of journal records (n, every) hold: those of the last of each group.

    The age is the largest of the group, so that no single late command is missed.
    """
    records = groups[:, -1]
    time_s = records["time_us"][:, np.newaxis] * 1e-6
    q_NB = records["q_NB"]
    air_N = records["wind_N"] + rotate_rows(q_NB, records["gust_B"])
    columns = {
        "attitude": (time_s, q_NB, records["omega_B"]),
        "wind": (time_s, air_N),
        "torque": (time_s, records["torque_command_B"]),
        "age": (time_s, groups["command_age"].max(axis=1) * (sample_us / 1000)),
    }
    rows = {name: np.round(np.hstack(parts), _DIGITS).tolist() for name, parts in columns.items()}
    rows["age"] = [[t, None if math.isnan(age_ms) else age_ms] for t, age_ms in rows["age"]]
    return rows


def rotate_rows(q_NB: Array, v_B: Array) -> Array:
    """Return vectors (n, 3) given in B in N, by the attitudes (n, 4)."""
    w, axis = q_NB[:, :1], q_NB[:, 1:]
    turned = 2.0 * np.cross(axis, v_B)
    return np.asarray(v_B + w * turned + np.cross(axis, turned))


class _GroupReader:
    """The records of a growing journal in groups: each `every`th, and before it those since the one before."""

    def __init__(self, file: BufferedReader, every: int) -> None:
        self._file, self._every = file, every
        self._rest = b""
        self._begun = False

    def take(self) -> NDArray[np.void]:
        """Return the groups (n, every) that became whole since the last call."""
        self._rest += self._file.read()
        if not self._begun:
            first = self._rest.partition(b"\n")[2]
            if len(first) >= RECORD.itemsize:  # a group of its own
                self._begun, self._rest = True, first[: RECORD.itemsize] * (self._every - 1) + first
        size = RECORD.itemsize * self._every
        whole = len(self._rest) // size * size if self._begun else 0
        groups = np.frombuffer(self._rest[:whole], dtype=RECORD).reshape(-1, self._every)
        self._rest = self._rest[whole:]
        return groups
