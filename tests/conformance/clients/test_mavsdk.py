"""MAVSDK 4 in a program of its own: a user's actions with a vehicle, and their results."""

import math

import pytest

from firmware_model.autopilot.parameters import Parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle

pytestmark = pytest.mark.clients
PROGRAM = "mavsdk_client.py"
DENIED_NOW = 1  # MAV_RESULT_TEMPORARILY_REJECTED


def test_the_vehicle_is_discovered_healthy_and_armable(vehicle, run_program):
    facts = run_program(PROGRAM, "discover", vehicle.off_board)
    assert (facts["autopilot"], facts["vehicle"]) == ("PX4", "MULTICOPTER")
    assert (facts["system"], facts["components"]) == (vehicle.system, [1])
    assert facts["version"] >= [1, 4]
    assert facts["development"] == "DEV"
    assert facts["all_ok"]
    assert set(facts["health"].values()) == {True}
    assert (facts["fix"], facts["landed"], facts["mode"]) == ("FIX_3D", "ON_GROUND", "STABILIZED")
    assert facts["home"] == pytest.approx([47.397742, 8.545594], abs=1e-6)
    battery = facts["battery"]
    assert (battery["voltage_v"], battery["remaining_percent"]) == (0.0, -1.0)  # unknown, and not 65.5 V
    assert math.isnan(battery["current_battery_a"])


def test_all_parameters_are_listed_set_echoed_and_refused_by_name(vehicle, run_program):
    facts = run_program(PROGRAM, "change_parameters", vehicle.off_board)
    table = Parameters(load_vehicle("paper"), load_scenario("calm")).table
    listed = facts["float"] | facts["int"]
    assert listed == pytest.approx({parameter.name: parameter.default for parameter in table}, rel=1e-6)
    assert set(facts["int"]) == {parameter.name for parameter in table if isinstance(parameter.default, int)}
    assert facts["set"] == [2.5, 4]
    assert facts["unknown"] == ["DOES_NOT_EXIST", "DOES_NOT_EXIST"]  # an answer; without one it would be TIMEOUT
    assert facts["range"] == "VALUE_OUT_OF_RANGE"
    assert vehicle.stop()["links"][f"127.0.0.1:{vehicle.off_board}"]["rejected"] == {}


def test_telemetry_comes_at_the_rates_that_are_set(vehicle, run_program):
    facts = run_program(PROGRAM, "set_rates", vehicle.off_board)
    # The vehicle catches up after a late sample; only slips on an overloaded machine make an interval longer.
    assert facts == pytest.approx(
        {"quaternion 10 Hz": 100_000, "quaternion 50 Hz": 20_000, "quaternion 100 Hz": 10_000, "imu 250 Hz": 4_000},
        rel=0.05,
    )


def test_it_arms_takes_off_to_10_m_holds_and_lands(vehicle, run_program):
    facts = run_program(PROGRAM, "take_off_and_land", vehicle.off_board, timeout_s=150.0)
    assert facts["in_air"] == "COMMAND_DENIED"
    assert facts["held"] == "HOLD"
    assert len(facts["rotors"]) == 4
    assert all(0.4 < output < 0.6 for output in facts["rotors"])  # it hovers at half of the largest thrust
    assert facts["truth_m"] == pytest.approx(facts["told_m"], abs=0.5)
    assert facts["truth_m"] == pytest.approx(488.0 + 10.0, abs=1.0)
    assert facts["landed_m"] == pytest.approx(0.0, abs=0.1)


def test_attitudes_and_rates_are_flown_off_board_and_given_back(vehicle, run_program):
    facts = run_program(PROGRAM, "fly_off_board", vehicle.off_board, timeout_s=150.0)
    without_setpoint, asked_anyway = facts["without"]
    assert without_setpoint == "NO_SETPOINT_SET"
    assert asked_anyway == {"result": DENIED_NOW, "said": "OFFBOARD rejected: no usable set-points"}
    assert facts["rolled_deg"] == pytest.approx(10.0, abs=2.0)
    assert facts["yaw_rate_deg"] == pytest.approx(30.0, abs=3.0)
    assert facts["roll_rate_deg"] == pytest.approx(0.0, abs=3.0)


def test_attitude_and_torque_setpoints_take_turns(stand, run_program):
    with stand("--held") as vehicle:
        facts = run_program(PROGRAM, "alternate_setpoints", vehicle.off_board, timeout_s=150.0)
        rejected = vehicle.stop()["links"][f"127.0.0.1:{vehicle.off_board}"]["rejected"]
    assert [phase["modes"] for phase in facts["phases"]] == [["OFFBOARD"]] * 3
    assert not any("failsafe" in text for text in facts["texts"])
    assert rejected == {}
    echoed = ["ATTITUDE_TARGET", "ACTUATOR_CONTROL_TARGET", "ATTITUDE_TARGET"]
    for phase, wanted in zip(facts["phases"], echoed, strict=True):
        assert list(phase["last"]) == [wanted]
        assert phase["echoes"][wanted] > 20  # of 40: a busy machine lets model time slip
    level, turned, quarter = facts["phases"]
    assert turned["last"]["ACTUATOR_CONTROL_TARGET"]["controls"][:4] == pytest.approx([0.0, 0.0, 0.001, 0.5])
    assert turned["yaw_acceleration"] == pytest.approx(
        0.001 * 10.0 / load_vehicle("paper").inertia_B[2], rel=0.1
    )  # air damps it
    assert (level["yaw_deg"], quarter["yaw_deg"]) == pytest.approx((0.0, 90.0), abs=1.0)


def test_what_is_not_there_is_refused_by_name(vehicle, run_program):
    facts = run_program(PROGRAM, "ask_for_what_is_not_there", vehicle.off_board)
    texts = facts["texts"]
    for kind in ("position", "velocity", "acceleration"):
        assert facts[kind] == "COMMAND_DENIED"
        assert f"{kind} set-points rejected: send attitude" in texts
    assert facts["sticks"] == ["COMMAND_DENIED", "COMMAND_DENIED"]
    assert "sticks are not flown: mode refused" in texts
    assert (facts["winch"], facts["gimbal"]) == ("UNSUPPORTED", "UNSUPPORTED")
    assert {"this vehicle has no winch", "this vehicle has no gimbal"} <= set(texts)
    # Two of the protocols have no refusal that MAVSDK reads: the text gives it.
    assert facts["custom"] == ["TIMEOUT", "FAILED"]
    assert "no extended parameters: use PARAM_*" in texts
    assert (facts["origin"], facts["same origin"]) == ("TIMEOUT", None)
    assert "origin is fixed: request ignored" in texts
    said = vehicle.stop()
    assert set(said["links"][f"127.0.0.1:{vehicle.off_board}"]["rejected"]) == {"refused"}


def test_it_arms_and_disarms_on_the_ground(vehicle, run_program):
    assert run_program(PROGRAM, "arm_and_disarm", vehicle.off_board) == {"armed": True, "disarmed": True}
