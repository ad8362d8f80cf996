"""The model of small angles in turbulence foretells what flies."""

import dataclasses
import math

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import Dryden, RandomGusts, VonKarman
from gustproof.airframe.covariance import axis_models, axis_performance, mean_covariance
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import measure
from gustproof.law.cascade import Gains, cascade_law, strapdown_axis
from gustproof.law.form import Provenance

GAINS = Gains(angle_p=8.0, rate_p=14.0, rate_i=80.0, rate_d=0.8, derivative_cutoff=12.0)


@pytest.mark.parametrize("count", [1, 2, 3, 64, 117])
def test_the_mean_covariance_is_that_of_the_plain_recursion(count: int) -> None:
    rng = np.random.default_rng(1)
    F = 0.3 * rng.normal(size=(4, 4))
    F[3] = [0.1, 0.0, 0.0, 1.0]  # an integrator: there is no stationary covariance
    half, start = rng.normal(size=(4, 4)), rng.normal(size=(4, 4))
    Q, P = half @ half.T, start @ start.T
    mean = mean_covariance(F, Q, P, count)
    covariance, total = P, np.zeros((4, 4))
    for _ in range(count):
        total += covariance
        covariance = F @ covariance @ F.T + Q
    np.testing.assert_allclose(mean, total / count, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "delay", "kind"),
    [("paper", 1, Dryden), ("paper", 0, Dryden), ("paper", 3, Dryden), ("iris", 1, Dryden), ("iris", 1, VonKarman)],
)
def test_what_the_model_foretells_is_what_flies(name: str, delay: int, kind: type[RandomGusts]) -> None:
    vehicle = load_vehicle(name)
    air = kind(kind={Dryden: "dryden", VonKarman: "von_karman"}[kind], wind_speed_20ft_mps=15.0)
    scenario = dataclasses.replace(load_scenario("paper-turbulence"), delay_samples=delay, wind=(air,))
    axes = [strapdown_axis(GAINS, inertia, scenario.dt) for inertia in vehicle.inertia_B]
    law = cascade_law("test", axes, vehicle, scenario.dt, Provenance(design="test", vehicle=name))
    foretold = [axis_performance(m, axis) for m, axis in zip(axis_models(vehicle, scenario), axes, strict=True)]
    flights = [
        measure(fly_direct(scenario, law, vehicle=vehicle, seed=seed), vehicle, scenario, 1.0) for seed in range(40)
    ]
    for axis, figures in zip(("roll", "pitch", "yaw"), foretold, strict=True):
        flown = math.sqrt(np.mean([getattr(flight, f"rmse_{axis}_deg") ** 2 for flight in flights]))
        # 40 random walks of 60 s: the mean square has a relative spread of about 1.15 / sqrt(40) = .18, the root .09.
        assert flown == pytest.approx(math.degrees(figures.rmse), rel=0.25)
    pooled = math.sqrt(np.mean([figures.rmse**2 for figures in foretold]))
    flown = math.sqrt(np.mean([flight.rmse_deg**2 for flight in flights]))
    assert flown == pytest.approx(math.degrees(pooled), rel=0.15)
    slew = math.sqrt(np.mean([figures.slew**2 for figures in foretold]))
    # Half a million samples a flight; 1 % is what limits and small angles may cost.
    assert np.mean([flight.torque_slew_rms for flight in flights]) == pytest.approx(slew, rel=0.01)


def test_the_sensitivity_peak_is_that_of_the_loop_written_out() -> None:
    vehicle, scenario = load_vehicle("paper"), load_scenario("paper-turbulence")
    s = 1j * np.geomspace(1.0, 100.0, 4000)
    slope = s / (1.0 + s / (2.0 * math.pi * GAINS.derivative_cutoff))
    K = (GAINS.rate_p + GAINS.rate_i / s + GAINS.rate_d * slope) * (1.0 + GAINS.angle_p / s)
    L = K * np.exp(-1.5 * scenario.dt * s) / (s + vehicle.rate_damping_B[1]) / (1.0 + vehicle.actuator_lag * s)
    model = axis_models(vehicle, scenario)[1]
    peak = axis_performance(model, strapdown_axis(GAINS, model.inertia, scenario.dt)).sensitivity_peak
    # 1 %: the sampled integral and filter differ from the continuous ones by half a sample.
    assert peak == pytest.approx(np.max(1.0 / np.abs(1.0 + L)), rel=0.01)


def test_an_unstable_loop_has_an_infinite_sensitivity_peak() -> None:
    vehicle, scenario = load_vehicle("paper"), load_scenario("paper-turbulence")
    model = axis_models(vehicle, scenario)[0]
    wild = Gains(angle_p=8.0, rate_p=200.0, rate_i=80.0)
    assert axis_performance(model, strapdown_axis(wild, model.inertia, scenario.dt)).sensitivity_peak == math.inf


def test_a_scenario_without_turbulence_is_refused() -> None:
    with pytest.raises(ValueError, match="'calm' has no turbulence"):
        axis_models(load_vehicle("paper"), load_scenario("calm"))
