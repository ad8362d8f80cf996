"""Zeros near the imaginary axis, deflated from a Riccati equation: known eigenvalues that rounding would mix up."""

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from gustproof.robust.lti.norms import eigenvalues
from gustproof.robust.lti.state_space import Matrix

_NEAR = 1e-4
"""[-] zeros with a real part below this fraction of the norm of the state matrix are near the axis."""
_UNOBSERVABLE = 1e-12
"""[-] singular values of the scaled pencil below this are rounding: the zero is one."""
_ROUNDING = 1e-15
"""[-] relative rounding of an eigenvalue of a matrix of moderate order."""


class AxisZeros(NamedTuple):
    """Zeros of (A, B2, C1, D12) near the axis, and bases that split the states into theirs and the rest."""

    decaying: Matrix
    """(n, s) basis of the directions of the zeros left of the axis, on which the Riccati solution is 0."""
    growing: Matrix
    """(n, k) basis of the directions of the zeros right of the axis."""
    rest: Matrix
    """(n, n - s - k) basis of the complement."""
    block: Matrix
    """(k, k) with the zeros right of the axis as its eigenvalues."""
    on_axis: complex | None
    """[rad/s] a zero that rounding does not tell from the axis."""
    others: NDArray[Any]
    """(n - s - k,) [rad/s] eigenvalues of the rest: all other zeros are among them."""


def find_axis_zeros(A: Matrix, C: Matrix, scale: float, size: float) -> AxisZeros:
    """Return the unobservable modes of `(C, A)` near the imaginary axis.

    `scale` and `size` are the sizes of A and C, to tell rounding by.
    With `u = -D12^+ C1 x` applied, these are the zeros of a plant from u to z. Chains of modes are found link by link.
    """
    if not np.isfinite(A).all():
        raise np.linalg.LinAlgError("the zeros overflow")
    n = A.shape[0]
    found, on_axis = np.zeros((n, 0)), None
    rest, others = np.eye(n), eigenvalues(A)
    while True:
        directions, doubtful = _unobservable_near_axis(rest.T @ A @ rest, C @ rest, others, scale, size)
        on_axis = on_axis if doubtful is None else doubtful
        if not directions.shape[1]:
            break
        found = _orthonormal(np.hstack([found, rest @ directions]))
        rest = _complement(found)
        others = eigenvalues(rest.T @ A @ rest)
    if not found.shape[1]:
        return AxisZeros(found, found, rest, np.zeros((0, 0)), on_axis, others)
    T, Z, count = scipy.linalg.schur(found.T @ A @ found, sort="lhp")
    basis = found @ Z
    return AxisZeros(basis[:, :count], basis[:, count:], rest, T[count:, count:], on_axis, others)


def _unobservable_near_axis(
    A: Matrix, C: Matrix, values: NDArray[Any], scale: float, size: float
) -> tuple[Matrix, complex | None]:
    """Return a basis of eigenvectors of unobservable modes near the axis, and one that may be on it."""
    kept, on_axis = [np.zeros((A.shape[0], 0))], None
    for value in values[(np.abs(values.real) <= _NEAR * scale) & (values.imag >= 0.0)]:
        pencil = np.vstack([(A - value * np.eye(len(A))) / scale, C / size])
        _, singular, Vh = np.linalg.svd(pencil)
        null = Vh[singular <= _UNOBSERVABLE].conj().T
        if not null.shape[1]:
            continue
        kept.append(np.hstack([null.real, null.imag]))
        left, _, right = np.linalg.svd(A - value * np.eye(len(A)))
        cosine = max(abs(np.vdot(left[:, -1], right[-1].conj())), 1e-8)
        if abs(value.real) <= _ROUNDING * np.sqrt(len(A)) * scale / cosine:
            on_axis = complex(value)
    return _orthonormal(np.hstack(kept)), on_axis


def _orthonormal(M: Matrix) -> Matrix:
    """Return an orthonormal basis of the columns; those of rounding are dropped."""
    if not M.shape[1]:
        return M
    U, singular, _ = np.linalg.svd(M, full_matrices=False)
    return np.asarray(U[:, singular > 1e-8 * singular[0]], dtype=np.float64)


def _complement(basis: Matrix) -> Matrix:
    """Return an orthonormal basis of the complement of orthonormal columns."""
    Q = np.linalg.qr(basis, mode="complete")[0] if basis.shape[1] else np.eye(basis.shape[0])
    return np.asarray(Q[:, basis.shape[1] :], dtype=np.float64)


def add_growing(zeros: AxisZeros, X: Matrix, closed: Matrix, G: Matrix) -> tuple[Matrix, bool]:
    """Return the stabilising solution, and True if zeros right of the axis allow one that is not negative.

    `X` is the solution that leaves them where they are, `closed` the closed state matrix, `G` the quadratic term of
    `... - X G X`. They are mirrored by a Lyapunov equation of their own number.
    """
    U, N = zeros.growing, zeros.rest
    if not U.shape[1]:
        return X, True
    # left basis of the zeros: L^T closed = block L^T
    Z = scipy.linalg.solve_sylvester(zeros.block, -(N.T @ closed @ N), U.T @ closed @ N)
    L = U + N @ Z.T
    W = scipy.linalg.solve_continuous_lyapunov(zeros.block, L.T @ G @ L)
    W = 0.5 * (W + W.T)
    if np.linalg.eigvalsh(W)[0] <= 0.0:
        return X, False
    return X + L @ np.linalg.solve(W, L.T), True
