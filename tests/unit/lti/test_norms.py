"""Norms of systems whose norm is known in closed form, and of random ones against python-control."""

import math
from dataclasses import replace

import control
import numpy as np
import pytest

from gustproof.errors import DesignError
from gustproof.lti import norms
from gustproof.lti.norms import h2_norm, hinf_norm
from gustproof.lti.state_space import Lti, as_lti, gain

TIGHT = 1e-8
"""The norm is promised to 2e-9 relative."""


def transfer(numerator, denominator, dt=0.0) -> Lti:
    return as_lti(control.tf2ss(control.tf(numerator, denominator, dt)))


def test_eigenvalues_of_what_is_no_number_are_refused():
    with pytest.raises(ValueError, match="no number or infinite"):
        norms.eigenvalues(np.array([[np.nan]]))


def test_a_lag_peaks_at_zero_frequency():
    peak = hinf_norm(transfer([6.0], [1.0, 3.0]))
    assert (peak.gain, peak.omega) == (pytest.approx(2.0, rel=TIGHT), 0.0)


@pytest.mark.parametrize("zeta", [0.5, 0.1, 1e-3, 1e-6])
def test_a_resonance_peaks_where_the_textbook_says(zeta):
    peak = hinf_norm(transfer([4.0], [1.0, 4.0 * zeta, 4.0]))
    assert peak.gain == pytest.approx(1.0 / (2.0 * zeta * math.sqrt(1.0 - zeta**2)), rel=TIGHT)
    assert peak.omega == pytest.approx(2.0 * math.sqrt(1.0 - 2.0 * zeta**2), rel=1e-4)  # a flat top hides where it is


def test_a_high_pass_peaks_at_infinity():
    peak = hinf_norm(transfer([1.0, 0.0], [1.0, 1.0]))
    assert (peak.gain, peak.omega) == (pytest.approx(1.0, rel=TIGHT), math.inf)


def test_an_all_pass_has_norm_one():
    assert hinf_norm(transfer([1.0, -2.0], [1.0, 2.0])).gain == pytest.approx(1.0, rel=TIGHT)


def test_a_rise_of_a_few_parts_in_ten_thousand_above_a_plateau_is_found():
    bump = transfer([1.0, 20.0 * 1.0003, 100.0], [1.0, 20.0, 100.0])  # 1 at both ends, rounding hides where it leaves 1
    assert hinf_norm(bump).gain == pytest.approx(1.0003, rel=TIGHT)


def test_a_peak_just_above_the_gain_at_infinity_is_not_lost_in_rounding():
    # every guess lies below the gain at infinity, and the level just above it makes the Hamiltonian matrix huge
    system = Lti(
        A=[
            [-0.6445396338915006, 0.23599825548660097, 0.8610151621733736],
            [-0.12934378528653054, -3.1838561076265615, -0.32429615981767923],
            [0.18363724944982562, -1.2831534866144731, -1.0558129076089575],
        ],
        B=[
            [1.0408415152765786, -1.5262932706948533],
            [-0.12167070072917209, 0.4497134632331462],
            [-0.3012675824275476, 0.44934150817527313],
        ],
        C=[
            [-1.2919499923423572, 0.79392097447448, 0.9910225957106517],
            [0.332407022089407, 1.4355268702506445, 0.759323236825502],
        ],
        D=[[0.9047818635818073, -1.851647165832078], [0.10358283248197178, 2.0782049169216843]],
    )
    peak = hinf_norm(system)
    dense = np.linalg.norm(system.response(np.geomspace(1.0, 30.0, 20001)), 2, axis=(1, 2))
    assert peak.gain == pytest.approx(np.max(dense), rel=TIGHT)
    assert peak.gain > 1.001 * np.linalg.norm(system.D, 2)


def test_a_discrete_resonance_has_the_peak_of_its_dense_response():
    system = Lti(A=0.999 * np.array([[0.6, 0.8], [-0.8, 0.6]]), B=[[1.0], [0.0]], C=[[0.0, 1.0]], D=[[0.1]], dt=0.01)
    peak = hinf_norm(system)
    near = np.linspace(0.99 * peak.omega, 1.01 * peak.omega, 20001)
    assert peak.gain == pytest.approx(np.max(np.abs(system.response(near))), rel=1e-6)  # grid of 1e-6 of the frequency
    assert peak.omega == pytest.approx(math.atan2(0.8, 0.6) / 0.01, rel=1e-3)


def test_an_unstable_system_has_an_infinite_norm_at_its_unstable_pole():
    system = Lti(A=[[0.1, 2.0], [-2.0, 0.1]], B=[[1.0], [0.0]], C=[[1.0, 0.0]], D=[[0.0]])
    peak = hinf_norm(system)
    assert (peak.gain, peak.omega) == (math.inf, pytest.approx(2.0))
    assert h2_norm(system) == math.inf


def test_a_gain_without_states_has_its_largest_singular_value():
    assert hinf_norm(gain(np.diag([3.0, 4.0]))).gain == pytest.approx(4.0)


def test_h2_of_a_lag_is_that_of_its_impulse_response():
    assert h2_norm(transfer([1.0], [1.0, 2.0])) == pytest.approx(0.5, rel=1e-12)


def test_h2_of_a_discrete_lag_is_the_sum_of_its_impulse_response():
    assert h2_norm(transfer([1.0], [1.0, -0.5], 1.0)) == pytest.approx(math.sqrt(1.0 / 0.75), rel=1e-12)


def test_white_noise_through_a_feedthrough_has_infinite_power():
    assert h2_norm(gain([[1.0]])) == math.inf


def test_a_search_that_rises_without_end_is_given_up(monkeypatch):
    monkeypatch.setattr(norms, "_raise_lower_bound", lambda _G, best, _omega: replace(best, gain=2.0 * best.gain + 1.0))
    monkeypatch.setattr(norms, "_crossings", lambda _G, _level: np.array([1.0]))
    with pytest.raises(DesignError, match="did not settle in 60 rounds"):
        hinf_norm(Lti(A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]]))


def test_eigenvalues_that_do_not_converge_are_named(monkeypatch):
    monkeypatch.setattr(norms, "dgeev", lambda _H, **_options: (np.ones(2), np.ones(2), None, None, 1))
    with pytest.raises(np.linalg.LinAlgError, match="the eigenvalues did not converge"):
        hinf_norm(Lti(A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]]))
