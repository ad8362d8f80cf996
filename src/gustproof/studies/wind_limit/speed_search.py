"""Search the wind speed at which the probability of a failure reaches a stated risk, by sequential tests.

A test at one speed ends when either of two statements is shown: the probability is below the risk, or above it. Each is
a mean of likelihood ratios of a Bernoulli process, a nonnegative supermartingale if the statement is false. So it may
be read after each batch, and is wrong at most with its share of the whole error (Ville's inequality). Speeds are chosen
by a normal distribution of the logarithm of the speed at which a flight fails. A bad choice costs flights, not truth;
a test that a far lower speed would end sooner is given up.

Failures of a risk below `RARE` can't be counted: their probability is estimated, see `studies.campaign.rare`. Its
interval shows on which side of the risk it is; all estimates of a search share the error.

References
----------
A. Wald, Sequential Tests of Statistical Hypotheses, Annals of Mathematical Statistics 16, 1945.
S. R. Howard, A. Ramdas, J. McAuliffe, J. Sekhon, Time-uniform, nonparametric, nonasymptotic confidence sequences,
Annals of Statistics 49, 2021.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr
from scipy.stats import norm

from gustproof.studies.campaign.intervals import IntervalEstimate
from gustproof.types import Array

CONFIDENCE = 0.95
"""[-] probability that the interval of a limit holds it."""
_TESTS = 20
"""Speeds at which a statement may be made, those of the scouting among them."""
_OF_SCOUTS = 0.1
"""[-] share of the error for statements at scouted speeds, in equal parts; of the rest, test k has 1 / (k (k + 1))."""
_BELOW, _ABOVE = 8.0, 3.0  # factors of the risk, by which the probability at a tested speed is meant to differ from it
_OTHERS_BELOW, _OTHERS_ABOVE = (2.0, 8.0), (1.5, 3.0)  # factors of the risk: probabilities that a test has beside it
_WIDER = 1.7  # [-] on these factors, after a test that shows neither
_SCOUTS, _BATCH, _LARGEST = 64, 256, 2048  # flights at each speed of a scouting; of the first and the largest batch
_NEAR = 1.12  # [-] ratio of speeds at which scouting ends
_LOWER = 0.85  # [-] of the least speed that was tested, where the fit leads no further
_CLOSE = 1.05  # [-] ratio of the ends at which the search ends
RARE = 5e-4
"""[-] risk below which the probability of a failure is estimated, not counted: a test takes some 8 flights over it."""
_ESTIMATES = 8  # most of a search
ESTIMATE_CONFIDENCE = 1.0 - 2.0 * (1.0 - CONFIDENCE) / _ESTIMATES
"""[-] of the interval of each: it may be wrong about one side of the risk alone."""
_OFTEN = 0.1  # [-]
_STEP, _NEVER = 1.5, 1e-12  # [-] largest ratio of a speed to those flown; probability that stands for none
_SEEN = 3.0  # failures expected at the risk, from which on a test may be given up
_DEARER = 2.0  # [-] flights that a test still lacks, over those of one at a speed where nothing fails


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedTrial:
    """All flights at one speed."""

    speed: float
    """[m/s]."""
    flights: int
    """Number of flights."""
    probability: float
    """[-] share of them that failed, or its estimate."""


class SpeedEstimate(NamedTuple):
    """Estimated probability of a failure at one speed."""

    probability: IntervalEstimate
    """[-] with an interval of `ESTIMATE_CONFIDENCE`."""
    flights: int
    """Number of flights."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedLimit:
    """Speed at which the probability of a failure reaches the risk."""

    low: float | None
    """[m/s] largest speed at which it is shown to be below the risk; `None` if there is none."""
    high: float | None
    """[m/s] least speed at which it is shown to be above; `None` if there is none."""
    best: float
    """[m/s] estimate; NaN without an end on each side."""
    trials: tuple[SpeedTrial, ...]
    """Flights at each speed, ascending."""

    @property
    def flights(self) -> int:
        """Number of all flights."""
        return sum(trial.flights for trial in self.trials)

    @property
    def often(self) -> float | None:
        """Least speed [m/s] at which a tenth of the flights fail; `None` without one."""
        return next((trial.speed for trial in self.trials if trial.probability >= _OFTEN), None)


@dataclass
class _Search:
    """Counts at each speed, and the fit to them."""

    fails: Callable[[float, int, int], int]
    """Number of failures at a speed [m/s] among flights from a number on, and their count."""
    risk: float
    """[-] accepted probability of a failure."""
    least: float
    """[m/s] least speed."""
    most: float
    """[m/s] largest speed."""
    progress: Callable[[str], None]
    """Receives a line after each batch."""
    counts: dict[float, tuple[int, int]] = field(default_factory=dict)
    """Flights and failures at each speed [m/s]."""
    tested: list[float] = field(default_factory=list)
    """Speeds [m/s] that were flown more than for the scouting, in this order."""

    @property
    def flown(self) -> int:
        """Number of all flights."""
        return sum(flown for flown, _ in self.counts.values())

    @property
    def trials(self) -> tuple[SpeedTrial, ...]:
        """All flights at each speed, ascending."""
        return tuple(SpeedTrial(speed=v, flights=n, probability=k / n) for v, (n, k) in sorted(self.counts.items()))

    @property
    def low(self) -> float | None:
        """Largest speed [m/s] at which the probability is shown to be below the risk."""
        return max((speed for speed in self.counts if self.shows(speed) is True), default=None)

    @property
    def high(self) -> float | None:
        """Least speed [m/s] at which it is shown to be above."""
        return min((speed for speed in self.counts if self.shows(speed) is False), default=None)

    def fly(self, speed: float, count: int) -> float:
        """Fly `count` further flights at a speed [m/s]; return the share [-] that failed of all there."""
        flown, failed = self.counts.get(speed, (0, 0))
        if flown + count > _SCOUTS and speed not in self.tested:
            self.tested.append(speed)
        failed += self.fails(speed, flown, count)
        self.counts[speed] = (flown + count, failed)
        self.progress(f"{speed:.1f} m/s: {failed} of {flown + count} flights fail")
        return failed / (flown + count)

    def scout(self) -> float:
        """Find two near speeds with few and with many failures, by halving; return the lower one [m/s].

        The ends are flown first.
        """
        low, high = self.least, self.most
        if self.fly(low, _SCOUTS) > 0.5:
            return low
        if self.fly(high, _SCOUTS) <= 0.5:
            return high
        while high > _NEAR * low:
            middle = math.sqrt(low * high)
            low, high = (low, middle) if self.fly(middle, _SCOUTS) > 0.5 else (middle, high)
        return low

    def shows(self, speed: float) -> bool | None:
        """Return whether the probability at a speed is shown to be below the risk, or `None` if neither is shown."""
        enough = self._enough(speed)
        below, above = self._others
        if self._evidence(speed, below) >= enough:
            return True
        return False if self._evidence(speed, above) >= enough else None

    @property
    def _others(self) -> tuple[list[float], list[float]]:
        """Probabilities [-] below and above the risk that stand for either side in a test."""
        above = [min(self.risk * each, 0.5 * (1.0 + self.risk)) for each in _OTHERS_ABOVE]
        return [self.risk / each for each in _OTHERS_BELOW], above

    def _enough(self, speed: float) -> float:
        """Return the evidence [-] that a statement at a speed takes."""
        if speed in self.tested:
            return _enough_of_test(1 + self.tested.index(speed))
        return _TESTS / (_OF_SCOUTS * (1.0 - CONFIDENCE))

    def _evidence(self, speed: float, others: Sequence[float]) -> float:
        """Return the mean likelihood ratio [-] of other probabilities to the risk, of all flights at a speed."""
        flown, failed = self.counts[speed]
        logs = [_log_ratio(flown, failed, other, self.risk) for other in others]
        return sum(math.exp(min(each, 500.0)) for each in logs) / len(logs)

    def _lacks(self, flown: int, failed: int, enough: float) -> float:
        """Return how many flights a test lacks if they go on to fail as those flown; infinite if it never ends."""
        aim, share = math.log(len(_OTHERS_BELOW) * enough), failed / max(flown, 1)
        growths = [_log_ratio(1.0, share, other, self.risk) for others in self._others for other in others]
        return min((aim / growth - flown for growth in growths if growth > 0.0), default=math.inf)

    def test(self, speed: float, most: int) -> bool | None:
        """Fly at a speed until it shows something, or `most` flights are flown in all; see `shows`.

        It is given up if it lacks more flights than are left. With no lower end yet, it is also if a test at a speed
        where nothing fails would end much sooner.
        """
        batch = _BATCH
        while True:
            self.fly(speed, batch)
            answer, left = self.shows(speed), float(most - self.flown)
            if answer is not None or left <= 0.0:
                return answer
            if self.low is None:
                left = min(left, _DEARER * self._lacks(0, 0, _enough_of_test(1 + len(self.tested))))
            is_seen = self.counts[speed][0] * self.risk > _SEEN
            if is_seen and self._lacks(*self.counts[speed], self._enough(speed)) > left:
                return None
            batch = min(2 * batch, _LARGEST)

    def guess(self, probability: float) -> float:
        """Return the speed [m/s] of a probability of failure by the fit to the counts.

        Far below the risk and far above it another distribution may rule: only the nearest such speeds count.
        """
        speeds = sorted(self.counts)
        share = [self.counts[speed][1] / self.counts[speed][0] for speed in speeds]
        many = next((i for i, each in enumerate(share) if each > max(0.3, 5.0 * self.risk)), len(speeds) - 1)
        logs = np.log(speeds[: many + 1])
        flown, failed = np.array([self.counts[speed] for speed in speeds[: many + 1]], dtype=float).T

        def misfit(x: Array) -> float:
            z = (logs - x[0]) * math.exp(-x[1])
            return -float(failed @ log_ndtr(z) + (flown - failed) @ log_ndtr(-z)) + 0.02 * (float(x[1]) + 2.0) ** 2

        failing = logs[failed > 0.5 * flown]
        start = float(failing.min() if len(failing) else logs.max())
        found = minimize(misfit, [start, -2.0], method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-4})
        speed = math.exp(found.x[0] + math.exp(found.x[1]) * float(norm.ppf(probability)))
        return min(max(speed, self.least), self.most)

    def choose(self, wider: float) -> float | None:
        """Return the next speed [m/s] to test, or `None` if both ends are shown and near, or no speed is left.

        The probability there is meant to be `wider` times `_BELOW` below the risk; once a speed is shown to be below,
        `wider` times `_ABOVE` above it.
        """
        low, high, tested = self.low, self.high or self.most, self.tested
        if low is None:
            speed = self.guess(self.risk / (wider * _BELOW))
            speed = min(speed, _LOWER * min(tested, default=math.inf))
            return None if self.high == self.least else max(speed, self.least)
        ends = sorted({low, high, *(each for each in tested if low < each < high)})
        if len(ends) == 1:
            return None
        before, after = max(pairwise(ends), key=lambda gap: gap[1] / gap[0])
        if after <= _CLOSE * before and self.high is not None:
            return None
        speed = self.guess(min(self.risk * wider * _ABOVE, 0.5 * (1.0 + self.risk)))
        return speed if before < speed < after else math.sqrt(before * after)


def _enough_of_test(number: int) -> float:
    """Return the evidence [-] that a statement takes at the speed tested as number 1, 2, ..."""
    return number * (number + 1) / ((1.0 - _OF_SCOUTS) * (1.0 - CONFIDENCE))


def _log_ratio(flown: float, failed: float, probability: float, risk: float) -> float:
    """Return the logarithm of the likelihood ratio of a probability [-] to the risk."""
    return failed * math.log(probability / risk) + (flown - failed) * math.log((1.0 - probability) / (1.0 - risk))


def scout_speed(fails: Callable[[float, int, int], int], *, least: float, most: float) -> float:
    """Return a speed [m/s] a little below that at which half of the flights fail; see `find_speed_limit`."""
    return _Search(fails, 0.5, least, most, lambda _text: None).scout()


def find_speed_limit(
    fails: Callable[[float, int, int], int],
    *,
    risk: float,
    least: float,
    most: float,
    most_flights: int = 30_000,
    progress: Callable[[str], None] = lambda _text: None,
) -> SpeedLimit:
    """Return the speed between `least` and `most` [m/s] at which the probability of a failure is `risk` [-].

    `fails(speed, first, count)` returns how many of the flights `first` to `first + count - 1` fail at a speed [m/s].
    Flights of other numbers must be independent; the same number at other speeds may share all its random numbers. The
    probability must grow with the speed. No test begins after `most_flights`.
    """
    search, wider = _Search(fails, risk, least, most, progress), 1.0
    search.scout()
    while search.flown < most_flights and len(search.counts) < _TESTS:
        speed = search.choose(wider)
        if speed is None or speed in search.tested:
            break
        wider *= _WIDER if search.test(speed, most_flights) is None else 1.0
    low, high = search.low, search.high
    best = math.nan if low is None or high is None else min(max(search.guess(risk), low), high)
    return SpeedLimit(low=low, high=high, best=best, trials=search.trials)


def find_rare_limit(
    fails: Callable[[float, int, int], int],
    estimate: Callable[[float], SpeedEstimate],
    *,
    risk: float,
    least: float,
    most: float,
    progress: Callable[[str], None] = lambda _text: None,
) -> SpeedLimit:
    """Return the speed between `least` and `most` [m/s] at which the probability of a failure is a `risk` below `RARE`.

    `fails` is as of `find_speed_limit`, and `estimate` returns the probability at a speed [m/s].
    """
    search, apart, known = _Search(fails, risk, least, most, progress), _ABOVE, dict[float, SpeedEstimate]()
    search.scout()
    for share in (0.1, 0.01):
        search.fly(search.guess(share), _LARGEST)
    tail = _Tail(risk, known, math.log(search.guess(0.5) / search.guess(norm.cdf(-1.0))))
    speed = search.guess(risk / apart)
    while len(known) < _ESTIMATES and speed not in known:
        known[speed] = estimate(speed)
        found = known[speed].probability
        progress(
            f"{speed:.2f} m/s: a flight fails with probability {found.value:.2g} ({found.low:.2g} to {found.high:.2g})"
        )
        apart *= 1.0 if found.high < risk or found.low > risk else _WIDER
        if tail.low is None or tail.high is None:
            speed = min(max(tail.speed(risk / apart if tail.low is None else risk * apart), least), most)
    estimates = [
        SpeedTrial(speed=v, flights=each.flights, probability=each.probability.value) for v, each in known.items()
    ]
    trials = sorted([*search.trials, *estimates], key=lambda trial: trial.speed)
    return SpeedLimit(low=tail.low, high=tail.high, best=tail.best, trials=tuple(trials))


@dataclass
class _Tail:
    """Estimates at some speeds; between them the speed's logarithm is linear in the probability's normal deviate."""

    risk: float
    """[-] accepted probability of a failure."""
    known: dict[float, SpeedEstimate]
    """Estimate at each speed [m/s]."""
    spread: float
    """[-] change of the logarithm with the deviate, where fewer than two speeds tell it."""

    @property
    def low(self) -> float | None:
        """Largest speed [m/s] at which the probability is shown to be below the risk."""
        return max((speed for speed, each in self.known.items() if each.probability.high < self.risk), default=None)

    @property
    def high(self) -> float | None:
        """Least speed [m/s] at which it is shown to be above."""
        return min((speed for speed, each in self.known.items() if each.probability.low > self.risk), default=None)

    @property
    def best(self) -> float:
        """Estimate [m/s] of the speed of the risk; NaN without an end on each side."""
        low, high = self.low, self.high
        return math.nan if low is None or high is None else min(max(self.speed(self.risk), low), high)

    def speed(self, probability: float) -> float:
        """Return the speed [m/s] of a probability, no further than `_STEP` from those known."""
        z = {speed: float(norm.ppf(max(each.probability.value, _NEVER))) for speed, each in self.known.items()}
        aim = float(norm.ppf(probability))
        nearest = sorted(z, key=lambda speed: abs(z[speed] - aim))[:2]
        spread = self.spread
        if len(nearest) == 2 and abs(z[nearest[0]] - z[nearest[1]]) > 0.1:
            spread = math.log(nearest[0] / nearest[1]) / (z[nearest[0]] - z[nearest[1]])
        speed = nearest[0] * math.exp(max(spread, 0.1 * self.spread) * (aim - z[nearest[0]]))
        return min(max(speed, min(z) / _STEP), max(z) * _STEP)
