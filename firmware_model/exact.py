"""Set-up of a flight in exact arithmetic, rounded once, so that it has the same bits on every machine.

BLAS, LAPACK and the C library choose their code by processor; the order of sums and the last bit change with it.
"""

from collections.abc import Iterable, Sequence
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Number = TypeVar("Number", int, Fraction)
Rows = Sequence[Sequence[Fraction]]
DIGITS = 100
"""Decimal digits to compute with: six times those of a double, so that much may cancel."""
_ASKED_AGAIN = lru_cache(maxsize=256)  # by each flight of a campaign: a function takes .1 ms


@_ASKED_AGAIN
def exp(x: float) -> float:
    """Return the exponential of `x`, rounded from 100 digits."""
    with localcontext(prec=DIGITS):
        return float(Decimal(x).exp())


@_ASKED_AGAIN
def power(x: float, exponent: float) -> float:
    """Return `x` > 0 to the power of `exponent`, rounded from 100 digits."""
    with localcontext(prec=DIGITS):
        return float(Decimal(x) ** Decimal(exponent))


@_ASKED_AGAIN
def sin_cos(x: float) -> tuple[float, float]:
    """Return sine and cosine of `x` [rad], within some turns, rounded from 100 digits less those of its size."""
    with localcontext(prec=DIGITS):
        angle, term, order = Decimal(x), Decimal(1), 0
        sums = [Decimal(0), Decimal(0)]
        while abs(term) > Decimal(10) ** -DIGITS:
            sums[order % 2] += term if order % 4 < 2 else -term
            order += 1
            term *= angle / order
        cosine, sine = sums
        return float(sine), float(cosine)


def tangent(x: float) -> float:
    """Return the tangent of `x` [rad]."""
    sine, cosine = sin_cos(x)
    return sine / cosine


def multiply(A: Iterable[Iterable[float]], B: Iterable[Iterable[float]]) -> Array:
    """Return the product of two matrices, each entry rounded once.

    Doubles are integers over a power of two; over one for all, sums of products take a tenth of the time of fractions.
    """
    (rows, over), (others, under) = _integers(A), _integers(B)
    return np.array([[entry / (over * under) for entry in row] for row in _product(rows, others)])


def right_inverse(A: Iterable[Iterable[float]]) -> Array:
    """Return `A^T (A A^T)^-1` (n, m) of a matrix (m, n) of full row rank, each entry rounded once.

    It is the inverse of a square matrix, else the pseudo-inverse. It takes some m^3 products of fractions.

    Raises
    ------
    ZeroDivisionError
        If the rows are linearly dependent.
    """
    rows = _fractions(A)
    across = list(zip(*rows, strict=True))
    return _round(_product(across, _inverse(_product(rows, across))))


def _integers(matrix: Iterable[Iterable[float]]) -> tuple[list[list[int]], int]:
    """Return integers, and the power of two that they are over."""
    ratios = [[number.as_integer_ratio() for number in row] for row in matrix]
    over = max((below for row in ratios for _, below in row), default=1)
    return [[number * (over // below) for number, below in row] for row in ratios], over


def _fractions(matrix: Iterable[Iterable[float]]) -> list[list[Fraction]]:
    return [[Fraction(number) for number in row] for row in matrix]


def _product(A: Sequence[Sequence[Number]], B: Sequence[Sequence[Number]]) -> list[list[Number]]:
    columns = list(zip(*B, strict=True))
    return [[sum((a * b for a, b in zip(row, column, strict=True)), type(row[0])()) for column in columns] for row in A]


def _inverse(A: Rows) -> list[list[Fraction]]:
    """Return the inverse of a positive definite matrix, whose pivots are never 0."""
    n = len(A)
    rows = [[*row, *(Fraction(i == j) for j in range(n))] for i, row in enumerate(A)]
    for k in range(n):
        pivot = rows[k][k]
        rows[k] = [entry / pivot for entry in rows[k]]
        for i in range(n):
            if i != k:
                factor = rows[i][k]
                rows[i] = [entry - factor * top for entry, top in zip(rows[i], rows[k], strict=True)]
    return [row[n:] for row in rows]


def _round(matrix: Rows) -> Array:
    return np.array([[float(entry) for entry in row] for row in matrix])
