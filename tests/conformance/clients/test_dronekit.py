"""dronekit 2.9 in a program of its own; needs the packages that tools/test adds to pyproject.toml's."""

from importlib.util import find_spec

import pytest

pytestmark = [
    pytest.mark.clients,
    pytest.mark.skipif(find_spec("dronekit") is None, reason="dronekit is not here"),
]


def test_dronekit_arms_when_armable_takes_off_and_lands(vehicle, run_program):
    facts = run_program("dronekit_client.py", f"udpin:127.0.0.1:{vehicle.ground_station}", timeout_s=150.0)
    assert (facts["on_ground"]["ekf_ok"], facts["on_ground"]["mode"]) == (True, "STABILIZED")
    assert facts["on_ground"]["battery"] == {"voltage": 0.0, "current": None, "level": None}  # and not 65.5 V
    assert facts["in_air"]["ekf_ok"]
    assert facts["in_air"]["height_m"] == pytest.approx(2.4, abs=0.3)
    assert facts["landed_m"] == pytest.approx(0.0, abs=0.1)
    assert facts["texts"][-1] == "landed: disarmed"
