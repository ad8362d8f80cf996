"""The margin of a system with one real parameter, from one eigenvalue problem: exact up to rounding."""

import math

import numpy as np
import scipy

from gustproof.robust.lti.norms import eigenvalues
from gustproof.robust.lti.state_space import Lti, Matrix, is_singular
from gustproof.robust.mu.sweep import Bracket
from gustproof.robust.uncertain.uncertainty import RealBlock

_MOST_EQUATIONS = 400
"""Largest number of states times repetitions; beyond it the eigenvalue problem takes minutes."""
_REAL = 1e-6
"""[-] imaginary part, relative, below which an eigenvalue counts as real; the upper bound is raised by as much."""
_ROUNDING = 1e-9
"""[-] relative amount by which the lower bound is lowered."""
_ON_AXIS = 1e-6
"""[-] real part, relative to the size of `A`, below which a pole counts as on the axis."""


def one_parameter_margin(M: Lti, block: RealBlock) -> Bracket | None:
    """Return mu of a continuous, stable `M` with one real parameter; `None` if it is large or rounding dominates.

    Two poles `p` and `-p` at the closed `A(delta)` make `X -> A(delta) X + X A(delta)'` singular for symmetric X. This
    map is an LFT in delta, so such delta are the inverses of real eigenvalues of one matrix. The bound of scalings is
    far above mu here, which jumps from 0 at single frequencies.

    References
    ----------
    L. Qiu, E. J. Davison, The stability robustness determination of state space models with real unstructured
    perturbations, Mathematics of Control, Signals, and Systems 4 (1991), 247-267 (the symmetric Kronecker sum).
    """
    n, r = M.order, block.repeats
    if n * r > _MOST_EQUATIONS:
        return None
    values = np.linalg.eigvals(M.D)
    if n:
        values = np.append(values, np.linalg.eigvals(_singular_map(M)))
    real = values[np.abs(values.imag) <= _REAL * np.abs(values)].real
    real = real[np.argsort(-np.abs(real))]
    upper = (1.0 + _REAL) * float(np.max(np.abs(real), initial=0.0))
    floor = 1e-12 * float(np.max(np.abs(values), initial=0.0))
    for size in real[np.abs(real) > floor]:
        omega = _crossing(M, 1.0 / size)
        if omega is not None:
            found = Bracket(
                lower=(1.0 - _ROUNDING) * abs(float(size)),
                upper=upper,
                omega=omega,
                delta={block.name: 1.0 / float(size)},
            )
            return found if abs(size) > (1.0 - 1e-3) * upper else None
    return None if upper > floor else Bracket(lower=0.0, upper=upper, omega=0.0, delta={})


def _singular_map(M: Lti) -> Matrix:
    """Return the matrix of `Y -> D Y + C X` with `A X + X A' + B Y + Y' B' = 0`, Y (r, n) row by row."""
    n, r = M.order, M.n_inputs
    # in Schur's coordinates each equation is a substitution
    T, U = scipy.linalg.schur(M.A.astype(np.complex128), output="complex")
    B, C = U.conj().T @ M.B, M.C @ U
    sums = np.zeros((n * r, n * r), dtype=np.complex128)
    for k, unit in enumerate(np.eye(n * r).reshape(-1, r, n)):
        driven = B @ unit @ U
        X, scale, _ = scipy.linalg.lapack.ztrsyl(T, T, -(driven + driven.conj().T), tranb="C")
        sums[:, k] = (M.D @ unit + C @ X @ U.conj().T / scale).ravel()
    return sums.real


def _crossing(M: Lti, delta: float) -> float | None:
    """Return the frequency [rad/s] of a pole on the axis at `delta`; infinite if the loop has no solution there."""
    loop = np.eye(M.n_outputs) - delta * M.D
    if is_singular(loop, np.eye(M.n_outputs) + np.abs(delta * M.D)):
        return math.inf
    poles = eigenvalues(M.A + delta * M.B @ np.linalg.solve(loop, M.C))
    near = poles[np.argmin(np.abs(poles.real))]
    return float(abs(near.imag)) if abs(near.real) <= _ON_AXIS * np.linalg.norm(M.A, 2) else None
