"""Ranks by pairs, with confidence, and classes of operating points: who is as robust and as quiet, by measurement.

A flight's score is the logarithm of its error over the reference entry's in the same seed, within a factor of `CLIP`.
An entry's score is the mean over flights and cells, a cell being a scenario on a vehicle. Its exponential is shown, a
geometric mean of error ratios. Seeds are independent, so the means over cells of each seed give Student's interval.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from gustproof.studies.campaign.intervals import IntervalEstimate, mean
from gustproof.studies.league.course import WORST_DEG
from gustproof.types import Array

CLIP = 10.0
"""[-] largest ratio of errors that counts, either way: no single cell decides the league."""
TOLERANCE = 0.03
"""[-] share by which a measured figure may exceed a bound: the accuracy of the experiment."""
_FLOOR_DEG = 1e-9


class OperatingPoint(NamedTuple):
    """Robustness of an entry on a vehicle, and the torque slew that it takes; or bounds of these."""

    Ms: float
    """[-] largest sensitivity peak of the worst axis; infinite if none could be measured."""
    gain_margin: float
    """[-] least factor above 1 that destabilises."""
    delay_margin: float
    """[s] least additional delay that destabilises."""
    slew_share: float
    """[-] rms torque slew in the turbulence of the tuning, over `default_slew` of the vehicle."""
    refused: str = ""
    """Reason why it could not be measured; empty if it was."""

    @classmethod
    def parse(cls, result: dict[str, Any], default_slew: float) -> Self:
        """Return the point in the JSON values of a measurement."""
        if "refused" in result:
            return cls(math.inf, 1.0, 0.0, math.inf, result["refused"])
        gain, delay = (math.inf if result[key] is None else result[key] for key in ("gain_margin", "delay_margin_s"))
        return cls(result["Ms"], gain, delay, result["slew"] / default_slew)

    def keeps(self, bounds: "OperatingPoint") -> bool:
        """Return whether the point is within bounds and `TOLERANCE`."""
        above, below = 1.0 + TOLERANCE, 1.0 - TOLERANCE
        return (
            self.Ms <= above * bounds.Ms
            and self.gain_margin >= below * bounds.gain_margin
            and self.delay_margin >= below * bounds.delay_margin
            and self.slew_share <= above * bounds.slew_share
        )


CLASSES = {
    "robust": OperatingPoint(1.4, 3.0, 0.012, 1.1),
    "usual": OperatingPoint(1.7, 2.3, 0.008, 1.7),
    "sharp": OperatingPoint(2.0, 1.9, 0.004, 3.0),
    "open": OperatingPoint(math.inf, 0.0, 0.0, math.inf),
}
"""Bounds of each class on every vehicle, from the most robust; the last has none."""


def classify(points: Sequence[OperatingPoint]) -> str:
    """Return the first class whose bounds are kept on all vehicles."""
    return next(name for name, bounds in CLASSES.items() if all(point.keeps(bounds) for point in points))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Standings:
    """Scores of n entries over m cells."""

    ratios: tuple[IntervalEstimate, ...]
    """(n,) [-] error over the reference's, geometric mean."""
    cells: Array
    """(n, m) [-] error over the reference's in each cell, geometric mean of its flights."""
    pairs: tuple[tuple[IntervalEstimate, ...], ...]
    """(n, n) [-] error of the row's entry over the column's."""

    def ranks(self, members: Sequence[int]) -> list[int]:
        """Return 1 plus the number of better members for each: those who can't be distinguished share a rank."""
        return [1 + sum(self.pairs[i][j].low > 1.0 for j in members if j != i) for i in members]


def log_ratios(errors_deg: Array, reference_deg: Array) -> Array:
    """Return the scores of flights (entries, cells, runs) from errors [deg], NaN for failed ones.

    `reference_deg` (cells, runs) holds the reference entry's errors.
    """
    counted, unit = (
        np.clip(np.where(np.isfinite(each), each, WORST_DEG), _FLOOR_DEG, WORST_DEG)
        for each in (errors_deg, reference_deg)
    )
    return np.asarray(np.clip(np.log(counted / unit), -math.log(CLIP), math.log(CLIP)))


def compute_standings(scores: Array) -> Standings:
    """Return the standings from the scores (entries, cells, runs) of all flights."""
    by_seed = scores.mean(axis=1)
    return Standings(
        ratios=tuple(map(_estimate, by_seed)),
        cells=np.exp(scores.mean(axis=2)),
        pairs=tuple(tuple(_estimate(one - other) for other in by_seed) for one in by_seed),
    )


def _estimate(logarithms: Array) -> IntervalEstimate:
    """Return the geometric mean of ratios from their logarithms (runs,), which are paired by seed."""
    return IntervalEstimate(*np.exp(mean(logarithms)).tolist())
