"""Multipliers that bound an L2 gain with some real parameters slow, from one linear matrix inequality."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from gustproof.checker.dissipation import Vertex, sign_product, vertices
from gustproof.robust.gain.multipliers import add_transpose, balance, basis, least_level, minimize, svec, svec_columns
from gustproof.robust.gain.symmetry import Mirror, mirror_group
from gustproof.robust.lti.state_space import Matrix
from gustproof.robust.uncertain.uncertain_system import Uncertain

_STRICTNESS = 1e-6
"""[-] least margin of each inequality in the balanced loop."""

BlockScalings = tuple[tuple[Matrix, Matrix], ...]
"""D and G of each block."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateBoundedMultipliers:
    """A Lyapunov matrix that is linear in each slow parameter separately, and the multipliers at each corner."""

    coordinates: Matrix
    """(n, n) from the loop's states to the balanced ones, the coordinates of P and Y."""
    P: tuple[Matrix, ...]
    """(n, n) coefficient of the product of each set of slow parameters; bit i of an index stands for parameter i."""
    Y: Matrix
    """(r, n + k + m) factor of `p - Delta q` of the slow blocks, on (x, p, w)."""
    scalings: tuple[BlockScalings, ...]
    """Scalings at each of `dissipation.vertices`."""
    level: float
    """[-] gain for which the inequalities hold in floating point."""


def rate_bounded_multipliers(loop: Uncertain, speeds: Sequence[float | None]) -> RateBoundedMultipliers | None:
    """Return multipliers for about the least provable gain of a continuous loop, or `None` if there are none.

    `speeds` [1/s] bound the normalised parameter of each block; `None` allows any speed. Corners that mirror each other
    are solved once. For two slow parameters and 31 rows: 8 inequalities, 500 unknowns, 15 s.

    Raises
    ------
    ValueError
        If the loop is discrete or unstable, or all speeds are `None`.
    """
    if loop.M.dt or not loop.M.is_stable():
        raise ValueError("the loop must be continuous and stable at Delta = 0")
    if len(speeds) != len(loop.blocks) or all(speed is None for speed in speeds):
        raise ValueError(f"speeds are {list(speeds)}, must be one a block, not all None")
    group = mirror_group(loop)
    inverse, balanced = balance(loop, list(zip(*(mirror.x for mirror in group), strict=True)))
    program = _Program(balanced, speeds, group)
    unknowns = program.solve()
    levels = [least_level(program.form(unknowns, vertex), program.m) for vertex in program.leaders]
    known = [level for level in levels if level is not None]
    if len(known) < len(levels):
        return None
    P, Y = program.unpack_shared(unknowns)
    scalings = tuple(program.scalings_at(unknowns, vertex) for vertex in vertices(program.count))
    return RateBoundedMultipliers(coordinates=inverse, P=P, Y=Y, scalings=scalings, level=max(known))


class _Program:
    """Inequalities at one corner of each set of mirror images, and the order of the unknowns.

    First P and Y, shared by all corners, then D and G of each corner; the squared level is last.
    """

    def __init__(self, loop: Uncertain, speeds: Sequence[float | None], group: list[Mirror]) -> None:
        M, k = loop.M, loop.n_w
        self.group, self.n, self.m = group, M.order, M.n_inputs - k
        self.slow = [i for i, speed in enumerate(speeds) if speed is not None]
        self.speeds = [speed for speed in speeds if speed is not None]
        self.count = len(self.slow)
        self.repeats = [block.shape[0] for block in loop.blocks]
        starts = np.cumsum([0, *self.repeats]).tolist()
        self.rows = [slice(a, b) for a, b in pairwise(starts)]
        self.unit, output = np.eye(self.n + k + self.m), np.hstack([M.C, M.D])
        self.derivative, self.q, self.z = np.hstack([M.A, M.B]), output[:k], output[k:]
        self.x, self.p, self.w = np.split(self.unit, [self.n, self.n + k])
        self.channels = [row for block in self.slow for row in range(starts[block], starts[block + 1])]
        self.P, self.Y = self._entries_of_P(), self._entries_of_Y()
        self.leaders: list[Vertex] = []
        self.image: dict[Vertex, tuple[int, Mirror]] = {}
        self._choose_leaders()
        self.shared = len(self.P) + len(self.Y)
        self.own = sum(size**2 for size in self.repeats)  # symmetric and skew together

    def _entries_of_P(self) -> list[tuple[int, int, int]]:
        """Return set, row and column of each unknown of P: the entries that every mirror leaves unchanged."""
        return [
            (S, i, j)
            for S in range(1 << self.count)
            for j in range(self.n)
            for i in range(j + 1)
            if self._is_symmetric(S, i, j)
        ]

    def _entries_of_Y(self) -> list[tuple[int, int]]:
        """Return column and channel of each unknown of Y: the entries that every mirror leaves unchanged."""
        signs = [(np.concatenate([mirror.x, mirror.p, mirror.w]), mirror.p) for mirror in self.group]
        columns = range(len(self.unit))
        return [(a, j) for j in self.channels for a in columns if all(s[a] == p[j] for s, p in signs)]

    def _choose_leaders(self) -> None:
        """Choose a leading corner for each set of mirror images, and a mirror from it to each corner."""
        for vertex in vertices(self.count):
            if vertex not in self.image:
                for mirror in self.group:
                    self.image.setdefault(self._mirror_vertex(vertex, mirror), (len(self.leaders), mirror))
                self.leaders.append(vertex)

    def _is_symmetric(self, S: int, i: int, j: int) -> bool:
        """Return whether every mirror leaves the entry (i, j) of the term of set `S` unchanged."""
        return all(
            mirror.x[i] * mirror.x[j] == sign_product(S, tuple(mirror.delta[b] for b in self.slow))
            for mirror in self.group
        )

    def _mirror_vertex(self, vertex: Vertex, mirror: Mirror) -> Vertex:
        turned = [mirror.delta[block] for block in self.slow]
        signs, speeds = (tuple(a * b for a, b in zip(part, turned, strict=True)) for part in vertex)
        return Vertex(signs, speeds)

    def _shared_terms(self, vertex: Vertex) -> Iterator[Matrix]:
        """Yield the coefficient of each unknown of P and Y at a corner."""
        signs = vertex.signs
        for S, i, j in self.P:
            E = _unit(self.n, i, j)
            value = sign_product(S, signs)
            slope = sum(
                a * s * v
                for b, (a, s, v) in enumerate(zip(signs, vertex.speeds, self.speeds, strict=True))
                if S >> b & 1
            )
            yield value * (add_transpose(self.x.T @ E @ self.derivative) + slope * self.x.T @ E @ self.x)
        owner = np.repeat(signs, [self.repeats[block] for block in self.slow])
        error = {j: self.p[j] - sign * self.q[j] for j, sign in zip(self.channels, owner, strict=True)}
        for a, j in self.Y:
            yield add_transpose(np.outer(self.unit[a], error[j]))

    def _own_terms(self) -> Iterator[Matrix]:
        """Yield the coefficient of each unknown of a corner's D and G."""
        for rows, repeats in zip(self.rows, self.repeats, strict=True):
            q, p = self.q[rows], self.p[rows]
            yield from (q.T @ S @ q - p.T @ S @ p for S in basis(repeats, skew=False))
            yield from (add_transpose(q.T @ S @ p) for S in basis(repeats, skew=True))

    def form(self, unknowns: Matrix, vertex: Vertex) -> Matrix:
        """Return the form at a leading corner, without the level."""
        start = self.shared + self.leaders.index(vertex) * self.own
        values = np.concatenate([unknowns[: self.shared], unknowns[start : start + self.own]])
        terms = [*self._shared_terms(vertex), *self._own_terms()]
        return np.asarray(self.z.T @ self.z + np.tensordot(values, np.array(terms), 1), dtype=np.float64)

    def solve(self) -> Matrix:
        """Return the solver's unknowns of the least level."""
        count, size = len(self.leaders), len(self.unit)
        shared = np.vstack([svec_columns(self._shared_terms(vertex)) for vertex in self.leaders])
        own = scipy.linalg.block_diag(*[svec_columns(self._own_terms())] * count)
        last = np.concatenate([svec(-self.w.T @ self.w)] * count)
        definite_P, definite_D = self._definiteness_rows()
        top, middle = shared.shape[0], shared.shape[0] + definite_P.shape[0]
        bottom = scipy.linalg.block_diag(*[definite_D] * count)
        rows = np.zeros((middle + bottom.shape[0], self.shared + own.shape[1] + 1))
        rows[:top, : self.shared], rows[:top, self.shared : -1], rows[:top, -1] = shared, own, last
        rows[top:middle, : self.shared], rows[middle:, self.shared : -1] = definite_P, bottom
        sides = [self.n] * (definite_P.shape[0] * 2 // (self.n * (self.n + 1))) + self.repeats * count
        bounds = [-self.z.T @ self.z - _STRICTNESS * np.eye(size)] * count + [
            -_STRICTNESS * np.eye(side) for side in sides
        ]
        cost = np.zeros(rows.shape[1])
        cost[-1] = 1.0
        return minimize(cost, rows, bounds)

    def _definiteness_rows(self) -> tuple[Matrix, Matrix]:
        """Return the rows of -P at its corners, for the shared unknowns, and of -D, for a corner's own; packed."""
        parts = []
        for signs in dict.fromkeys(vertex.signs for vertex in self.leaders):
            P = svec_columns(-sign_product(S, signs) * _unit(self.n, i, j) for S, i, j in self.P)
            parts.append(np.hstack([P, np.zeros((P.shape[0], len(self.Y)))]))
        scalings = []
        for size in self.repeats:
            D = -svec_columns(basis(size, skew=False))
            scalings.append(np.hstack([D, np.zeros((D.shape[0], size * (size - 1) // 2))]))
        return np.vstack(parts), np.asarray(scipy.linalg.block_diag(*scalings), dtype=np.float64)

    def unpack_shared(self, unknowns: Matrix) -> tuple[tuple[Matrix, ...], Matrix]:
        """Return P, one term per set, and Y."""
        P = np.zeros((1 << self.count, self.n, self.n))
        for (S, i, j), value in zip(self.P, unknowns, strict=False):
            P[S, i, j] = P[S, j, i] = value
        Y = np.zeros((len(self.channels), len(self.unit)))
        for (a, j), value in zip(self.Y, unknowns[len(self.P) :], strict=False):
            Y[self.channels.index(j), a] = value
        return tuple(P), Y

    def scalings_at(self, unknowns: Matrix, vertex: Vertex) -> BlockScalings:
        """Return D and G of each block at any corner, mirrored from its leading corner."""
        leader, mirror = self.image[vertex]
        start = self.shared + leader * self.own
        found = []
        for rows, size, sign in zip(self.rows, self.repeats, mirror.delta, strict=True):
            turned, half = np.outer(mirror.q[rows], mirror.q[rows]), size * (size + 1) // 2
            D = sum(value * S for value, S in zip(unknowns[start : start + half], basis(size, skew=False), strict=True))
            skew = unknowns[start + half : start + size**2]
            G = sum((value * S for value, S in zip(skew, basis(size, skew=True), strict=True)), np.zeros((size, size)))
            found.append((np.asarray(D * turned), np.asarray(sign * G * turned)))
            start += size**2
        return tuple(found)


def _unit(n: int, i: int, j: int) -> Matrix:
    E = np.zeros((n, n))
    E[i, j] = E[j, i] = 1.0
    return E
