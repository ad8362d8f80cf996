"""Files on board: every operation is refused at once, by sequence number and reason."""

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.services import files

OPEN = bytes([0xFF, 0xFF, 198, 4, 3, 0, 0, 0, 0, 0, 0, 0]) + b"a.b"
"""Sequence 65535, session 198, open for reading, three bytes of data: the name."""


def test_operation_is_refused_as_unknown_with_the_next_sequence_number(craft, ask):
    request = wire.MAVLink_file_transfer_protocol_message(0, 1, 1, OPEN.ljust(251, b"\0"))
    (answer,) = ask(files.make_service(craft), request)
    assert (answer.target_system, answer.target_component) == (255, 190)
    assert bytes(answer.payload) == bytes([0, 0, 198, 129, 1, 4, 0, 0, 0, 0, 0, 0, 7]).ljust(251, b"\0")


@pytest.mark.parametrize(("asked", "answered"), [(0, 1), (255, 256), (4660, 4661), (65_534, 65_535)])
def test_answer_has_the_number_after_the_question(craft, ask, asked, answered):
    payload = (asked.to_bytes(2, "little") + OPEN[2:]).ljust(251, b"\0")
    (answer,) = ask(files.make_service(craft), wire.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
    assert int.from_bytes(bytes(answer.payload)[:2], "little") == answered


@pytest.mark.parametrize("operation", [128, 129])
def test_answer_is_not_answered(craft, ask, operation):
    payload = (OPEN[:3] + bytes([operation])).ljust(251, b"\0")
    assert ask(files.make_service(craft), wire.MAVLink_file_transfer_protocol_message(0, 1, 1, payload)) == []
