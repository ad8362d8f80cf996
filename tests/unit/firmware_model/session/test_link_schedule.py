"""The schedule of a link against the link itself, datagram by datagram."""

import random
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.events import ControllerHang, ControllerKill, ModeChange
from firmware_model.config.link_faults import Bandwidth, BurstLoss, Duplication, Jitter, LinkDelay, Loss, Reordering
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.session.link import BEGINS_TO_HOLD, HOLDS, IN_TRIM, LinkDirection
from firmware_model.session.link_schedule import link_schedule
from firmware_model.session.pacing import STALL_US

CALM = replace(load_scenario("calm"), duration_s=1.0)
SAMPLE_US, SIZES, SECOND = CALM.sample_us, (73, 55), 1_000_000
UP, DOWN = {"direction": "to_vehicle"}, {"direction": "to_controller"}
FAULTS = [
    fault
    for way in (UP, DOWN)
    for fault in (
        LinkDelay(kind="delay", delay_s=0.007, **way),
        Jitter(kind="jitter", most_s=0.009, **way),
        Loss(kind="loss", probability=0.2, **way),
        BurstLoss(kind="burst_loss", to_bad=0.1, to_good=0.1, loss_in_good=0.05, **way),
        Duplication(kind="duplication", probability=0.2, **way),
        Reordering(kind="reordering", probability=0.1, by_s=0.02, **way),
        Bandwidth(kind="bandwidth", rate_bit_s=110_000.0, queue=4, **way),
    )
]


def hung(at_s: float, for_s: float) -> ControllerHang:
    return ControllerHang(kind="controller_hung", at_s=at_s, for_s=for_s)


def flown_by_datagrams(scenario: Scenario, seed: int) -> tuple[list[bool], list[int]]:
    """Return what a schedule tells, from two lines that carry numbers of samples."""
    down: LinkDirection[int] = LinkDirection(scenario.link, "to_controller", seed)
    up: LinkDirection[int] = LinkDirection(scenario.link, "to_vehicle", seed)
    taken, acting = [True] + [False] * (scenario.samples - 1), []
    newest_sent, newest_answer, accepted_us, holds_at_us, current = -1, -1, 0, 1 << 60, IN_TRIM
    hangs = [(1e6 * item.at_s, 1e6 * (item.at_s + item.for_s)) for item in scenario.event]
    for k in range(scenario.samples):
        now_us = k * SAMPLE_US
        down.send(k, SIZES[0], now_us)
        for arrival_us, sample in list(down.take_all(now_us + SAMPLE_US)):
            if sample >= newest_sent and not any(begin <= arrival_us < end for begin, end in hangs):
                newest_sent, taken[sample] = sample, True
                up.send(sample, SIZES[1], arrival_us)
        for _, sample in list(up.take_all(now_us + SAMPLE_US)):
            if sample >= newest_answer:
                newest_answer = current = sample
                holds_at_us = now_us + max(STALL_US, 3 * (now_us - accepted_us))
                accepted_us = now_us
        if now_us >= holds_at_us:
            current, holds_at_us = BEGINS_TO_HOLD, 1 << 60
        acting.append(current)
        current = HOLDS if current == BEGINS_TO_HOLD else current
    return taken, acting


@pytest.mark.parametrize("seed", range(40))
def test_a_schedule_is_what_the_link_does_to_each_datagram(seed):
    chance = random.Random(seed)
    faults = []
    for fault in chance.sample(FAULTS, chance.randrange(1, 9)):
        begin = chance.choice((0.0, 0.1, 0.3))
        faults.append(replace(fault, start_s=begin, stop_s=chance.choice((None, begin + 0.2, begin + 0.5))))
    script = replace(CALM, link=tuple(faults), event=(hung(0.4, chance.choice((0.004, 0.1, 0.3))),))
    taken, acting = flown_by_datagrams(script, seed)
    schedule = link_schedule(script, seed, SIZES, SECOND)
    assert schedule is not None
    assert schedule.taken.tolist() == taken
    assert schedule.acting.tolist() == acting


def test_without_a_script_each_sample_is_answered_at_once():
    schedule = link_schedule(CALM, 1, SIZES, SECOND)
    assert schedule.taken.all()
    assert schedule.acting.tolist() == list(range(CALM.samples))


def test_a_stream_that_ends_is_held_and_then_lost():
    script = replace(CALM, event=(hung(0.4, 10.0),))
    acting = link_schedule(script, 1, SIZES, 600_001).acting
    last, holds = round(0.4 / CALM.dt) - 1, round((0.396 + 0.05) / CALM.dt) + 1
    assert acting[last] == last
    assert set(acting[last:holds].tolist()) <= {last, BEGINS_TO_HOLD}
    assert np.flatnonzero(acting == BEGINS_TO_HOLD).size == 1
    assert acting[-1] == HOLDS
    assert link_schedule(script, 1, SIZES, 500_000) is None


@pytest.mark.parametrize(
    "event",
    [
        ControllerKill(kind="controller_killed", at_s=0.5, recovers_after_s=0.1),
        ModeChange(kind="mode", at_s=0.5, mode="hold"),
    ],
)
def test_what_is_decided_in_flight_has_no_schedule(event):
    assert link_schedule(replace(CALM, event=(event,)), 1, SIZES, SECOND) is None


def test_a_link_that_loses_everything_leaves_the_trim_until_the_stream_is_lost():
    script = replace(CALM, link=(Loss(kind="loss", probability=1.0, **UP),))
    assert link_schedule(script, 1, SIZES, SECOND + 1).acting.tolist() == [IN_TRIM] * CALM.samples
    assert link_schedule(script, 1, SIZES, SECOND - SAMPLE_US) is None
