"""The vehicle's endpoint on a virtual clock, spoken to by a client of a few lines."""

import math
import random
import struct
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode
from firmware_model.config.events import ControllerHang, ControllerKill, GpsLoss, ModeChange
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.mavlink import peers
from firmware_model.mavlink.frames import EncodedMessage, Frame, RejectReason, parse
from firmware_model.mavlink.messages import CONTROLLER, command_message
from firmware_model.mavlink.services import refusals
from firmware_model.mavlink.signing import Signing
from firmware_model.session import vehicle_endpoint
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.pacing import TimingFault
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.types import AttitudeTarget, TorqueCommand

SAMPLE_US = 4_000
UNSUPPORTED = wire.MAV_RESULT_UNSUPPORTED
ARM, MODE = wire.MAV_CMD_COMPONENT_ARM_DISARM, wire.MAV_CMD_DO_SET_MODE


class Vehicle:
    """An endpoint, its clock, and what each peer has heard since it was last asked."""

    def __init__(self, *, lockstep: bool, scenario: str = "calm", duration_s: float = 0.2, **options) -> None:
        self.modes: list[float] = []
        self.rates: list[list[float]] = []
        rate_hz = options.pop("rate_hz", 250)
        script = replace(load_scenario(scenario), duration_s=duration_s, control_rate_hz=rate_hz)
        script = replace(script, event=options.pop("event", script.event))
        self.endpoint = VehicleEndpoint(load_vehicle("paper"), script, 1, self.record, lockstep=lockstep, **options)
        self.flushed: list[int] = []  # samples in the journal at each flush
        self.endpoint.flush = lambda: self.flushed.append(len(self.modes))
        self.now_us = 0
        self.heard: dict[int, list[Frame]] = {}  # not yet taken: to decode all would take half of the time
        self.raw: dict[int, list[Frame]] = {}

    def record(self, row) -> None:
        self.modes.append(row[-1])
        self.rates.append(row[1:4].tolist())

    def say(self, message, *, port: int = 1, component: int = CONTROLLER, system: int = 1) -> None:
        datagram = message.pack(wire.MAVLink(None, system, component))
        self.endpoint.receive(datagram, (0, ("client", port)), self.now_us)

    def poll(self) -> None:
        for datagram, (_, (_, port)) in self.endpoint.poll(self.now_us):
            for frame in parse(datagram):
                assert isinstance(frame, Frame)
                self.raw.setdefault(port, []).append(frame)
                self.heard.setdefault(port, []).append(frame)

    def wait(self, us: int = 0) -> None:
        end_us = self.now_us + us
        while True:
            self.poll()
            if self.endpoint.finished or self.endpoint.deadline_us() > end_us:
                break
            self.now_us = max(self.endpoint.deadline_us(), self.now_us)
        self.now_us = end_us

    def take(self, kind: str, port: int = 1) -> list:
        heard, number = self.heard.get(port, []), getattr(wire, f"MAVLINK_MSG_ID_{kind}")
        self.heard[port] = [frame for frame in heard if frame.message_id != number]
        return [frame.message() for frame in heard if frame.message_id == number]

    def ask(self, command: int, *params: float, system: int = 1, component: int = 1, port: int = 1) -> list[int]:
        numbers = (*params, *[math.nan] * (7 - len(params)))
        self.say(wire.MAVLink_command_long_message(system, component, command, 0, *numbers), port=port)
        self.wait()
        return [message.result for message in self.take("COMMAND_ACK", port)]

    def setpoint(self, time_us: int = 0, port: int = 1) -> None:
        torque = TorqueCommand(time_us=time_us, torque_B=(0.1, 0.0, 0.0), throttle=0.5)
        self.say(command_message(torque, 1), port=port)

    def take_off(self) -> None:
        self.say(HEARTBEAT)
        self.setpoint()
        assert self.ask(ARM, 1.0) == [wire.MAV_RESULT_ACCEPTED]
        assert self.ask(MODE, 1.0, 6.0) == [wire.MAV_RESULT_ACCEPTED]


SETPOINTS = ("set_attitude_target", "set_actuator_control_target")
HEARTBEAT = wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)


@pytest.fixture
def vehicle() -> Vehicle:
    return Vehicle(lockstep=False)


@pytest.mark.parametrize(("late_us", "result"), [(499_999, wire.MAV_RESULT_ACCEPTED), (500_000, 1)])
def test_age_of_a_set_point_is_counted_between_polls_too(vehicle, late_us, result):
    vehicle.say(HEARTBEAT)
    vehicle.wait()
    vehicle.now_us += 300_000
    vehicle.setpoint()
    vehicle.now_us += late_us
    assert vehicle.ask(MODE, 1.0, 6.0) == [result]


@pytest.mark.slow
def test_heartbeat_comes_at_once_to_who_speaks_first_then_every_second_and_on_a_change(vehicle):
    vehicle.wait(400_000)
    for _ in range(2):
        vehicle.say(HEARTBEAT)
        vehicle.wait(100_000)
    assert len(vehicle.take("HEARTBEAT")) == 1
    vehicle.wait(4_500_000)
    assert len(vehicle.take("HEARTBEAT")) == 5
    vehicle.ask(ARM, 1.0)
    (beat,) = vehicle.take("HEARTBEAT")
    assert beat.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED


def test_stamps_run_on_between_samples_in_real_time(vehicle):
    vehicle.take_off()
    for us, stamp_us in ((0, 0), (1000, 1000), (3000, 4000), (2500, 6500)):
        vehicle.wait(us)
        vehicle.poll()
        assert vehicle.endpoint.stamp_us == stamp_us


def test_a_heartbeat_a_second_and_a_warning_five_are_exact(vehicle):
    vehicle.say(HEARTBEAT)
    vehicle.wait()
    vehicle.take("HEARTBEAT")
    vehicle.endpoint.warn("rain")
    for us, beats, texts in ((0, 0, 1), (999_999, 0, 0), (1, 1, 0), (3_999_999, 3, 0), (1, 1, 1)):
        vehicle.wait(us)
        vehicle.poll()
        vehicle.endpoint.warn("rain")
        vehicle.poll()
        assert (len(vehicle.take("HEARTBEAT")), len(vehicle.take("STATUSTEXT"))) == (beats, texts)


def test_expected_peer_is_told_of_the_vehicle_unasked_and_of_nothing_else():
    vehicle = Vehicle(lockstep=False, expected=[(0, ("client", 14550))])
    vehicle.poll()
    assert [frame.message_id for frame in vehicle.heard[14550]] == [0]  # a heartbeat, at once
    vehicle.wait(2_500_000)
    assert Counter(frame.message_id for frame in vehicle.heard[14550]) == {wire.MAVLINK_MSG_ID_HEARTBEAT: 3}


@pytest.mark.parametrize(
    ("component", "rates"),
    [
        (CONTROLLER, {"HIGHRES_IMU": 250, "ATTITUDE": 100, "ATTITUDE_QUATERNION": 50, "HIL_STATE_QUATERNION": 50}),
        (190, {"HIGHRES_IMU": 50, "ATTITUDE": 100, "ATTITUDE_QUATERNION": 50, "HIL_STATE_QUATERNION": 50}),
    ],
)
def test_streams_have_their_rates_on_the_clamped_vehicle(vehicle, component, rates):
    vehicle.say(HEARTBEAT, component=component)
    vehicle.wait(999_999)
    counted = Counter(frame.message().get_type() for frame in vehicle.heard[1])
    assert {name: counted[name] for name in rates} == rates


def test_sample_0_is_repeated_while_clamped(vehicle):
    vehicle.say(HEARTBEAT)
    vehicle.wait(500_000)
    samples = vehicle.take("HIGHRES_IMU")
    assert {message.time_usec for message in samples} == {0}
    assert len({(m.xgyro, m.ygyro, m.zgyro) for m in samples}) == 1


def test_message_interval_can_be_set_stopped_and_reset(vehicle):
    vehicle.say(HEARTBEAT)
    interval, attitude = wire.MAV_CMD_SET_MESSAGE_INTERVAL, float(wire.MAVLINK_MSG_ID_ATTITUDE)
    for asked, expected in ((500_000.0, 2), (-1.0, 0), (0.0, 100)):
        assert vehicle.ask(interval, attitude, asked) == [wire.MAV_RESULT_ACCEPTED]
        vehicle.take("ATTITUDE")
        vehicle.now_us += 1
        vehicle.wait(999_998)
        assert abs(len(vehicle.take("ATTITUDE")) - expected) <= 1  # the first one comes with the request
    assert vehicle.ask(interval, 9999.0, 1000.0) == [wire.MAV_RESULT_UNSUPPORTED]


def test_message_is_sent_once_on_request(vehicle):
    vehicle.say(HEARTBEAT)
    assert vehicle.ask(wire.MAV_CMD_REQUEST_MESSAGE, 148.0) == [wire.MAV_RESULT_ACCEPTED]
    (version,) = vehicle.take("AUTOPILOT_VERSION")
    assert version.capabilities & wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    assert vehicle.ask(wire.MAV_CMD_REQUEST_MESSAGE, 9999.0) == [wire.MAV_RESULT_UNSUPPORTED]


@pytest.mark.parametrize(
    ("command", "params", "result"),
    [
        (ARM, (0.0,), wire.MAV_RESULT_ACCEPTED),
        (ARM, (math.nan,), wire.MAV_RESULT_DENIED),
        (ARM, (2.0,), wire.MAV_RESULT_DENIED),
        (MODE, (33.0, 7.0), wire.MAV_RESULT_ACCEPTED),  # as MAVSDK sends it
        (MODE, (1.0, 4.0, 3.0), wire.MAV_RESULT_ACCEPTED),
        (MODE, (1.0, 6.0), wire.MAV_RESULT_TEMPORARILY_REJECTED),  # no stream
        (MODE, (1.0, 5.0), wire.MAV_RESULT_DENIED),
        (MODE, (0.0, 7.0), wire.MAV_RESULT_DENIED),
        (MODE, (1.0, math.nan), wire.MAV_RESULT_DENIED),
        (MODE, (1.0, -7.0), wire.MAV_RESULT_DENIED),
        (wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, (1.0,), wire.MAV_RESULT_ACCEPTED),
        (wire.MAV_CMD_NAV_TAKEOFF, (), wire.MAV_RESULT_DENIED),  # on the stand
        (wire.MAV_CMD_NAV_WAYPOINT, (), wire.MAV_RESULT_UNSUPPORTED),
    ],
)
def test_every_command_is_acknowledged(vehicle, command, params, result):
    assert vehicle.ask(command, *params) == [result]


def test_refusal_is_explained(vehicle):
    vehicle.ask(MODE, 1.0, 6.0)
    (text,) = vehicle.take("STATUSTEXT")
    assert "OFFBOARD rejected" in text.text


@pytest.mark.parametrize(("system", "component"), [(9, 1), (1, 190)])
def test_command_for_another_is_not_executed(vehicle, system, component):
    assert vehicle.ask(ARM, 1.0, system=system, component=component) == []
    assert not vehicle.endpoint.autopilot.armed
    assert vehicle.endpoint.counters[RejectReason.OTHER_TARGET] == 1


def test_component_that_is_not_there_refuses_commands_in_its_own_name(vehicle):
    for _ in range(3):
        assert vehicle.ask(wire.MAV_CMD_DO_WINCH, 1.0, component=wire.MAV_COMP_ID_WINCH) == [UNSUPPORTED]
        vehicle.wait(100_000)
    for component, count in ((1, None), (wire.MAV_COMP_ID_WINCH, 3)):
        numbers = [frame.raw[4] for frame in vehicle.raw[1] if frame.component == component]
        assert numbers == [index % 256 for index in range(count or len(numbers))]
    assert vehicle.ask(ARM, 1.0, component=wire.MAV_COMP_ID_GIMBAL) == [UNSUPPORTED]
    assert not vehicle.endpoint.autopilot.armed
    assert vehicle.ask(ARM, 1.0, system=9, component=wire.MAV_COMP_ID_GIMBAL) == []
    vehicle.say(wire.MAVLink_param_request_list_message(1, wire.MAV_COMP_ID_GIMBAL))
    vehicle.wait()
    assert not vehicle.take("PARAM_VALUE")
    assert vehicle.endpoint.counters == {RejectReason.OTHER_TARGET: 2}


@pytest.mark.slow
def test_what_is_refused_is_counted_and_told_to_all(vehicle):
    vehicle.say(HEARTBEAT, port=2)
    for target in (1, 1, 9):
        vehicle.say(wire.MAVLink_manual_control_message(target, 0, 0, 500, 0, 0))
    assert vehicle.ask(MODE, 1.0, 3.0) == [wire.MAV_RESULT_TEMPORARILY_REJECTED]
    assert vehicle.ask(MODE, 1.0, 3.0, port=2) == [wire.MAV_RESULT_ACCEPTED]  # who sent none
    assert vehicle.endpoint.counters == {RejectReason.REFUSED: 2, RejectReason.OTHER_TARGET: 1}
    for port in (1, 2):
        texts = [message.text for message in vehicle.take("STATUSTEXT", port)]
        assert texts == ["sticks not supported: use OFFBOARD", "sticks are not flown: mode refused"]
    vehicle.wait(10_000_000)
    assert vehicle.ask(MODE, 1.0, 3.0) == [wire.MAV_RESULT_ACCEPTED]


def test_each_peer_has_sequence_numbers_without_a_gap(vehicle):
    for port in (1, 2):
        vehicle.say(HEARTBEAT, port=port, component=190)
    vehicle.wait(2_000_000)
    for port in (1, 2):
        numbers = [frame.raw[4] for frame in vehicle.raw[port]]
        assert numbers == [index % 256 for index in range(len(numbers))]
        assert len(numbers) > 256


def test_three_ground_stations_and_a_controller_see_no_gap_in_a_flight():
    vehicle = Vehicle(lockstep=False, duration_s=3.0)
    for port in (2, 3, 4):
        vehicle.say(HEARTBEAT, port=port, component=190)
    vehicle.take_off()
    for step in range(750):
        vehicle.setpoint(step * SAMPLE_US)
        if step % 100 == 0:
            vehicle.say(wire.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 1.0 + step, 9), port=2)
            vehicle.ask(wire.MAV_CMD_REQUEST_MESSAGE, 148.0, port=3)
            vehicle.say(wire.MAVLink_param_request_list_message(1, 1), port=4)
        vehicle.wait(SAMPLE_US)
    assert vehicle.endpoint.outcome is VehicleOutcome.DONE
    for port in (1, 2, 3, 4):
        for component, least in ((1, 1000), (CONTROLLER, 0)):  # what is relayed has its own numbers
            numbers = [frame.raw[4] for frame in vehicle.raw[port] if frame.component == component]
            assert numbers == [index % 256 for index in range(len(numbers))]
            assert len(numbers) >= least
    stamps = [message.time_usec for message in vehicle.take("HIGHRES_IMU") if message.time_usec]
    assert stamps == [step * SAMPLE_US for step in range(1, 751)]  # one for each sample


def test_what_qgroundcontrol_asks_for_on_connection_is_answered_without_a_retry(vehicle):
    vehicle.say(HEARTBEAT, component=190, system=255)
    request = wire.MAV_CMD_REQUEST_MESSAGE
    assert vehicle.ask(request, 148.0) == [wire.MAV_RESULT_ACCEPTED]
    assert len(vehicle.take("AUTOPILOT_VERSION")) == 1
    for metadata in (397.0, 395.0):  # COMPONENT_METADATA, and COMPONENT_INFORMATION before it
        assert vehicle.ask(request, metadata) == [wire.MAV_RESULT_UNSUPPORTED]
    index = total = 1
    while index <= total:
        assert vehicle.ask(request, 435.0, float(index)) == [wire.MAV_RESULT_ACCEPTED]
        (mode,) = vehicle.take("AVAILABLE_MODES")
        assert mode.mode_index == index
        index, total = index + 1, mode.number_modes
    assert total > 4
    vehicle.say(wire.MAVLink_param_request_list_message(1, 0))
    vehicle.wait()
    listed = vehicle.take("PARAM_VALUE")
    assert {value.param_index for value in listed} == set(range(listed[0].param_count))
    for kind in (0, 1, 2):
        vehicle.say(wire.MAVLink_mission_request_list_message(1, 1, kind))
        vehicle.wait()
        (count,) = vehicle.take("MISSION_COUNT")
        assert (count.count, count.mission_type) == (0, kind)
    assert vehicle.endpoint.counters == {}


def test_state_is_told_at_once_when_it_changes(vehicle):
    vehicle.say(HEARTBEAT)
    vehicle.wait(100_000)
    vehicle.heard.clear()
    assert vehicle.ask(MODE, 1.0, 3.0) == [wire.MAV_RESULT_ACCEPTED]
    (beat,), (current,) = vehicle.take("HEARTBEAT"), vehicle.take("CURRENT_MODE")
    assert beat.custom_mode == current.custom_mode == Mode.POSCTL.value
    assert len(vehicle.take("EXTENDED_SYS_STATE")) == 1


def test_stream_is_never_faster_than_the_samples_nor_its_interval_too_long_to_tell(vehicle):
    vehicle.say(HEARTBEAT)
    attitude = float(wire.MAVLINK_MSG_ID_ATTITUDE)
    for asked, kept in ((1.0, SAMPLE_US), (1e30, 2**31 - 1)):
        assert vehicle.ask(wire.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, asked) == [wire.MAV_RESULT_ACCEPTED]
        assert vehicle.ask(wire.MAV_CMD_GET_MESSAGE_INTERVAL, attitude) == [wire.MAV_RESULT_ACCEPTED]
        assert vehicle.take("MESSAGE_INTERVAL")[0].interval_us == kept


def test_everything_that_is_streamed_fits_its_fields_and_comes_on_request(vehicle):
    vehicle.say(HEARTBEAT)
    for message_id in sorted(vehicle.endpoint.services.streams):
        result = vehicle.ask(wire.MAV_CMD_REQUEST_MESSAGE, float(message_id))
        tracked = message_id in (wire.MAVLINK_MSG_ID_ATTITUDE_TARGET, wire.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET)
        assert result == [wire.MAV_RESULT_TEMPORARILY_REJECTED if tracked else wire.MAV_RESULT_ACCEPTED]


def test_generic_autopilot_tells_all_parameters_as_real_numbers():
    vehicle = Vehicle(lockstep=False, generic=True)
    vehicle.say(wire.MAVLink_param_request_read_message(1, 1, b"SYS_AUTOSTART", -1))
    vehicle.wait()
    (value,) = vehicle.take("PARAM_VALUE")
    assert (value.param_value, value.param_type) == (4001.0, wire.MAV_PARAM_TYPE_REAL32)
    assert vehicle.take("HEARTBEAT")[0].autopilot == wire.MAV_AUTOPILOT_GENERIC


def test_silent_peer_is_forgotten_after_10_s(vehicle):
    vehicle.say(HEARTBEAT)
    vehicle.wait(20_000_000)
    beats = len(vehicle.take("HEARTBEAT"))
    assert 10 <= beats <= 12
    vehicle.wait(5_000_000)
    assert not vehicle.take("HEARTBEAT")


def test_number_of_peers_is_bounded(vehicle):
    for port in range(100):
        vehicle.say(HEARTBEAT, port=port)
    vehicle.wait()
    assert len(vehicle.heard) == 16
    assert vehicle.endpoint.counters[RejectReason.TOO_MANY_PEERS] == 100 - 16


def test_parameters_are_listed_and_read_by_name_and_index(vehicle):
    vehicle.say(wire.MAVLink_param_request_list_message(1, 1))
    vehicle.wait()
    listed = vehicle.take("PARAM_VALUE")
    assert [message.param_index for message in listed] == list(range(listed[0].param_count))
    vehicle.say(wire.MAVLink_param_request_read_message(1, 0, b"GP_TRQ_MAX_P", -1))
    vehicle.say(wire.MAVLink_param_request_read_message(1, 1, b"", 1))
    vehicle.wait()
    by_name, by_index = vehicle.take("PARAM_VALUE")
    assert (by_name.param_id, by_name.param_value) == (by_index.param_id, by_index.param_value) == ("GP_TRQ_MAX_P", 10)


def test_set_parameter_is_told_to_all_peers(vehicle):
    vehicle.say(HEARTBEAT, port=2)
    vehicle.say(wire.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 2.0, 9))
    vehicle.wait()
    for port in (1, 2):
        (value,) = vehicle.take("PARAM_VALUE", port)
        assert (value.param_id, value.param_value) == ("COM_OF_LOSS_T", 2.0)
    assert vehicle.endpoint.autopilot.settings.stream_timeout_us == 2_000_000


def test_gust_intensity_acts_in_flight():
    vehicle = Vehicle(lockstep=False, scenario="paper-turbulence", duration_s=1.0)
    vehicle.take_off()
    gusts = []
    for scale in (1.0, 0.0):
        vehicle.say(wire.MAVLink_param_set_message(1, 1, b"GP_GUST_SCALE", scale, 9))
        vehicle.wait(100_000)
        vehicle.take("WIND_COV")
        vehicle.wait(100_000)
        (wind,) = vehicle.take("WIND_COV")
        gusts.append(math.hypot(wind.wind_x, wind.wind_y, wind.wind_z))
    assert gusts[0] > 0.1
    assert gusts[1] == 0.0


def test_gains_act_in_flight_and_to_set_them_to_what_they_are_changes_no_bit():
    flights = []
    for value in (None, 0.35, 0.1):  # 0.35 is the paper's vehicle
        vehicle = Vehicle(lockstep=False, scenario="paper-turbulence", duration_s=1.0)
        vehicle.take_off()
        vehicle.ask(MODE, 1.0, 7.0)
        vehicle.wait(500_000)
        if value is not None:
            vehicle.say(wire.MAVLink_param_set_message(1, 1, b"MC_ROLLRATE_P", value, 9))
            (told,) = (vehicle.wait(), vehicle.take("PARAM_VALUE"))[1]
            assert told.param_value == pytest.approx(value)
        vehicle.wait(1_000_000)
        flights.append(vehicle.rates)
    plain, same, other = flights
    assert plain[:125] == same[:125] == other[:125]
    assert same == plain
    assert other != plain


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        (b"NOPE", 1.0, wire.MAV_PARAM_ERROR_DOES_NOT_EXIST),
        (b"COM_OF_LOSS_T", math.nan, wire.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE),
        (b"GP_TRQ_MAX_R", 1.0, wire.MAV_PARAM_ERROR_READ_ONLY),
    ],
)
def test_parameter_that_is_not_set_is_refused_with_its_cause(vehicle, name, value, error):
    vehicle.say(wire.MAVLink_param_set_message(1, 1, name, value, 9))
    vehicle.wait()
    (refused,) = vehicle.take("PARAM_ERROR")
    assert (refused.param_id.encode(), refused.error) == (name, error)


def test_set_points_are_echoed(vehicle):
    vehicle.say(HEARTBEAT)
    vehicle.setpoint()
    vehicle.wait(999_999)
    echoes = vehicle.take("ACTUATOR_CONTROL_TARGET")
    assert len(echoes) == 10
    assert echoes[0].controls[0] == pytest.approx(0.1, abs=1e-8)  # a float32
    assert not vehicle.take("ATTITUDE_TARGET")


@pytest.mark.parametrize("rate_hz", [50, 250, 1000])
def test_in_real_time_the_controller_is_sent_each_sample_once(rate_hz):
    vehicle, sample_us = Vehicle(lockstep=False, rate_hz=rate_hz), 1_000_000 // rate_hz
    vehicle.say(HEARTBEAT)
    vehicle.wait(12_345)
    vehicle.take_off()
    vehicle.wait(10 * sample_us)
    told = [message.time_usec for message in vehicle.take("HIGHRES_IMU") if message.time_usec]
    assert told == list(range(sample_us, 11 * sample_us, sample_us))


@pytest.mark.parametrize(
    ("scenario", "surplus"), [("calm", RejectReason.DUPLICATE), ("link-delay", RejectReason.STALE)]
)
def test_answers_to_repetitions_of_sample_0_may_come_after_the_start(scenario, surplus):
    vehicle = Vehicle(lockstep=True, scenario=scenario, duration_s=load_scenario(scenario).duration_s)
    vehicle.say(HEARTBEAT)
    vehicle.wait(200_000)
    repetitions = len(vehicle.take("HIGHRES_IMU"))
    vehicle.take_off()
    told = [message.time_usec for message in vehicle.take("HIGHRES_IMU")]
    under_way = repetitions - 1 + told.count(0)
    for _ in range(under_way):
        vehicle.setpoint(0)
        vehicle.wait()
    assert under_way > 8
    assert vehicle.endpoint.counters == {}
    vehicle.setpoint(0)
    vehicle.wait()
    assert vehicle.endpoint.counters == {surplus: 1}


def test_real_time_flight_holds_a_late_set_point(vehicle):
    vehicle.take_off()
    vehicle.wait(SAMPLE_US * 3)
    assert len(vehicle.modes) == 3
    assert vehicle.endpoint.flight.counters[TimingFault.HELD] == 2  # sample 0 was answered before t = 0
    assert set(vehicle.modes) == {Mode.OFFBOARD.value}


def test_real_time_flight_keeps_absolute_deadlines_through_a_stall(vehicle):
    vehicle.take_off()
    vehicle.now_us += 10 * SAMPLE_US + 1
    vehicle.setpoint()
    vehicle.wait()
    assert len(vehicle.modes) == 10
    assert vehicle.endpoint.flight.counters[TimingFault.OVERRUN] == 9


def test_real_time_stream_that_stops_ends_in_the_fail_safe():
    vehicle = Vehicle(lockstep=False, duration_s=2.0)
    vehicle.take_off()
    vehicle.wait(3_000_000)
    assert vehicle.endpoint.outcome is VehicleOutcome.STREAM_LOST
    assert vehicle.modes.count(Mode.OFFBOARD.value) == 250  # one second, COM_OF_LOSS_T
    assert vehicle.modes[-1] == Mode.STABILIZED.value
    assert any("failsafe" in message.text for message in vehicle.take("STATUSTEXT"))
    assert vehicle.take("HEARTBEAT")[-1].base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED == 0


def test_another_controller_takes_over_only_when_the_stream_is_dead():
    vehicle = Vehicle(lockstep=False, duration_s=3.0)
    vehicle.take_off()
    vehicle.setpoint(port=2)
    assert vehicle.endpoint.counters[RejectReason.NOT_IN_COMMAND] == 1
    vehicle.wait(1_100_000)
    vehicle.setpoint(port=2)
    assert vehicle.ask(MODE, 1.0, 6.0, port=2) == [wire.MAV_RESULT_ACCEPTED]


def test_real_time_set_point_older_than_the_last_is_stale(vehicle):
    vehicle.take_off()
    vehicle.setpoint(8_000)
    vehicle.setpoint(4_000)
    assert vehicle.endpoint.counters[RejectReason.STALE] == 1


def test_set_point_with_nothing_to_track_is_counted_and_its_sender_not_in_command(vehicle):
    vehicle.say(wire.MAVLink_set_attitude_target_message(0, 1, 1, 0xFF, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5))
    vehicle.setpoint(port=2)
    assert vehicle.endpoint.counters == {RejectReason.NO_SETPOINT: 1}


def test_setpoints_of_two_messages_pass_a_link_each_by_its_own_stamps():
    vehicle = Vehicle(lockstep=False, scenario="link-delay", duration_s=21.0)
    vehicle.take_off()
    level = AttitudeTarget(time_us=5_000_000_000, q_NB=(1.0, 0.0, 0.0, 0.0), omega_B=None, thrust=0.5)
    vehicle.say(command_message(level, 1))
    vehicle.wait(SAMPLE_US)
    vehicle.setpoint(5_000_100)  # MAVSDK's ms, where the message has us
    vehicle.wait(SAMPLE_US)
    assert isinstance(vehicle.endpoint.setpoint, TorqueCommand)
    vehicle.say(command_message(level._replace(time_us=4_999_000_000), 1))
    vehicle.wait(SAMPLE_US)
    assert isinstance(vehicle.endpoint.setpoint, TorqueCommand)
    assert vehicle.endpoint.scripted_link.stats()["to_vehicle"]["overtaken"] == 1


def test_leaving_offboard_is_named(vehicle):
    vehicle.take_off()
    vehicle.wait(SAMPLE_US)
    vehicle.ask(MODE, 1.0, 3.0)
    vehicle.wait(1_000_000)
    assert vehicle.endpoint.outcome is VehicleOutcome.LEFT_OFFBOARD


def test_disarming_in_flight_is_refused(vehicle):
    vehicle.take_off()
    assert vehicle.ask(ARM, 0.0) == [wire.MAV_RESULT_TEMPORARILY_REJECTED]


def test_interrupted_flight_is_named(vehicle):
    vehicle.take_off()
    vehicle.endpoint.interrupt()
    assert vehicle.endpoint.finished
    assert vehicle.endpoint.outcome is VehicleOutcome.INTERRUPTED


def test_any_message_that_is_refused_is_survived(vehicle):
    chance, packer = random.Random(3), wire.MAVLink(None, 1, CONTROLLER)
    numbers = sorted(refusals.make_service(vehicle.endpoint).requests)
    for index in range(2_000):
        number = chance.choice(numbers)
        length = wire.mavlink_map[number].unpacker.size
        body = bytes(chance.choice((0, 1, chance.randrange(256))) for _ in range(length))
        vehicle.endpoint.receive(EncodedMessage(number, body).pack(packer), (0, ("client", 1)), index)
        vehicle.endpoint.poll(index)
    assert vehicle.endpoint.counters.keys() == {RejectReason.REFUSED, RejectReason.OTHER_TARGET}
    assert vehicle.endpoint.counters[RejectReason.REFUSED] > 500


def test_any_message_of_the_dialect_is_survived(vehicle):
    chance, packer = random.Random(4), wire.MAVLink(None, 1, CONTROLLER)
    for number, kind in wire.mavlink_map.items():
        for _ in range(3):
            body = bytes(chance.choice((0, 1, chance.randrange(256))) for _ in range(kind.unpacker.size))
            vehicle.endpoint.receive(EncodedMessage(number, body).pack(packer), (0, ("client", 1)), vehicle.now_us)
    vehicle.wait()
    assert vehicle.endpoint.counters[RejectReason.UNUSED_MESSAGE] > 100
    assert vehicle.endpoint.counters[RejectReason.REFUSED] > 10


@pytest.mark.slow
@pytest.mark.parametrize("lockstep", [False, True])
def test_any_datagram_is_survived_and_counted(lockstep):
    vehicle = Vehicle(lockstep=lockstep)
    chance = random.Random(2)
    names = ("command_long", "param_set", "param_request_read", "param_request_list", "heartbeat")
    kinds = [getattr(wire, f"MAVLink_{name}_message") for name in (*names, *SETPOINTS)]
    packer = wire.MAVLink(None, 1, CONTROLLER)
    for index in range(20_000):
        kind = chance.choice(kinds)
        body = bytes(chance.choice((0, 1, chance.randrange(256))) for _ in range(kind.unpacker.size))
        datagram = bytearray(EncodedMessage(kind.id, body).pack(packer))
        if chance.random() < 0.3:
            datagram = datagram[: chance.randrange(len(datagram))] + chance.randbytes(chance.randrange(9))
        vehicle.endpoint.receive(bytes(datagram), (0, ("client", chance.randrange(40))), index)
        if index % 100 == 0:
            vehicle.endpoint.poll(index)
    assert vehicle.endpoint.counters[RejectReason.OTHER_TARGET] > 1000
    assert vehicle.endpoint.counters[RejectReason.TOO_MANY_PEERS] > 1000


@pytest.mark.parametrize("scenario", ["calm", "link-delay"])
@pytest.mark.parametrize("lockstep", [True, False])
def test_every_imu_sample_leaves_through_one_function(lockstep, scenario, monkeypatch):
    sent = []
    make_packer = peers.sample_packer

    def make_counting_packer(*arguments):
        pack = make_packer(*arguments)
        return lambda sample: sent.append(sample) or pack(sample)

    monkeypatch.setattr(peers, "sample_packer", make_counting_packer)
    vehicle = Vehicle(lockstep=lockstep, scenario=scenario, duration_s=load_scenario(scenario).duration_s)
    vehicle.take_off()
    for port in (1, 2):
        vehicle.say(HEARTBEAT, port=port, component=CONTROLLER if port == 1 else 190)
    imu = float(wire.MAVLINK_MSG_ID_HIGHRES_IMU)
    assert vehicle.ask(wire.MAV_CMD_REQUEST_MESSAGE, imu, port=2) == [wire.MAV_RESULT_ACCEPTED]
    for _ in range(60):
        samples = vehicle.take("HIGHRES_IMU")
        for message in samples or [None]:
            vehicle.setpoint(message.time_usec if message else 0)
        vehicle.wait(SAMPLE_US)
    frames = [frame for heard in vehicle.raw.values() for frame in heard]
    assert len(sent) == sum(frame.message_id == wire.MAVLINK_MSG_ID_HIGHRES_IMU for frame in frames) > 50


KEY, UNIX_US = bytes(range(32)), 1_700_000_000_000_000


def keyed() -> wire.MAVLink:
    """Return a controller's packer with the key, and stamps from now on."""
    packer = wire.MAVLink(None, 1, CONTROLLER)
    packer.signing.secret_key, packer.signing.sign_outgoing = KEY, True
    packer.signing.timestamp = (UNIX_US - 1_420_070_400_000_000) // 10
    return packer


class Controlled(Vehicle):
    """A vehicle whose controller answers each sample that it hears."""

    def __init__(self, *, lockstep: bool = True, throttle: float | None = None, rates: bool = False, **options) -> None:
        super().__init__(lockstep=lockstep, **options)
        self.packer = keyed() if options.get("signing") else wire.MAVLink(None, 1, CONTROLLER)
        self.throttle, self.by_rates = throttle, rates
        self.say(HEARTBEAT)
        self.answer(0)
        self.command(ARM, 1.0)
        self.wait()
        assert self.endpoint.autopilot.armed
        self.take("HIGHRES_IMU")
        self.command(MODE, 1.0, 6.0)

    def command(self, number: int, *params: float) -> None:
        numbers = (*params, *[math.nan] * (7 - len(params)))
        self.send(wire.MAVLink_command_long_message(1, 1, number, 0, *numbers))

    def answer(self, time_us: int) -> None:
        torques = TorqueCommand(time_us, (0.125, 0.0, 0.0), self.throttle)
        rates = AttitudeTarget(time_us, None, (0.25, 0.0, 0.0), 0.5)
        self.send(command_message(rates if self.by_rates else torques, 1))

    def send(self, message) -> None:
        self.packer.seq = (self.packer.seq + 1) & 255
        self.packer.signing.timestamp += 1
        datagram = message.pack(self.packer)
        self.endpoint.receive(datagram, (0, ("client", 1)), self.now_us)

    def fly(self, us: int = 20_000_000) -> None:
        """Answer each sample until the flight ends or wall time is over, which runs only while the vehicle waits."""
        end_us = self.now_us + us
        while not self.endpoint.finished:
            self.poll()
            samples = self.take("HIGHRES_IMU")
            for sample in samples:
                self.answer(sample.time_usec)
            if not samples and self.endpoint.deadline_us() > end_us:
                break
            if not samples:
                self.now_us = max(self.endpoint.deadline_us(), self.now_us + 1)


def test_lockstep_leaves_room_for_heartbeats_and_the_streams_of_others():
    vehicle = Controlled(duration_s=4.0)
    vehicle.say(HEARTBEAT, port=2, component=190)
    while not vehicle.endpoint.finished:
        vehicle.wait()
        for sample in vehicle.take("HIGHRES_IMU"):
            vehicle.answer(sample.time_usec)
        vehicle.now_us += SAMPLE_US
    for port in (1, 2):
        assert 4 <= len(vehicle.take("HEARTBEAT", port)) <= 8  # one a second, and one at each change
    assert len(vehicle.take("ATTITUDE", 2)) in (399, 400, 401)  # 100 Hz
    assert not vehicle.take("ATTITUDE", 1)


def test_heartbeat_is_sent_in_time_in_lockstep():
    vehicle = Controlled(duration_s=4.0)
    vehicle.poll()
    assert vehicle.take("HEARTBEAT")  # OFFBOARD, at 0 s
    for now_us, beats in ((500_000, 0), (999_999, 0), (1_000_000, 1), (1_000_001, 0)):
        vehicle.now_us = now_us
        vehicle.answer(vehicle.endpoint.loop.time_us)
        vehicle.poll()
        assert len(vehicle.take("HEARTBEAT")) == beats
    assert len(vehicle.modes) == 5


def test_one_poll_flies_at_most_a_batch_of_samples(monkeypatch):
    assert vehicle_endpoint._MAX_BATCH == 250
    monkeypatch.setattr(vehicle_endpoint, "_MAX_BATCH", 10)
    vehicle = Controlled(duration_s=0.08)
    vehicle.poll()
    vehicle.command(MODE, 1.0, 7.0)  # outside OFFBOARD lockstep waits for nobody
    flown = [len(vehicle.modes)]
    for _ in range(3):
        vehicle.poll()
        flown.append(len(vehicle.modes))
    assert [after - before for before, after in pairwise(flown)] == [10, 9, 0]
    assert vehicle.endpoint.finished


def test_set_point_with_a_throttle_is_flown_in_lockstep():
    vehicle = Controlled(duration_s=0.1, throttle=0.5)
    vehicle.fly()
    assert vehicle.endpoint.outcome is VehicleOutcome.DONE
    assert vehicle.endpoint.counters == {}


@pytest.mark.parametrize("polled", [False, True])
def test_paused_lockstep_flies_no_answer(polled):
    vehicle = Controlled(duration_s=0.1)
    vehicle.poll()
    vehicle.answer(SAMPLE_US)
    vehicle.poll()
    one = struct.unpack("<f", struct.pack("<i", 1))[0]  # integers travel bytewise
    vehicle.send(wire.MAVLink_param_set_message(1, 1, b"GP_PAUSE", one, wire.MAV_PARAM_TYPE_INT32))
    if polled:
        vehicle.poll()
    flown = len(vehicle.modes)
    vehicle.answer(vehicle.endpoint.loop.time_us)
    vehicle.wait(50_000)
    assert len(vehicle.modes) == flown > 0


def test_lockstep_flight_without_a_controller_is_given_up_after_a_minute():
    vehicle = Vehicle(lockstep=True)
    vehicle.wait(60_000_000)
    assert not vehicle.endpoint.finished
    vehicle.wait(2_000_000)
    assert vehicle.endpoint.outcome is VehicleOutcome.NO_CONTROLLER
    assert vehicle.endpoint.finished


@pytest.mark.parametrize("lockstep", [True, False])
def test_script_changes_the_mode_and_tells_when_that_is_refused(lockstep):
    asked = ((0.1, "hold"), (0.2, "takeoff"))
    changes = tuple(ModeChange(kind="mode", at_s=at_s, mode=mode) for at_s, mode in asked)
    vehicle = Controlled(lockstep=lockstep, duration_s=0.4, event=changes)
    vehicle.fly()
    assert vehicle.modes == [Mode.OFFBOARD.value] * 25 + [Mode.HOLD.value] * 75
    assert vehicle.endpoint.flight.counters[TimingFault.REFUSED] == 1
    assert [text.text for text in vehicle.take("STATUSTEXT")] == ["held on the test stand: refused"]
    assert vehicle.endpoint.outcome is VehicleOutcome.LEFT_OFFBOARD
    assert vehicle.flushed == [25, 50]


def test_killed_controller_is_heard_no_more_and_another_one_is_invited():
    kill = ControllerKill(kind="controller_killed", at_s=0.1, recovers_after_s=0.1)
    vehicle = Controlled(duration_s=0.4, event=(kill,))
    for port in (2, 3):
        vehicle.say(HEARTBEAT, port=port, component=CONTROLLER if port == 2 else 190)
    vehicle.fly(1_000_000)
    assert len(vehicle.modes) == 50  # lockstep waits for the next controller
    stands_us = vehicle.endpoint.loop.time_us
    told = {port: [message.time_usec for message in vehicle.take("HIGHRES_IMU", port)] for port in (1, 2, 3)}
    assert told[1] == []
    assert told[3].count(stands_us) <= 1  # a ground station's own stream
    assert told[2].count(stands_us) in (10, 11)  # every 100 ms
    vehicle.answer(stands_us)
    assert vehicle.endpoint.counters == {RejectReason.NOT_IN_COMMAND: 1}
    for _ in range(2):  # its first answer ends the wait, its second passes the link
        assert len(vehicle.modes) == 50
        vehicle.say(command_message(TorqueCommand(stands_us, (0.0, 0.0, 0.0), None), 1), port=2)
        vehicle.wait()
    assert len(vehicle.modes) == 51
    assert vehicle.take("HIGHRES_IMU", 2)[-1].time_usec == stands_us + SAMPLE_US


def test_vehicle_with_a_key_obeys_and_relays_only_what_is_signed():
    vehicle = Vehicle(lockstep=False, signing=Signing(KEY, UNIX_US))
    vehicle.say(HEARTBEAT, port=2, component=190)  # a heartbeat is no secret, and is not passed on
    text = wire.MAVLink_statustext_message(6, b"law in control")
    vehicle.say(text)
    assert vehicle.endpoint.counters == {RejectReason.NOT_SIGNED: 1}
    vehicle.say(HEARTBEAT)
    vehicle.wait()
    assert {frame.component for frame in vehicle.raw[2] if frame.message_id == 0} == {1}
    datagram = text.pack(keyed())
    vehicle.endpoint.receive(datagram, (0, ("client", 1)), vehicle.now_us)
    vehicle.wait()
    assert [message.text for message in vehicle.take("STATUSTEXT", 2)] == ["law in control"]
    assert not vehicle.take("STATUSTEXT", 1)
    assert all(frame.is_signed for frame in vehicle.raw[2])
    vehicle.endpoint.receive(datagram, (0, ("client", 1)), vehicle.now_us)
    assert vehicle.endpoint.counters == {RejectReason.NOT_SIGNED: 1, RejectReason.REPLAYED: 1}


def test_signed_lockstep_flies_like_an_unsigned_one():
    flights = []
    for signing in (None, Signing(KEY, UNIX_US)):
        vehicle = Controlled(scenario="paper-turbulence", duration_s=0.1, signing=signing)
        vehicle.fly()
        flights.append(vehicle.rates)
    assert flights[0] == flights[1]
    assert len(flights[0]) == 25


@pytest.mark.slow
def test_commander_that_is_silent_for_10_s_is_forgotten_and_the_next_one_heard_at_once():
    vehicle = Vehicle(lockstep=False, interactive=True)
    vehicle.setpoint()
    vehicle.setpoint(port=2)
    assert vehicle.endpoint.counters == {RejectReason.NOT_IN_COMMAND: 1}
    vehicle.wait(11_500_000)
    vehicle.setpoint(port=2)
    vehicle.setpoint(port=1)
    assert vehicle.endpoint.counters == {RejectReason.NOT_IN_COMMAND: 2}  # now the first one is the rival
    assert [link for link in vehicle.endpoint.links if link != "gone"] == ["client:2", "client:1"]


def test_controller_that_hangs_by_the_script_is_not_sent_its_samples():
    hang = ControllerHang(kind="controller_hung", at_s=0.1, for_s=0.1)
    vehicle = Controlled(duration_s=0.4, event=(hang,))
    vehicle.fly()
    assert vehicle.endpoint.outcome is VehicleOutcome.DONE
    assert vehicle.flushed == [25]
    assert vehicle.endpoint.scripted_link.stats()["to_controller"]["unheard"] == 25


def test_message_that_nothing_reads_is_counted(vehicle):
    vehicle.say(HEARTBEAT, component=190)
    vehicle.say(wire.MAVLink_attitude_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert vehicle.endpoint.counters == {RejectReason.UNUSED_MESSAGE: 1}


def heard_texts(vehicle: Vehicle, port: int = 1) -> list[str]:
    return [message.text for message in vehicle.take("STATUSTEXT", port)]


def attitude(q=(1.0, 0.0, 0.0, 0.0), thrust: float = 0.5, mask: int = 7):
    return wire.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, 0.0, 0.0, 0.0, thrust)


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (attitude((math.nan, 0.0, 0.0, 0.0)), "set-points refused: NaN or infinite"),
        (attitude((0.0, 0.0, 0.0, 0.0)), "set-points refused: quaternion not of length 1"),
        (attitude((0.0, 3.0, 0.0, 0.0)), "set-points refused: quaternion not of length 1"),
        (attitude(thrust=math.nan), "set-points refused: no thrust, or no target"),
        (attitude(mask=7 | 128), "set-points refused: no thrust, or no target"),
    ],
)
def test_set_points_without_effect_are_refused_by_name_every_five_seconds(message, text):
    vehicle = Vehicle(lockstep=False, interactive=True)
    vehicle.say(HEARTBEAT)
    for _ in range(60):
        vehicle.say(message)
        vehicle.wait(100_000)
    assert heard_texts(vehicle) == [text] * 2
    vehicle.ask(MODE, 1.0, 6.0)
    assert heard_texts(vehicle) == ["OFFBOARD rejected: no usable set-points"]


@pytest.mark.parametrize(
    ("lead_s", "said"),
    [
        (86400 * 3650, ["signature refused: a clock is over 1 min ahead"]),
        (-86400, ["signature refused: a clock is over 1 min behind"]),
        (50, []),
    ],
)
def test_clock_that_is_wrong_by_more_than_a_minute_is_told_once_and_harms_nobody(lead_s, said):
    vehicle = Vehicle(lockstep=False, interactive=True, signing=Signing(KEY, UNIX_US))
    vehicle.say(HEARTBEAT)
    for _ in range(3):
        wrong = keyed()
        wrong.srcComponent, wrong.signing.timestamp = 55, wrong.signing.timestamp + 100_000 * lead_s
        vehicle.endpoint.receive(attitude().pack(wrong), (0, ("client", 2)), vehicle.now_us)
        vehicle.wait(6_000_000)
        vehicle.say(HEARTBEAT)
    assert heard_texts(vehicle) == said
    vehicle.endpoint.receive(attitude().pack(late := keyed()), (0, ("client", 3)), vehicle.now_us)
    assert late.signing.timestamp
    assert vehicle.endpoint.setpoint is not None


def test_signed_commands_to_a_vehicle_without_a_key_are_served_and_their_sender_told_once(vehicle):
    client = keyed()
    for _ in range(3):
        vehicle.endpoint.receive(HEARTBEAT.pack(client), (0, ("client", 1)), vehicle.now_us)
        vehicle.say(HEARTBEAT, port=2)
        vehicle.wait()
    assert heard_texts(vehicle) == ["signatures not checked: start with --signing-key"]
    assert heard_texts(vehicle, 2) == []


def test_message_to_this_vehicle_that_nothing_reads_is_refused_by_its_name(vehicle):
    vehicle.say(HEARTBEAT, component=190)
    for _ in range(2):
        vehicle.say(wire.MAVLink_fence_fetch_point_message(1, 1, 0), component=190)
    vehicle.wait()
    assert heard_texts(vehicle) == ["FENCE_FETCH_POINT not supported"]
    assert vehicle.endpoint.counters == {RejectReason.REFUSED: 2}


def test_client_of_mavlink_1_is_answered_in_mavlink_1_and_told_once_what_that_lacks(vehicle):
    client = wire.MAVLink(None, 255, 190)
    ask = wire.MAVLink_command_long_message(1, 1, 512, 0, 435, 0, 0, 0, 0, 0, 0)  # AVAILABLE_MODES
    for _ in range(2):
        for message in (HEARTBEAT, ask):
            datagram = message.pack(client, force_mavlink1=True)
            vehicle.endpoint.receive(datagram, (0, ("client", 1)), vehicle.now_us)
        vehicle.say(HEARTBEAT, port=2, component=190)
        vehicle.wait(3_000_000)
    assert {frame.is_version_1 for frame in vehicle.raw[1]} == {True}
    assert {frame.is_version_1 for frame in vehicle.raw[2]} == {False}
    assert [message.result for message in vehicle.take("COMMAND_ACK")] == [wire.MAV_RESULT_ACCEPTED] * 2
    assert heard_texts(vehicle) == ["MAVLink 1: messages above 255 are not sent"]
    assert vehicle.take("ATTITUDE")
    assert vehicle.take("CURRENT_MODE", 2)
    assert vehicle.endpoint.links["client:1"]["out"] == len(vehicle.raw[1])


def test_controller_that_speaks_mavlink_1_flies_and_is_relayed_in_it(vehicle):
    vehicle.endpoint.receive(
        HEARTBEAT.pack(wire.MAVLink(None, 255, 190), force_mavlink1=True), (0, ("client", 2)), vehicle.now_us
    )
    vehicle.say(HEARTBEAT)
    vehicle.wait()
    relayed = [frame for frame in vehicle.raw[2] if frame.component == CONTROLLER]
    assert [frame.is_version_1 for frame in relayed] == [True]


@pytest.mark.parametrize("command", [wire.MAV_CMD_REQUEST_MESSAGE, wire.MAV_CMD_SET_MESSAGE_INTERVAL])
def test_fifty_messages_asked_for_by_two_stations_at_once_are_each_answered_within_a_second(vehicle, command):
    asked = [*range(25), *range(80, 100), 141, 148, 242, 435, 436]
    old, new = wire.MAVLink(None, 255, 190), wire.MAVLink(None, 255, 191)
    for number in asked:
        long = wire.MAVLink_command_long_message(1, 1, command, 0, number, 500_000, 0, 0, 0, 0, 0)
        whole = wire.MAVLink_command_int_message(1, 1, 0, command, 0, 0, number, 500_000, 0, 0, 0, 0, 0)
        vehicle.endpoint.receive(long.pack(old, force_mavlink1=True), (0, ("client", 1)), vehicle.now_us)
        vehicle.endpoint.receive(whole.pack(new), (0, ("client", 2)), vehicle.now_us)
    vehicle.wait(1_000_000)
    first, second = (vehicle.take("COMMAND_ACK", port) for port in (1, 2))
    assert len(asked) == len(set(asked)) == len(first) == len(second) == 50
    assert {message.command for message in (*first, *second)} == {command}
    results = [message.result for message in first]
    assert results == [message.result for message in second]  # to each in the order it asked, the same
    assert set(results) == {wire.MAV_RESULT_ACCEPTED, UNSUPPORTED} | ({1} if command == 512 else set())
    assert {frame.is_version_1 for frame in vehicle.raw[1]} == {True}
    assert {frame.is_version_1 for frame in vehicle.raw[2]} == {False}
    assert {(message.target_system, message.target_component) for message in second} == {(255, 191)}


def test_a_scenario_with_an_event_that_it_would_not_notice_is_refused():
    script = replace(load_scenario("calm"), event=(GpsLoss(kind="gps_lost", at_s=1.0),))
    with pytest.raises(ConfigError, match=r"event\.0: gps_lost is of real autopilots"):
        VehicleEndpoint(load_vehicle("paper"), script, 1, lambda _: None, lockstep=True)
