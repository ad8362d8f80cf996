"""The pilot of a guest, on a clock of the test: what it asks for, and what it makes of the answers."""

import math
from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.guest.dialect import Dialect
from firmware_model.guest.pilot import Estimate, Pilot, describe_refusals, quote_last_texts
from firmware_model.guest.px4 import SimulatorLink
from firmware_model.guest.read_back import ParameterReader
from firmware_model.mavlink.frames import Address, Frame, Message, RejectReason, parse
from firmware_model.types import AttitudeTarget

GUEST: Address = (0, ("127.0.0.1", 18570))
INSIDE = Dialect(12, "its law", (4.0, 11.0), 77, array_name="law", law_switch=(176.0, 1.0, 7.0))
LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture
def pilot() -> Pilot:
    made = Pilot(INSIDE, ParameterReader({"KNOWN": "1", "UNKNOWN": "1"}))
    made.meet(1, 18570)
    return made


def say(pilot: Pilot, *messages: Message, system: int = 1) -> None:
    for message in messages:
        pilot.receive(message.pack(wire.MAVLink(None, system, 1)), GUEST, 0)


def sent(pilot: Pilot, now_us: int) -> Iterator[Message]:
    for datagram, address in pilot.poll(now_us):
        assert address == GUEST
        for frame in parse(datagram):
            assert isinstance(frame, Frame)
            yield frame.message()


def beat(*, mode: int = 0, armed: bool = False) -> Message:
    return wire.MAVLink_heartbeat_message(2, 12, 1 + 128 * armed, mode, 4, 3)


def asked(pilot: Pilot, now_us: int) -> list[int]:
    return [message.command for message in sent(pilot, now_us) if message.get_type() == "COMMAND_LONG"]


def test_mode_arming_and_law_are_asked_for_in_turn_until_they_are_there(pilot: Pilot) -> None:
    assert asked(pilot, 0) == []  # before the guest has spoken
    say(pilot, beat())
    assert asked(pilot, 1) == [512, 511, 511]
    assert asked(pilot, 2) == []  # not before the next try
    say(pilot, wire.MAVLink_attitude_quaternion_message(0, *LEVEL, 0.0, 0.0, 0.0))
    say(
        pilot,
        wire.MAVLink_autopilot_version_message(0, 1 << 24 | 16 << 16, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0),
    )
    pilot.wants_flight = pilot.wants_law = True
    assert asked(pilot, 500_001) == [176, 176]
    say(pilot, beat(mode=77))
    assert asked(pilot, 1_000_001) == [400, 176]
    say(pilot, beat(mode=77, armed=True))
    pilot.wants_law = False
    assert asked(pilot, 1_500_001) == []
    assert pilot.is_in_mode
    assert pilot.is_armed


def test_parameter_without_an_answer_to_three_requests_is_unknown(pilot: Pilot) -> None:
    say(pilot, beat())
    requests = []
    for turn in range(5):
        names = [message.param_id for message in sent(pilot, 250_000 * turn) if hasattr(message, "param_id")]
        requests.append(names)
        say(pilot, wire.MAVLink_param_value_message(b"KNOWN", 1.0, 9, 2, 0))
    assert requests == [["KNOWN", "UNKNOWN"], ["UNKNOWN"], ["UNKNOWN"], [], []]
    assert pilot.reader.unknown == ["UNKNOWN"]


@pytest.mark.parametrize(
    ("digits", "told"),
    [
        ([0] * 8, "4.6.1"),
        ([0, 0, 0, 0, 0, 0xEF, 0xCD, 0xAB], "4.6.1 (abcdef)"),
        (list(b"abcd1234"), "4.6.1 (abcd1234)"),
    ],
)
def test_version_has_its_hash_as_either_autopilot_writes_it(pilot: Pilot, digits: list[int], told: str) -> None:
    number = 4 << 24 | 6 << 16 | 1 << 8
    zeros = [0] * 8
    say(pilot, wire.MAVLink_autopilot_version_message(0, number, 0, 0, 0, digits, zeros, zeros, 0, 0, 0))
    assert pilot.version == told


def test_refused_commands_and_last_words_are_told_once(pilot: Pilot) -> None:
    assert describe_refusals(pilot) == "it gave no reason"
    assert quote_last_texts(pilot) == "it said last: nothing"
    for text in (b"no fix", b"no fix", b"not level"):
        say(pilot, wire.MAVLink_statustext_message(3, text))
    say(pilot, wire.MAVLink_command_ack_message(400, 4), wire.MAVLink_command_ack_message(176, 2))
    say(pilot, wire.MAVLink_command_ack_message(176, 5))  # in progress: refused no more
    assert describe_refusals(pilot) == "no fix; not level; MAV_CMD_COMPONENT_ARM_DISARM: MAV_RESULT_FAILED"
    assert quote_last_texts(pilot) == "it said last: no fix; not level"


def test_estimates_hold_the_set_point_that_was_told_before(pilot: Pilot) -> None:
    told = wire.MAVLink_attitude_quaternion_message(20, *LEVEL, 0.0, 0.0, 0.0)
    say(pilot, told, wire.MAVLink_attitude_target_message(20, 0, [0.0, 1.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5), told)
    first, second = pilot.take_estimates()
    assert first[:2] == (20_000, LEVEL)
    assert all(map(math.isnan, first.setpoint_q_NB))
    assert second == Estimate(20_000, LEVEL, (0.0, 1.0, 0.0, 0.0))
    assert pilot.take_estimates() == []


def test_target_goes_to_the_law_inside_as_an_array(pilot: Pilot) -> None:
    pilot.target = AttitudeTarget(0, LEVEL, None, 0.25)
    assert pilot.deadline_us() == 20_000
    _, array = sent(pilot, 40_000)
    assert (array.time_usec, array.name, array.data[:6]) == (40_000, "law", [*LEVEL, 0.25, 0.0])
    assert pilot.deadline_us() == 60_000


def test_target_goes_to_the_loops_of_a_guest_as_a_set_point() -> None:
    pilot = Pilot(INSIDE._replace(array_name=""))
    pilot.meet(1, 18570)
    pilot.target = AttitudeTarget(0, LEVEL, None, 0.25)
    _, target = sent(pilot, 40_000)
    assert target.get_type() == "SET_ATTITUDE_TARGET"
    assert (target.time_boot_ms, target.q, target.thrust, target.target_system) == (40, [*LEVEL], 0.25, 1)


def test_only_the_guest_is_heard_and_what_is_no_frame_is_counted() -> None:
    pilot = Pilot(INSIDE)
    pilot.meet(1, None)
    assert pilot.poll(0) == []  # it speaks first
    pilot.receive(b"noise", GUEST, 0)
    assert pilot.channel.dropped[RejectReason.NOT_MAVLINK] == 1
    say(pilot, beat(), system=9)
    say(pilot, wire.MAVLink_system_time_message(0, 0))
    assert pilot.autopilot is None
    assert [message.get_type() for message in sent(pilot, 0)] == ["HEARTBEAT"]


def test_simulator_link_takes_frames_out_of_noise_and_halves() -> None:
    link, packer = SimulatorLink(), wire.MAVLink(None, 1, 1)
    answer = wire.MAVLink_hil_actuator_controls_message(8000, [0.5] * 16, 128, 1).pack(packer)
    damaged = answer[:-1] + bytes([answer[-1] ^ 1])
    other = wire.MAVLink_system_time_message(0, 1).pack(packer)
    stream = b"ab" + damaged + other + beat().pack(packer) + answer
    link.feed(stream[:-1])
    assert (link.answer, link.autopilot) == (None, 12)
    link.feed(stream[-1:])
    assert link.answer is not None
    assert (link.answer.time_us, link.answer.controls, link.answer.is_armed) == (8000, (0.5,) * 16, True)
    assert link.answer.is_lockstep


def test_ping_follows_a_set_point_and_its_own_echo_is_awaited(pilot: Pilot) -> None:
    pilot.target, pilot.wants_echo = AttitudeTarget(0, LEVEL, None, 0.5), True
    assert [message.get_type() for message in sent(pilot, 20_000)][-2:] == ["DEBUG_FLOAT_ARRAY", "PING"]
    for target, time_us in ((0, 20_000), (245, 0), (245, 20_000)):  # of the guest, of another set-point, of this one
        assert pilot.awaits_echo
        say(pilot, wire.MAVLink_ping_message(time_us, 0, target, 191))
    assert not pilot.awaits_echo
    pilot.wants_echo = False
    assert "PING" not in [message.get_type() for message in sent(pilot, 40_000)]
    assert not pilot.awaits_echo
