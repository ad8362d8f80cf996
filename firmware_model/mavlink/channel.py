"""One peer's share of a link: sequence numbers, signatures and packet counters."""

from collections import Counter
from typing import Any

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import (
    DAMAGE_REASONS,
    EncodedMessage,
    Frame,
    FrameTemplate,
    Message,
    RejectReason,
    to_version_1,
)
from firmware_model.mavlink.signing import Signing

MAX_SOURCES = 16
"""Senders behind one address whose sequence gaps are counted; further senders are received without gap counts."""
_LATE_GAP = 128  # a sequence number ahead by at least half the range comes from an older frame


class Channel:
    """Packer for one peer, with packet counters of both directions.

    One that `follows` its peer sends MAVLink 1 for as long as the peer has sent nothing else, as PX4 does.
    """

    def __init__(
        self, system: int, component: int, signing: Signing | None = None, link: int = 0, *, follows: bool = False
    ) -> None:
        self.sent = self.received = self.lost = 0
        self.dropped: Counter[RejectReason] = Counter()
        self.packer = wire.MAVLink(None, system, component)
        self._expected: dict[tuple[int, int], int] = {}
        self._signing = signing
        self._follows = follows and signing is None  # MAVLink 1 has no signatures
        self._versions: set[bool] = set()
        if signing is not None:
            self.packer.signing.secret_key, self.packer.signing.link_id = signing.key, link
            self.packer.signing.sign_outgoing = True

    @property
    def is_version_1(self) -> bool:
        """True if this peer is sent MAVLink 1."""
        return self._follows and self._versions == {True}

    def forget_version(self) -> None:
        """Begin anew with MAVLink 2: another program may be there."""
        self._versions.clear()

    def pack(self, message: Message | EncodedMessage, *, version_1: bool = False) -> bytes:
        """Return the message as a datagram to this peer, with the next sequence number.

        With `version_1`, or to a peer of MAVLink 1, it is empty for a message that MAVLink 1 does not have.
        """
        if self._signing is not None:
            self.packer.signing.timestamp = self._signing.next_stamp()
        datagram: bytes = message.pack(self.packer)
        if (version_1 or self.is_version_1) and not (datagram := to_version_1(datagram)):
            return datagram
        self.packer.seq = (self.packer.seq + 1) & 255
        self.sent += 1
        return datagram

    def count(self, frame: Frame) -> None:
        """Count a received frame and the frames lost before it."""
        self.received += 1
        self._versions.add(frame.is_version_1)
        source, sequence = (frame.system, frame.component), frame.sequence
        expected = self._expected.get(source)
        if expected != sequence:
            if expected is None:
                if len(self._expected) >= MAX_SOURCES:
                    return
            elif (gap := (sequence - expected) & 255) < _LATE_GAP:
                self.lost += gap
            else:  # a duplicate or overtaken frame: the expected number stays
                return
        self._expected[source] = (sequence + 1) & 255

    def next_from(self, source: tuple[int, int]) -> int:
        """Return the sequence number that the next frame from a source should have; any, so 0, for the first."""
        return self._expected.get(source, 0)

    def count_next(self, source: tuple[int, int], frames: int) -> None:
        """Count frames that were received, each the next one from a source."""
        self.received += frames
        self._expected[source] = (self._expected.get(source, 0) + frames) & 255

    def count_sent(self, frames: int) -> None:
        """Count frames that were made elsewhere, with the next sequence numbers."""
        self.sent += frames
        self.packer.seq = (self.packer.seq + frames) & 255

    def make(self, template: FrameTemplate, *fields: float) -> bytes:
        """Return a message as a datagram to this peer, with the next sequence number."""
        if self._signing is not None or self.is_version_1:
            return self.pack(template.encode(*fields))
        packer = self.packer
        datagram = template.make(packer.seq, *fields)
        packer.seq = (packer.seq + 1) & 255
        self.sent += 1
        return datagram

    def merge(self, other: "Channel") -> None:
        """Add the counters of a removed peer."""
        self.sent += other.sent
        self.received += other.received
        self.lost += other.lost
        self.dropped.update(other.dropped)

    def stats(self) -> dict[str, Any]:
        """Return the packet counters: in, out, lost on the way here, damaged, and rejected by cause."""
        rejected = {cause.value: count for cause, count in self.dropped.items() if cause not in DAMAGE_REASONS}
        return {
            "in": self.received,
            "out": self.sent,
            "lost": self.lost,
            "bad": sum(self.dropped[cause] for cause in DAMAGE_REASONS),
            "rejected": dict(sorted(rejected.items())),
        }
