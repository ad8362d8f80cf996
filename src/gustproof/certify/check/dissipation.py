"""Matrix inequalities that prove an L2 gain, in rational numbers.

Part of the check: standard library and rational arithmetic only. The system is `x' = A x + B (p, w)`,
`(q, z) = C x + D (p, w)`, closed by `p = Delta(t) q`. Delta holds real numbers `|delta_i(t)| <= 1`, each times an
identity.
"""

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import product
from typing import Any, NamedTuple

from gustproof.lti.rational import RationalMatrix, add, identity, multiply, scale, to_rational, transpose, zeros


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


def lyapunov_matrix(evidence: dict[str, Any], P: Sequence[Sequence[float | Fraction]]) -> RationalMatrix:
    """Return a Lyapunov matrix in the system's coordinates, from the evidence's coordinates."""
    coordinates = to_rational(evidence["coordinates"])
    return multiply(transpose(coordinates), multiply(to_rational(P), coordinates))


def gain_inequality(level: Fraction, evidence: dict[str, Any]) -> RationalMatrix:
    """Return a matrix whose definiteness proves the L2 gain from w to z below `level`, for Delta of any speed.

    With P and each `D_i` positive definite and each `G_i` skew, along every trajectory

        V' + |z|^2 - level^2 |w|^2 + sum_i (q_i' D_i q_i - p_i' D_i p_i + 2 q_i' G_i p_i) < 0,  V = x' P x.

    No term of the sum is negative, as `q_i' G_i q_i = 0`. The matrix is minus this form in (x, p, w). If it is positive
    definite, the loop is also well posed and exponentially stable.

    References
    ----------
    C. Scherer, LPV control and full block multipliers, Automatica 37 (2001), 361-375 (D-G scalings are the multipliers
    of repeated real parameters).
    """
    system = _System(evidence)
    storage = system.storage(lyapunov_matrix(evidence, evidence["P"]))
    return scale(-1, add(storage, system.supply(level), *system.scaling_terms(evidence["blocks"])))


def rate_bounded_inequalities(level: Fraction, evidence: dict[str, Any]) -> Iterator[RationalMatrix]:
    """Yield a matrix for each of `vertices`; if all are positive definite, the gain is proved for slow parameters.

    Slow parameters keep `|delta_i'| <= speed_i`. V = x' P(delta) x, with P linear in each of them separately: P = sum
    over sets S of slow parameters of `P_S prod_(i in S) delta_i`. The form of `gain_inequality` gains the terms

        x' (sum_i delta_i' dP/ddelta_i) x + 2 (p - Delta q)_slow' Y (x, p, w).

    The last one is 0 along every trajectory, for any Y. The form is linear in each slow parameter and in each speed
    separately. Inside the box it is therefore a weighted mean of the forms at the vertices, with the same mean of their
    D and G: no grid is needed. P(delta) is positive definite for the same reason.
    """
    system, slow = _System(evidence), rate_bounded_blocks(evidence)
    P = [lyapunov_matrix(evidence, term) for term in evidence["P"]]
    supply, to_x = system.supply(level), transpose(system.x)
    coordinates = multiply(to_rational(evidence["coordinates"]), system.x)
    free = multiply(to_rational(evidence["Y"]), coordinates + system.p + system.w)
    for vertex, scalings in zip(vertices(len(slow)), evidence["vertices"], strict=True):
        signs = vertex.signs
        P_rate = zeros(len(P[0]), len(P[0]))
        for i, speed in enumerate(vertex.speeds):
            factor = speed * signs[i] * Fraction(evidence["blocks"][slow[i]]["speed"])
            terms = (scale(sign_product(S, signs) * factor, term) for S, term in enumerate(P) if S >> i & 1)
            P_rate = add(P_rate, *terms)
        errors: RationalMatrix = []
        for block, sign in zip(slow, signs, strict=True):
            rows = system.rows[block]
            errors += add(system.p[rows], scale(-sign, system.q[rows]))
        cross = multiply(transpose(errors), free)
        storage = add(system.storage(corner(P, signs)), multiply(to_x, multiply(P_rate, system.x)))
        yield scale(-1, add(storage, cross, transpose(cross), supply, *system.scaling_terms(scalings)))


def rate_bounded_blocks(evidence: dict[str, Any]) -> list[int]:
    """Return the indices of the blocks with a bound on their speed."""
    return [i for i, block in enumerate(evidence["blocks"]) if block["speed"] is not None]


def corner(P: Sequence[RationalMatrix], signs: tuple[int, ...]) -> RationalMatrix:
    """Return P(delta) at a corner of the slow parameters; bit i of a term's index stands for parameter i."""
    if len(P) != 1 << len(signs):
        raise ValueError("P does not have a term for each set of slow parameters")
    return add(*(scale(sign_product(subset, signs), term) for subset, term in enumerate(P)))


def sign_product(subset: int, signs: tuple[int, ...]) -> int:
    """Return the product of the `signs` whose bit is set in `subset`."""
    return math.prod(sign for i, sign in enumerate(signs) if subset >> i & 1)


class _System:
    """System of the evidence: each signal as rows that act on (x, p, w)."""

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

    def storage(self, P: RationalMatrix) -> RationalMatrix:
        """Return the form of 2 x' P x'."""
        half = multiply(transpose(self.x), multiply(P, self.derivative))
        return add(half, transpose(half))

    def supply(self, level: Fraction) -> RationalMatrix:
        """Return the form of |z|^2 - level^2 |w|^2."""
        z, w = multiply(transpose(self.z), self.z), multiply(transpose(self.w), self.w)
        return add(z, scale(-level * level, w))

    def scaling_terms(self, scalings: list[dict[str, Any]]) -> Iterator[RationalMatrix]:
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
