"""One of the two Riccati equations of a synthesis, for all levels; the filter's is the same on transposed data."""

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgesv, dpotrf

from gustproof.errors import DesignError
from gustproof.robust.hinf.axis_zeros import AxisZeros, add_growing
from gustproof.robust.lti.riccati import stabilizing_solution
from gustproof.robust.lti.state_space import Matrix, largest_gain

_SEMIDEFINITE = 1e-9
"""[-] eigenvalues above minus this fraction of the solution's natural size count as not negative. A solution may be
singular or 0; it becomes indefinite only through infinity."""
_TINY = float(np.finfo(float).tiny)
"""Least positive number, so that a signal of no terms is not divided by 0."""
_ROUNDING = 1e-14
"""[-] rounding of a gain, of the terms that it is summed from."""


class RiccatiData(NamedTuple):
    """Data of the control Riccati equation that no level gamma changes; the filter equation takes transposed data."""

    A: Matrix
    """(n, n)."""
    B: Matrix
    """(n, m1 + m2), of (w, u)."""
    C1: Matrix
    """(p1, n)."""
    D1: Matrix
    """(p1, m1 + m2)."""
    R: Matrix
    """(m1 + m2, m1 + m2) D1^T D1."""
    SB: Matrix
    """(m1 + m2, 2n) S = D1^T C1, then B^T."""
    H: Matrix
    """(2n, 2n) Hamiltonian matrix without the feedback of inputs: [A, 0; -C1^T C1, -A^T]."""
    into: Matrix
    """(2n, m1 + m2) B above -C1^T D1, by which inputs enter the Hamiltonian matrix."""
    J: Matrix
    """(m1 + m2, m1 + m2) identity on w, 0 on u."""
    natural_size: float
    """[-] size of a solution, the scale for its eigenvalues."""
    allowance: Matrix
    """(n, n) half of what an eigenvalue may be negative by, times the identity."""
    zeros: AxisZeros
    """Zeros near the imaginary axis."""
    quotient: "RiccatiData | None"
    """Data without the states of such zeros; `None` if there are none."""


def riccati_data(A: Matrix, B: Matrix, C1: Matrix, D1: Matrix, m1: int, zeros: AxisZeros) -> RiccatiData:
    """Return the data of a Riccati equation of the first `m1` inputs as disturbances, the others as controls."""
    rate = largest_gain(A)
    natural_size = largest_gain(C1) ** 2 / rate if rate else 1.0
    J = np.diag((np.arange(D1.shape[1]) < m1).astype(np.float64))
    S, n, quotient = D1.T @ C1, len(A), None
    H = np.zeros((2 * n, 2 * n))
    H[:n, :n], H[n:, :n], H[n:, n:] = A, -C1.T @ C1, -A.T
    if zeros.rest.shape[1] < A.shape[0]:
        # u = -D12^T C1 x hides the states of the zeros from z, and leaves the solution as it is
        N, D12 = zeros.rest, D1[:, m1:]
        A_hidden, C_hidden = A - B[:, m1:] @ (D12.T @ C1), C1 - D12 @ (D12.T @ C1)
        none = AxisZeros(N[:, :0].T @ N, N[:, :0].T @ N, np.eye(N.shape[1]), np.zeros((0, 0)), None, zeros.others)
        quotient = riccati_data(N.T @ A_hidden @ N, N.T @ B, C_hidden @ N, D1, m1, none) if N.size else None
    return RiccatiData(
        A=A,
        B=B,
        C1=C1,
        D1=D1,
        R=D1.T @ D1,
        SB=np.concatenate([S, B.T], axis=1),
        H=H,
        into=np.concatenate([B, -S.T]),
        J=J,
        natural_size=natural_size,
        allowance=0.5 * _SEMIDEFINITE * natural_size * np.eye(n),
        zeros=zeros,
        quotient=quotient,
    )


def solve_riccati(half: RiccatiData, gamma: float) -> tuple[Matrix, Matrix, bool]:
    """Return a Riccati solution, its gain, and True if it has no negative eigenvalue.

    Raises
    ------
    DesignError
        If there is no stabilising solution, or `gamma` is a singular value of the part of D11 that no control affects.
    """
    feedback, n = _feedback(half, gamma), half.A.shape[0]
    if half.zeros.rest.shape[1] < n:
        X, definite = _solve_quotient(half, gamma, feedback)
    else:
        X = stabilizing_solution(_hamiltonian(half, feedback))
        definite = _is_semidefinite(X, half)
    return X, -(feedback[:, :n] + feedback[:, n:] @ X), definite


def _is_semidefinite(X: Matrix, half: RiccatiData) -> bool:
    """Return whether no eigenvalue is negative. A Cholesky factor of a slightly larger matrix, if it exists, tells."""
    if not dpotrf(X + half.allowance)[1]:
        return True
    eigenvalues = np.linalg.eigvalsh(X)
    return bool(eigenvalues[0] >= -_SEMIDEFINITE * max(eigenvalues[-1], half.natural_size))


def has_no_solution(half: RiccatiData, gamma: float) -> bool:
    """Return True if there is no stabilising solution, whatever the rounding.

    There is none if at some frequency no control, knowing all, keeps the gain from w to z below the level. Frequencies
    are tried between the eigenvalues of the Hamiltonian on the imaginary axis, where that gain crosses the level.
    """
    if half.quotient is not None:
        return has_no_solution(half.quotient, gamma)
    n, w = half.A.shape[0], np.flatnonzero(np.diag(half.J))
    crossings = np.abs(np.linalg.eigvals(_hamiltonian(half, _feedback(half, gamma))).imag)
    ends = np.concatenate([[0.0], np.unique(crossings), [2.0 * np.max(crossings)]])
    omega = 0.5 * (ends[:-1] + ends[1:])
    omega = omega[omega > 0.0]
    states = np.linalg.solve(1j * omega[:, None, None] * np.eye(n) - half.A, half.B.astype(np.complex128)[None])
    gains = half.C1 @ states + half.D1
    terms = np.linalg.norm(np.abs(half.C1) @ np.abs(states) + np.abs(half.D1), axis=1, keepdims=True) + _TINY
    controls = (gains / terms)[:, :, len(w) :]
    U, singular, _ = np.linalg.svd(controls, full_matrices=False)
    left = gains[:, :, : len(w)] - U @ (U.conj().transpose(0, 2, 1) @ gains[:, :, : len(w)])
    rounding = _ROUNDING * np.linalg.norm(terms[:, 0, : len(w)], axis=1) / singular[:, -1]
    return bool(np.any(np.linalg.norm(left, 2, axis=(1, 2)) > gamma + rounding))


def _feedback(half: RiccatiData, gamma: float) -> Matrix:
    """Return `R^-1 [S, B^T]` at a level, (m1 + m2, 2n)."""
    _, _, solved, singular = dgesv(half.R - gamma**2 * half.J, half.SB)
    if singular:
        raise DesignError("R - gamma^2 J is singular")
    return np.asarray(solved, dtype=np.float64)


def _hamiltonian(half: RiccatiData, feedback: Matrix) -> Matrix:
    """Return the Hamiltonian matrix of the equation, (2n, 2n), whose lower half repeats the upper to the bit."""
    n = half.A.shape[0]
    H = half.H - half.into @ feedback
    H[n:, n:] = -H[:n, :n].T
    return H


def _solve_quotient(half: RiccatiData, gamma: float, feedback: Matrix) -> tuple[Matrix, bool]:
    """Return a Riccati solution with the states of zeros near the axis split off, and True if it is not negative."""
    X, definite, N, n = np.zeros_like(half.A), True, half.zeros.rest, half.A.shape[0]
    RS, RB = feedback[:, :n], feedback[:, n:]
    if half.quotient is not None:
        inner, _, definite = solve_riccati(half.quotient, gamma)
        X = N @ inner @ N.T
    X, allowed = add_growing(half.zeros, X, half.A - half.B @ (RS + RB @ X), half.B @ RB)
    return X, definite and allowed
