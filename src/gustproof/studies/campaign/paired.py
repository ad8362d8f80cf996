"""Ratio of two errors in the same flights, with an interval that holds at any time, so that a test may stop by itself.

The logarithm of the ratio is taken as normal over the seeds, with unknown mean and spread. Its t statistic against a
mean m has a likelihood ratio over a normal prior of the effect, in units of the spread. That is an e-process whatever
the spread is. So the means m at which it stays below 1 / error form an interval that holds at all times at once.

References
----------
T. L. Lai, On confidence sequences, Annals of Statistics 4, 1976.
M. F. Perez-Ortiz, T. Lardy, R. de Heide, P. Grunwald, E-statistics, group invariance and anytime-valid testing, Annals
of Statistics 52, 2024.
"""

import math
from collections.abc import Sequence
from enum import Enum

import numpy as np

from gustproof.studies.campaign.intervals import IntervalEstimate
from gustproof.types import Array

ERROR = 0.01
"""[-] probability that the interval ever leaves out the true ratio."""
SMALL = 0.01
"""[-] difference that is called none."""
_PRIOR = 10.0  # variance of the effect over that of a pair
_LEAST_SPREAD = 1e-9  # of logarithms: equal flights are equal


class Change(Enum):
    """Verdict on an error beside another."""

    BETTER = "better"
    """It is less."""
    WORSE = "worse"
    """It is larger."""
    ALIKE = "alike"
    """It differs by less than `SMALL`."""
    OPEN = "undecided"
    """More flights are needed."""


def error_ratio(errors: Sequence[float], others: Sequence[float]) -> IntervalEstimate:
    """Return errors over those of `others` in the same flights, their geometric mean, with its interval.

    The interval holds at any time. Before it can tell, the interval is 0 to infinite.
    """
    middle, low, high = mean_change(np.log(np.divide(errors, others)))
    return IntervalEstimate(math.exp(middle), math.exp(low), math.exp(high))


def mean_change(changes: Array) -> IntervalEstimate:
    """Return the mean of changes (n,) in the same flights, with its interval, which holds at any time."""
    n, middle = len(changes), float(np.mean(changes))
    if n < 2:
        return IntervalEstimate(middle, -math.inf, math.inf)
    growth = 1.0 + n * _PRIOR
    bound = (math.sqrt(growth) / ERROR) ** (2.0 / n)
    if bound >= growth:
        return IntervalEstimate(middle, -math.inf, math.inf)
    t = math.sqrt((n - 1) * (bound - 1.0) / (1.0 - bound / growth))
    half = t * max(float(np.std(changes, ddof=1)), _LEAST_SPREAD) / math.sqrt(n)
    return IntervalEstimate(middle, middle - half, middle + half)


def find_change(ratio: IntervalEstimate) -> Change:
    """Return the verdict on a ratio of errors."""
    if ratio.low > 1.0 - SMALL and ratio.high < 1.0 + SMALL:
        return Change.ALIKE
    if ratio.high < 1.0:
        return Change.BETTER
    return Change.WORSE if ratio.low > 1.0 else Change.OPEN
