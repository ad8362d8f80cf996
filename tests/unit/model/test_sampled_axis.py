"""The uncertain sampled axis is the sampled axis of each vehicle in its ranges."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.model.sampled_axis import sampled_axis
from gustproof.performance.covariance import axis_models

OMEGA = np.geomspace(0.1, 700.0, 20)


def plant(vehicle, scenario, axis):
    late = np.exp(-1j * OMEGA * scenario.dt * scenario.delay_samples)
    return axis_models(vehicle, scenario)[axis].plant.response(OMEGA)[:, 0, 0] * late


@pytest.mark.parametrize("damping", [0.02, 0.0])
@pytest.mark.parametrize("delay", [0, 2])
def test_the_family_holds_the_axis_at_every_inertia_and_lag(damping, delay):
    vehicle = replace(load_vehicle("paper"), rate_damping=damping)
    scenario = replace(load_scenario("paper-turbulence"), delay_samples=delay)
    family = sampled_axis(vehicle, scenario, 1, inertia=0.2, actuator_lag=0.3)
    np.testing.assert_allclose(family.nominal_system().response(OMEGA)[:, 0, 0], plant(vehicle, scenario, 1), rtol=1e-9)
    I_x, I_y, I_z = vehicle.inertia_B
    for heavier, slower in ((1.2, 1.3), (0.8, 1.3), (1.2, 0.7), (0.93, 1.12)):
        other = replace(vehicle, inertia_B=(I_x, heavier * I_y, I_z), actuator_lag=slower * vehicle.actuator_lag)
        decay = np.exp(-scenario.dt / other.actuator_lag)
        carried = (np.exp(-damping * scenario.dt) - decay) / (1.0 / other.actuator_lag - damping)
        delta = family.delta({"inverse inertia": 1.0 / (heavier * I_y), "decay": decay, "carried": carried})
        assert all(abs(value) <= 1.0 + 1e-9 for value in delta.values())
        np.testing.assert_allclose(
            family.substitute(delta).response(OMEGA)[:, 0, 0], plant(other, scenario, 1), rtol=1e-9
        )
