"""Mixed sensitivity: printed levels, parts of the loop, each ill-posed problem by name."""

import control
import numpy as np
import pytest
from control import ss, tf

from gustproof.errors import DesignError
from gustproof.robust import hinfstruct, ncfsyn
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.hinf.mixsyn import augw, mixsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import as_lti, gain, sensitivity, series

G = control.tf(200, [0.025, 1.0025, 10.1, 1])
W1 = control.tf([1 / 1.5, 10], [1, 10 * 1e-4])


def test_mixsyn_reaches_the_level_that_skogestad_prints():
    """Multivariable Feedback Control, 2nd ed., Example 2.17: 1.37."""
    result = mixsyn(G, W1, 1.0)
    assert result.gamma_opt == pytest.approx(1.37, abs=0.005)
    assert result.norm < result.gamma


def test_mixsyn_closes_negative_feedback():
    result = mixsyn(G, W1, 1.0)
    S = sensitivity(series(result.lti, as_lti(control.tf2ss(G))))
    weighted = hinf_norm(series(S, as_lti(control.tf2ss(W1)))).gain
    told = next(check for check in result.checks if "W1 S" in check)
    assert float(told.split()[-1]) == pytest.approx(weighted, rel=1e-5)
    assert weighted < result.gamma


@pytest.mark.parametrize("weights", [{"W1": W1}, {"W1": W1, "W3": 0.5}, {"W1": [], "W2": 1.0, "W3": None}])
def test_mixsyn_solves_what_weights_left_out_make_singular(weights):
    result = mixsyn(G, **weights)
    assert result.norm < result.gamma


def test_mixsyn_solves_a_plant_with_an_integrator_and_one_sampled():
    lag = control.tf([1.0], [1.0, 1.0, 0.0])
    W = control.tf([0.5, 1.0], [1.0, 0.01])
    assert mixsyn(lag, W, 0.1).regularization > 0.0
    sampled = mixsyn(control.sample_system(lag, 0.1), control.sample_system(W, 0.1, method="tustin"), 0.1)
    assert sampled.lti.dt == 0.1
    assert sampled.norm < sampled.gamma


def test_mixsyn_repeats_a_weight_for_each_channel():
    plant = control.ss(-np.eye(2), np.eye(2), np.array([[1.0, 0.5], [0.0, 1.0]]), np.zeros((2, 2)))
    same = mixsyn(plant, W1, 0.1).gamma_opt
    assert same == pytest.approx(mixsyn(plant, W1, 0.1 * np.eye(2)).gamma_opt, rel=1e-6)


@pytest.mark.parametrize(
    ("weights", "error", "message"),
    [
        ({"W1": None}, ValueError, "one of the weights W1, W2 and W3 must"),
        ({"W1": control.tf([1.0], [1.0, -1.0])}, DesignError, "W1 is not stable: it has a pole at 1"),
        ({"W1": W1, "W2": control.tf([1.0], [1.0, 0.0])}, DesignError, "W2 is not stable: it has a pole at 0"),
        ({"W1": np.ones((1, 3))}, ValueError, r"W1 has 3 inputs, must have 1$"),
        ({"W1": gain([[1.0]], 0.1)}, ValueError, "W1 has the sample time 0.1 s, G 0.0 s"),
    ],
)
def test_mixsyn_names_the_weight_at_fault(weights, error, message):
    with pytest.raises(error, match=message):
        mixsyn(G, **weights)


def test_mixsyn_refuses_what_is_no_system():
    with pytest.raises(ValueError, match="list is no linear system: take a state space or a transfer function"):
        mixsyn([[1.0]], W1)


def test_the_generalised_plant_has_names_which_its_controller_keeps_and_shows():
    P = augw(tf(200, [0.025, 1.0025, 10.1, 1]), tf([1 / 1.5, 10], [1, 10 * 1e-4]), 1.0)
    result = hinfsyn(P, 1, 1, regularize=True)
    assert (result.K.input_labels, result.K.output_labels) == (["e[0]"], ["control[0]"])
    shown = str(result).splitlines()
    assert shown[0] == "HinfResult: 1 x 1, 4 states, continuous"
    assert shown[1].startswith("least level: 1.36")
    assert shown[-1] == "checked: its norm, from its state space alone, is below gamma"
    assert len(shown) <= 10
    assert "<caption>HinfResult" in result._repr_html_()
    assert repr(result) == str(result)


def test_a_controller_keeps_the_names_of_its_plant():
    lag = ss(-1.0, 1.0, 1.0, 0.0, inputs="torque", outputs="rate")
    shaped, mixed = ncfsyn(lag).K, mixsyn(lag, tf([0.6, 10], [1, 0.001]), 1.0).K
    assert (shaped.input_labels, shaped.output_labels) == (["rate"], ["torque"])
    # it reads the error: under the name of the output, a diagram would lose its sign
    assert (mixed.input_labels, mixed.output_labels) == (["e_rate"], ["torque"])
    P = augw(lag, 1.0, 2.0)
    assert (P.input_labels, P.output_labels) == (["r_rate", "torque"], ["z[0]", "z[1]", "e_rate"])
    assert hinfsyn(P, 1, 1, regularize=True).K.input_labels == mixed.input_labels
    D = [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]]
    plant = ss(1.0, [[1, 0, 1]], [[1], [0], [1]], D, inputs=["d", "n", "u"], outputs=["x", "v", "y"])
    static = hinfstruct(plant, 1, 1, starts=1).K
    assert (static.input_labels, static.output_labels) == (["y"], ["u"])
