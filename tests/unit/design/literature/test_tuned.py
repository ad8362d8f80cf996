"""Laws of the literature keep the price that they are tuned for."""

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import load_vehicle
from gustproof.design.literature.tuned import tune_baseline

AIR = load_scenario("paper-turbulence")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "vehicle", "excess"), [("adrc", "iris", 1.1), ("ardupilot", "octo", 1.2)])
def test_a_tuned_baseline_keeps_its_price(kind: str, vehicle: str, excess: float) -> None:
    tuning = tune_baseline(kind, load_vehicle_set(vehicle), AIR)
    assert tuning.law.name == f"{kind}-{vehicle}"
    assert tuning.Ms <= 1.4 * (1.0 + 1e-6)
    assert tuning.slew <= tuning.limits.slew * (1.0 + 1e-6)
    assert tuning.least_rmse <= tuning.rmse <= excess * tuning.least_rmse
    assert tuning.law.takes_references
    assert tuning.law.is_scheduled
    np.testing.assert_allclose(tuning.law.rate_limit.limits, load_vehicle(vehicle).stabilizer.rate_limit)
