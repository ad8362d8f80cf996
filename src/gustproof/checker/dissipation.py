"""Matrix inequalities that prove an L2 gain, in rational numbers.

Part of the check: rational arithmetic only; doubles choose coordinates, on which no proof rests. The system is
`x' = A x + B (p, w)`, `(q, z) = C x + D (p, w)`, closed by `p = Delta q`. Delta holds real numbers
`|delta_i(t)| <= 1`, each times an identity, and other parts, of which `quadratic_constraints` are known. The numbers of
the system may be known up to a share only, or up to distances of their own, `radius`. The forms are then those of every
such system.
"""

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import product
from typing import NamedTuple

import numpy as np

from gustproof.checker.evidence_types import (
    AnyGainEvidence,
    ConstrainedGainEvidence,
    GainEvidence,
    LoopEvidence,
    Matrix,
    MultiplierTable,
    SlowGainEvidence,
    SystemMatrices,
)
from gustproof.checker.quadratic_constraints import ConstraintFilter, constraint_form, kind_of, make_filter, needs_rate
from gustproof.checker.rational import (
    RationalMatrix,
    add,
    identity,
    is_positive_definite,
    is_symmetric,
    multiply,
    round_up,
    scale,
    to_rational,
    transpose,
)
from gustproof.checker.system import Refusal

_BITS = 96
"""Binary places of the numbers of balls."""


class Ball(NamedTuple):
    """All matrices whose entries are no further from those of `middle` than those of `radius`."""

    middle: RationalMatrix
    """(n, m) centre."""
    radius: RationalMatrix
    """(n, m) distances, none negative."""

    def is_positive_definite(self) -> bool:
        """Return whether every symmetric matrix of the ball is positive definite: a proof.

        Congruence by any matrix W keeps what it proves: with W F W' diagonally dominant, W is regular and F definite.
        W is the inverse of a Cholesky factor in doubles, so that W F W' is near the identity. What it does not prove of
        one matrix is left to elimination, which takes seven times as long and always tells.
        """
        if not _are_exact(self):
            return self._is_dominant()
        return (is_symmetric(self.middle) and self._is_dominant()) or is_positive_definite(self.middle)

    def _is_dominant(self) -> bool:
        """Return whether W F W' is diagonally dominant for every F of the ball."""
        try:
            W = to_rational(np.linalg.inv(np.linalg.cholesky(np.array(self.middle, dtype=np.float64))).tolist())
        except (ValueError, OverflowError):  # as LinAlgError is
            return False
        short = self if _are_exact(self) else _shorten(self)
        left = ball_product(exact(W), short)
        form = ball_product(left if _are_exact(left) else _shorten(left), exact(transpose(W)))
        for i, (row, off) in enumerate(zip(form.middle, form.radius, strict=True)):
            if not 2 * row[i] > sum(map(abs, row)) + sum(off):
                return False
        return True


def _shorten(A: Ball) -> Ball:
    """Return a ball of shorter numbers that holds `A`."""
    middle = [[round_up(value, _BITS) for value in row] for row in A.middle]
    return Ball(middle, [[value + Fraction(1, 1 << _BITS) for value in row] for row in A.radius])


def exact(A: RationalMatrix) -> Ball:
    """Return the ball of one matrix."""
    return Ball(A, [[Fraction(0)] * len(row) for row in A])


def _are_exact(*balls: Ball) -> bool:
    """Return whether each ball is that of one matrix, which takes half of the work."""
    return not any(any(map(any, ball.radius)) for ball in balls)


def ball_sum(*terms: Ball) -> Ball:
    """Return a ball that holds all sums of matrices of the balls."""
    middle = add(*(term.middle for term in terms))
    return exact(middle) if _are_exact(*terms) else Ball(middle, add(*(term.radius for term in terms)))


def _times(sign: int, A: Ball) -> Ball:
    """Return a ball times -1 or 1."""
    return Ball(scale(sign, A.middle), A.radius)


def _transpose(A: Ball) -> Ball:
    return Ball(transpose(A.middle), transpose(A.radius))


def ball_product(A: Ball, B: Ball) -> Ball:
    """Return a ball that holds all products of matrices of two balls."""
    middle = multiply(A.middle, B.middle)
    if _are_exact(A, B):
        return exact(middle)
    size_A, size_B = ([[abs(value) for value in row] for row in M.middle] for M in (A, B))
    radii = multiply(size_A, B.radius), multiply(A.radius, size_B), multiply(A.radius, B.radius)
    return Ball(middle, [[round_up(value) for value in row] for row in add(*radii)])


class Vertex(NamedTuple):
    """A corner of the box of slow parameters, on which P depends, and of their speeds."""

    signs: tuple[int, ...]
    """-1 or 1 for each parameter."""
    speeds: tuple[int, ...]
    """-1 or 1 for each speed."""


def vertices(count: int) -> Iterator[Vertex]:
    """Yield all corners of `count` parameters and their speeds; speeds vary fastest."""
    corners = list(product((-1, 1), repeat=count))
    yield from (Vertex(signs, speeds) for signs in corners for speeds in corners)


def lyapunov_matrix(evidence: LoopEvidence, P: Matrix) -> RationalMatrix:
    """Return a Lyapunov matrix in the system's coordinates, from the evidence's coordinates."""
    coordinates = to_rational(evidence["coordinates"])
    return multiply(transpose(coordinates), multiply(to_rational(P), coordinates))


def gain_inequality(
    level: Fraction, evidence: GainEvidence | ConstrainedGainEvidence, share: Fraction = Fraction(0)
) -> Ball:
    """Return a matrix whose definiteness proves the L2 gain from w to z below `level`, for Delta of any speed.

    Numbers of the system are within `share` of the largest of their row and column.

    With P and each `D_i` positive definite and each `G_i` skew, along every trajectory

        V' + |z|^2 - level^2 |w|^2 + sum_i (q_i' D_i q_i - p_i' D_i p_i + 2 q_i' G_i p_i) < 0,  V = x' P x.

    No term of the sum is negative, as `q_i' G_i q_i = 0`. The matrix is minus this form in (x, p, w). If it is positive
    definite, the loop is also well posed and exponentially stable.

    References
    ----------
    C. Scherer, LPV control and full block multipliers, Automatica 37 (2001), 361-375 (D-G scalings are the multipliers
    of repeated real parameters).
    """
    system = _System(evidence, share)
    storage = system.storage(lyapunov_matrix(evidence, evidence["P"]))
    return _times(-1, ball_sum(storage, system.supply(level), *system.constraint_terms(evidence["blocks"])))


def stability_inequality(evidence: ConstrainedGainEvidence, share: Fraction = Fraction(0)) -> Ball:
    """Return a matrix whose definiteness, with that of `stability`, proves the system and its filters stable alone.

    `gain_inequality` then needs no definite P: it is the lemma of Kalman, Yakubovich and Popov for constraints on
    integrals over all time (Megretski and Rantzer 1997).

    Raises
    ------
    Refusal
        If a part sees its own output at once: directly, through a later part, or through a parameter.
    """
    system = _System(evidence, share)
    system.check_order()
    form = _times(-1, system.storage(lyapunov_matrix(evidence, evidence["stability"])))
    n = len(system.x[0]) - len(system.p) - len(system.w)
    return Ball(*([row[:n] for row in half[:n]] for half in form))


def rate_bounded_inequalities(
    level: Fraction, evidence: SlowGainEvidence, share: Fraction = Fraction(0)
) -> Iterator[Ball]:
    """Yield a matrix for each of `vertices`; if all are positive definite, the gain is proved for slow parameters.

    Slow parameters keep `|delta_i'| <= speed_i`. V = x' P(delta) x, with P linear in each of them separately: P = sum
    over sets S of slow parameters of `P_S prod_(i in S) delta_i`. The form of `gain_inequality` gains the terms

        x' (sum_i delta_i' dP/ddelta_i) x + 2 (p - Delta q)_slow' Y (x, p, w).

    The last one is 0 along every trajectory, for any Y. The form is linear in each slow parameter and in each speed
    separately. Inside the box it is therefore a weighted mean of the forms at the vertices, with the same mean of their
    D and G: no grid is needed. P(delta) is positive definite for the same reason.
    """
    system, slow = _System(evidence, share), rate_bounded_blocks(evidence)
    P = [lyapunov_matrix(evidence, term) for term in evidence["P"]]
    supply, to_x = system.supply(level), transpose(system.x)
    coordinates = multiply(to_rational(evidence["coordinates"]), system.x)
    free = exact(multiply(to_rational(evidence["Y"]), coordinates + system.p + system.w))
    for vertex, scalings in zip(vertices(len(slow)), evidence["vertices"], strict=True):
        signs = vertex.signs
        rates = []
        for i, (sign, bound) in enumerate(zip(vertex.speeds, slow.values(), strict=True)):
            factor = sign * signs[i] * Fraction(bound)
            rates += [scale(sign_product(S, signs) * factor, term) for S, term in enumerate(P) if S >> i & 1]
        errors = Ball([], [])
        for block, sign in zip(slow, signs, strict=True):
            rows = system.rows[block]
            error = ball_sum(exact(system.p[rows]), _times(-sign, system.q(rows)))
            errors = Ball(errors.middle + error.middle, errors.radius + error.radius)
        cross = ball_product(_transpose(errors), free)
        storage = ball_sum(system.storage(corner(P, signs)), exact(multiply(to_x, multiply(add(*rates), system.x))))
        yield _times(-1, ball_sum(storage, cross, _transpose(cross), supply, *system.constraint_terms(scalings)))


def rate_bounded_blocks(evidence: SlowGainEvidence) -> dict[int, float]:
    """Return the bounds on speed [1/s] of the blocks that have one, by their indices."""
    return {i: speed for i, block in enumerate(evidence["blocks"]) if (speed := block["speed"]) is not None}


def corner(P: Sequence[RationalMatrix], signs: tuple[int, ...]) -> RationalMatrix:
    """Return P(delta) at a corner of the slow parameters; bit i of a term's index stands for parameter i."""
    if len(P) != 1 << len(signs):
        raise ValueError("P does not have a term for each set of slow parameters")
    return add(*(scale(sign_product(subset, signs), term) for subset, term in enumerate(P)))


def sign_product(subset: int, signs: tuple[int, ...]) -> int:
    """Return the product of the `signs` whose bit is set in `subset`."""
    return math.prod(sign for i, sign in enumerate(signs) if subset >> i & 1)


class _System:
    """System of the evidence with the filters of its parts: each signal as rows that act on (x, p, w).

    The states x are those of the system, then of the filter of each part. With a `share`, x is `S` times other
    coordinates: balanced, where what rounding does to the forms is smallest.
    """

    def __init__(self, evidence: AnyGainEvidence, share: Fraction) -> None:
        self._blocks = evidence["blocks"]
        self.rows = _slices(0, [block["size"] for block in self._blocks])
        k, slow = self.rows[-1].stop, "vertices" in evidence
        filters = [ConstraintFilter([], []) if slow else make_filter(block) for block in self._blocks]
        A, B, C, D = _read_system(evidence["system"], k)
        wide = _within_rounding(evidence.get("radius"), {"A": A, "B": B, "C": C, "D": D}, share)
        self._D, self._C = D[:k], wide["C"]
        plant, m = len(A), len(D[0])
        states = _slices(plant, [len(part.A) for part in filters])
        n = states[-1].stop
        S = _coordinates(evidence) if share else identity(n)
        self.x = [row + [Fraction(0)] * m for row in S]
        rest = [[Fraction(0)] * n + row for row in identity(m)]
        self.p, self.w, self._n_q = rest[:k], rest[k:], k
        self._states = [self.x[own] for own in states]
        own = exact(S[:plant])
        derivative = _join(ball_product(wide["A"], own), wide["B"])
        output = _join(ball_product(wide["C"], own), self._keep_zeros(wide["D"]))
        self._output, self._derivative = (_shorten(rows) if share else rows for rows in (output, derivative))
        self._add_filters(filters)

    def _add_filters(self, filters: list[ConstraintFilter]) -> None:
        for part, rows, states in zip(filters, self.rows, self._states, strict=True):
            if part.A:
                inputs = _stack(self.q(rows), exact(self.p[rows]))
                slopes = ball_sum(exact(multiply(part.A, states)), ball_product(exact(part.B), inputs))
                self._derivative = _stack(self._derivative, slopes)

    def _keep_zeros(self, D: Ball) -> Ball:
        """Return D within its rounding; in the rows of parts that are no parameters a zero is none of rounding's."""
        radius = [list(row) for row in D.radius]
        for block, rows in zip(self._blocks, self.rows, strict=True):
            if kind_of(block) != "real":
                for row, off in zip(D.middle[rows], radius[rows], strict=True):
                    off[:] = [r if value else Fraction(0) for value, r in zip(row, off, strict=True)]
        return Ball(D.middle, radius)

    def check_order(self) -> None:
        """Raise `Refusal` unless each part that is no parameter sees at once the outputs of earlier such parts only.

        The loop with any of them is then well posed if that of the parameters is, which `gain_inequality` proves.
        """
        real = [kind_of(block) == "real" for block in self._blocks]
        for i, (block, rows) in enumerate(zip(self._blocks, self.rows, strict=True)):
            if real[i]:
                continue
            later = (columns for j, columns in enumerate(self.rows) if real[j] or j >= i)
            if any(any(row[columns]) for columns in later for row in self._D[rows]):
                raise Refusal(
                    f"block {block['name']} sees at once what a later part or a parameter makes of its output"
                )
            if needs_rate(block) and any(map(any, self._D[rows])):
                raise Refusal(f"the input of block {block['name']} may jump, so that its rate is unknown")

    def q(self, rows: slice) -> Ball:
        """Return some of the inputs of Delta."""
        return Ball(self._output.middle[rows], self._output.radius[rows])

    def _rate(self, rows: slice) -> Ball:
        """Return the derivative of inputs of Delta that do not jump."""
        plant = slice(len(self._C.middle[0]))
        C = Ball(self._C.middle[rows], self._C.radius[rows])
        return ball_product(C, Ball(self._derivative.middle[plant], self._derivative.radius[plant]))

    def storage(self, P: RationalMatrix) -> Ball:
        """Return the form of 2 x' P x'."""
        half = ball_product(exact(multiply(transpose(self.x), P)), self._derivative)
        return ball_sum(half, _transpose(half))

    def supply(self, level: Fraction) -> Ball:
        """Return the form of |z|^2 - level^2 |w|^2."""
        z, w = self.q(slice(self._n_q, None)), multiply(transpose(self.w), self.w)
        return ball_sum(ball_product(_transpose(z), z), exact(scale(-level * level, w)))

    def constraint_terms(self, multipliers: Sequence[MultiplierTable]) -> Iterator[Ball]:
        """Yield the form of each part's constraint."""
        for block, rows, states, item in zip(self._blocks, self.rows, self._states, multipliers, strict=True):
            signals = [exact(states), self.q(rows), exact(self.p[rows])]
            if needs_rate(block):
                signals.append(self._rate(rows))
            z = _stack(*signals)
            yield ball_product(_transpose(z), ball_product(exact(constraint_form(block, item)), z))


def _slices(start: int, sizes: list[int]) -> list[slice]:
    """Return consecutive slices of these sizes."""
    return [slice(start + sum(sizes[:i]), start + sum(sizes[: i + 1])) for i in range(len(sizes))]


def _stack(*parts: Ball) -> Ball:
    """Return matrices below each other."""
    return Ball(*([row for half in halves for row in half] for halves in zip(*parts, strict=True)))


def _read_system(system: SystemMatrices, k: int) -> list[RationalMatrix]:
    """Return A, B, C and D, with at least k inputs and outputs."""
    A, B, C, D = matrices = [to_rational(rows) for rows in (system["A"], system["B"], system["C"], system["D"])]
    n, m = len(A), len(D[0])
    widths = {len(row) for row in A + C} - {n} | {len(row) for row in B + D} - {m}
    if widths or len(B) != n or len(C) != len(D) or k > min(m, len(D)):
        raise ValueError("the system has matrices of wrong shapes")
    return matrices


def _coordinates(evidence: LoopEvidence) -> RationalMatrix:
    """Return about the inverse of the evidence's coordinates; any matrix would do, as a regular one proves the same."""
    return to_rational(np.linalg.inv(np.array(evidence["coordinates"], dtype=np.float64)).tolist())


def widen(A: RationalMatrix, share: Fraction) -> Ball:
    """Return the matrices whose entries differ by `share` of the largest of their row and column."""
    if not share:
        return exact(A)
    rows = [max(map(abs, row), default=Fraction(0)) for row in A]
    columns = [max(map(abs, column)) for column in zip(*A, strict=True)]
    return Ball(A, [[share * max(row, column) for column in columns] for row in rows])


def _within_rounding(
    radius: dict[str, RationalMatrix] | None, matrices: dict[str, RationalMatrix], share: Fraction
) -> dict[str, Ball]:
    """Return matrices within distances of their own, or within `share` if none are known."""
    return {name: Ball(M, radius[name]) if radius else widen(M, share) for name, M in matrices.items()}


def _join(A: Ball, B: Ball) -> Ball:
    """Return two matrices side by side."""
    middle = [a + b for a, b in zip(A.middle, B.middle, strict=True)]
    return Ball(middle, [a + b for a, b in zip(A.radius, B.radius, strict=True)])
