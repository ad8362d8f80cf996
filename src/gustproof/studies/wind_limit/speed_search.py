"""Search the wind speed at which the probability of a failure reaches a stated risk, by sequential tests.

A test at one speed ends when either of two statements is shown: the probability is below the risk, or above it. Each is
a mean of likelihood ratios of a Bernoulli process, a nonnegative supermartingale if the statement is false. So it may
be read after each batch, and is wrong at most with its share of the whole error (Ville's inequality). Speeds are chosen
by a normal distribution of the logarithm of the speed at which a flight fails. A bad choice costs flights, not truth.

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

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr
from scipy.stats import norm

from gustproof.types import Array

CONFIDENCE = 0.95
"""[-] probability that the interval of a limit holds it."""
_TESTS = 20
"""Speeds at which a statement may be made, those of the scouting among them; each has an equal share of the error."""
_APART = 3.0  # [-] of the risk, by which the probability at a tested speed is meant to be below or above it
_ALTERNATIVES = (1.5, 3.0)  # [-] of the risk, the probabilities that a test has beside it
_WIDER = 1.7  # [-] on this, after a test that shows neither
_SCOUTS, _BATCH, _LARGEST = 64, 256, 2048  # flights at each speed of a scouting; of the first and the largest batch
_NEAR = 1.12  # [-] ratio of speeds at which scouting ends
_LOWER = 0.85  # [-] of the least speed that was tested, where the fit leads no further
_CLOSE = 1.05  # [-] ratio of the ends at which the search ends
_VAIN, _LEVEL = 8.0, 1.35  # expected failures that end a test whose share is within this factor of the risk


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedTrial:
    """All flights at one speed."""

    speed: float
    """[m/s]."""
    flights: int
    """Number of flights."""
    failures: int
    """Number that failed."""


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

    @property
    def flown(self) -> int:
        """Number of all flights."""
        return sum(flown for flown, _ in self.counts.values())

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
        enough = _TESTS / (1.0 - CONFIDENCE)
        if self._evidence(speed, [self.risk / each for each in _ALTERNATIVES]) >= enough:
            return True
        above = [min(self.risk * each, 0.5 * (1.0 + self.risk)) for each in _ALTERNATIVES]
        return False if self._evidence(speed, above) >= enough else None

    def _evidence(self, speed: float, others: Sequence[float]) -> float:
        """Return the mean likelihood ratio [-] of other probabilities to the risk, of all flights at a speed."""
        flown, failed = self.counts[speed]
        logs = [
            failed * math.log(other / self.risk) + (flown - failed) * math.log((1.0 - other) / (1.0 - self.risk))
            for other in others
        ]
        return sum(math.exp(min(each, 500.0)) for each in logs) / len(logs)

    def test(self, speed: float, most: int) -> bool | None:
        """Fly at a speed until it shows something, seems in vain, or `most` flights are flown in all; see `shows`."""
        batch = _BATCH
        while True:
            share = self.fly(speed, batch)
            answer, flown = self.shows(speed), self.counts[speed][0]
            in_vain = flown * self.risk > _VAIN and 1.0 / _LEVEL < share / self.risk < _LEVEL
            if answer is not None or in_vain or self.flown >= most:
                return answer
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

    def choose(self, apart: float) -> float | None:
        """Return the next speed [m/s] to test, or `None` if both ends are shown and near, or no speed is left.

        The probability there is meant to be `apart` times below the risk, or above it once a speed below is shown.
        """
        low, high, tested = self.low, self.high or self.most, self.tested
        if low is None:
            speed = self.guess(self.risk / apart)
            speed = min(speed, _LOWER * min(tested, default=math.inf))
            return None if self.high == self.least else max(speed, self.least)
        ends = sorted({low, high, *(each for each in tested if low < each < high)})
        if len(ends) == 1:
            return None
        before, after = max(pairwise(ends), key=lambda gap: gap[1] / gap[0])
        if after <= _CLOSE * before and self.high is not None:
            return None
        speed = self.guess(min(self.risk * apart, 0.5 * (1.0 + self.risk)))
        return speed if before < speed < after else math.sqrt(before * after)

    @property
    def tested(self) -> set[float]:
        """Speeds [m/s] that were flown more than for the scouting."""
        return {speed for speed, (flown, _) in self.counts.items() if flown > _SCOUTS}


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
    search, apart = _Search(fails, risk, least, most, progress), _APART
    search.scout()
    while search.flown < most_flights and len(search.counts) < _TESTS:
        speed = search.choose(apart)
        if speed is None or speed in search.tested:
            break
        apart *= _WIDER if search.test(speed, most_flights) is None else 1.0
    low, high = search.low, search.high
    trials = [SpeedTrial(speed=v, flights=n, failures=k) for v, (n, k) in sorted(search.counts.items())]
    best = math.nan if low is None or high is None else min(max(search.guess(risk), low), high)
    return SpeedLimit(low=low, high=high, best=best, trials=tuple(trials))
