import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import Battery, load_vehicle
from firmware_model.mavlink.services import identity, motion, outputs, status, storage
from firmware_model.numerics.rotations import rotate
from firmware_model.recording.journal import record_type
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import AttitudeTarget, LevelFlight, TorqueCommand

HALF = math.sqrt(0.5)


def told(service, number: int):
    message = service.streams[number].message()
    if message is not None:
        message.pack(wire.MAVLink(None, 1, 1))
    return message


@pytest.mark.parametrize("bit", [0x1, 0x10000000])  # gyro, ready to arm
def test_what_works_is_present_enabled_and_healthy(craft, bit):
    message = told(status.make_service(craft), wire.MAVLINK_MSG_ID_SYS_STATUS)
    for field in ("present", "enabled", "health"):
        assert getattr(message, f"onboard_control_sensors_{field}") & bit


def test_there_is_no_fence_and_none_is_breached(craft):
    message = told(status.make_service(craft), wire.MAVLINK_MSG_ID_SYS_STATUS)
    fence = wire.MAV_SYS_STATUS_GEOFENCE
    assert not message.onboard_control_sensors_present & fence
    assert message.onboard_control_sensors_health & fence


def test_no_battery_is_made_up(craft):
    message = told(status.make_service(craft), wire.MAVLINK_MSG_ID_BATTERY_STATUS)
    assert (message.battery_remaining, message.current_battery, message.voltages) == (-1, -1, [65535] * 10)
    assert (message.id, message.current_consumed, message.energy_consumed) == (0, -1, -1)
    assert (message.temperature, message.time_remaining) == (32767, 0)
    message = told(status.make_service(craft), wire.MAVLINK_MSG_ID_SYS_STATUS)
    assert (message.battery_remaining, message.current_battery, message.voltage_battery) == (-1, -1, 0)
    assert not message.onboard_control_sensors_present & wire.MAV_SYS_STATUS_SENSOR_BATTERY


@pytest.mark.parametrize("cells", [4, 12])
def test_a_battery_is_told(craft, cells):
    battery = Battery(cells=cells, capacity_ah=0.01, resistance_ohm=0.1, hover_current_a=18.0)
    scenario = replace(load_scenario("paper"), translation="free")
    craft.loop = VehicleLoop(replace(load_vehicle("paper"), battery=battery), scenario, 1)
    for _ in range(250):
        craft.loop.advance(LevelFlight(), 0)
    at = craft.loop.battery
    assert (0.3 < at.remaining < 0.7, 10.0 < at.current < 30.0) == (True, True)
    message = told(status.make_service(craft), wire.MAVLINK_MSG_ID_BATTERY_STATUS)
    cell = round(1000.0 * at.voltage / cells)
    assert message.voltages == [cell] * min(cells, 10) + [65535] * max(10 - cells, 0)
    assert message.voltages_ext == [cell] * max(cells - 10, 0) + [0] * min(14 - cells, 4)
    assert (message.current_battery, message.battery_remaining) == (round(100 * at.current), round(100 * at.remaining))
    assert message.current_consumed == round(1000 * at.used_ah)
    message = told(status.make_service(craft), wire.MAVLINK_MSG_ID_SYS_STATUS)
    assert (message.voltage_battery, message.current_battery) == (round(1000 * at.voltage), round(100 * at.current))
    assert message.battery_remaining == round(100 * at.remaining)
    for field in ("present", "enabled", "health"):
        assert getattr(message, f"onboard_control_sensors_{field}") & wire.MAV_SYS_STATUS_SENSOR_BATTERY


def test_a_current_beyond_its_field_is_told_as_the_largest(craft):
    battery = Battery(cells=12, capacity_ah=9.0, resistance_ohm=0.001, hover_current_a=400.0)
    scenario = replace(load_scenario("paper"), translation="free")
    craft.loop = VehicleLoop(replace(load_vehicle("paper"), battery=battery), scenario, 1)
    for number in (wire.MAVLINK_MSG_ID_BATTERY_STATUS, wire.MAVLINK_MSG_ID_SYS_STATUS):
        assert told(status.make_service(craft), number).current_battery == 2**15 - 1


def test_no_load_and_no_errors_are_made_up(craft):
    message = told(status.make_service(craft), wire.MAVLINK_MSG_ID_SYS_STATUS)
    assert (message.load, message.drop_rate_comm, message.errors_comm) == (0, 0, 0)
    assert [getattr(message, f"errors_count{number}") for number in (1, 2, 3, 4)] == [0, 0, 0, 0]


def test_estimator_has_a_place_and_says_so(craft):
    report = told(status.make_service(craft), wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT)
    # Attitude, velocities, positions and predicted positions; not a constant position, not uninitialised.
    assert report.flags == 1 + 2 + 4 + 8 + 16 + 32 + 256 + 512
    assert {getattr(report, name) for name in report.fieldnames if name.endswith("variance")} == {0.0}


def test_landed_state_goes_with_the_flight(craft):
    service, autopilot = status.make_service(craft), craft.autopilot
    assert told(service, wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE).landed_state == wire.MAV_LANDED_STATE_ON_GROUND
    autopilot.arm()
    autopilot.set_mode(Mode.TAKEOFF)
    assert told(service, wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE).landed_state == wire.MAV_LANDED_STATE_TAKEOFF


@pytest.mark.parametrize(("generic", "capabilities", "autopilot"), [(False, 8286, 12), (True, 8270, 0)])
def test_identity_says_how_integers_travel(craft, generic, capabilities, autopilot):
    craft.generic = generic
    service = identity.make_service(craft)
    version = told(service, wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert version.capabilities == capabilities  # 2|4|8|64|8192, and 16: bytewise
    assert version.flight_sw_version >> 8 >= 1 << 16 | 4 << 8 | 1
    assert version.flight_sw_version & 0xFF == 0  # development
    assert told(service, wire.MAVLINK_MSG_ID_HEARTBEAT).autopilot == autopilot


def test_log_list_is_one_entry_that_says_none(craft, ask):
    (entry,) = ask(storage.make_service(craft), wire.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    assert (entry.id, entry.num_logs, entry.last_log_num, entry.time_utc, entry.size) == (0, 0, 0, 0, 0)


def test_echo_is_of_what_is_tracked(craft):
    service = outputs.make_service(craft)
    target, torque = wire.MAVLINK_MSG_ID_ATTITUDE_TARGET, wire.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET
    assert told(service, target) is told(service, torque) is None
    craft.setpoint = TorqueCommand(time_us=4000, torque_B=(0.1, 0.2, 0.3), throttle=None)
    assert told(service, target) is None
    assert math.isnan(told(service, torque).controls[3])
    craft.setpoint = AttitudeTarget(time_us=4000, q_NB=None, omega_B=(0.1, 0.2, 0.3), thrust=0.5)
    assert told(service, target).type_mask == 128


def test_torque_of_the_vehicle_s_own_loops_is_told_while_a_controller_stands_by(craft):
    service, attitude = outputs.make_service(craft), wire.MAVLINK_MSG_ID_ATTITUDE_TARGET
    craft.setpoint = TorqueCommand(time_us=4000, torque_B=(0.1, 0.2, 0.3), throttle=None)
    craft.autopilot.armed, craft.autopilot.mode = True, Mode.HOLD
    assert told(service, wire.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET).time_usec == 4000
    craft.loop.advance(LevelFlight(), Mode.HOLD.value)
    record = craft.loop.advance(LevelFlight(), Mode.HOLD.value)
    message = told(service, wire.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET)
    commanded = record.view(record_type(4))["torque_command_B"][0]
    assert any(commanded)
    assert message.controls[:3] == pytest.approx(commanded / load_vehicle("paper").torque_limit, rel=1e-6)
    assert message.time_usec == craft.loop.time_us == 8000
    craft.autopilot.mode = Mode.OFFBOARD
    assert told(service, wire.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET).time_usec == 4000
    craft.setpoint = AttitudeTarget(time_us=4000, q_NB=None, omega_B=(0.1, 0.2, 0.3), thrust=0.5)
    assert told(service, attitude).time_boot_ms == 4
    craft.autopilot.mode = Mode.HOLD
    assert told(service, attitude) is None


def test_gust_is_told_as_wind_that_blows_toward(craft):
    message = told(motion.make_service(craft), wire.MAVLINK_MSG_ID_WIND_COV)
    gust_N = rotate(craft.loop.q_NB, craft.loop.true_vector("gust_B"))  # there is no mean wind in it
    assert (message.wind_x, message.wind_y, message.wind_z) == pytest.approx(gust_N)
    assert message.wind_alt == 498.0
    east = motion.wind_message(0, (0.0, 5.0, 0.0), (0.0, 0.0, 0.0))
    assert (east.wind_x, east.wind_y) == (0.0, 5.0)


def test_air_is_mean_wind_and_the_gust_turned_north():
    vectors = {"gust_B": (1.0, 2.0, 0.5), "wind_N": (5.0, -3.0, 0.25)}
    loop = SimpleNamespace(q_NB=(HALF, 0.0, 0.0, HALF), observe=lambda: None, true_vector=vectors.get)
    # The nose points east: a gust from behind blows east, one from the left blows south.
    assert motion.air_velocity_N(loop) == pytest.approx((3.0, -2.0, 0.75))


def test_rotors_are_told_as_fractions_and_as_pulses(craft):
    service = outputs.make_service(craft)
    thrusts = told(service, wire.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS)
    assert thrusts.actuator[:5] == pytest.approx([0.5, 0.5, 0.5, 0.5, 0.0])  # hovers at half throttle
    assert thrusts.active == 0b1111
    servos = told(service, wire.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW)
    assert [servos.servo1_raw, servos.servo4_raw, servos.servo5_raw] == [1500, 1500, 0]


def test_all_of_eight_rotors_are_told(craft):
    octo = VehicleLoop(load_vehicle("octo"), load_scenario("calm"), 1)
    service = outputs.make_service(SimpleNamespace(loop=octo))
    thrusts = told(service, wire.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS)
    assert thrusts.actuator[:9] == pytest.approx([*[1.0 / 3.0] * 8, 0.0], rel=1e-3)
    assert thrusts.active == 0xFF
    servos = told(service, wire.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW)
    assert [servos.servo1_raw, servos.servo8_raw, servos.servo9_raw] == [1333, 1333, 0]
