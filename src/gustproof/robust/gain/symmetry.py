"""Mirror symmetries of an uncertain loop: sign changes of signals and parameters that leave it unchanged."""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gustproof.robust.lti.state_space import Matrix
from gustproof.robust.uncertain.uncertain_system import Uncertain

_ZERO_TOLERANCE = 1e-9
"""[-] size below which an entry of the loop's matrices counts as 0, a coupling left by rounding. Symmetry only saves
the solver work; no proof rests on it."""


class Mirror(NamedTuple):
    """Signs of a symmetry, each -1 or 1: `F_u(M, signed delta)` maps the signed inputs to the signed outputs."""

    x: Matrix
    """(n,) of the states."""
    p: Matrix
    """(k,) of Delta's outputs."""
    q: Matrix
    """(k,) of Delta's inputs."""
    w: Matrix
    """(m,) of the inputs."""
    delta: tuple[int, ...]
    """Signs of the blocks' parameters."""


def mirror_group(loop: Uncertain) -> list[Mirror]:
    """Return the group of the mirror symmetries of `loop`, identity included.

    Each nonzero entry of M requires equal signs of its input and output: linear equations of bits, solved by
    elimination. Input and output of a block differ by the sign of its parameter.
    """
    M, k = loop.M, loop.n_w
    n, m, z = M.order, M.n_inputs - k, M.n_outputs - k
    owner = np.repeat(np.arange(len(loop.blocks)), [block.shape[0] for block in loop.blocks])
    unit = np.eye(n + k + m + z + len(loop.blocks), dtype=np.int64)
    x, q, w, out, delta = np.split(unit, np.cumsum([n, k, m, z]))
    inputs, outputs = np.vstack([x, q + delta[owner], w]), np.vstack([x, q, out])
    rows, columns = np.nonzero(np.abs(np.block([[M.A, M.B], [M.C, M.D]])) > _ZERO_TOLERANCE)
    basis = _null_space((outputs[rows] + inputs[columns]) % 2)
    found = []
    for chosen in product((0, 1), repeat=len(basis)):
        signs = 1 - 2 * (np.array(chosen, dtype=np.int64) @ basis % 2)
        s_x, s_q, s_w, _, s_delta = np.split(signs, np.cumsum([n, k, m, z]))
        found.append(Mirror(x=s_x, p=s_q * s_delta[owner], q=s_q, w=s_w, delta=tuple(s_delta.tolist())))
    return found


def _null_space(equations: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a basis, by rows, of the vectors of bits that satisfy all `equations`, modulo 2."""
    E: NDArray[np.int64] = np.unique(equations, axis=0)
    pivots: list[int] = []
    for column in range(E.shape[1]):
        below = np.flatnonzero(E[len(pivots) :][:, column]) + len(pivots)
        if not below.size:
            continue
        row = len(pivots)
        E[[row, below[0]]] = E[[below[0], row]]
        others = np.flatnonzero(E[:, column])
        E[others[others != row]] ^= E[row]
        pivots.append(column)
    free = [column for column in range(E.shape[1]) if column not in pivots]
    basis = np.zeros((len(free), E.shape[1]), dtype=np.int64)
    for vector, column in zip(basis, free, strict=True):
        vector[column] = 1
        vector[pivots] = E[: len(pivots), column]
    return basis
