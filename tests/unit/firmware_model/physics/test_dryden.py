"""Dryden turbulence against MIL-F-8785C; discrete gusts; the moment of a gust."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import quad

from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import Dryden
from firmware_model.numerics.compiled import compiled
from firmware_model.numerics.elementary import normals
from firmware_model.numerics.soa import flatten
from firmware_model.physics.dryden import dryden_filters, dryden_gust, dryden_spectrum, dryden_step, gust_moment
from firmware_model.physics.gust_filters import DrydenParams, DrydenState

DRYDEN = Dryden(kind="dryden", wind_speed_20ft_mps=15.0)
FOOT = 0.3048
SPAN = 1.0
SPECTRUM = dryden_spectrum(DRYDEN, 10.0, SPAN)
HANDBOOK = dryden_spectrum(replace(DRYDEN, specification="MIL-HDBK-1797"), 10.0, SPAN)


def simulate(params: DrydenParams, state: DrydenState, seed: int, samples: int) -> np.ndarray:
    out = np.empty((samples, 6))
    _simulate(params, state, seed, out)
    return out


@compiled
def _simulate(params: DrydenParams, state: DrydenState, seed: int, out: np.ndarray) -> None:
    for k in range(out.shape[0]):
        gust, rates = dryden_gust(params, state)
        for i in range(3):
            out[k, i] = gust[i]
            out[k, 3 + i] = rates[i]
        a, b = normals(seed, 1, k, 0), normals(seed, 1, k, 1)
        state = dryden_step(params, state, (a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]))


def state_space(params: DrydenParams) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B, C of the discrete filters as they are flown, by probing the step with unit vectors."""
    zero, quiet = DrydenState(*[0.0] * 8), (0.0,) * 8
    unit = np.eye(8)
    A = np.array([dryden_step(params, DrydenState(*row), quiet) for row in unit.tolist()]).T
    B = np.array([dryden_step(params, zero, tuple(row)) for row in unit.tolist()]).T
    C = np.array(
        [[*gust, *rates] for gust, rates in (dryden_gust(params, DrydenState(*row)) for row in unit.tolist())]
    ).T
    return A, B, C


def test_intensities_and_lengths_are_those_of_the_low_altitude_model() -> None:
    # By hand from MIL-F-8785C 3.7.3.4 at h = 100 ft: .177 + .000823 * 100 = .2593.
    spectrum = dryden_spectrum(DRYDEN, 100.0 * FOOT, SPAN)
    assert spectrum.sigma_w == pytest.approx(1.5)
    assert spectrum.sigma_u == pytest.approx(1.5 / 0.2593**0.4)
    assert spectrum.L_u == pytest.approx(100.0 / 0.2593**1.2 * FOOT)
    assert spectrum.L_w == pytest.approx(100.0 * FOOT)
    assert spectrum.airspeed == 15.0


def test_the_roll_gust_has_the_variance_of_its_spectrum() -> None:
    # Integrate sigma_w^2 / L_w * .8 (pi L_w / 4b)^(1/3) / (1 + (4 b Omega / pi)^2) numerically.
    b, L_w, sigma_w = SPAN, SPECTRUM.L_w, SPECTRUM.sigma_w
    Omega = np.tan(np.linspace(0.0, math.pi / 2.0, 200001)[:-1])
    density = sigma_w**2 / L_w * 0.8 * (math.pi * L_w / (4 * b)) ** (1 / 3) / (1.0 + (4 * b * Omega / math.pi) ** 2)
    assert float(np.trapezoid(density, Omega)) == pytest.approx(SPECTRUM.sigma_p**2, rel=1e-4)


@pytest.mark.parametrize(
    ("rate", "gust", "sigma", "length", "lag_spans"),
    [(4, 2, SPECTRUM.sigma_w, SPECTRUM.L_w, 4.0), (5, 1, SPECTRUM.sigma_v, SPECTRUM.L_v, 3.0)],
    ids=["q", "r"],
)
def test_pitch_and_yaw_gusts_have_the_variances_of_their_spectra(rate, gust, sigma, length, lag_spans) -> None:
    V, span = SPECTRUM.airspeed, 0.7
    tau, lag = length / V, lag_spans * span / (math.pi * V)

    def density(omega: float) -> float:
        field = sigma**2 * tau * (1.0 + 3.0 * (tau * omega) ** 2) / (1.0 + (tau * omega) ** 2) ** 2
        return field * (omega / V) ** 2 / (1.0 + (lag * omega) ** 2) / math.pi

    params, factor = dryden_filters(SPECTRUM, span, 0.004)
    assert factor.shape == (8, 8)
    _, _, C = state_space(params)
    covariance = C @ factor @ factor.T @ C.T
    assert covariance[gust, gust] == pytest.approx(sigma**2, rel=1e-9)
    corner = 1.0 / lag
    variance = sum(quad(density, a, b, limit=500)[0] for a, b in ((0.0, corner), (corner, math.inf)))
    assert covariance[rate, rate] == pytest.approx(variance, rel=1e-6)


def test_the_handbook_halves_the_transverse_lengths_and_means_the_same_gusts() -> None:
    # MIL-HDBK-1797 at h = 100 ft: 2 L_w = h, 2 L_v = L_u = h / .2593^1.2.
    spectrum = dryden_spectrum(replace(DRYDEN, specification="MIL-HDBK-1797"), 100.0 * FOOT, SPAN)
    assert spectrum.L_w == pytest.approx(50.0 * FOOT)
    assert 2.0 * spectrum.L_v == pytest.approx(spectrum.L_u) == pytest.approx(100.0 / 0.2593**1.2 * FOOT)
    (ours, our_factor), (theirs, their_factor) = (dryden_filters(each, SPAN, 0.004) for each in (HANDBOOK, SPECTRUM))
    np.testing.assert_allclose([*flatten(ours)], [*flatten(theirs)], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(our_factor, their_factor, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(("intensity", "knots"), [("light", 15.0), ("moderate", 30.0), ("severe", 45.0)])
def test_a_word_is_a_wind_speed_and_the_airspeed_is_that_of_the_wind_above_a_floor(
    intensity: str, knots: float
) -> None:
    dryden = Dryden(kind="dryden", intensity=intensity)
    assert dryden_spectrum(dryden, 10.0, SPAN).sigma_w == pytest.approx(0.1 * knots * 1852.0 / 3600.0, rel=1e-5)
    assert dryden.airspeed == dryden.wind_speed_20ft
    assert Dryden(kind="dryden", wind_speed_20ft_mps=0.01).airspeed == 1.0
    assert Dryden(kind="dryden", intensity=intensity, airspeed_mps=15.0).airspeed == 15.0


@pytest.mark.parametrize("dt", [0.0005, 0.004, 0.05])
@pytest.mark.parametrize("specification", ["MIL-F-8785C", "MIL-HDBK-1797"])
def test_the_stationary_variance_is_sigma_squared_at_any_step(dt: float, specification: str) -> None:
    stated = dryden_spectrum(replace(DRYDEN, specification=specification), 10.0, SPAN)
    params, factor = dryden_filters(stated, SPAN, dt)
    A, B, C = state_space(params)
    P = scipy.linalg.solve_discrete_lyapunov(A, B @ B.T)
    variance = np.diag(C @ P @ C.T)[:4]
    expected = np.array([SPECTRUM.sigma_u, SPECTRUM.sigma_v, SPECTRUM.sigma_w, SPECTRUM.sigma_p]) ** 2
    # The Lyapunov solution itself magnifies roundings by the slowest mode, 1 / (1 - a^2).
    np.testing.assert_allclose(variance, expected, rtol=1e-12)
    np.testing.assert_allclose(factor @ factor.T, P, rtol=0.0, atol=1e-12 * P.max())


def continuous_psd(component: int, omega: np.ndarray) -> np.ndarray:
    """Return MIL-F-8785C's two-sided-in-omega density times 2, [unit^2/(rad/s)], frozen field at the airspeed."""
    V, Omega = SPECTRUM.airspeed, omega / SPECTRUM.airspeed
    L = (SPECTRUM.L_u, SPECTRUM.L_v, SPECTRUM.L_w)
    sigma = (SPECTRUM.sigma_u, SPECTRUM.sigma_v, SPECTRUM.sigma_w)
    if component == 0:
        return sigma[0] ** 2 * 2 * L[0] / (math.pi * V) / (1 + (L[0] * Omega) ** 2)
    if component == 3:
        constant = sigma[2] ** 2 / L[2] * 0.8 * (math.pi * L[2] / (4 * SPAN)) ** (1 / 3) / V
        return constant / (1 + (4 * SPAN * Omega / math.pi) ** 2)
    source = {1: 1, 2: 2, 4: 2, 5: 1}[component]
    x = (L[source] * Omega) ** 2
    return _turned(component, Omega, sigma[source] ** 2 * L[source] / (math.pi * V) * (1 + 3 * x) / (1 + x) ** 2)


def handbook_psd(component: int, omega: np.ndarray) -> np.ndarray:
    """Return the same density as MIL-HDBK-1797 writes it, with its own lengths: L_u = 2 L_v, h = 2 L_w."""
    spectrum = HANDBOOK
    V, Omega = spectrum.airspeed, omega / spectrum.airspeed
    if component == 0:
        return spectrum.sigma_u**2 * 2 * spectrum.L_u / (math.pi * V) / (1 + (spectrum.L_u * Omega) ** 2)
    if component == 3:
        constant = 0.8 * (2 * math.pi * spectrum.L_w / (4 * SPAN)) ** (1 / 3)
        return spectrum.sigma_w**2 / (2 * V * spectrum.L_w) * constant / (1 + (4 * SPAN * Omega / math.pi) ** 2)
    L, sigma = (spectrum.L_v, spectrum.sigma_v) if component in (1, 5) else (spectrum.L_w, spectrum.sigma_w)
    x = (L * Omega) ** 2
    return _turned(component, Omega, 2 * sigma**2 * L / (math.pi * V) * (1 + 12 * x) / (1 + 4 * x) ** 2)


def _turned(component: int, Omega: np.ndarray, density: np.ndarray) -> np.ndarray:
    if component in (1, 2):
        return density
    width = {4: 4.0, 5: 3.0}[component] * SPAN / math.pi
    return Omega**2 / (1 + (width * Omega) ** 2) * density


@pytest.mark.parametrize("rate_hz", [100, 400])
@pytest.mark.parametrize(("stated", "formula"), [(SPECTRUM, continuous_psd), (HANDBOOK, handbook_psd)])
def test_the_spectrum_is_that_of_the_specification_at_each_frequency(stated, formula, rate_hz) -> None:
    params, _ = dryden_filters(stated, SPAN, 1.0 / rate_hz)
    A, B, C = state_space(params)
    omega = 2.0 * math.pi * np.geomspace(1e-3, 0.49 * rate_hz, 50)
    response = [C @ np.linalg.solve(np.exp(1j * each / rate_hz) * np.eye(8) - A, B) for each in omega]
    flown = (np.abs(response) ** 2).sum(axis=2).T / (math.pi * rate_hz)
    # Samples hold all frequencies that look alike. Beyond the last of them the densities fall with the square.
    last, around = 4000, 2.0 * math.pi * rate_hz
    alike = np.abs(omega[:, None] + around * np.arange(-last, last + 1))
    for component in range(6):
        beyond = 2.0 * last**2 / (last + 0.5) * float(formula(component, np.array(last * around)))
        expected = formula(component, alike).sum(axis=1) + beyond
        np.testing.assert_allclose(flown[component], expected, rtol=1e-6)


def test_angular_gusts_turn_the_air_as_its_field_says() -> None:
    # A ramp in w along the path: q_gust = -dw/dx. Slow filter states follow a slow ramp with no error but a lag.
    params, _ = dryden_filters(SPECTRUM, SPAN, 0.004)
    (_, v, w), (_, q, r) = dryden_gust(params, DrydenState(0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0))
    assert v > 0.0
    assert r > 0.0
    assert w > 0.0
    assert q < 0.0


@pytest.mark.slow
def test_the_paper_vehicle_feels_a_peak_of_065_newton_metres_in_the_median_of_1000_seeds() -> None:
    vehicle = load_vehicle("paper")
    spectrum = dryden_spectrum(DRYDEN, 10.0, vehicle.span)
    params, factor = dryden_filters(spectrum, vehicle.span, 0.004)
    start = np.random.default_rng(0).normal(size=(1000, 8)) @ factor.T
    peaks = [
        np.abs(simulate(params, DrydenState(*row), seed, 15000)[:, :2]).max() for seed, row in enumerate(start.tolist())
    ]
    # The median of 1,000 peaks of some 17 % spread is known to about .7 %: three of that.
    peak = vehicle.gust_gain * float(np.median(peaks))
    assert peak == pytest.approx(0.65, rel=0.02)


def test_a_gust_from_the_left_rolls_right_and_a_tailwind_pitches_down() -> None:
    # The rotor plane is above the centre of mass: it is blown along, and the vehicle leans that way.
    moment_B = gust_moment(0.08, 0.3, (1.0, 2.0, 4.0))
    assert moment_B == pytest.approx((0.16, -0.08, 0.096))
