"""H-infinity synthesis by two Riccati equations: the least level, and the central controller at a stated one."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgeev

from gustproof.errors import DesignError
from gustproof.robust.hinf.channels import PlantUnits, solve_in_best_units
from gustproof.robust.hinf.checked_controller import ROUNDING_ERRORS, CheckedController, keep_names, tell_by_names
from gustproof.robust.hinf.closed_loop import loop_norm
from gustproof.robust.hinf.conditions import NormalizedPlant, normalize, require_sizes
from gustproof.robust.hinf.discrete_image import continuous_image, discrete_original
from gustproof.robust.hinf.regularization import solve_or_regularize
from gustproof.robust.hinf.riccati_half import RiccatiData, has_no_solution, riccati_data, solve_riccati
from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, as_lti

_RESOLUTION = 1e-7
"""[-] relative width at which the bisection for the least level stops."""
_TOLD = 5e-5
"""[-] relative distance below the least level at which it must be clear that there is no controller."""
_HIGHER = (1.001, 1.003, 1.01, 1.03, 1.1, 1.3, 2.0, 4.0)
"""[-] factors on the backoff that are tried where rounding spoilt a controller: a level nearby may be spared, and
controllers of higher levels stand more of it."""
_NEAR_ZERO = 1e-6
"""[-] part of the size of P below which a least level is 0 or rounding."""
_SMALLEST_LEVEL = 1e-30
"""[-] the search for the least level stops here if a controller still exists."""
_LARGEST_LEVEL = 1e100
"""[-] largest level that can be stated: some of its powers are computed."""
_PATIENCE = 3
"""Number of steps without a Riccati solution, or of slow ones in turn, after which brackets are only halved."""
_BEYOND_MISS = 0.1
"""[-] part of the bracket that is stepped over after a step to where there is no Riccati solution."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class HinfResult(CheckedController):
    """A checked controller with its level and the evidence.

    The central controller's states estimate those of P, in the order of P's. `norm` is an H-infinity norm.

    Examples
    --------
    >>> from gustproof import design_problem, hinfsyn, load_design, load_vehicle
    >>> problem = design_problem(load_design("D1"), load_vehicle("paper"))
    >>> result = hinfsyn(problem.plant(), problem.n_meas, problem.n_con)
    >>> result.norm <= result.gamma
    True
    """

    gamma_opt: float
    """[-] least level for which a controller exists, to 1e-7 relative, from above; of the regularised plant if `P` is
    singular. Levels below 1e-6 of the size of P may be rounding of 0."""
    X: Matrix
    """(n, n) solution of the control Riccati equation at the level designed for; of the bilinear image of a discrete P.
    That level is `gamma`, or half way down to `gamma_opt` where rounding spoilt the controller of a stated one."""
    Y: Matrix
    """(n, n) solution of the filter Riccati equation at `gamma`."""
    norm_error: float = 0.0
    """[-] bound of the rounding of `norm`: what the gain at `omega` moves by if each number of the loop is rounded."""
    regularization: float = 0.0
    """[-] weight of the controls, states and noise added to a singular plant; 0 if there was no need."""
    gamma_excess: float = 0.0
    """[-] estimate of how much the regularisation adds to `gamma_opt`; infinite if rounding hides it."""


class _Solution(NamedTuple):
    """Solutions of the two Riccati equations at one level, in normalised coordinates."""

    X: Matrix
    Y: Matrix
    F: Matrix
    L: Matrix
    definite: bool
    """True if neither solution has a negative eigenvalue."""
    margin: float
    """[-] `gamma^2 / rho(XY) - 1`, positive if and only if a controller exists. Nearly linear in the level, also where
    a solution becomes indefinite through infinity: rho then has the sign of the eigenvalue that passed through it."""


def hinfsyn(
    P: LinearSystem,
    n_meas: int,
    n_con: int,
    *,
    gamma: float | None = None,
    backoff: float = 1.05,
    regularize: bool = False,
) -> HinfResult:
    """Return the central controller that keeps the H-infinity norm from w to z below a level.

    The last `n_meas` outputs of `P` are measured, its last `n_con` inputs are controls. `D11` and `D22` are arbitrary.
    A badly scaled plant is solved in units of powers of two. Zeros near the imaginary axis are split off the Riccati
    equations. A discrete plant is mapped by the bilinear transformation. The returned loop's norm is always computed
    from `P` itself, as it was given.

    Parts of the plant not joined by any path of coefficients are not joined in the controller either: exact zeros.
    Cost: some 25 Schur forms of order 2n, milliseconds at n = 9.

    Parameters
    ----------
    P
        Generalised plant, continuous or discrete, inputs (w, u), outputs (z, y).
    n_meas, n_con
        Number of measurements y and controls u.
    gamma
        [-] level to keep below; `None` for `backoff` times the least. If rounding spoils its controller, that of a
        level half way down to the least is taken.
    backoff
        [-] > 1. At the least level itself the controller's poles are unbounded, so it is never used. If rounding spoils
        the controller, up to four times as much is taken, or 1e-6 of the size of P if the least level is below that.
    regularize
        True to solve a singular problem: D12 or D21 without full rank, or a zero on the imaginary axis. Small weights
        on controls and states, and small noise on states and measurements, only raise the norm of a loop. They fall by
        tens until the least level falls no more; `regularization` and `gamma_excess` tell the last and its cost.

    Raises
    ------
    ValueError
        If sizes do not fit, or `gamma` or `backoff` is out of range.
    SingularProblemError
        If D12 or D21 lacks rank or there is a zero on the imaginary axis, and `regularize` is False.
    DesignError
        If a mode cannot be stabilised or detected, no controller exists at `gamma`, or rounding spoilt the controller.
        The text names the failed condition. A controller that does not keep its level is never returned.

    References
    ----------
    K. Glover, J. C. Doyle, State-space formulae for all stabilizing controllers that satisfy an H-infinity norm bound,
    Systems & Control Letters 11 (1988), 167-172. K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control,
    Prentice Hall 1996, Theorem 17.1.

    Examples
    --------
    >>> from gustproof import design_problem, hinfsyn, load_design, load_vehicle
    >>> problem = design_problem(load_design("D1"), load_vehicle("paper"))
    >>> result = hinfsyn(problem.plant(), problem.n_meas, problem.n_con, backoff=1.05)
    >>> f"least level {result.gamma_opt:.4f}, {result.order} states"
    'least level 0.2136, 9 states'
    """
    if gamma is not None and not 0.0 < gamma <= _LARGEST_LEVEL:
        raise ValueError(f"gamma is {gamma!r}, must be positive, at most {_LARGEST_LEVEL:g}")
    if not (np.isfinite(backoff) and backoff > 1.0):
        raise ValueError(f"backoff is {backoff!r}, must be above 1")
    plant = as_lti(P)
    require_sizes(plant, n_meas, n_con)
    design = _Design(plant=plant, n_meas=n_meas, n_con=n_con, gamma=gamma, backoff=backoff)
    try:
        with tell_by_names(P, n_meas, n_con):
            return keep_names(design.solve(regularize=regularize), P)
    except ROUNDING_ERRORS as error:
        raise DesignError(f"the plant is too badly scaled to solve: {error}") from None


class _Design(NamedTuple):
    """A plant, as it was given, and the demands on its controller."""

    plant: Lti
    n_meas: int
    n_con: int
    gamma: float | None
    backoff: float

    def solve(self, *, regularize: bool) -> HinfResult:
        """Return the controller of the plant, or of the least regularisation that is useful."""
        result, weight, excess = solve_or_regularize(
            continuous_image(self.plant),
            (self.n_meas, self.n_con),
            self._solve_image,
            lambda result: result.gamma_opt,
            regularize=regularize,
        )
        return replace(result, regularization=weight, gamma_excess=excess) if weight else result

    def _solve_image(self, image: Lti, units: PlantUnits) -> HinfResult:
        """Return the checked controller of an image of the plant in `units`."""
        return solve_in_best_units(
            image, self.n_meas, self.n_con, lambda scaled, more: self._solve(scaled, units * more)
        )

    def _solve(self, image: Lti, units: PlantUnits) -> HinfResult:
        """Return the checked controller at the first level at which rounding does not spoil it."""
        problem = normalize(image, self.n_meas, self.n_con)
        halves = _riccati_halves(problem)
        gamma_opt = _find_least_level(problem, halves)
        is_zero = gamma_opt <= _NEAR_ZERO * problem.size
        if self.gamma is not None and self.gamma <= gamma_opt:
            raise DesignError(f"no controller at gamma = {self.gamma:.6g}: the least level is {gamma_opt:.6g}")
        refusals: list[DesignError] = []
        for level in self._levels(gamma_opt, problem.size):
            if len(refusals) == 1 and not is_zero:
                _require_same_level(image, self.n_meas, self.n_con, gamma_opt)
            try:
                solution = _require_controller(_solve(halves, level))
                K = discrete_original(_decouple(_central_controller(problem, solution, level), image), self.plant)
                return self._check_loop(K, units, gamma_opt, level, solution)
            except (DesignError, ValueError) as failure:
                spoilt = f"rounding spoilt the controller at gamma = {level:.6g}: {failure}"
                refusals.append(DesignError(spoilt))
        raise refusals[0]

    def _levels(self, gamma_opt: float, size: float) -> list[float]:
        """Return levels to try, in order.

        A least level that is nearly 0 for a plant of this `size` may be rounding; the last one tried is not.
        """
        if self.gamma is not None:
            # near the least level the norm is the level itself, up to rounding: half way down leaves room for it
            return [self.gamma, 0.5 * (self.gamma + gamma_opt)]
        levels = [factor * self.backoff * gamma_opt for factor in (1.0, *_HIGHER)]
        last = _NEAR_ZERO * size
        return [*levels, last] if last > levels[-1] else levels

    def _check_loop(self, K: Lti, units: PlantUnits, gamma_opt: float, level: float, solution: _Solution) -> HinfResult:
        """Return a controller with the norm of the loop that it closes; raise if its level is exceeded.

        The units of the loop change neither its norm nor, being powers of two, a digit of it.
        """
        peak, error = loop_norm(units.apply(self.plant, self.n_meas, self.n_con), K)
        most = level if self.gamma is None else self.gamma
        if not peak.gain < most:
            excess = f", {peak.gain - most:.2g} above gamma" if f"{peak.gain:.6g}" == f"{most:.6g}" else ""
            raise DesignError(f"its norm is {peak.gain:.6g}{excess}")
        if not peak.gain + error < most:
            raise DesignError(f"its norm is {peak.gain:.6g} +- {error:.2g}")
        back = units.x[:, None] * units.x
        return HinfResult(
            lti=units.restore(K),
            gamma_opt=gamma_opt,
            gamma=most,
            norm=peak.gain,
            omega=peak.omega,
            checks=("the loop of the given plant is stable", "its norm, from its state space alone, is below gamma"),
            X=solution.X / back,
            Y=solution.Y * back,
            norm_error=error,
        )


def _riccati_halves(problem: NormalizedPlant) -> tuple[RiccatiData, RiccatiData]:
    """Return the data of the control and the filter Riccati equation."""
    A, B, C, D, m1, p1 = problem.A, problem.B, problem.C, problem.D, problem.m1, problem.p1
    return (
        riccati_data(A, B, C[:p1], D[:p1], m1, problem.control_zeros),
        riccati_data(A.T, C.T, B[:, :m1].T, D[:, :m1].T, p1, problem.filter_zeros),
    )


def _find_least_level(problem: NormalizedPlant, halves: tuple[RiccatiData, RiccatiData]) -> float:
    """Return the least level; raise if rounding hides it."""
    gamma_opt, is_crossed = _least_level(halves, problem.floor)
    if not is_crossed and gamma_opt > _NEAR_ZERO * problem.size:
        _require_clear_boundary(halves, gamma_opt, problem.floor)
    return gamma_opt


def _require_same_level(image: Lti, n_meas: int, n_con: int, gamma_opt: float) -> None:
    """Raise if the least level is another one in other coordinates of the states: then it is rounding.

    They are mirrored at a plane, so that each new state is a sum of all.
    """
    v = np.ones((image.order, 1))
    T = np.eye(image.order) - 2.0 / image.order * v @ v.T
    problem = normalize(replace(image, A=T @ image.A @ T, B=T @ image.B, C=image.C @ T), n_meas, n_con)
    other, _ = _least_level(_riccati_halves(problem), problem.floor)
    if abs(other - gamma_opt) > _TOLD * gamma_opt:
        raise DesignError(f"the least level cannot be told: rounding makes it {gamma_opt:.6g} or {other:.6g}")


def _least_level(halves: tuple[RiccatiData, RiccatiData], floor: float) -> tuple[float, bool]:
    """Return the least feasible level, from above, and True if just below it both solutions exist and the margin fails.

    Parabolas and secants converge to the zero of the margin. A step to where there is no solution is followed by one to
    a little above. If steps are slow, the bracket is halved on a logarithmic scale. The same is done if there is no
    zero, because a solution ceases to exist while the margin is positive.
    """
    low, seen = _bracket(halves, floor)
    high, misses, slow, missed = seen[-1][0], 0, 0, False
    while high - low > _RESOLUTION * high and high > _SMALLEST_LEVEL:
        middle, width = max(float(np.sqrt(low * high)), 0.25 * high), high - low
        trusted = misses < _PATIENCE and slow < _PATIENCE
        zero = _find_zero(seen, low, high) if trusted and not missed else np.nan
        level = low + _BEYOND_MISS * width if trusted and missed else middle
        if follows := low < zero < (1.0 + _RESOLUTION) * high:
            # a level within the resolution of an end of the bracket is moved just inside: this closes the bracket
            level = min(max(zero, (1.0 + 0.4 * _RESOLUTION) * low), (1.0 - 0.4 * _RESOLUTION) * high)
        margin = _margin(halves, level)
        low, high = (low, level) if margin > 0.0 else (level, high)
        seen.append((level, margin))
        missed = follows and not np.isfinite(margin)
        misses += missed
        slow = slow + 1 if follows and high - low > 0.5 * width else 0
    return high, bool(np.isfinite(dict(seen).get(low, -np.inf)))


def _bracket(halves: tuple[RiccatiData, RiccatiData], floor: float) -> tuple[float, list[tuple[float, float]]]:
    """Return a level too low, and those tried with their margins: the last one is high enough."""
    low, high = floor, max(1.0, 2.0 * floor)
    seen = [(high, _margin(halves, high))]
    while seen[-1][1] <= 0.0:
        low, high = high, 4.0 * high
        if len(seen) == 60:
            raise DesignError(
                f"no controller at any level up to {low:.3g}: for doubles P is too badly scaled, or too near a plant "
                "that nothing stabilises"
            )
        seen.append((high, _margin(halves, high)))
    return low, seen


def _require_clear_boundary(halves: tuple[RiccatiData, RiccatiData], gamma_opt: float, floor: float) -> None:
    """Raise if it may be rounding that leaves no controller just below the least level."""
    level = (1.0 - _TOLD) * gamma_opt
    if level <= floor or gamma_opt <= _SMALLEST_LEVEL:
        return
    try:
        solution = _solve(halves, level)
        clear = solution.margin <= 0.0
    except DesignError:
        clear = any(has_no_solution(half, level) for half in halves)
    if not clear:
        raise DesignError(
            f"the least level, about {gamma_opt:.6g}, cannot be told: rounding hides on which side of the imaginary "
            "axis a mode or zero of P is"
        )


def _find_zero(seen: list[tuple[float, float]], low: float, high: float) -> float:
    """Return the zero of the curve through the last points of finite margin; nan if there is none.

    `f = 1/rho - s` over `s = 1/level^2`, the margin times s, is smooth but where a solution ceases to exist: there it
    ends like a square root. Its inverse, s over f, is nearly a parabola in both cases. Where three points give no zero
    in the bracket, the line through the margins of the last two does.
    """
    finite = [point for point in seen if np.isfinite(point[1])][-3:]
    if len(finite) == 3:
        (a, fa), (b, fb), (c, fc) = ((level**-2.0, margin * level**-2.0) for level, margin in finite)
        s = 0.0
        if len({fa, fb, fc}) == 3:
            slope = (c - b) / (fc - fb)
            s = c - fc * slope + fc * fb * (slope - (b - a) / (fb - fa)) / (fc - fa)
        if s > 0.0 and low < 1.0 / math.sqrt(s) < (1.0 + _RESOLUTION) * high:
            return 1.0 / math.sqrt(s)
    if len(finite) < 2 or finite[-1][1] == finite[-2][1]:
        return np.nan
    (first, its_margin), (last, margin) = finite[-2:]
    return last - margin * (last - first) / (margin - its_margin)


def _margin(halves: tuple[RiccatiData, RiccatiData], gamma: float) -> float:
    """Return the margin at a level; minus infinity if a Riccati solution does not exist."""
    try:
        return _solve(halves, gamma).margin
    except DesignError:
        return -np.inf


def _solve(halves: tuple[RiccatiData, RiccatiData], gamma: float) -> _Solution:
    """Return both Riccati solutions, gains and the margin at the level `gamma`; raise if a solution does not exist."""
    X, F, X_definite = solve_riccati(halves[0], gamma)
    Y, Lt, Y_definite = solve_riccati(halves[1], gamma)
    real, imaginary = dgeev(X @ Y, compute_vl=0, compute_vr=0, overwrite_a=1)[:2]
    dominant = float(real[np.argmax(np.hypot(real, imaginary))])
    definite = X_definite and Y_definite
    if definite:
        dominant = abs(dominant)
    margin = gamma**2 / dominant - 1.0 if dominant else np.inf
    if not definite and margin > 0.0:
        margin = -np.inf
    return _Solution(X=X, Y=Y, F=F, L=Lt.T, definite=definite, margin=margin)


def _require_controller(solution: _Solution) -> _Solution:
    """Return the solutions if they make a controller; raise otherwise."""
    if not solution.definite:
        raise DesignError("a Riccati solution is not positive semidefinite")
    if solution.margin <= 0.0:
        raise DesignError("the spectral radius of XY is not below gamma^2")
    return solution


def _central_controller(problem: NormalizedPlant, solution: _Solution, gamma: float) -> Lti:
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
    return problem.to_plant_units(A_hat, B_hat, C_hat, D_hat)


def _decouple(K: Lti, P: Lti) -> Lti:
    """Return the central controller without rounding errors between parts of `P` not joined by any coefficients.

    The stabilising solutions of the parts together are the unique one of the whole. The controller does not depend on
    the bases of the normal form. So it consists of the controllers of the parts, and all other entries are 0.
    """
    n, m, p = P.order, P.n_inputs, P.n_outputs
    joined = np.eye(n + m + p)
    joined[:n, :n] += P.A != 0.0
    joined[:n, n : n + m] = P.B != 0.0
    joined[n + m :, :n] = P.C != 0.0
    joined[n + m :, n : n + m] = P.D != 0.0
    joined += joined.T
    for _ in range(len(joined).bit_length()):  # each product doubles the length of the paths
        joined = np.minimum(joined @ joined, 1.0)
    x, u, y = slice(n), slice(n + m - K.n_outputs, n + m), slice(n + m + p - K.n_inputs, n + m + p)
    A, B = np.where(joined[x, x], K.A, 0.0), np.where(joined[x, y], K.B, 0.0)
    return Lti(A=A, B=B, C=np.where(joined[u, x], K.C, 0.0), D=np.where(joined[u, y], K.D, 0.0))
