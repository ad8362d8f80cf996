"""The least H2 norm, what a returned controller must do, each ill-posed problem by name."""

import control
import numpy as np
import pytest

from gustproof.errors import DesignError
from gustproof.robust.hinf.checked_controller import tell_by_names
from gustproof.robust.hinf.h2syn import h2syn
from gustproof.robust.lti.norms import h2_norm
from gustproof.robust.lti.riccati import RiccatiError, RiccatiFailure
from gustproof.robust.lti.state_space import Lti, gain, lft

UNSTABLE = {"A": [[1.0]], "B": [[1.0, 0.0, 1.0]], "C": [[1.0], [0.0], [1.0]]}
GOOD_D = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]


def random_plant(seed: int) -> Lti:
    rng = np.random.default_rng(seed)
    D = rng.normal(size=(5, 5))
    D[:3, :3] = 0.0
    return Lti(A=rng.normal(size=(4, 4)), B=rng.normal(size=(4, 5)), C=rng.normal(size=(5, 4)), D=D)


@pytest.mark.parametrize("seed", range(5))
def test_h2syn_reaches_its_norm_and_no_change_of_it_is_better(seed):
    P = random_plant(seed)
    result = h2syn(P, 2, 2)
    K = result.lti
    assert h2_norm(lft(P, K)) == pytest.approx(result.gamma, rel=1e-6)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        changes = {name: getattr(K, name) * (1.0 + 0.01 * rng.normal(size=getattr(K, name).shape)) for name in "ABC"}
        assert h2_norm(lft(P, Lti(**changes, D=K.D))) >= result.gamma * (1.0 - 1e-9)


def test_h2syn_of_a_first_order_plant_is_the_one_computed_by_hand():
    # both equations are 2 x + 1 - x^2 = 0: x = 1 + sqrt(2), norm^2 = x + x^3
    x = 1.0 + np.sqrt(2.0)
    result = h2syn(control.ss(*UNSTABLE.values(), GOOD_D), 1, 1)
    assert result.norm == pytest.approx(np.sqrt(x + x**3), rel=1e-9)


def test_h2syn_solves_a_singular_plant_on_request_and_tells_the_cost():
    P = Lti(**UNSTABLE, D=np.zeros((3, 3)))
    result = h2syn(P, 1, 1, regularize=True)
    assert result.regularization > 0.0
    assert result.gamma_excess > 0.0
    assert h2_norm(lft(P, result.lti)) == pytest.approx(result.norm, rel=1e-6)
    assert result.norm <= result.gamma


@pytest.mark.parametrize(
    ("D", "message"),
    [
        (np.zeros((3, 3)), "D12 lacks full column rank"),
        (np.eye(3), "D11 is not 0"),
    ],
)
def test_h2syn_refuses_by_name(D, message):
    with pytest.raises(DesignError, match=message):
        h2syn(Lti(**UNSTABLE, D=D), 1, 1)


@pytest.mark.parametrize("seed", range(3))
def test_a_sampled_controller_has_the_least_norm_with_feedthrough_everywhere(seed):
    rng = np.random.default_rng(seed)
    D = rng.normal(size=(5, 5))
    D[3:, 3:] *= 0.2
    P = Lti(A=0.8 * rng.normal(size=(4, 4)), B=rng.normal(size=(4, 5)), C=rng.normal(size=(5, 4)), D=D, dt=0.1)
    result = h2syn(P, 2, 2)
    K = result.lti
    assert h2_norm(lft(P, K)) == pytest.approx(result.gamma, rel=1e-9)
    for _ in range(6):
        changes = {name: getattr(K, name) + 0.01 * rng.normal(size=getattr(K, name).shape) for name in "ABCD"}
        assert h2_norm(lft(P, Lti(**changes, dt=0.1))) >= result.gamma * (1.0 - 1e-9)


def test_a_sampled_controller_is_the_printed_one():
    """SLICOT, examples/SB10ED.dat and SB10ED.res, to one in the last digit printed."""
    rows = """
    -.7 0 .3 0 -.5 -.1 -.6 .2 -.4 -.3 0 0 -.5 .7 -.1 0 0 -.8 -.7 0 0 -.5 -1 0 0 .3 .6 -.9 .1 -.4 .5 -.8 0 0 .2 -.9
    -1 -2 -2 1 0 1 0 1 -2 1 -3 -4 0 2 -2 1 -2 1 0 -1 0 1 -2 0 3 1 0 3 -1 -2 1 -1 2 -2 0 -3 -3 0 1 -1 1 0 0 2 0 -4 0 -2
    1 -3 0 0 3 1 0 1 -2 1 0 -2 1 -1 -2 0 0 0 1 0 1 0 2 -1 -3 0 1 0 1 0 1 -1 0 0 1 2 1"""
    A, B, C, D = np.split(np.array(rows.split(), float), [36, 66, 96])
    D = D.reshape(5, 5)
    D[:3, :3] = 0.0
    K = h2syn(control.ss(A.reshape(6, 6), B.reshape(6, 5), C.reshape(5, 6), D, 1.0), 2, 2).K
    assert pytest.approx([-0.0551, -2.1891, -0.6607, -0.2532, 0.6674, -1.0044], abs=1e-4) == K.A[0]
    assert np.abs(K.B[:2] - [[-0.5985, -0.5464], [0.5285, 0.6087]]).max() < 1e-4
    assert pytest.approx([0.25, -1.02, -0.3371, -0.2733, 0.2747, -0.4444], abs=1e-4) == K.C[0]
    assert np.abs(K.D - [[-0.2181, -0.2070], [0.1094, 0.1159]]).max() < 1e-4


def test_h2syn_refuses_a_discrete_plant_that_has_no_solution():
    with pytest.raises(ValueError, match="P is discrete"):
        h2syn(Lti(**UNSTABLE, D=GOOD_D, dt=0.1), 1, 1, regularize=True)
    hidden = {"A": [[1.5]], "B": [[1.0, 0.0, 0.0]], "C": [[1.0], [0.0], [1.0]]}
    with pytest.raises(DesignError, match="stabilisable by u"):
        h2syn(Lti(**hidden, D=GOOD_D, dt=0.1), 1, 1)


def test_a_failure_with_a_reason_of_its_own_keeps_it():
    with pytest.raises(RiccatiError, match="no graph") as raised, tell_by_names(gain(np.eye(2)), 1, 1):
        raise RiccatiError(RiccatiFailure.COMPLEMENT)
    assert raised.value.failure is RiccatiFailure.COMPLEMENT
