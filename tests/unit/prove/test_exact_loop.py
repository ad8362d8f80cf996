"""Loops of a law's own numbers: exact where the file is, and within bounds of what rounding did to the plant."""

from fractions import Fraction

import numpy as np
import pytest

from gustproof.checker.rational import add, identity, multiply, scale
from gustproof.law.resample import continuous_origin
from gustproof.robust.gain import exact_loop
from gustproof.robust.gain.exact_loop import exact_origin, loop_radius
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.uncertain.uncertain_system import Uncertain, lft
from gustproof.robust.uncertain.uncertainty import FullBlock, RealBlock

RNG = np.random.default_rng(7)
SAMPLED = Lti(
    A=np.diag([0.9, 0.5, -0.3]) + 0.1 * RNG.normal(size=(3, 3)),
    B=RNG.normal(size=(3, 5)),
    C=RNG.normal(size=(5, 3)),
    D=RNG.normal(size=(5, 5)),
    dt=0.004,
)
"""Channels of a parameter twice, another once, then two measurements and two commands."""


def blocks(*counts: int) -> tuple[RealBlock, ...]:
    named = zip("tq", counts, strict=True)
    return tuple(RealBlock(name=name, low=-1.0, high=1.0, nominal=0.0, repeats=n) for name, n in named)


LAW = Uncertain(M=continuous_origin(SAMPLED), blocks=blocks(2, 1))


def plant(direct: float = 0.0) -> Uncertain:
    """Return a plant with a part of its own between its two parameters, z and w of two channels."""
    D = RNG.normal(size=(8, 8))
    D[6:, 6:] = direct
    M = Lti(A=RNG.normal(size=(4, 4)), B=RNG.normal(size=(4, 8)), C=RNG.normal(size=(8, 4)), D=D)
    t, q = blocks(1, 2)
    return Uncertain(M=M, blocks=(q, FullBlock(name="late", n_outputs=1, n_inputs=1), t))


def moved(P: Uncertain, share: float) -> Uncertain:
    """Return a plant whose numbers differ by up to `share` of the largest of row and column."""
    found = {}
    for name in "ABCD":
        M = getattr(P.M, name)
        reach = np.maximum(np.abs(M).max(axis=1)[:, None], np.abs(M).max(axis=0))
        found[name] = M + share * reach * RNG.choice([-1.0, 1.0], M.shape)
    found["D"][6:, 6:] = 0.0
    return Uncertain(M=Lti(**found), blocks=P.blocks)


def test_the_exact_origin_is_the_one_that_tustins_rule_maps_to_the_law():
    origin = exact_origin(SAMPLED)
    np.testing.assert_allclose(
        np.array(origin, dtype=float), np.block([[LAW.M.A, LAW.M.B], [LAW.M.C, LAW.M.D]]), rtol=1e-11, atol=1e-11
    )
    A, half = [row[:3] for row in origin[:3]], Fraction(SAMPLED.dt) / 2
    ahead, behind = add(identity(3), scale(half, A)), add(identity(3), scale(-half, A))
    assert multiply([[Fraction(value) for value in row] for row in SAMPLED.A.tolist()], behind) == ahead


def test_the_radius_holds_every_loop_of_a_rounded_plant_and_is_not_much_wider(monkeypatch):
    share = 2.0**-20
    monkeypatch.setattr(exact_loop, "ROUNDING", Fraction(share))
    P, shares = plant(), [1.0, 1.0, 1.0]
    loop = lft(P, LAW, 2, 2)
    radius = {name: np.array(M, dtype=float) for name, M in loop_radius(P, LAW, SAMPLED, shares, loop).items()}
    reached = 0.0
    for _ in range(40):
        other = lft(moved(P, share), LAW, 2, 2)
        for name, limit in radius.items():
            distance = np.abs(getattr(other.M, name) - getattr(loop.M, name))
            assert np.all(distance <= (1.0 + 1e-6) * limit + 1e-12)
            reached = max(reached, float(np.max(distance / np.maximum(limit, 1e-9))))
    assert reached > 0.8


def test_a_loop_of_other_numbers_than_the_laws_is_at_their_distance():
    P = plant()
    loop = lft(P, LAW, 2, 2)
    assert max(float(np.max(np.array(M, dtype=float))) for M in radius_of(P, loop).values()) < 1e-7
    A = LAW.M.A.copy()
    A[1, 2] += 1e-3
    wrong = lft(P, Uncertain(M=Lti(A=A, B=LAW.M.B, C=LAW.M.C, D=LAW.M.D), blocks=LAW.blocks), 2, 2)
    assert float(radius_of(P, wrong)["A"][5][6]) == pytest.approx(1e-3, rel=1e-3)


def radius_of(P: Uncertain, loop: Uncertain) -> dict:
    return loop_radius(P, LAW, SAMPLED, [1.0, 1.0, 1.0], loop)


def test_of_a_smaller_range_only_a_share_is_known():
    P, shares = plant(), [0.5, 0.5, 1.0]
    M = LAW.M
    factors = np.array([*shares, 1.0, 1.0])
    turned = Uncertain(M=Lti(A=M.A, B=M.B * factors, C=M.C, D=M.D * factors), blocks=LAW.blocks)
    loop = lft(P, turned, 2, 2)
    exact = loop_radius(P, turned, SAMPLED, shares, loop)
    # the law's states see its own copies of t after the plant's: columns of q (2 + 1), late, t (1 + 2)
    of_q, of_t = (float(exact["B"][4][column]) for column in (2, 5))
    assert of_q < 1e-3 * of_t
    assert of_t == pytest.approx(float(exact_loop.ROUNDING) * abs(turned.M.B[0, 0]), rel=0.05)


def test_a_plant_that_passes_commands_to_measurements_is_refused():
    P = plant(0.1)
    with pytest.raises(ValueError, match="passes a command to a measurement at once"):
        radius_of(P, lft(P, LAW, 2, 2))
