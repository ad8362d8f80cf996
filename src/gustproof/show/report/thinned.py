"""Long curves with fewer samples: no peak is lost."""

import numpy as np

from gustproof.types import Array

MAX_SAMPLES = 20_000
"""Samples of a curve that are drawn unchanged; a longer curve is reduced to the extremes of each section."""


def decimate(time: Array, values: Array, most: int = MAX_SAMPLES) -> tuple[Array, Array]:
    """Return a curve of at most `most` samples: the lowest and the highest of each section, in order.

    No peak is lost, and the times are those of the kept samples.
    """
    n = len(time)
    if n <= most:
        return time, values
    edges = np.linspace(0, n, most // 2 + 1).astype(np.int64)
    starts, lasts = edges[:-1, None], edges[1:, None] - 1
    # Sections differ in length by one at most: shorter ones repeat their last sample, which is then found first.
    places = np.minimum(starts + np.arange(np.max(lasts - starts) + 1), lasts)
    parts = values[places]
    absent = np.isnan(parts)
    lowest = np.argmin(np.where(absent, np.inf, parts), axis=1)
    highest = np.argmax(np.where(absent, -np.inf, parts), axis=1)
    kept = np.unique(starts[:, 0] + (lowest, highest))
    return time[kept], values[kept]
