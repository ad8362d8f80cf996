"""H2 synthesis by two Riccati equations: the controller of the least rms output."""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from gustproof.errors import DesignError
from gustproof.robust.hinf.channels import PlantUnits, solve_in_best_units
from gustproof.robust.hinf.checked_controller import ROUNDING_ERRORS, CheckedController, keep_names, tell_by_names
from gustproof.robust.hinf.conditions import normalize, require_sizes
from gustproof.robust.hinf.regularization import solve_or_regularize
from gustproof.robust.hinf.riccati_half import riccati_data, solve_riccati
from gustproof.robust.lti.norms import h2_norm
from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, as_lti, gain, lft, part

_AGREEMENT = 1e-6
"""[-] by which the norm of the closed loop may exceed what the Riccati equations say."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class H2Result(CheckedController):
    """A checked controller; `norm` is the H2 norm of its loop, `omega` is nan, as an H2 norm has no frequency.

    Its states estimate those of P, in the order of P's. `gamma` is the least norm of any controller, from the Riccati
    equations; of the regularised plant if `P` is singular.
    """

    X: Matrix
    """(n, n) solution of the control Riccati equation."""
    Y: Matrix
    """(n, n) solution of the filter Riccati equation."""
    regularization: float = 0.0
    """[-] weight of the controls, states and noise added to a singular plant; 0 if there was no need."""
    gamma_excess: float = 0.0
    """[-] estimate of how much the regularisation adds to `gamma`; infinite if rounding hides it."""


def h2syn(P: LinearSystem, n_meas: int, n_con: int, *, regularize: bool = False) -> H2Result:
    """Return the controller with the least H2 norm from w to z: LQG for white noise w of unit density.

    The last `n_meas` outputs of `P` are measured, its last `n_con` inputs are controls. `D22` is arbitrary, `D11` must
    be 0 in continuous time. There, badly scaled plants and zeros near the axis are treated as in `hinfsyn`. A sampled
    controller uses the measurement of its own sample, so it has a feedthrough.

    Parameters
    ----------
    P
        Generalised plant, continuous or discrete, inputs (w, u), outputs (z, y).
    n_meas, n_con
        Number of measurements y and controls u.
    regularize
        True to solve a singular continuous problem with small weights and noise, as in `hinfsyn`.

    Raises
    ------
    ValueError
        If sizes do not fit, or a discrete `P` is to be regularised.
    SingularProblemError
        If D12 or D21 lacks rank or there is a zero on the imaginary axis, and `regularize` is False.
    DesignError
        If `D11` is not 0, a mode cannot be stabilised or detected, or rounding spoilt the controller.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, Prentice Hall 1996, Theorem 14.7. T. Chen,
    B. A. Francis, Optimal Sampled-Data Control Systems, Springer 1995, chapter 6.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import h2syn
    >>> plant = ss([[1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> result = h2syn(plant, n_meas=1, n_con=1)
    >>> f"least norm {result.gamma:.3f}, that of the loop {result.norm:.3f}"
    'least norm 4.060, that of the loop 4.060'
    """
    plant = as_lti(P)
    require_sizes(plant, n_meas, n_con)
    if plant.dt and regularize:
        raise ValueError("P is discrete: its weights and noise are not made up, give them in D12 and D21")
    if not plant.dt and np.any(plant.D[:-n_meas, :-n_con]):
        raise DesignError("D11 is not 0: white noise passes from w to z, and the H2 norm is infinite")
    try:
        with tell_by_names(P, n_meas, n_con):
            return keep_names(_solve_plant(plant, (n_meas, n_con), regularize=regularize), P)
    except ROUNDING_ERRORS as error:
        raise DesignError(f"the plant is too badly scaled to solve: {error}") from None


def _solve_plant(plant: Lti, sizes: tuple[int, int], *, regularize: bool) -> H2Result:
    if plant.dt:
        return _solve_discrete(plant, *sizes)

    def solve(image: Lti, units: PlantUnits) -> H2Result:
        return solve_in_best_units(image, *sizes, lambda scaled, more: _solve(plant, scaled, units * more))

    result, weight, excess = solve_or_regularize(
        plant, sizes, solve, lambda result: result.gamma, regularize=regularize
    )
    return replace(result, regularization=weight, gamma_excess=excess)


def _solve_discrete(plant: Lti, n_meas: int, n_con: int) -> H2Result:
    """Return the controller by two discrete Riccati equations, which D12 of full column and D21 of full row rank need.

    F and F0 are the best answer to state and disturbance, L and L0 the gains of the filter.
    """
    P = part(plant, n_meas, n_con)
    A, B1, B2, C1, C2, D11, D12, D21 = P.A, P.B1, P.B2, P.C1, P.C2, P.D11, P.D12, P.D21
    try:
        X, Y = (
            np.asarray(scipy.linalg.solve_discrete_are(*equation), dtype=np.float64)
            for equation in (
                (A, B2, C1.T @ C1, D12.T @ D12, None, C1.T @ D12),
                (A.T, C2.T, B1 @ B1.T, D21 @ D21.T, None, B1 @ D21.T),
            )
        )
    except (np.linalg.LinAlgError, ValueError) as failure:
        raise DesignError(
            "no stabilising Riccati solution: P must be stabilisable by u and detectable from y, no zero from u to "
            f"z or from w to y may be on the unit circle ({failure})"
        ) from None
    R_u, R_y = D12.T @ D12 + B2.T @ X @ B2, D21 @ D21.T + C2 @ Y @ C2.T
    F, F0 = (-np.linalg.solve(R_u, B2.T @ X @ first + D12.T @ last) for first, last in ((A, C1), (B1, D11)))
    L = -np.linalg.solve(R_y, (A @ Y @ C2.T + B1 @ D21.T).T).T
    L0 = np.asarray(np.linalg.solve(R_y, (F @ Y @ C2.T + F0 @ D21.T).T).T, dtype=np.float64)
    told = np.trace(D11.T @ D11 + B1.T @ X @ B1 - F0.T @ R_u @ F0)
    hidden = np.trace(R_u @ (F @ Y @ F.T + F0 @ F0.T - L0 @ R_y @ L0.T))
    gamma = float(np.sqrt(max(told + hidden, 0.0)))
    K = Lti(
        A=A + B2 @ F + L @ C2 - B2 @ L0 @ C2,
        B=B2 @ L0 - L,
        C=F - L0 @ C2,
        D=L0,
        dt=plant.dt,
    )
    try:
        K = lft(_with_feedthrough(K, -P.D22), gain(np.eye(n_meas), plant.dt)) if P.D22.any() else K
        norm = h2_norm(lft(plant, K))
    except ValueError as failure:
        raise DesignError(f"rounding spoilt the controller: {failure}") from None
    if not norm <= (1.0 + _AGREEMENT) * gamma:
        raise DesignError(f"rounding spoilt the controller: its norm is {norm:.6g}, not {gamma:.6g}")
    checks = ("the loop of the given plant is stable", "its norm is that of the Riccati equations, or below")
    return H2Result(lti=K, gamma=max(gamma, norm), norm=norm, omega=np.nan, checks=checks, X=X, Y=Y)


def _with_feedthrough(K: Lti, D: Matrix) -> Lti:
    """Return the system from (y, e) to (u, y + D u), where u = K e."""
    n, (m, p) = K.order, K.D.shape
    B, C = np.hstack([np.zeros((n, p)), K.B]), np.vstack([K.C, D @ K.C])
    direct = np.block([[np.zeros((m, p)), K.D], [np.eye(p), D @ K.D]])
    return Lti(A=K.A, B=B, C=C, D=direct, dt=K.dt)


def _solve(plant: Lti, image: Lti, units: PlantUnits) -> H2Result:
    """Return the controller of an image of the plant in `units`, with the norm of the loop that it closes."""
    problem = normalize(image, units.y.size, units.u.size)
    A, B, C, D, m1, p1 = problem.A, problem.B, problem.C, problem.D, problem.m1, problem.p1
    B1, B2, C1, C2, D12, D21 = B[:, :m1], B[:, m1:], C[:p1], C[p1:], D[:p1, m1:], D[p1:, :m1]
    # without w among the inputs, the equations of the H-infinity problem are those of this one, at any level
    X, F, _ = solve_riccati(riccati_data(A, B2, C1, D12, 0, problem.control_zeros), 1.0)
    Y, Lt, _ = solve_riccati(riccati_data(A.T, C2.T, B1.T, D21.T, 0, problem.filter_zeros), 1.0)
    gamma = float(np.sqrt(max(np.trace(B1.T @ X @ B1) + np.trace(F @ Y @ F.T), 0.0)))
    K = problem.to_plant_units(A + B2 @ F + Lt.T @ C2, -Lt.T, F, np.zeros((problem.m2, problem.p2)))
    try:
        norm = h2_norm(lft(units.apply(plant, K.n_inputs, K.n_outputs), K))
    except ValueError as failure:
        raise DesignError(f"rounding spoilt the controller: {failure}") from None
    if not norm <= (1.0 + _AGREEMENT) * gamma:
        raise DesignError(f"rounding spoilt the controller: its norm is {norm:.6g}, not {gamma:.6g}")
    back = units.x[:, None] * units.x
    checks = ("the loop of the given plant is stable", "its norm is that of the Riccati equations, or below")
    return H2Result(
        lti=units.restore(K),
        gamma=max(gamma, norm),
        norm=norm,
        omega=np.nan,
        checks=checks,
        X=X / back,
        Y=Y * back,
    )
