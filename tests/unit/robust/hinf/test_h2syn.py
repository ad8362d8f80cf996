"""The least H2 norm, what a returned controller must do, each ill-posed problem by name."""

import control
import numpy as np
import pytest

from gustproof.errors import DesignError
from gustproof.robust.hinf.h2syn import h2syn
from gustproof.robust.lti.norms import h2_norm
from gustproof.robust.lti.state_space import Lti, lft

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
    K = result.controller
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
    assert h2_norm(lft(P, result.controller)) == pytest.approx(result.norm, rel=1e-6)
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


def test_h2syn_refuses_a_discrete_plant():
    with pytest.raises(ValueError, match="P is discrete"):
        h2syn(Lti(**UNSTABLE, D=GOOD_D, dt=0.1), 1, 1)
