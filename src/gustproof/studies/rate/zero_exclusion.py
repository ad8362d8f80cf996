"""Stability of an axis for every constant inertia and lag in a box, and at every frequency: branch and bound.

The polynomial of `AxisLoop` depends continuously on its parameters and keeps its degree. If it has no root on the unit
circle for any member of a connected family and one member is stable, all members are (zero exclusion; B. R. Barmish,
New Tools for Robustness of Linear Systems, 1994, chapter 7). Cells of frequency and lag are halved until each is proved
to exclude zero for all inertias. Discs enclose the polynomial over a whole cell: nothing is sampled.

Discs are computed in floats. Each is widened by `_ROUNDING` of the sum of moduli of all terms. That is 30 times the
bound on rounding at order 30, and more below, if the library's exponentials are accurate to 1e-13.
"""

import math
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from gustproof.robust.lti.state_space import ComplexMatrix, Matrix
from gustproof.studies.rate.axis_loop import AxisLoop

_ROUNDING = 1e-12
"""[-] relative widening of each disc. Horner's rule at order n errs by less than 8 n 2^-53, 3e-14 at order 30."""
_BATCH = 8192
"""Cells at a time."""
_MOST_CELLS = 200_000
"""Cells for |s| <= 1, and for the others: a third of a second. A proof that is possible takes a few thousand."""
_ROUNDS = 14
"""Halvings of a band that may prove it."""
_LOWEST = 1e-7
"""[-] end of the first cell of s; the others grow from here to 1 by `_GROWTH`."""
_GROWTH = 1.25
"""[-] ratio of the ends of a cell of s at the start."""

End = TypeVar("End", float, Matrix)


class ParameterBox(NamedTuple, Generic[End]):
    """Ranges of the constant parameters, of one box or of k."""

    inertia: tuple[End, End]
    """[kg*m^2] least and largest moment of inertia."""
    lag: tuple[End, End]
    """[s] least and largest actuator lag."""


class _Cells(NamedTuple):
    """Cells of frequency and lag, (k,) each."""

    s_low: Matrix
    s_high: Matrix
    lag_low: Matrix
    lag_high: Matrix

    def take(self, mask: np.ndarray | slice) -> "_Cells":
        return _Cells(*(part[mask] for part in self))


class _Disc(NamedTuple):
    """Discs in the complex plane, (k,); the radius has two parts."""

    centre: ComplexMatrix
    by_frequency: Matrix
    by_lag: Matrix


def is_proven(loop: AxisLoop, box: ParameterBox[float], *, peak: float = math.inf, most: int = _MOST_CELLS) -> bool:
    """Return whether all members of the box are proved stable, with sensitivity below `peak` [-] at all frequencies.

    False means not proved within `most` cells. One member is tested exactly; the others follow from it.
    """
    if not loop.is_stable_at(box.inertia[0], box.lag[0]):
        return False
    count = math.ceil(math.log(1.0 / _LOWEST, _GROWTH))
    ends = np.append(0.0, np.geomspace(_LOWEST, 1.0, count))
    for reverse in (False, True):  # |s| <= 1, then 1 / s
        low, high = np.full(count, box.lag[0]), np.full(count, box.lag[1])
        pending, seen = [_Cells(ends[:-1], ends[1:], low, high)], 0
        while pending:
            cells = pending.pop()
            seen += cells.s_low.size
            if seen > most:
                return False
            proven, by_frequency = _examine(loop, box.inertia, 1.0 / peak, cells, reverse)
            pending += _halve(cells.take(~proven), by_frequency[~proven])
    return True


def proven_bands(
    loop: AxisLoop, box: ParameterBox[Matrix], omega: Matrix, peaks: Matrix, tried: np.ndarray
) -> np.ndarray:
    """Return for each band whether every member of its box is proved to keep its sensitivity below the band's peak.

    Bands lie between successive `omega` (k + 1,) [rad/s], below the Nyquist frequency; `peaks` and ends (k,). With an
    infinite peak no member has a pole on the band. False means not proved within `_ROUNDS` halvings. Bands not `tried`
    (k,) are not proved.
    """
    s = np.tan(0.5 * loop.dt * omega)
    proven = np.zeros(len(peaks), dtype=bool)
    for reverse in (False, True):  # |s| <= 1, then 1 / s
        band = np.flatnonzero(((s[1:] > 1.0) == reverse) & tried)
        low, high = (1.0 / s[band + 1], 1.0 / s[band]) if reverse else (s[band], s[band + 1])
        cells = _Cells(low, high, *(end[band] for end in box.lag))
        proven[band] = True
        for _ in range(_ROUNDS):
            if not 0 < band.size <= _BATCH:
                break
            inertia = box.inertia[0][band], box.inertia[1][band]
            done, by_frequency = _examine(loop, inertia, 1.0 / peaks[band], cells, reverse)
            band = np.tile(band[~done], 2)
            cells = next(iter(_halve(cells.take(~done), by_frequency[~done])), cells)
        proven[band] = False
    return proven


def _halve(cells: _Cells, by_frequency: np.ndarray) -> list[_Cells]:
    """Return both halves of each cell, along its frequencies or its lags, in batches."""
    low, high, lag_low, lag_high = cells
    s, lag = 0.5 * (low + high), 0.5 * (lag_low + lag_high)
    first = _Cells(low, np.where(by_frequency, s, high), lag_low, np.where(by_frequency, lag_high, lag))
    second = _Cells(np.where(by_frequency, s, low), high, np.where(by_frequency, lag_low, lag), lag_high)
    both = _Cells(*(np.concatenate(parts) for parts in zip(first, second, strict=True)))
    return [both.take(slice(k, k + _BATCH)) for k in range(0, both.s_low.size, _BATCH)]


def _examine(
    loop: AxisLoop, inertia: tuple[End, End], clearance: End, cells: _Cells, reverse: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return which cells are proved, and where the frequencies widen the discs more than the lags do."""
    f0, f1 = _enclose(loop, cells, reverse)
    v_low, v_high = (1.0 - _ROUNDING) / inertia[1], (1.0 + _ROUNDING) / inertia[0]
    # the inertia is no interval: the distance from 0 to the segment of f0 - v f1 is exact
    square = np.maximum(np.abs(f1.centre) ** 2, np.finfo(float).tiny)
    v = np.clip((f0.centre * f1.centre.conj()).real / square, v_low, v_high)
    size = np.abs(f0.centre) + v_high * np.abs(f1.centre)
    distance = np.abs(f0.centre - v * f1.centre) - clearance * np.abs(f0.centre) - _ROUNDING * size
    by_frequency = (1.0 + clearance) * f0.by_frequency + v_high * f1.by_frequency
    by_lag = (1.0 + clearance) * f0.by_lag + v_high * f1.by_lag
    return distance > (1.0 + _ROUNDING) * (by_frequency + by_lag), by_frequency >= by_lag


def _enclose(loop: AxisLoop, cells: _Cells, reverse: bool) -> tuple[_Disc, _Disc]:
    """Return discs around f0 and f1 over each cell; with `reverse`, around their values at 1 / s times a power of s."""
    t, half = _middle(cells.s_low, cells.s_high)
    h = half + _ROUNDING * cells.s_high
    (beta_0, c_0), (beta_1, c_1) = loop.lag_terms(cells.lag_low), loop.lag_terms(cells.lag_high)
    (beta, off_beta), (c, off_c) = _middle(beta_0, beta_1), _middle(c_0, c_1)
    b, one, order = loop.held_gain, np.ones(t.size), -1 if reverse else 1
    # coefficients, how far they are off, and the size of their terms, which scales their rounding
    first = np.array([(beta, 2.0 - beta), (off_beta, off_beta), (beta, 2.0 * one)])
    second = b * np.array([(beta, 2.0 - beta - 2.0 * c / b), (off_beta, off_beta + 2.0 * off_c / b), (beta, 4.0 * one)])
    denominator, numerator = _discs(loop.in_floats[:, ::order], t, h)
    f0 = _product(denominator, _disc_of_line(first[:, ::order], t, h))
    f1 = _product(numerator, _disc_of_line(second[:, ::order], t, h))
    return f0, f1


def _middle(x: Matrix, y: Matrix) -> tuple[Matrix, Matrix]:
    """Return the middle of two ends and half their distance."""
    return 0.5 * (x + y), 0.5 * np.abs(y - x)


def _discs(polynomials: Matrix, t: Matrix, h: Matrix) -> list[_Disc]:
    """Return discs around each polynomial (m, n + 1) at s = j (t +- h), by its Taylor coefficients at the centre."""
    p, n, s = polynomials.T[:, :, None], polynomials.shape[1] - 1, 1j * t
    taylor = np.repeat(p.astype(np.complex128), t.size, axis=2)
    for first in range(n):
        for k in range(n - 1, first - 1, -1):
            taylor[k] += s * taylor[k + 1]
    radius, size, far = np.zeros(1), np.zeros(1), t + h
    moduli = np.abs(taylor[1:])
    for modulus in moduli[::-1]:
        radius = h * (radius + modulus)
    for coefficient in np.abs(p[::-1]):
        size = coefficient + far * size
    radius = radius + _ROUNDING * size
    return [_Disc(taylor[0, i], radius[i], np.zeros(t.size)) for i in range(len(polynomials))]


def _disc_of_line(line: Matrix, t: Matrix, h: Matrix) -> _Disc:
    """Return discs around `p[0] + p[1] s` at s = j (t +- h); `line` (3, 2, k) is p, its largest change, its size."""
    p, off, size = line
    centre = np.asarray(p[0] + 1j * t * p[1], dtype=np.complex128)
    rounding = _ROUNDING * (size[0] + (t + h) * size[1])
    return _Disc(centre, h * np.abs(p[1]) + rounding, off[0] + (t + h) * off[1])


def _product(p: _Disc, q: _Disc) -> _Disc:
    """Return discs that hold every product of members; the first has no part by lag."""
    largest = np.abs(p.centre) + p.by_frequency
    centre = np.asarray(p.centre * q.centre, dtype=np.complex128)
    return _Disc(centre, np.abs(q.centre) * p.by_frequency + largest * q.by_frequency, largest * q.by_lag)
