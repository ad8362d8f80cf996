"""pymavlink's mavutil in a program of its own, and the requests of QGroundControl through it."""

import pytest

from firmware_model.autopilot.parameters import Parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle

pytestmark = pytest.mark.clients
PROGRAM = "mavutil_client.py"
TABLE = Parameters(load_vehicle("paper"), load_scenario("calm")).table


def test_a_naive_program_reads_sets_changes_mode_and_arms(vehicle, run_program):
    facts = run_program(PROGRAM, "fly", f"udpin:127.0.0.1:{vehicle.ground_station}")
    assert set(facts["parameters"]) == {parameter.name for parameter in TABLE}
    assert facts["changed"] == 3.0
    assert {"POSCTL", "LOITER", "LAND", "OFFBOARD"} <= set(facts["modes"])
    assert (facts["mode"], facts["armed"]) == ("POSCTL", True)
    assert facts["zacc"] == pytest.approx(-9.81, abs=0.2)  # noise of .03 m/s^2 rms
    assert facts["lost"] == 0


def test_downloads_find_nothing_and_say_so(vehicle, run_program):
    facts = run_program(PROGRAM, "download", f"udpin:127.0.0.1:{vehicle.ground_station}")
    assert facts["counts"] == [[0, 0], [1, 0], [2, 0]]
    assert facts["upload"] == 3  # MAV_MISSION_UNSUPPORTED
    assert facts["logs"] == 0


def test_what_qgroundcontrol_asks_for_on_connection_is_answered_the_first_time(vehicle, run_program):
    facts = run_program(PROGRAM, "connect_as_qgroundcontrol", f"udpout:127.0.0.1:{vehicle.ground_station_door}")
    assert (facts["autopilot"], facts["version"]) == (12, 0)
    assert facts["metadata"] == [3, 3]  # UNSUPPORTED, so that it looks no further
    assert [index for index, _, _ in facts["modes"]] == list(range(1, len(facts["modes"]) + 1))
    assert len({name for _, name, _ in facts["modes"]}) == len({mode for _, _, mode in facts["modes"]}) == 9
    assert facts["parameters"] == len(TABLE)
    assert facts["counts"] == [0, 0, 0]
    assert facts["lost"] == 0
    assert vehicle.stop()["counters"].get("unused_message", 0) == 0
