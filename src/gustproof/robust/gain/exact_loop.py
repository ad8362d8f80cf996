"""Rounding of the loop of a plant and a law file: the file's numbers are exact, those of the plant are derived."""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from gustproof.checker.dissipation import Ball, ball_product, ball_sum, widen
from gustproof.checker.evidence import ROUNDING
from gustproof.checker.rational import RationalMatrix, add, identity, inverse, multiply, round_up, scale, to_rational
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import rows


def exact_origin(K: Lti) -> RationalMatrix:
    """Return `[A, B; C, D]` of the continuous controller that Tustin's rule maps to `K`, without rounding."""
    A, B, C, D = (to_rational(M.tolist()) for M in (K.A, K.B, K.C, K.D))
    n, dt = len(A), Fraction(K.dt)
    implicit = scale(2, inverse(add(A, identity(n))))
    B = scale(1 / dt, multiply(implicit, B))
    D = add(D, scale(-dt / 2, multiply(C, B)))
    A, C = scale(2 / dt, add(identity(n), scale(-1, implicit))), multiply(C, implicit)
    return [a + b for a, b in zip(A, B, strict=True)] + [c + d for c, d in zip(C, D, strict=True)]


def loop_radius(
    P: Uncertain, K: Uncertain, sampled: Lti, shares: Sequence[float], loop: Uncertain
) -> dict[str, RationalMatrix]:
    """Return the distances of the numbers of `loop`, the star of `P` and `K`, from those without rounding.

    Numbers of `P` are within `ROUNDING` of the largest of their row and column; what is never joined is 0. Those of `K`
    are the continuous ones of `sampled`, exactly. Its parameters have other ranges than those of `P`: `shares` scale
    its first inputs, each within `ROUNDING` of itself.

    Raises
    ------
    ValueError
        If the plant passes a command to a measurement at once.
    """
    n_y, n_u = K.n_inputs, K.n_outputs
    if np.any(P.M.D[-n_y:, -n_u:]):
        raise ValueError("the plant passes a command to a measurement at once")
    plant, law = _plant(P.M), _law(exact_origin(sampled), [1.0] * K.M.order + list(shares))
    kept, seen = slice(len(plant.middle) - n_y), slice(len(plant.middle) - n_y, None)
    left, driven = slice(len(plant.middle[0]) - n_u), slice(len(plant.middle[0]) - n_u, None)
    own, command = slice(len(law.middle) - n_u), slice(len(law.middle) - n_u, None)
    known, measured = slice(len(law.middle[0]) - n_y), slice(len(law.middle[0]) - n_y, None)
    across, direct = _part(plant, kept, driven), _part(plant, seen, left)
    turned = ball_product(across, ball_product(_part(law, command, measured), direct))
    corner = ball_sum(_part(plant, kept, left), turned)
    upper = _beside(corner, ball_product(across, _part(law, command, known)))
    lower = _beside(ball_product(_part(law, own, measured), direct), _part(law, own, known))
    outputs, inputs = _order(P, K, loop, len(upper.middle)), _order(P, K, loop, len(corner.middle[0]))
    n, size = loop.M.order, {"A": (0, 0), "B": (0, 1), "C": (1, 0), "D": (1, 1)}
    found = {}
    for name, (below, right) in size.items():
        rows_of, columns_of = (
            places[n:] if after else places[:n] for places, after in ((outputs, below), (inputs, right))
        )
        exact_part = [[(upper.middle + lower.middle)[i][j] for j in columns_of] for i in rows_of]
        spread = [[(upper.radius + lower.radius)[i][j] for j in columns_of] for i in rows_of]
        given = to_rational(getattr(loop.M, name).tolist())
        moved = add(given, scale(-1, exact_part))
        found[name] = [
            [round_up(abs(a) + b) for a, b in zip(*pair, strict=True)] for pair in zip(moved, spread, strict=True)
        ]
    return found


def _plant(M: Lti) -> Ball:
    """Return `[A, B; C, D]` of a derived plant, each matrix within its rounding."""
    A, B, C, D = (widen(to_rational(part.tolist()), ROUNDING) for part in (M.A, M.B, M.C, M.D))
    upper, lower = _beside(A, B), _beside(C, D)
    return Ball(upper.middle + lower.middle, upper.radius + lower.radius)


def _law(M: RationalMatrix, factors: Sequence[float]) -> Ball:
    """Return a controller whose first columns are scaled; of a factor other than 1 only `ROUNDING` of it is known."""
    full = [Fraction(factor) for factor in factors] + [Fraction(1)] * (len(M[0]) - len(factors))
    middle = [[factor * value for factor, value in zip(full, row, strict=True)] for row in M]
    unsure = [Fraction(0) if factor == 1 else ROUNDING for factor in full]
    return Ball(middle, [[share * abs(value) for share, value in zip(unsure, row, strict=True)] for row in middle])


def _part(A: Ball, rows_of: slice, columns_of: slice) -> Ball:
    return Ball(*([row[columns_of] for row in half[rows_of]] for half in A))


def _beside(A: Ball, B: Ball) -> Ball:
    return Ball(*([a + b for a, b in zip(*pair, strict=True)] for pair in zip(A, B, strict=True)))


def _order(P: Uncertain, K: Uncertain, loop: Uncertain, width: int) -> list[int]:
    """Return the places of the loop's states and channels among those of `P`, `width` in all, followed by those of `K`.

    A parameter's copies in `P` come before those in `K`.
    """
    n, n_K = P.M.order, K.M.order
    places = [*range(n), *range(width, width + n_K)]
    for block in loop.blocks:
        for part, start in ((P, n), (K, width + n_K)):
            at = {own.name: own_rows for own, own_rows in zip(part.blocks, rows(part.blocks), strict=True)}
            if block.name in at:
                places += range(start + at[block.name].start, start + at[block.name].stop)
    return [*places, *range(n + P.n_w, width)]
