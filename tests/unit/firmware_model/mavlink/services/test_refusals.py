import math

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import RejectReason, parse
from firmware_model.mavlink.services import refusals

ALL = 0o7777


def received(message):
    """Return the message as its receiver decodes it."""
    (frame,) = parse(message.pack(wire.MAVLink(None, 255, 190)))
    return frame.message()


@pytest.fixture
def service(craft):
    return refusals.make_service(craft)


def local(given: int):
    return wire.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, ALL & ~given, *[math.nan] * 11)


def everywhere(given: int):
    return wire.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, ALL & ~given, 0, 0, *[0.0] * 9)


STICKS = wire.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0)
CHANNELS = wire.MAVLink_rc_channels_override_message(1, 1, *[1500] * 8)


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (local(0o7), "position set-points rejected: send attitude"),
        (local(0o77), "position set-points rejected: send attitude"),
        (local(0o70), "velocity set-points rejected: send attitude"),
        (local(0o400), "acceleration set-points rejected: send attitude"),
        (local(0o2000), "yaw set-points rejected: send attitude"),
        (everywhere(0o7), "position set-points rejected: send attitude"),
        (STICKS, "sticks not supported: use OFFBOARD"),
        (CHANNELS, "sticks not supported: use OFFBOARD"),
        (
            wire.MAVLink_gimbal_manager_set_pitchyaw_message(1, 1, 0, 0, 0.1, 0.0, 0.0, 0.0),
            "this vehicle has no gimbal",
        ),
        (wire.MAVLink_param_ext_request_read_message(1, 1, b"A", -1), "no extended parameters: use PARAM_*"),
        (wire.MAVLink_param_ext_request_list_message(1, 1), "no extended parameters: use PARAM_*"),
        (wire.MAVLink_log_request_data_message(1, 1, 0, 0, 90), "no log on board: see the flight's recording"),
        (wire.MAVLink_log_erase_message(1, 1), "no log on board: nothing to erase"),
        (wire.MAVLink_mission_set_current_message(1, 1, 0), "no mission on board"),
        (wire.MAVLink_setup_signing_message(1, 1, bytes(32), 1), "key not taken: start with --signing-key"),
        (
            wire.MAVLink_serial_control_message(10, 6, 0, 0, 3, [104, 101, 108] + [0] * 67),
            "this vehicle has no serial port, and no shell",
        ),
        (
            wire.MAVLink_follow_target_message(0, 0, 1, 0, 0, [0] * 3, [0] * 3, [1, 0, 0, 0], [0] * 3, [0] * 3, 0),
            "follow-me not supported",
        ),
    ],
)
def test_refusals_name_what_was_asked_for(service, craft, message, text, heard):
    assert heard(service, message) is RejectReason.REFUSED
    assert craft.texts == [text]


@pytest.mark.parametrize("bit", range(12))
def test_refusals_name_a_quantity_by_any_of_its_bits(service, craft, heard, bit):
    heard(service, local(1 << bit))
    name = ("position", "velocity", "acceleration", "yaw")[bit // 3]
    assert craft.texts == [f"{name} set-points rejected: send attitude"]


def test_refusals_of_two_kinds_do_not_wait_for_each_other(service, craft, heard):
    heard(service, local(0o7))
    heard(service, local(0o70))
    heard(service, wire.MAVLink_log_request_data_message(1, 1, 0, 0, 90))
    heard(service, wire.MAVLink_log_erase_message(1, 1))
    assert len(craft.texts) == 4


def test_refusals_acknowledge_an_extended_value_as_failed(service, craft, ask):
    (ack,) = ask(service, wire.MAVLink_param_ext_set_message(1, 1, b"COM_OF_LOSS_T", b"2.5", 11))
    assert (ack.param_id, ack.param_result) == ("COM_OF_LOSS_T", wire.PARAM_ACK_FAILED)
    assert craft.parameters["COM_OF_LOSS_T"] == 1.0


def test_refusals_answer_a_new_origin_by_the_one_that_holds(service, craft, ask):
    (origin,) = ask(service, wire.MAVLink_set_gps_global_origin_message(1, 470_000_000, 80_000_000, 0))
    assert (origin.latitude, origin.longitude, origin.altitude) == (473_977_420, 85_455_940, 488_000)
    assert craft.texts == ["origin is fixed: request ignored"]


@pytest.mark.parametrize("message", [STICKS, CHANNELS])
def test_refusals_note_who_moves_sticks(service, peer, heard, message):
    heard(service, message)
    assert peer.moves_sticks


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (wire.MAVLink_set_home_position_message(1, 0, 0, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0), "SET_HOME_POSITION"),
        (wire.MAVLink_camera_trigger_message(0, 0), None),  # to nobody
        (wire.MAVLink_fence_fetch_point_message(2, 1, 0), None),  # to another system
        (wire.MAVLink_fence_fetch_point_message(1, 100, 0), None),  # to a camera
        (wire.MAVLink_fence_fetch_point_message(1, 1, 0), "FENCE_FETCH_POINT"),
        (wire.MAVLink_mission_ack_message(1, 1, 0), None),  # an answer
        (wire.MAVLink_log_request_end_message(1, 1), None),
    ],
)
def test_unread_message_to_this_autopilot_is_refused_by_its_name(craft, message, text):
    why = refusals.refuse_unread(received(message), craft)
    assert (why is RejectReason.REFUSED) is bool(text)
    assert craft.texts == ([f"{text} not supported"] if text else [])


@pytest.mark.slow
@pytest.mark.parametrize("kind", wire.mavlink_map.values())
def test_refusal_of_any_message_fits_a_statustext(any_craft, kind):
    message = Addressed(kind.msgname, kind.id)
    assert refusals.refuse_unread(message, any_craft) in (RejectReason.REFUSED, RejectReason.UNUSED_MESSAGE)


class Addressed:
    target_system = target_component = 1

    def __init__(self, name: str, number: int) -> None:
        self.name, self.number = name, number

    def get_type(self) -> str:
        return self.name

    def get_msgId(self) -> int:
        return self.number
