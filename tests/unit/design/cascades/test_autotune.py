"""The autotuner: what it measures is the plant, and what it asks for is what the loop has."""

import dataclasses
import math

import numpy as np
import pytest

from firmware_model.config.vehicle import Vehicle, load_vehicle
from gustproof.design.cascades.autotune import RATIOS, Response, autotune_pid, measure_response, tune_axis
from gustproof.errors import DesignError

DT = 0.004


def plant(vehicle: Vehicle, axis: int, omega: np.ndarray) -> np.ndarray:
    """Torque command to gyro: lag, damping, inertia; one sample of delay and half a sample of hold."""
    s = 1j * np.asarray(omega)
    rigid = 1.0 / vehicle.inertia_B[axis] / (s + vehicle.rate_damping_B[axis])
    return rigid / (1.0 + vehicle.actuator_lag * s) * np.exp(-1.5 * DT * s)


def exact(vehicle: Vehicle, axis: int, bandwidth: float) -> Response:
    omega = bandwidth * np.array(RATIOS)
    return Response(omega=omega, G=plant(vehicle, axis, omega))


@pytest.mark.parametrize(("name", "axis"), [("paper", 0), ("paper", 2), ("iris", 1)])
def test_the_experiment_measures_the_plant_through_gyro_noise(name: str, axis: int) -> None:
    vehicle = load_vehicle(name)
    response = measure_response(vehicle, axis, bandwidth=1.0, amplitude=0.05 * vehicle.inertia_B[axis])
    # 2 %: gyro noise of .0036 rad/s against rates of .005 rad/s at the fastest sine, over 60,000 samples.
    np.testing.assert_allclose(response.G, plant(vehicle, axis, response.omega), rtol=0.02)


@pytest.mark.parametrize("bandwidth", [0.5, 1.0, 2.0])
def test_the_loops_have_the_bandwidth_and_margin_asked_for(bandwidth: float) -> None:
    vehicle = load_vehicle("paper")
    inertia = vehicle.inertia_B[0]
    gains = tune_axis(exact(vehicle, 0, bandwidth), inertia, DT, phase_margin=math.radians(60.0))

    def inner(omega: float) -> complex:
        s = 1j * omega
        return complex(inertia * (gains.rate_p + gains.rate_i / s) * plant(vehicle, 0, np.array([omega]))[0])

    at = inner(3.0 * bandwidth)
    # .5 %: the continuous PI here has half a sample less delay than the sampled one that was tuned.
    assert abs(at) == pytest.approx(1.0, rel=5e-3)
    assert 180.0 + math.degrees(np.angle(at)) == pytest.approx(60.0, abs=0.5)
    outer = gains.angle_p / (1j * bandwidth) * inner(bandwidth) / (1.0 + inner(bandwidth))
    assert abs(outer) == pytest.approx(1.0, rel=5e-3)
    assert 180.0 + math.degrees(np.angle(outer)) > 60.0


def test_the_tuned_law_has_two_states_an_axis_and_says_how_it_was_made() -> None:
    law = autotune_pid(load_vehicle("paper"), bandwidth=2.0, phase_margin=math.radians(55.0))
    assert (law.order, law.is_scheduled) == (6, False)
    assert law.provenance.parameters["bandwidth_rad_s"] == 2.0
    assert law.provenance.parameters["phase_margin_rad"] == math.radians(55.0)


def test_the_same_seed_tunes_the_same_law() -> None:
    first, again, other = (autotune_pid(load_vehicle("paper"), bandwidth=3.0, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.D, again.D)
    assert not np.array_equal(first.D, other.D)


def test_a_margin_that_no_pi_has_there_is_refused_with_the_phase() -> None:
    vehicle = load_vehicle("paper")
    with pytest.raises(DesignError, match=r"no rate PI has a phase margin of 60 deg at 30 rad/s.*-1\d\d deg"):
        tune_axis(exact(vehicle, 0, 10.0), vehicle.inertia_B[0], DT)


def test_an_attitude_loop_short_of_margin_is_refused() -> None:
    vehicle = load_vehicle("paper")
    with pytest.raises(DesignError, match="attitude loop has a phase margin of"):
        tune_axis(exact(vehicle, 0, 0.3), vehicle.inertia_B[0], DT, phase_margin=math.radians(86.5))


def test_an_experiment_too_fast_for_the_sample_rate_is_refused() -> None:
    with pytest.raises(DesignError, match="too fast to be measured at 250 Hz"):
        autotune_pid(load_vehicle("paper"), bandwidth=80.0)


def test_an_experiment_that_meets_the_torque_limit_is_refused() -> None:
    vehicle = dataclasses.replace(load_vehicle("paper"), torque_limit=(0.02, 0.02, 0.02))
    with pytest.raises(DesignError, match="roll: the experiment reaches the torque limit"):
        autotune_pid(vehicle)
