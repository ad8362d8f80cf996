"""Reduce the order of a linear system by balancing, with a bound of the error that the result is checked against."""

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
import scipy

from gustproof.errors import DesignError
from gustproof.robust.lti.balancing import balance_states, balanced_realization
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, all_or_none, as_lti, signal_names
from gustproof.robust.shown import Shown

if TYPE_CHECKING:
    import control

_AXIS = 1e-10
"""[-] distance from the stability boundary, relative to the fastest pole, below which a pole counts as unstable."""
_ROUNDING = 1e-9
"""[-] excess of the error over its bound that counts as rounding, relative to the largest singular value."""


class Reduction(StrEnum):
    """State elimination of the weak part of a balanced system."""

    TRUNCATE = "truncate"
    """Weak states are 0: the error vanishes at infinite frequency, or for a discrete system nowhere."""
    MATCH = "match"
    """Weak states are at rest (singular perturbation): the error vanishes at zero frequency."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ReducedSystem(Shown):
    """A reduced system with its error.

    Examples
    --------
    >>> from control import ss, tf
    >>> from gustproof import balred
    >>> result = balred(ss(tf([1, 11], [1, 11, 10])), 1)
    >>> f"order {result.order}, error {result.error:.4f}, at most {result.bound:.4f}"
    'order 1, error 0.0075, at most 0.0075'
    """

    system: "control.StateSpace"
    """The system of lower order, its signals named as before: states of the stable part, then those kept."""
    hankel: Matrix
    """(k,) Hankel singular values of the stable part, descending."""
    kept: int
    """Number of states that are unstable, or on the stability boundary, and kept."""
    bound: float
    """[-] twice the sum of the distinct singular values left out: bound of the error."""
    error: float
    """[-] H-infinity norm of the difference, computed from its stable part."""

    @property
    def order(self) -> int:
        """Number of states left."""
        return int(self.system.nstates)

    def lines(self) -> list[str]:
        """Return its order, the error and the first singular values."""
        values = ", ".join(f"{value:.3g}" for value in self.hankel[:6])
        more = f" and {len(self.hankel) - 6} more" if len(self.hankel) > 6 else ""
        error = f"error: {self.error:.4g}, at most {self.bound:.4g}"
        return [
            f"ReducedSystem: {self.order} state{'s' * (self.order != 1)}, {self.kept} of them unstable",
            error,
            f"Hankel: {values}{more}",
        ]


def balred(G: LinearSystem, order: int, *, method: Reduction | str = Reduction.TRUNCATE) -> ReducedSystem:
    """Return a system of lower order by balancing, continuous or discrete (MATLAB: `balred`).

    Unstable states, and those on the stability boundary, are kept; the stable part is balanced and loses its weakest
    states. The H-infinity norm of the difference is computed and checked against the bound. Gramians are found in
    factored form, so that small singular values keep their digits. States that nothing reaches or sees are dropped as
    well: the result may have less than `order` states. `simplify` reduces uncertain systems, without error.

    Parameters
    ----------
    G
        System of n states.
    order
        Number of states to leave, from those kept to n.
    method
        "truncate", or "match" to keep the gain at zero frequency.

    Raises
    ------
    ValueError
        If `method` is unknown, or `order` is above n or below the number of states that must be kept.
    DesignError
        If the stable and the kept poles can not be separated, the system is too badly scaled, or the error exceeds its
        bound: rounding dominates.

    References
    ----------
    K. Glover, All optimal Hankel-norm approximations of linear multivariable systems and their L-infinity error bounds,
    Int. J. Control 39 (1984), 1115-1193, Theorem 9.6. U. M. Al-Saggaf, G. F. Franklin, An error bound for a discrete
    reduced order model, IEEE TAC 32 (1987), 815-819. Y. Liu, B. D. O. Anderson, Singular perturbation approximation of
    balanced systems, Int. J. Control 50 (1989), 1379-1405.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import balred
    >>> G = ss([[-1.0, 0.1], [0.0, -50.0]], [[1.0], [1.0]], [[1.0, 1.0]], 0.0)
    >>> result = balred(G, 1, method="match")
    >>> f"error {result.error:.3f}, at most {result.bound:.3f}"
    'error 0.018, at most 0.018'
    """
    system, how = balance_states(as_lti(G)), _method(method)
    stable, rest = _split(system)
    if not rest.order <= order <= system.order:
        raise ValueError(f"order is {order}, must be from {rest.order} (states that are kept) to {system.order}")
    try:
        with np.errstate(over="raise", invalid="raise"):
            balanced, hankel = balanced_realization(stable)
            size = min(order - rest.order, balanced.order)
            reduced = _eliminate(balanced, size, how)
        error = hinf_norm(_add(stable, -reduced)).gain if stable.order else 0.0
    except (np.linalg.LinAlgError, ArithmeticError, ValueError) as problem:
        raise DesignError(f"the system is too badly scaled to reduce: {problem}") from None
    bound = 2.0 * float(np.sum(hankel[size:]))
    scale = float(np.max(hankel, initial=0.0))
    if not error <= bound * (1.0 + _ROUNDING) + _ROUNDING * scale:
        raise DesignError(f"rounding spoilt the reduction: its error is {error:.6g}, above the bound {bound:.6g}")
    kinds = zip(("inputs", "outputs"), map(all_or_none, signal_names(G)), strict=True)
    small = _add(reduced, rest).to_control(**{kind: list(names) for kind, names in kinds if names})
    return ReducedSystem(system=small, hankel=hankel, kept=rest.order, bound=bound, error=error)


def _method(method: Reduction | str) -> Reduction:
    if method not in tuple(Reduction):
        raise ValueError(f"method is '{method}', must be {' or '.join(Reduction)}")
    return Reduction(method)


def _add(first: Lti, second: Lti) -> Lti:
    """Return the parallel connection."""
    A, B = scipy.linalg.block_diag(first.A, second.A), np.vstack([first.B, second.B])
    return Lti(A=A, B=B, C=np.hstack([first.C, second.C]), D=first.D + second.D, dt=first.dt)


def _split(G: Lti) -> tuple[Lti, Lti]:
    """Return the stable part with the feedthrough, and the rest; their sum is `G`."""
    if not G.order:
        return G, Lti(A=G.A, B=G.B, C=G.C, D=0.0 * G.D, dt=G.dt)
    poles = G.poles()
    edge = 1.0 - _AXIS if G.dt else -_AXIS * float(np.abs(poles).max())

    def is_stable(real: float, imaginary: float) -> bool:
        return bool(np.hypot(real, imaginary) < edge) if G.dt else real < edge

    T, U, k = scipy.linalg.schur(G.A, output="real", sort=is_stable)
    coupling = scipy.linalg.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
    B, C = U.T @ G.B, G.C @ U
    parts = (
        Lti(A=T[:k, :k], B=B[:k] - coupling @ B[k:], C=C[:, :k], D=G.D, dt=G.dt),
        Lti(A=T[k:, k:], B=B[k:], C=C[:, k:] + C[:, :k] @ coupling, D=0.0 * G.D, dt=G.dt),
    )
    if not parts[0].is_stable():
        raise DesignError("the stable and the other poles are too close to be separated")
    return parts


def _eliminate(G: Lti, size: int, method: Reduction) -> Lti:
    """Return a balanced system with its first `size` states."""
    A, B, C = G.A, G.B, G.C
    if method is Reduction.TRUNCATE or size == G.order:
        return Lti(A=A[:size, :size], B=B[:size], C=C[:, :size], D=G.D, dt=G.dt)
    at_rest = np.linalg.inv((np.eye(G.order - size) if G.dt else 0.0) - A[size:, size:])
    kept, lost = slice(size), slice(size, None)
    return Lti(
        A=A[kept, kept] + A[kept, lost] @ at_rest @ A[lost, kept],
        B=B[kept] + A[kept, lost] @ at_rest @ B[lost],
        C=C[:, kept] + C[:, lost] @ at_rest @ A[lost, kept],
        D=G.D + C[:, lost] @ at_rest @ B[lost],
        dt=G.dt,
    )
