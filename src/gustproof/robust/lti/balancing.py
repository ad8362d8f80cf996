"""Balanced coordinates: in units, powers of two, that round nothing; and, of states, by their Gramians."""

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.linalg.lapack import dgebal

from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix

_NEGLIGIBLE = 1e-14
"""[-] Hankel singular values below this fraction of the largest are rounding; their states are dropped."""
_DOUBLINGS = 60
"""Number of doublings of the horizon at most."""
_ONE_WAY = 2.0**-10
"""[-] largest size, next to that of signals coupled both ways, of what couples signals in one direction only."""
_MOST = 400
"""Largest exponent of two by which units separate signals."""


def balancing_units(M: Matrix | ComplexMatrix, rows: Sequence[slice], columns: Sequence[slice]) -> Matrix:
    """Return units (k,) of k inner signals: rows over them and columns times them have alike Frobenius norms.

    A row or column in no group is external and keeps its unit. A group's own diagonal block does not count. Groups
    joined to the rest in one direction only cannot be balanced. Units that `M` came in change the balanced matrix by a
    factor of two at most. Cost: one pass of `M`, then some sweeps of order k^2.

    Parameters
    ----------
    M
        (p, m) matrix; may be complex.
    rows, columns
        k slices, disjoint: the rows and the columns of each inner signal, or of a group of signals with one unit.

    References
    ----------
    E. E. Osborne, On pre-conditioning of matrices, Journal of the ACM 7 (1960), 338-345. R. James, J. Langou, B. R.
    Lowery, On matrix balancing and eigenvector computation, arXiv:1401.5766 (2014): the norm.

    Examples
    --------
    >>> import numpy as np
    >>> from gustproof.robust.lti.balancing import balancing_units
    >>> M = np.array([[0.0, 2.0**20], [2.0**-20, 0.0]])
    >>> units = balancing_units(M, [slice(0, 1), slice(1, 2)], [slice(0, 1), slice(1, 2)])
    >>> (M * units / units[:, None]).tolist()
    [[0.0, 1.0], [1.0, 0.0]]
    """
    k = len(rows)
    own_row, own_column = np.full(M.shape[0], k), np.full(M.shape[1], k)
    for i, (row, column) in enumerate(zip(rows, columns, strict=True)):
        own_row[row], own_column[column] = i, i
    # `hypot` neither overflows nor loses what is small, as sums of squares would
    by_row, sizes = np.zeros((k + 1, M.shape[1])), np.zeros((k + 1, k + 1))
    np.hypot.at(by_row, own_row, np.abs(M))
    np.hypot.at(sizes.T, own_column, by_row.T)
    return _balance_sizes(sizes)


def _balance_sizes(sizes: Matrix) -> Matrix:
    """Return the units (k,) of inner signals from sizes (k + 1, k + 1), the last row and column of all external ones.

    What couples a signal to itself does not count.
    """
    np.fill_diagonal(sizes, 0.0)
    _, _, _, scale, _ = dgebal(sizes, scale=1, permute=0)
    return np.asarray(scale[:-1] / scale[-1], dtype=np.float64)


def balance_states(G: Lti) -> Lti:
    """Return a system with its states in balanced units: the same responses, and rows and columns of like size."""
    if not G.order:
        return G
    units = state_units(G)
    if np.all(units == 1.0):
        return G
    return Lti(A=G.A * units / units[:, None], B=G.B / units[:, None], C=G.C * units, D=G.D, dt=G.dt)


def state_units(G: Lti) -> Matrix:
    """Return the balancing units (n,) of a system's states; inputs and outputs keep theirs."""
    n = G.order
    sizes = np.zeros((n + 1, n + 1))  # as `balancing_units` makes them of [A, B; C, 0], for states that are no groups
    sizes[:n, :n] = np.abs(G.A)
    if G.n_inputs:
        sizes[:n, n] = np.hypot.reduce(np.abs(G.B), axis=1)
    if G.n_outputs:
        sizes[n, :n] = np.hypot.reduce(np.abs(G.C), axis=0)
    return _balance_sizes(sizes)


def balanced_realization(G: Lti) -> tuple[Lti, Matrix]:
    """Return the minimal balanced form of a stable system, and its Hankel singular values."""
    if not G.order:
        return G, np.zeros(0)
    reached, seen = gramian_factor(G.A, G.B, G.dt), gramian_factor(G.A.T, G.C.T, G.dt)
    U, hankel, Vt = np.linalg.svd(seen.T @ reached)
    size = int(np.sum(hankel > _NEGLIGIBLE * hankel[0]))
    root = np.sqrt(hankel[:size])
    T, left = reached @ Vt[:size].T / root, (seen @ U[:, :size] / root).T
    return Lti(A=left @ G.A @ T, B=left @ G.B, C=G.C @ T, D=G.D, dt=G.dt), np.asarray(hankel[:size])


def gramian_factor(A: Matrix, B: Matrix, dt: float) -> Matrix:
    """Return L, (n, n), with L L' the reachability Gramian of a stable system, by doubling of the horizon.

    A continuous system is first mapped to a discrete one of the same Gramian. Only orthogonal transformations and
    powers of A are used, so that weak directions keep their digits.

    References
    ----------
    R. A. Smith, Matrix equation XA + BX = C, SIAM J. Applied Mathematics 16 (1968), 198-201.
    """
    n = A.shape[0]
    if not dt:
        speeds = np.abs(scipy.linalg.eigvals(A))
        step = 2.0 / float(np.sqrt(speeds.min() * speeds.max()))
        inverse = np.linalg.inv(np.eye(n) - 0.5 * step * A)
        A, B = inverse @ (np.eye(n) + 0.5 * step * A), np.sqrt(step) * inverse @ B
    factor = np.hstack([B, np.zeros((n, max(0, n - B.shape[1])))])
    power = A
    for _ in range(_DOUBLINGS):
        _, R = np.linalg.qr(np.hstack([factor, power @ factor]).T)
        factor, power = R[:n].T, power @ power
        if np.linalg.norm(power) < 1e-17:
            break
    return np.asarray(factor, dtype=np.float64)


def separating_units(sizes: Matrix) -> Matrix:
    """Return balancing units (k,) of k signals that also make small what couples signals in one direction only.

    No loop passes such a coupling, so no bound of the loops need see it, whatever its size.

    Parameters
    ----------
    sizes
        (k, k) gains, none negative, to each signal from each.
    """
    count = len(sizes)
    signals = [slice(i, i + 1) for i in range(count)]
    units = balancing_units(sizes, signals, signals)
    sizes = sizes * units / units[:, None]
    reach: NDArray[np.bool_] = np.eye(count, dtype=bool) | (sizes > 0.0)
    for _ in range(count.bit_length()):
        reach = reach @ reach
    together = reach & reach.T
    one_way = np.where(together, 0.0, sizes)
    loops = float(np.max(sizes, where=together, initial=0.0)) or 1.0
    wanted = np.ceil(np.log2(np.maximum(one_way / (_ONE_WAY * loops), 1.0)))
    exponents = np.zeros(count)
    for _ in signals:
        alone = np.maximum(exponents, np.max(np.where(one_way > 0.0, exponents + wanted, 0.0), axis=1))
        exponents = np.max(np.where(together, alone, 0.0), axis=1)
    return np.asarray(units * 2.0 ** np.minimum(exponents, _MOST))
