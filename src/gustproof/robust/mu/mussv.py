"""The structured singular value of matrices, with blocks written as in MATLAB."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gustproof.robust.lti.state_space import ComplexMatrix, Matrix, gain
from gustproof.robust.mu.nearest_singular import nearest_singular_delta
from gustproof.robust.mu.scalings import best_scalings
from gustproof.robust.mu.singular_value import SHARES, matrix_lower_bound, mu
from gustproof.robust.mu.sweep import require_search
from gustproof.robust.shown import Shown
from gustproof.robust.uncertain.uncertain_system import Uncertain, is_system
from gustproof.robust.uncertain.uncertainty import DeltaBlock, FullBlock, RealBlock, columns, rows

_TIGHT = 0.995
"""[-] lower over upper bound above which neither is searched further."""
_BITS = 60
"""Exponent of two beyond which a matrix is bounded in another unit."""
_SMALLER = (0.5, 0.25, 0.1, 0.03, 0.01, 1e-3)
"""[-] shares of the upper bound tried in turn where no singular matrix was found."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class MatrixMu(Shown):
    """Bounds on mu of one matrix or of several, and the Delta of the lower ones."""

    lower: Matrix
    """(k,) or (): inverse of the size of `Delta`; 0 where none was found."""
    upper: Matrix
    """(k,) or (): no Delta of a size below its inverse makes `I - M Delta` singular."""
    Delta: ComplexMatrix
    """(k, n_w, n_z) or (n_w, n_z): makes `I - M Delta` singular where the lower bound is positive."""

    def lines(self) -> list[str]:
        """Return the bounds of the matrix with the largest upper one."""
        k = int(np.argmax(self.upper))
        count = f", the largest of {self.upper.size}" if self.upper.ndim else ""
        return [f"mu: {np.ravel(self.lower)[k]:.6g} to {np.ravel(self.upper)[k]:.6g}{count}"]


def mussv(M: ArrayLike, blocks: Sequence[tuple[int, int]], *, accuracy: float = 1e-3, boxes: int = 100) -> MatrixMu:
    """Return bounds on mu of a complex matrix, or of one for each frequency (MATLAB: `mussv`).

    Where real parameters leave a gap between the bounds, their ranges are halved by branch and bound.

    Parameters
    ----------
    M
        (n_z, n_w) or (k, n_z, n_w), as of `control.frequency_response` with the frequency first.
    blocks
        A pair for each block of Delta. Real numbers repeated r times are (-r, 0), complex ones (r, 0), and (-1, 1) is
        (-1, 0). A full complex block of p rows and m columns is (p, m).
    accuracy
        [-] relative distance of the upper bounds from the least of D-G scalings.
    boxes
        Most boxes of real parameters at each level tried; 1 for scalings alone.

    Raises
    ------
    ValueError
        If a pair is none of these, or blocks and matrix do not fit.

    References
    ----------
    A. Packard, J. C. Doyle, The complex structured singular value, Automatica 29 (1993), 71-109. M. P. Newlin, P. M.
    Young, Mixed mu problems and branch and bound techniques, Int. J. of Robust and Nonlinear Control 7 (1997), 145-164.

    Examples
    --------
    >>> from gustproof.robust import mussv
    >>> mussv([[0.5, 4.0], [-0.3, 0.8]], [(1, 1), (1, 1)], accuracy=1e-4)
    mu: 1.42377 to 1.42385
    """
    if is_system(M):
        raise ValueError("M is a system: take its frequency response, or robstab of the uncertain system")
    require_search(accuracy, boxes)
    whole = np.asarray(M, dtype=np.complex128)
    known = tuple(_block(k, pair) for k, pair in enumerate(blocks))
    z, w = (sum(block.shape[axis] for block in known) for axis in (1, 0))
    if whole.ndim not in (2, 3) or whole.shape[-2:] != (z, w) or 0 in (len(known), whole.size):
        raise ValueError(f"M has the shape {whole.shape}, the blocks need {z} x {w}")
    if not np.isfinite(whole).all():
        raise ValueError("M has what is no finite number")
    found = [_bounds(matrix, known, accuracy, boxes) for matrix in whole.reshape(-1, z, w)]
    lower, upper, Delta = (np.array(each) for each in zip(*found, strict=True))
    shape = whole.shape[:-2]
    return MatrixMu(lower=lower.reshape(shape), upper=upper.reshape(shape), Delta=Delta.reshape(*shape, w, z))


def _block(k: int, pair: tuple[int, int]) -> DeltaBlock:
    name = f"block {k + 1}"
    if np.shape(pair) != (2,):
        raise ValueError(f"{name} is {pair!r}, must be a pair: (-r, 0) real, (r, 0) complex, (p, m) full")
    p, m = (int(size) for size in pair)
    if [p, m] != list(pair):
        raise ValueError(f"{name} is {pair!r}, must be a pair of whole numbers")
    if (p < 0 and m == 0) or (p, m) == (-1, 1):
        return RealBlock(name=name, low=-1.0, high=1.0, nominal=0.0, repeats=-p)
    if m == 0 and p > 0:
        return FullBlock(name=name, repeats=p)
    return FullBlock(name=name, n_outputs=p, n_inputs=m)


def _bounds(
    M: ComplexMatrix, blocks: tuple[DeltaBlock, ...], accuracy: float, boxes: int
) -> tuple[float, float, ComplexMatrix]:
    """Return both bounds of one matrix, and the Delta of the lower one."""
    size = float(np.max(np.abs(M)))
    if size and abs(math.log2(size)) > _BITS:  # squares would overflow, or be lost
        unit = 2.0 ** round(math.log2(size))
        lower, upper, Delta = _bounds(M / unit, blocks, accuracy, boxes)
        return lower * unit, upper * unit, Delta / unit
    if not M.imag.any():
        found = mu(Uncertain(M=gain(M.real), blocks=blocks), accuracy=accuracy)
        lower, upper, delta = found.lower, found.upper, dict(found.delta)
    else:
        upper = best_scalings(M, blocks, gain=False, accuracy=accuracy).level(M)
        full = any(isinstance(block, FullBlock) for block in blocks)
        lower, delta = matrix_lower_bound(M, blocks, upper) if full and upper > 0.0 else (0.0, {})
    Delta = np.zeros((M.shape[1], M.shape[0]), dtype=np.complex128)
    for block, w, z in zip(blocks, rows(blocks), columns(blocks), strict=True):
        value = np.atleast_2d(np.asarray(delta.get(block.name, np.zeros((block.n_outputs, block.n_inputs)))))
        Delta[w, z] = np.kron(np.eye(block.repeats), value)
    if lower < _TIGHT * upper and math.isfinite(upper):
        nearest, found_there = nearest_singular_delta(M, blocks, upper)
        lower, Delta = (nearest, found_there) if nearest > lower else (lower, Delta)
        upper = _lower_by_boxes(M, blocks, (lower, upper), accuracy, boxes)
    return min(lower, upper), upper, Delta


def _lower_by_boxes(
    M: ComplexMatrix, blocks: tuple[DeltaBlock, ...], bounds: tuple[float, float], accuracy: float, boxes: int
) -> float:
    """Return the least upper bound that boxes of the real parameters prove; with a lower one, the levels next to it."""
    lower, upper = bounds
    for level in [lower / share for share in SHARES] if lower else [upper * share for share in _SMALLER]:
        proved = level < upper and _is_regular_within(M, blocks, 1.0 / level, accuracy, boxes)
        upper = level if proved else upper
        if proved == (lower > 0.0):
            break
    return upper


def _is_regular_within(
    M: ComplexMatrix, blocks: tuple[DeltaBlock, ...], radius: float, accuracy: float, boxes: int
) -> bool:
    """Return whether `I - M Delta` is proved regular for every Delta of norm `radius`, by at most `boxes` boxes."""
    places = list(zip(blocks, rows(blocks), columns(blocks), strict=True))
    parameters = sum(isinstance(block, RealBlock) for block in blocks)
    pending, seen = [np.full((parameters, 2), [-radius, radius])], 0
    while pending:
        box, seen = pending.pop(), seen + 1
        if seen > boxes:
            return False
        # Delta = centre + extent Delta', Delta' in the unit ball
        centre, extent, ends = np.zeros(M.shape[::-1]), np.full(M.shape[1], radius), iter(box)
        for block, w, z in places:
            if isinstance(block, RealBlock):
                low, high = next(ends)
                centre[w, z], extent[w] = 0.5 * (low + high) * np.eye(block.repeats), 0.5 * (high - low)
        try:
            inside = np.linalg.solve(np.eye(len(M)) - M @ centre, M) * extent
        except np.linalg.LinAlgError:
            return False
        scalings = best_scalings(inside, blocks, gain=False, accuracy=max(accuracy, 0.01), enough=0.999)
        if scalings.level(inside) < 1.0:
            continue
        if not parameters:
            return False
        k = int(np.argmax(box[:, 1] - box[:, 0]))
        middle = box[k].mean()
        pending += [np.vstack([box[:k], [half], box[k + 1 :]]) for half in ((box[k, 0], middle), (middle, box[k, 1]))]
    return True
