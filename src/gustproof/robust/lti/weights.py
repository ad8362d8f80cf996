"""Weights of a design: constants and first-order shapes."""

import math
from collections.abc import Sequence

import numpy as np

from gustproof.robust.lti.state_space import Lti, Matrix


def constant_weight(values: Sequence[float]) -> Lti:
    """Return a diagonal weight independent of frequency, one value an axis."""
    return _diagonal_weight([(0.0, 0.0, 0.0, value) for value in values])


def first_order_weight(low: Sequence[float], corner: float, high: Sequence[float]) -> Lti:
    """Return a diagonal weight with gain `low` at low and `high` at high frequency, one pole and state an axis.

    `W(s) = (high s + low corner) / (s + corner)`. At `corner` [rad/s] the squared gain is the mean of the two squares.
    An axis with equal gains has no state.

    Raises
    ------
    ValueError
        If `corner` is not positive.
    """
    if not (math.isfinite(corner) and corner > 0.0):
        raise ValueError(f"corner is {corner!r}, must be positive")
    # low - high is split evenly between input and output: neither is badly scaled
    rows = []
    for a, b in zip(low, high, strict=True):
        share = math.sqrt(corner * abs(a - b))
        rows.append((-corner if a != b else 0.0, share, math.copysign(share, a - b), b))
    return _diagonal_weight(rows)


def _diagonal_weight(rows: Sequence[tuple[float, float, float, float]]) -> Lti:
    """Return the diagonal of systems (a, b, c, d); those with a = 0 have no state."""
    dynamic = [k for k, row in enumerate(rows) if row[0] != 0.0]
    a, b, c, d = (np.diag(np.array(column, dtype=np.float64)) for column in zip(*rows, strict=True))
    A: Matrix = a[np.ix_(dynamic, dynamic)]
    return Lti(A=A, B=b[dynamic], C=c[:, dynamic], D=d)
