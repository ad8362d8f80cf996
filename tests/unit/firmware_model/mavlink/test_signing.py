"""Signing on a virtual clock, with pymavlink's own signing as the other side."""

import random
from hashlib import sha256

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.errors import ConfigError
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import EncodedMessage, Frame, RejectReason, parse
from firmware_model.mavlink.signing import Signing, read_key

KEY = bytes(range(32))
NOW = 1_700_000_000_000_000  # [us] Unix time at which the virtual clock is 0
STAMP = (NOW - 1_420_070_400_000_000) // 10
MINUTE = 6_000_000
PING = wire.MAVLink_ping_message(1, 2, 0, 0)
HEARTBEAT = wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def sender(key: bytes = KEY, stamp: int = STAMP, link: int = 0, component: int = 190) -> wire.MAVLink:
    client = wire.MAVLink(None, 255, component)
    client.signing.secret_key, client.signing.timestamp, client.signing.link_id = key, stamp, link
    client.signing.sign_outgoing = True
    return client


def frame(message=PING, **client) -> Frame:
    (parsed,) = parse(message.pack(sender(**client)))
    return parsed


@pytest.fixture
def signing() -> Signing:
    signing = Signing(KEY, NOW)
    signing.tick(0)
    return signing


def test_signature_is_the_published_formula():
    raw = frame(stamp=STAMP).raw
    assert raw[-13:-6] == b"\0" + STAMP.to_bytes(6, "little")
    assert raw[-6:] == sha256(KEY + raw[:-6]).digest()[:6]


def test_right_key_is_obeyed_as_long_as_its_stamps_grow(signing):
    client = sender()
    for _ in range(3):
        (parsed,) = parse(PING.pack(client))
        assert signing.check(parsed) is None


def test_wrong_key_is_refused(signing):
    assert signing.check(frame(key=bytes(32))) is RejectReason.WRONG_SIGNATURE


def test_altered_frame_is_refused(signing):
    raw = bytearray(frame().raw)
    raw[-13] ^= 1  # the link id is under the signature, and not under the checksum
    (altered,) = parse(bytes(raw))
    assert signing.check(altered) is RejectReason.WRONG_SIGNATURE


def test_unsigned_frame_is_refused_but_heartbeat_and_radio_status(signing):
    plain = wire.MAVLink(None, 255, 190)
    causes = []
    for message in (PING, HEARTBEAT, wire.MAVLink_radio_status_message(0, 0, 0, 0, 0, 0, 0)):
        (parsed,) = parse(message.pack(plain))
        causes.append(signing.check(parsed))
    assert causes == [RejectReason.NOT_SIGNED, None, None]


def test_version_1_frame_is_not_signed(signing):
    (parsed,) = parse(PING.pack(wire.MAVLink(None, 1, 1), force_mavlink1=True))
    assert not parsed.is_signed
    assert signing.check(parsed) is RejectReason.NOT_SIGNED


def test_heartbeat_with_a_wrong_signature_is_refused(signing):
    assert signing.check(frame(HEARTBEAT, key=bytes(32))) is RejectReason.WRONG_SIGNATURE


def test_replayed_frame_is_refused(signing):
    first = frame()
    assert signing.check(first) is None
    assert signing.check(first) is RejectReason.REPLAYED
    assert signing.check(frame(stamp=STAMP - 1)) is RejectReason.REPLAYED


def test_each_stream_has_stamps_of_its_own(signing):
    assert signing.check(frame(stamp=STAMP + 9)) is None
    for other in ({"link": 1}, {"component": 191}):
        assert signing.check(frame(stamp=STAMP, **other)) is None


@pytest.mark.parametrize(("age", "cause"), [(MINUTE, None), (MINUTE + 1, RejectReason.OUT_OF_DATE)])
def test_first_stamp_of_a_stream_is_at_most_a_minute_old(signing, age, cause):
    assert signing.check(frame(stamp=STAMP - age)) is cause


def test_minute_is_measured_on_the_callers_clock(signing):
    signing.tick(1_000_000)
    assert signing.check(frame(stamp=STAMP - MINUTE)) is RejectReason.OUT_OF_DATE


def test_forged_stamp_does_not_shut_the_true_sender_out(signing):
    assert signing.check(frame(key=bytes(32), stamp=STAMP + 1_000_000)) is RejectReason.WRONG_SIGNATURE
    assert signing.check(frame()) is None


def test_streams_are_bounded(signing):
    for link in range(256):
        assert signing.check(frame(link=link)) is None
    assert signing.check(frame(component=1)) is RejectReason.TOO_MANY_PEERS
    assert signing.check(frame(stamp=STAMP + 1)) is None


@pytest.mark.parametrize(("lead", "cause"), [(MINUTE, None), (MINUTE + 1, RejectReason.AHEAD_OF_CLOCK)])
def test_any_stamp_is_at_most_a_minute_ahead_of_the_clock(signing, lead, cause):
    assert signing.check(frame(stamp=STAMP)) is None
    assert signing.check(frame(stamp=STAMP + lead)) is cause
    assert signing.check(frame(stamp=STAMP + lead, component=1)) is cause


@pytest.mark.parametrize("stamp", [STAMP + MINUTE, STAMP + 10 * 365 * 1440 * MINUTE, 2**48 - 2, 2**48 - 1])
def test_a_clock_in_the_future_locks_nobody_out(signing, stamp):
    signing.check(frame(stamp=stamp))
    assert signing.check(frame(component=1)) is None
    assert signing.check(frame(stamp=STAMP - MINUTE, component=2)) is None
    signing.tick(1_000_000)
    assert signing.check(frame(stamp=STAMP + 100_000, component=3)) is None


def test_own_stamps_grow_and_follow_the_own_clock_alone(signing):
    assert [signing.next_stamp(), signing.next_stamp()] == [STAMP + 1, STAMP + 2]
    signing.tick(1_000)
    assert signing.next_stamp() == STAMP + 101
    assert signing.check(frame(stamp=STAMP + 1_000)) is None
    assert signing.next_stamp() == STAMP + 102


def test_last_stamp_of_all_is_no_error():
    signing = Signing(KEY, 1_420_070_400_000_000 + 10 * (2**48 - 2))
    signing.tick(0)
    assert signing.check(frame(stamp=2**48 - 1)) is None
    assert [parse(Channel(1, 1, signing).pack(PING))[0].is_signed for _ in range(3)] == [True] * 3


def test_pymavlink_obeys_what_we_sign(signing):
    traffic = Channel(1, 1, signing, 1)
    attitude = wire.MAVLink_attitude_message.unpacker.pack(4, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0)
    receiver = sender()
    for outgoing in (PING, EncodedMessage(30, attitude), HEARTBEAT, EncodedMessage(30, attitude)):
        message = receiver.decode(bytearray(traffic.pack(outgoing)))
        assert message.get_signed()
    assert (receiver.signing.goodsig_count, receiver.signing.badsig_count) == (4, 0)


def test_any_damage_to_a_signed_frame_is_refused(signing):
    raw, chance = frame().raw, random.Random(5)
    for bit in chance.sample(range(8 * len(raw)), 200):
        damaged = bytearray(raw)
        damaged[bit // 8] ^= 1 << bit % 8
        for item in parse(bytes(damaged)):
            assert isinstance(item, RejectReason) or signing.check(item) is not None
    assert signing.check(frame()) is None


def key_file(folder, content: bytes, mode: int = 0o600):
    path = folder / "key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("content", [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n"])
def test_key_is_32_bytes_or_64_digits(tmp_path, content):
    assert read_key(key_file(tmp_path, content)) == KEY


@pytest.mark.parametrize("content", [b"", KEY[:-1], KEY + b"\n", KEY.hex().encode()[:-1], b"x" * 64, bytes(5000)])
def test_other_content_is_no_key(tmp_path, content):
    with pytest.raises(ConfigError, match="32 bytes, or 64 hexadecimal digits"):
        read_key(key_file(tmp_path, content))


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620])
def test_key_that_others_can_reach_is_refused(tmp_path, mode):
    with pytest.raises(ConfigError, match=f"mode is {mode:o}"):
        read_key(key_file(tmp_path, KEY, mode))


def test_missing_key_is_told_by_its_name(tmp_path):
    with pytest.raises(ConfigError, match="nowhere: No such file"):
        read_key(tmp_path / "nowhere")


def test_key_of_another_length_is_refused():
    with pytest.raises(ValueError, match="32 bytes, not 16"):
        Signing(bytes(16), NOW)
