"""Faults of the link between vehicle and controller, in model time: loss, duplication, delay, reordering.

    bandwidth -> loss, burst_loss -> duplication -> delay, jitter -> reordering

A datagram passes the `[[link]]` tables of its direction in this order, whatever their order in the file. A table acts
on datagrams that enter from its `start_s` to its `stop_s`. Tables of one kind add up. Datagrams overtake each other
only under `reordering`.
"""

import heapq
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from enum import Enum
from typing import Generic, TypeVar

from firmware_model.config import link_faults
from firmware_model.numerics.compiled import compiled
from firmware_model.numerics.elementary import uniforms
from firmware_model.numerics.random import LINK_STREAM
from firmware_model.types import NEVER_US

Item = TypeVar("Item")


class LinkCounter(Enum):
    """Counted fate of a datagram; the values are the counters' names."""

    __hash__ = object.__hash__  # enum's own, in Python, is called ten times a sample

    SENT = "sent"
    """Entered this direction."""
    ARRIVED = "arrived"
    """Came out at the other end."""
    LOST = "lost"
    """Lost at random, alone or in a burst."""
    CROWDED_OUT = "crowded_out"
    """Dropped at a full queue."""
    DOUBLED = "doubled"
    """Duplicated."""
    HELD_BACK = "held_back"
    """Held back, so that others overtake it."""
    UNHEARD = "unheard"
    """Arrived at a hanging or dead controller."""
    OVERTAKEN = "overtaken"
    """Arrived at the vehicle after the answer to a newer sample, and was not flown."""


class LinkDirection(Generic[Item]):
    """One direction of a link: `send` in order of time, `take` arrivals."""

    def __init__(self, faults: Sequence[link_faults.AnyFault], direction: str, seed: int) -> None:
        self.counters: Counter[LinkCounter] = Counter()
        self._tables = [
            _FaultTable(fault, seed, number) for number, fault in enumerate(faults) if fault.direction == direction
        ]
        self._in_flight: list[tuple[int, int, Item]] = []
        self._order = 0  # orders simultaneous arrivals
        self._last_us = 0

    def send(self, item: Item, size: int, now_us: int) -> None:
        """Send a datagram of `size` bytes."""
        self.counters[LinkCounter.SENT] += 1
        number = self.counters[LinkCounter.SENT]
        tables = [table for table in self._tables if table.start_us <= now_us < table.stop_us]
        sent_us = now_us
        for table in tables:
            if isinstance(table.fault, link_faults.Bandwidth):
                free_us = table.transmission_end_us(table.fault, size, sent_us)
                if free_us is None:
                    self.counters[LinkCounter.CROWDED_OUT] += 1
                    return
                sent_us = free_us
        # Evaluate all tables: a burst continues even if another table loses the datagram.
        if any([table.is_lost(number) for table in tables]):
            self.counters[LinkCounter.LOST] += 1
            return
        duplicated = any([table.occurs(link_faults.Duplication, number) for table in tables])
        if duplicated:
            self.counters[LinkCounter.DOUBLED] += 1
        for copy in range(1 + duplicated):
            late_us = hold_back_us = 0
            for table in tables:
                late_us += table.delay_us(number, copy)
                hold_back_us += table.hold_back_us(number, copy)
            if hold_back_us:
                self.counters[LinkCounter.HELD_BACK] += 1
            self._last_us = max(sent_us + late_us, self._last_us)
            self._order += 1
            heapq.heappush(self._in_flight, (self._last_us + hold_back_us, self._order, item))

    @property
    def next_us(self) -> int:
        """[us] Time of the next arrival; `NEVER_US` if nothing is on its way."""
        return self._in_flight[0][0] if self._in_flight else NEVER_US

    def take(self, before_us: int) -> tuple[int, Item] | None:
        """Return arrival time [us] and item of the next arrival before a time; `None` if there is none."""
        if self.next_us >= before_us:
            return None
        self.counters[LinkCounter.ARRIVED] += 1
        arrival_us, _, item = heapq.heappop(self._in_flight)
        return arrival_us, item

    def take_all(self, before_us: int) -> Iterator[tuple[int, Item]]:
        """Yield arrival time [us] and item of all arrivals before a time, in order."""
        while (arrived := self.take(before_us)) is not None:
            yield arrived

    def stats(self) -> dict[str, int]:
        """Return the counters by name."""
        return {counter.value: count for counter in LinkCounter if (count := self.counters[counter])}


class _FaultTable:
    """A `[[link]]` table with its random numbers and its memory."""

    def __init__(self, fault: link_faults.AnyFault, seed: int, number: int) -> None:
        self.fault = fault
        self.start_us = _to_us(fault.start_s)
        self.stop_us = NEVER_US if fault.stop_s is None else _to_us(fault.stop_s)
        self._seed, self._block = seed, 2 * number
        self._bad = False
        self._sent_at_us: deque[int] = deque()

    def transmission_end_us(self, fault: link_faults.Bandwidth, size: int, now_us: int) -> int | None:
        """Return the time [us] at which a datagram's last bit is sent; `None` if the queue is full."""
        waiting = self._sent_at_us
        while waiting and waiting[0] <= now_us:
            waiting.popleft()
        if len(waiting) > fault.queue:
            return None
        waiting.append((waiting[-1] if waiting else now_us) + round(8e6 * size / fault.rate_bit_s))
        return waiting[-1]

    def is_lost(self, number: int) -> bool:
        """Return whether this table loses a datagram."""
        fault = self.fault
        if not isinstance(fault, link_faults.BurstLoss):
            return self.occurs(link_faults.Loss, number)
        change, loss = self._draw(number)
        self._bad = change >= fault.to_good if self._bad else change < fault.to_bad
        return loss < (fault.loss_in_bad if self._bad else fault.loss_in_good)

    def occurs(self, kind: type[link_faults.Loss | link_faults.Duplication], number: int) -> bool:
        """Return whether this table is of that kind and applies its fault to a datagram."""
        fault = self.fault
        return isinstance(fault, kind) and self._draw(number)[0] < fault.probability

    def delay_us(self, number: int, copy: int) -> int:
        """Return the delay [us] of a copy of a datagram, 0 or 1, by this table."""
        fault = self.fault
        if isinstance(fault, link_faults.LinkDelay):
            return _to_us(fault.delay_s)
        return round(self._draw(number, copy)[0] * fault.most_s * 1e6) if isinstance(fault, link_faults.Jitter) else 0

    def hold_back_us(self, number: int, copy: int) -> int:
        """Return the time [us] for which this table holds back a copy of a datagram."""
        fault = self.fault
        if not isinstance(fault, link_faults.Reordering) or self._draw(number, copy)[0] >= fault.probability:
            return 0
        return _to_us(fault.by_s)

    def _draw(self, number: int, copy: int = 0) -> tuple[float, float]:
        """Return two uniform numbers in (0, 1), unique to this table, datagram and copy."""
        change, loss, _, _ = _uniforms(self._seed, number, self._block + copy)
        return change, loss


@compiled
def _uniforms(seed: int, number: int, block: int) -> tuple[float, float, float, float]:
    return uniforms(seed, LINK_STREAM, number, block)


def _to_us(seconds: float) -> int:
    return round(seconds * 1e6)
