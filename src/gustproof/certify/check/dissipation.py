"""The matrix inequalities that prove an L2 gain, in rational numbers.

Part of the judge: the standard library and rational arithmetic only. The system is `x' = A x + B (p, w)`,
`(q, z) = C x + D (p, w)`, closed by `p = Delta(t) q`, where Delta holds real numbers `|delta_i(t)| <= 1`, each times an
identity.
"""

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import product
from typing import Any, NamedTuple

from gustproof.lti.rational import RationalMatrix, add, identity, multiply, scale, to_rational, transpose, zeros


class Vertex(NamedTuple):
    """A corner of the parameters that P depends on, and of their speeds."""

    signs: tuple[int, ...]
    """-1 or 1 for each of these parameters."""
    speeds: tuple[int, ...]
    """-1 or 1 for each of their speeds."""


def vertices(count: int) -> Iterator[Vertex]:
    """Yield all corners of `count` parameters and their speeds, signs first, the last ones fastest."""
    corners = list(product((-1, 1), repeat=count))
    yield from (Vertex(signs, speeds) for signs in corners for speeds in corners)


def lyapunov_matrix(evidence: dict[str, Any], P: Sequence[Sequence[float | Fraction]]) -> RationalMatrix:
    """Return a Lyapunov matrix in the coordinates of the system, from those in which it was found."""
    coordinates = to_rational(evidence["coordinates"])
    return multiply(transpose(coordinates), multiply(to_rational(P), coordinates))


def gain_inequality(level: Fraction, evidence: dict[str, Any]) -> RationalMatrix:
    """Return the matrix that is positive definite only if the L2 gain from w to z is below `level`, however fast Delta.

    With P and each `D_i` positive definite and each `G_i` skew, along every trajectory

        V' + |z|^2 - level^2 |w|^2 + sum_i (q_i' D_i q_i - p_i' D_i p_i + 2 q_i' G_i p_i) < 0,  V = x' P x,

    and no term of the sum is negative, for `q_i' G_i q_i = 0`. The matrix is minus this form in (x, p, w); that it is
    positive definite makes the loop well posed and exponentially stable too.

    References
    ----------
    C. Scherer, LPV control and full block multipliers, Automatica 37 (2001), 361-375 (D-G scalings are the multipliers
    of repeated real parameters).
    """
    system = _System(evidence)
    stored = system.stored(lyapunov_matrix(evidence, evidence["P"]))
    return scale(-1, add(stored, system.supply(level), *system.scaled(evidence["blocks"])))


def rate_bounded_inequalities(level: Fraction, evidence: dict[str, Any]) -> Iterator[RationalMatrix]:
    """Yield a matrix for each of `vertices`; all positive definite prove the gain where some parameters are slow.

    The slow parameters keep `|delta_i'| <= speed_i`, and V = x' P(delta) x with P linear in each of them apart:
    P = sum over sets S of them of `P_S prod_(i in S) delta_i`. To the form of `gain_inequality` come

        x' (sum_i delta_i' dP/ddelta_i) x + 2 (p - Delta q)_slow' Y (x, p, w),

    the last of which is 0 along every trajectory, whatever Y is. The form is linear in each slow parameter and in its
    speed apart, so that inside the box it is a weighted mean of the forms at the vertices, D and G the same mean of
    theirs: there is no grid to look between. P(delta) is positive definite for the same reason.
    """
    system, slow = _System(evidence), rate_bounded_blocks(evidence)
    P = [lyapunov_matrix(evidence, term) for term in evidence["P"]]
    supply, to_x = system.supply(level), transpose(system.x)
    coordinates = multiply(to_rational(evidence["coordinates"]), system.x)
    free = multiply(to_rational(evidence["Y"]), coordinates + system.p + system.w)
    for vertex, scalings in zip(vertices(len(slow)), evidence["vertices"], strict=True):
        signs = vertex.signs
        turning = zeros(len(P[0]), len(P[0]))
        for i, speed in enumerate(vertex.speeds):
            factor = speed * signs[i] * Fraction(evidence["blocks"][slow[i]]["speed"])
            terms = (scale(sign_product(S, signs) * factor, term) for S, term in enumerate(P) if S >> i & 1)
            turning = add(turning, *terms)
        errors: RationalMatrix = []
        for block, sign in zip(slow, signs, strict=True):
            rows = system.rows[block]
            errors += add(system.p[rows], scale(-sign, system.q[rows]))
        cross = multiply(transpose(errors), free)
        stored = add(system.stored(corner(P, signs)), multiply(to_x, multiply(turning, system.x)))
        yield scale(-1, add(stored, cross, transpose(cross), supply, *system.scaled(scalings)))


def rate_bounded_blocks(evidence: dict[str, Any]) -> list[int]:
    """Return which blocks have a bound on their speed."""
    return [i for i, block in enumerate(evidence["blocks"]) if block["speed"] is not None]


def corner(P: Sequence[RationalMatrix], signs: tuple[int, ...]) -> RationalMatrix:
    """Return P(delta) at a corner of the slow parameters, from its term for each set of them, a bit each."""
    if len(P) != 1 << len(signs):
        raise ValueError("P does not have a term for each set of slow parameters")
    return add(*(scale(sign_product(subset, signs), term) for subset, term in enumerate(P)))


def sign_product(subset: int, signs: tuple[int, ...]) -> int:
    """Return the product of the `signs` whose bit is in `subset`."""
    return math.prod(sign for i, sign in enumerate(signs) if subset >> i & 1)


class _System:
    """The evidence's system: each signal as rows that act on (x, p, w)."""

    def __init__(self, evidence: dict[str, Any]) -> None:
        A, B, C, D = (to_rational(evidence["system"][name]) for name in "ABCD")
        sizes = [block["size"] for block in evidence["blocks"]]
        n, m, k = len(A), len(D[0]), sum(sizes)
        unit = identity(n + m)
        self.x, self.p, self.w = unit[:n], unit[n : n + k], unit[n + k :]
        self.derivative = [a + b for a, b in zip(A, B, strict=True)]
        output = [c + d for c, d in zip(C, D, strict=True)]
        self.q, self.z = output[:k], output[k:]
        starts = [sum(sizes[:i]) for i in range(len(sizes))]
        self.rows = [slice(start, start + size) for start, size in zip(starts, sizes, strict=True)]

    def stored(self, P: RationalMatrix) -> RationalMatrix:
        """Return the form of 2 x' P x'."""
        half = multiply(transpose(self.x), multiply(P, self.derivative))
        return add(half, transpose(half))

    def supply(self, level: Fraction) -> RationalMatrix:
        """Return the form of |z|^2 - level^2 |w|^2."""
        z, w = multiply(transpose(self.z), self.z), multiply(transpose(self.w), self.w)
        return add(z, scale(-level * level, w))

    def scaled(self, scalings: list[dict[str, Any]]) -> Iterator[RationalMatrix]:
        """Yield the forms of the D-G scalings of the blocks."""
        for rows, item in zip(self.rows, scalings, strict=True):
            q, p, D, G = self.q[rows], self.p[rows], to_rational(item["D"]), to_rational(item["G"])
            cross = multiply(transpose(q), multiply(G, p))
            yield add(
                multiply(transpose(q), multiply(D, q)),
                scale(-1, multiply(transpose(p), multiply(D, p))),
                cross,
                transpose(cross),
            )
