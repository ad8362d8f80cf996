"""The controller's endpoint on a virtual clock, against an autopilot that says what the test tells it to say."""

import math
import random
import socket
import struct
from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import EncodedMessage, RejectReason, parse
from firmware_model.mavlink.messages import heartbeat_message, imu_message, imu_template, tilt_message, torque_template
from firmware_model.mavlink.signing import Signing
from firmware_model.mavlink.wire import NO_SOCKET, make_line
from firmware_model.process import udp
from firmware_model.types import ImuSample
from gustproof.flight.controllers.stepper import CheckedStepper, StepFault
from gustproof.flight.endpoint.core import ControllerCore
from gustproof.flight.endpoint.endpoint import (
    ControllerEndpoint,
    ControllerOutcome,
    Phase,
)
from gustproof.flight.endpoint.exchange import answer_sample, answer_samples
from gustproof.law.form import load_law

VEHICLE = (0, ("vehicle", 14580))
RETRIES, RETRY_US, VEHICLE_TIMEOUT_US = 50, 200_000, 5_000_000
OFFBOARD, STABILIZED, HOLD = 6 << 16, 7 << 16, 4 << 16 | 3 << 24
TAKEOFF, RETURN, LAND = (4 << 16 | sub << 24 for sub in (2, 5, 6))
KEY, UNIX_US = bytes(range(32)), 1_700_000_000_000_000
ARM, MODE = wire.MAV_CMD_COMPONENT_ARM_DISARM, wire.MAV_CMD_DO_SET_MODE
INTERVAL = wire.MAV_CMD_SET_MESSAGE_INTERVAL


class Autopilot:
    """What the test says to the controller, and what it hears from it."""

    def __init__(self, law: str = "hinf-d1", *, signed: bool = False, address=VEHICLE) -> None:
        self.endpoint = ControllerEndpoint(load_law(law), address, Signing(KEY, UNIX_US) if signed else None)
        self.address = address
        self.packer = wire.MAVLink(None, 3, 1)
        self.packer.signing.secret_key, self.packer.signing.sign_outgoing = KEY, signed
        self.packer.signing.timestamp = (UNIX_US - 1_420_070_400_000_000) // 10
        self.now_us = 0

    def pack(self, message) -> bytes:
        self.packer.signing.timestamp += 1
        datagram: bytes = message.pack(self.packer)
        self.packer.seq = (self.packer.seq + 1) & 255
        return datagram

    def say(self, *messages, peer=None) -> None:
        for message in messages:
            self.endpoint.receive(self.pack(message), peer or self.address, self.now_us)

    def hear(self) -> list:
        return [frame.message() for datagram, _ in self.endpoint.poll(self.now_us) for frame in parse(datagram)]

    def names(self) -> list[str]:
        return [message.get_type() for message in self.hear()]

    def parameters_asked_for(self) -> list[str]:
        return [message.param_id for message in self.hear() if hasattr(message, "param_id")]

    def reach(self, phase: Phase) -> None:
        steps = {
            Phase.READING: [heartbeat_message(STABILIZED, False, critical=False)],
            Phase.ARMING: [*parameters(), imu(0)],
            Phase.ENTERING: [accepted(wire.MAV_CMD_COMPONENT_ARM_DISARM)],
            Phase.FLYING: [accepted(wire.MAV_CMD_DO_SET_MODE)],
        }
        for reached, messages in steps.items():
            self.hear()
            self.say(*messages)
            assert self.endpoint.phase is reached
            if reached is phase:
                return


def parameters(rate_hz: int = 250):
    for name in ("GP_TRQ_MAX_R", "GP_TRQ_MAX_P", "GP_TRQ_MAX_Y"):
        yield wire.MAVLink_param_value_message(name.encode(), 10.0, 9, 5, 0)
    yield wire.MAVLink_param_value_message(b"MPC_THR_HOVER", 0.5, 9, 5, 3)
    bytewise = struct.unpack("<f", struct.pack("<i", rate_hz))[0]
    yield wire.MAVLink_param_value_message(b"IMU_INTEG_RATE", bytewise, 6, 5, 4)


def imu(time_us: int, roll_rate: float = 0.1):
    return imu_message(ImuSample(time_us=time_us, gyro_B=(roll_rate, 0.0, 0.0), specific_force_B=(0.0, 0.0, -9.8)))


def accepted(command: int, result: int = wire.MAV_RESULT_ACCEPTED):
    return wire.MAVLink_command_ack_message(command, result)


@pytest.fixture
def autopilot() -> Autopilot:
    return Autopilot()


def test_controller_shows_itself_as_an_on_board_computer(autopilot):
    (datagram, peer), *_ = autopilot.endpoint.poll(0)
    (frame,) = parse(datagram)
    beat = frame.message()
    assert (beat.type, frame.component, peer) == (18, 191, VEHICLE)
    assert (beat.autopilot, beat.base_mode, beat.custom_mode, beat.system_status) == (8, 0, 0, 4)


def test_it_takes_the_system_id_of_its_vehicle(autopilot):
    autopilot.reach(Phase.READING)
    (datagram, _), *_ = autopilot.endpoint.poll(0)
    (frame,) = parse(datagram)
    assert frame.system == 3
    assert frame.message().target_system == 3


def test_it_reads_limits_and_rate_then_arms_then_asks_for_offboard(autopilot):
    autopilot.reach(Phase.READING)
    *wanted, rate = autopilot.hear()
    wanted = [message.param_id for message in wanted]
    assert (rate.command, rate.param1, rate.param2) == (INTERVAL, wire.MAVLINK_MSG_ID_HIGHRES_IMU, 4000.0)
    assert wanted == ["GP_TRQ_MAX_R", "GP_TRQ_MAX_P", "GP_TRQ_MAX_Y", "MPC_THR_HOVER", "IMU_INTEG_RATE"]
    autopilot.say(*parameters(), imu(0))
    setpoint, arm = autopilot.hear()
    assert setpoint.get_type() == "SET_ACTUATOR_CONTROL_TARGET"
    assert (arm.command, arm.param1) == (wire.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    autopilot.say(accepted(wire.MAV_CMD_COMPONENT_ARM_DISARM))
    (mode,) = autopilot.hear()
    assert (mode.command, mode.param1, mode.param2) == (wire.MAV_CMD_DO_SET_MODE, 1.0, 6.0)


def test_rates_law_needs_no_torque_limits():
    autopilot = Autopilot("hinf-rates")
    autopilot.reach(Phase.READING)
    assert autopilot.parameters_asked_for() == ["MPC_THR_HOVER", "IMU_INTEG_RATE"]


def test_every_sample_is_answered_with_its_stamp(autopilot):
    autopilot.reach(Phase.FLYING)
    for time_us in (4000, 8000):
        autopilot.say(imu(time_us))
    assert [message.time_usec for message in autopilot.hear() if message.get_type().startswith("SET_ACT")] == [
        4000,
        8000,
    ]


def test_the_tilt_that_a_position_loop_asks_for_is_tracked_and_no_other():
    def answer(*tilts_deg: float, time_runs: bool = False) -> list[float]:
        autopilot = Autopilot("flagship")
        autopilot.reach(Phase.FLYING)
        autopilot.endpoint._time_runs = time_runs
        autopilot.hear()
        for tilt in tilts_deg:
            autopilot.say(tilt_message((tilt, -2.0)))
        autopilot.say(imu(4000), imu(8000))
        *_, last = (message.controls[:2] for message in autopilot.hear() if message.get_type().startswith("SET_ACT"))
        return list(last)

    level, asked = answer(), answer(3.0)
    assert asked[0] > level[0]
    assert asked[1] < level[1]
    assert answer(3.0, math.nan) == asked
    assert answer(3.0, time_runs=True) == level  # a pilot's vehicle: ArduPilot tells what its own navigation wants


@pytest.mark.parametrize("law", ["flagship", "hinf-rates"])
def test_samples_that_waited_are_all_stepped_and_the_newest_are_answered(law):
    prompt, hung = Autopilot(law), Autopilot(law)
    stamps = range(4000, 126 * 4000, 4000)
    for autopilot in (prompt, hung):
        autopilot.reach(Phase.FLYING)
        autopilot.hear()
    answers = []
    for stamp in stamps:
        prompt.say(imu(stamp))
        answers += prompt.hear()
    hung.say(*map(imu, stamps))
    assert list(map(str, hung.hear())) == list(map(str, answers[-16:]))
    assert (hung.endpoint.late, prompt.endpoint.late) == (124, 0)
    assert hung.endpoint.missed == prompt.endpoint.missed == 0


def test_repeated_sample_is_not_late(autopilot):
    autopilot.reach(Phase.FLYING)
    autopilot.say(imu(4000), imu(4000))
    assert autopilot.endpoint.late == 0


def test_samples_that_never_came_are_missed(autopilot):
    autopilot.reach(Phase.FLYING)
    autopilot.say(imu(4000), imu(16_000), imu(20_001), imu(24_000))
    assert autopilot.endpoint.missed == 2


@pytest.mark.parametrize("law", ["hinf-d1", "hinf-rates"])
def test_a_sample_of_any_stamp_is_answered(law):
    autopilot = Autopilot(law)
    autopilot.reach(Phase.FLYING)
    autopilot.hear()
    late_us = 2**64 - 1
    autopilot.say(imu(late_us))
    (answer,) = autopilot.hear()
    stamp = answer.time_boot_ms if law == "hinf-rates" else answer.time_usec
    assert stamp == (late_us // 1000 % 2**32 if law == "hinf-rates" else late_us)


@pytest.mark.parametrize("phase", [Phase.SEEKING, Phase.READING, Phase.ARMING, Phase.ENTERING])
def test_it_repeats_a_request_and_then_gives_up_with_a_name(autopilot, phase):
    if phase is not Phase.SEEKING:
        autopilot.reach(phase)
    polls = 0
    while not autopilot.endpoint.finished:
        autopilot.hear()
        autopilot.now_us += RETRY_US
        polls += 1
    assert polls == RETRIES + 1
    assert autopilot.endpoint.outcome is ControllerOutcome.NOT_STARTED
    assert autopilot.endpoint.message.startswith(phase.value.format(mode="OFFBOARD"))


def test_refused_arming_ends_with_the_autopilots_words(autopilot):
    autopilot.reach(Phase.ARMING)
    autopilot.say(wire.MAVLink_statustext_message(4, b"battery empty"))
    autopilot.say(accepted(wire.MAV_CMD_COMPONENT_ARM_DISARM, wire.MAV_RESULT_DENIED))
    assert autopilot.endpoint.outcome is ControllerOutcome.NOT_STARTED
    assert "battery empty" in autopilot.endpoint.message


def test_temporary_rejection_is_tried_again(autopilot):
    autopilot.reach(Phase.ENTERING)
    autopilot.hear()
    autopilot.say(accepted(wire.MAV_CMD_DO_SET_MODE, wire.MAV_RESULT_TEMPORARILY_REJECTED))
    autopilot.now_us += RETRY_US
    assert "COMMAND_LONG" in autopilot.names()


def test_vehicle_of_another_rate_is_not_flown(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.say(*parameters(rate_hz=400), imu(0))
    assert autopilot.endpoint.outcome is ControllerOutcome.WRONG_RATE
    assert "400 Hz: set IMU_INTEG_RATE to 250" in autopilot.endpoint.message


@pytest.mark.parametrize(("rate_hz", "outcome"), [(250.03, None), (250.035, ControllerOutcome.WRONG_RATE)])
def test_rate_is_the_law_s_if_its_steps_are_within_half_a_microsecond(autopilot, rate_hz, outcome):
    autopilot.reach(Phase.READING)
    *others, _ = parameters()
    autopilot.say(*others, wire.MAVLink_param_value_message(b"IMU_INTEG_RATE", rate_hz, 9, 5, 4), imu(0))
    assert autopilot.endpoint.outcome is outcome


def give_up(autopilot: Autopilot, interval_us: int = 0) -> str:
    """Send samples, if an interval is given, until the controller gives up; return its reason."""
    time_us = 1_000_000
    while not autopilot.endpoint.finished:
        autopilot.hear()
        autopilot.now_us += RETRY_US
        for _ in range(RETRY_US // interval_us if interval_us else 0):
            time_us += interval_us
            autopilot.say(imu(time_us))
    return autopilot.endpoint.message


def test_samples_at_another_rate_than_asked_for_are_not_flown(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.say(accepted(INTERVAL), *parameters())
    assert give_up(autopilot, 20_000).startswith("HIGHRES_IMU arrives at 50 Hz, law 'hinf-d1' needs 250 Hz: ")
    assert autopilot.endpoint.outcome is ControllerOutcome.WRONG_RATE


def test_autopilot_that_declines_the_rate_is_named_with_its_answer(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.say(accepted(INTERVAL, wire.MAV_RESULT_DENIED), *(imu(20_000 * k) for k in range(1, 12)))
    assert autopilot.endpoint.outcome is ControllerOutcome.WRONG_RATE
    assert autopilot.endpoint.message.endswith("the answer to MAV_CMD_SET_MESSAGE_INTERVAL is MAV_RESULT_DENIED")


def test_samples_that_come_at_the_rate_are_flown_whatever_the_autopilot_says(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.say(accepted(INTERVAL, wire.MAV_RESULT_UNSUPPORTED), beat(HOLD), *parameters())
    autopilot.say(*(imu(4000 * k) for k in range(1, 12)))
    assert autopilot.endpoint.phase is Phase.ENTERING


def test_autopilot_that_comes_to_the_rate_is_flown(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.say(beat(HOLD), *parameters(), *(imu(20_000 * k) for k in range(1, 12)))
    assert autopilot.endpoint.phase is Phase.READING
    assert "SET_ACTUATOR_CONTROL_TARGET" not in autopilot.names()
    autopilot.say(*(imu(220_000 + 4000 * k) for k in range(1, 8)))
    assert autopilot.endpoint.phase is Phase.ENTERING


def test_rate_is_asked_for_until_it_is_answered(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.hear()
    autopilot.now_us += RETRY_US
    assert autopilot.names().count("COMMAND_LONG") == 1
    autopilot.say(accepted(INTERVAL))
    autopilot.now_us += RETRY_US
    assert "COMMAND_LONG" not in autopilot.names()


def test_vehicle_whose_time_stands_in_mid_flight_is_joined(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.say(beat(OFFBOARD), *parameters(), *(imu(8000) for _ in range(3)))
    assert autopilot.endpoint.phase is Phase.FLYING


def test_no_samples_are_told_so(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.say(*parameters())
    assert give_up(autopilot) == "no samples: the autopilot sends no HIGHRES_IMU on this link"
    assert autopilot.endpoint.outcome is ControllerOutcome.NOT_STARTED


def test_missing_parameters_are_named():
    autopilot = Autopilot("hinf-rates")
    autopilot.reach(Phase.READING)
    autopilot.say(*list(parameters())[-1:])
    assert give_up(autopilot, 4000) == "the autopilot does not report its parameters: MPC_THR_HOVER"


def test_autopilot_that_takes_no_torques_is_told_what_it_needs(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.say(*list(parameters())[3:])
    reason = give_up(autopilot, 4000)
    assert reason.startswith("the autopilot has no GP_TRQ_MAX_R, GP_TRQ_MAX_P, GP_TRQ_MAX_Y")
    assert reason.endswith("--law hinf-rates --via rates")


@pytest.mark.parametrize(
    ("kind", "words"),
    [(wire.MAV_AUTOPILOT_ARDUPILOTMEGA, "ArduPilot takes no torques"), (wire.MAV_AUTOPILOT_PPZ, "_PPZ is not")],
)
def test_autopilot_of_another_kind_is_refused_and_sent_no_set_point(autopilot, kind, words):
    autopilot.say(wire.MAVLink_heartbeat_message(2, kind, 209, 4, 4, 3), *parameters(), imu(0), imu(4000))
    assert autopilot.endpoint.outcome is ControllerOutcome.NOT_SUPPORTED
    assert words in autopilot.endpoint.message
    assert autopilot.names() == ["HEARTBEAT"]


def test_standing_by_sends_nothing_to_another_autopilot_than_px4(autopilot):
    autopilot.say(heartbeat_message(HOLD, False, critical=False, generic=True), *parameters())
    autopilot.say(*(imu(4000 * k) for k in range(1, 20)))
    assert autopilot.endpoint.phase is Phase.STANDING_BY
    assert "SET_ACTUATOR_CONTROL_TARGET" not in autopilot.names()
    autopilot.say(heartbeat_message(OFFBOARD, True, critical=False, generic=True), imu(80_000))
    assert "SET_ACTUATOR_CONTROL_TARGET" in autopilot.names()


def test_people_are_told_what_the_controller_does():
    told: list[str] = []
    autopilot = Autopilot()
    autopilot.endpoint = ControllerEndpoint(load_law("hinf-d1"), VEHICLE, report=told.append)
    autopilot.reach(Phase.FLYING)
    autopilot.say(beat(HOLD))
    reads = "GP_TRQ_MAX_R, GP_TRQ_MAX_P, GP_TRQ_MAX_Y, MPC_THR_HOVER, IMU_INTEG_RATE"
    assert told == [
        f"found PX4, system 3: reading {reads}, requesting HIGHRES_IMU at 250 Hz",
        "arming the vehicle",
        "requesting OFFBOARD",
        "hinf-d1 in control",
        "hinf-d1 standing by: in control once OFFBOARD is set",
    ]


@pytest.mark.parametrize(
    ("mode", "armed", "outcome"),
    [(OFFBOARD, True, None), (OFFBOARD, False, ControllerOutcome.DONE), (STABILIZED, True, None)],
)
def test_heartbeat_in_flight_tells_how_it_goes(autopilot, mode, armed, outcome):
    autopilot.reach(Phase.FLYING)
    autopilot.say(heartbeat_message(mode, armed, critical=False))
    assert autopilot.endpoint.outcome is outcome


def test_flight_that_is_landed_out_of_offboard_is_named(autopilot):
    autopilot.reach(Phase.FLYING)
    autopilot.say(beat(STABILIZED), beat(STABILIZED, armed=False))
    assert autopilot.endpoint.outcome is ControllerOutcome.MODE_LOST


def beat(mode: int, *, armed: bool = True):
    return heartbeat_message(mode, armed, critical=False)


def join(mode: int, *, armed: bool = True) -> Autopilot:
    """Find a vehicle whose time runs, in a mode."""
    autopilot = Autopilot()
    autopilot.hear()
    autopilot.say(beat(mode, armed=armed))
    autopilot.hear()
    autopilot.say(*parameters(), imu(4000), imu(8000), imu(12_000))
    return autopilot


def asked(autopilot: Autopilot, seconds: float = 60.0) -> list[int]:
    """Return the commands that the controller gives while samples go on."""
    given: list[int] = []
    for _ in range(round(5 * seconds)):
        given += [message.command for message in autopilot.hear() if message.get_type() == "COMMAND_LONG"]
        autopilot.now_us += 200_000
        autopilot.say(imu(autopilot.now_us))
    return given


@pytest.mark.parametrize("mode", [HOLD, STABILIZED])
def test_vehicle_that_a_pilot_flies_is_taken_and_not_armed(mode):
    autopilot = join(mode)
    (request,) = [message for message in autopilot.hear() if message.get_type() == "COMMAND_LONG"]
    assert (request.command, request.param2) == (MODE, 6.0)
    autopilot.say(accepted(MODE))
    assert autopilot.endpoint.phase is Phase.FLYING


@pytest.mark.parametrize(("mode", "armed"), [(HOLD, False), (TAKEOFF, True), (RETURN, True), (LAND, True)])
def test_vehicle_on_the_ground_or_on_its_way_is_stood_by(mode, armed):
    autopilot = join(mode, armed=armed)
    assert autopilot.endpoint.phase is Phase.STANDING_BY
    assert asked(autopilot) == []
    assert not autopilot.endpoint.finished


@pytest.mark.parametrize("found", [0, 12_000])
def test_taken_vehicle_gets_set_points_and_no_request_until_it_is_given_back(autopilot, found):
    if found:
        autopilot = join(HOLD)
        autopilot.hear()
        autopilot.say(accepted(MODE))
    else:
        autopilot.reach(Phase.FLYING)
    autopilot.say(beat(HOLD))
    assert autopilot.endpoint.phase is Phase.STANDING_BY
    autopilot.hear()
    autopilot.say(imu(16_000))
    assert "SET_ACTUATOR_CONTROL_TARGET" in autopilot.names()
    assert asked(autopilot) == []
    autopilot.say(beat(OFFBOARD))
    assert autopilot.endpoint.phase is Phase.FLYING
    assert not autopilot.endpoint.finished


def test_pilot_who_changes_the_mode_meanwhile_is_not_overruled():
    autopilot = join(HOLD)
    autopilot.hear()
    autopilot.say(accepted(MODE, wire.MAV_RESULT_TEMPORARILY_REJECTED), beat(LAND))
    assert autopilot.endpoint.phase is Phase.STANDING_BY
    assert asked(autopilot) == []


def test_refused_request_to_take_the_vehicle_leads_to_standing_by():
    autopilot = join(HOLD)
    autopilot.say(accepted(MODE, wire.MAV_RESULT_DENIED))
    assert autopilot.endpoint.phase is Phase.STANDING_BY


def test_piloted_vehicle_that_is_disarmed_is_not_left():
    autopilot = join(HOLD)
    autopilot.say(accepted(MODE), beat(OFFBOARD), beat(HOLD, armed=False))
    assert not autopilot.endpoint.finished
    autopilot.say(beat(OFFBOARD))
    assert autopilot.endpoint.phase is Phase.FLYING


def test_law_begins_afresh_when_the_vehicle_is_given():
    def torques(autopilot: Autopilot, *stamps: int) -> list[float]:
        autopilot.hear()
        autopilot.say(*[imu(stamp) for stamp in stamps])
        return [message.controls[0] for message in autopilot.hear() if hasattr(message, "controls")]

    autopilot = join(HOLD)
    waiting = torques(autopilot, 16_000, 20_000, 24_000)
    assert len(set(waiting)) == 1
    autopilot.say(accepted(MODE))
    flown = torques(autopilot, 28_000, 32_000, 36_000)
    autopilot.say(beat(HOLD))
    torques(autopilot, 40_000, 44_000)
    autopilot.say(beat(OFFBOARD))
    assert torques(autopilot, 48_000, 52_000, 56_000) == flown
    assert len(set(flown)) == 3


def test_people_are_told_which_law_flies():
    autopilot = join(HOLD)
    autopilot.say(accepted(MODE), beat(HOLD), beat(OFFBOARD))
    texts = [message.text for message in autopilot.hear() if message.get_type() == "STATUSTEXT"]
    assert texts == ["hinf-d1 in control", "hinf-d1 standing by", "hinf-d1 in control"]


def test_silent_autopilot_is_lost(autopilot):
    autopilot.reach(Phase.FLYING)
    autopilot.now_us += VEHICLE_TIMEOUT_US + 1
    autopilot.hear()
    assert autopilot.endpoint.outcome is ControllerOutcome.AUTOPILOT_LOST


def test_strangers_are_not_listened_to(autopilot):
    autopilot.say(heartbeat_message(OFFBOARD, True, critical=False), peer=(0, ("stranger", 1)))
    assert autopilot.endpoint.phase is Phase.SEEKING
    assert autopilot.endpoint.channel.dropped[RejectReason.OTHER_TARGET] == 1


def test_any_datagram_is_survived(autopilot):
    autopilot.reach(Phase.FLYING)
    chance = random.Random(3)
    names = ("highres_imu", "param_value", "command_ack", "statustext", "attitude")
    kinds = [getattr(wire, f"MAVLink_{name}_message") for name in names]
    for _ in range(5_000):
        kind = chance.choice(kinds)
        datagram = EncodedMessage(kind.id, chance.randbytes(kind.unpacker.size)).pack(autopilot.packer)
        cut = chance.randrange(len(datagram)) if chance.random() < 0.3 else len(datagram)
        autopilot.endpoint.receive(datagram[:cut], VEHICLE, 0)
        autopilot.endpoint.poll(0)
    assert autopilot.endpoint.channel.dropped[RejectReason.TRUNCATED] > 100


@pytest.mark.parametrize("law", ["flagship", "hinf-rates"])
def test_answers_are_the_same_at_once_one_by_one_and_signed(law):
    told = []
    for way in ("at once", "one by one", "signed"):
        autopilot = Autopilot(law, signed=way == "signed")
        autopilot.reach(Phase.FLYING)
        autopilot.say(imu(4000))
        heard = [frame for datagram, _ in autopilot.endpoint.poll(0) for frame in parse(datagram)]
        begun = autopilot.endpoint.begin_exchange()
        assert (begun is None) is (way == "signed")
        for step in range(2, 300):
            if way == "at once":
                assert begun is not None
                begun.line.put(autopilot.pack(imu(4000 * step, 0.01 * step)))
                answer_samples(NO_SOCKET, begun._replace(turns=1))
                autopilot.endpoint.end_exchange(begun, 0)
                heard += parse(begun.line.answer)
                begun = autopilot.endpoint.begin_exchange()
            else:
                autopilot.say(imu(4000 * step, 0.01 * step))
                heard += [frame for datagram, _ in autopilot.endpoint.poll(0) for frame in parse(datagram)]
        assert all(frame.is_signed is (way == "signed") for frame in heard)
        facts = [(frame.message_id, frame.system, frame.component, frame.payload) for frame in heard]
        told.append((facts, autopilot.endpoint.channel.stats(), autopilot.endpoint.channel.dropped))
    assert told[0] == told[1] == told[2]
    assert len({payload for *_, payload in told[0][0]}) > 298


@pytest.fixture
def sockets() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Yield the controller's socket, and that of its vehicle."""
    with udp.bind(0) as bound, udp.bind(0) as vehicle:
        udp.connect(bound, vehicle.getsockname())
        yield bound, vehicle


def on_wire(sockets, *messages) -> Autopilot:
    """Return an autopilot that has said one sample to a law in control, and what follows on the wire."""
    bound, vehicle = sockets
    autopilot = Autopilot(address=(0, vehicle.getsockname()))
    autopilot.reach(Phase.FLYING)
    autopilot.say(imu(4000))
    autopilot.hear()
    for message in messages:
        vehicle.sendto(autopilot.pack(message), bound.getsockname())
    return autopilot


@pytest.mark.parametrize(
    ("odd", "missed", "dropped"),
    [
        (imu(20_000), 1, None),
        (imu(12_000), 0, None),
        (imu(8_000), 0, RejectReason.STALE),
        (imu(16_000, math.nan), 0, RejectReason.NOT_FINITE),
        (heartbeat_message(OFFBOARD, True, critical=False), 0, None),
    ],
)
def test_samples_on_a_socket_are_answered_up_to_what_is_not_the_next_one(odd, missed, dropped, sockets):
    autopilot, (bound, vehicle) = on_wire(sockets, imu(8000), imu(12_000), odd), sockets
    endpoint = autopilot.endpoint
    line = endpoint.exchange(bound.fileno(), lambda: 0)
    assert line is not None
    assert (line.turns, line.left is None) == (2, False)
    stamps = [parse(vehicle.recv(2048))[0].message().time_usec for _ in range(2)]
    assert stamps == [8000, 12_000]
    received = endpoint.channel.received
    endpoint.receive(line.left[0], autopilot.address, 0)
    assert endpoint.channel.received == received + 1
    assert (endpoint.missed, endpoint.late) == (missed, 0)
    assert endpoint.channel.dropped == ({dropped: 1} if dropped else {})


def test_before_it_flies_nothing_is_exchanged(sockets):
    assert Autopilot().endpoint.exchange(sockets[0].fileno(), lambda: 0) is None


def test_without_a_datagram_nothing_is_answered_and_nothing_left(sockets):
    autopilot = on_wire(sockets)
    line = autopilot.endpoint.exchange(sockets[0].fileno(), lambda: 0)
    assert (line.turns, line.left) == (0, None)


def test_a_sample_after_a_long_wait_is_left_as_others_may_have_queued(sockets):
    begun = on_wire(sockets, imu(8000)).endpoint.begin_exchange()
    assert answer_sample(sockets[0].fileno(), begun, 0, 0) < 0
    assert parse(begun.line.left[0])[0].message().time_usec == 8000
    assert begun.line.turns == 0


def test_references_are_held_from_their_stamps_on_at_once_as_one_by_one():
    references = [
        (8000, (0.1, 0.0, 0.0)),
        (12_000, (0.2, 0.0, 0.1)),
        (12_000, (0.3, -0.1, 0.0)),
        (24_000, (0.0, 0.0, 0.0)),
    ]
    told = []
    for at_once in (True, False):
        core = ControllerCore(load_law("flagship"), (1.0, 1.0, 1.0), 0.5, references)
        core.step(4000, (0.125, 0.0, 0.0), (0.0, 0.0, -9.75))
        line = make_line(imu_template(1).buffer(), torque_template(1).buffer(), ("127.0.0.1", 1))
        for step in range(2, 9):
            if at_once:
                begun = core.begin_turns(line)
                line.begin(0, 0)
                line.put(imu_template(1).make(0, 4000 * step, 0.0, 0.0, -9.75, 0.125, 0.0, 0.0))
                answer_samples(NO_SOCKET, begun._replace(turns=1))
                core.end_turns(begun)
            else:
                core.step(4000 * step, (0.125, 0.0, 0.0), (0.0, 0.0, -9.75))
            told.append((core.fractions, core.last_sample_us))
    assert told[:7] == told[7:]


@pytest.mark.parametrize("roll_rate", [float("nan"), float("inf")])
def test_sample_that_is_not_finite_in_flight_is_counted_and_not_answered(autopilot, roll_rate):
    autopilot.reach(Phase.FLYING)
    autopilot.say(imu(4000), imu(8000))
    autopilot.hear()
    autopilot.say(imu(12_000, roll_rate))
    assert autopilot.names() == []
    assert autopilot.endpoint.channel.dropped == {RejectReason.NOT_FINITE: 1}
    autopilot.say(imu(12_000))
    assert autopilot.names() == ["SET_ACTUATOR_CONTROL_TARGET"]


def test_older_sample_in_flight_is_stale_and_from_a_stranger_is_not_flown(autopilot):
    autopilot.reach(Phase.FLYING)
    autopilot.say(imu(4000), imu(8000))
    autopilot.say(imu(12_000), peer=(0, ("stranger", 1)))
    assert autopilot.endpoint.channel.dropped == {RejectReason.OTHER_TARGET: 1}
    autopilot.say(imu(12_000), imu(16_000), imu(4000))
    assert autopilot.endpoint.channel.dropped == {RejectReason.STALE: 1, RejectReason.OTHER_TARGET: 1}
    assert autopilot.endpoint.missed == 0


def test_controller_with_a_key_reads_only_what_is_signed():
    autopilot = Autopilot(signed=True)
    autopilot.reach(Phase.FLYING)
    autopilot.packer.signing.sign_outgoing = False
    autopilot.say(imu(4000), beat(OFFBOARD, armed=False))
    assert autopilot.endpoint.channel.dropped == {RejectReason.NOT_SIGNED: 1}  # heartbeats are read without a signature
    assert autopilot.endpoint.outcome is ControllerOutcome.DONE


def test_interruption_ends_the_flight_by_its_name_and_stays_the_outcome(autopilot):
    autopilot.reach(Phase.FLYING)
    autopilot.endpoint.interrupt()
    autopilot.say(heartbeat_message(OFFBOARD, False, critical=False))
    assert (autopilot.endpoint.outcome, autopilot.endpoint.message) == (ControllerOutcome.INTERRUPTED, "interrupted")
    assert autopilot.endpoint.finished


def test_deadline_is_the_next_heartbeat_retry_or_loss_of_the_vehicle(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.hear()
    assert autopilot.endpoint.deadline_us() == RETRY_US
    autopilot.say(*parameters(), imu(0), accepted(ARM), accepted(MODE))
    assert autopilot.endpoint.phase is Phase.FLYING
    assert autopilot.endpoint.deadline_us() == 1_000_000
    for now_us in range(1_000_000, 5_000_001, 1_000_000):
        autopilot.now_us = now_us
        autopilot.hear()
    assert autopilot.endpoint.deadline_us() == VEHICLE_TIMEOUT_US + 1
    assert autopilot.endpoint.outcome is None


@pytest.mark.parametrize("phase", [Phase.ENTERING, Phase.FLYING])
def test_interruption_hands_back_once_who_was_flown_by_a_pilot_and_nobody_else(autopilot, phase):
    def requests(each: Autopilot) -> list:
        return [message for message in each.hear() if getattr(message, "command", 0) == MODE]

    piloted = join(HOLD)
    piloted.hear()
    if phase is Phase.FLYING:
        piloted.say(accepted(MODE))
    assert piloted.endpoint.phase is phase
    piloted.endpoint.interrupt()
    piloted.endpoint.interrupt()
    (request,) = [message for message in requests(piloted) if message.param3]
    assert (request.param1, request.param2, request.param3) == (1.0, 4.0, 3.0)
    autopilot.reach(phase)
    autopilot.hear()
    autopilot.endpoint.interrupt()
    assert requests(autopilot) == []


@pytest.mark.parametrize(("law", "intervals"), [("hinf-d1", {}), ("flagship", {30: 20_000.0}),
    ("hinf-rates", {30: 20_000.0, 32: 20_000.0, 245: 200_000.0})])  # fmt: skip
def test_navigation_is_requested_at_its_rates_as_far_as_the_law_needs_it(law, intervals):
    autopilot = Autopilot(law)
    autopilot.reach(Phase.READING)
    autopilot.hear()
    autopilot.say(beat(HOLD), *parameters(), imu(4000), imu(8000), imu(12_000))
    asked_for = [message for message in autopilot.hear() if getattr(message, "command", 0) == INTERVAL]
    assert {message.param1: message.param2 for message in asked_for} == intervals


@pytest.mark.parametrize(("age_us", "starts_there"), [(500_000, True), (500_001, False)])
def test_law_starts_at_an_attitude_of_half_a_second_and_level_at_an_older_one(age_us, starts_there):
    autopilot = Autopilot("hinf-rates")
    read(autopilot, mode=GUIDED)
    autopilot.now_us += age_us
    autopilot.say(landed(IN_AIR), imu(1_100_000))
    (answer,) = setpoints(autopilot)
    assert (answer.body_roll_rate < -0.5) is starts_there


@pytest.mark.parametrize(("severity", "is_told"), [(4, True), (5, False)])
def test_words_of_the_autopilot_are_told_from_a_warning_on(severity, is_told):
    told: list[str] = []
    flying_ardupilot(told).say(wire.MAVLink_statustext_message(severity, b"wind"))
    assert ("the autopilot reports: wind" in told) is is_told


def test_attitude_corrects_by_the_time_since_the_last_one():
    autopilot, told = flying_ardupilot(correct_attitude=True), []
    autopilot.endpoint._controller.correct = lambda *given: told.append(given)
    for time_ms in (1020, 1070, 1050):
        autopilot.say(wire.MAVLink_attitude_message(time_ms, 0.25, -0.5, 1.0, 0.0, 0.0, 0.0))
    assert told == [((0.25, -0.5, 1.0), step_s) for step_s in (0.02, 0.05, 0.0)]


def test_no_samples_are_missed_before_the_law_flies(autopilot):
    assert autopilot.endpoint.missed == 0


def test_unread_message_is_counted(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.say(wire.MAVLink_attitude_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert autopilot.endpoint.channel.dropped == {RejectReason.UNUSED_MESSAGE: 1}


def test_request_to_take_the_vehicle_that_is_never_answered_leads_to_standing_by():
    autopilot = join(HOLD)
    given = asked(autopilot)
    assert given == [MODE] * RETRIES
    assert autopilot.endpoint.phase is Phase.STANDING_BY
    assert not autopilot.endpoint.finished


def test_rate_that_stays_unanswered_is_asked_for_no_more_once_declined(autopilot):
    autopilot.reach(Phase.READING)
    autopilot.say(accepted(INTERVAL, wire.MAV_RESULT_TEMPORARILY_REJECTED))
    assert autopilot.names().count("COMMAND_LONG") == 1
    autopilot.now_us += RETRY_US
    assert autopilot.names().count("COMMAND_LONG") == 1
    autopilot.say(accepted(INTERVAL, wire.MAV_RESULT_DENIED))
    autopilot.now_us += RETRY_US
    assert "COMMAND_LONG" not in autopilot.names()
    autopilot.say(accepted(INTERVAL), accepted(INTERVAL, wire.MAV_RESULT_TEMPORARILY_REJECTED))  # once granted, granted
    autopilot.now_us += RETRY_US
    assert "COMMAND_LONG" not in autopilot.names()


def test_parameters_are_asked_for_by_name_and_those_known_no_more(autopilot):
    autopilot.reach(Phase.READING)
    asked_for = [message for message in autopilot.hear() if message.get_type() == "PARAM_REQUEST_READ"]
    assert {message.param_index for message in asked_for} == {-1}
    autopilot.say(*list(parameters())[:3], imu(0))
    autopilot.now_us += RETRY_US
    assert autopilot.parameters_asked_for() == ["MPC_THR_HOVER", "IMU_INTEG_RATE"]


ARDUPILOT, GUIDED, LOITER, BRAKE = wire.MAV_AUTOPILOT_ARDUPILOTMEGA, 4, 5, 17
IN_AIR = wire.MAV_LANDED_STATE_IN_AIR


def ardupilot_beat(mode: int, *, armed: bool = True):
    return wire.MAVLink_heartbeat_message(2, ARDUPILOT, 1 + 128 * armed, mode, 4, 3)


def position(time_ms: int, height: float = 10.0, v_down: float = 0.0):
    return wire.MAVLink_local_position_ned_message(time_ms, 0.0, 0.0, -height, 0.0, 0.0, v_down)


def landed(state: int):
    return wire.MAVLink_extended_sys_state_message(0, state)


def read(autopilot: Autopilot, *, mode: int, options: float = 8.0, stream=imu, interval_us: int = 4000) -> None:
    """Answer an endpoint as ArduPilot does, up to the take-over; its integers are cast."""
    autopilot.hear()
    autopilot.say(ardupilot_beat(mode))
    autopilot.hear()
    autopilot.say(
        wire.MAVLink_param_value_message(b"MOT_THST_HOVER", 0.25, 9, 2, 0),
        wire.MAVLink_param_value_message(b"GUID_OPTIONS", options, 6, 2, 1),
        *(stream(1_000_000 + interval_us * k) for k in range(12)),
        wire.MAVLink_attitude_message(1000, 0.1, -0.2, 3.0, 0.0, 0.0, 0.0),
        position(1000),
    )


def flying_ardupilot(told: list[str] | None = None, options: float = 8.0, **options_of_endpoint) -> Autopilot:
    autopilot = Autopilot("hinf-rates")
    report = (lambda _: None) if told is None else told.append
    autopilot.endpoint = ControllerEndpoint(
        load_law("hinf-rates"), VEHICLE, report=report, hold_height=True, **options_of_endpoint
    )
    read(autopilot, mode=GUIDED, options=options)
    autopilot.say(landed(IN_AIR), imu(1_100_000))
    assert autopilot.endpoint.phase is Phase.FLYING
    return autopilot


def setpoints(autopilot: Autopilot) -> list:
    return [message for message in autopilot.hear() if message.get_type() == "SET_ATTITUDE_TARGET"]


@pytest.mark.parametrize(("mode", "phase"), [(GUIDED, Phase.FLYING), (LOITER, Phase.ENTERING), (9, Phase.STANDING_BY)])
def test_ardupilot_in_the_air_is_taken_by_its_own_modes(mode, phase):
    autopilot = Autopilot("hinf-rates")
    read(autopilot, mode=mode)
    assert autopilot.endpoint.phase is Phase.READING  # whether it flies is not known yet
    autopilot.say(landed(IN_AIR), imu(1_100_000))
    assert autopilot.endpoint.phase is phase
    requests = [message.param2 for message in autopilot.hear() if getattr(message, "command", 0) == MODE]
    assert requests == ([GUIDED] if phase is Phase.ENTERING else [])


def test_ardupilot_gets_nothing_in_its_take_off_and_after_its_landing():
    autopilot = Autopilot("hinf-rates")
    read(autopilot, mode=GUIDED)
    for k, state in enumerate((wire.MAV_LANDED_STATE_TAKEOFF, IN_AIR, wire.MAV_LANDED_STATE_ON_GROUND)):
        autopilot.say(landed(state), imu(1_100_000 + 8000 * k))
        autopilot.hear()
        autopilot.say(imu(1_104_000 + 8000 * k))
        assert bool(setpoints(autopilot)) is (state == IN_AIR)


@pytest.mark.parametrize("mode", [0, LOITER, BRAKE])
def test_pilot_takes_ardupilot_by_any_mode_and_gives_it_by_guided(mode):
    autopilot = flying_ardupilot()
    autopilot.say(ardupilot_beat(mode))
    autopilot.hear()
    autopilot.say(imu(1_104_000))
    assert not setpoints(autopilot)
    autopilot.say(ardupilot_beat(20), imu(1_108_000))  # GUIDED_NOGPS
    assert len(setpoints(autopilot)) == 1


def test_raw_imu_is_requested_and_read_where_highres_imu_is_declined():
    def raw(time_us: int):
        return wire.MAVLink_raw_imu_message(time_us, 0, 0, -1000, 100, 0, 0, 0, 0, 0)

    autopilot = Autopilot("hinf-rates")
    autopilot.hear()
    autopilot.say(ardupilot_beat(GUIDED))
    autopilot.hear()
    autopilot.say(accepted(INTERVAL, wire.MAV_RESULT_FAILED))
    autopilot.now_us += RETRY_US
    wanted = [message.param1 for message in autopilot.hear() if getattr(message, "command", 0) == INTERVAL]
    assert wanted == [wire.MAVLINK_MSG_ID_RAW_IMU]
    read(autopilot, mode=GUIDED, stream=raw)
    autopilot.say(landed(IN_AIR), raw(1_100_000), raw(1_104_000))
    (_, answer) = setpoints(autopilot)
    assert answer.time_boot_ms == 1104


def test_handover_starts_at_the_attitude_of_the_autopilot():
    autopilot = flying_ardupilot()
    (answer,) = setpoints(autopilot)
    # rolled to the right, pitched down: the law turns back, and keeps the heading that it has found
    assert answer.body_roll_rate < -0.5
    assert answer.body_pitch_rate > 1.0
    assert abs(answer.body_yaw_rate) < 1e-6


def test_attitude_corrects_the_estimate_only_if_it_may():
    def commanded(heading: float, *, correct_attitude: bool) -> float:
        autopilot = flying_ardupilot(correct_attitude=correct_attitude)
        for k in range(1, 500):
            turned = wire.MAVLink_attitude_message(1000 + 20 * k, 0.0, 0.0, heading, 0.0, 0.0, 0.0)
            autopilot.say(turned, imu(1_100_000 + 4000 * k, 0.0))
            answers = setpoints(autopilot)
        return answers[-1].body_yaw_rate

    assert commanded(3.05, correct_attitude=True) < commanded(2.95, correct_attitude=True) - 0.5
    assert commanded(3.05, correct_attitude=False) == commanded(2.95, correct_attitude=False)


@pytest.mark.parametrize("estimator", [0, 1])
def test_turn_of_the_earth_is_known_where_an_estimator_has_left_it(estimator):
    autopilot = Autopilot("hinf-rates")
    autopilot.reach(Phase.READING)
    bytewise = struct.unpack("<f", struct.pack("<i", estimator))[0]
    answer = wire.MAVLink_param_value_message(b"EKF2_EN", bytewise, 6, 2, 0)
    requested = []
    for messages in ([answer], [beat(HOLD), *parameters(), imu(4000), imu(8000), imu(12_000)], [answer]):
        autopilot.say(*messages)
        requested += [message.param1 for message in autopilot.hear() if getattr(message, "command", 0) == 512]
    assert requested == [wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN] * estimator  # once it is known what flies
    autopilot.say(wire.MAVLink_gps_global_origin_message(300_000_000, 80_000_000, 0))
    earth = autopilot.endpoint._controller.earth_rate_N
    assert earth == (pytest.approx((0.75**0.5 * 7.2921e-5, 0.0, -0.5 * 7.2921e-5)) if estimator else None)


def test_thrust_holds_the_height_where_it_is_a_thrust():
    autopilot = flying_ardupilot()
    thrust = []
    for k, height in enumerate((10.0, 9.0, 11.0), start=1):
        autopilot.hear()
        autopilot.say(position(1000 + 20 * k, height), imu(1_100_000 + 4000 * k))
        thrust.append(setpoints(autopilot)[0].thrust)
    assert thrust[0] == 0.25
    assert thrust[1] > 0.3
    assert thrust[2] < 0.2


def test_thrust_is_no_climb_where_it_is_a_climb_rate():
    told: list[str] = []
    autopilot = flying_ardupilot(told, options=0.0)
    autopilot.hear()
    autopilot.say(position(1020, 5.0), imu(1_104_000))
    assert setpoints(autopilot)[0].thrust == 0.5
    assert "height: ArduPilot holds it; thrust is a climb rate until GUID_OPTIONS has bit 3" in told


def test_interruption_hands_ardupilot_back_to_stay_in_place():
    autopilot = flying_ardupilot()
    autopilot.hear()
    autopilot.endpoint.interrupt()
    (request,) = [message for message in autopilot.hear() if message.get_type() == "COMMAND_LONG"]
    assert (request.command, request.param1, request.param2) == (MODE, 1.0, BRAKE)


def test_words_of_the_autopilot_and_its_fail_safe_are_told():
    told: list[str] = []
    autopilot = flying_ardupilot(told)
    autopilot.say(
        wire.MAVLink_statustext_message(2, b"EKF variance"),
        wire.MAVLink_statustext_message(6, b"no matter"),
        wire.MAVLink_param_value_message(b"GUID_TIMEOUT", 3.0, 9, 2, 2),
    )
    assert told[-2:] == [
        "the autopilot reports: EKF variance",
        "if set-points stop, ArduPilot levels and holds its height after 3 s (GUID_TIMEOUT)",
    ]


@pytest.mark.parametrize(("action", "name"), [(5, "Hold"), (99, "unknown"), (-1, "unknown")])
def test_fail_safe_in_two_parameters_is_told_once_both_have_come(action, name):
    told: list[str] = []
    autopilot = Autopilot()
    autopilot.endpoint = ControllerEndpoint(load_law("hinf-d1"), VEHICLE, report=told.append)
    autopilot.reach(Phase.READING)
    autopilot.say(beat(HOLD), *parameters(), imu(4000), imu(8000), imu(12_000))
    before = len(told)
    bytewise = struct.unpack("<f", struct.pack("<i", action))[0]
    for value, kind, parameter in ((1.5, 9, b"COM_OF_LOSS_T"), (bytewise, 6, b"COM_OBL_RC_ACT")):
        assert len(told) == before
        autopilot.say(wire.MAVLink_param_value_message(parameter, value, kind, 2, 0))
    fail_safe = f"enters its fail-safe: {name} (COM_OBL_RC_ACT {action}) after 1.5 s (COM_OF_LOSS_T)"
    assert told[before:] == [f"if set-points stop, PX4 {fail_safe}"]


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_parameter_that_is_not_finite_counts_as_not_reported(number):
    told: list[str] = []
    autopilot = flying_ardupilot(told)
    before = list(told)
    autopilot.say(wire.MAVLink_param_value_message(b"GUID_TIMEOUT", number, 9, 2, 2))
    assert told == before
    other = Autopilot("hinf-rates")
    read(other, mode=GUIDED, options=number)
    other.now_us += RETRY_US
    assert other.parameters_asked_for() == ["GUID_OPTIONS"]


@pytest.mark.parametrize("limit", [0.0, -10.0])
def test_torque_limit_that_is_not_positive_counts_as_not_reported(autopilot, limit):
    autopilot.reach(Phase.READING)
    autopilot.hear()
    _, *others = parameters()
    autopilot.say(wire.MAVLink_param_value_message(b"GP_TRQ_MAX_R", limit, 9, 5, 0), *others, imu(0))
    autopilot.now_us += RETRY_US
    assert autopilot.parameters_asked_for() == ["GP_TRQ_MAX_R"]


def test_attitude_and_height_that_are_not_finite_are_not_flown_by():
    answers = []
    for is_told in (True, False):
        autopilot = flying_ardupilot(correct_attitude=True)
        autopilot.hear()
        if is_told:
            autopilot.say(
                wire.MAVLink_attitude_message(1020, math.nan, 0.0, 0.0, 0.0, 0.0, 0.0),
                position(1020, math.nan),
                position(1040, 10.0, math.inf),
            )
        autopilot.say(imu(1_104_000), imu(1_108_000))
        answers.append(list(map(str, setpoints(autopilot))))
    assert answers[0] == answers[1]
    assert len(answers[0]) == 2


class Failing:
    """A user's object that fails in its third step."""

    def __init__(self, failure: float | Exception) -> None:
        self._failure = failure

    def reset(self) -> None:
        self._steps = 0

    def step(self, gyro, reference, force, dt):
        self._steps += 1
        if self._steps < 3:
            return 0.1, 0.2, 0.3
        if isinstance(self._failure, Exception):
            raise self._failure
        return self._failure, 0.0, 0.0


@pytest.mark.parametrize(
    ("failure", "outcome", "words"),
    [
        (ValueError("too steep"), ControllerOutcome.RAISED, "step() raised ValueError: too steep"),
        (math.inf, ControllerOutcome.NOT_FINITE, "step() returned inf, 0, 0 N m"),
    ],
)
def test_entry_that_fails_in_flight_ends_it_by_its_name(failure, outcome, words):
    autopilot = Autopilot()
    autopilot.endpoint = ControllerEndpoint(CheckedStepper("mine", Failing(failure), dt=0.004), VEHICLE)
    autopilot.reach(Phase.FLYING)
    autopilot.say(imu(4000))
    (answer,) = [message for message in autopilot.hear() if hasattr(message, "controls")]
    assert answer.controls[:3] == pytest.approx([0.01, 0.02, 0.03])
    autopilot.say(imu(8000))
    assert autopilot.endpoint.outcome is outcome
    assert autopilot.endpoint.message.startswith(f"controller 'mine': {words}")
    assert autopilot.endpoint.failure is not None
    assert autopilot.endpoint.failure.fault is StepFault(outcome.value)
    assert "SET_ACTUATOR_CONTROL_TARGET" not in autopilot.names()


@pytest.mark.parametrize(
    ("law", "option", "words"),
    [
        ("hinf-rates", "hold_height", "LOCAL_POSITION_NED; --height free needs no height"),
        ("flagship", "correct_attitude", "ATTITUDE; --attitude own starts level without it"),
    ],
)
def test_what_is_missing_is_told_with_the_way_out(law, option, words):
    autopilot = Autopilot()
    autopilot.endpoint = ControllerEndpoint(load_law(law), VEHICLE, **{option: True})
    autopilot.reach(Phase.READING)
    autopilot.say(accepted(INTERVAL), *parameters())
    assert give_up(autopilot, 4000) == f"the autopilot does not send {words}"


@pytest.mark.parametrize("law", ["flagship", "hinf-scheduled", "aided", "pid-fair"])
def test_torque_law_takes_over_only_with_attitude_and_starts_at_it(law):
    autopilot = Autopilot()
    autopilot.endpoint = ControllerEndpoint(load_law(law), VEHICLE, correct_attitude=True)
    autopilot.reach(Phase.READING)
    autopilot.say(beat(HOLD), *parameters(), accepted(INTERVAL), *(imu(4000 * k, 0.0) for k in range(1, 12)))
    assert autopilot.endpoint.phase is Phase.READING
    autopilot.now_us += RETRY_US
    assert wire.MAVLINK_MSG_ID_ATTITUDE in [
        message.param1 for message in autopilot.hear() if hasattr(message, "param1")
    ]
    autopilot.say(wire.MAVLink_attitude_message(44, 0.17, -0.1, 3.0, 0.0, 0.0, 0.0), imu(48_000, 0.0))
    autopilot.say(accepted(MODE))
    assert autopilot.endpoint.phase is Phase.FLYING
    autopilot.hear()
    autopilot.say(imu(52_000, 0.0))
    (answer,) = [message for message in autopilot.hear() if hasattr(message, "controls")]
    assert answer.controls[0] < -0.05  # rolled to the right, pitched down: it turns back and keeps its heading
    assert answer.controls[1] > 0.03
    assert abs(answer.controls[2]) < 0.2  # to turn north it would take all there is


def test_law_without_an_estimate_tells_what_it_holds_as_level():
    told: list[str] = []
    autopilot = Autopilot()
    autopilot.endpoint = ControllerEndpoint(load_law("hinf-d1"), VEHICLE, report=told.append, correct_attitude=True)
    autopilot.reach(Phase.READING)
    autopilot.say(beat(HOLD), *parameters(), imu(4000), imu(8000), imu(12_000))
    assert autopilot.endpoint.phase is Phase.ENTERING
    assert (
        "attitude: law 'hinf-d1' has no estimate that could start at ATTITUDE: "
        "it holds as level the attitude in which it takes over"
    ) in told


def test_another_vehicle_on_the_link_is_not_listened_to(autopilot):
    autopilot.reach(Phase.READING)
    other = wire.MAVLink(None, 9, 1)
    autopilot.endpoint.receive(heartbeat_message(OFFBOARD, True, critical=False).pack(other), VEHICLE, 0)
    assert autopilot.endpoint.channel.dropped == {RejectReason.OTHER_TARGET: 1}


def test_recorder_ends_the_flight_and_hands_the_vehicle_back():
    seen: list[int] = []
    autopilot = flying_ardupilot(recorder=lambda sample, _: seen.append(sample.time_us) or len(seen) == 3)
    autopilot.say(imu(1_104_000), imu(1_108_000))
    assert autopilot.endpoint.outcome is ControllerOutcome.DONE
    assert seen == [1_100_000, 1_104_000, 1_108_000]
    assert [message.param2 for message in autopilot.hear() if getattr(message, "command", 0) == MODE] == [BRAKE]
    seen.clear()
    autopilot = flying_ardupilot(recorder=lambda sample, _: seen.append(sample.time_us))
    autopilot.endpoint._enter(Phase.STANDING_BY)  # another flies: that is no record of the law
    autopilot.say(imu(1_104_000))
    assert (seen, autopilot.endpoint.outcome) == ([1_100_000], None)
