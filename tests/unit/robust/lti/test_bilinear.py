"""Bilinear transformations: the frequency they move, their inverse, and what they refuse."""

import numpy as np
import pytest

from gustproof.errors import DesignError
from gustproof.robust.lti.bilinear import bilinear, bilinear_transform, tustin
from gustproof.robust.lti.state_space import Lti

DT = 0.05
G = Lti(A=[[-1.0, 4.0], [-4.0, 0.5]], B=[[1.0], [2.0]], C=[[1.0, 0.5]], D=[[0.3]])


def value(system: Lti, at: complex) -> complex:
    return complex((system.C @ np.linalg.solve(at * np.eye(system.order) - system.A, system.B) + system.D)[0, 0])


@pytest.mark.parametrize("coefficients", [(1.0, -2.0, 0.0, 1.0), (0.9, 0.0, 0.0, 1.0), (2.0, 1.0, 0.3, 0.7)])
def test_the_variable_is_replaced(coefficients):
    a, b, c, d = coefficients
    q = 0.3 + 1.7j
    assert value(bilinear(G, a, b, c, d, dt=0.0), q) == pytest.approx(value(G, (a * q + b) / (c * q + d)), rel=1e-12)


@pytest.mark.parametrize("prewarp", [0.0, 3.0, 40.0])
def test_prewarping_keeps_one_frequency(prewarp):
    sampled = tustin(G, DT, prewarp=prewarp)
    assert sampled.response(prewarp)[0, 0, 0] == pytest.approx(G.response(prewarp)[0, 0, 0], rel=1e-12)
    assert sampled.dt == DT


def test_the_transformation_back_returns_the_system():
    back = bilinear_transform(tustin(G, DT))
    omega = np.geomspace(0.1, 100.0, 20)
    np.testing.assert_allclose(back.response(omega), G.response(omega), rtol=1e-10)


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="is a constant"):
        bilinear(G, 1.0, 2.0, 1.0, 2.0, dt=0.0)
    with pytest.raises(ValueError, match="below the Nyquist frequency"):
        tustin(G, DT, prewarp=70.0)
    with pytest.raises(DesignError, match=r"a pole at 2/dt = 20 rad/s: choose another sample time"):
        tustin(Lti(A=[[20.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]]), 0.1)
    with pytest.raises(DesignError, match="pole at 2"):
        bilinear(Lti(A=[[2.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]]), 2.0, 0.0, 1.0, 1.0, dt=0.0)
