"""Lower bounds from bad members of the uncertain family, found by search and evaluated exactly."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gustproof.robust.lti.gain_curve import largest_gains
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix
from gustproof.robust.uncertain.uncertainty import DeltaBlock, RealBlock, columns, rows

_CORNERS = 64
"""Most starts: every corner of the real parameters if there are few, else random corners."""
_STEPS = 60
"""Most ascent steps from one start."""
_SHARES = 0.5 ** np.arange(8.0)[:, None, None]
"""[-] of the way to a vertex that each step tries."""


class _Objective(NamedTuple):
    """Function of Delta to make large."""

    values: Callable[[ComplexMatrix], Matrix]
    """Its values (k,) at k Deltas; raises `LinAlgError` if a loop is singular."""
    slope: Callable[[ComplexMatrix], tuple[float, ComplexMatrix]]
    """Its value and gradient at one; the value changes by `Re tr(gradient dDelta)`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WorstDelta:
    """A Delta of the family and its gain."""

    gain: float
    """[-] largest singular value from the free inputs to the free outputs."""
    Delta: ComplexMatrix
    """(n_w, n_z) block-diagonal, each block of norm at most the radius; real parameters are real."""

    def parts(self, blocks: tuple[DeltaBlock, ...]) -> dict[str, ArrayLike]:
        """Return the value of each block by name: a number for a parameter, a complex matrix for a full block."""
        cut = {
            block.name: (block, self.Delta[w, z])
            for block, w, z in zip(blocks, rows(blocks), columns(blocks), strict=True)
        }
        return {
            name: float(part[0, 0].real) if isinstance(block, RealBlock) else part[: block.n_outputs, : block.n_inputs]
            for name, (block, part) in cut.items()
        }


def worst_delta(
    M: ComplexMatrix,
    blocks: tuple[DeltaBlock, ...],
    *,
    radius: float = 1.0,
    repeated: bool = False,
    enough: float = np.inf,
) -> WorstDelta:
    """Return a Delta within `radius` that makes the gain of `F_u(M, Delta)` large: a local maximum, often the global.

    Conditional gradients from many starts. Each step linearises the gain in Delta and finds the best vertex of the
    ball. That is a corner for real parameters, an aligned matrix of rank one for full blocks. The step keeps the best
    point on the way to it. For full blocks alone, this is the power iteration of Packard, Fan and Doyle. With
    `repeated`, the gain is the spectral radius, that which a repeated complex number meets. No start follows
    one that has reached the gain `enough`.

    References
    ----------
    P. M. Young, J. C. Doyle, Computation of mu with real and complex uncertainties, CDC 1990, 1230-1235.
    """
    objective = _Objective(
        lambda Deltas: _gains(M, Deltas, repeated=repeated), lambda Delta: _gain(M, Delta, repeated=repeated)
    )
    return _search(objective, blocks, radius, enough)


def most_unstable_delta(M: Lti, blocks: tuple[DeltaBlock, ...], *, radius: float = 1.0) -> tuple[WorstDelta, complex]:
    """Return a Delta within `radius` that moves the poles of the continuous `F_u(M, Delta)` far to the right.

    Its `gain` is the largest real part; the second result is the pole itself. The search is that of `worst_delta`.
    """
    w, z = _shape(blocks)
    opened = M.subsystem(slice(0, z), slice(0, w))
    objective = _Objective(lambda Deltas: _abscissas(opened, Deltas), lambda Delta: _abscissa(opened, Delta)[1:])
    found = _search(objective, blocks, radius)
    return found, _abscissa(opened, found.Delta)[0]


def most_singular_delta(M: ComplexMatrix, blocks: tuple[DeltaBlock, ...]) -> WorstDelta:
    """Return a real Delta of norm 1 with a large real eigenvalue of `M Delta`, its `gain`, for a real `M`.

    Delta over that eigenvalue makes `I - M Delta` singular. The search is that of `worst_delta`.
    """
    objective = _Objective(
        lambda Deltas: _real_parts(np.linalg.eigvals(M.real @ Deltas.real).astype(np.complex128)).max(axis=1),
        lambda Delta: _largest_real_eigenvalue(M.real, Delta.real),
    )
    return _search(objective, blocks, 1.0)


def _search(objective: _Objective, blocks: tuple[DeltaBlock, ...], radius: float, enough: float = np.inf) -> WorstDelta:
    found: list[WorstDelta] = []
    for start in _starts(blocks):
        found.append(_ascend(objective, blocks, radius, radius * start))
        if found[-1].gain >= enough:
            break
    return max(found, key=lambda result: result.gain)


def _ascend(objective: _Objective, blocks: tuple[DeltaBlock, ...], radius: float, Delta: ComplexMatrix) -> WorstDelta:
    value, slope = objective.slope(Delta)
    for _ in range(_STEPS):
        trials = Delta + _SHARES * (radius * _vertex(slope, blocks) - Delta)
        try:
            values = objective.values(trials)
        except np.linalg.LinAlgError:  # one of them is what is looked for
            values = np.array([objective.slope(trial)[0] for trial in trials])
        k = int(np.argmax(values))
        reached, ahead = objective.slope(trials[k])
        if not reached > value + 1e-6 * abs(value):
            break
        Delta, value, slope = trials[k], reached, ahead
    return WorstDelta(gain=value, Delta=Delta)


def _abscissas(M: Lti, Deltas: ComplexMatrix) -> Matrix:
    """Return the largest real part of the poles at each of some Deltas (k, ...)."""
    reads = np.linalg.solve(np.eye(M.n_outputs) - M.D @ Deltas, M.C.astype(np.complex128)[None])
    return np.asarray(np.linalg.eigvals(M.A + M.B @ Deltas @ reads).real.max(axis=1))


def _abscissa(M: Lti, Delta: ComplexMatrix) -> tuple[complex, float, ComplexMatrix]:
    """Return the rightmost pole, its real part, and the gradient of the real part, as for the gain."""
    loop = np.eye(M.n_outputs) - M.D @ Delta
    reads = np.linalg.solve(loop, M.C.astype(np.complex128))
    poles, left, right = scipy.linalg.eig(M.A + M.B @ Delta @ reads, left=True, right=True)  # type: ignore[misc]
    k = int(np.argmax(poles.real))
    y, x = left[:, k].conj(), right[:, k]
    drives = y @ M.B @ (np.eye(M.n_inputs) + Delta @ np.linalg.solve(loop, M.D))
    return complex(poles[k]), float(poles[k].real), np.outer(reads @ x, drives) / (y @ x)


def _real_parts(values: ComplexMatrix) -> Matrix:
    """Return eigenvalues that are real, and 0 in place of others."""
    return np.where(values.imag == 0.0, values.real, 0.0)


def _largest_real_eigenvalue(M: Matrix, Delta: Matrix) -> tuple[float, ComplexMatrix]:
    """Return the largest real eigenvalue of `M Delta`, 0 without a positive one, and its gradient, as for the gain."""
    values, left, right = scipy.linalg.eig(M @ Delta, left=True, right=True)  # type: ignore[misc]
    real = _real_parts(values)
    k = int(np.argmax(real))
    y, x = left[:, k].conj(), right[:, k]
    if real[k] <= 0.0 or abs(y @ x) < 1e-12:  # a multiple one has no gradient
        return max(float(real[k]), 0.0), np.zeros(Delta.shape[::-1], dtype=np.complex128)
    return float(real[k]), np.asarray(np.outer(x, y @ M) / (y @ x), dtype=np.complex128)


def _gains(M: ComplexMatrix, Deltas: ComplexMatrix, *, repeated: bool) -> Matrix:
    """Return the gain at each of some Deltas (k, ...)."""
    w, z = Deltas.shape[1:]
    reads = np.linalg.solve(np.eye(z) - M[:z, :w] @ Deltas, M[None, :z, w:])
    seen = M[z:, w:] + M[z:, :w] @ Deltas @ reads
    return np.asarray(np.abs(np.linalg.eigvals(seen)).max(axis=1)) if repeated else largest_gains(seen)


def _gain(M: ComplexMatrix, Delta: ComplexMatrix, *, repeated: bool) -> tuple[float, ComplexMatrix]:
    """Return the gain, infinite for a singular loop, and its gradient: the gain changes by `Re tr(slope dDelta)`."""
    w, z = Delta.shape
    loop = np.eye(z) - M[:z, :w] @ Delta
    try:
        reads = np.linalg.solve(loop, M[:z, w:])
        drives = np.linalg.solve(loop.T, (M[z:, :w] @ Delta).T).T @ M[:z, :w] + M[z:, :w]
    except np.linalg.LinAlgError:
        return np.inf, np.zeros((z, w), complex)
    seen = M[z:, w:] + M[z:, :w] @ Delta @ reads
    if repeated:
        values, left, right = scipy.linalg.eig(seen, left=True, right=True)  # type: ignore[misc]
        k = int(np.argmax(np.abs(values)))
        y, x, size = left[:, k].conj(), right[:, k], float(abs(values[k]))
        turn = values[k].conj() / ((y @ x) * size) if size > 0.0 and abs(y @ x) > 1e-12 else 0.0
        return size, np.asarray(turn * np.outer(reads @ x, y @ drives))
    U, s, Vh = np.linalg.svd(seen)
    slope = np.outer(reads @ Vh[0].conj(), U[:, 0].conj() @ drives)
    return float(s[0]), slope


def _vertex(slope: ComplexMatrix, blocks: tuple[DeltaBlock, ...]) -> ComplexMatrix:
    """Return the Delta of norm 1 with the largest `Re tr(slope Delta)`."""
    vertex = np.zeros(_shape(blocks), dtype=np.complex128)
    for block, w, z in zip(blocks, rows(blocks), columns(blocks), strict=True):
        part = slope[z, w]
        if isinstance(block, RealBlock):
            vertex[w, z] = np.sign(np.trace(part).real) * np.eye(block.repeats)
        elif block.repeats > 1 or block.shape == (1, 1):
            vertex[w, z] = np.exp(-1j * np.angle(np.trace(part))) * np.eye(block.repeats)
        else:
            U, _, Vh = np.linalg.svd(part, full_matrices=False)
            vertex[w, z] = np.outer(Vh[0].conj(), U[:, 0].conj())
    return vertex


def _starts(blocks: tuple[DeltaBlock, ...]) -> list[ComplexMatrix]:
    """Return starts of norm 1: corners of the real parameters, random directions of the full blocks."""
    rng = np.random.default_rng(0)
    n_real = sum(isinstance(block, RealBlock) for block in blocks)
    corners = (
        list(product((-1.0, 1.0), repeat=n_real))
        if 2**n_real <= _CORNERS
        else [tuple(rng.choice((-1.0, 1.0), n_real)) for _ in range(_CORNERS)]
    )
    if n_real < len(blocks):
        corners = [corner for corner in corners for _ in range(max(1, 8 // len(corners)))]
    starts = []
    for corner in corners:
        signs, Delta = iter(corner), np.zeros(_shape(blocks), dtype=np.complex128)
        for block, w, z in zip(blocks, rows(blocks), columns(blocks), strict=True):
            if isinstance(block, RealBlock):
                Delta[w, z] = next(signs) * np.eye(block.repeats)
            elif block.repeats > 1:
                Delta[w, z] = np.exp(2j * np.pi * rng.uniform()) * np.eye(block.repeats)
            else:
                full = rng.normal(size=block.shape) + 1j * rng.normal(size=block.shape)
                Delta[w, z] = full / np.linalg.norm(full, 2)
        starts.append(Delta)
    return starts


def _shape(blocks: tuple[DeltaBlock, ...]) -> tuple[int, int]:
    return sum(block.shape[0] for block in blocks), sum(block.shape[1] for block in blocks)
