"""Linear systems: what the algebra must give for systems whose answer is known, and the border to python-control."""

import control
import numpy as np
import pytest
import scipy

from gustproof.robust.lti.margins import margins
from gustproof.robust.lti.state_space import (
    Lti,
    as_lti,
    delay,
    discretize_zoh,
    gain,
    largest_gain,
    lft,
    sensitivity,
    series,
)

EXACT = 1e-12
"""A handful of floating-point operations on numbers near 1."""


def lag(a: float, b: float = 1.0) -> Lti:
    return Lti(A=[[-a]], B=[[b]], C=[[1.0]], D=[[0.0]])


def test_a_copy_does_not_change_with_its_original():
    original = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    copy = as_lti(original)
    original.A[0, 0] = 5.0
    assert copy.A[0, 0] == -1.0
    with pytest.raises(ValueError, match="read-only"):
        copy.A[0, 0] = 5.0


def test_a_state_that_python_control_might_call_useless_is_kept():
    system = Lti(A=np.diag([-1.0, -2.0]), B=[[1.0], [0.0]], C=[[1.0, 0.0]], D=[[0.0]])
    assert system.to_control().nstates == 2


def test_only_a_gain_may_have_an_unspecified_time_base_or_a_continuous_system_of_scipy():
    assert as_lti(control.ss([], [], [], [[2.0]], None)).dt == 0.0
    assert as_lti(scipy.signal.StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])).dt == 0.0
    for system in (control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], None), control.tf([1.0], [1.0, 0.5], None)):
        with pytest.raises(ValueError, match="dt of the system is None: give 0 for continuous time"):
            as_lti(system)


def test_a_sample_time_that_is_none_is_refused():
    with pytest.raises(ValueError, match="without a sample time"):
        as_lti(control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], True))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("B", [[1.0, 2.0]], "B has shape"),
        ("A", [[np.nan]], "A has a number that is not finite"),
        ("dt", -0.1, r"dt is -0\.1, must be 0"),
        ("dt", None, "dt is None, must be 0"),
        ("dt", "x", "dt is 'x', must be 0"),
    ],
)
def test_a_system_that_is_not_sound_is_refused(field, value, message):
    matrices = {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]], field: value}
    with pytest.raises(ValueError, match=message):
        Lti(**matrices)


def test_the_largest_gain_of_a_matrix_is_numpys_and_there_is_none_of_what_is_no_number():
    M = np.random.default_rng(1).normal(size=(3, 5))
    assert largest_gain(M) == pytest.approx(np.linalg.norm(M, 2), rel=EXACT)
    with pytest.raises(np.linalg.LinAlgError, match="did not converge"):
        largest_gain(np.full((2, 2), np.nan))


def test_series_multiplies_responses():
    first, second = lag(1.0, 3.0), lag(2.0)
    omega = np.array([0.0, 1.0, 10.0])
    expected = first.response(omega) * second.response(omega)
    assert np.allclose(series(first, second).response(omega), expected, rtol=EXACT)


def test_sensitivity_of_an_integrator_is_a_high_pass():
    integrator = Lti(A=[[0.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]])
    omega = np.array([0.1, 1.0, 10.0])
    expected = 1j * omega / (1j * omega + 1.0)
    assert np.allclose(sensitivity(integrator).response(omega)[:, 0, 0], expected, rtol=EXACT)


def test_lft_agrees_with_python_control():
    rng = np.random.default_rng(0)
    P = Lti(
        A=rng.normal(size=(3, 3)), B=rng.normal(size=(3, 4)), C=rng.normal(size=(3, 3)), D=0.1 * rng.normal(size=(3, 4))
    )
    K = Lti(A=rng.normal(size=(2, 2)), B=rng.normal(size=(2, 1)), C=rng.normal(size=(2, 2)), D=rng.normal(size=(2, 1)))
    theirs = as_lti(P.to_control().lft(K.to_control(), 2, 1))
    omega = np.array([0.3, 2.0])
    assert np.allclose(lft(P, K).response(omega), theirs.response(omega), rtol=1e-9)


def test_a_loop_that_is_not_well_posed_is_refused():
    P, K = gain([[0.0, 1.0], [1.0, 1.0]]), gain([[1.0]])
    with pytest.raises(ValueError, match="not well posed"):
        lft(P, K)
    with pytest.raises(ValueError, match="K is 3 x 3, larger than P, 2 x 2"):
        lft(P, gain(np.eye(3)))


def test_a_held_double_integrator_is_the_textbook_one():
    plant = Lti(A=[[0.0, 1.0], [0.0, 0.0]], B=[[0.0], [1.0]], C=np.eye(2), D=np.zeros((2, 1)))
    sampled = discretize_zoh(plant, 0.1)
    assert np.allclose(sampled.A, [[1.0, 0.1], [0.0, 1.0]], rtol=EXACT)
    assert np.allclose(sampled.B, [[0.005], [0.1]], rtol=EXACT)


def test_a_delay_turns_the_phase_by_one_sample():
    response = delay(1, 0.1).response(3.0)[0, 0, 0]
    assert response == pytest.approx(np.exp(-0.3j), rel=EXACT)


def test_systems_of_different_sample_times_are_not_joined():
    with pytest.raises(ValueError, match="sample times differ"):
        series(delay(1, 0.1), lag(1.0))


def test_a_gain_has_the_sample_time_of_what_it_joins():
    assert series(gain([[2.0]]), delay(1, 0.1)).dt == series(delay(1, 0.1), gain([[2.0]])).dt == 0.1
    assert lft(delay(1, 0.1), gain([[2.0]], 0.1).subsystem([], [])).dt == 0.1


def test_systems_whose_sizes_do_not_fit_are_named():
    with pytest.raises(ValueError, match="a system of 2 x 2 feeds one of 1 x 1"):
        series(delay(2, 0.1), delay(1, 0.1))
    with pytest.raises(ValueError, match="the loop L is 2 x 1, must be square"):
        sensitivity(gain([[1.0], [2.0]]))
    with pytest.raises(ValueError, match="K is 1 x 1, must be 1 x 2 for G"):
        margins(gain([[1.0], [2.0]]), gain([[1.0]]))


def test_a_discrete_system_is_not_held():
    with pytest.raises(ValueError, match=r"discrete already, dt = 0\.1 s"):
        discretize_zoh(delay(1, 0.1), 0.1)


def test_a_transfer_function_gets_states():
    G = as_lti(control.tf([2.0], [1.0, 3.0]))
    assert (G.order, G.response(1.0)[0, 0, 0]) == (1, pytest.approx(2.0 / (3.0 + 1j)))


@pytest.mark.parametrize(
    ("system", "s"),
    [
        (control.tf([1e-16], [1.0, 4e-4, 6e-8, 4e-12, 1e-16]), 1e-4j),
        (control.tf([1e-17], [1.0, 1.0, 1.0]), 1j),
        (control.tf([1e-17, 0.0], [1.0, -0.5], 0.1), 1j),
        (control.tf([1e-20, 1.0], [1.0, 1.0, 0.0]), 1j),
        (control.tf([0.0], [1.0, 1.0]), 1j),
    ],
)
def test_a_transfer_function_of_any_speed_and_size_keeps_its_response(system, s):
    """Of the four slow lags python-control leaves nothing: their norm was 0."""
    found = as_lti(system)
    x = np.linalg.solve(s * np.eye(found.order) - found.A, found.B) if found.order else np.zeros((0, 1))
    assert (found.C @ x + found.D)[0, 0] == pytest.approx(system(s), rel=1e-6)


@pytest.mark.parametrize(
    ("system", "told"),
    [
        (control.tf([1.0, 0.0], [1.0]), "the transfer function has no state space: .*proper"),
        (control.tf([np.nan], [1.0, 1.0]), "the transfer function has a coefficient that is no finite number"),
        (
            scipy.signal.TransferFunction([1.0], [1.0, 1.0]),
            "TransferFunctionContinuous is no linear system: take one of",
        ),
        (3.0, "float is no linear system: take a state space or a transfer function"),
    ],
)
def test_what_has_no_states_is_refused_by_name(system, told):
    with pytest.raises(ValueError, match=told):
        as_lti(system)


def test_complex_numbers_are_refused_by_the_name_of_their_matrix():
    with pytest.raises(ValueError, match="A has complex numbers, must be real"):
        Lti(A=[[-1.0 + 1.0j]], B=[[1.0]], C=[[1.0]], D=[[0.0]])
