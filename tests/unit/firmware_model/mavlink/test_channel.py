import pytest
from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import EncodedMessage, Frame, RejectReason, parse, to_version_1
from firmware_model.mavlink.messages import imu_message, imu_template
from firmware_model.mavlink.signing import Signing
from firmware_model.types import ImuSample

HEARTBEAT = wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
MODES = wire.MAVLink_available_modes_message(1, 1, 0, 0, 0, b"Land")


def frame(sequence: int, component: int = 1, *, old: bool = False) -> Frame:
    packer = wire.MAVLink(None, 1, component)
    packer.seq = sequence
    (parsed,) = parse(HEARTBEAT.pack(packer, force_mavlink1=old))
    return parsed


def lost(*sequences: int) -> int:
    traffic = Channel(1, 1)
    for sequence in sequences:
        traffic.count(frame(sequence))
    assert traffic.received == len(sequences)
    return traffic.lost


def test_gaps_are_lost_packets():
    assert lost(7, 8, 9) == 0
    assert lost(7, 9, 13) == 4
    assert lost(254, 255, 0, 1) == 0
    assert lost(254, 1) == 2


def test_repeated_and_overtaken_packets_are_not_lost():
    assert lost(5, 6, 6, 6, 7) == 0
    assert lost(5, 7, 6, 8) == 1


def test_each_sender_behind_an_address_counts_by_itself():
    traffic = Channel(1, 1)
    for sequence in range(5):
        traffic.count(frame(sequence, 1))
        traffic.count(frame(100 + sequence, 2, old=True))
    assert traffic.lost == 0


def test_senders_behind_one_address_are_bounded():
    traffic = Channel(1, 1)
    for component in range(32):
        for sequence in (0, 2):
            traffic.count(frame(sequence, component))
    assert traffic.lost == 16


def test_each_packet_out_has_the_next_number():
    traffic = Channel(3, 4)
    sent = [parse(traffic.pack(HEARTBEAT))[0] for _ in range(300)]
    assert [item.sequence for item in sent] == [number % 256 for number in range(300)]
    assert {(item.system, item.component) for item in sent} == {(3, 4)}


def test_figures_tell_damage_from_refusal():
    traffic = Channel(1, 1)
    traffic.count(frame(1))
    traffic.count(frame(3))
    traffic.pack(HEARTBEAT)
    traffic.dropped.update([RejectReason.BAD_CHECKSUM, RejectReason.TRUNCATED, RejectReason.STALE, RejectReason.STALE])
    assert traffic.stats() == {"in": 2, "out": 1, "lost": 1, "bad": 2, "rejected": {"stale": 2}}


@pytest.mark.parametrize("signing", [None, bytes(range(32))])
def test_template_makes_the_datagrams_of_the_message(signing):
    sample = ImuSample(4000, (0.5, -0.25, 0.0), (0.0, 2.0, -9.75))
    channels = [Channel(1, 1, signing and Signing(signing, 1_700_000_000_000_000)) for _ in range(2)]
    for _ in range(3):
        made = channels[0].make(imu_template(1), sample.time_us, *sample.specific_force_B, *sample.gyro_B)
        assert made == channels[1].pack(imu_message(sample))
        assert parse(made)[0].is_signed is (signing is not None)
    assert channels[0].stats() == channels[1].stats()


def test_frames_exchanged_at_once_are_counted_like_others():
    ours, theirs = Channel(1, 1), Channel(1, 191)
    ours.count(parse(theirs.pack(HEARTBEAT))[0])
    for frames in (300, 1):
        assert ours.next_from((1, 191)) == theirs.packer.seq
        theirs.count_sent(frames)
        ours.count_next((1, 191), frames)
    assert ours.next_from((1, 190)) == 0
    ours.count(parse(theirs.pack(HEARTBEAT))[0])
    assert ours.stats() == {"in": 303, "out": 0, "lost": 0, "bad": 0, "rejected": {}}
    assert theirs.stats()["out"] == 303


@pytest.mark.parametrize("number", [number for number in wire.mavlink_map if number < 256])
def test_version_1_has_the_fields_that_the_checksum_seed_covers(number):
    """The seed of a message is a checksum over name and base fields, without those that were appended later."""
    kind = wire.mavlink_map[number]
    length, size = len(to_version_1(empty(number))) - 8, 0
    described, arrays = f"{kind.msgname} ".encode(), dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    for name in kind.ordered_fieldnames:
        if size == length:
            break
        described += f"{types[name]} {name} ".encode() + (bytes((arrays[name],)) if arrays[name] else b"")
        width = 8 if types[name].split("_")[0].endswith("64") or types[name] == "double" else BYTES[types[name][:5]]
        size += width * max(arrays[name], 1)
    both = mcrf4xx(described)
    assert (size, both & 255 ^ both >> 8) == (length, kind.crc_extra)


BYTES = {"char": 1, "uint8": 1, "int8_": 1, "uint1": 2, "int16": 2, "uint3": 4, "int32": 4, "float": 4}


def empty(number: int) -> bytes:
    return EncodedMessage(number, b"\0").pack(wire.MAVLink(None, 1, 1))


def test_message_above_255_does_not_fit_version_1():
    assert to_version_1(empty(256)) == b""
    assert to_version_1(empty(255 if 255 in wire.mavlink_map else 254)) != b""


@pytest.mark.parametrize(
    "message",
    [
        HEARTBEAT,
        wire.MAVLink_ping_message(7, 8, 0, 0),
        wire.MAVLink_attitude_message(1000, 0.5, -0.25, 0.125, 0.0, 0.0, 0.0),  # zeros at its end are not cut
    ],
)
def test_version_1_is_that_of_pymavlink(message):
    ours = to_version_1(message.pack(wire.MAVLink(None, 3, 4)))
    assert ours == bytes(message.pack(wire.MAVLink(None, 3, 4), force_mavlink1=True))


def test_peer_of_version_1_is_answered_in_it_until_it_speaks_version_2():
    traffic = Channel(1, 1, follows=True)
    assert traffic.pack(HEARTBEAT)[0] == 0xFD
    sender = wire.MAVLink(None, 255, 190)
    traffic.count(parse(HEARTBEAT.pack(sender, force_mavlink1=True))[0])
    sent = [traffic.pack(HEARTBEAT), traffic.pack(MODES), traffic.make(imu_template(1), 4000, *[0.5] * 6)]
    assert [each[:1] for each in sent] == [b"\xfe", b"", b"\xfe"]
    assert (sent[0][2], sent[2][2], traffic.sent) == (1, 2, 3)  # what is not sent takes no sequence number
    assert parse(sent[2])[0].payload == parse(Channel(1, 1).make(imu_template(1), 4000, *[0.5] * 6))[0].payload
    traffic.count(parse(HEARTBEAT.pack(sender))[0])
    traffic.count(parse(HEARTBEAT.pack(sender, force_mavlink1=True))[0])  # another program behind the same address
    assert traffic.pack(MODES)[0] == 0xFD


@pytest.mark.parametrize("channel", [Channel(1, 1), Channel(1, 1, Signing(bytes(32), 0), follows=True)])
def test_controller_and_who_must_sign_never_speak_version_1(channel):
    channel.count(parse(HEARTBEAT.pack(wire.MAVLink(None, 255, 190), force_mavlink1=True))[0])
    assert channel.pack(HEARTBEAT)[0] == 0xFD
