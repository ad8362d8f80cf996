"""Norms of systems whose norm is known in closed form, and of random ones against python-control."""

import math
from dataclasses import replace

import control
import numpy as np
import pytest
from control import ss

from gustproof.errors import DesignError
from gustproof.robust.lti import norms
from gustproof.robust.lti.norms import h2_norm, hinf_norm
from gustproof.robust.lti.state_space import Lti, as_lti, gain

TIGHT = 1e-8
"""The norm is promised to 2e-9 relative."""


def transfer(numerator, denominator, dt=0.0) -> Lti:
    return as_lti(control.tf2ss(control.tf(numerator, denominator, dt)))


def test_eigenvalues_of_what_is_no_number_are_refused():
    with pytest.raises(ValueError, match="no number or infinite"):
        norms.eigenvalues(np.array([[np.nan]]))


@pytest.mark.parametrize("accuracy", [0.0, -1e-9, 1.0, math.nan])
def test_an_accuracy_out_of_range_is_refused(accuracy):
    with pytest.raises(ValueError, match="must be between 0 and 1"):
        hinf_norm(gain([[1.0]]), accuracy=accuracy)


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


def test_the_h2_norm_of_a_lag_is_told_at_any_speed() -> None:
    for speed in (1e-300, 1e-160, 1.0, 1e160, 1e300):
        assert h2_norm(transfer([speed], [1.0, speed])) == pytest.approx(math.sqrt(0.5 * speed), rel=1e-12)


@pytest.mark.parametrize("size", [1e-200, 1e-20, 1e15, 1e100])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_the_h2_norm_grows_with_the_gain(size, dt):
    """Of 1e15 the balanced states were spoilt, and the norm was 0."""
    A = np.array([[-0.1, -1.0], [1.0, 0.0]]) if not dt else np.array([[0.5, -0.4], [0.4, 0.5]])
    G, large = (ss(A, [[gain], [0.0]], [[0.0, 1.0]], [[0.0]], dt) for gain in (1.0, size))
    assert h2_norm(large) == pytest.approx(size * h2_norm(G), rel=1e-9)


def test_the_h2_norm_of_very_unlike_poles_is_that_of_the_formula():
    """LAPACK takes poles of 1e-6 and 1e12 rad/s for a sum of zero, and moves them."""
    a, b = 1e-6, 1e12
    power = 0.5 * a + 0.5 * b + 2.0 * a * b / (a + b)
    assert h2_norm(ss([[-a, 0.0], [0.0, -b]], [[1.0], [1.0]], [[a, b]], [[0.0]])) == pytest.approx(
        math.sqrt(power), 1e-6
    )


def test_white_noise_through_a_feedthrough_has_infinite_power():
    assert h2_norm(gain([[1.0]])) == math.inf


def test_a_search_that_rises_without_end_is_given_up(monkeypatch):
    monkeypatch.setattr(norms, "_higher", lambda best, _omega, _gain: replace(best, gain=2.0 * best.gain + 1.0))
    monkeypatch.setattr(norms, "_crossings", lambda _G, _level: (np.array([1.0]), np.array([1.0])))
    with pytest.raises(DesignError, match="did not settle in 60 rounds"):
        hinf_norm(Lti(A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]]))


def test_eigenvalues_that_do_not_converge_are_named(monkeypatch):
    monkeypatch.setattr(norms, "dgeev", lambda _H, **_options: (np.ones(2), np.ones(2), None, None, 1))
    with pytest.raises(np.linalg.LinAlgError, match="the eigenvalues did not converge"):
        hinf_norm(Lti(A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]]))


def random_stable_system(seed: int) -> Lti:
    """Return a system of up to 8 states: dense, or of resonances with spread frequencies, light damping, odd units."""
    rng = np.random.default_rng(seed)
    kind, pairs, width, height = seed % 4, int(rng.integers(1, 5)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    n = 2 * pairs
    A = rng.normal(size=(n, n))
    if kind:
        decades, damping = ((1.0, -6.0), (4.0, -1.5), (2.0, -3.0))[kind - 1]
        A = np.zeros((n, n))
        for k in range(0, n, 2):
            omega, zeta = 10.0 ** rng.uniform(-decades, decades), 10.0 ** rng.uniform(damping, 0.0)
            A[k : k + 2, k : k + 2] = [[0.0, omega], [-omega, -2.0 * zeta * omega]]
        T = np.linalg.qr(rng.normal(size=(n, n)))[0]
        A = T @ A @ T.T
    A -= max(np.linalg.eigvals(A).real.max() + 1e-6, 0.0) * np.eye(n)
    units = 10.0 ** rng.uniform(-6.0, 6.0, size=n) if kind == 3 else np.ones(n)
    B, C = rng.normal(size=(n, width)), rng.normal(size=(height, n))
    dt = 0.0
    if rng.random() < 0.4:
        dt = float(10.0 ** rng.uniform(-3.0, 0.0) / np.max(np.abs(np.linalg.eigvals(A))))
        A = np.linalg.solve(np.eye(n) - 0.5 * dt * A, np.eye(n) + 0.5 * dt * A)
    D = rng.normal(size=(height, width)) * (rng.random() < 0.5)
    return Lti(A=A * units / units[:, None], B=B / units[:, None], C=C * units, D=D, dt=dt)


def precise_gains(G: Lti, omega: np.ndarray) -> np.ndarray:
    """Return the gain of up to two inputs or outputs by elimination in extended precision; its pivots are not sought.

    Each step divides by the largest pivot of its column at each frequency.
    """
    long = np.clongdouble
    points = np.exp(1j * (omega.astype(long) * G.dt)) if G.dt else 1j * omega.astype(long)
    n, at = G.order, np.arange(omega.size)
    work = np.concatenate([-G.A.astype(long), G.B.astype(long)], axis=1)[None].repeat(omega.size, axis=0)
    work[:, range(n), range(n)] += points[:, None]
    for k in range(n):
        pivot = k + np.argmax(np.abs(work[:, k:, k]), axis=1)
        rows = work[at, pivot].copy()
        work[at, pivot] = work[:, k]
        work[:, k] = rows / rows[:, k : k + 1]
        factors = work[:, :, k].copy()
        factors[:, k] = 0.0
        work -= factors[:, :, None] * work[:, k : k + 1]
    response = np.einsum("pn,knm->kpm", G.C.astype(long), work[:, :, n:]) + G.D
    square = np.einsum("kpi,kpj->kij", response.conj(), response)
    if square.shape[1] == 1:
        return np.sqrt(square[:, 0, 0].real)
    half = 0.5 * (square[:, 0, 0] + square[:, 1, 1]).real
    return np.sqrt(half + np.hypot(0.5 * (square[:, 0, 0] - square[:, 1, 1]).real, np.abs(square[:, 0, 1])))


@pytest.mark.parametrize("start", range(0, 100, 20))
def test_the_norm_of_random_systems_is_that_of_extended_precision_within_its_error(start):
    for seed in range(start, start + 20):
        G = random_stable_system(seed)
        peak, poles = hinf_norm(G), G.poles()
        natural = np.abs(np.angle(poles)) / G.dt if G.dt else np.abs(poles.imag)
        width = np.abs(np.log(np.abs(poles))) / G.dt if G.dt else np.abs(poles.real)
        last = math.pi / G.dt if G.dt else 100.0 * np.max(np.abs(poles))
        beside = natural[:, None] + width[:, None] * np.linspace(-2.0, 2.0, 41)
        omega = np.concatenate([[0.0], np.geomspace(1e-9 * last, last, 400), np.clip(beside.ravel(), 0.0, last)])
        assert np.max(precise_gains(G, omega)) <= peak.gain + peak.error, seed
        attained = precise_gains(G, np.array([min(peak.omega, 1e12 * last if not G.dt else last)]))[0]
        assert abs(attained - peak.gain) <= peak.error, seed
        assert peak.error <= 1e-4 * peak.gain, seed


def test_a_matrix_that_sees_no_peak_leaves_a_wider_error(monkeypatch):
    G, hinf_norm_of_g = transfer([4.0], [1.0, 0.4, 4.0]), 5.025189
    assert hinf_norm(G).error < 3e-9 * hinf_norm_of_g
    see = norms._crossings
    monkeypatch.setattr(
        norms,
        "_crossings",
        lambda image, level: see(image, level) if level < 0.999 * hinf_norm_of_g else (np.zeros(0), np.zeros(0)),
    )
    peak = hinf_norm(G)
    assert peak.gain == pytest.approx(hinf_norm_of_g, rel=1e-6)
    assert 1e-3 * peak.gain < peak.error < 0.1 * peak.gain


def test_a_system_that_cancels_to_rounding_has_an_error_of_rounding():
    G = Lti(A=np.diag([-1.0, -1.0 - 1e-15]), B=[[1.0], [1.0]], C=[[0.7, -0.7]], D=[[0.0]])
    peak = hinf_norm(G)
    assert peak.gain + peak.error < 1e-13


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4])
def test_a_peak_between_many_close_poles_is_settled_by_one_look(monkeypatch, seed):
    """Samples beside poles stand close about it: a band was not called narrow, and four more problems were solved."""
    random, n = np.random.default_rng(seed), 60
    A = random.normal(size=(n, n)) / math.sqrt(n)
    A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n)
    system = control.StateSpace(A, random.normal(size=(n, 3)), random.normal(size=(3, n)), np.zeros((3, 3)))
    looks, look = [], norms._crossings
    monkeypatch.setattr(norms, "_crossings", lambda *image: looks.append(1) or look(*image))
    peak = hinf_norm(system)
    assert len(looks) <= 2
    assert peak.gain == pytest.approx(control.norm(system, p="inf", tol=1e-10), rel=TIGHT)
    assert peak.error <= TIGHT * peak.gain
