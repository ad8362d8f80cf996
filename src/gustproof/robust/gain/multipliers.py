"""Multipliers that bound an L2 gain over real parameters of any speed, from one linear matrix inequality."""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import clarabel
import numpy as np
import scipy

from gustproof.robust.lti.state_space import Lti, Matrix
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import RealBlock

_STRICTNESS = 1e-7
"""[-] least margin of each inequality in the balanced loop while the solver minimises the level."""
_BACKOFF = 1.001
"""[-] multiple of the least level at which the margin of the inequalities is then maximised."""
_MIN_HANKEL_RATIO = 1e-2
"""[-] floor of the Hankel singular values relative to the largest, so that balancing stays well posed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Multipliers:
    """A constant Lyapunov matrix and D-G scalings.

    The Lyapunov matrix stays in balanced coordinates: rounded in the loop's own, it would lose the proof.
    """

    coordinates: Matrix
    """(n, n) from the loop's states to the balanced ones."""
    P: Matrix
    """(n, n) Lyapunov matrix in balanced coordinates; `coordinates' P coordinates` in the loop's."""
    D: tuple[Matrix, ...]
    """(k, k) for each block, symmetric."""
    G: tuple[Matrix, ...]
    """(k, k) for each block, skew."""
    level: float
    """[-] gain for which the inequality holds in floating point."""


def best_multipliers(loop: Uncertain) -> Multipliers | None:
    """Return multipliers for about the least provable gain of a continuous loop, or `None` if there are none.

    The loop is balanced first. The solver's result is made symmetric, and the level is computed from it again. Two
    semidefinite programs of size states + Delta + w: least level, then widest margin. 1 s at size 31, 3 s at 38.

    Raises
    ------
    ValueError
        If the loop is discrete, unstable, or has a block that is not a real parameter.
    """
    if loop.M.dt or not loop.M.is_stable():
        raise ValueError("the loop must be continuous and stable at Delta = 0")
    if full := [block.name for block in loop.blocks if not isinstance(block, RealBlock)]:
        raise ValueError(f"block '{full[0]}' is no real parameter")
    inverse, balanced = balance(loop)
    inequality = _Inequality(balanced)
    found = solve_inside(partial(_solve_sdp, inequality), partial(_level, inequality))
    if found is None:
        return None
    unknowns, level = found
    P, D, G = inequality.split(unknowns)
    return Multipliers(coordinates=inverse, P=P, D=D, G=G, level=level)


def solve_inside(
    solve: Callable[[float | None], Matrix], level_of: Callable[[Matrix], float | None]
) -> tuple[Matrix, float] | None:
    """Return unknowns with the level that they prove, or `None` if they prove none.

    Those of the largest margin just above the least level come first, then those of the least level. `solve` is that of
    `solve_level` by the squared level.
    """
    at_least = solve(None)
    inside = solve(_BACKOFF**2 * abs(float(at_least[-1])))
    for unknowns in (inside, at_least):
        level = level_of(unknowns)
        if level is not None:
            return unknowns, level
    return None


def balance(loop: Uncertain, classes: Sequence[Hashable] | None = None) -> tuple[Matrix, Uncertain]:
    """Return the transformation from the loop's states to balanced ones, and the loop in balanced states.

    See `balancing_transform` for `classes`.
    """
    T = balancing_transform(loop.M, classes)
    inverse: Matrix = np.asarray(np.linalg.inv(T), dtype=np.float64)
    M = Lti(A=inverse @ loop.M.A @ T, B=inverse @ loop.M.B, C=loop.M.C @ T, D=loop.M.D)
    return inverse, Uncertain(M=M, blocks=loop.blocks)


def balancing_transform(M: Lti, classes: Sequence[Hashable] | None = None) -> Matrix:
    """Return the state transformation that makes both Gramians equal, except for very weak modes.

    States of different `classes`, one class per state, are not mixed.
    """
    if not M.order:
        return np.zeros((0, 0))
    Wc = scipy.linalg.solve_continuous_lyapunov(M.A, -M.B @ M.B.T)
    Wo = scipy.linalg.solve_continuous_lyapunov(M.A.T, -M.C.T @ M.C)
    kinds = [0] * M.order if classes is None else list(classes)
    T = np.zeros((M.order, M.order))
    for kind in dict.fromkeys(kinds):
        own = np.ix_(*[[i for i, other in enumerate(kinds) if other == kind]] * 2)
        W = 0.5 * (Wc + Wc.T)[own]
        # some modes are unreachable up to rounding: a multiple of rounding makes the Gramian definite
        L = np.linalg.cholesky(W + 1e-13 * np.trace(W) * np.eye(W.shape[0]))
        U, squares, _ = np.linalg.svd(L.T @ Wo[own] @ L)
        hankel = np.maximum(np.sqrt(squares), _MIN_HANKEL_RATIO * np.sqrt(squares[0]))
        T[own] = L @ U / np.sqrt(hankel)
    return T


class _Inequality:
    """`constant + sum_k x_k terms[k] <= 0` in (x, p, w), and the order of the unknowns; the squared level is last."""

    def __init__(self, loop: Uncertain) -> None:
        M, k = loop.M, loop.n_w
        self.n, self.size = M.order, M.order + M.n_inputs
        inputs, output = np.eye(self.size), np.hstack([M.C, M.D])
        derivative, q, z = np.hstack([M.A, M.B]), output[:k], output[k:]
        x, p, w = inputs[: self.n], inputs[self.n : self.n + k], inputs[self.n + k :]
        self.constant = np.asarray(z.T @ z, dtype=np.float64)
        self.repeats = [block.shape[0] for block in loop.blocks]
        self.terms = [add_transpose(x.T @ S @ derivative) for S in basis(self.n, skew=False)]
        start = 0
        for repeats in self.repeats:
            q_i, p_i = q[start : start + repeats], p[start : start + repeats]
            self.terms += [q_i.T @ S @ q_i - p_i.T @ S @ p_i for S in basis(repeats, skew=False)]
            self.terms += [add_transpose(q_i.T @ S @ p_i) for S in basis(repeats, skew=True)]
            start += repeats
        self.terms.append(-w.T @ w)

    def split(self, unknowns: Matrix) -> tuple[Matrix, tuple[Matrix, ...], tuple[Matrix, ...]]:
        """Return P, the D and the G from a vector of unknowns."""
        values = iter(unknowns.tolist())
        matrices = [combine_basis(values, self.n, skew=False)]
        for repeats in self.repeats:
            matrices += [combine_basis(values, repeats, skew=skew) for skew in (False, True)]
        return matrices[0], tuple(matrices[1::2]), tuple(matrices[2::2])


def _solve_sdp(inequality: _Inequality, square: float | None) -> Matrix:
    """Return the unknowns of the least level or, for a given `square` of the level, of the largest margin."""
    cones, column = [], inequality.n * (inequality.n + 1) // 2
    for repeats in inequality.repeats:  # each D is positive definite
        cones.append((column, basis(repeats, skew=False)))
        column += repeats**2  # symmetric and skew together
    return solve_level(inequality.terms, inequality.constant, cones, square)


def solve_level(
    terms: Sequence[Matrix], constant: Matrix, cones: Sequence[tuple[int, Sequence[Matrix]]], square: float | None
) -> Matrix:
    """Return unknowns for which the form `constant` plus their `terms` is negative definite.

    The last term is that of the squared level. Without a `square`, the level is the least; with one, it is given, and
    the margin of all inequalities is the largest. The last unknown is the squared level or that margin.

    Parameters
    ----------
    terms, constant
        (n, n) symmetric.
    cones
        First of some unknowns, and their symmetric matrices, whose combination is to be positive definite.
    square
        [-] squared level, or `None`.
    """
    columns = len(terms)
    if square is not None:
        terms, constant = terms[:-1], constant + square * terms[-1]
    whole = np.zeros((len(svec(constant)), columns))
    whole[:, : len(terms)] = svec_columns(terms)
    parts, bounds = [whole], [-constant]
    for column, cone in cones:
        part = np.zeros((len(svec(cone[0])), columns))
        part[:, column : column + len(cone)] = -svec_columns(cone)
        parts.append(part)
        bounds.append(np.zeros_like(cone[0]))
    for k, bound in enumerate(bounds):
        margin = np.eye(len(bound))
        if square is None:
            bounds[k] = bound - _STRICTNESS * margin
        else:
            parts[k][:, -1] = svec(margin)
    cost = np.zeros(columns)
    cost[-1] = 1.0 if square is None else -1.0
    return minimize(cost, np.vstack(parts), bounds)


def minimize(cost: Matrix, rows: Matrix, bounds: Sequence[Matrix], **options: float) -> Matrix:
    """Return the solver's x of least `cost` x with each block of `rows` x below its symmetric bound.

    `rows` stacks the blocks of all bounds, each in the form of `svec`; `options` are the solver's own.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    for name, value in options.items():
        setattr(settings, name, value)
    quadratic = scipy.sparse.csc_matrix((cost.size, cost.size))
    limits = np.concatenate([svec(bound) for bound in bounds])
    cones = [clarabel.PSDTriangleConeT(bound.shape[0]) for bound in bounds]
    solver = clarabel.DefaultSolver(quadratic, cost, scipy.sparse.csc_matrix(rows), limits, cones, settings)
    return np.array(solver.solve().x, dtype=np.float64)


def _level(inequality: _Inequality, unknowns: Matrix) -> float | None:
    """Return the least level for the multipliers in `unknowns`, independent of the solver's verdict, or `None`."""
    form = inequality.constant + sum(x * term for x, term in zip(unknowns[:-1], inequality.terms[:-1], strict=True))
    return least_level(form, int(np.trace(-inequality.terms[-1])))


def least_level(form: Matrix, inputs: int) -> float | None:
    """Return the least level for which `form` - level^2 |w|^2 is negative, w its last `inputs`, or `None`."""
    rest = form.shape[0] - inputs
    inner, cross = form[:rest, :rest], form[:rest, rest:]
    if not np.all(np.isfinite(form)) or np.linalg.eigvalsh(inner)[-1] >= 0.0:
        return None
    square = np.linalg.eigvalsh(form[rest:, rest:] - cross.T @ np.linalg.solve(inner, cross))[-1]
    return float(np.sqrt(max(square, 0.0)))


def basis(n: int, *, skew: bool) -> list[Matrix]:
    """Return a basis of the symmetric or skew matrices, by columns of the upper triangle."""
    found = []
    for j in range(n):
        for i in range(j if skew else j + 1):
            S = np.zeros((n, n))
            S[i, j], S[j, i] = 1.0, -1.0 if skew else 1.0
            found.append(S)
    return found


def combine_basis(values: Iterator[float], n: int, *, skew: bool) -> Matrix:
    """Return the matrix whose coordinates are the next `values`."""
    matrix = np.zeros((n, n))
    for S in basis(n, skew=skew):
        matrix += next(values) * S
    return matrix


def add_transpose(X: Matrix) -> Matrix:
    """Return X + X'."""
    return np.asarray(X + X.T, dtype=np.float64)


def svec_columns(matrices: Iterable[Matrix]) -> Matrix:
    """Return the `svec` of each matrix as a column."""
    return np.column_stack([svec(S) for S in matrices])


def svec(S: Matrix) -> Matrix:
    """Return the upper triangle by columns, sqrt(2) times off the diagonal: the solver's form of a symmetric matrix."""
    rows, columns = np.tril_indices(S.shape[0])
    return np.asarray(S[columns, rows] * np.where(rows == columns, 1.0, np.sqrt(2.0)), dtype=np.float64)
