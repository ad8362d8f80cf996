import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.channel import MAX_SOURCES, Channel
from firmware_model.mavlink.frames import Frame, RejectReason, parse
from firmware_model.mavlink.messages import imu_message, imu_template
from firmware_model.mavlink.signing import Signing
from firmware_model.types import ImuSample

HEARTBEAT = wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


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
    for component in range(2 * MAX_SOURCES):
        for sequence in (0, 2):
            traffic.count(frame(sequence, component))
    assert traffic.lost == MAX_SOURCES


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


def test_frames_read_by_template_are_counted_like_others():
    sender, receiver, template = Channel(1, 1), Channel(1, 191), imu_template(1)
    receiver.count(parse(sender.pack(HEARTBEAT))[0])
    for step in range(300):
        fields = (4000 * step, 0.0, 2.0, -9.75, 0.5, -0.25, 0.0)
        datagram = sender.make(template, *fields)
        assert receiver.read(template, (1, 1), datagram) == fields
        assert receiver.read(template, (1, 1), datagram) == fields  # reading alone does not count
        receiver.count_read((1, 1))
        assert receiver.read(template, (1, 1), datagram) is None
    assert (receiver.received, receiver.lost) == (301, 0)
    assert sender.stats()["out"] == 301
