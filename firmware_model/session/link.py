"""Faults of the link between vehicle and controller, in model time: loss, duplication, delay, reordering.

    bandwidth -> loss, burst_loss -> duplication -> delay, jitter -> reordering

A datagram passes the `[[link]]` tables of its direction in this order, whatever their order in the file. A table acts
on datagrams that enter from its `start_s` to its `stop_s`. Tables of one kind add up. Datagrams overtake each other
only under `reordering`.
"""

import heapq
from collections import Counter
from collections.abc import Iterator, Sequence
from enum import Enum
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_model.config import link_faults
from firmware_model.numerics.compiled import compiled, kernel
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


_DELAY, _JITTER, _LOSS, _BURSTS, _DOUBLING, _HOLDING, _BANDWIDTH = range(7)
_START, _STOP, _BLOCK = range(3)
_LAST, _HELD = range(2)
LOST, CROWDED_OUT = 0, -1
"""In place of a count of copies: none arrives, for that reason."""
MOST_COPIES = 2
"""Copies of a datagram that arrive, at most."""

IN_TRIM, BEGINS_TO_HOLD, HOLDS = -1, -2, -3
"""In place of the number of a sample: no command has come; they stopped, so the attitude is held from this sample on,
or from an earlier one."""


class LinkSchedule(NamedTuple):
    """Samples that a law steps with, and commands that act."""

    taken: NDArray[np.bool_]
    """(samples,) true for a sample with which the law steps."""
    acting: NDArray[np.int64]
    """(samples,) sample whose command is the set-point of each, or `IN_TRIM`, `BEGINS_TO_HOLD`, `HOLDS`."""


def answered_at_once(samples: int) -> LinkSchedule:
    """Return the schedule of a flight without a script: each sample's command acts at once."""
    return LinkSchedule(np.ones(samples, dtype=np.bool_), np.arange(samples))


class LinkTables(NamedTuple):
    """The `[[link]]` tables of one direction in arrays, with their random numbers and their memory."""

    seed: int
    """Seed of the flight."""
    kinds: NDArray[np.int64]
    """(n,) kind of each table."""
    numbers: NDArray[np.float64]
    """(n, 4) its parameters: [us] of a delay or a hold, [s] of jitter, [bit/s], [-] of all probabilities."""
    times: NDArray[np.int64]
    """(n, 3) [us] its start and stop; number of the first block of its random numbers."""
    bad: NDArray[np.bool_]
    """(n,) true where the chain of a burst loss is in its bad state."""
    queues: NDArray[np.int64]
    """(n, most that wait + 2) [us] times at which the datagrams of a bandwidth have left; a ring."""
    waiting: NDArray[np.int64]
    """(n, 2) place of the first of these, and their count."""
    last: NDArray[np.int64]
    """(2,) [us] latest arrival without a hold; how many copies of the last datagram are held back."""


def make_tables(faults: Sequence[link_faults.AnyFault], direction: str, seed: int) -> LinkTables:
    """Return the tables of a direction, before the first datagram."""
    own = [(number, fault) for number, fault in enumerate(faults) if fault.direction == direction]
    rows = [_row(fault) for _, fault in own]
    n, room = len(own), max((fault.queue for _, fault in own if isinstance(fault, link_faults.Bandwidth)), default=0)
    times = [
        (_to_us(fault.start_s), NEVER_US if fault.stop_s is None else _to_us(fault.stop_s), MOST_COPIES * number)
        for number, fault in own
    ]
    return LinkTables(
        seed,
        kinds=np.array([kind for kind, *_ in rows], dtype=np.int64),
        numbers=np.array([[*numbers, *[0.0] * (4 - len(numbers))] for _, *numbers in rows]).reshape(n, 4),
        times=np.array(times, dtype=np.int64).reshape(n, 3),
        bad=np.zeros(n, dtype=np.bool_),
        queues=np.zeros((n, room + 2), dtype=np.int64),
        waiting=np.zeros((n, 2), dtype=np.int64),
        last=np.zeros(2, dtype=np.int64),
    )


def _row(fault: link_faults.AnyFault) -> tuple[float, ...]:
    """Return kind and parameters of a table."""
    match fault:
        case link_faults.LinkDelay():
            return _DELAY, _to_us(fault.delay_s)
        case link_faults.Jitter():
            return _JITTER, fault.most_s
        case link_faults.Loss():
            return _LOSS, fault.probability
        case link_faults.BurstLoss():
            return _BURSTS, fault.to_bad, fault.to_good, fault.loss_in_bad, fault.loss_in_good
        case link_faults.Duplication():
            return _DOUBLING, fault.probability
        case link_faults.Reordering():
            return _HOLDING, fault.probability, _to_us(fault.by_s)
        case _:
            return _BANDWIDTH, fault.rate_bit_s, fault.queue


class LinkDirection(Generic[Item]):
    """One direction of a link: `send` in order of time, `take` arrivals."""

    def __init__(self, faults: Sequence[link_faults.AnyFault], direction: str, seed: int) -> None:
        self.counters: Counter[LinkCounter] = Counter()
        self._tables = make_tables(faults, direction, seed)
        self._arrivals_us = np.zeros(MOST_COPIES, dtype=np.int64)
        self._in_flight: list[tuple[int, int, Item]] = []
        self._order = 0  # orders simultaneous arrivals

    def send(self, item: Item, size: int, now_us: int) -> None:
        """Send a datagram of `size` bytes."""
        self.counters[LinkCounter.SENT] += 1
        copies = _send(self._tables, self.counters[LinkCounter.SENT], size, now_us, self._arrivals_us)
        if copies <= 0:
            self.counters[LinkCounter.LOST if copies == LOST else LinkCounter.CROWDED_OUT] += 1
            return
        if copies > 1:
            self.counters[LinkCounter.DOUBLED] += 1
        if held := int(self._tables.last[_HELD]):
            self.counters[LinkCounter.HELD_BACK] += held
        for arrival_us in self._arrivals_us[:copies].tolist():
            self._order += 1
            heapq.heappush(self._in_flight, (arrival_us, self._order, item))

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


@compiled
def _send(link: LinkTables, number: int, size: int, now_us: int, arrivals_us: NDArray[np.int64]) -> int:
    return pass_datagram(link, number, size, now_us, arrivals_us)


@kernel
def pass_datagram(link: LinkTables, number: int, size: int, now_us: int, arrivals_us: NDArray[np.int64]) -> int:
    """Write the arrival times [us] of the copies of a datagram, and return their count; or why none arrives.

    Datagrams have numbers from 1 on, and are passed in order of time.
    """
    sent_us, lost, copies = now_us, False, 1
    for i in range(link.kinds.size):
        if link.kinds[i] == _BANDWIDTH and _acts(link, i, now_us):
            sent_us = _transmit(link, i, size, sent_us)
            if sent_us < 0:
                return CROWDED_OUT
    # All tables are asked: a burst goes on even if another table loses the datagram.
    for i in range(link.kinds.size):
        if _acts(link, i, now_us):
            lost = _loses(link, i, number) or lost
            if link.kinds[i] == _DOUBLING and _draw(link, i, number, 0)[0] < link.numbers[i, 0]:
                copies = 2
    if lost:
        return LOST
    link.last[_HELD] = 0
    for copy in range(copies):
        late_us, hold_back_us = 0, 0
        for i in range(link.kinds.size):
            if _acts(link, i, now_us):
                late_us += _delay_us(link, i, number, copy)
                if link.kinds[i] == _HOLDING and _draw(link, i, number, copy)[0] < link.numbers[i, 0]:
                    hold_back_us += int(link.numbers[i, 1])
        link.last[_LAST] = max(sent_us + late_us, link.last[_LAST])
        link.last[_HELD] += hold_back_us > 0
        arrivals_us[copy] = link.last[_LAST] + hold_back_us
    return copies


@kernel
def _acts(link: LinkTables, i: int, now_us: int) -> bool:
    return bool(link.times[i, _START] <= now_us < link.times[i, _STOP])


@kernel
def _transmit(link: LinkTables, i: int, size: int, now_us: int) -> int:
    """Return the time [us] at which a datagram's last bit is sent; a negative number if the queue is full."""
    queue, room = link.queues[i], link.queues.shape[1]
    first, count = link.waiting[i, 0], link.waiting[i, 1]
    while count and queue[first] <= now_us:
        first, count = (first + 1) % room, count - 1
    free_us = -1
    if count <= link.numbers[i, 1]:
        begin_us = queue[(first + count - 1) % room] if count else now_us
        free_us = begin_us + round(8e6 * size / link.numbers[i, 0])
        queue[(first + count) % room] = free_us
        count += 1
    link.waiting[i, 0], link.waiting[i, 1] = first, count
    return int(free_us)


@kernel
def _loses(link: LinkTables, i: int, number: int) -> bool:
    """Return whether a table loses a datagram."""
    numbers = link.numbers[i]
    if link.kinds[i] == _LOSS:
        return bool(_draw(link, i, number, 0)[0] < numbers[0])
    if link.kinds[i] != _BURSTS:
        return False
    change, loss = _draw(link, i, number, 0)
    link.bad[i] = change >= numbers[1] if link.bad[i] else change < numbers[0]
    return bool(loss < (numbers[2] if link.bad[i] else numbers[3]))


@kernel
def _delay_us(link: LinkTables, i: int, number: int, copy: int) -> int:
    """Return the delay [us] of a copy of a datagram by a table."""
    if link.kinds[i] == _DELAY:
        return int(link.numbers[i, 0])
    if link.kinds[i] != _JITTER:
        return 0
    late_us: int = round(_draw(link, i, number, copy)[0] * link.numbers[i, 0] * 1e6)
    return late_us


@kernel
def _draw(link: LinkTables, i: int, number: int, copy: int) -> tuple[float, float]:
    """Return two uniform numbers in (0, 1), unique to this table, datagram and copy."""
    change, loss, _, _ = uniforms(link.seed, LINK_STREAM, number, link.times[i, _BLOCK] + copy)
    return change, loss


def _to_us(seconds: float) -> int:
    return round(seconds * 1e6)
