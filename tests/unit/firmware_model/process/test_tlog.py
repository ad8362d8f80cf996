"""The telemetry log: every frame of both directions, stamped, and nothing that a reader would stumble over."""

import struct

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.errors import RecordingError
from firmware_model.mavlink.frames import RejectReason
from firmware_model.process.tlog import Tlog
from firmware_model.recording.durable_file import AppendOnlyFile, is_growing

PEERS = [(0, ("127.0.0.1", port)) for port in (14550, 14540, 40000, 40001, 40002)]


def frame(sequence: int, *, signed: bool = False, version: int = 2) -> bytes:
    packer = wire.MAVLink(None, 1, 1)
    packer.seq = sequence
    if signed:
        packer.signing.secret_key, packer.signing.sign_outgoing = b"k" * 32, True
    message = wire.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    packed: bytes = message.pack(packer, force_mavlink1=version == 1)
    return packed


class Echo:
    """An endpoint that sends what it was given."""

    def __init__(self) -> None:
        self.heard: list[bytes] = []
        self.outbox: list[tuple[bytes, tuple]] = []
        self.dropped: list[RejectReason] = []
        self.finished = False

    def receive(self, datagram, peer, now_us):
        self.heard.append(datagram)

    def count_reject(self, cause, peer):
        self.dropped.append(cause)

    def poll(self, now_us):
        outbox, self.outbox = self.outbox, []
        return outbox

    def deadline_us(self):
        return 77


def entries(path) -> list[tuple[int, bytes]]:
    """Read a log by its definition: a stamp, then a frame as long as its header says."""
    content, found, place = path.read_bytes(), [], 0
    while place < len(content):
        (stamp,) = struct.unpack_from(">Q", content, place)
        place += 8
        overhead = 8 if content[place] == 0xFE else 25 if content[place + 2] & 1 else 12
        end = place + content[place + 1] + overhead
        found.append((stamp, content[place:end]))
        place = end
    return found


def test_both_directions_are_logged_in_order_and_passed_on(tmp_path):
    echo = Echo()
    with Tlog(tmp_path / "t", echo, lambda now_us: 1_000_000 + now_us) as log:
        log.receive(frame(1), PEERS[0], 100)
        echo.outbox = [(frame(2), PEERS[0]), (frame(3), PEERS[1])]
        assert log.poll(200) == [(frame(2), PEERS[0]), (frame(3), PEERS[1])]
        assert log.deadline_us() == 77
        log.count_reject(RejectReason.RATE_LIMITED, PEERS[0])
    assert echo.heard == [frame(1)]
    assert echo.dropped == [RejectReason.RATE_LIMITED]
    assert not log.finished
    assert entries(tmp_path / "t") == [(1_000_100, frame(1)), (1_000_200, frame(2)), (1_000_200 + 1, frame(3))]


def test_frames_of_every_kind_are_found_and_what_is_none_is_left_out(tmp_path):
    good = [frame(1), frame(2, signed=True), frame(3, version=1)]
    with Tlog(tmp_path / "t", echo := Echo(), lambda now_us: now_us) as log:
        for datagram in (b"".join(good), b"", b"\xfd", b"GET / HTTP/1.1", frame(4)[:-1], good[0] + b"\xfd\x09"):
            log.receive(datagram, PEERS[0], 8)
    assert len(echo.heard) == 6
    assert [logged for _, logged in entries(tmp_path / "t")] == [*good, good[0]]


def test_up_to_three_peers_have_a_number_of_their_own(tmp_path):
    with Tlog(tmp_path / "t", Echo(), lambda now_us: now_us) as log:
        for peer in (*PEERS, *PEERS):
            log.receive(frame(1), peer, 400)
    assert [stamp - 400 for stamp, _ in entries(tmp_path / "t")] == [0, 1, 2, 3, 3] * 2


def test_a_crash_loses_a_second_of_traffic_at_most(tmp_path):
    echo = Echo()
    log = Tlog(tmp_path / "t", echo, lambda now_us: now_us)
    for now_us in range(0, 2_500_000, 4_000):
        echo.outbox = [(frame(1), PEERS[0])]
        log.poll(now_us)
    assert entries(tmp_path / "t")[-1][0] > 2_499_999 - 1_004_000
    log.__exit__(None, None, None)


def test_a_file_is_known_to_grow_until_it_is_closed(tmp_path):
    file = AppendOnlyFile(tmp_path / "f")
    file.write(b"begun")
    assert is_growing(tmp_path / "f")
    file.close()
    assert not is_growing(tmp_path / "f")
    assert (tmp_path / "f").read_bytes() == b"begun"


def test_a_full_disk_is_one_line_with_the_file_s_name(tmp_path):
    file = AppendOnlyFile(tmp_path / "f")
    try:
        file._file.close()
        file._file = open("/dev/full", "wb", buffering=0)  # noqa: PTH123, SIM115
        with pytest.raises(RecordingError, match=r"/f: No space left on device$"):
            file.write(b"more")
    finally:
        file.close()
