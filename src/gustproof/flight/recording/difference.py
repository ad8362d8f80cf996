"""Compare a bag with journal records message by message, in little memory."""

from collections import defaultdict
from pathlib import Path

import numpy as np

from firmware_model.errors import ConfigError
from firmware_model.recording.journal import record_blocks
from gustproof.flight.recording.bag import MODE_TOPIC, RATES_TOPIC, Records, checked_messages
from gustproof.flight.recording.topics import TOPICS, encode, list_topics

_ROWS = 1 << 13  # messages of a topic that are compared at once


def first_difference(path: Path, records: Records) -> tuple[int | None, int]:
    """Return the first sample in which a bag differs from `records` (n,), and how many samples the bag has.

    It is `None` if no bit differs. A flight that was cut off shares all of its samples with the whole one. `path` is
    the bag's folder or its one .mcap file.

    Raises
    ------
    ConfigError
        If the bag can't be read, or lacks one of the topics.
    """
    comparison = _BagComparison(records)
    for name, time_ns, payload in checked_messages(path):
        comparison.take(name, time_ns, payload)
    comparison.finish()
    if uneven := [name for name, count in comparison.counts.items() if count != comparison.samples]:
        raise ConfigError(f"{path}: {uneven[0]} has not as many messages as {TOPICS[0].name}")
    return min(comparison.different, default=None), comparison.samples


class _BagComparison:
    """Running comparison of the messages of a bag with records."""

    def __init__(self, records: Records) -> None:
        self._records = records
        self._topics = {topic.name: topic for topic in list_topics(records.dtype["rotors"].shape[0])}
        self._waiting: dict[str, list[bytes]] = defaultdict(list)
        self._modes: list[tuple[int, int]] = []
        self.counts: dict[str, int] = defaultdict(int)
        self.different: list[int] = []

    @property
    def samples(self) -> int:
        """Number of samples of the bag so far."""
        return self.counts[TOPICS[0].name]

    def take(self, name: str, time_ns: int, payload: bytes) -> None:
        """Compare a message of the bag, once there are enough of its topic."""
        if name == MODE_TOPIC:
            self._modes.append((time_ns // 1000, int.from_bytes(payload[-4:], "little")))
        elif name in self._topics:
            self._waiting[name].append(payload)
            if len(self._waiting[name]) == _ROWS:
                self._compare(name)

    def finish(self) -> None:
        """Compare the last messages, and what has no message a sample."""
        for name in [*self._waiting]:
            self._compare(name)
        self._compare_modes()
        if RATES_TOPIC not in self.counts:
            self._compare_rates()

    def _compare(self, name: str) -> None:
        theirs, begin = self._waiting.pop(name), self.counts[name]
        self.counts[name] += len(theirs)
        for block in record_blocks(self._records[begin : begin + len(theirs)], _ROWS):
            rows = encode(self._topics[name], block)
            if rows.tobytes() != b"".join(theirs[: len(rows)]):
                pairs = zip(rows, theirs, strict=False)
                self.different += [begin + next(i for i, (ours, their) in enumerate(pairs) if ours.tobytes() != their)]

    def _compare_modes(self) -> None:
        changed_us, modes = np.array(self._modes, dtype=np.int64).reshape(-1, 2).T
        begin = 0
        for block in record_blocks(self._records[: self.samples]):
            latest = np.searchsorted(changed_us, block["time_us"], side="right") - 1
            recorded = np.where(latest >= 0, modes[latest], -1)
            self.different += (begin + np.flatnonzero(recorded != block["mode"])[:1]).tolist()
            begin += len(block)

    def _compare_rates(self) -> None:
        """Compare with the rates that a bag has not: it leaves them out if none was commanded."""
        begin = 0
        for block in record_blocks(self._records[: self.samples]):
            has_rates = ~np.isnan(block["omega_command_B"]).all(axis=1)
            self.different += (begin + np.flatnonzero(has_rates)[:1]).tolist()
            begin += len(block)
