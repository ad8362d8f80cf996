"""Laws of the literature keep the price that they are tuned for."""

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from gustproof.baselines.linear.tuned import tune_baseline

AIR = load_scenario("paper-turbulence")


@pytest.mark.slow
def test_a_tuned_baseline_keeps_its_price() -> None:
    tuning = tune_baseline("adrc", load_vehicle_set("iris"), AIR)
    assert tuning.law.name == "adrc-iris"
    assert tuning.Ms <= 1.4 * (1.0 + 1e-6)
    assert tuning.slew <= tuning.limits.slew * (1.0 + 1e-6)
    assert tuning.least_rmse <= tuning.rmse <= 1.15 * tuning.least_rmse
    assert tuning.law.takes_references
    assert tuning.law.is_scheduled
    assert tuning.law.rate_limit is not None
