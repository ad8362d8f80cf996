"""ucover: members are inside, weights are tight and minimum phase, named errors."""

import numpy as np
import pytest
from control import ss

from gustproof.errors import DesignError
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, as_lti, discretize_zoh, series
from gustproof.robust.mu.ucover import ucover

LAGS = (0.8, 0.9, 1.1, 1.3)


def lag(seconds: float, gain: float = 1.0) -> Lti:
    return Lti(A=[[-1.0 / seconds]], B=[[gain / seconds]], C=[[1.0]], D=[[0.0]])


def two_by_two(seed: int) -> Lti:
    rng = np.random.default_rng(seed)
    off = 0.2 * rng.normal(size=(2, 2))
    return Lti(A=np.diag([-1.0, -3.0]), B=np.eye(2), C=np.array([[2.0, 1.0], [0.5, 1.0]]) + off, D=np.zeros((2, 2)))


@pytest.mark.parametrize("form", ["additive", "input", "output"])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_every_member_is_within_the_weight(form, order):
    family = [two_by_two(seed) for seed in range(4)]
    nominal = Lti(A=np.diag([-1.0, -3.0]), B=np.eye(2), C=[[2.0, 1.0], [0.5, 1.0]], D=np.zeros((2, 2)))
    cover = ucover(family, nominal, order, form=form)
    assert cover.weight.nstates == order
    assert as_lti(cover.weight).is_stable()
    for omega in (0.05, 0.7, 3.3, 40.0):  # none is on the grid of the fit
        weight, centre = abs(as_lti(cover.weight).response(omega)[0, 0, 0]), nominal.response(omega)[0]
        for member in family:
            off = member.response(omega)[0] - centre
            E = {"additive": off, "input": np.linalg.solve(centre, off), "output": off @ np.linalg.inv(centre)}[form]
            assert np.linalg.norm(E, 2) <= weight * (1.0 + 1e-6)
    assert cover.model.n_w == cover.model.n_z == 2


def test_the_weight_of_lags_is_known_and_tight():
    cover = ucover([lag(seconds) for seconds in LAGS], lag(1.0), 1)
    # G / G0 - 1 = (1 - T) s / (T s + 1): the largest is |1 - T| / T at T = .8, far above the corners
    assert abs(as_lti(cover.weight).response(1e4)[0, 0, 0]) == pytest.approx(0.25, rel=0.01)
    assert cover.excess == pytest.approx(1.0, abs=0.01)
    assert np.max(cover.distance) == pytest.approx(0.25, rel=1e-3)


def test_a_cover_says_what_it_is_in_four_lines():
    shown = str(ucover([ss(-1.0, 1.0, 1.0, 0.0)], ss(-2.0, 1.0, 1.0, 0.0), 1)).splitlines()
    assert shown[1] == "model: 1 output, 1 input, 2 states, continuous"
    assert shown[3].startswith("weight: 1 x 1, 1 state, continuous, 1")
    assert len(shown) == 4


@pytest.mark.slow
@pytest.mark.parametrize("form", ["additive", "input", "output"])
def test_the_model_holds_its_nominal_and_moves_by_the_weight(form):
    cover = ucover([lag(seconds) for seconds in LAGS], lag(1.0), 1, form=form)
    np.testing.assert_allclose(cover.model.nominal_system().response(0.7), lag(1.0).response(0.7), rtol=1e-9)
    moved = cover.model.member({"unmodelled": 1.0}).response(0.7)[0, 0, 0]
    weight, centre = as_lti(cover.weight).response(0.7)[0, 0, 0], lag(1.0).response(0.7)[0, 0, 0]
    expected = centre + weight if form == "additive" else centre * (1.0 + weight)
    assert moved == pytest.approx(expected, rel=1e-9)


def test_additive_covers_are_exact_in_norm_and_discrete_families_stay_discrete():
    family = [lag(seconds, 1.1) for seconds in LAGS]
    cover = ucover(family, lag(1.0), 2, form="additive")
    V = cover.weight
    inverse = Lti(A=V.A - V.B @ V.C / V.D, B=V.B / V.D, C=-V.C / V.D, D=1.0 / V.D)
    assert inverse.is_stable()
    for member in family:
        off = Lti(A=np.diag([member.A[0, 0], -1.0]), B=[[member.B[0, 0]], [-1.0]], C=[[1.0, 1.0]], D=[[0.0]])
        ratio = Lti(
            A=np.block([[off.A, np.zeros((2, 2))], [inverse.B @ off.C, inverse.A]]),
            B=np.vstack([off.B, np.zeros((2, 1))]),
            C=np.hstack([inverse.D @ off.C, inverse.C]),
            D=[[0.0]],
        )
        assert hinf_norm(ratio).gain <= 1.0 + 1e-6
    discrete = ucover([discretize_zoh(model, 0.05) for model in family], discretize_zoh(lag(1.0), 0.05), 1)
    assert discrete.weight.dt == discrete.model.M.dt == 0.05
    assert as_lti(discrete.weight).is_stable()
    size = np.abs(as_lti(discrete.weight).response(discrete.omega)[:, 0, 0])
    assert np.all(size >= discrete.distance * (1.0 - 1e-6))


@pytest.mark.parametrize(
    ("models", "change", "error", "told"),
    [
        ([], {}, ValueError, "no models"),
        ([lag(1.1)], {"order": -1}, ValueError, "out of range"),
        ([lag(1.1)], {"form": "inverse"}, ValueError, "out of range"),
        ([two_by_two(1)], {}, ValueError, "size or sample time"),
        ([discretize_zoh(lag(1.1), 0.1)], {}, ValueError, "size or sample time"),
        ([lag(-1.1)], {}, DesignError, "1 unstable poles, the nominal model 0"),
        ([lag(1.0)], {}, DesignError, "equals the nominal model"),
    ],
)
def test_bad_families_are_named(models, change, error, told):
    with pytest.raises(error, match=told):
        ucover(**({"models": models, "nominal": lag(1.0), "order": 1} | change))


def test_a_nominal_model_without_rank_has_no_multiplicative_cover():
    flat = Lti(A=-np.eye(2), B=np.eye(2), C=[[1.0, 1.0], [1.0, 1.0]], D=np.zeros((2, 2)))
    other = Lti(A=-np.eye(2), B=np.eye(2), C=[[1.0, 1.0], [1.0, 1.2]], D=np.zeros((2, 2)))
    with pytest.raises(DesignError, match="loses rank"):
        ucover([other], flat, 1)
    assert ucover([other], flat, 1, form="additive").weight.nstates == 1


@pytest.mark.parametrize(("form", "notched"), [("additive", False), ("input", True)])
def test_a_resonance_narrower_than_the_grid_is_inside(form, notched):
    omega, zeta = 37.3, 1e-5
    A, B = [[0.0, omega], [-omega, -2.0 * zeta * omega]], [[0.0], [omega]]
    mode = Lti(A=A, B=B, C=[[1.6 * zeta, 0.0]], D=[[0.0]])
    plain = Lti(A=[[-1.0]], B=[[1.0]], C=[[0.3]], D=[[1.0]])
    if notched:  # 1 - 1.98 zeta omega s / (s^2 + 2 zeta omega s + omega^2): a hundredth of the gain in its middle
        nominal, other = series(Lti(A=A, B=B, C=[[0.0, -1.98 * zeta]], D=[[1.0]]), plain), plain
    else:
        nominal = plain
        other = Lti(
            A=np.block([[plain.A, np.zeros((1, 2))], [np.zeros((2, 1)), mode.A]]),
            B=np.vstack([plain.B, mode.B]),
            C=np.hstack([plain.C, mode.C]),
            D=plain.D,
        )
    cover = ucover([other], nominal, 1, form=form)
    near = omega * (1.0 + zeta * np.linspace(-50.0, 50.0, 2001))
    centre = nominal.response(near)[:, 0, 0]
    off = np.abs(other.response(near)[:, 0, 0] - centre) / (1.0 if form == "additive" else np.abs(centre))
    assert np.all(off <= np.abs(as_lti(cover.weight).response(near)[:, 0, 0]) * 1.001)
    assert np.max(cover.distance) >= 0.99 * np.max(off)
