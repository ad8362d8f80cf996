import random

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import EncodedMessage, Frame, RejectReason, parse, split_stream
from firmware_model.mavlink.messages import torque_template

HEARTBEAT = wire.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3)


def packed(message=HEARTBEAT, **sender) -> bytes:
    return message.pack(wire.MAVLink(None, sender.get("system", 1), sender.get("component", 1)))


def test_frame_of_each_version_is_read():
    old = HEARTBEAT.pack(wire.MAVLink(None, 7, 8), force_mavlink1=True)
    for datagram in (old, packed(system=7, component=8)):
        (frame,) = parse(datagram)
        assert (frame.message_id, frame.system, frame.component) == (0, 7, 8)
        assert frame.message().autopilot == 12


def test_several_frames_in_one_datagram_are_all_read():
    assert [item.message_id for item in parse(packed() * 3)] == [0, 0, 0]


def test_outgoing_payload_makes_the_frame_that_pymavlink_makes():
    message = wire.MAVLink_attitude_message(4, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0)
    payload = wire.MAVLink_attitude_message.unpacker.pack(4, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0)
    packer = wire.MAVLink(None, 3, 4)
    packer.seq = 77
    assert EncodedMessage(30, payload).pack(packer) == message.pack(packer)


def test_trailing_zeros_that_were_not_sent_are_filled_in():
    (frame,) = parse(packed(wire.MAVLink_attitude_message(4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    assert frame.payload == b"\x04" + bytes(27)


def test_signed_frame_is_read():
    signing = wire.MAVLink(None, 1, 1)
    signing.signing.secret_key, signing.signing.sign_outgoing = bytes(32), True
    (frame,) = parse(HEARTBEAT.pack(signing))
    assert frame.message_id == 0


def damaged(datagram: bytes, at: int, value: int) -> bytes:
    return datagram[:at] + bytes([value]) + datagram[at + 1 :]


@pytest.mark.parametrize(
    ("datagram", "cause"),
    [
        (b"hello", RejectReason.NOT_MAVLINK),
        (b"\xfd", RejectReason.TRUNCATED),
        (packed()[:-1], RejectReason.TRUNCATED),
        (damaged(packed(), 12, 99), RejectReason.BAD_CHECKSUM),
        (damaged(packed(), 2, 4), RejectReason.INCOMPATIBLE),
        (damaged(packed(), 8, 0xFF), RejectReason.UNKNOWN_MESSAGE),
    ],
)
def test_what_is_no_frame_is_told_by_its_cause(datagram, cause):
    assert parse(datagram) == [cause]


def test_half_a_datagram_does_not_spoil_the_next():
    assert parse(packed()[:9]) == [RejectReason.TRUNCATED]
    assert isinstance(parse(packed())[0], Frame)


def test_empty_datagram_holds_nothing():
    assert parse(b"") == []


def test_frame_alone_is_read_as_it_is_among_others():
    chance = random.Random(2)
    for _ in range(2_000):
        datagram = packed()
        for _ in range(chance.randrange(3)):
            datagram = damaged(datagram, chance.choice([*range(3, len(datagram))]), chance.randrange(256))
        assert parse(datagram) + parse(packed()) == parse(datagram + packed())


def test_frames_before_a_damaged_one_are_kept():
    first, second = parse(packed() + damaged(packed(), 12, 99))
    assert isinstance(first, Frame)
    assert second is RejectReason.BAD_CHECKSUM


def test_stream_gives_its_whole_frames_and_keeps_the_half_one():
    unknown = damaged(packed(), 8, 0xFF)
    stream = bytearray(b"noise" + packed() + damaged(packed(), 12, 99) + unknown + packed()[:-1])
    assert split_stream(stream) == [packed(), unknown]
    assert stream == packed()[:-1]
    stream += packed()[-1:]
    assert split_stream(stream) == [packed()]
    assert split_stream(stream) == []


def test_any_bytes_are_parsed_without_an_exception():
    chance = random.Random(1)
    for _ in range(20_000):
        noise = bytearray(chance.randbytes(chance.randrange(60)))
        if noise and chance.random() < 0.8:
            noise[0] = chance.choice([0xFD, 0xFE])
        for item in parse(bytes(noise)):
            if isinstance(item, Frame):
                item.message()


def test_template_makes_frames_of_its_message():
    for sequence in (0, 255):
        made = torque_template(3).make(sequence, 4000, 0.25, -0.5, 1.0, 0.75)
        (frame,) = parse(made)
        assert frame.sequence == sequence
        assert frame.message().controls[:4] == [0.25, -0.5, 1.0, 0.75]
