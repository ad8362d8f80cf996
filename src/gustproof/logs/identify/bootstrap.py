"""Confidence intervals of a fit: a block bootstrap in its one-step form."""

from collections.abc import Callable

import numpy as np
from scipy import stats

from gustproof.logs.identify.identification import Interval
from gustproof.logs.identify.likelihood import DAMPING, Fit, places, solve_scaled
from gustproof.types import Array

_REPLICATES = 1000
_BLOCK = 1.0  # [s] prediction errors are nearly white: it is longer than what correlation is left
_SEED = 16
_MISFIT = 1.4  # spread of real errors by that of the bootstrap: disturbances are not of the model's shape


def bootstrap(fit: Fit) -> Array:
    """Return replicates (r, p) of a fit's parameters.

    Blocks of the flight are drawn with replacement; each draw moves the maximum by one Newton step, the sum of the
    drawn scores times the inverse information. Blocks make the spread right also where the disturbance has another
    shape than the model's. Scores at a maximum are smaller than at the truth, by the share of parameters in blocks.
    Replicates are spread by that, and by the quantile of Student's t for the rest. A disturbance of another shape
    leaves a bias too: for it they are spread by .4 more, as `trial` measures. A damping that ends at 0 has replicates
    about the maximum without that bound, by the same step: an estimate at a bound is not known exactly.

    References
    ----------
    H. R. Kuensch, The Jackknife and the Bootstrap for General Stationary Observations, Annals of Statistics, 1989.
    P. Kline, A. Santos, A Score Based Approach to Wild Bootstrap Inference, J. of Econometric Methods, 2012.
    """
    scores, information = _block_scores(fit), fit.information()
    weights = np.random.default_rng(_SEED).multinomial(
        len(scores), np.full(len(scores), 1.0 / len(scores)), _REPLICATES
    )
    rest = max(len(scores) - max(data.size for data in fit.axes), 1)
    spread = _MISFIT * np.sqrt(len(scores) / rest) * stats.t.ppf(0.975, rest) / stats.norm.ppf(0.975)

    def move(free: Array) -> tuple[Array, Array]:
        """Return the step to the maximum (p,) and replicates about it (r, p) of `free` parameters."""
        solved = solve_scaled(information[np.ix_(free, free)], scores[:, free].T).T
        step, around = np.zeros(len(free)), np.zeros((_REPLICATES, len(free)))
        step[free], around[:, free] = solved.sum(axis=0), spread * ((weights - 1.0) @ solved)
        return step, around

    replicates = fit.theta + move(fit.free)[1]
    if ended := [at[DAMPING] for at in places(fit.axes) if not fit.free[at[DAMPING]] and fit.theta[at[DAMPING]] == 0.0]:
        loosened = fit.free.copy()
        loosened[ended] = True
        step, around = move(loosened)
        replicates[:, ended] = step[ended] + around[:, ended]
    return replicates


def _block_scores(fit: Fit) -> Array:
    """Return the sums (b, p) of the scores over each block, about their mean."""
    begin = min(data.time[0] for data in fit.axes)
    numbers = [np.floor((data.time - begin) / _BLOCK).astype(int) for data in fit.axes]
    scores = np.zeros((max(n[-1] for n in numbers) + 1, len(fit.theta)))
    for at, number, linear in zip(places(fit.axes), numbers, fit.linear, strict=True):
        sums = np.zeros((len(scores), len(at)))
        np.add.at(sums, number, linear.scores)
        scores[:, at] += sums
    return scores[np.any(scores != 0.0, axis=1)]


def interval(nominal: Array, replicates: Array, function: Callable[[Array], Array]) -> Interval:
    """Return the interval of a `function` of the parameters (..., p)."""
    low, high = np.quantile(function(replicates), [0.025, 0.975])
    value = float(function(nominal))
    return Interval(min(float(low), value), value, max(float(high), value))


def widen(given: Interval, floor: float) -> Interval:
    """Return an interval that also has an error of `floor`, independent of the others."""
    low, nominal, high = given
    return Interval(nominal - np.hypot(nominal - low, floor), nominal, nominal + np.hypot(high - nominal, floor))
