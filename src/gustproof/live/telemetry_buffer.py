"""What the page is to show, gathered by some threads and read by others."""

from collections.abc import Iterable, Sequence
from threading import Lock
from typing import Any

Row = Sequence[float | None]
"""Time [s] of the model, then the numbers of a series at that time."""
SERIES = ("attitude", "wind", "torque", "age")
"""attitude: q_NB [-], omega_B [rad/s]; wind: how the air moves [m/s] N, blowing toward; torque: asked for [N*m] B; age:
of the command that acts, by its stamp [ms], `None` if none does."""
_MAX_ROWS = 60_000  # rows of a series, 20 minutes at 50 Hz; the oldest half goes when there are more


class TelemetryBuffer:
    """Rows in the order of their time, and facts that have one value at a time."""

    def __init__(self, **facts: Any) -> None:
        self._lock = Lock()
        self._rows: dict[str, list[Row]] = {name: [] for name in SERIES}
        self._gone = dict.fromkeys(SERIES, 0)
        self._facts = facts
        self._changes = 1

    def add(self, name: str, rows: Iterable[Row]) -> None:
        """Append rows to a series."""
        with self._lock:
            kept = self._rows[name]
            kept.extend(rows)
            if len(kept) > _MAX_ROWS:
                self._gone[name] += _MAX_ROWS // 2
                del kept[: _MAX_ROWS // 2]

    def tell(self, **facts: Any) -> None:
        """Set facts."""
        with self._lock:
            if any(name not in self._facts or self._facts[name] != value for name, value in facts.items()):
                self._facts = {**self._facts, **facts}
                self._changes += 1

    def __getitem__(self, name: str) -> Any:
        return self._facts[name]

    def reader(self) -> "BufferReader":
        """Return someone who has read nothing yet."""
        return BufferReader(self)


class BufferReader:
    """One reader's place in a feed."""

    def __init__(self, feed: TelemetryBuffer) -> None:
        self._buffer = feed
        self._read = dict.fromkeys(SERIES, 0)
        self._changes = 0

    def news(self) -> dict[str, Any]:
        """Return what came since the last call: rows by series, and under `facts` all facts if one has changed."""
        feed = self._buffer
        news: dict[str, Any] = {}
        with feed._lock:
            for name, rows in feed._rows.items():
                end = feed._gone[name] + len(rows)
                if end > self._read[name]:
                    news[name] = rows[max(self._read[name] - feed._gone[name], 0) :]
                    self._read[name] = end
            if feed._changes > self._changes:
                news["facts"], self._changes = feed._facts, feed._changes
        return news
