"""The Delta nearest to 0 with which a matrix is singular in feedback, by constrained minimisation from many starts."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from gustproof.robust.lti.state_space import ComplexMatrix, Matrix
from gustproof.robust.uncertain.uncertainty import DeltaBlock, RealBlock, columns, rows
from gustproof.robust.uncertain.units import channel_units

_STARTS = 12
"""Random starts."""
_NEAR = 0.995
"""[-] share of the upper bound at which the search stops."""
_NEWTON_STEPS = 4
"""Steps that bring what the minimisation found onto the singular set."""
_SINGULAR = 1e-9
"""[-] least singular value of `I - M Delta` that counts as 0."""


@dataclass(frozen=True, slots=True)
class _Search:
    """The search for one matrix in balanced units, its mu about 1; a point is all blocks, then a bound of their norms.

    A parameter is one number, a complex number two, and a full block of rank one a column and a row of complex ones.
    """

    M: ComplexMatrix
    """(n_z, n_w) matrix."""
    blocks: tuple[DeltaBlock, ...]
    """Blocks of Delta."""

    def cut(self, x: Matrix) -> Iterator[tuple[ComplexMatrix, float]]:
        """Yield the value of one occurrence of each block, and its norm."""
        at = 0
        for block in self.blocks:
            if isinstance(block, RealBlock):
                yield x[at : at + 1, None].astype(np.complex128), abs(float(x[at]))
                at += 1
                continue
            count = _count_numbers(block)
            known = x[at : at + count // 2] + 1j * x[at + count // 2 : at + count]
            at += count
            left, right = known[: block.n_outputs], known[block.n_outputs :] if count > 2 else np.ones(1)
            yield (
                np.asarray(np.outer(left, right), dtype=np.complex128),
                float(np.linalg.norm(left) * np.linalg.norm(right)),
            )

    def delta(self, x: Matrix) -> ComplexMatrix:
        """Return Delta (n_w, n_z) at a point."""
        whole = np.zeros(self.M.shape[::-1], dtype=np.complex128)
        places = zip(self.blocks, rows(self.blocks), columns(self.blocks), self.cut(x), strict=True)
        for block, w, z, (value, _) in places:
            whole[w, z] = np.kron(np.eye(block.repeats), value)
        return whole

    def room(self, x: Matrix) -> Matrix:
        """Return what is left between each norm and the bound."""
        return np.array([x[-1] - size for _, size in self.cut(x)])

    def determinant(self, x: Matrix) -> Matrix:
        """Return the real and imaginary part of `det(I - M Delta)`."""
        value = np.linalg.det(np.eye(len(self.M)) - self.M @ self.delta(x))
        return np.array([value.real, value.imag])

    def start(self, rng: np.random.Generator) -> Matrix:
        """Return a random point."""
        x = np.append(rng.normal(size=sum(map(_count_numbers, self.blocks))) * rng.choice((0.3, 1.0)), 0.0)
        x[-1] = -np.min(self.room(x))
        return x

    def close_in(self, x: Matrix) -> Matrix:
        """Return a point moved onto the singular set by Newton's method."""
        for _ in range(_NEWTON_STEPS):
            value, step = self.determinant(x), 1e-7
            slope = np.array([(self.determinant(x + step * e) - value) / step for e in np.eye(x.size)[:-1]]).T
            x = x - np.append(np.linalg.lstsq(slope, value)[0], 0.0)
        return x


def _count_numbers(block: DeltaBlock) -> int:
    """Return the count of real numbers that a block has at a point."""
    if isinstance(block, RealBlock):
        return 1
    return 2 if block.n_outputs == block.n_inputs == 1 else 2 * (block.n_outputs + block.n_inputs)


def _bound_of_norms(x: Matrix) -> float:
    return float(x[-1])


def nearest_singular_delta(
    M: ComplexMatrix, blocks: tuple[DeltaBlock, ...], upper: float
) -> tuple[float, ComplexMatrix]:
    """Return a lower bound on mu of a matrix, and the Delta (n_w, n_z) of norm 1 / bound that makes it singular.

    The Delta makes `I - M Delta` singular and is the least of several local minima; 0 and zeros if none was found. No
    complex block is needed, unlike by searches that turn phases. `upper` is an upper bound of mu, positive and finite.
    """
    units = channel_units(M[None], blocks)
    search = _Search(M * units.w / units.z[:, None] / upper, blocks)
    rng = np.random.default_rng(0)
    best, Delta = 0.0, np.zeros(M.shape[::-1], dtype=np.complex128)
    limits: Any = [{"type": "eq", "fun": search.determinant}, {"type": "ineq", "fun": search.room}]
    for _ in range(_STARTS):
        if best >= _NEAR:
            break
        found = scipy.optimize.minimize(
            _bound_of_norms,
            search.start(rng),
            method="SLSQP",
            constraints=limits,
            tol=1e-9,
        )
        if not np.isfinite(found.x).all():
            continue
        x = search.close_in(np.asarray(found.x))
        size = max((norm for _, norm in search.cut(x)), default=0.0)
        least = np.linalg.svd(np.eye(len(M)) - search.M @ search.delta(x), compute_uv=False)[-1]
        if least <= _SINGULAR and 1.0 / size > best:
            best, Delta = 1.0 / size, search.delta(x)
    return best * upper, Delta / upper
