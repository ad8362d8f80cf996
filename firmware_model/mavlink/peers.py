"""The peers of the vehicle: what each is sent how often, and what came and went.

A peer is the address that a datagram says it comes from. On this machine the system vouches for it; from elsewhere
anybody can write any address, so only a signature says who speaks.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import Address, EncodedMessage, Frame, Message, RejectReason
from firmware_model.mavlink.messages import AUTOPILOT, CONTROLLER
from firmware_model.mavlink.signing import Signing

NEVER_US = 1 << 62
"""[us] a time that does not come."""
PEER_TIMEOUT_US = 10_000_000
"""[us] wall time after which a silent peer is forgotten."""
MAX_PEERS = 16
"""Peers served at once; more are refused, so that a flood of addresses can't fill the memory."""
STICKS_US = 10_000_000
"""[us] model time for which a peer that moved sticks counts on them."""
_MAX_INTERVAL_US = 2**31 - 1  # MESSAGE_INTERVAL has no more bits

_IMU = wire.MAVLINK_MSG_ID_HIGHRES_IMU


class Peer:
    """A peer and its streams; `expected` ones are told of the vehicle unasked, and never forgotten."""

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
        self.traffic = Channel(system, AUTOPILOT, signing, address[0])
        self._others: dict[int, Channel] = {}
        self._system, self._signing = system, signing
        self._vehicle_intervals_us, self._fastest_us = intervals_us, min_interval_us
        self.begin()

    def begin(self) -> None:
        """Begin as if nothing had been heard of this peer; its packets are numbered and counted on."""
        self.last_seen_us: int | None = None
        self.next_us = NEVER_US
        self.controller = False
        self.sticks_until_us = -NEVER_US
        self._defaults_us: dict[int, int] = {}
        self._intervals_us: dict[int, int] = {}
        self._due_us: dict[int, int] = {}

    def pack(self, message: Message | EncodedMessage, component: int = AUTOPILOT) -> bytes:
        """Return a message of a component of the vehicle as a datagram to this peer; each has its own numbers."""
        if component == AUTOPILOT:
            return self.traffic.pack(message)
        if component not in self._others:
            self._others[component] = Channel(self._system, component, self._signing, self.address[0])
        self.traffic.sent += 1
        return self._others[component].pack(message)

    def identify(self, frame: Frame, *, lockstep: bool, clock_us: int) -> None:
        """Start the streams that a peer of this kind gets when it asks for nothing.

        A lockstep controller is sent each sample when it is due and nothing more, as every message costs it time.
        """
        controller = frame.component == CONTROLLER
        if self.last_seen_us is not None and (self.controller or not controller):
            return
        self.controller = controller
        if controller and lockstep:
            self._defaults_us = {_IMU: self._vehicle_intervals_us[_IMU]}
        else:
            self._defaults_us = {**self._vehicle_intervals_us, **({_IMU: self._fastest_us} if controller else {})}
        self._start(dict(self._defaults_us), clock_us)

    @property
    def is_samples_only(self) -> bool:
        """Whether it is sent samples and nothing else regularly."""
        return self._intervals_us.keys() <= {_IMU}

    def interval_us(self, message_id: int) -> int | None:
        """Return the time between two messages, `None` if there are none."""
        return self._intervals_us.get(message_id)

    def set_interval(self, message_id: int, interval_us: int | None, clock_us: int) -> None:
        """Set the time between two messages, 0 for the default, `None` for never.

        A sample is not told twice: no stream is faster than the samples.
        """
        if interval_us == 0:
            interval_us = self._defaults_us.get(message_id, self._vehicle_intervals_us.get(message_id))
        if interval_us is None:
            self._intervals_us.pop(message_id, None)
            self._due_us.pop(message_id, None)
        else:
            self._intervals_us[message_id] = min(max(interval_us, self._fastest_us), _MAX_INTERVAL_US)
            self._due_us[message_id] = clock_us
        self.next_us = min(self._due_us.values(), default=NEVER_US)

    def take_due(self, clock_us: int) -> list[int]:
        """Return the message ids that are due, and set when they are due again."""
        if clock_us < self.next_us:
            return []
        due = [message_id for message_id, due_us in self._due_us.items() if due_us <= clock_us]
        for message_id in due:
            interval_us = self._intervals_us[message_id]
            # What was missed is not made up for.
            again_us = self._due_us[message_id] + interval_us
            self._due_us[message_id] = again_us if again_us > clock_us else clock_us + interval_us
        self.next_us = min(self._due_us.values(), default=NEVER_US)
        return due

    def _start(self, intervals_us: dict[int, int], clock_us: int) -> None:
        self._intervals_us = intervals_us
        self._due_us = dict.fromkeys(intervals_us, clock_us)
        self.next_us = clock_us if intervals_us else NEVER_US


@dataclass(frozen=True, slots=True)
class RequestContext:
    """The peer that a request came from, as services see it."""

    listener: Peer
    """The peer."""
    outbox: list[tuple[bytes, Address]]
    """What is to be sent."""
    clock_us: int
    """[us] time of the request, on the clock of the streams."""
    speaker: int
    """Component that answers."""

    def send(self, message: Message | EncodedMessage) -> None:
        """Send a message to it alone."""
        self.outbox.append((self.listener.pack(message, self.speaker), self.listener.address))

    def interval_us(self, message_id: int) -> int | None:
        """Return the time [us] between two messages of a stream to it, `None` if there are none."""
        return self.listener.interval_us(message_id)

    def set_interval(self, message_id: int, interval_us: int | None) -> None:
        """Set the time [us] between two messages of a stream to it, 0 for the default, `None` for never."""
        self.listener.set_interval(message_id, interval_us, self.clock_us)

    def hear_sticks(self) -> None:
        """Note that it moves sticks."""
        self.listener.sticks_until_us = self.clock_us + STICKS_US

    @property
    def moves_sticks(self) -> bool:
        """Whether it moved sticks lately."""
        return self.clock_us < self.listener.sticks_until_us


class PeerTable:
    """All peers of a vehicle by their addresses, a bounded number."""

    def __init__(
        self,
        system: int,
        signing: Signing | None,
        intervals_us: Mapping[int, int],
        expected: Iterable[Address],
        *,
        min_interval_us: int,
    ) -> None:
        self._system, self._signing = system, signing
        self._intervals_us, self._fastest_us = intervals_us, min_interval_us
        self._gone = Channel(system, AUTOPILOT)
        self._at = {address: self._new(address, expected=True) for address in expected}

    def __iter__(self) -> Iterator[Peer]:
        return iter(self._at.values())

    @property
    def next_us(self) -> int:
        """[us] when a stream is due, on the clock of the streams."""
        return min((listener.next_us for listener in self), default=NEVER_US)

    def at(self, address: Address) -> Peer | None:
        """Return the peer at an address, a new one if there is room, `None` if there is not."""
        listener = self._at.get(address)
        if listener is None and len(self._at) < MAX_PEERS:
            listener = self._at[address] = self._new(address, expected=False)
        return listener

    def remove_silent(self, now_us: int) -> list[Peer]:
        """Forget who has been silent for too long and return them; an expected one begins anew."""
        silent = [
            listener
            for listener in self
            if listener.last_seen_us is not None and now_us > listener.last_seen_us + PEER_TIMEOUT_US
        ]
        for listener in silent:
            if listener.expected:
                listener.begin()
            else:
                self._gone.absorb(self._at.pop(listener.address).traffic)
        return silent

    def drop(self, address: Address, cause: RejectReason) -> None:
        """Count what a known peer sent in vain."""
        if listener := self._at.get(address):
            listener.traffic.dropped[cause] += 1

    def figures(self) -> dict[str, dict[str, Any]]:
        """Return what came and went, by peer; `gone` sums up those that are forgotten."""
        figures = {f"{host}:{port}": listener.traffic.figures() for (_, (host, port)), listener in self._at.items()}
        return {**figures, "gone": self._gone.figures()} if self._gone.received else figures

    def _new(self, address: Address, *, expected: bool) -> Peer:
        return Peer(
            address,
            self._system,
            self._signing,
            self._intervals_us,
            min_interval_us=self._fastest_us,
            expected=expected,
        )
