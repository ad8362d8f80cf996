"""H-infinity synthesis by two Riccati equations: the least level, and the central controller at a stated one."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgesv

from gustproof.errors import DesignError
from gustproof.lti.norms import Peak, bilinear_transform, hinf_norm
from gustproof.lti.riccati import RiccatiError, stabilizing_solution
from gustproof.lti.state_space import LinearSystem, Lti, Matrix, as_lti, largest_gain, lft
from gustproof.synthesis.checked_controller import CheckedController
from gustproof.synthesis.hinf.axis_zeros import AxisZeros, add_growing
from gustproof.synthesis.hinf.channels import Units, find_units, own_units
from gustproof.synthesis.hinf.conditions import NormalizedPlant, SingularProblemError, normalize, require_sizes

_RESOLUTION = 1e-7
"""[-] relative width at which the bisection for the least level stops."""
_SEMIDEFINITE = 1e-9
"""[-] eigenvalues above minus this fraction of the solution's natural size count as not negative. A solution may be
singular or 0; it becomes indefinite only through infinity."""
_SMALLEST_LEVEL = 1e-30
"""[-] the search for the least level stops here if a controller still exists."""
_BADLY_SCALED = 1e4
"""[-] spread of the states' units from which a plant is solved in better ones. Below it, only if it fails in its own."""
_NEAR_MINUS_ONE = 1e-3
"""[-] distance of a discrete pole from z = -1 within which the sign of z is changed."""
_REGULARIZATIONS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
"""[-] weights tried, in units in which the plant is of order 1."""
_NORM_ACCURACY = 1e-9
"""[-] relative accuracy of the search for the peak of the closed loop."""
_NEGLIGIBLE = 1e-5
"""[-] part of the level that a smaller regularisation is not tried for."""
_ROUNDING_ERRORS = (np.linalg.LinAlgError, OverflowError)
"""Errors by which arithmetic gives up."""
_PATIENCE = 2
"""Number of secants without a Riccati solution after which brackets are only halved."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
    singular. Levels below 1e-8 of the size of P are rounding."""
    X: Matrix
    """(n, n) solution of the control Riccati equation at `gamma`; of the bilinear image if P is discrete."""
    Y: Matrix
    """(n, n) solution of the filter Riccati equation at `gamma`."""
    norm_error: float = 0.0
    """[-] rounding of `norm`, from two ways to compute the loop's gain at `omega`."""
    regularization: float = 0.0
    """[-] weight of the controls, states and noise added to a singular plant; 0 if there was no need."""
    gamma_excess: float = 0.0
    """[-] estimate of how much the regularisation adds to `gamma_opt`; infinite if it cannot be told."""


class _RiccatiData(NamedTuple):
    """Data of the control Riccati equation for all levels; the filter's is the same on transposed data."""

    A: Matrix
    B: Matrix
    R: Matrix
    """(m1 + m2, m1 + m2) D1^T D1."""
    SB: Matrix
    """(m1 + m2, 2n) S = D1^T C1, then B^T."""
    Q: Matrix
    """(n, n) C1^T C1."""
    J: Matrix
    """(m1 + m2, m1 + m2) identity on w, 0 on u."""
    natural_size: float
    """Size of a solution, the scale for its eigenvalues."""
    zeros: AxisZeros
    """Zeros near the imaginary axis."""
    quotient: "_RiccatiData | None"
    """Data without the states of such zeros; `None` if there are none."""


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
    A badly scaled plant is solved in units of powers of two, and zeros near the imaginary axis are split off the Riccati
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
        [-] level to design for; `None` for `backoff` times the least.
    backoff
        [-] > 1. At the least level itself the controller's poles are unbounded, so it is never used.
    regularize
        True to solve a singular problem (D12 or D21 without full rank, a zero on the imaginary axis) with small weights
        on controls and states and small noise on states and measurements. They only raise the norm of a loop. They fall
        by tens until the least level falls no more; `regularization` and `gamma_excess` tell the last and its cost.

    Raises
    ------
    ValueError
        If sizes do not fit, or `gamma` or `backoff` is out of range.
    SingularProblemError
        If D12 or D21 lacks rank or there is a zero on the imaginary axis, and `regularize` is False.
    DesignError
        If a mode cannot be stabilised or detected, no controller exists at `gamma`, or rounding spoilt the controller.
        The text names the failed condition. A controller that does not stabilise or exceeds the level is never returned.

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
    if gamma is not None and not (np.isfinite(gamma) and gamma > 0.0):
        raise ValueError(f"gamma is {gamma!r}, must be positive")
    if not (np.isfinite(backoff) and backoff > 1.0):
        raise ValueError(f"backoff is {backoff!r}, must be above 1")
    plant = as_lti(P)
    require_sizes(plant, n_meas, n_con)
    design = _Design(n_meas=n_meas, n_con=n_con, gamma=gamma, backoff=backoff)
    try:
        if not regularize:
            return _check(plant, design.solve(_as_continuous(plant)))
        return _solve_regularized(plant, design)
    except _ROUNDING_ERRORS as error:
        raise DesignError(f"the plant is too badly scaled to solve: {error}") from None


class _Unchecked(NamedTuple):
    """A controller that no closed loop has vouched for."""

    K: Lti
    """Continuous, in `units`."""
    units: Units
    gamma_opt: float
    gamma: float
    X: Matrix
    Y: Matrix


class _Design(NamedTuple):
    """Demands on a controller."""

    n_meas: int
    n_con: int
    gamma: float | None
    backoff: float

    def solve(self, plant: Lti) -> _Unchecked:
        """Return the central controller of a continuous plant, in better units if it needs them."""
        units = find_units(plant, self.n_meas, self.n_con)
        if units.spread <= _BADLY_SCALED:
            try:
                return self._synthesize(plant)
            except (DesignError, *_ROUNDING_ERRORS) as failure:
                if units.spread == 1.0 and not units.changes_channels:
                    raise
                refusal = failure
                try:
                    return self._solve_scaled(plant, units)
                except (DesignError, *_ROUNDING_ERRORS):
                    raise refusal from None
        return self._solve_scaled(plant, units)

    def _solve_scaled(self, plant: Lti, units: Units) -> _Unchecked:
        found = self._synthesize(units.apply(plant, self.n_meas, self.n_con))
        back = units.x[:, None] * units.x
        return found._replace(units=units, X=found.X / back, Y=found.Y * back)

    def _synthesize(self, plant: Lti) -> _Unchecked:
        problem = normalize(plant, self.n_meas, self.n_con)
        A, B, C, D, m1, p1 = problem.A, problem.B, problem.C, problem.D, problem.m1, problem.p1
        halves = (
            _riccati_data(A, B, C[:p1], D[:p1], m1, problem.control_zeros),
            _riccati_data(A.T, C.T, B[:, :m1].T, D[:, :m1].T, p1, problem.filter_zeros),
        )
        gamma_opt = _least_level(halves, problem.floor)
        level = self.backoff * gamma_opt if self.gamma is None else self.gamma
        if level <= gamma_opt:
            raise DesignError(f"no controller at gamma = {level:.6g}: the least level is {gamma_opt:.6g}")
        solution = _solve(halves, level)
        if not solution.definite:
            raise DesignError(f"no controller at gamma = {level:.6g}: a Riccati solution is not positive semidefinite")
        if solution.margin <= 0.0:
            raise DesignError(f"no controller at gamma = {level:.6g}: the spectral radius of XY is not below gamma^2")
        K = _decouple(_central_controller(problem, solution, level), plant)
        units = own_units(plant, self.n_meas, self.n_con)
        return _Unchecked(K=K, units=units, gamma_opt=gamma_opt, gamma=level, X=solution.X, Y=solution.Y)


def _as_continuous(P: Lti) -> Lti:
    """Return a plant of the same norms and controllers in continuous time, at a time unit of half a sample.

    A pole at z = -1 would go to infinity; `z -> -z` moves it to the origin.
    """
    if not P.dt:
        return P
    sign = _time_sign(P)
    return bilinear_transform(Lti(A=sign * P.A, B=sign * P.B, C=P.C, D=P.D, dt=2.0))


def _time_sign(P: Lti) -> float:
    """Return the sign of z with which no pole of the plant is near -1; raise if there is none."""
    poles = P.poles()
    distances = {sign: float(np.min(np.abs(sign * poles + 1.0))) for sign in (1.0, -1.0)}
    sign = 1.0 if distances[1.0] > _NEAR_MINUS_ONE else -1.0
    if distances[sign] <= _NEAR_MINUS_ONE:
        raise DesignError("P has poles at z = -1 and at z = 1: the bilinear map has no place for both")
    return sign


def _as_discrete(K: Lti, P: Lti) -> Lti:
    """Return the controller of the discrete plant `P` for that of `_as_continuous(P)`."""
    if not P.dt:
        return K
    n, sign = K.order, _time_sign(P)
    M = np.linalg.inv(np.eye(n) - K.A)
    A, B = sign * M @ (np.eye(n) + K.A), sign * 2.0**0.5 * M @ K.B
    return Lti(A=A, B=B, C=2.0**0.5 * K.C @ M, D=K.D + K.C @ M @ K.B, dt=P.dt)


def _check(plant: Lti, found: _Unchecked) -> HinfResult:
    """Return the controller with the norm of the loop that it closes; raise if that is not below its level.

    The units of the loop change neither its norm nor, being powers of two, a digit of it.
    """
    K, spoilt = _as_discrete(found.K, plant), f"rounding spoilt the controller at gamma = {found.gamma:.6g}"
    scaled = found.units.apply(plant, K.n_inputs, K.n_outputs)
    try:
        peak = hinf_norm(lft(scaled, K), accuracy=_NORM_ACCURACY)
    except ValueError as error:
        raise DesignError(f"{spoilt}: {error}") from None
    if not peak.gain < found.gamma:
        raise DesignError(f"{spoilt}: its norm is {peak.gain:.6g}")
    return HinfResult(
        controller=found.units.restore(K),
        gamma_opt=found.gamma_opt,
        gamma=found.gamma,
        norm=peak.gain,
        omega=peak.omega,
        X=found.X,
        Y=found.Y,
        norm_error=_norm_error(scaled, K, peak),
    )


def _norm_error(P: Lti, K: Lti, peak: Peak) -> float:
    """Return a bound of the search for the peak, and by how much the gain there differs by way of computation.

    The other way solves the equations of plant and controller together, where `lft` eliminates u and y first.
    """
    searched = 2.0 * _NORM_ACCURACY * peak.gain
    if not np.isfinite(peak.omega):
        return searched
    n, k, m2, p2 = P.order, K.order, K.n_outputs, K.n_inputs
    p1, m1 = P.n_outputs - p2, P.n_inputs - m2
    point = np.exp(1j * peak.omega * P.dt) if P.dt else 1j * peak.omega
    equations = np.zeros((n + k + m2 + p2, n + k + m2 + p2), dtype=np.complex128)
    x, x_K, u, y = np.split(np.arange(len(equations)), [n, n + k, n + k + m2])
    equations[np.ix_(x, x)], equations[np.ix_(x, u)] = point * np.eye(n) - P.A, -P.B[:, m1:]
    equations[np.ix_(x_K, x_K)], equations[np.ix_(x_K, y)] = point * np.eye(k) - K.A, -K.B
    equations[np.ix_(u, u)], equations[np.ix_(u, x_K)], equations[np.ix_(u, y)] = np.eye(m2), -K.C, -K.D
    equations[np.ix_(y, y)], equations[np.ix_(y, x)], equations[np.ix_(y, u)] = np.eye(p2), -P.C[p1:], -P.D[p1:, m1:]
    driven = np.zeros((len(equations), m1))
    driven[x], driven[y] = P.B[:, :m1], P.D[p1:, :m1]
    signals = np.linalg.solve(equations, driven)
    other = np.linalg.norm(P.C[:p1] @ signals[x] + P.D[:p1, m1:] @ signals[u] + P.D[:p1, :m1], 2)
    return searched + abs(float(other) - peak.gain)


def _solve_regularized(plant: Lti, design: _Design) -> HinfResult:
    """Return the controller of the plant itself if it is regular, else of the least regularisation that is solved.

    The closed loop of the plant is a part of that of the regularised one, so its norm is not larger, whatever the
    controller; a smaller regularisation has a smaller least level. The levels of a falling sequence tell what is left.
    """
    try:
        return _check(plant, design.solve(_as_continuous(plant)))
    except SingularProblemError as fault:
        refusal: DesignError = fault
    continuous = _as_continuous(plant)
    units = find_units(continuous, design.n_meas, design.n_con)
    scaled = units.apply(continuous, design.n_meas, design.n_con)
    results: list[HinfResult] = []
    for weight in _REGULARIZATIONS:
        try:
            found = design.solve(_regularized(scaled, design.n_meas, design.n_con, weight))
            result = _check(plant, found._replace(units=units.after(found.units)))
        except (DesignError, *_ROUNDING_ERRORS) as failure:
            if results:
                break
            refusal = failure if isinstance(failure, DesignError) else refusal
            continue
        levels = [each.gamma_opt for each in results] + [result.gamma_opt]
        if not _is_converging(levels):
            break
        results.append(replace(result, regularization=weight, gamma_excess=_remaining(levels)))
        if results[-1].gamma_excess <= _NEGLIGIBLE * result.gamma_opt:
            break
    if not results:
        raise refusal
    return results[-1]


def _is_converging(levels: list[float]) -> bool:
    """Return False if the last of a falling sequence shows that rounding has taken over."""
    steps = -np.diff(levels[-3:])
    return not np.any(steps < -2.0 * _RESOLUTION * levels[-1]) and (len(steps) < 2 or steps[1] <= steps[0])


def _remaining(levels: list[float]) -> float:
    """Return how far a falling sequence is from its limit, by its last three members as a geometric one."""
    if len(levels) < 2:
        return np.inf
    rounding = 2.0 * _RESOLUTION * levels[-1]
    last = max(levels[-2] - levels[-1], rounding)
    if len(levels) == 2 or last == rounding:
        return last
    first = levels[-3] - levels[-2]
    return max(last * last / (first - last), rounding) if first > last else np.inf


def _regularized(P: Lti, n_meas: int, n_con: int, weight: float) -> Lti:
    """Return the plant with weighted states and controls added to z, and noise on both states and measurements to w."""
    n, p1, m1 = P.order, P.n_outputs - n_meas, P.n_inputs - n_con
    x, u, y = (weight * np.eye(size) for size in (n, n_con, n_meas))
    B = np.hstack([P.B[:, :m1], x, np.zeros((n, n_meas)), P.B[:, m1:]])
    C = np.vstack([P.C[:p1], x, np.zeros((n_con, n)), P.C[p1:]])
    D = np.zeros((C.shape[0], B.shape[1]))
    D[:p1, :m1], D[:p1, -n_con:] = P.D[:p1, :m1], P.D[:p1, m1:]
    D[-n_meas:, :m1], D[-n_meas:, -n_con:] = P.D[p1:, :m1], P.D[p1:, m1:]
    D[p1 + n : -n_meas, -n_con:], D[-n_meas:, m1 + n : -n_con] = u, y
    return Lti(A=P.A, B=B, C=C, D=D, dt=P.dt)


def _least_level(halves: tuple[_RiccatiData, _RiccatiData], floor: float) -> float:
    """Return the least feasible level, from above.

    Secants converge to the zero of the margin. If they are slow, the bracket is halved on a logarithmic scale. The same
    is done if there is no zero, because a solution ceases to exist while the margin is positive.
    """
    low, high = floor, max(1.0, 2.0 * floor)
    seen = [(high, _margin(halves, high))]
    while seen[-1][1] <= 0.0:
        low, high = high, 4.0 * high
        if len(seen) == 60:
            raise DesignError(f"no controller at any level up to {low:.3g}: the plant is too badly scaled to solve")
        seen.append((high, _margin(halves, high)))
    misses = slow = 0
    while high - low > _RESOLUTION * high and high > _SMALLEST_LEVEL:
        middle, width = max(float(np.sqrt(low * high)), 0.25 * high), high - low
        secant = _secant_zero(seen) if misses < _PATIENCE and slow < 3 else np.nan
        follows = low < secant < (1.0 + _RESOLUTION) * high
        # a level within the resolution of an end of the bracket is moved just inside: this closes the bracket
        least, most = (1.0 + 0.4 * _RESOLUTION) * low, (1.0 - 0.4 * _RESOLUTION) * high
        level = min(max(secant, least), most) if follows else middle
        margin = _margin(halves, level)
        low, high = (low, level) if margin > 0.0 else (level, high)
        seen.append((level, margin))
        misses += follows and not np.isfinite(margin)
        slow = slow + 1 if follows and high - low > 0.5 * width else 0
    return high


def _secant_zero(seen: list[tuple[float, float]]) -> float:
    """Return the zero of the line through the last two points of finite margin; nan if there are fewer than two."""
    finite = [point for point in seen if np.isfinite(point[1])][-2:]
    if len(finite) < 2 or finite[0][1] == finite[1][1]:
        return np.nan
    (first, its_margin), (last, margin) = finite
    return last - margin * (last - first) / (margin - its_margin)


def _margin(halves: tuple[_RiccatiData, _RiccatiData], gamma: float) -> float:
    """Return the margin at a level; minus infinity if a Riccati solution does not exist."""
    try:
        return _solve(halves, gamma).margin
    except DesignError:
        return -np.inf


def _riccati_data(A: Matrix, B: Matrix, C1: Matrix, D1: Matrix, m1: int, zeros: AxisZeros) -> _RiccatiData:
    natural_size = float(largest_gain(C1) ** 2 / largest_gain(A)) if np.any(A) else 1.0
    J = np.diag((np.arange(D1.shape[1]) < m1).astype(np.float64))
    SB = np.hstack([D1.T @ C1, B.T])
    quotient = None
    if zeros.rest.shape[1] < A.shape[0]:
        # u = -D12^T C1 x hides the states of the zeros from z, and leaves the solution as it is
        N, D12 = zeros.rest, D1[:, m1:]
        A_hidden, C_hidden = A - B[:, m1:] @ (D12.T @ C1), C1 - D12 @ (D12.T @ C1)
        none = AxisZeros(N[:, :0].T @ N, N[:, :0].T @ N, np.eye(N.shape[1]), np.zeros((0, 0)), None)
        quotient = _riccati_data(N.T @ A_hidden @ N, N.T @ B, C_hidden @ N, D1, m1, none) if N.size else None
    return _RiccatiData(
        A=A, B=B, R=D1.T @ D1, SB=SB, Q=C1.T @ C1, J=J, natural_size=natural_size, zeros=zeros, quotient=quotient
    )


def _solve(halves: tuple[_RiccatiData, _RiccatiData], gamma: float) -> _Solution:
    """Return both Riccati solutions, gains and the margin at the level `gamma`; raise if a solution does not exist."""
    X, F, X_definite = _solve_riccati(halves[0], gamma)
    Y, Lt, Y_definite = _solve_riccati(halves[1], gamma)
    eigenvalues = np.linalg.eigvals(X @ Y)
    dominant = float(eigenvalues[np.argmax(np.abs(eigenvalues))].real)
    definite = X_definite and Y_definite
    if definite:
        dominant = abs(dominant)
    margin = gamma**2 / dominant - 1.0 if dominant else np.inf
    if not definite and margin > 0.0:
        margin = -np.inf
    return _Solution(X=X, Y=Y, F=F, L=Lt.T, definite=definite, margin=margin)


def _solve_riccati(half: _RiccatiData, gamma: float) -> tuple[Matrix, Matrix, bool]:
    """Return a Riccati solution, its gain, and True if it has no negative eigenvalue."""
    n, A, B, SB = half.A.shape[0], half.A, half.B, half.SB
    _, _, solved, singular = dgesv(half.R - gamma**2 * half.J, SB)
    if singular:
        raise np.linalg.LinAlgError("R - gamma^2 J is singular")
    S, RS, RB = SB[:, :n], solved[:, :n], solved[:, n:]
    if half.zeros.rest.shape[1] < n:
        X, definite = _solve_quotient(half, gamma, RS, RB)
        return X, -(RS + RB @ X), definite
    H = np.empty((2 * n, 2 * n))
    H[:n, :n] = A - B @ RS
    H[:n, n:] = -B @ RB
    H[n:, :n] = S.T @ RS - half.Q
    H[n:, n:] = -H[:n, :n].T
    try:
        X = stabilizing_solution(H)
    except RiccatiError as error:
        raise DesignError(f"no controller at gamma = {gamma:.6g}: {error}") from None
    eigenvalues = np.linalg.eigvalsh(X)
    definite = eigenvalues[0] >= -_SEMIDEFINITE * max(eigenvalues[-1], half.natural_size)
    return X, -(RS + RB @ X), bool(definite)


def _solve_quotient(half: _RiccatiData, gamma: float, RS: Matrix, RB: Matrix) -> tuple[Matrix, bool]:
    """Return a Riccati solution with the states of zeros near the axis split off, and True if it is not negative."""
    X, definite, N = np.zeros_like(half.A), True, half.zeros.rest
    if half.quotient is not None:
        inner, _, definite = _solve_riccati(half.quotient, gamma)
        X = N @ inner @ N.T
    X, allowed = add_growing(half.zeros, X, half.A - half.B @ (RS + RB @ X), half.B @ RB)
    return X, definite and allowed


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
    normalized = Lti(A=A_hat, B=B_hat, C=C_hat, D=D_hat)
    return problem.to_plant_units(normalized)


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
