"""node-mavlink in a program of its own; needs Node and the packages that tools/test installs by npm."""

import shutil
import sys
from pathlib import Path

import pytest

from firmware_model.autopilot.parameters import Parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle

MODULES = Path(sys.prefix) / "node" / "node_modules"

pytestmark = [
    pytest.mark.clients,
    pytest.mark.skipif(
        shutil.which("node") is None or not (MODULES / "node-mavlink").is_dir(), reason="node-mavlink is not here"
    ),
]


def test_it_lists_the_parameters_arms_and_reads_the_streams(vehicle, run_program):
    facts = run_program("node_client.mjs", f"{MODULES}/", vehicle.ground_station)
    assert (facts["system"], facts["autopilot"]) == (vehicle.system, 12)
    table = Parameters(load_vehicle("paper"), load_scenario("calm")).table
    assert set(facts["parameters"]) == {parameter.name for parameter in table}
    assert facts["parameters"]["COM_OF_LOSS_T"] == 1.0
    assert facts["result"] == 0
    assert {"HEARTBEAT", "HIGHRES_IMU", "ATTITUDE", "GLOBAL_POSITION_INT", "SYS_STATUS"} <= set(facts["types"])
