"""The autopilot's rate loop, identified from flight."""

import numpy as np

from firmware_model.config.vehicle import load_vehicle
from gustproof.design.cascades.rate_loop import identify_rate_loop
from gustproof.design.designs import load_design


def test_the_shipped_rates_design_uses_the_lag_that_is_identified_from_flight() -> None:
    design = load_design("R1")
    loop = identify_rate_loop(load_vehicle(design.vehicle))
    # The file has three digits; the axes have the same gains per inertia.
    np.testing.assert_allclose(loop.tau, design.rate_loop_lag, rtol=0.01)
    assert loop.misfit.max() < 0.2


def test_the_lag_is_a_property_of_the_loop_not_of_the_noise() -> None:
    vehicle = load_vehicle("paper")
    np.testing.assert_allclose(
        identify_rate_loop(vehicle, seed=1).tau, identify_rate_loop(vehicle, seed=2).tau, rtol=5e-3
    )
