"""H-infinity synthesis by two Riccati equations: the least level, and the central controller at a stated one."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gustproof.errors import DesignError
from gustproof.numerics.lti import LinearSystem, Lti, Matrix, copied, lft
from gustproof.numerics.norms import hinf_norm
from gustproof.numerics.riccati import RiccatiError, stabilizing_solution
from gustproof.synthesis.conditions import Normalized, normalize

if TYPE_CHECKING:
    import control

_RESOLUTION = 1e-7
"""[-] relative width at which the bisection for the least level stops."""
_SEMIDEFINITE = 1e-9
"""[-] eigenvalues above minus this fraction of the solution's natural size count as not negative: a solution may be
singular or 0, and an indefinite one has left through infinity."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HinfResult:
    """A controller, checked, with the level it was made for and the evidence."""

    controller: Lti
    """Central controller `u = K y` (positive feedback); its states estimate those of P, in the order of P's."""
    gamma_opt: float
    """[-] least level for which a controller exists, to 1e-7 relative, from above."""
    gamma: float
    """[-] level that the controller was made for."""
    norm: float
    """[-] H-infinity norm of the closed loop, computed from it alone; below `gamma`."""
    omega: float
    """[rad/s] frequency of that norm."""
    X: Matrix
    """(n, n) solution of the control Riccati equation at `gamma`."""
    Y: Matrix
    """(n, n) solution of the filter Riccati equation at `gamma`."""

    @property
    def K(self) -> "control.StateSpace":
        """The central controller for python-control, a copy at each call."""
        return self.controller.to_control()

    @property
    def order(self) -> int:
        """Number of controller states."""
        return self.controller.order


class _Solution(NamedTuple):
    """What the two Riccati equations give at one level, in normalised coordinates."""

    X: Matrix
    Y: Matrix
    F: Matrix
    L: Matrix


def hinfsyn(
    P: LinearSystem, n_meas: int, n_con: int, *, gamma: float | None = None, backoff: float = 1.05
) -> HinfResult:
    """Return the central controller that keeps the H-infinity norm from w to z below a level.

    The last `n_meas` outputs of `P` are measured, its last `n_con` inputs are controls. `D11` and `D22` may be
    anything. Cost some 60 Schur forms of order 2n: milliseconds at n = 9.

    Parameters
    ----------
    P
        Continuous generalised plant, inputs (w, u), outputs (z, y).
    n_meas, n_con
        Number of measurements y and controls u.
    gamma
        [-] level to design for; `None` for `backoff` times the least.
    backoff
        [-] > 1. At the least level itself the controller has poles beyond any bound, so it is never used.

    Raises
    ------
    ValueError
        If sizes do not fit, `P` is discrete, or `gamma` or `backoff` is out of range.
    DesignError
        If the problem is ill posed (the failed condition is named), no controller exists at `gamma`, or rounding
        spoilt the controller: one that does not stabilise or exceeds the level is never returned.

    References
    ----------
    K. Glover, J. C. Doyle, State-space formulae for all stabilizing controllers that satisfy an H-infinity norm bound,
    Systems & Control Letters 11 (1988), 167-172. K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control,
    Prentice Hall 1996, Theorem 17.1.
    """
    if gamma is not None and not (np.isfinite(gamma) and gamma > 0.0):
        raise ValueError(f"gamma is {gamma!r}, must be positive")
    if not (np.isfinite(backoff) and backoff > 1.0):
        raise ValueError(f"backoff is {backoff!r}, must be above 1")
    plant = copied(P)
    problem = normalize(plant, n_meas, n_con)
    gamma_opt = _least_level(problem)
    level = backoff * gamma_opt if gamma is None else gamma
    if level <= gamma_opt:
        raise DesignError(f"no controller at gamma = {level:.6g}: the least level is {gamma_opt:.6g}")
    solution = _solve(problem, level)
    K = _central(problem, solution, level)
    peak = hinf_norm(lft(plant, K))
    if not peak.gain < level:
        raise DesignError(f"rounding spoilt the controller at gamma = {level:.6g}: its norm is {peak.gain:.6g}")
    return HinfResult(
        controller=K,
        gamma_opt=gamma_opt,
        gamma=level,
        norm=peak.gain,
        omega=peak.omega,
        X=solution.X,
        Y=solution.Y,
    )


def _least_level(problem: Normalized) -> float:
    """Return the least feasible level, from above, by bisection on a logarithmic scale."""
    floor = problem.floor
    high = max(1.0, 2.0 * floor)
    for _ in range(60):
        if _feasible(problem, high):
            break
        high *= 4.0
    else:
        raise DesignError(f"no controller at any level up to {high:.3g}: the plant is too badly scaled to solve")
    low = high
    for _ in range(60):
        low = max(low / 4.0, floor)
        if low == floor or not _feasible(problem, low):
            break
        high = low
    while high - low > _RESOLUTION * high and high > np.finfo(float).tiny:
        middle = float(np.sqrt(low * high)) if low > 0.0 else 0.5 * high
        low, high = (low, middle) if _feasible(problem, middle) else (middle, high)
    return high


def _feasible(problem: Normalized, gamma: float) -> bool:
    try:
        _solve(problem, gamma)
    except DesignError:
        return False
    return True


def _solve(problem: Normalized, gamma: float) -> _Solution:
    """Return both Riccati solutions and gains at the level `gamma`, or raise with the condition that fails there."""
    A, B, C = problem.A, problem.B, problem.C
    X, F = _half(A, B, C[: problem.p1], problem.D[: problem.p1], problem.m1, gamma)
    Y, Lt = _half(A.T, C.T, B[:, : problem.m1].T, problem.D[:, : problem.m1].T, problem.p1, gamma)
    if np.max(np.abs(np.linalg.eigvals(X @ Y))) >= gamma**2:
        raise DesignError(f"no controller at gamma = {gamma:.6g}: the spectral radius of XY is not below gamma^2")
    return _Solution(X=X, Y=Y, F=F, L=Lt.T)


def _half(A: Matrix, B: Matrix, C1: Matrix, D1: Matrix, m1: int, gamma: float) -> tuple[Matrix, Matrix]:
    """Return `X` and `F` of the control half; the filter half is the same on transposed data."""
    R = D1.T @ D1
    R[:m1, :m1] -= gamma**2 * np.eye(m1)
    S = D1.T @ C1
    RS, RB = np.split(np.linalg.solve(R, np.hstack([S, B.T])), [A.shape[0]], axis=1)
    A_s = A - B @ RS
    H = np.block([[A_s, -B @ RB], [-(C1.T @ C1 - S.T @ RS), -A_s.T]])
    try:
        X = stabilizing_solution(H)
    except RiccatiError as error:
        raise DesignError(f"no controller at gamma = {gamma:.6g}: {error}") from None
    eigenvalues = np.linalg.eigvalsh(X)
    natural_size = np.linalg.norm(C1, 2) ** 2 / np.linalg.norm(A, 2) if np.any(A) else 1.0
    if eigenvalues[0] < -_SEMIDEFINITE * max(eigenvalues[-1], natural_size):
        raise DesignError(f"no controller at gamma = {gamma:.6g}: a Riccati solution is not positive semidefinite")
    return X, -(RS + RB @ X)


def _central(problem: Normalized, solution: _Solution, gamma: float) -> Lti:
    """Return the central controller in the plant's own coordinates, states, inputs and outputs.

    Zhou, Doyle and Glover, Theorem 17.1, with the free parameter Q = 0 and the names of that theorem.
    """
    m1, p1, m2, p2 = problem.m1, problem.p1, problem.m2, problem.p2
    A, B, C, F, L = problem.A, problem.B, problem.C, solution.F, solution.L
    D1111, D1112 = problem.D[: p1 - m2, : m1 - p2], problem.D[: p1 - m2, m1 - p2 : m1]
    D1121, D1122 = problem.D[p1 - m2 : p1, : m1 - p2], problem.D[p1 - m2 : p1, m1 - p2 : m1]
    F12, F2 = F[m1 - p2 : m1], F[m1:]
    L12, L2 = L[:, p1 - m2 : p1], L[:, p1:]
    B2, C2 = B[:, m1:], C[p1:]
    Z = np.linalg.inv(np.eye(A.shape[0]) - solution.Y @ solution.X / gamma**2)
    inner = gamma**2 * np.eye(p1 - m2) - D1111 @ D1111.T
    D_hat = -D1121 @ D1111.T @ np.linalg.solve(inner, D1112) - D1122
    B_hat = Z @ ((B2 + L12) @ D_hat - L2)
    C_hat = F2 - D_hat @ (C2 + F12)
    A_hat = A + B @ F - B_hat @ (C2 + F12)
    normalized = Lti(A=A_hat, B=B_hat, C=C_hat, D=D_hat)
    return problem.in_plant_units(normalized)
