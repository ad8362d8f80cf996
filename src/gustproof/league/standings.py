"""Standings: scores relative to a reference entrant, with intervals, and ranks by pairs.

A flight's score is the logarithm of its error over the reference entrant's in the same seed, within a factor of
`CLIP`. A cell is a scenario on a vehicle: the mean over its flights. An entrant's score is the mean over cells. Its
exponential is shown, a geometric mean of error ratios. Intervals are those of a bootstrap over seeds: in each cell the
flights are drawn anew, the same ones for all entrants.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gustproof.campaign.intervals import CONFIDENCE, IntervalEstimate
from gustproof.league.course import WORST_DEG
from gustproof.types import Array

CLIP = 10.0
"""[-] largest ratio of errors that counts, either way: no single cell decides the league."""
DRAWS = 2000
"""Number of bootstrap draws."""
_FLOOR_DEG = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Standings:
    """Scores of n entrants over m cells."""

    ratios: tuple[IntervalEstimate, ...]
    """(n,) [-] error over the reference's, geometric mean."""
    cells: Array
    """(n, m) [-] error over the reference's in each cell, geometric mean of its flights."""
    pairs: tuple[tuple[IntervalEstimate, ...], ...]
    """(n, n) [-] error of the row's entrant over the column's."""
    cell_best: NDArray[np.intp]
    """(m,) number of the entrant with the least error."""
    ranks: tuple[int, ...]
    """(n,) 1 plus the number of entrants that are better with confidence: those who can't be told apart share."""

    def rank_within(self, members: list[int]) -> list[int]:
        """Return the ranks of some entrants among themselves."""
        return [1 + sum(self.pairs[i][j].low > 1.0 for j in members if j != i) for i in members]


def log_ratios(errors_deg: Array, reference_deg: Array) -> Array:
    """Return the scores of flights (entrants, cells, runs) from errors [deg], NaN for failed ones.

    `reference_deg` (cells, runs) holds the reference entrant's errors.
    """
    counted = np.clip(np.where(np.isfinite(errors_deg), errors_deg, WORST_DEG), _FLOOR_DEG, WORST_DEG)
    unit = np.clip(np.where(np.isfinite(reference_deg), reference_deg, WORST_DEG), _FLOOR_DEG, WORST_DEG)
    return np.asarray(np.clip(np.log(counted / unit), -math.log(CLIP), math.log(CLIP)))


def compute_standings(scores: Array) -> Standings:
    """Return the standings from the scores (entrants, cells, runs) of all flights."""
    entrants, _, runs = scores.shape
    means = scores.mean(axis=2)
    total = means.mean(axis=1)
    drawn = _draw_totals(scores)
    pairs = tuple(
        tuple(_estimate(total[i] - total[j], drawn[:, i] - drawn[:, j], runs) for j in range(entrants))
        for i in range(entrants)
    )
    better = [sum(pair.low > 1.0 for pair in row) for row in pairs]
    return Standings(
        ratios=tuple(_estimate(total[i], drawn[:, i], runs) for i in range(entrants)),
        cells=np.exp(means),
        pairs=pairs,
        cell_best=np.argmin(means, axis=0),
        ranks=tuple(1 + each for each in better),
    )


def _draw_totals(scores: Array) -> Array:
    """Return the entrants' mean scores (draws, entrants) in each bootstrap draw."""
    entrants, cells, runs = scores.shape
    generator = np.random.default_rng(0)  # the same league has the same intervals
    totals: Array = np.zeros((DRAWS, entrants))
    for cell in range(cells):
        weights = generator.multinomial(runs, np.full(runs, 1.0 / runs), size=DRAWS) / runs
        totals += weights @ scores[:, cell].T
    return np.asarray(totals / cells)


def _estimate(value: float, drawn: Array, runs: int) -> IntervalEstimate:
    """Return the exponential of a mean, and of its interval from bootstrap draws (draws,).

    Draws of n flights scatter by a factor sqrt((n - 1) / n) too little, which is made good. One flight bounds nothing.
    """
    if runs < 2:
        return IntervalEstimate(math.exp(value), 0.0, math.inf)
    wider = math.sqrt(runs / (runs - 1.0))
    low, high = np.quantile(drawn - value, [(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0]) * wider
    return IntervalEstimate(math.exp(value), math.exp(value + low), math.exp(value + high))
