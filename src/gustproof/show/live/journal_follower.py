"""Series of the live page from a journal while it is written, at no cost to the flight."""

import math
from collections.abc import Iterable
from io import BufferedReader
from pathlib import Path
from threading import Event

import numpy as np

from firmware_model.config.files import parse_json
from firmware_model.numerics.rotations import rotate_rows
from firmware_model.recording.journal import RECORD, told_type
from gustproof.show.live.telemetry_buffer import SERIES, Row, TelemetryBuffer
from gustproof.types import Records

_POLL_S = 0.02
_DIGITS = 6  # decimals


def follow_journal(
    path: Path, every: int, sample_us: int, buffer: TelemetryBuffer, done: Event, names: Iterable[str] = SERIES
) -> None:
    """Add each `every`th record of the journal at `path`, from the first on, to the series `names` until `done`.

    A record is a sample of `sample_us` [us].
    """
    while not (path.exists() or done.wait(_POLL_S)):
        pass
    if not path.exists():
        return
    with path.open("rb") as file:
        groups = _GroupReader(file, every)
        ended = False
        while not ended:
            ended = done.wait(_POLL_S)
            rows = series_rows(groups.read(), sample_us)
            for name in names:
                buffer.add(name, rows[name])


def series_rows(groups: Records, sample_us: int) -> dict[str, list[Row]]:
    """Return the rows of each series from groups of journal records (n, every): the last record of each group.

    The age is the largest of the group: no late command is missed.
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


class _GroupReader:
    """Reader of a growing journal in groups of `every` records; the first record is a group of its own."""

    def __init__(self, file: BufferedReader, every: int) -> None:
        self._file, self._every = file, every
        self._remainder = b""
        self._has_first, self._record = False, RECORD

    def read(self) -> Records:
        """Return the groups (n, every) completed since the last call."""
        self._remainder += self._file.read()
        if not self._has_first:
            header, ended, first = self._remainder.partition(b"\n")
            self._record = told_type(parse_json(header)) if ended else RECORD
            if len(first) >= self._record.itemsize:  # repeated to a group of its own
                self._has_first = True
                self._remainder = first[: self._record.itemsize] * (self._every - 1) + first
        size = self._record.itemsize * self._every
        whole = len(self._remainder) // size * size if self._has_first else 0
        groups = np.frombuffer(self._remainder[:whole], dtype=self._record).reshape(-1, self._every)
        self._remainder = self._remainder[whole:]
        return groups
