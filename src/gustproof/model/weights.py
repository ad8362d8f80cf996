"""Weights of a design: constants, first-order shapes, and what they stand for."""

import math
from collections.abc import Sequence

import numpy as np

from gustproof.lti.state_space import Lti, Matrix


def constant_weight(values: Sequence[float]) -> Lti:
    """Return a diagonal weight that is the same at all frequencies, one value an axis."""
    return _diagonal_weight([(0.0, 0.0, 0.0, value) for value in values])


def first_order_weight(low: Sequence[float], corner: float, high: Sequence[float]) -> Lti:
    """Return a diagonal weight that goes from gain `low` to gain `high` through one pole, one state an axis.

    `W(s) = (high s + low corner) / (s + corner)`: at `corner` [rad/s] the squared gain is the mean of the squares.
    An axis whose gains are equal has no state.

    Raises
    ------
    ValueError
        If `corner` is not positive.
    """
    if not (math.isfinite(corner) and corner > 0.0):
        raise ValueError(f"corner is {corner!r}, must be positive")
    # the step low - high is split evenly between input and output, so that neither is badly scaled
    rows = [
        (
            -corner if a != b else 0.0,
            math.sqrt(corner * abs(a - b)),
            math.copysign(math.sqrt(corner * abs(a - b)), a - b),
            b,
        )
        for a, b in zip(low, high, strict=True)
    ]
    return _diagonal_weight(rows)


def _diagonal_weight(rows: Sequence[tuple[float, float, float, float]]) -> Lti:
    """Return the diagonal of systems (a, b, c, d), without the state of those with a = 0."""
    dynamic = [k for k, row in enumerate(rows) if row[0] != 0.0]
    a, b, c, d = (np.diag(np.array(column, dtype=np.float64)) for column in zip(*rows, strict=True))
    picked: Matrix = a[np.ix_(dynamic, dynamic)]
    return Lti(A=picked, B=b[dynamic], C=c[:, dynamic], D=d)
