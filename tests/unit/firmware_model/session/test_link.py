"""Each fault of the link against its formula, on datagrams sent every 4 ms."""

import math
from dataclasses import replace
from itertools import groupby, pairwise

import numpy as np
import pytest

from firmware_model.config.events import ModeChange
from firmware_model.config.files import validate
from firmware_model.config.link_faults import Bandwidth, BurstLoss, Duplication, Jitter, LinkDelay, Loss, Reordering
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.errors import ConfigError
from firmware_model.session.link import LinkCounter, LinkDirection

EVERY_US = 4_000
MANY = 20_000
DIRECTION = {"direction": "to_vehicle"}
DELAY = LinkDelay(kind="delay", delay_s=0.011, **DIRECTION)
JITTER = Jitter(kind="jitter", most_s=0.003, **DIRECTION)
LOSS = Loss(kind="loss", probability=0.1, **DIRECTION)
BURSTS = BurstLoss(kind="burst_loss", to_bad=0.02, to_good=0.25, **DIRECTION)
DOUBLING = Duplication(kind="duplication", probability=0.1, **DIRECTION)
HOLDING = Reordering(kind="reordering", probability=0.1, by_s=0.010, **DIRECTION)
SLOW = Bandwidth(kind="bandwidth", rate_bit_s=100_000.0, queue=5, **DIRECTION)


def passed(
    *faults, count: int = MANY, seed: int = 1, size: int = 43
) -> tuple[list[tuple[int, int]], LinkDirection[int]]:
    """Return arrival time [us] and number of what arrives, and the line that it passed."""
    line: LinkDirection[int] = LinkDirection(faults, "to_vehicle", seed)
    for number in range(count):
        line.send(number, size, number * EVERY_US)
    return list(line.take_all(1 << 60)), line


def lateness(arrivals: list[tuple[int, int]]) -> np.ndarray:
    return np.array([arrival_us - number * EVERY_US for arrival_us, number in arrivals])


def lost(arrivals: list[tuple[int, int]]) -> np.ndarray:
    return np.setdiff1d(np.arange(MANY), [number for _, number in arrivals])


def sigma(probability: float, count: int = MANY) -> float:
    """Standard deviation of a share of `count` independent events."""
    return math.sqrt(probability * (1.0 - probability) / count)


def test_line_without_faults_passes_all_at_once():
    arrivals, line = passed(count=100)
    assert arrivals == [(number * EVERY_US, number) for number in range(100)]
    assert line.stats() == {"sent": 100, "arrived": 100}


def test_faults_of_the_other_direction_do_nothing():
    arrivals, _ = passed(Loss(kind="loss", probability=1.0, direction="to_controller"), count=100)
    assert len(arrivals) == 100


def test_delay_makes_all_late_by_the_same():
    arrivals, _ = passed(DELAY, count=100)
    assert set(lateness(arrivals)) == {11_000}


def test_tables_of_one_kind_add_up_while_they_last():
    later = LinkDelay(kind="delay", delay_s=0.002, start_s=0.1, stop_s=0.2, **DIRECTION)
    arrivals, _ = passed(DELAY, later, count=100)
    late_us = lateness(arrivals)
    assert set(late_us[:25]) == {11_000}
    assert set(late_us[25:50]) == {13_000}
    assert set(late_us[50:]) == {11_000}


def test_delay_that_ends_lets_none_overtake():
    ending = LinkDelay(kind="delay", delay_s=0.020, stop_s=0.1, **DIRECTION)
    arrivals, _ = passed(ending, count=100)
    assert [number for _, number in arrivals] == list(range(100))
    late_us = lateness(arrivals)
    assert late_us[24] == 20_000
    assert list(late_us[25:30]) == [16_000, 12_000, 8_000, 4_000, 0]


@pytest.mark.slow
def test_jitter_is_uniform():
    arrivals, _ = passed(JITTER)
    shares = np.sort(lateness(arrivals)) / 3_000
    assert shares[0] >= 0.0
    assert shares[-1] <= 1.0
    # Kolmogorov's distance is below 1.95 / sqrt(n) with a probability of .999.
    assert np.abs(shares - (np.arange(MANY) + 0.5) / MANY).max() < 1.95 / math.sqrt(MANY)


@pytest.mark.slow
def test_jitter_longer_than_a_sample_lets_none_overtake():
    arrivals, _ = passed(Jitter(kind="jitter", most_s=0.05, **DIRECTION))
    assert [number for _, number in arrivals] == list(range(MANY))
    assert lateness(arrivals).max() <= 50_000


@pytest.mark.slow
def test_loss_has_its_probability_and_no_memory():
    arrivals, line = passed(LOSS)
    gone = lost(arrivals)
    assert len(gone) == line.counters[LinkCounter.LOST]
    assert abs(len(gone) / MANY - 0.1) < 4.0 * sigma(0.1)
    assert abs(np.sum(np.diff(gone) == 1) / MANY - 0.01) < 4.0 * sigma(0.01)


@pytest.mark.slow
def test_bursts_have_the_chains_share_and_mean_length():
    gone = lost(passed(BURSTS)[0])
    share, length = 0.02 / (0.02 + 0.25), 1.0 / 0.25
    missing = np.zeros(MANY, dtype=bool)
    missing[gone] = True
    bursts = [len(list(group)) for is_lost, group in groupby(missing) if is_lost]
    # A run of a chain with these rates is worth (1 - r) / (1 + r) of as many independent ones, r = 1 - .02 - .25.
    assert abs(len(gone) / MANY - share) < 4.0 * sigma(share) * math.sqrt(1.73 / 0.27)
    assert abs(np.mean(bursts) - length) < 4.0 * length * math.sqrt(0.75 / len(bursts))
    # Geometric: the share of bursts of a single datagram is that of leaving the bad state.
    assert abs(np.mean(np.array(bursts) == 1) - 0.25) < 4.0 * sigma(0.25, len(bursts))


@pytest.mark.slow
def test_losses_in_either_state_have_their_probability():
    leaky = BurstLoss(
        kind="burst_loss", to_bad=0.3, to_good=0.6, loss_in_bad=0.5, loss_in_good=0.05, **DIRECTION
    )  # fmt: skip
    share = (0.3 * 0.5 + 0.6 * 0.05) / 0.9
    # Correlation of neighbours, .1 a step, makes the spread at most sqrt(1.1 / .9) times that of independent losses.
    assert abs(len(lost(passed(leaky)[0])) / MANY - share) < 4.0 * sigma(share) * math.sqrt(1.1 / 0.9)


@pytest.mark.slow
def test_doubled_ones_arrive_twice_each_with_its_own_jitter():
    arrivals, line = passed(DOUBLING, JITTER)
    numbers = [number for _, number in arrivals]
    doubled = len(numbers) - len(set(numbers))
    assert len(set(numbers)) == MANY
    assert doubled == line.counters[LinkCounter.DOUBLED]
    assert abs(doubled / MANY - 0.1) < 4.0 * sigma(0.1)
    apart = [second[0] - first[0] for first, second in pairwise(arrivals) if first[1] == second[1]]
    assert len(set(apart)) > 100


def test_a_microsecond_is_held_back_too():
    _, line = passed(replace(HOLDING, by_s=1e-6), count=200)
    assert 0 < line.counters[LinkCounter.HELD_BACK] < 60


@pytest.mark.slow
def test_held_back_ones_are_overtaken():
    arrivals, line = passed(HOLDING)
    late_us = lateness(arrivals)
    assert set(late_us) == {0, 10_000}
    held = int(np.sum(late_us == 10_000))
    assert held == line.counters[LinkCounter.HELD_BACK]
    assert abs(held / MANY - 0.1) < 4.0 * sigma(0.1)
    order = [number for _, number in arrivals]
    assert order != sorted(order)
    assert sorted(order) == list(range(MANY))


def test_bandwidth_spaces_datagrams_by_their_bits():
    wide = Bandwidth(kind="bandwidth", rate_bit_s=1_000_000.0, **DIRECTION)
    assert set(lateness(passed(wide, count=100)[0])) == {8 * 43}


def test_too_narrow_a_link_fills_its_queue_then_crowds_out():
    narrow = Bandwidth(kind="bandwidth", rate_bit_s=43_000.0, queue=5, **DIRECTION)  # 8 ms each, one comes every 4 ms
    arrivals, line = passed(narrow, count=2_000)
    times_us = np.array([arrival_us for arrival_us, _ in arrivals])
    assert set(np.diff(times_us)) == {8_000}
    # One on its way and five that wait for it and each other: what is left of the first, and six whole ones.
    assert 5 * 8_000 <= lateness(arrivals).max() <= 6 * 8_000
    assert line.counters[LinkCounter.CROWDED_OUT] == 2_000 - len(arrivals)
    assert len(arrivals) == pytest.approx(1_000, abs=7)


ALL = (DELAY, JITTER, LOSS, BURSTS, DOUBLING, HOLDING, SLOW)


@pytest.mark.slow
def test_same_seed_is_the_same_link_and_another_is_not():
    assert passed(*ALL, count=2_000)[0] == passed(*ALL, count=2_000)[0]
    assert passed(*ALL, count=2_000)[0] != passed(*ALL, count=2_000, seed=2)[0]


def test_twice_as_many_begin_identically():
    longer = passed(*ALL, count=2_000)[0]
    shorter = passed(*ALL, count=1_000)[0]
    until_us = 990 * EVERY_US
    assert [item for item in longer if item[0] < until_us] == [item for item in shorter if item[0] < until_us]


@pytest.mark.slow
def test_one_more_table_leaves_what_the_others_do():
    before, after = passed(JITTER, DOUBLING)[0], passed(JITTER, DOUBLING, LOSS)[0]
    late = dict(zip([number for _, number in before], lateness(before), strict=True))
    stayed = [(number, late_us) for (_, number), late_us in zip(after, lateness(after), strict=True)]
    assert 0.8 * len(before) < len(stayed) < len(before)
    assert all(late[number] == late_us for number, late_us in dict(stayed).items())


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"kind": "delay", "direction": "up", "delay_s": 0.1}, "'to_controller' or 'to_vehicle'"),
        ({"kind": "delay", "direction": "to_vehicle", "delay_ms": 100}, "delay_ms: unknown key"),
        ({"kind": "delay", "direction": "to_vehicle"}, "delay_s: missing"),
        ({"kind": "loss", "direction": "to_vehicle", "probability": 1.5}, "less than or equal to 1"),
        ({"kind": "loss", "direction": "to_vehicle", "probability": math.nan}, "probability"),
        (
            {"kind": "loss", "direction": "to_vehicle", "probability": 0.1, "start_s": 2.0, "stop_s": 1.0},
            "stop_s must be later than start_s",
        ),
        ({"kind": "fog", "direction": "to_vehicle"}, "'burst_loss'"),
    ],
)
def test_mistakes_in_a_table_are_told_with_what_is_allowed(table, words):
    document = {"name": "foggy", "description": "", "duration_s": 1.0, "link": [table]}
    with pytest.raises(ConfigError, match=r"foggy\.toml: link\.0") as caught:
        validate(Scenario, document, "foggy.toml")
    assert words in str(caught.value)


def test_two_killed_controllers_are_refused():
    killing = {"kind": "controller_killed", "at_s": 1.0}
    document = {"name": "bad", "description": "", "duration_s": 1.0, "event": [killing, killing]}
    with pytest.raises(ConfigError, match="at most one 'controller_killed'"):
        validate(Scenario, document, "bad.toml")


def test_only_what_touches_the_conversation_needs_messages():
    calm = {"name": "calm", "description": "", "duration_s": 1.0}
    assert not load_scenario("paper").has_link_script
    assert validate(
        Scenario, {**calm, "link": [{"kind": "loss", "direction": "to_vehicle", "probability": 0.1}]}, ""
    ).link
    changed = validate(Scenario, {**calm, "event": [{"kind": "mode", "at_s": 1.0, "mode": "hold"}]}, "")
    assert changed.event == (ModeChange(kind="mode", at_s=1.0, mode="hold"),)
    assert changed.has_link_script
