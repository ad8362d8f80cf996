"""Schedule of a flight in lockstep over a scripted link, made before it: no fault depends on how the vehicle moves.

It tells at which samples a law steps, and whose command is the set-point of each sample. So a flight needs no messages
for it. Those in which the stream is lost, the controller is killed, or a mode is scripted do: what follows is decided
in flight.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.events import ControllerHang
from firmware_model.config.scenario import Scenario
from firmware_model.numerics.compiled import compiled, kernel
from firmware_model.session.link import (
    BEGINS_TO_HOLD,
    HOLDS,
    IN_TRIM,
    MOST_COPIES,
    LinkSchedule,
    LinkTables,
    answered_at_once,
    make_tables,
    pass_datagram,
)
from firmware_model.session.pacing import STALL_INTERVALS, STALL_US
from firmware_model.types import NEVER_US

Times = NDArray[np.int64]


class _Sent(NamedTuple):
    """Datagrams of one direction, in the order of their arrival."""

    times: Times
    """(n,) [us] of arrival."""
    samples: Times
    """(n,) number of the sample that each holds or answers."""


def link_schedule(scenario: Scenario, seed: int, sizes: tuple[int, int], timeout_us: int) -> LinkSchedule | None:
    """Return the schedule of a flight; `None` if its stream is lost, or it needs messages for another reason.

    `sizes` [bytes] are those of a sample and of a command, `timeout_us` is the time after which a stream is lost.
    """
    n = scenario.samples
    if not scenario.has_link_script:
        return answered_at_once(n)
    if scenario.needs_messages:
        return None
    hangs = [item for item in scenario.event if isinstance(item, ControllerHang)]
    begins = [scenario.nearest_sample(item.at_s) for item in hangs]
    ends = [scenario.nearest_sample(item.at_s + item.for_s) for item in hangs]
    outages = scenario.sample_us * np.array([begins, ends], dtype=np.int64)
    down, up = (make_tables(scenario.link, way, seed) for way in ("to_controller", "to_vehicle"))
    room = np.zeros((2, MOST_COPIES * n), dtype=np.int64)
    sent = _in_order(room, _send_samples(down, sizes[0], scenario.sample_us, n, room))
    taken, answers = np.zeros(n, dtype=np.bool_), np.zeros((2, MOST_COPIES * len(sent.times)), dtype=np.int64)
    taken[0] = True  # the law has stepped with it before t = 0, where the link carries nothing
    count = _answer(up, sizes[1], n * scenario.sample_us, outages, sent, taken, answers)
    acting = np.full(n, IN_TRIM)
    if not _accept(_in_order(answers, count), scenario.sample_us, timeout_us, acting):
        return None
    return LinkSchedule(taken, acting)


def _in_order(room: Times, count: int) -> _Sent:
    """Return the datagrams of the first columns in the order in which they arrive, or were sent if that is at once."""
    order = np.argsort(room[0, :count], kind="stable")
    return _Sent(room[0, order], room[1, order])


@compiled
def _send_samples(link: LinkTables, size: int, sample_us: int, samples: int, room: Times) -> int:
    """Send each sample when it is taken; write arrivals and numbers of what arrives, and return its count."""
    count = 0
    for k in range(samples):
        count = _carry(link, k + 1, size, k * sample_us, k, count, room)
    return count


@compiled
def _answer(
    link: LinkTables, size: int, end_us: int, outages: Times, sent: _Sent, taken: NDArray[np.bool_], room: Times
) -> int:
    """Answer each sample that no newer one has overtaken; write arrivals and samples of the answers."""
    count, number, newest = 0, 0, -1
    for i in range(sent.times.size):
        time_us, k, heard = sent.times[i], sent.samples[i], sent.times[i] < end_us
        for j in range(outages.shape[1]):
            heard = heard and not outages[0, j] <= time_us < outages[1, j]
        if not heard or k < newest:
            continue
        newest, number = k, number + 1
        taken[k] = True
        count = _carry(link, number, size, time_us, k, count, room)
    return count


@kernel
def _carry(link: LinkTables, number: int, size: int, now_us: int, sample: int, count: int, room: Times) -> int:
    """Send a datagram of a sample; write what arrives behind the `count` that did before, and return their count."""
    copies = max(pass_datagram(link, number, size, now_us, room[0, count:]), 0)
    for i in range(copies):
        room[1, count + i] = sample
    return count + copies


@compiled
def _accept(answers: _Sent, sample_us: int, timeout_us: int, acting: Times) -> bool:
    """Write whose command acts at each sample, as `FlightClock` decides; return false once the stream is lost."""
    i, newest, accepted_us, stalls_us = 0, -1, 0, NEVER_US
    current = IN_TRIM
    for k in range(acting.size):
        time_us = k * sample_us
        while i < answers.times.size and answers.times[i] < time_us + sample_us:
            if answers.samples[i] >= newest:
                current = newest = answers.samples[i]
                stalls_us = time_us + max(STALL_US, STALL_INTERVALS * (time_us - accepted_us))
                accepted_us = time_us
            i += 1
        if time_us >= accepted_us + timeout_us:
            return False
        if time_us >= stalls_us:
            current, stalls_us = BEGINS_TO_HOLD, NEVER_US
        acting[k] = current
        if current == BEGINS_TO_HOLD:
            current = HOLDS
    return True
