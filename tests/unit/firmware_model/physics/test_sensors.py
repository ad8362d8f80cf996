"""Gyro and accelerometer as asked for: noise, bias, range, float32."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import AccelerometerFault, Scenario, load_scenario
from firmware_model.config.vehicle import Accelerometer, Vehicle, load_vehicle
from firmware_model.numerics.elementary import normals
from firmware_model.physics.sensors import AccelerometerParams, GyroParams, measure_accelerometer, measure_gyro
from firmware_model.recording.journal import RECORD
from firmware_model.sim.fault_schedule import initial_plant
from firmware_model.sim.state import _gyro_params
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import load_law

CALM: Scenario = replace(load_scenario("calm"), duration_s=4.0)
AIRFRAME = load_vehicle("paper")
FAULTLESS = AccelerometerParams(sigma=0.0, b_x=0.0, b_y=0.0, b_z=0.0, range=157.0)
QUIET = GyroParams(sigma=0.0, ratio=0.0, b_x=0.0, b_y=0.0, b_z=0.0, range=34.9)


def readings(params: GyroParams, rate: tuple[float, float, float], count: int = 4000) -> np.ndarray:
    return np.array([measure_gyro(params, rate, normals(1, 2, k, 0), 0.0) for k in range(count)])


def test_the_signal_to_noise_ratio_is_as_asked() -> None:
    sigma = 0.2 * 10.0 ** (-35.0 / 20.0)
    noise = readings(QUIET._replace(sigma=sigma), (0.0, 0.0, 0.0))
    # 12,000 values: five standard errors of a standard deviation.
    assert 20.0 * math.log10(0.2 / noise.std()) == pytest.approx(
        35.0, abs=20.0 * math.log10(1.0 + 5.0 / math.sqrt(24000))
    )


def test_state_dependent_noise_grows_with_the_rate() -> None:
    noise = readings(QUIET._replace(ratio=0.1), (1.0, -2.0, 0.0)) - (1.0, -2.0, 0.0)
    assert noise[:, 0].std() == pytest.approx(0.1, rel=0.06)
    assert noise[:, 1].std() == pytest.approx(0.2, rel=0.06)
    assert not noise[:, 2].any()


def test_bias_is_added_and_range_clips() -> None:
    reading = measure_gyro(QUIET._replace(b_x=0.25, b_z=-0.5, range=2.0), (1.0, 5.0, -9.0), (0.0, 0.0, 0.0, 0.0), 0.0)
    assert reading == (1.25, 2.0, -2.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_bias_drift_and_noise_add_up_axis_by_axis(axis: int) -> None:
    name = "xyz"[axis]
    params = QUIET._replace(sigma=0.5, ratio=0.25, since=2.0, **{f"b_{name}": 0.125, f"drift_{name}": 0.0625})
    rate, noise = [0.0] * 3, [0.0] * 4
    rate[axis], noise[axis] = -2.0, 1.5
    # 10 s of drift; the noise has an rms of .5 + .25 * 2.
    expected = [-2.0 + 0.125 + 0.625 + 1.5 if k == axis else 0.0 for k in range(3)]
    assert measure_gyro(params, tuple(rate), tuple(noise), 12.0) == tuple(expected)


def test_readings_are_float32() -> None:
    reading = measure_gyro(QUIET, (0.1, 1 / 3, math.pi), (0.0, 0.0, 0.0, 0.0), 0.0)
    assert reading == tuple(float(np.float32(value)) for value in (0.1, 1 / 3, math.pi))
    assert felt(FAULTLESS, (0.1, 0.0, -9.80665))[2] == float(np.float32(-9.80665))


def felt(params: AccelerometerParams, force: tuple[float, float, float], noise: float = 0.0) -> tuple[float, ...]:
    return measure_accelerometer(params, force, (noise, -noise, 2.0 * noise, 0.0))


def test_the_accelerometer_adds_bias_and_noise_and_clips() -> None:
    params = AccelerometerParams(sigma=0.5, b_x=0.25, b_y=0.0, b_z=-0.5, range=8.0)
    assert felt(params, (1.0, 2.0, -3.0), 1.0) == (1.75, 1.5, -2.5)
    assert felt(params, (9.0, 0.0, -9.0)) == (8.0, 0.0, -8.0)


def flown(vehicle: Vehicle, **changed: object) -> np.ndarray:
    scenario = replace(CALM, **changed)
    return fly_direct(scenario, load_law("hinf-scheduled"), vehicle=vehicle, seed=3)


@pytest.mark.parametrize("rate_hz", [250, 500])
def test_the_accelerometers_noise_is_the_density_at_every_rate(rate_hz: int) -> None:
    law = replace(load_law("hinf-scheduled"), dt=1.0 / rate_hz)
    records = fly_direct(replace(CALM, control_rate_hz=rate_hz), law, vehicle=AIRFRAME, seed=3)
    sigma = AIRFRAME.accelerometer.noise_density * math.sqrt(rate_hz / 2.0)
    noise = records["specific_force_B"][:, 2] - records["specific_force_B"][:, 2].mean()
    # five standard errors of a standard deviation
    assert noise.std() == pytest.approx(sigma, rel=5.0 / math.sqrt(2.0 * len(records)))


@pytest.mark.parametrize("rate_hz", [125, 250, 1000])
def test_the_gyros_noise_is_stated_for_250_hz_and_grows_with_the_root_of_the_rate(rate_hz: int) -> None:
    now, usual = (
        _gyro_params(initial_plant(AIRFRAME, scenario), scenario)
        for scenario in (replace(CALM, control_rate_hz=rate) for rate in (rate_hz, 250))
    )
    assert now.sigma + now.ratio == pytest.approx((usual.sigma + usual.ratio) * math.sqrt(rate_hz / 250.0), rel=1e-14)
    assert now.sigma + now.ratio > 0.0


def test_bias_is_of_the_vehicle_and_of_the_scenario() -> None:
    quiet = AccelerometerFault(noise=False)
    biased = replace(AIRFRAME, accelerometer=Accelerometer(bias_B=(0.0, 0.5, 0.0)))
    level = flown(AIRFRAME, accelerometer=quiet)["specific_force_B"]
    off = flown(biased, accelerometer=replace(quiet, bias_mps2=(0.25, 0.0, 0.0)))["specific_force_B"]
    np.testing.assert_allclose(off - level, [(0.25, 0.5, 0.0)] * len(level), atol=1e-6)


def test_a_law_without_accelerometer_flies_the_same_bits_whatever_that_measures() -> None:
    first = flown(AIRFRAME)
    second = flown(AIRFRAME, accelerometer=AccelerometerFault(noise=False, bias_mps2=(1.0, 1.0, 1.0)))
    assert not np.array_equal(first["specific_force_B"], second["specific_force_B"])
    for name in set(RECORD.names) - {"specific_force_B"}:
        assert first[name].tobytes() == second[name].tobytes(), name
