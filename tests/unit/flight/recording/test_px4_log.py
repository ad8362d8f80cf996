"""A flight as ULog is read by pyulog and by our own reader, with the numbers of its records."""

import numpy as np
import pytest
from pyulog import ULog

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.numerics.rotations import euler_angles
from firmware_model.recording.estimates import ESTIMATE
from gustproof.flight.recording.px4_log import write_ulog
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.loopback import fly_loopback
from gustproof.law.form import load_law
from gustproof.logs.read.read_log import read_log

VEHICLE = load_vehicle("paper")


def table(log: ULog, topic: str, field: str, count: int) -> np.ndarray:
    data = log.get_dataset(topic).data
    return np.column_stack([data[f"{field}[{i}]"] for i in range(count)])


def test_each_topic_has_the_numbers_of_the_records(tmp_path):
    scenario = load_scenario("doublets")
    records = fly_direct(scenario, load_law("hinf-rates"))
    write_ulog(tmp_path / "a.ulg", records, VEHICLE, scenario, {"scenario": "doublets"})
    log = ULog(str(tmp_path / "a.ulg"))
    assert (log.file_corruption, log.msg_info_dict["scenario"]) == (False, "doublets")
    single = {name: records[name].astype(np.float32) for name in records.dtype.names}
    for topic, field, count, expected in (
        ("vehicle_attitude", "q", 4, single["q_NB"]),
        ("vehicle_angular_velocity", "xyz", 3, single["gyro_B"]),
        ("vehicle_angular_velocity_groundtruth", "xyz", 3, single["omega_B"]),
        ("vehicle_acceleration", "xyz", 3, single["specific_force_B"]),
        ("vehicle_torque_setpoint", "xyz", 3, (records["torque_command_B"] / VEHICLE.torque_limit).astype(np.float32)),
    ):
        assert np.array_equal(table(log, topic, field, count), expected), topic
    attitude, reference = log.get_dataset("vehicle_attitude").data, table(log, "vehicle_attitude_setpoint", "q_d", 4)
    assert attitude["timestamp"].tolist() == attitude["timestamp_sample"].tolist() == records["time_us"].tolist()
    assert np.degrees(euler_angles(reference.astype(float))).max() == pytest.approx(
        max(max(np.degrees(angles)) for _, angles in scenario.references), abs=1e-5
    )
    rates = log.get_dataset("vehicle_rates_setpoint").data
    assert np.array_equal(rates["yaw"], single["omega_command_B"][:, 2], equal_nan=True)
    assert np.array_equal(log.get_dataset("vehicle_local_position").data["vz"], single["velocity_N"][:, 2])
    ours = read_log(tmp_path / "a.ulg")
    assert np.array_equal(ours.gyro.values, single["gyro_B"])
    assert [line for line in ours.findings if "not in this log" in line] == ["not in this log: motors"]


def test_attitude_of_a_real_autopilot_is_its_estimate_beside_the_truth(tmp_path):
    scenario = load_scenario("gust-roll")
    records = fly_direct(scenario, load_law("flagship"))
    told = np.zeros(500, dtype=ESTIMATE)
    told["time_us"], told["q_NB"] = records["time_us"][2::5], records["q_NB"][2::5] + 0.01
    told["setpoint_q_NB"] = (1.0, 0.0, 0.0, 0.0)
    write_ulog(tmp_path / "a.ulg", records, VEHICLE, scenario, estimates=told)
    log = ULog(str(tmp_path / "a.ulg"))
    assert not log.file_corruption
    assert np.array_equal(table(log, "vehicle_attitude", "q", 4), told["q_NB"].astype(np.float32))
    assert log.get_dataset("vehicle_attitude").data["timestamp"].tolist() == told["time_us"].tolist()
    assert np.array_equal(table(log, "vehicle_attitude_groundtruth", "q", 4), records["q_NB"].astype(np.float32))
    assert np.array_equal(table(log, "vehicle_attitude_setpoint", "q_d", 4), told["setpoint_q_NB"].astype(np.float32))


def test_a_change_of_mode_is_a_message_of_the_status(tmp_path):
    scenario = load_scenario("controller-crash")
    records = fly_loopback(scenario, load_law("flagship"))
    write_ulog(tmp_path / "a.ulg", records, VEHICLE, scenario)
    status = ULog(str(tmp_path / "a.ulg")).get_dataset("vehicle_status").data
    changed = np.flatnonzero(np.diff(records["mode"], prepend=-1.0))
    assert status["timestamp"].tolist() == records["time_us"][changed].tolist()
    assert status["nav_state"][0] == 14
    assert len(changed) > 1


def test_the_wind_is_that_at_the_vehicle(tmp_path):
    scenario = load_scenario("gust-roll")
    write_ulog(tmp_path / "a.ulg", fly_direct(scenario, load_law("flagship")), VEHICLE, scenario)
    wind = ULog(str(tmp_path / "a.ulg"), ["wind"]).get_dataset("wind").data
    assert wind["windspeed_east"].max() == pytest.approx(8.0, abs=0.01)
