"""The rows of a journal while it is written: what the page shows of a flight in lockstep, at no cost to the flight."""

from io import BufferedReader
from pathlib import Path
from threading import Event

import numpy as np
from numpy.typing import NDArray

from firmware_model.journal import RECORD
from gustproof.view.feed import Feed, Row

Array = NDArray[np.float64]
_LOOK_S = 0.02
_DIGITS = 6  # decimals: a millionth of the units shown


def tail(path: Path, every: int, feed: Feed, done: Event) -> None:
    """Feed each `every`th record of the journal at `path`, the first among them, until it is `done`."""
    while not path.exists():
        if done.wait(_LOOK_S):
            return
    with path.open("rb") as file:
        records = _Records(file, every)
        ended = False
        while not ended:
            ended = done.wait(_LOOK_S)
            for name, rows in series(records.take()).items():
                feed.add(name, rows)


def series(records: NDArray[np.void]) -> dict[str, list[Row]]:
    """Return the rows of each series that journal records (n,) hold."""
    time_s = records["time_us"][:, np.newaxis] * 1e-6
    q_NB = records["q_NB"]
    air_N = records["wind_N"] + rotated(q_NB, records["gust_B"])
    columns = {
        "attitude": (time_s, q_NB, records["omega_B"]),
        "wind": (time_s, air_N),
        "torque": (time_s, records["torque_command_B"]),
    }
    return {name: np.round(np.hstack(parts), _DIGITS).tolist() for name, parts in columns.items()}


def rotated(q_NB: Array, v_B: Array) -> Array:
    """Return vectors (n, 3) given in B in N, by the attitudes (n, 4)."""
    w, axis = q_NB[:, :1], q_NB[:, 1:]
    turned = 2.0 * np.cross(axis, v_B)
    return np.asarray(v_B + w * turned + np.cross(axis, turned))


class _Records:
    """The whole records of a growing journal, each `every`th."""

    def __init__(self, file: BufferedReader, every: int) -> None:
        self._file, self._every = file, every
        self._rest = b""
        self._headed = False
        self._skip = 0

    def take(self) -> NDArray[np.void]:
        """Return those that came since the last call."""
        self._rest += self._file.read()
        if not self._headed:
            _, newline, rest = self._rest.partition(b"\n")
            if not newline:
                return np.empty(0, dtype=RECORD)
            self._headed, self._rest = True, rest
        whole = len(self._rest) // RECORD.itemsize * RECORD.itemsize
        records = np.frombuffer(self._rest[:whole], dtype=RECORD)
        self._rest = self._rest[whole:]
        taken = records[self._skip :: self._every]
        self._skip = (self._skip - len(records)) % self._every
        return taken
