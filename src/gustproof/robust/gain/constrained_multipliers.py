"""Multipliers that bound an L2 gain with delays, sectors and slopes, from one linear matrix inequality."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from gustproof.checker.evidence_types import BlockTable
from gustproof.checker.quadratic_constraints import constraint_form, make_filter, needs_rate
from gustproof.robust.gain.multipliers import (
    add_transpose,
    balancing_transform,
    basis,
    least_level,
    solve_inside,
    solve_level,
)
from gustproof.robust.gain.parts import Delay, Part, Slope
from gustproof.robust.lti.state_space import Lti, Matrix
from gustproof.robust.uncertain.uncertain_system import Uncertain


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConstrainedMultipliers:
    """A storage matrix, not definite in general, with the multipliers of each part, and a proof of stability."""

    coordinates: Matrix
    """(n, n) from the states of the loop and the filters to the balanced ones."""
    P: Matrix
    """(n, n) storage matrix in balanced coordinates."""
    stability: Matrix
    """(n, n) Lyapunov matrix of the loop and the filters alone, in balanced coordinates."""
    blocks: tuple[BlockTable, ...]
    """Entries of each block beside name and size."""
    level: float
    """[-] gain for which the inequality holds in floating point."""


def constrained_multipliers(loop: Uncertain, parts: Mapping[str, Part]) -> ConstrainedMultipliers | None:
    """Return multipliers for about the least provable gain of a continuous loop, or `None` if there are none.

    Blocks named in `parts` are these parts, the others real parameters of any speed. Two semidefinite programs, as in
    `best_multipliers`, with the filters of the constraints as further states.

    Raises
    ------
    ValueError
        If the loop is discrete or unstable at Delta = 0.
    """
    if loop.M.dt or not loop.M.is_stable():
        raise ValueError("the loop must be continuous and stable at Delta = 0")
    unknowns = [_Unknowns(block.name, block.shape[0], parts.get(block.name)) for block in loop.blocks]
    program = _Program(loop, unknowns)
    found = solve_inside(program.solve, lambda solution: least_level(program.form(solution), program.m))
    if found is None:
        return None
    solution, level = found
    lyapunov = np.asarray(solve_continuous_lyapunov(program.A.T, -np.eye(program.n)), dtype=np.float64)
    return ConstrainedMultipliers(
        coordinates=program.coordinates,
        P=program.storage(solution),
        stability=0.5 * add_transpose(lyapunov),
        blocks=program.entries(solution),
        level=level,
    )


class _Unknowns:
    """Unknown multipliers of one block: entries of the evidence, linear in the unknowns, and what must be positive."""

    def __init__(self, name: str, size: int, part: Part | None) -> None:
        self.fixed: BlockTable = {"name": name, "size": size}
        self._units: list[dict[str, Matrix]] = []
        self._shapes: dict[str, tuple[int, ...]] = {}
        self.cones: list[list[Matrix]] = []
        """Matrix of each unknown in each inequality `sum_k x_k matrices[k] > 0`."""
        if part is None:
            self._add_definite("D", size)
            self._add("G", basis(size, skew=True), (size, size))
        else:
            self.fixed = {**self.fixed, **part.entries()}
            self._add_part(size, part)
        width = len(self._units)
        self.cones = [cone + [np.zeros_like(cone[0])] * (width - len(cone)) for cone in self.cones]

    def _add_part(self, size: int, part: Part) -> None:
        poles = getattr(part, "poles", ())
        if isinstance(part, Delay):
            if not part.varying:
                self.fixed["poles"] = list(poles)
                self._add_definite("X", size * (1 + len(poles)))
                self._add_definite("Y", size * (1 + len(poles)))
            else:
                self._add_definite("X", size)
            return
        unit = np.eye(size)
        self._add("T", list(unit), (size,))
        remainder = [[unit[i : i + 1, j : j + 1] for j in range(size)] for i in range(size)]
        if isinstance(part, Slope):
            self.fixed["poles"] = list(poles)
            for name in ("causal", "anticausal"):
                self._shapes[name] = (len(poles), size)
                for k in range(len(poles)):
                    for sign in (1.0, -1.0) if part.odd else (1.0,):
                        self._add_multiplier(name, k, sign, remainder)
        self.cones += remainder

    def _add_multiplier(self, name: str, k: int, sign: float, remainder: list[list[Matrix]]) -> None:
        """Add a non-negative unknown for each channel: it uses up so much of T."""
        rows, size = self._shapes[name]
        for i in range(size):
            unit = np.zeros((rows, size))
            unit[k, i] = sign
            zero = np.zeros((1, 1))
            self.cones.append([zero] * len(self._units) + [np.ones((1, 1))])
            self._units.append({name: unit})
            for j, row in enumerate(remainder):
                row.append(np.full((1, 1), -float(i == j)))

    def _add_definite(self, name: str, size: int) -> None:
        matrices = basis(size, skew=False)
        zero = np.zeros((size, size))
        self.cones.append([zero] * len(self._units) + matrices)
        self._add(name, matrices, (size, size))

    def _add(self, name: str, units: list[Matrix], shape: tuple[int, ...]) -> None:
        self._shapes[name] = shape
        self._units += [{name: unit} for unit in units]

    def __len__(self) -> int:
        return len(self._units)

    def entries(self, values: Matrix) -> BlockTable:
        """Return the block's entries at values of its unknowns."""
        found = {name: np.zeros(shape) for name, shape in self._shapes.items()}
        for value, unit in zip(values, self._units, strict=True):
            for name, matrix in unit.items():
                found[name] = found[name] + value * matrix
        return cast(BlockTable, self.fixed | {name: matrix.tolist() for name, matrix in found.items()})

    def forms(self) -> list[Matrix]:
        """Return the form of the constraint for each unknown, in (f, q, p), then q' if it is needed."""
        blocks = [self.entries(row) for row in np.eye(len(self))]
        return [np.array(constraint_form(block, block), dtype=np.float64) for block in blocks]


class _Program:
    """`constant + sum_k x_k terms[k] < 0` in (x, p, w), and the order of the unknowns; the squared level is last."""

    def __init__(self, loop: Uncertain, unknowns: list[_Unknowns]) -> None:
        self._unknowns = unknowns
        M, k = loop.M, loop.n_w
        self.m = M.n_inputs - k
        rows = [slice(a, b) for a, b in pairwise(np.cumsum([0, *(block.shape[0] for block in loop.blocks)]).tolist())]
        blocks = [one.entries(np.ones(len(one))) for one in unknowns]
        filters = [make_filter(block) for block in blocks]
        whole = _with_filters(M, [(np.array(f.A, float), np.array(f.B, float)) for f in filters], rows)
        T = balancing_transform(whole)
        self.coordinates: Matrix = np.asarray(np.linalg.inv(T), dtype=np.float64)
        self.A = self.coordinates @ whole.A @ T
        self.n = n = len(self.A)
        unit = np.eye(n + M.n_inputs)
        x, p, w = unit[:n], unit[n : n + k], unit[n + k :]
        derivative = np.hstack([self.A, self.coordinates @ whole.B])
        output, states = np.hstack([whole.C @ T, whole.D]), T @ x
        self.terms = [add_transpose(x.T @ S @ derivative) for S in basis(n, skew=False)]
        self.constant = np.asarray(output[k:].T @ output[k:], dtype=np.float64)
        start = M.order
        for block, part, at, one in zip(blocks, filters, rows, unknowns, strict=True):
            stop = start + len(part.A)
            signals = [states[start:stop], output[at], p[at]]
            if needs_rate(block):
                signals.append((whole.C @ T)[at] @ derivative)
            z, start = np.vstack(signals), stop
            self.terms += [z.T @ form @ z for form in one.forms()]
        self.terms.append(-w.T @ w)

    def solve(self, square: float | None) -> Matrix:
        """Return the unknowns of the least level or, for a given `square` of the level, of the largest margin."""
        cones, column = list[tuple[int, Sequence[Matrix]]](), self.n * (self.n + 1) // 2
        for one in self._unknowns:
            cones += [(column, cone) for cone in one.cones]
            column += len(one)
        return solve_level(self.terms, self.constant, cones, square)

    def form(self, solution: Matrix) -> Matrix:
        """Return the form at a solution, without the level."""
        total = sum(x * term for x, term in zip(solution[:-1], self.terms[:-1], strict=True))
        return np.asarray(self.constant + total, dtype=np.float64)

    def storage(self, solution: Matrix) -> Matrix:
        """Return P at a solution."""
        matrices = zip(solution, basis(self.n, skew=False), strict=False)
        return np.asarray(sum(x * S for x, S in matrices), dtype=np.float64)

    def entries(self, solution: Matrix) -> tuple[BlockTable, ...]:
        """Return the entries of each block at a solution."""
        return tuple(self._entries(solution))

    def _entries(self, solution: Matrix) -> Iterator[BlockTable]:
        start = self.n * (self.n + 1) // 2
        for one in self._unknowns:
            yield one.entries(solution[start : start + len(one)])
            start += len(one)


def _with_filters(M: Lti, filters: list[tuple[Matrix, Matrix]], rows: list[slice]) -> Lti:
    """Return the loop with the filters of its blocks as further states."""
    widths = [len(A) for A, _ in filters]
    n, total = M.order, M.order + sum(widths)
    A, B = np.zeros((total, total)), np.zeros((total, M.n_inputs))
    A[:n, :n], B[:n] = M.A, M.B
    start = n
    for (A_f, B_f), at, width in zip(filters, rows, widths, strict=True):
        if width:
            own, size = slice(start, start + width), at.stop - at.start
            A[own, :n], A[own, own] = B_f[:, :size] @ M.C[at], A_f
            B[own] = B_f[:, :size] @ M.D[at]
            B[own, at] += B_f[:, size:]
            start += width
    return Lti(A=A, B=B, C=np.hstack([M.C, np.zeros((M.n_outputs, total - n))]), D=M.D)
