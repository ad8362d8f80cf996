"""Stabilising solutions of algebraic Riccati equations by ordered real Schur form."""

import math
from enum import Enum

import numpy as np
from scipy.linalg.lapack import dgebal, dgecon, dgees, dgetrf, dgetrs, dtrsen

from gustproof.errors import DesignError
from gustproof.robust.lti.state_space import Matrix

_AXIS_TOLERANCE = 1e-9
"""[-] real parts below this fraction of the largest eigenvalue count as zero. Rounding of a balanced matrix of order 40
moves a simple eigenvalue by some 1e-14 of it. A larger tolerance would refuse plants with slow modes and fast
actuators."""
_RANK_TOLERANCE = 1e-13
"""[-] reciprocal condition of the leading half of the basis below which its inverse has no digits left."""


class RiccatiFailure(Enum):
    """Reasons for a Riccati equation to have no stabilising solution."""

    AXIS = "the Hamiltonian has eigenvalues on the imaginary axis"
    """The spectrum does not split into a stable and an unstable half."""
    COMPLEMENT = "the stable invariant subspace is no graph (the pair is not stabilisable, or the level is critical)"
    """The spectrum splits, but the stable half does not define a solution."""


class RiccatiError(DesignError):
    """A Riccati equation has no stabilising solution; `failure` is the reason."""

    def __init__(self, failure: RiccatiFailure) -> None:
        super().__init__(failure.value)
        self.failure = failure


def stabilizing_solution(H: Matrix) -> Matrix:
    """Return `X = Ric(H)`, (n, n) symmetric: `[I; X]` spans the stable invariant subspace of the Hamiltonian `H`.

    Let `H = [[A, R], [Q, -A^T]]`. Then `X` solves `A^T X + X A + X R X - Q = 0` and makes `A + R X` stable.

    `H` is first balanced by a diagonal symplectic scaling in powers of two, which does not round. Cost: some 200 n^3
    operations. Relative accuracy: near 1e-15 times the condition of the equation.

    Raises
    ------
    RiccatiError
        If `H` has eigenvalues on the imaginary axis, or the stable subspace is no graph.
    DesignError
        If `H` has a number that is not finite, on which LAPACK may hang.

    References
    ----------
    A. J. Laub, A Schur method for solving algebraic Riccati equations, IEEE TAC 24 (1979), 913-921.
    """
    if not np.isfinite(H).all():
        raise DesignError("the Hamiltonian overflows: the plant is too badly scaled to solve")
    n = H.shape[0] // 2
    # a plant's states often stand as chains, each driven by later ones: in reverse they need half of the QR steps
    H = H.reshape(2, n, 2, n)[:, ::-1, :, ::-1].reshape(2 * n, 2 * n)
    scale = _symplectic_scale(H)
    T, _, real, imaginary, U, _, info = dgees(_select_all, H * scale[:, None] / scale, lwork=128 * n, overwrite_a=1)
    if not info:
        # dgees would sort as well, but by a Python call for each eigenvalue
        _, U, real, imaginary, _, _, _, info = dtrsen(real < 0.0, T, U, job="N", overwrite_t=1, overwrite_q=1)
    # info: no convergence, or no reordering; reordering may also have rounded an eigenvalue across the axis
    if info or not _is_split(real.tolist(), imaginary.tolist()):
        raise RiccatiError(RiccatiFailure.AXIS)
    U1, U2 = U[:n, :n].T, U[n:, :n].T
    factors, pivots, _ = dgetrf(U1)
    if dgecon(factors, np.abs(U1).sum(axis=0).max())[0] < _RANK_TOLERANCE:
        raise RiccatiError(RiccatiFailure.COMPLEMENT)
    X = (dgetrs(factors, pivots, U2)[0].T * scale[:n, None] * scale[:n])[::-1, ::-1]
    return np.asarray(0.5 * (X + X.T), dtype=np.float64)


def _select_all(_real: float, _imaginary: float) -> bool:
    """Accept every eigenvalue; LAPACK's interface requires a function, but does not call it."""
    return True


def _is_split(real: list[float], imaginary: list[float]) -> bool:
    """Return whether the first half of the eigenvalues is left of the axis and the other half right of it.

    Lists, because arrays of so few numbers take longer.
    """
    n = len(real) // 2
    return min(-max(real[:n]), min(real[n:])) > _AXIS_TOLERANCE * max(map(math.hypot, real, imaginary))


def _symplectic_scale(H: Matrix) -> Matrix:
    """Return powers of two `(s, 1/s)`, (2n,), that balance `H` and keep it Hamiltonian."""
    n = H.shape[0] // 2
    off_diagonal = np.abs(H)
    off_diagonal.flat[:: 2 * n + 1] = 0.0
    factors = dgebal(off_diagonal, scale=1)[3]
    s: Matrix = np.exp2(np.rint(0.5 * np.log2(factors[n:] / factors[:n])))
    return np.concatenate([s, 1.0 / s])
