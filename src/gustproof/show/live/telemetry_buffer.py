"""Data of the live page, written by some threads and read by others."""

from collections.abc import Iterable, Sequence
from threading import Lock
from typing import Any

Row = Sequence[float | None]
"""Model time [s], then the numbers of a series at that time."""
SERIES = ("attitude", "wind", "torque", "age")
"""attitude: q_NB [-], omega_B [rad/s]; wind: velocity of the air [m/s] N; torque: commanded [N*m] B.

age: that of the command in effect [ms], from its timestamp, or `None`."""
_MAX_ROWS = 60_000  # of a series, 20 minutes at 50 Hz; beyond that the oldest half is dropped


class TelemetryBuffer:
    """Rows in order of time, and facts with one current value."""

    def __init__(self, **facts: Any) -> None:
        self._lock = Lock()
        self._rows: dict[str, list[Row]] = {name: [] for name in SERIES}
        self._dropped = dict.fromkeys(SERIES, 0)
        self._facts = facts
        self._changes, self._flight = 1, 1

    def restart(self, **facts: Any) -> None:
        """Drop all rows, as another flight begins, and set facts."""
        with self._lock:
            for name in SERIES:
                self._rows[name], self._dropped[name] = [], 0
            self._facts = {**self._facts, **facts}
            self._changes += 1
            self._flight += 1

    def add(self, name: str, rows: Iterable[Row]) -> None:
        """Append rows to a series."""
        with self._lock:
            kept = self._rows[name]
            kept.extend(rows)
            if len(kept) > _MAX_ROWS:
                self._dropped[name] += _MAX_ROWS // 2
                del kept[: _MAX_ROWS // 2]

    def update(self, **facts: Any) -> None:
        """Set facts."""
        with self._lock:
            if any(name not in self._facts or self._facts[name] != value for name, value in facts.items()):
                self._facts = {**self._facts, **facts}
                self._changes += 1

    def __getitem__(self, name: str) -> Any:
        return self._facts[name]

    def reader(self) -> "BufferReader":
        """Return a reader at the start of the buffer."""
        return BufferReader(self)


class BufferReader:
    """One reader's position in a buffer."""

    def __init__(self, buffer: TelemetryBuffer) -> None:
        self._buffer = buffer
        self._ends = dict.fromkeys(SERIES, 0)
        self._changes, self._flight = 0, buffer._flight

    def read(self) -> dict[str, Any]:
        """Return the changes since the last call: rows by series, and all facts under `facts` if one has changed.

        With the number of another flight under `flight`, rows are those of that flight alone.
        """
        buffer = self._buffer
        update: dict[str, Any] = {}
        with buffer._lock:
            if buffer._flight != self._flight:
                update["flight"] = self._flight = buffer._flight
                self._ends = dict.fromkeys(SERIES, 0)
            for name, rows in buffer._rows.items():
                end = buffer._dropped[name] + len(rows)
                if end > self._ends[name]:
                    update[name] = rows[max(self._ends[name] - buffer._dropped[name], 0) :]
                    self._ends[name] = end
            if buffer._changes > self._changes:
                update["facts"], self._changes = buffer._facts, buffer._changes
        return update
