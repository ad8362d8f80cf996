"""The vehicle's peers: their streams, intervals and packet counters.

A peer is identified by the source address of its datagrams. On this machine the operating system guarantees that
address. From other machines it can be forged, so only a signature identifies the sender.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import Address, EncodedMessage, Frame, Message, RejectReason
from firmware_model.mavlink.messages import AUTOPILOT, CONTROLLER, sample_packer
from firmware_model.mavlink.signing import Signing
from firmware_model.types import NEVER_US, ImuSample

PEER_TIMEOUT_US = 10_000_000
"""[us] Wall time after which a silent peer is removed."""
MAX_PEERS = 16
"""Most peers at once; further ones are rejected, so that a flood of addresses cannot fill the memory."""
STICKS_US = 10_000_000
"""[us] Time, on the clock of the streams, for which a peer that moved sticks counts as steering."""
_MAX_INTERVAL_US = 2**31 - 1  # the largest that MESSAGE_INTERVAL can hold

_IMU = wire.MAVLINK_MSG_ID_HIGHRES_IMU
_VERSION_1 = wire.MAVLink_statustext_message(wire.MAV_SEVERITY_WARNING, b"MAVLink 1: messages above 255 are not sent")


class Peer:
    """A peer and its streams; an `expected` peer is sent messages before it speaks, and is never removed."""

    def __init__(
        self,
        address: Address,
        system: int,
        signing: Signing | None,
        intervals_us: Mapping[int, int],
        *,
        min_interval_us: int,
        expected: bool,
    ) -> None:
        self.address, self.expected = address, expected
        self._make_channel = partial(Channel, system, signing=signing, link=address[0], follows=True)
        self.channel = self._make_channel(AUTOPILOT)
        self._other_channels: dict[int, Channel] = {}
        self.pack_sample = sample_packer(self.channel, system)
        self._vehicle_intervals_us, self._fastest_us = intervals_us, min_interval_us
        self.reset()

    def reset(self) -> None:
        """Forget role, streams and last contact; sequence numbers and counters continue."""
        self.last_seen_us: int | None = None
        self.next_us = NEVER_US
        self.channel.forget_version()
        self.is_told_version_1 = self.is_told_unsigned = False
        self.controller = False
        self.sticks_until_us = -NEVER_US
        self.answers_due = 0  # at most this many to repetitions of sample 0, which may arrive after t = 0
        self._defaults_us: dict[int, int] = {}
        self._intervals_us: dict[int, int] = {}
        self._due_us: dict[int, int] = {}

    def post(
        self,
        message: Message | EncodedMessage | ImuSample,
        outbox: list[tuple[bytes, Address]],
        component: int = AUTOPILOT,
    ) -> None:
        """Add a component's message to this peer to an outbox; in place of what MAVLink 1 lacks, say so once."""
        datagram = self.pack(message, component)
        if not datagram and not self.is_told_version_1:
            self.is_told_version_1 = True
            datagram = self.pack(_VERSION_1)
        if datagram:
            outbox.append((datagram, self.address))

    def pack(self, message: Message | EncodedMessage | ImuSample, component: int = AUTOPILOT) -> bytes:
        """Return a component's message as a datagram to this peer; each component has its own sequence numbers.

        It is empty if the peer speaks MAVLink 1, which does not have this message.
        """
        if isinstance(message, ImuSample):
            return self.pack_sample(message)
        if component == AUTOPILOT:
            return self.channel.pack(message)
        if component not in self._other_channels:
            self._other_channels[component] = self._make_channel(component)
        datagram = self._other_channels[component].pack(message, version_1=self.channel.is_version_1)
        self.channel.sent += bool(datagram)
        return datagram

    def identify(self, frame: Frame, *, lockstep: bool, clock_us: int) -> None:
        """Start the default streams of this kind of peer.

        A lockstep controller gets each sample when it is due and nothing else, as every message costs it time.
        """
        controller = frame.component == CONTROLLER
        if self.last_seen_us is not None and (self.controller or not controller):
            return
        self.controller = controller
        if controller and lockstep:
            self._defaults_us = {_IMU: self._vehicle_intervals_us[_IMU]}
        else:
            self._defaults_us = {**self._vehicle_intervals_us, **({_IMU: self._fastest_us} if controller else {})}
        self._intervals_us, self._due_us = dict(self._defaults_us), dict.fromkeys(self._defaults_us, clock_us)
        self.next_us = clock_us if self._defaults_us else NEVER_US

    @property
    def is_samples_only(self) -> bool:
        """True if its only stream, if any, is the samples."""
        return self._intervals_us.keys() <= {_IMU}

    def interval_us(self, message_id: int) -> int | None:
        """Return the time [us] between two messages of a stream, `None` if it is off."""
        return self._intervals_us.get(message_id)

    def set_interval(self, message_id: int, interval_us: int | None, clock_us: int) -> None:
        """Set the time [us] between two messages of a stream: 0 for the default, `None` for off.

        No stream is faster than the samples, and a stream that is on keeps its next time, so that no sample is sent
        twice.
        """
        if interval_us == 0:
            interval_us = self._defaults_us.get(message_id, self._vehicle_intervals_us.get(message_id))
        if interval_us is None:
            self._intervals_us.pop(message_id, None)
            self._due_us.pop(message_id, None)
        else:
            interval_us = min(max(interval_us, self._fastest_us), _MAX_INTERVAL_US)
            self._intervals_us[message_id] = interval_us
            self._due_us[message_id] = min(self._due_us.get(message_id, clock_us), clock_us + interval_us)
        self.next_us = min(self._due_us.values(), default=NEVER_US)

    def take_due(self, clock_us: int) -> list[int]:
        """Return the message ids that are due, and schedule their next time."""
        if clock_us < self.next_us:
            return []
        due = [message_id for message_id, due_us in self._due_us.items() if due_us <= clock_us]
        for message_id in due:
            interval_us = self._intervals_us[message_id]
            # Missed messages are not made up for.
            again_us = self._due_us[message_id] + interval_us
            self._due_us[message_id] = again_us if again_us > clock_us else clock_us + interval_us
        self.next_us = min(self._due_us.values(), default=NEVER_US)
        return due


@dataclass(frozen=True, slots=True)
class Client:
    """A request's sender, as services see it."""

    peer: Peer
    """Peer that sent the request."""
    outbox: list[tuple[bytes, Address]]
    """Datagrams to send, with their addresses."""
    clock_us: int
    """[us] Time of the request, on the clock of the streams."""
    component: int
    """Component that answers."""

    def send(self, message: Message | EncodedMessage | ImuSample) -> None:
        """Send a message to this peer alone."""
        self.peer.post(message, self.outbox, self.component)

    def interval_us(self, message_id: int) -> int | None:
        """Return the time [us] between two messages of a stream, `None` if it is off."""
        return self.peer.interval_us(message_id)

    def set_interval(self, message_id: int, interval_us: int | None) -> None:
        """Set the time [us] between two messages of a stream: 0 for the default, `None` for off."""
        self.peer.set_interval(message_id, interval_us, self.clock_us)

    def note_sticks(self) -> None:
        """Record that the peer moves sticks."""
        self.peer.sticks_until_us = self.clock_us + STICKS_US

    @property
    def moves_sticks(self) -> bool:
        """True if the peer moved sticks recently."""
        return self.clock_us < self.peer.sticks_until_us


class PeerTable:
    """Peers of a vehicle by address, a bounded number."""

    def __init__(
        self,
        system: int,
        signing: Signing | None,
        intervals_us: Mapping[int, int],
        expected: Iterable[Address],
        *,
        min_interval_us: int,
    ) -> None:
        make_peer = partial(Peer, system=system, signing=signing, intervals_us=intervals_us)
        self._make_peer = partial(make_peer, min_interval_us=min_interval_us)
        self._removed = Channel(system, AUTOPILOT)
        self._peers = {address: self._make_peer(address, expected=True) for address in expected}

    def __iter__(self) -> Iterator[Peer]:
        return iter(self._peers.values())

    @property
    def next_us(self) -> int:
        """[us] Time of the next stream message, on the clock of the streams."""
        return min((peer.next_us for peer in self), default=NEVER_US)

    def get_or_add(self, address: Address) -> Peer | None:
        """Return the peer at an address, adding it if needed; `None` if the table is full."""
        peer = self._peers.get(address)
        if peer is None and len(self._peers) < MAX_PEERS:
            peer = self._peers[address] = self._make_peer(address, expected=False)
        return peer

    def remove_silent(self, now_us: int) -> list[Peer]:
        """Return the peers that have been silent for too long; remove them, or reset the expected ones."""
        oldest_us = now_us - PEER_TIMEOUT_US
        silent = [peer for peer in self if peer.last_seen_us is not None and peer.last_seen_us < oldest_us]
        for peer in silent:
            if peer.expected:
                peer.reset()
            else:
                self._removed.merge(self._peers.pop(peer.address).channel)
        return silent

    def count_reject(self, cause: RejectReason, address: Address) -> None:
        """Count a rejected datagram or message of a known peer."""
        if peer := self._peers.get(address):
            peer.channel.dropped[cause] += 1

    def stats(self) -> dict[str, dict[str, Any]]:
        """Return packet counters by peer; `gone` sums up the removed peers."""
        stats = {f"{host}:{port}": peer.channel.stats() for (_, (host, port)), peer in self._peers.items()}
        return {**stats, "gone": self._removed.stats()} if self._removed.received else stats
