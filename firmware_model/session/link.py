"""Faults of the link between vehicle and controller, in model time: what is late, lost, doubled, out of order.

    bandwidth -> loss, burst_loss -> duplication -> delay, jitter -> reordering

A datagram passes the `[[link]]` tables of its direction in this order, whatever theirs is in the file; a table acts on
what enters from its `start_s` to its `stop_s`. Tables of one kind add up. Only `reordering` lets one overtake another.
"""

import heapq
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from enum import Enum
from typing import Generic, TypeVar

import numpy as np

from firmware_model.config.link_faults import (
    AnyFault,
    Bandwidth,
    BurstLoss,
    Delay,
    Duplication,
    Jitter,
    Loss,
    Reordering,
)
from firmware_model.numerics.compiled import compiled
from firmware_model.numerics.elementary import philox
from firmware_model.numerics.random import LINK_STREAM

_NEVER_US = 1 << 62
_SCALE = 2.0**-32

Item = TypeVar("Item")


class LinkCounter(Enum):
    """What became of a datagram, counted; the values are the names of the counters."""

    SENT = "sent"
    """Entered this direction."""
    ARRIVED = "arrived"
    """Came out at the other end."""
    LOST = "lost"
    """Was lost by chance, alone or in a burst."""
    CROWDED_OUT = "crowded_out"
    """Found no room in the queue."""
    DOUBLED = "doubled"
    """Went on as two."""
    HELD_BACK = "held_back"
    """Was held back, for others to overtake it."""
    UNHEARD = "unheard"
    """Came to a controller that hangs or is dead."""
    OVERTAKEN = "overtaken"
    """Came to the vehicle after the answer to a newer sample, and was not flown."""


class LinkDirection(Generic[Item]):
    """One direction of a link: `send` in the order of time, `take` what has arrived."""

    def __init__(self, faults: Sequence[AnyFault], direction: str, seed: int) -> None:
        self.counters: Counter[LinkCounter] = Counter()
        self._tables = [
            _FaultTable(fault, seed, number) for number, fault in enumerate(faults) if fault.direction == direction
        ]
        self._in_flight: list[tuple[int, int, Item]] = []
        self._order = 0  # tells apart what arrives at the same time
        self._last_us = 0

    def send(self, item: Item, size: int, now_us: int) -> None:
        """Let a datagram of `size` bytes enter."""
        self.counters[LinkCounter.SENT] += 1
        number = self.counters[LinkCounter.SENT]
        tables = [table for table in self._tables if table.start_us <= now_us < table.stop_us]
        sent_us = now_us
        for table in tables:
            if isinstance(table.fault, Bandwidth):
                free_us = table.transmission_end_us(table.fault, size, sent_us)
                if free_us is None:
                    self.counters[LinkCounter.CROWDED_OUT] += 1
                    return
                sent_us = free_us
        # All of them are asked: a burst goes on, whatever else loses the datagram.
        if any([table.loses(number) for table in tables]):
            self.counters[LinkCounter.LOST] += 1
            return
        doubled = any(table.occurs(Duplication, number) for table in tables)
        self.counters[LinkCounter.DOUBLED] += doubled
        for copy in range(1 + doubled):
            late_us = sum(table.delay_us(number, copy) for table in tables)
            hold_back_us = sum(table.hold_back_us(number, copy) for table in tables)
            self.counters[LinkCounter.HELD_BACK] += hold_back_us > 0
            self._last_us = max(sent_us + late_us, self._last_us)
            self._order += 1
            heapq.heappush(self._in_flight, (self._last_us + hold_back_us, self._order, item))

    @property
    def next_us(self) -> int:
        """[us] when the next one arrives; never, if none is on its way."""
        return self._in_flight[0][0] if self._in_flight else _NEVER_US

    def take(self, before_us: int) -> tuple[int, Item] | None:
        """Return the next one that arrives before a time, after the time [us] of its arrival; `None` if none does."""
        if self.next_us >= before_us:
            return None
        self.counters[LinkCounter.ARRIVED] += 1
        arrival_us, _, item = heapq.heappop(self._in_flight)
        return arrival_us, item

    def take_all(self, before_us: int) -> Iterator[tuple[int, Item]]:
        """Yield all that arrive before a time, in the order of arrival."""
        while (arrived := self.take(before_us)) is not None:
            yield arrived

    def figures(self) -> dict[str, int]:
        """Return the counters by name."""
        return {counter.value: count for counter in LinkCounter if (count := self.counters[counter])}


class _FaultTable:
    """A `[[link]]` table at work: its random numbers, and what it remembers."""

    def __init__(self, fault: AnyFault, seed: int, number: int) -> None:
        self.fault = fault
        self.start_us = _to_us(fault.start_s)
        self.stop_us = _NEVER_US if fault.stop_s is None else _to_us(fault.stop_s)
        self._seed, self._block = seed, 2 * number
        self._bad = False
        self._sent_at_us: deque[int] = deque()

    def transmission_end_us(self, fault: Bandwidth, size: int, now_us: int) -> int | None:
        """Return when a datagram is sent to its last bit; `None` if it finds no room to wait for that."""
        waiting = self._sent_at_us
        while waiting and waiting[0] <= now_us:
            waiting.popleft()
        if len(waiting) > fault.queue:
            return None
        waiting.append((waiting[-1] if waiting else now_us) + round(8e6 * size / fault.rate_bit_s))
        return waiting[-1]

    def loses(self, number: int) -> bool:
        """Whether a datagram is lost here."""
        fault = self.fault
        if not isinstance(fault, BurstLoss):
            return self.occurs(Loss, number)
        change, loss = self._draw(number)
        self._bad = change >= fault.to_good if self._bad else change < fault.to_bad
        return loss < (fault.loss_in_bad if self._bad else fault.loss_in_good)

    def occurs(self, kind: type[Loss | Duplication], number: int) -> bool:
        """Whether a fault of that kind happens here to a datagram."""
        fault = self.fault
        return isinstance(fault, kind) and self._draw(number)[0] < fault.probability

    def delay_us(self, number: int, copy: int) -> int:
        """Return by how much a copy of a datagram, 0 or 1, is late because of this table."""
        fault = self.fault
        if isinstance(fault, Delay):
            return _to_us(fault.delay_s)
        return round(self._draw(number, copy)[0] * fault.most_s * 1e6) if isinstance(fault, Jitter) else 0

    def hold_back_us(self, number: int, copy: int) -> int:
        """Return for how long a copy of a datagram is held back here."""
        fault = self.fault
        if not isinstance(fault, Reordering) or self._draw(number, copy)[0] >= fault.probability:
            return 0
        return _to_us(fault.by_s)

    def _draw(self, number: int, copy: int = 0) -> tuple[float, float]:
        """Return two uniform numbers in (0, 1) that no other table, datagram or copy has."""
        return _uniforms(self._seed, number, self._block + copy)


@compiled
def _uniforms(seed: int, sample: int, block: int) -> tuple[float, float]:
    """Return two independent uniform numbers in (0, 1): a pure function of its arguments, each below 2^32."""
    a, b, _, _ = philox(
        (np.uint64(sample), np.uint64(block), np.uint64(0), np.uint64(0)),
        (np.uint64(seed), np.uint64(LINK_STREAM)),
    )
    return (np.float64(a) + 0.5) * _SCALE, (np.float64(b) + 0.5) * _SCALE


def _to_us(seconds: float) -> int:
    return round(seconds * 1e6)
