"""Find the stamps of a log that are right: a wrong one, or a block of them, decides nothing about the others."""

from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

from gustproof.types import Array

PAUSE_US = 600e6
"""[us] longest pause within one flight; beyond it the clock was set anew, or another flight begins."""
_SUSPICIOUS_US = 1e6  # step beyond which the last stamps of a log may be wrong, though they rise
_BREAK, _PAUSING = 3.0, 30.0  # times the usual step that end a run, and that are no part of the usual step
_OFTEN, _SPREAD = 0.9, 1.5  # the quantile of steps within a run, where stamps come in bursts, and its share
_FEW = 8.0  # samples that one unexplained step costs, or that may overlap
_LOOK_BACK = 256  # runs of wrong stamps in a row that are passed over
_MOST_RUNS = 50_000


def find_chain(time_us: Array) -> NDArray[np.bool_]:
    """Return which of the stamps (n,) [us], in the order of the file, are on its longest consistent chain.

    The stamps are cut into runs that rise evenly. Of all rows of runs, the one with most samples is chosen, less what
    its steps leave unexplained. A step is explained if the samples passed over would have filled it. So a block of
    wrong stamps is passed over, a gap of the log stays, and a clock that was set back ends the chain. Of the chosen
    stamps the most that rise are kept.
    """
    finite = np.flatnonzero(np.isfinite(time_us))
    chosen, time = np.zeros(len(time_us), dtype=np.bool_), time_us[finite]
    steps = np.diff(time)
    if np.any((steps <= 0.0) | (steps > _SUSPICIOUS_US)):
        finite = finite[_choose_runs(time, steps)]
        finite = finite[_most_rising(time_us[finite])]
    chosen[finite] = True
    return chosen


def usual_step(time_us: Array) -> float:
    """Return the mean step [us] between stamps (n,) without gaps and wrong ones; infinite if none rise."""
    rising = np.diff(time_us)
    rising = rising[rising > 0.0]
    if len(rising) == 0:
        return np.inf
    return float(np.mean(rising[rising <= _PAUSING * np.median(rising)]))


def _choose_runs(time: Array, steps: Array) -> NDArray[np.int64]:
    """Return the places of the samples in the best row of runs."""
    usual = usual_step(time)
    if not np.isfinite(usual):
        return np.arange(len(time))
    most = max(_BREAK * usual, _SPREAD * np.quantile(steps[steps > 0.0], _OFTEN))
    begins = np.concatenate(([0], np.flatnonzero((steps < 0.0) | (steps > most)) + 1))
    if len(begins) > _MOST_RUNS:
        return np.arange(len(time))
    ends = np.append(begins[1:], len(time)) - 1
    count = (ends - begins + 1).astype(np.float64)
    best, before = count.copy(), np.full(len(begins), -1)
    leader = 0  # the best row that is further back
    for run in range(1, len(begins)):
        near = np.arange(max(0, run - _LOOK_BACK), run)
        if near[0] > 0:
            leader = near[0] - 1 if best[near[0] - 1] > best[leader] else leader
            near = np.append(near, leader)
        gap = time[begins[run]] - time[ends[near]]
        unexplained = np.abs(gap / usual - (begins[run] - ends[near]))
        cost = np.minimum(unexplained, _FEW + 0.5 * np.minimum(count[near], count[run]))
        cost[(gap > PAUSE_US) | (gap < -_FEW * usual)] = np.inf
        total = best[near] - cost
        which = int(np.argmax(total))
        if total[which] > 0.0:
            best[run] += total[which]
            before[run] = near[which]
    chain, run = list[NDArray[np.int64]](), int(np.argmax(best))
    while run >= 0:
        chain.append(np.arange(begins[run], ends[run] + 1))
        run = int(before[run])
    return np.concatenate(chain[::-1])


def _most_rising(time: Array) -> NDArray[np.int64]:
    """Return the indices of the longest rising subsequence of stamps, by patience sorting."""
    if np.all(np.diff(time) > 0.0):
        return np.arange(len(time))
    tops, places, below = list[float](), list[int](), list[int]()
    for place, stamp in enumerate(time.tolist()):
        pile = bisect_left(tops, stamp)
        below.append(places[pile - 1] if pile else -1)
        tops[pile : pile + 1], places[pile : pile + 1] = [stamp], [place]
    found, place = list[int](), places[-1]
    while place >= 0:
        found.append(place)
        place = below[place]
    return np.array(found[::-1], dtype=np.int64)
