"""Storage on board: lists are empty, uploads and file operations are refused at once."""

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.services import storage

OPEN = bytes([0xFF, 0xFF, 198, 4, 3, 0, 0, 0, 0, 0, 0, 0]) + b"a.b"
"""Sequence 65535, session 198, open for reading, three bytes of data: the name."""


def test_operation_is_refused_as_unknown_with_the_next_sequence_number(craft, ask):
    request = wire.MAVLink_file_transfer_protocol_message(0, 1, 1, OPEN.ljust(251, b"\0"))
    (answer,) = ask(storage.make_service(craft), request)
    assert (answer.target_system, answer.target_component) == (255, 190)
    assert bytes(answer.payload) == bytes([0, 0, 198, 129, 1, 4, 0, 0, 0, 0, 0, 0, 7]).ljust(251, b"\0")


@pytest.mark.parametrize(("asked", "answered"), [(0, 1), (255, 256), (4660, 4661), (65_534, 65_535)])
def test_answer_has_the_number_after_the_question(craft, ask, asked, answered):
    payload = (asked.to_bytes(2, "little") + OPEN[2:]).ljust(251, b"\0")
    (answer,) = ask(storage.make_service(craft), wire.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
    assert int.from_bytes(bytes(answer.payload)[:2], "little") == answered


@pytest.mark.parametrize("operation", [128, 129])
def test_answer_is_not_answered(craft, ask, operation):
    payload = (OPEN[:3] + bytes([operation])).ljust(251, b"\0")
    assert ask(storage.make_service(craft), wire.MAVLink_file_transfer_protocol_message(0, 1, 1, payload)) == []


@pytest.fixture
def service(craft):
    return storage.make_service(craft)


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_every_list_is_empty(service, ask, kind):
    (count,) = ask(service, wire.MAVLink_mission_request_list_message(1, 1, kind))
    assert (count.get_type(), count.count, count.mission_type) == ("MISSION_COUNT", 0, kind)
    assert (count.target_system, count.target_component) == (255, 190)


@pytest.mark.parametrize(
    ("message", "result"),
    [
        (wire.MAVLink_mission_count_message(1, 1, 5, 0), wire.MAV_MISSION_UNSUPPORTED),
        (wire.MAVLink_mission_count_message(1, 1, 0, 1), wire.MAV_MISSION_ACCEPTED),
        (wire.MAVLink_mission_clear_all_message(1, 1, 255), wire.MAV_MISSION_ACCEPTED),
        (wire.MAVLink_mission_request_int_message(1, 1, 0, 0), wire.MAV_MISSION_INVALID_SEQUENCE),
        (wire.MAVLink_mission_request_list_message(1, 1, 7), wire.MAV_MISSION_UNSUPPORTED),
        (wire.MAVLink_mission_item_int_message(1, 1, 0, 6, 16, 2, 1, 0, 0, 0, 0, 0, 0, 9, 0), 3),
    ],
)
def test_items_are_neither_taken_nor_given(service, ask, message, result):
    (answer,) = ask(service, message)
    assert (answer.get_type(), answer.type, answer.mission_type) == ("MISSION_ACK", result, message.mission_type)
