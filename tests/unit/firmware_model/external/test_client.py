"""The client of an autopilot, on a clock of the test: what it asks for, and what it makes of the answers."""

import math
from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.external.client import Estimate, ExternalClient, describe_refusals, quote_last_texts
from firmware_model.external.dialect import Dialect
from firmware_model.external.px4 import SimulatorLink
from firmware_model.external.read_back import ParameterReader
from firmware_model.external.readings import Readings
from firmware_model.mavlink.frames import Address, Frame, Message, RejectReason, parse
from firmware_model.types import AttitudeTarget

EXTERNAL: Address = (0, ("127.0.0.1", 18570))
INSIDE = Dialect(12, "its law", (4.0, 11.0), 77, array_name="law", law_switch=(176.0, 1.0, 7.0))
LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture
def client() -> ExternalClient:
    made = ExternalClient(INSIDE, ParameterReader({"KNOWN": "1", "UNKNOWN": "1"}))
    made.meet(1, 18570)
    return made


def say(client: ExternalClient, *messages: Message, system: int = 1) -> None:
    for message in messages:
        client.receive(message.pack(wire.MAVLink(None, system, 1)), EXTERNAL, 0)


def sent(client: ExternalClient, now_us: int) -> Iterator[Message]:
    for datagram, address in client.poll(now_us):
        assert address == EXTERNAL
        for frame in parse(datagram):
            assert isinstance(frame, Frame)
            yield frame.message()


def beat(*, mode: int = 0, armed: bool = False) -> Message:
    return wire.MAVLink_heartbeat_message(2, 12, 1 + 128 * armed, mode, 4, 3)


def asked(client: ExternalClient, now_us: int) -> list[int]:
    return [message.command for message in sent(client, now_us) if message.get_type() == "COMMAND_LONG"]


def test_mode_arming_and_law_are_asked_for_in_turn_until_they_are_there(client: ExternalClient) -> None:
    assert asked(client, 0) == []  # before the autopilot has spoken
    say(client, beat())
    assert asked(client, 1) == [512, 511, 511, 511]
    assert asked(client, 2) == []  # not before the next try
    say(client, wire.MAVLink_attitude_quaternion_message(0, *LEVEL, 0.0, 0.0, 0.0))
    say(
        client,
        wire.MAVLink_autopilot_version_message(0, 1 << 24 | 16 << 16, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0),
    )
    client.wants_flight = client.wants_law = True
    assert asked(client, 500_001) == [176, 176]
    say(client, beat(mode=77))
    assert asked(client, 1_000_001) == [400, 176]
    say(client, beat(mode=77, armed=True))
    client.wants_law = False
    assert asked(client, 1_500_001) == []
    assert client.is_in_mode
    assert client.is_armed


def test_parameter_without_an_answer_to_three_requests_is_unknown(client: ExternalClient) -> None:
    say(client, beat())
    requests = []
    for turn in range(5):
        names = [message.param_id for message in sent(client, 250_000 * turn) if hasattr(message, "param_id")]
        requests.append(names)
        say(client, wire.MAVLink_param_value_message(b"KNOWN", 1.0, 9, 2, 0))
    assert requests == [["KNOWN", "UNKNOWN"], ["UNKNOWN"], ["UNKNOWN"], [], []]
    assert client.reader.unknown == ["UNKNOWN"]


@pytest.mark.parametrize(
    ("digits", "told"),
    [
        ([0] * 8, "4.6.1"),
        ([0, 0, 0, 0, 0, 0xEF, 0xCD, 0xAB], "4.6.1 (abcdef)"),
        (list(b"abcd1234"), "4.6.1 (abcd1234)"),
    ],
)
def test_version_has_its_hash_as_either_autopilot_writes_it(
    client: ExternalClient, digits: list[int], told: str
) -> None:
    number = 4 << 24 | 6 << 16 | 1 << 8
    zeros = [0] * 8
    say(client, wire.MAVLink_autopilot_version_message(0, number, 0, 0, 0, digits, zeros, zeros, 0, 0, 0))
    assert client.version == told


def test_refused_commands_and_last_words_are_told_once(client: ExternalClient) -> None:
    assert describe_refusals(client) == "it gave no reason"
    assert quote_last_texts(client) == "it said last: nothing"
    for text in (b"no fix", b"no fix", b"not level"):
        say(client, wire.MAVLink_statustext_message(3, text))
    say(client, wire.MAVLink_command_ack_message(400, 4), wire.MAVLink_command_ack_message(176, 2))
    say(client, wire.MAVLink_command_ack_message(176, 5))  # in progress: refused no more
    assert describe_refusals(client) == "no fix; not level; MAV_CMD_COMPONENT_ARM_DISARM: MAV_RESULT_FAILED"
    assert quote_last_texts(client) == "it said last: no fix; not level"


def test_estimates_hold_the_set_point_that_was_told_before(client: ExternalClient) -> None:
    told = wire.MAVLink_attitude_quaternion_message(20, *LEVEL, 0.0, 0.0, 0.0)
    say(client, told, wire.MAVLink_attitude_target_message(20, 0, [0.0, 1.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5), told)
    first, second = client.take_estimates()
    assert first[:2] == (20_000, LEVEL)
    assert all(map(math.isnan, first.setpoint_q_NB))
    assert second[:3] == Estimate(20_000, LEVEL, (0.0, 1.0, 0.0, 0.0))[:3]
    assert client.take_estimates() == []


@pytest.mark.parametrize(
    ("told", "blows_N"),
    [
        (wire.MAVLink_wind_cov_message(20, 3.0, -4.0, 0.0, 1.0, 0.0, 50.0, 0.0, 0.0), (3.0, -4.0, 0.0)),
        (wire.MAVLink_wind_message(90.0, math.hypot(4.0, 3.0), 3.0), (0.0, -4.0, 3.0)),  # from the east
    ],
)
def test_winds_of_either_autopilot_blow_toward(
    client: ExternalClient, told: Message, blows_N: tuple[float, ...]
) -> None:
    attitude = wire.MAVLink_attitude_quaternion_message(20, *LEVEL, 0.0, 0.0, 0.0)
    say(client, attitude, told, attitude)
    first, second = client.take_estimates()
    assert all(map(math.isnan, first.told_wind_N))
    assert second.told_wind_N == pytest.approx(blows_N, abs=1e-6)


def test_target_goes_to_the_law_inside_as_an_array(client: ExternalClient) -> None:
    client.target = AttitudeTarget(0, LEVEL, None, 0.25)
    assert client.deadline_us() == 20_000
    _, array = sent(client, 40_000)
    assert (array.time_usec, array.name, array.data[:6]) == (40_000, "law", [*LEVEL, 0.25, 0.0])
    assert client.deadline_us() == 60_000


def test_target_goes_to_its_own_loops_as_a_set_point() -> None:
    client = ExternalClient(INSIDE._replace(array_name=""))
    client.meet(1, 18570)
    client.target = AttitudeTarget(0, LEVEL, None, 0.25)
    _, target = sent(client, 40_000)
    assert target.get_type() == "SET_ATTITUDE_TARGET"
    assert (target.time_boot_ms, target.q, target.thrust, target.target_system) == (40, [*LEVEL], 0.25, 1)


def test_only_the_autopilot_is_heard_and_what_is_no_frame_is_counted() -> None:
    client = ExternalClient(INSIDE)
    client.meet(1, None)
    assert client.poll(0) == []  # it speaks first
    client.receive(b"noise", EXTERNAL, 0)
    assert client.channel.dropped[RejectReason.NOT_MAVLINK] == 1
    say(client, beat(), system=9)
    say(client, wire.MAVLink_system_time_message(0, 0))
    assert client.autopilot is None
    assert [message.get_type() for message in sent(client, 0)] == ["HEARTBEAT"]


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


def test_ping_follows_a_set_point_and_its_own_echo_is_awaited(client: ExternalClient) -> None:
    client.target, client.wants_echo = AttitudeTarget(0, LEVEL, None, 0.5), True
    assert [message.get_type() for message in sent(client, 20_000)][-2:] == ["DEBUG_FLOAT_ARRAY", "PING"]
    for target, time_us in (
        (0, 20_000),
        (245, 0),
        (245, 20_000),
    ):  # of the autopilot, of another set-point, of this one
        assert client.awaits_echo
        say(client, wire.MAVLink_ping_message(time_us, 0, target, 191))
    assert not client.awaits_echo
    client.wants_echo = False
    assert "PING" not in [message.get_type() for message in sent(client, 40_000)]
    assert not client.awaits_echo


def test_parameter_set_in_flight_is_sent_until_it_is_told_back_or_unknown(client: ExternalClient) -> None:
    say(client, beat(armed=True))
    client.set_parameters({"SIM_GPS1_ENABLE": 0.0, "SIM_GPS_DISABLE": 1.0})
    found = []
    for turn in range(7):
        found.append([m.param_id for m in sent(client, 20_000 * turn) if m.get_type() == "PARAM_SET"])
        say(client, wire.MAVLink_param_value_message(b"SIM_GPS1_ENABLE", 0.0, 9, 1, 0))
    assert found == [["SIM_GPS1_ENABLE", "SIM_GPS_DISABLE"], *[["SIM_GPS_DISABLE"]] * 4, [], []]


@pytest.mark.parametrize(("has_fix", "told"), [(True, (3, 12)), (False, (0, 0))])
def test_px4_is_told_whether_its_receiver_has_a_fix(has_fix: bool, told: tuple[int, int]) -> None:
    zeros = (0.0, 0.0, 0.0)
    readings = Readings(0, zeros, zeros, zeros, 1013.25, 15.0, *[zeros] * 4, LEVEL, zeros, zeros, has_fix)
    frames = [item.message() for item in parse(SimulatorLink().pack(readings)) if isinstance(item, Frame)]
    (gps,) = [message for message in frames if message.get_type() == "HIL_GPS"]
    assert (gps.fix_type, gps.satellites_visible) == told
