"""Latency of the samples of a real-time flight."""

from collections import Counter

_MAX_EXACT_US = 20_000  # larger values share one counter, so that a month on the ground fills no memory


class Latency:
    """Distribution of delays after a deadline, resolved to 1 us up to 20 ms."""

    def __init__(self) -> None:
        self.worst_us = 0
        self._counts: Counter[int] = Counter()

    def add(self, late_us: int) -> None:
        """Count a delay [us]."""
        self._counts[min(late_us, _MAX_EXACT_US)] += 1
        self.worst_us = max(self.worst_us, late_us)

    def percentile_us(self, percent: float) -> int:
        """Return the least delay [us] that `percent` of all delays do not exceed; 0 if there is none."""
        rank = percent / 100.0 * self._counts.total()
        for late_us, count in sorted(self._counts.items()):
            rank -= count
            if rank <= 0.0:
                return late_us if late_us < _MAX_EXACT_US else self.worst_us
        return 0

    def stats(self) -> dict[str, int]:
        """Return median, 99th percentile and maximum [us]."""
        return {"p50_us": self.percentile_us(50.0), "p99_us": self.percentile_us(99.0), "worst_us": self.worst_us}
