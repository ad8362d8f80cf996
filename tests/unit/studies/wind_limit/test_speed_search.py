"""The search of a speed: both ends are right far more often than not, whatever the tail of the failures is."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import norm

from gustproof.studies.campaign.intervals import IntervalEstimate
from gustproof.studies.wind_limit.speed_search import (
    ESTIMATE_CONFIDENCE,
    SpeedEstimate,
    SpeedLimit,
    find_rare_limit,
    find_speed_limit,
    scout_speed,
)

Tail = Callable[[float], float]
TAILS: dict[str, Tail] = {
    "normal": lambda z: float(norm.cdf(z)),
    "logistic": lambda z: 1.0 / (1.0 + math.exp(min(-1.7 * z, 700.0))),
    "gumbel": lambda z: 1.0 - math.exp(-math.exp(min(z, 50.0))),
}

NEVER = IntervalEstimate(0.0, 0.0, 1e-6)  # levels that lead nowhere


def search(tail: Tail, median: float, spread: float, risk: float, random: np.random.Generator) -> SpeedLimit:
    def fails(speed: float, _first: int, count: int) -> int:
        return int(random.binomial(count, tail(math.log(speed / median) / spread)))

    return find_speed_limit(fails, risk=risk, least=0.5, most=40.0)


@pytest.mark.slow
@pytest.mark.parametrize("tail", TAILS)
def test_both_ends_are_right_whatever_the_tail(tail: str) -> None:
    random, wrong, enclosed = np.random.default_rng(11), 0, 0
    for _ in range(60):
        median, spread = random.uniform(3.0, 30.0), random.uniform(0.02, 0.35)
        risk = 10.0 ** max(random.uniform(-4.5, -1.0), -3.0)  # often the default, the hardest
        found = search(TAILS[tail], median, spread, risk, random)
        low, high = found.low or 1e-9, found.high or 1e9
        wrong += not TAILS[tail](math.log(low / median) / spread) < risk < TAILS[tail](math.log(high / median) / spread)
        enclosed += low > 1e-9 and high < 1e9
        assert found.flights < 34_000
        assert math.isnan(found.best) or low <= found.best <= high
    assert wrong <= 3  # 5 % of 60
    assert enclosed >= 54


@pytest.mark.slow
def test_a_risk_just_at_a_tested_speed_is_claimed_on_neither_side_too_often() -> None:
    random, wrong = np.random.default_rng(5), 0
    for _ in range(100):  # flat: each test sees the risk itself, a little above it
        found = find_speed_limit(
            lambda _speed, _first, count: int(random.binomial(count, 0.0203)), risk=0.02, least=0.5, most=40.0
        )
        wrong += found.low is not None
    assert wrong <= 5


@pytest.mark.slow
@pytest.mark.parametrize("tail", TAILS)
def test_both_ends_of_a_small_risk_are_right_whatever_the_tail(tail: str) -> None:
    random, wrong, enclosed, wide = np.random.default_rng(3), 0, 0, 0.5 * (1.0 + ESTIMATE_CONFIDENCE)
    for _ in range(60):
        median, spread, risk = random.uniform(3.0, 20.0), random.uniform(0.02, 0.2), 10.0 ** random.uniform(-8.0, -4.1)

        def probability(speed: float, median: float = median, spread: float = spread) -> float:
            return TAILS[tail](math.log(speed / median) / spread)

        def estimate(speed: float, probability: Callable[[float], float] = probability) -> SpeedEstimate:
            value, error = probability(speed) * math.exp(random.normal(0.0, 0.25)), math.exp(0.25 * norm.ppf(wide))
            found = IntervalEstimate(value, value / error, value * error) if value > 1e-12 else NEVER
            return SpeedEstimate(found, 25_000)

        found = find_rare_limit(
            lambda speed, _, count, p=probability: int(random.binomial(count, p(speed))), estimate,
            risk=risk, least=0.1, most=100.0,
        )  # fmt: skip
        wrong += not probability(found.low or 1e-9) < risk < probability(found.high or 1e9)
        enclosed += found.low is not None and found.high is not None
    assert wrong <= 3  # 5 % of 60
    assert enclosed >= 54


def test_a_limit_that_is_not_there_is_said() -> None:
    never = find_speed_limit(lambda *_: 0, risk=1e-2, least=0.5, most=40.0)
    assert (never.low, never.high, math.isnan(never.best)) == (40.0, None, True)
    for risk, low in ((1e-5, 40.0), (1e-7, None)):  # the levels end above the smaller one
        calm = find_rare_limit(lambda *_: 0, lambda _: SpeedEstimate(NEVER, 2000), risk=risk, least=0.5, most=40.0)
        assert (calm.low, calm.high, math.isnan(calm.best)) == (low, None, True)
    sure = SpeedEstimate(IntervalEstimate(1.0, 1.0, 1.0), 0)
    storm = find_rare_limit(lambda _v, _first, n: n, lambda _: sure, risk=1e-6, least=0.5, most=40.0)
    assert (storm.low, storm.high) == (None, 0.5)
    always = find_speed_limit(lambda _speed, _first, count: count, risk=1e-2, least=0.5, most=40.0)
    assert (always.low, always.high) == (None, 0.5)


def test_scouting_ends_a_little_below_the_middle() -> None:
    assert 9.0 < scout_speed(lambda speed, _first, count: count * (speed > 10.3), least=0.5, most=40.0) <= 10.3
