"""Synthesis of scheduled controllers: on a grid of the parameters, or for an LFT in them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gustproof.errors import DesignError
from gustproof.robust.hinf.checked_controller import CheckedController
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lpv.inequalities import (
    Functions,
    Inequalities,
    LyapunovMatrices,
    Point,
    balancing,
    corners,
    first_scales,
    transform,
)
from gustproof.robust.lpv.reconstruction import controller_at, proven_level
from gustproof.robust.lti.norms import Peak, hinf_norm
from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, PartedPlant, as_continuous, lft, part
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import RealBlock

if TYPE_CHECKING:
    import control

_SPREAD = 0.5
"""[-] share of the backoff by which `I - X Y` is kept regular."""
_BETWEEN = 4
"""Number of parts into which each step of the grid is parted for the check between its points."""

Model = Callable[[Point], LinearSystem]
"""Generalised plant at a point."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ScheduledController(CheckedController):
    """A controller for each point of a grid, and between.

    `norm` bounds the L2 gain at the grid's points and the corners of the speeds, by the design's Lyapunov matrices and
    the closed loops' own coefficients. Both it and `norm_between` are sampled: no proof for the points not tried.
    `K` is the one in the middle of the grid. All are in the same states.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import lpvsyn
    >>> D = [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]]
    >>> def plant(rho):
    ...     return ss([[-rho[0]]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], D)
    >>> result = lpvsyn({(rho,): plant((rho,)) for rho in (1.0, 2.0, 3.0)}, 1, 1, speeds=(1.0,))
    >>> [round(float(pole), 1) < 0 for pole in result.at((2.5,)).poles().real]
    [True]
    """

    gamma_opt: float
    """[-] least level for which the inequalities have a solution on the grid, by the solver."""
    norm_between: float
    """[-] bound like `norm` at points between those of the grid; infinite if these matrices prove none."""
    points: tuple[Point, ...]
    """Points of the grid."""
    _at: Callable[[Point, Point], Lti]
    """The controller's formula, by a point and speeds."""

    def at(self, rho: Sequence[float], speed: Sequence[float] | None = None) -> "control.StateSpace":
        """Return the controller at any point within the grid, by its own formula and the plant there.

        `speed` is the parameters' derivative by time; it matters if the design took `speeds_measured` alone.

        Raises
        ------
        ValueError
            If the point is outside the grid.
        """
        point = tuple(float(value) for value in rho)
        low, high = np.min(self.points, axis=0), np.max(self.points, axis=0)
        if len(point) != len(low) or np.any(point < low) or np.any(point > high):
            raise ValueError(f"{point} is outside the grid, from {tuple(low.tolist())} to {tuple(high.tolist())}")
        speeds = (0.0,) * len(point) if speed is None else tuple(float(value) for value in speed)
        return self._at(point, speeds).to_control()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class LftController(CheckedController):
    """A controller with a copy of the plant's parameters.

    `norm` bounds the L2 gain for parameters that change at any speed within their ranges. It is the H-infinity norm of
    the scaled closed loop. `K` is the one in the middle of the ranges.

    Examples
    --------
    >>> from gustproof import lpvsyn, ureal
    >>> from gustproof.robust.uncertain.uncertain_system import system_from_matrix
    >>> pole = ureal("pole", range=(1.0, 3.0))
    >>> A, rest = pole @ [[-1.0, 0, 0, 0]], [[1.0, 0, 0, 0], [0, 0, 0, 0.1], [1.0, 0, 0.1, 0]]
    >>> whole = [[1.0], [0], [0], [0]] @ A + [[0, 1.0, 0, 1.0], *rest]
    >>> result = lpvsyn(system_from_matrix(whole, 1), 1, 1)
    >>> (result.scheduled.n_inputs, [block.name for block in result.scheduled.blocks])
    (1, ['pole'])
    """

    gamma_opt: float
    """[-] least level for which the inequalities have a solution, by the solver."""
    scheduled: Uncertain
    """The controller as a system of the parameters, `u = K(rho) y`."""


def lpvsyn(
    grid: Mapping[Point, LinearSystem] | Uncertain,
    n_meas: int,
    n_con: int,
    *,
    speeds: Sequence[float] | None = None,
    basis: Functions | None = None,
    speeds_measured: bool = False,
    plant: Model | None = None,
    backoff: float = 1.05,
) -> ScheduledController | LftController:
    """Return a controller scheduled on measured parameters, of least L2 gain from w to z (LPVTools: `lpvsyn`).

    A grid maps points of the parameters to generalised plants of the same states. Its Lyapunov matrix depends on the
    parameters by `basis`, whose speeds are bounded by `speeds`; without these it is constant and any speed allowed. A
    plant given as an LFT in its parameters has constant scalings: any speed, and the whole range instead of a grid.
    Cost: two to three semidefinite programs; seconds for eight states, one parameter and seven points.

    Parameters
    ----------
    grid
        Plants on the product of some values of each parameter, or an LFT with real parameters alone.
    n_meas, n_con
        Number of measurements, last outputs of the plant, and of controls, its last inputs.
    speeds
        Bounds on the derivatives of the parameters by time, one each; `None` for any speed.
    basis
        Functions of a point, the first of them 1; by default 1 and the parameters themselves.
    speeds_measured
        True for a controller that may use the parameters' derivatives as well.
    plant
        The plant at any point, to check and to schedule between those of the grid; by default interpolated.
    backoff
        [-] > 1, level over the least.

    Raises
    ------
    ValueError
        If the grid is no product or has less than two points, plants differ in size or are discrete, or options do not
        fit.
    DesignError
        If the inequalities have no solution, D12 or D21 lacks rank, or the closed loops do not keep the level.

    References
    ----------
    F. Wu, X. H. Yang, A. Packard, G. Becker, Induced L2-norm control for LPV systems with bounded parameter variation
    rates, Int. J. Robust and Nonlinear Control 6 (1996), 983-998. P. Apkarian, R. J. Adams, Advanced gain-scheduling
    techniques for uncertain systems, IEEE Trans. Control Systems Technology 6 (1998), 21-32. A. Packard, Gain
    scheduling via linear fractional transformations, Systems & Control Letters 22 (1994), 79-92.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import lpvsyn
    >>> D = [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]]
    >>> def plant(rho):
    ...     return ss([[-rho[0]]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], D)
    >>> result = lpvsyn({(rho,): plant((rho,)) for rho in (1.0, 2.0, 3.0)}, 1, 1, speeds=(1.0,), plant=plant)
    >>> result.norm <= result.gamma
    True
    """
    if not (np.isfinite(backoff) and backoff > 1.0):
        raise ValueError(f"backoff is {backoff!r}, must be above 1")
    if isinstance(grid, Uncertain) and (speeds, basis, speeds_measured, plant) != (None, None, False, None):
        raise ValueError("an LFT takes no speeds, basis or plant: its parameters change at any speed")
    if speeds is None and (basis, speeds_measured) != (None, False):
        raise ValueError("a basis, or measured speeds, need bounds on the speeds")
    try:
        if isinstance(grid, Uncertain):
            return _lft_controller(grid, n_meas, n_con, backoff)
        design = _GridDesign(_models(grid, n_meas, n_con), n_meas, n_con, plant)
        bounds = None if speeds is None else _speeds(speeds, len(design.points[0]))
        return design.synthesize(bounds, basis or _affine, backoff, is_measured=speeds_measured)
    except np.linalg.LinAlgError:
        raise DesignError("no scheduled controller: the inequalities have no solution, or are badly scaled") from None


def _constant(_rho: Point) -> tuple[float, ...]:
    return (1.0,)


def _affine(rho: Point) -> tuple[float, ...]:
    return (1.0, *rho)


def _point(values: ArrayLike) -> Point:
    """Return values as a point; a single parameter may be a number."""
    return tuple(np.atleast_1d(np.asarray(values, dtype=np.float64)).tolist())


def _speeds(speeds: Sequence[float], count: int) -> Point:
    bounds = _point(speeds)
    if len(bounds) != count or not all(np.isfinite(speed) and speed >= 0.0 for speed in bounds):
        raise ValueError(f"speeds are {bounds}, must be {count} finite bounds, not negative")
    return bounds


def _models(grid: Mapping[Point, LinearSystem], n_meas: int, n_con: int) -> dict[Point, Lti]:
    """Check the plants of a grid; return them by their points, the last parameter fastest."""
    models = {_point(rho): as_continuous(f"the plant at {rho}", P) for rho, P in grid.items()}
    if len(models) < 2 or len({len(rho) for rho in models}) > 1:
        raise ValueError("the grid needs two points or more, of the same parameters")
    shapes = {(P.order, P.D.shape) for P in models.values()}
    if len(shapes) > 1:
        raise ValueError(f"the plants of the grid differ in states, inputs or outputs: {sorted(shapes)}")
    _check_sizes(next(iter(models.values())).D.shape, n_meas, n_con)
    ordered = list(product(*(sorted(set(values)) for values in zip(*models, strict=True))))
    if set(ordered) != set(models):
        raise ValueError(f"the grid has {len(models)} points, the product of its parameters' values has {len(ordered)}")
    return {rho: models[rho] for rho in ordered}


def _check_sizes(shape: tuple[int, ...], n_meas: int, n_con: int) -> None:
    p, m = shape
    if not (0 < n_meas < p and 0 < n_con < m):
        raise ValueError(f"{n_meas} measurements and {n_con} controls do not fit a plant of {p} outputs and {m} inputs")


class _GridDesign:
    """Plants of a grid, in states in which the Lyapunov matrices are well scaled."""

    def __init__(self, models: dict[Point, Lti], n_meas: int, n_con: int, plant: Model | None) -> None:
        self.points, self.sizes = list(models), (n_meas, n_con)
        self.axes = [sorted(set(values)) for values in zip(*models, strict=True)]
        self.plant = plant or _interpolate(models, self.axes)
        self.parts = {rho: part(P, n_meas, n_con) for rho, P in models.items()}
        self.T = first_scales(list(self.parts.values()))

    def synthesize(
        self, speeds: Point | None, basis: Functions, backoff: float, *, is_measured: bool
    ) -> ScheduledController:
        """Return the checked controller."""
        control = basis if speeds is not None else _constant
        bases = control if is_measured else _constant, control
        _, matrices = Inequalities(self._transform(), *bases, speeds).least_level()
        X, Y = (np.mean([matrices.at(rho)[k] for rho in self.points], axis=0) for k in range(2))
        self.T = self.T @ balancing(X, Y)
        inequalities = Inequalities(self._transform(), *bases, speeds)
        least, _ = inequalities.least_level(tried=1)
        level = backoff * least
        matrices = inequalities.matrices(level, 1.0 + _SPREAD * (backoff - 1.0))
        norm = max(self._level(matrices, rho, speeds, level) for rho in self.points)
        if not norm <= level:
            raise DesignError(f"rounding spoilt the controllers at gamma = {level:.6g}: their gain is {norm:.6g}")
        between = self._between()
        frozen = [self._frozen(matrices, rho, level) for rho in [*self.points, *between]]
        worst = max(frozen, key=lambda peak: peak.gain)
        if not np.isfinite(worst.gain):
            raise DesignError("a frozen loop between the points of the grid is unstable: make the grid denser")
        norm_between = max(self._level(matrices, rho, speeds, level) for rho in between)
        return ScheduledController(
            lti=self._controller(matrices, self.points[len(self.points) // 2], (0.0,) * len(self.points[0]), level),
            gamma=level,
            norm=norm,
            omega=worst.omega,
            checks=(
                f"sampled: at {len(self.points)} points of the grid the L2 gain is at most {norm:.6g}",
                f"sampled: at {len(between)} points between them it is at most {norm_between:.6g}",
                f"with the parameters at rest the largest gain of all these is {worst.gain:.6g}",
            ),
            gamma_opt=least,
            norm_between=norm_between,
            points=tuple(self.points),
            _at=lambda rho, drho: self._controller(matrices, rho, drho, level),
        )

    def _transform(self) -> dict[Point, PartedPlant]:
        return {rho: transform(plant, self.T) for rho, plant in self.parts.items()}

    def _model(self, rho: Point) -> Lti:
        """Return the plant at a point, in the states of the design."""
        P = as_continuous("the plant", self.plant(rho))
        left = np.linalg.inv(self.T)
        return Lti(A=left @ P.A @ self.T, B=left @ P.B, C=P.C @ self.T, D=P.D)

    def _controller(self, matrices: LyapunovMatrices, rho: Point, drho: Point, level: float) -> Lti:
        return controller_at(part(self._model(rho), *self.sizes), matrices, rho, drho, level)

    def _level(self, matrices: LyapunovMatrices, rho: Point, speeds: Point | None, level: float) -> float:
        """Return the gain that the matrices prove at a point, for every corner of the speeds."""
        P, found = self._model(rho), []
        for drho in corners(speeds, len(rho)):
            loop = lft(P, self._controller(matrices, rho, drho, level))
            found.append(proven_level(loop, matrices, rho, drho, level))
        return max(found)

    def _frozen(self, matrices: LyapunovMatrices, rho: Point, level: float) -> Peak:
        return hinf_norm(lft(self._model(rho), self._controller(matrices, rho, (0.0,) * len(rho), level)))

    def _between(self) -> list[Point]:
        """Return points between those of the grid: along each axis, and the middles of all cells."""
        shares = np.arange(1, _BETWEEN) / _BETWEEN
        middle = tuple(values[len(values) // 2] for values in self.axes)
        found: list[Point] = []
        for k, values in enumerate(self.axes):
            inner = [float(a + share * (b - a)) for a, b in pairwise(values) for share in shares]
            found += [(*middle[:k], value, *middle[k + 1 :]) for value in inner]
        centres = [[0.5 * (a + b) for a, b in pairwise(values)] or values for values in self.axes]
        return list(dict.fromkeys([*found, *product(*centres)]))


def _interpolate(models: dict[Point, Lti], axes: list[list[float]]) -> Model:
    """Return the plant between the points, by linear interpolation of its coefficients."""
    first = next(iter(models.values()))
    n = first.order
    whole = np.array([np.block([[P.A, P.B], [P.C, P.D]]) for P in models.values()])
    whole = whole.reshape(*map(len, axes), *whole.shape[1:])
    wide = [k for k, values in enumerate(axes) if len(values) > 1]
    table = scipy.interpolate.RegularGridInterpolator(
        [axes[k] for k in wide], np.squeeze(whole, tuple(k for k in range(len(axes)) if k not in wide))
    )

    def plant(rho: Point) -> Lti:
        system = table([rho[k] for k in wide])[0]
        return Lti(A=system[:n, :n], B=system[:n, n:], C=system[n:, :n], D=system[n:, n:])

    return plant


def _lft_controller(P: Uncertain, n_meas: int, n_con: int, backoff: float) -> LftController:
    """Return the checked controller of an LFT."""
    as_continuous("the plant", P.M)
    blocks = tuple(block for block in P.blocks if isinstance(block, RealBlock))
    if not blocks or len(blocks) != len(P.blocks):
        raise ValueError("the LFT needs real parameters, and no other blocks")
    _check_sizes((P.n_outputs, P.n_inputs), n_meas, n_con)
    repeats = [block.repeats for block in blocks]
    parts = part(P.M, n_meas, n_con)
    T = first_scales([parts])
    inequalities = Inequalities({(): transform(parts, T)}, _constant, _constant, repeats=repeats)
    least, matrices = inequalities.least_level()
    level = backoff * least
    scaling = _scaling(matrices)
    plant = _scaled_plant(P.M, scaling, level, (n_meas, n_con))
    result = hinfsyn(plant, n_meas + sum(repeats), n_con + sum(repeats), gamma=1.0)
    outputs, inputs = (np.roll(range(count + sum(repeats)), sum(repeats)).tolist() for count in (n_con, n_meas))
    scheduled = Uncertain(M=result.lti.subsystem(outputs, inputs), blocks=blocks)
    return LftController(
        lti=scheduled.nominal_system(),
        gamma=level,
        norm=level * result.norm,
        omega=result.omega,
        checks=(
            "every pole of the loop is stable with the parameters in the middle",
            f"the scaled loop's H-infinity norm is {result.norm:.6f}: the L2 gain is at most {level * result.norm:.6g}",
        ),
        gamma_opt=least,
        scheduled=scheduled,
    )


def _scaling(matrices: LyapunovMatrices) -> Matrix:
    """Return S with S'S the scaling of the closed loop's parameters, the controller's copy first."""
    roots = []
    for L, J in zip(matrices.L, matrices.J, strict=True):
        values, vectors = np.linalg.eigh(L - np.linalg.inv(J))
        roots.append(vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T)
    E, L = scipy.linalg.block_diag(*roots), scipy.linalg.block_diag(*matrices.L)
    return np.asarray(np.linalg.cholesky(np.block([[np.eye(len(E)), E], [E, L]])).T)


def _scaled_plant(M: Lti, scaling: Matrix, level: float, sizes: tuple[int, int]) -> Lti:
    """Return the plant that also hands the parameters' copy to the controller, scaled so that level 1 is the aim."""
    n, (p, m), r = M.order, M.D.shape, len(scaling) // 2
    identity, zero = np.eye(r), np.zeros
    # inputs (w_K, w_Delta, w, u, u_K), outputs (z_K, z_Delta, z, y, y_K): z_K = u_K and y_K = w_K
    B = np.hstack([zero((n, r)), M.B, zero((n, r))])
    C = np.vstack([zero((r, n)), M.C, zero((r, n))])
    D = scipy.linalg.block_diag(zero((r, r)), M.D, zero((r, r)))
    D[:r, r + m :] = D[r + p :, :r] = identity
    kept = [np.eye(size + r) for size in sizes]
    outputs, inputs = (
        scipy.linalg.block_diag(own, np.eye(count - r - size) / np.sqrt(level), rest)
        for own, count, size, rest in zip((scaling, np.linalg.inv(scaling)), (p, m), sizes, kept, strict=True)
    )
    return Lti(A=M.A, B=B @ inputs, C=outputs @ C, D=outputs @ D @ inputs)
