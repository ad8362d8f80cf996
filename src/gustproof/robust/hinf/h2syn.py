"""H2 synthesis by two Riccati equations: the controller of the least rms output."""

from dataclasses import dataclass, replace

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.hinf.channels import PlantUnits, solve_in_best_units
from gustproof.robust.hinf.checked_controller import ROUNDING_ERRORS, CheckedController
from gustproof.robust.hinf.conditions import normalize, require_sizes
from gustproof.robust.hinf.regularization import solve_or_regularize
from gustproof.robust.hinf.riccati_half import riccati_data, solve_riccati
from gustproof.robust.lti.norms import h2_norm
from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, as_continuous, lft

_AGREEMENT = 1e-6
"""[-] by which the norm of the closed loop may exceed what the Riccati equations say."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
    be 0. Badly scaled plants and zeros near the imaginary axis are treated as in `hinfsyn`.

    Parameters
    ----------
    P
        Continuous generalised plant, inputs (w, u), outputs (z, y).
    n_meas, n_con
        Number of measurements y and controls u.
    regularize
        True to solve a singular problem with small weights and noise, as in `hinfsyn`.

    Raises
    ------
    ValueError
        If sizes do not fit or `P` is discrete.
    SingularProblemError
        If D12 or D21 lacks rank or there is a zero on the imaginary axis, and `regularize` is False.
    DesignError
        If `D11` is not 0, a mode cannot be stabilised or detected, or rounding spoilt the controller.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, Prentice Hall 1996, Theorem 14.7.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import h2syn
    >>> plant = ss([[1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> result = h2syn(plant, n_meas=1, n_con=1)
    >>> f"least norm {result.gamma:.3f}, that of the loop {result.norm:.3f}"
    'least norm 4.060, that of the loop 4.060'
    """
    plant = as_continuous("P", P)
    require_sizes(plant, n_meas, n_con)
    if np.any(plant.D[:-n_meas, :-n_con]):
        raise DesignError("D11 is not 0: white noise passes from w to z, and the H2 norm is infinite")
    try:
        return _solve_plant(plant, (n_meas, n_con), regularize=regularize)
    except ROUNDING_ERRORS as error:
        raise DesignError(f"the plant is too badly scaled to solve: {error}") from None


def _solve_plant(plant: Lti, sizes: tuple[int, int], *, regularize: bool) -> H2Result:
    def solve(image: Lti, units: PlantUnits) -> H2Result:
        return solve_in_best_units(image, *sizes, lambda scaled, more: _solve(plant, scaled, units * more))

    result, weight, excess = solve_or_regularize(
        plant, sizes, solve, lambda result: result.gamma, regularize=regularize
    )
    return replace(result, regularization=weight, gamma_excess=excess)


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
        controller=units.restore(K),
        gamma=max(gamma, norm),
        norm=norm,
        omega=np.nan,
        checks=checks,
        X=X / back,
        Y=Y * back,
    )
