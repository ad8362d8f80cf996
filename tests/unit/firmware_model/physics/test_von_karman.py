"""Von Karman turbulence: rational spectra beside the standard's, and samples that have exactly their law."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import Dryden, VonKarman
from firmware_model.errors import ConfigError
from firmware_model.numerics.soa import flatten
from firmware_model.physics.dryden import dryden_gust, dryden_spectrum
from firmware_model.physics.von_karman import (
    ACROSS,
    ALONG,
    SHOWN,
    STILL,
    KarmanState,
    karman_filters,
    karman_step,
    show_gust,
)
from gustproof.airframe.chance import attitude_box
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import load_law

AIR = VonKarman(kind="von_karman", wind_speed_20ft_mps=15.0)
SCENARIO, PAPER = replace(load_scenario("paper-turbulence"), wind=(AIR,), duration_s=0.4), load_vehicle("paper")
CASES = [
    (AIR, 10.0, 1.0),
    (replace(AIR, airspeed_mps=3.0), 1.0, 0.15),
    (replace(AIR, specification="MIL-HDBK-1797"), 300.0, 4.0),
]


def nest(row: np.ndarray) -> KarmanState:
    x = [float(each) for each in row]
    return KarmanState(tuple(x[:5]), tuple(x[5:11]), tuple(x[11:17]), x[17])


def state_space(spectrum, span, dt):
    """Return A, B, C of the filters as they are flown, by probing with unit vectors, and the stationary covariance."""
    filters, factor = karman_filters(spectrum, span, dt)
    A = np.array([flatten(karman_step(filters, nest(row), (0.0,) * 8)) for row in np.eye(18)]).T
    B = np.array([flatten(karman_step(filters, STILL, tuple(row))) for row in np.eye(8)]).T
    gusts = [dryden_gust(SHOWN, show_gust(filters, nest(row))) for row in np.eye(18)]
    return A, B, np.array([[*gust, *rates] for gust, rates in gusts]).T, factor @ factor.T


def standard_density(spectrum, span, omega):
    """Return MIL-F-8785C 3.7.1.1 of u, v, w, p, q, r [unit^2/(rad/s)], one-sided."""
    V, Omega, scale = spectrum.airspeed, omega / spectrum.airspeed, spectrum.transverse
    lengths = np.array((spectrum.L_u, scale * spectrum.L_v, scale * spectrum.L_w))
    x = (1.339 * lengths[:, None] * Omega) ** 2
    level = (np.array((spectrum.sigma_u, spectrum.sigma_v, spectrum.sigma_w)) ** 2 * lengths / (math.pi * V))[:, None]
    u, v, w = level * np.array([2.0 * (1.0 + x[0]) ** (-5 / 6), *((1.0 + 8 / 3 * x[1:]) * (1.0 + x[1:]) ** (-11 / 6))])
    roll = spectrum.sigma_w**2 / (V * lengths[2]) * 0.8 * (math.pi * lengths[2] / (4.0 * span)) ** (1 / 3)
    fast = [Omega**2 / (1.0 + (spans * span * Omega / math.pi) ** 2) for spans in (4.0, 3.0)]
    return np.array([u, v, w, roll / (1.0 + (4.0 * span * Omega / math.pi) ** 2), fast[0] * w, fast[1] * v])


def rational_autocovariance(shape, sigma, tau, lag, lags):
    """Return those of a gust and of what its lag leaves (2, 2, n), by SciPy from poles and zeros."""
    poles, zeros = (-1.0 / (1.339 * tau * np.array(part)) for part in shape)
    A, B, C, _ = scipy.signal.zpk2ss(zeros, poles, 1.0)
    A = np.block([[A, np.zeros((5, 1))], [C / lag, -np.ones((1, 1)) / lag]])
    B, C = np.vstack([B, [[0.0]]]), np.vstack([np.hstack([C, [[0.0]]]), np.hstack([C, [[-1.0]]])])
    scales = np.diag(scipy.linalg.solve_continuous_lyapunov(A, -B @ B.T)) ** 0.5
    A, B, C = A * scales / scales[:, None], B / scales[:, None], C * scales
    P = scipy.linalg.solve_continuous_lyapunov(A, -B @ B.T)
    found = np.array([C @ scipy.linalg.expm(A * each) @ P @ C.T for each in lags]).transpose(1, 2, 0)
    return found * sigma**2 / found[0, 0, 0]


@pytest.mark.parametrize("dt", [0.004, 0.0005])
@pytest.mark.parametrize(("air", "altitude", "span"), CASES)
def test_samples_have_the_law_of_the_continuous_filters(air, altitude, span, dt) -> None:
    s = dryden_spectrum(air, altitude, span)
    A, B, C, P = state_space(s, span, dt)
    np.testing.assert_allclose(A @ P @ A.T + B @ B.T, P, rtol=0.0, atol=1e-14 * P.max())
    steps = np.array((0, 1, 2, 5, 30, 200, 1000))
    flown = np.array([C @ np.linalg.matrix_power(A, k) @ P @ C.T for k in steps])
    V, whole = s.airspeed, s.transverse / s.airspeed
    assert flown[0].diagonal()[:4] == pytest.approx(np.square((s.sigma_u, s.sigma_v, s.sigma_w, s.sigma_p)), rel=1e-12)
    lags = [spans * span / (math.pi * V) for spans in (3.0, 4.0)]
    u = rational_autocovariance(ALONG, s.sigma_u, s.L_u / V, 1.0, steps * dt)[0, 0]
    np.testing.assert_allclose(flown[:, 0, 0], u, rtol=1e-7, atol=1e-7 * u[0])
    for (i, j), sigma, length, lag, sign in (
        ((1, 5), s.sigma_v, s.L_v, lags[0], 1),
        ((2, 4), s.sigma_w, s.L_w, lags[1], -1),
    ):
        expected = rational_autocovariance(ACROSS, sigma, whole * length, lag, steps * dt)
        unit = np.array((1.0, sign / (lag * V)))
        found = flown[:, [i, j]][:, :, [i, j]].transpose(1, 2, 0) / (unit[:, None] * unit)[:, :, None]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * expected[1, 1, 0])


@pytest.mark.parametrize(("air", "altitude", "span"), CASES)
def test_spectra_are_those_of_the_standard_within_the_stated_error(air, altitude, span) -> None:
    s, dt = dryden_spectrum(air, altitude, span), 2e-5  # so that aliases do not count
    A, B, C, _ = state_space(s, span, dt)
    omega = np.geomspace(0.3, 740.0, 60) * s.airspeed / max(s.L_u, s.L_w * s.transverse)
    response = [C @ np.linalg.solve(np.exp(1j * w * dt) * np.eye(18) - A, B) for w in omega]
    flown = (np.abs(response) ** 2).sum(axis=2).T * dt / math.pi
    error = np.abs(flown / standard_density(s, span, omega) - 1.0).max(axis=1)
    assert np.all(error < (0.0075, 0.0145, 0.0145, 1e-3, 0.0145, 0.0145))
    assert np.all(error[[0, 1, 2]] > 0.005)  # the statement is no looser than it needs to be


@pytest.mark.parametrize("pole", [ACROSS[0][0], ACROSS[0][-1]])
def test_a_lag_at_a_pole_of_the_gust_gives_what_one_beside_it_does(pole) -> None:
    s = dryden_spectrum(AIR, 10.0, 1.0)
    span = math.pi / 4.0 * 1.339 * pole * s.L_w * s.transverse  # its lag of q is the pole
    at, beside = (state_space(s, each, 0.004) for each in (span, span * (1.0 + 1e-5)))
    variances = [(C @ P @ C.T).diagonal() for *_, C, P in (at, beside)]
    assert variances[0] == pytest.approx(variances[1], rel=1e-3)


def test_filters_that_flights_share_can_not_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        karman_filters(dryden_spectrum(AIR, 10.0, 1.0), 1.0, 0.004)[1][0, 0] = 1.0


@pytest.mark.parametrize("airspeed", [1e3, 1e9])
def test_air_that_passes_within_a_sample_is_white(airspeed) -> None:
    s = dryden_spectrum(replace(AIR, airspeed_mps=airspeed), 1.0, 0.5)
    A, B, C, P = state_space(s, 0.5, 0.1)
    np.testing.assert_allclose(A @ P @ A.T + B @ B.T, P, rtol=0.0, atol=1e-14 * P.max())
    variance = (C @ P @ C.T).diagonal()[:4]
    assert variance == pytest.approx(np.square((s.sigma_u, s.sigma_v, s.sigma_w, s.sigma_p)), rel=1e-12)


def test_it_flies_and_is_not_taken_for_dryden() -> None:
    flown = fly_direct(SCENARIO, load_law("flagship"), vehicle=PAPER)
    other = replace(SCENARIO, wind=(Dryden(kind="dryden", wind_speed_20ft_mps=15.0),))
    assert not np.array_equal(flown["gust_B"], fly_direct(other, load_law("flagship"), vehicle=PAPER)["gust_B"])
    assert np.all(np.ptp(np.hstack([flown["gust_B"], flown["gust_omega_B"]]), axis=0) > 0.0)
    with pytest.raises(ValueError, match="only 'dryden' turbulence on a level stand is predicted, not its wind"):
        attitude_box(load_law("flagship"), PAPER, SCENARIO, 1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wind": (AIR, Dryden(kind="dryden", intensity="light"))}, "at most one 'dryden' or 'von_karman'"),
        ({"altitude_m": 305.0}, "'von_karman' is the low-altitude model"),
    ],
)
def test_what_the_model_does_not_have_is_refused(change, message) -> None:
    with pytest.raises((ValueError, ConfigError), match=message):
        replace(SCENARIO, **change)
