"""Linear matrix inequalities of LPV synthesis, gridded and with scalings of an LFT.

The controller is eliminated. A plant then has two inequalities at each grid point and each corner of the speeds. They
are those of a filter matrix X(rho) and of a control matrix Y(rho), with `[X, I; I, Y] >= 0`. Each is a sum of basis
functions of rho times constant matrices. Channels of Delta add scalings L and J with `[L, I; I, J] >= 0`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy

from gustproof.errors import DesignError
from gustproof.robust.gain.multipliers import basis as symmetric_basis
from gustproof.robust.gain.multipliers import minimize, svec, svec_columns
from gustproof.robust.lti.state_space import Matrix, PartedPlant

_STRICTNESS = 1e-7
"""[-] margin of each inequality, in balanced states."""
_TOLERANCE = 1e-4
"""[-] largest excess of an inequality, relative to the level, with which the solver's matrices are of use."""
_OPTIONS: tuple[dict[str, float], ...] = (
    {"equilibrate_enable": False},
    {"static_regularization_constant": 1e-7},
    {"chordal_decomposition_enable": False},
)
"""Options of the solver that are tried in turn: none suits all problems."""
_STEP = 1e-6
"""[-] step of central differences, relative to the range of a parameter."""

Point = tuple[float, ...]
"""Values of the parameters."""
Functions = Callable[[Point], Sequence[float]]
"""Basis functions of the parameters; the first is 1 throughout."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LyapunovMatrices:
    """Coefficients of X and Y, and scalings of the blocks of Delta."""

    X: tuple[Matrix, ...]
    """(n, n) for each function of the filter's basis."""
    Y: tuple[Matrix, ...]
    """(n, n) for each function of the control's basis."""
    L: tuple[Matrix, ...]
    """(k, k) for each block, of the filter's side."""
    J: tuple[Matrix, ...]
    """(k, k) for each block, of the control's side."""
    filter_basis: Functions
    """Basis functions of X."""
    control_basis: Functions
    """Basis functions of Y."""
    steps: Point
    """[as the parameters] steps of the derivatives."""

    def at(self, rho: Point) -> tuple[Matrix, Matrix]:
        """Return X and Y at a point."""
        return combine(self.X, self.filter_basis(rho)), combine(self.Y, self.control_basis(rho))

    def speed(self, rho: Point, drho: Point) -> tuple[Matrix, Matrix]:
        """Return the derivatives of X and Y by time, at the speeds `drho` [1/s] of the parameters."""
        return (
            combine(self.X, derivative(self.filter_basis, rho, drho, self.steps)),
            combine(self.Y, derivative(self.control_basis, rho, drho, self.steps)),
        )


def combine(matrices: Sequence[Matrix], values: Iterable[float]) -> Matrix:
    """Return the sum of the matrices, each times its value."""
    total = np.zeros_like(matrices[0])
    for value, matrix in zip(values, matrices, strict=True):
        total += value * matrix
    return total


def derivative(functions: Functions, rho: Point, drho: Point, steps: Point) -> Matrix:
    """Return the derivatives of the functions by time, by central differences."""
    total = np.zeros(len(functions(rho)))
    for k, (speed, step) in enumerate(zip(drho, steps, strict=True)):
        if speed:
            ahead, behind = ((*rho[:k], rho[k] + sign * step, *rho[k + 1 :]) for sign in (1.0, -1.0))
            total += speed * (np.asarray(functions(ahead)) - np.asarray(functions(behind))) / (2.0 * step)
    return total


def corners(speeds: Point | None, count: int) -> list[Point]:
    """Return the corners of the box of speeds; one of zeros if they do not matter."""
    if speeds is None:
        return [(0.0,) * count]
    return list(dict.fromkeys(product(*((-speed, speed) for speed in speeds))))


def steps_of(points: Sequence[Point]) -> Point:
    """Return the steps of the derivatives by each parameter."""
    ranges = np.ptp(np.asarray(points), axis=0)
    return tuple(_STEP * float(extent or 1.0) for extent in ranges)


class Inequalities:
    """The inequalities of all points; unknowns are X, Y, L, J and the level or a margin, last.

    The first channels of w and z are those of Delta, as many as `repeats` add up to.
    """

    def __init__(
        self,
        plants: dict[Point, PartedPlant],
        filter_basis: Functions,
        control_basis: Functions,
        speeds: Point | None = None,
        repeats: Sequence[int] = (),
    ) -> None:
        self.points, self.repeats = list(plants), list(repeats)
        self.n = next(iter(plants.values())).A.shape[0]
        self.bases = filter_basis, control_basis
        self.counts = tuple(len(functions(self.points[0])) for functions in self.bases)
        self.steps = steps_of(self.points)
        self.stack = np.array(symmetric_basis(self.n, skew=False))
        self.scalings = [np.array(symmetric_basis(k, skew=False)) for k in self.repeats]
        self.before = sum(self.counts) * len(self.stack)
        self.width = sum(map(len, self.scalings))
        self.size = self.before + 2 * self.width + 1
        self.rows: list[Matrix] = []
        self.constants: list[Matrix] = []
        for rho, plant in plants.items():
            for drho in corners(speeds, len(rho)):
                self._add(plant, rho, drho, is_control=False)
                self._add(plant, rho, drho, is_control=True)

    def _add(self, plant: PartedPlant, rho: Point, drho: Point, *, is_control: bool) -> None:
        """Append the inequality of one side: the control side is the filter side of the transposed plant."""
        functions = self.bases[is_control]
        values, changes = functions(rho), derivative(functions, rho, drho, self.steps)
        A, B, C, D = plant.A, plant.B1, plant.C1, plant.D11
        seen = np.hstack([plant.C2, plant.D21])
        if is_control:
            A, B, C, D, changes = A.T, C.T, B.T, D.T, -changes
            seen = np.hstack([plant.B2.T, plant.D12.T])
        r, n, m = sum(self.repeats), self.n, B.shape[1]
        q, C, D = np.hstack([C[:r], D[:r]]), C[r:], D[r:]
        p = C.shape[0]
        N = scipy.linalg.block_diag(scipy.linalg.null_space(seen), np.eye(p))
        coefficients = np.zeros((self.size, N.shape[1], N.shape[1]))
        still = np.zeros((len(self.stack), n + m + p, n + m + p))
        product = self.stack @ A
        still[:, :n, :n] = product + product.transpose(0, 2, 1)
        still[:, :n, n : n + m] = self.stack @ B
        still[:, n : n + m, :n] = still[:, :n, n : n + m].transpose(0, 2, 1)
        moving = np.zeros_like(still)
        moving[:, :n, :n] = self.stack
        still, moving = N.T @ still @ N, N.T @ moving @ N
        start = self.counts[0] * len(self.stack) if is_control else 0
        for k, (value, change) in enumerate(zip(values, changes, strict=True)):
            at = slice(start + k * len(self.stack), start + (k + 1) * len(self.stack))
            coefficients[at] = value * still + change * moving
        first, start = 0, self.before + is_control * self.width
        into = np.eye(n + m + p)
        for repeats, scaling in zip(self.repeats, self.scalings, strict=True):
            z, w = np.zeros((repeats, n + m + p)), into[n + first : n + first + repeats]
            z[:, : n + m] = q[first : first + repeats]
            z, w = z @ N, w @ N
            coefficients[start : start + len(scaling)] = z.T @ scaling @ z - w.T @ scaling @ w
            first, start = first + repeats, start + len(scaling)
        coefficients[-1] = N.T @ scipy.linalg.block_diag(np.zeros((n + r, n + r)), -np.eye(m - r + p)) @ N
        constant = np.zeros((n + m + p, n + m + p))
        constant[:n, n + m :], constant[n : n + m, n + m :] = C.T, D.T
        self.rows.append(coefficients)
        self.constants.append(np.asarray(N.T @ (constant + constant.T) @ N))

    def least_level(self, *, tried: int = len(_OPTIONS)) -> tuple[float, LyapunovMatrices]:
        """Return the least level for which the solver finds matrices, and these; best of `tried` options of it.

        Raises
        ------
        DesignError
            If there are none at any level.
        """
        cost = np.zeros(self.size)
        cost[-1] = 1.0
        rows, bounds = self._inequalities(1.0)
        unknowns = _solve(cost, rows, bounds, tried)
        return float(unknowns[-1]), self._split(unknowns)

    def matrices(self, level: float, spread: float) -> LyapunovMatrices:
        """Return the matrices of the widest margin at a level, with `[X, spread I; spread I, Y] >= 0`.

        `I - X Y` is then regular.
        """
        rows, bounds = self._inequalities(spread)
        for k, block in enumerate(self.rows):
            bounds[k] = bounds[k] - level * block[-1]
            rows[k][:, -1] = svec(np.eye(len(bounds[k])))
        cost = np.zeros(self.size)
        cost[-1] = -1.0
        return self._split(_solve(cost, rows, bounds, 1))

    def _inequalities(self, spread: float) -> tuple[list[Matrix], list[Matrix]]:
        """Return rows and bounds of every inequality, with its margin."""
        coupled = self._coupling(spread)
        rows = [svec_columns(block) for block in self.rows] + [row for row, _ in coupled]
        bounds = [-constant for constant in self.constants] + [bound for _, bound in coupled]
        return rows, [bound - _STRICTNESS * np.eye(len(bound)) for bound in bounds]

    def _coupling(self, spread: float) -> list[tuple[Matrix, Matrix]]:
        """Return rows and bounds of `[X, spread I; spread I, Y] >= 0` at each point, and the same of each L and J."""
        found, seen = [], set()
        for rho in self.points:
            values = [tuple(functions(rho)) for functions in self.bases]
            if tuple(values) not in seen:
                seen.add(tuple(values))
                starts = (0, self.counts[0] * len(self.stack))
                found.append(self._couple(self.stack, values, starts, spread))
        start = self.before
        for scaling in self.scalings:
            found.append(self._couple(scaling, [(1.0,), (1.0,)], (start, start + self.width), spread))
            start += len(scaling)
        return found

    def _couple(
        self, stack: Matrix, values: Sequence[Sequence[float]], starts: tuple[int, int], spread: float
    ) -> tuple[Matrix, Matrix]:
        n = stack.shape[1]
        coefficients = np.zeros((self.size, 2 * n, 2 * n))
        for side, own in enumerate(values):
            block = slice(side * n, (side + 1) * n)
            for k, value in enumerate(own):
                at = starts[side] + k * len(stack)
                coefficients[at : at + len(stack), block, block] = -value * stack
        bound = np.zeros((2 * n, 2 * n))
        bound[:n, n:] = bound[n:, :n] = spread * np.eye(n)
        return svec_columns(coefficients), bound

    def _split(self, unknowns: Matrix) -> LyapunovMatrices:
        """Return the matrices of a vector of unknowns."""
        values = iter(unknowns[: self.before].reshape(-1, len(self.stack)))
        found = [np.tensordot(value, self.stack, axes=1) for value in values]
        scalings, start = [], self.before
        for scaling in [*self.scalings, *self.scalings]:
            scalings.append(np.tensordot(unknowns[start : start + len(scaling)], scaling, axes=1))
            start += len(scaling)
        return LyapunovMatrices(
            X=tuple(found[: self.counts[0]]),
            Y=tuple(found[self.counts[0] :]),
            L=tuple(scalings[: len(self.repeats)]),
            J=tuple(scalings[len(self.repeats) :]),
            filter_basis=self.bases[0],
            control_basis=self.bases[1],
            steps=self.steps,
        )


def _solve(cost: Matrix, rows: Sequence[Matrix], bounds: Sequence[Matrix], tried: int) -> Matrix:
    """Return the best of the solver's results, with `tried` options or more, that keep the inequalities."""
    found: list[Matrix] = []
    for k, options in enumerate(_OPTIONS):
        if found and k >= tried:
            break
        unknowns = minimize(cost, np.vstack(rows), bounds, **options)
        if np.isfinite(unknowns).all() and np.any(unknowns):
            pairs = zip(rows, bounds, strict=True)
            excess = max(float(np.linalg.eigvalsh(unpack(row @ unknowns) - bound)[-1]) for row, bound in pairs)
            if excess <= _TOLERANCE * max(1.0, abs(unknowns[-1])):
                found.append(unknowns)
    if not found:
        raise DesignError("no scheduled controller: the inequalities have no solution")
    return min(found, key=lambda unknowns: float(cost @ unknowns))


def unpack(packed: Matrix) -> Matrix:
    """Return the symmetric matrix of an `svec`."""
    size = round((np.sqrt(8.0 * packed.size + 1.0) - 1.0) / 2.0)
    rows, columns = np.tril_indices(size)
    matrix = np.zeros((size, size))
    matrix[columns, rows] = packed / np.where(rows == columns, 1.0, np.sqrt(2.0))
    return np.asarray(matrix + np.triu(matrix, 1).T)


def first_scales(plants: Sequence[PartedPlant]) -> Matrix:
    """Return a diagonal transformation of the states that balances the largest coefficients of all points."""
    n = plants[0].A.shape[0]
    whole = np.zeros((n + 1, n + 1))
    for plant in plants:
        whole[:n, :n] = np.maximum(whole[:n, :n], np.abs(plant.A))
        whole[:n, n] = np.maximum(whole[:n, n], np.abs(np.hstack([plant.B1, plant.B2])).max(axis=1))
        whole[n, :n] = np.maximum(whole[n, :n], np.abs(np.vstack([plant.C1, plant.C2])).max(axis=0))
    np.fill_diagonal(whole, 0.0)
    _, (scale, _) = scipy.linalg.matrix_balance(whole, permute=False, separate=True)
    return np.diag(scale[:n] / scale[n])


def balancing(X: Matrix, Y: Matrix) -> Matrix:
    """Return the transformation after which both positive definite matrices are the same diagonal one."""
    L = np.linalg.cholesky(Y)
    U, squares, _ = np.linalg.svd(L.T @ X @ L)
    return np.asarray(L @ U / squares**0.25)


def transform(plant: PartedPlant, T: Matrix) -> PartedPlant:
    """Return the plant in the states `inv(T) x`."""
    left = np.linalg.inv(T)
    return replace(
        plant,
        A=left @ plant.A @ T,
        B1=left @ plant.B1,
        B2=left @ plant.B2,
        C1=plant.C1 @ T,
        C2=plant.C2 @ T,
    )
