"""Gain by the set-points alone: an instrument, which shows whether a fit took a disturbance for the vehicle.

In closed loop the command answers the disturbance. A fit is right there if its disturbance has the right shape. If it
has, past set-points tell nothing of its prediction errors, even where set-points answer the flight. If they do, their
part of the command gives the gain whatever the disturbance is like.
"""

from typing import NamedTuple

import numpy as np

from gustproof.logs.identify.likelihood import GAINS, AxisData
from gustproof.logs.read.flight_log import LogSignal
from gustproof.types import Array

_LATE = np.geomspace(0.02, 1.0, 10) - 0.02  # [s] by which set-points are taken late
_FOLD, _BLOCK = 5.0, 1.0  # [s] of parts that are predicted from the others, and of those that the spread is from


class ByReference(NamedTuple):
    """Gain by the set-points over that of a fit."""

    scale: float
    """[-] 1 if both are alike."""
    deviation: float
    """[-] standard error of it."""
    surprise: float
    """[-] standard errors by which set-points tell of the prediction errors; a weak instrument's is small."""


def gain_by_reference(data: AxisData, theta: Array, reference: LogSignal) -> ByReference:
    """Return the gain by the `reference` (n, 3) [rad] of attitude over that of the fit `theta`.

    Its late samples, behind the fit's predictor, predict the command's part of the rate. Parts of the flight take that
    from the other parts: a weak instrument is then no mix with the fit itself.

    References
    ----------
    L. Ljung, System Identification, 1999, 7.6 and 16.6.
    J. D. Angrist, G. W. Imbens, A. B. Krueger, Jackknife Instrumental Variables Estimation, J. of Applied Econometrics,
    1999.
    """
    values, time, gains = np.unwrap(reference.values[:, data.axis]), data.time, theta[GAINS:]
    late = np.column_stack([np.interp(time - each, reference.time, values) for each in _LATE])
    errors, variance = data.predict_signals(theta, np.column_stack([data.rate, data.response(theta), late]))
    errors = errors / np.sqrt(variance)[:, None]
    count = len(gains)
    caused, told = errors[:, 1:count] @ gains[:-1], errors[:, 1 + count :]
    left = errors[:, 0] - gains[-1] * errors[:, count] - caused
    told = told - told.mean(axis=0)
    predicted, odd = np.empty(len(time)), np.floor((time - time[0]) / _FOLD) % 2.0 == 1.0
    for inside in (odd, ~odd):
        predicted[inside] = told[inside] @ np.linalg.lstsq(told[~inside], caused[~inside], rcond=None)[0]
    block = np.unique(np.floor((time - time[0]) / _BLOCK), return_inverse=True)[1]
    found, reach = (np.bincount(block, predicted * each) for each in (left, caused))
    tiny = np.finfo(float).tiny
    off, whole = float(found.sum() / max(abs(reach.sum()), tiny)), float(max(abs(reach.sum()), tiny))
    deviation = float(np.sqrt(np.sum((found - off * reach) ** 2))) / whole
    return ByReference(1.0 + off, deviation, float(abs(found.sum()) / max(np.sqrt(np.sum(found**2)), tiny)))
