"""What a service is: tables of what it answers, does and tells; and what it may know of the vehicle and of who asks.

    def service(craft: Craft) -> Service      each file of this package has one; the endpoint lists them all

A service holds no socket and reads no clock. Its tables go by MAVLink's numbers, and no number stands in two services.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, TypeVar

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Autopilot, TransitionResult
from firmware_model.autopilot.parameters import Parameters
from firmware_model.mavlink.frames import EncodedMessage, Message, RejectReason
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import Command

_Value = TypeVar("_Value")


class Client(Protocol):
    """The peer that a request came from."""

    def send(self, message: Message | EncodedMessage) -> None:
        """Send a message to it alone."""

    def interval_us(self, message_id: int) -> int | None:
        """Return the time [us] between two messages of a stream to it, `None` if there are none."""

    def set_interval(self, message_id: int, interval_us: int | None) -> None:
        """Set the time [us] between two messages of a stream to it, 0 for the default, `None` for never."""

    def hear_sticks(self) -> None:
        """Note that it moves sticks."""

    @property
    def moves_sticks(self) -> bool:
        """Whether it moved sticks lately."""


class VehicleContext(Protocol):
    """The vehicle and its other listeners."""

    @property
    def autopilot(self) -> Autopilot:
        """What decides."""

    @property
    def parameters(self) -> Parameters:
        """Values that people may read and change."""

    @property
    def loop(self) -> VehicleLoop:
        """What flies."""

    @property
    def setpoint(self) -> Command | None:
        """What is tracked, if an outside controller said so."""

    @property
    def generic(self) -> bool:
        """Whether it speaks as no autopilot in particular, and not as PX4."""

    @property
    def failed(self) -> bool:
        """Whether the fail-safe flies."""

    @property
    def services(self) -> "Service":
        """All services in one."""

    @property
    def clock_us(self) -> int:
        """[us] the clock of time-outs: wall time while clamped, model time from there on."""

    @property
    def stamp_us(self) -> int:
        """[us] model time now, between two samples too: the clock of the messages' stamps."""

    @property
    def system(self) -> int:
        """System id."""

    def relay(self, message: Message, source: Client) -> None:
        """Pass a message of the on-board controller on to all peers but the one that it came from."""

    def broadcast(self, message: Message | EncodedMessage) -> None:
        """Send a message to all peers."""

    def tell(self, text: str, severity: int) -> None:
        """Tell all peers a line of at most 50 characters."""

    def apply_parameters(self) -> None:
        """Let changed parameters act."""


class VehicleCommand(NamedTuple):
    """A command, whichever of the two messages brought it."""

    command: int
    """MAV_CMD."""
    numbers: tuple[float | None, ...]
    """Parameters 1 to 7 in units [of the command], positions in degrees and metres; `None` where one is not given."""
    relative: bool
    """Whether the height in parameter 7 counts from home, not from the sea."""

    def whole(self, place: int) -> int | None:
        """Return parameter `place`, counted from 1, without what follows its point; `None` if it is not given."""
        number = self.numbers[place - 1]
        return None if number is None else int(number)


class CommandAck(NamedTuple):
    """What became of a command."""

    result: int
    """MAV_RESULT."""
    text: str = ""
    """Why it was refused, for people; at most 50 characters."""


ACCEPTED = CommandAck(wire.MAV_RESULT_ACCEPTED)
DENIED = wire.MAV_RESULT_DENIED
TEMPORARILY_REJECTED = wire.MAV_RESULT_TEMPORARILY_REJECTED
UNSUPPORTED = wire.MAV_RESULT_UNSUPPORTED
_PERMANENT = (
    TransitionResult.NOT_FLOWN,
    TransitionResult.ON_STAND,
    TransitionResult.HEIGHT,
)  # the same request will fail again


class Stream(NamedTuple):
    """A message that tells how things stand; sent on request and at intervals."""

    message: Callable[[], Message | EncodedMessage | None]
    """Makes it; `None` while there is nothing to tell."""
    interval_us: int | None = None
    """[us] between two for a peer that has asked for nothing; `None` for never."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """One group of microservices."""

    requests: Mapping[int, Callable[[Message, Client], RejectReason | None]] = field(default_factory=dict)
    """By message id: what to do with a message to the autopilot; returns why it had no effect, if that counts."""
    commands: Mapping[int, Callable[[VehicleCommand, Client], CommandAck]] = field(default_factory=dict)
    """By MAV_CMD: what to do at a command."""
    streams: Mapping[int, Stream] = field(default_factory=dict)
    """By message id: what can be told at any time."""
    shows: Mapping[int, Callable[[int], Iterable[Message]]] = field(default_factory=dict)
    """By message id: what is shown on request only; takes the command's second parameter."""


def merge_services(services: Iterable[Service]) -> Service:
    """Return all services as one.

    Raises
    ------
    ValueError
        If two of them claim the same number.
    """
    parts = list(services)
    return Service(
        requests=_merge_tables(part.requests for part in parts),
        commands=_merge_tables(part.commands for part in parts),
        streams=_merge_tables(part.streams for part in parts),
        shows=_merge_tables(part.shows for part in parts),
    )


def make_ack(verdict: TransitionResult) -> CommandAck:
    """Return the autopilot's verdict as the answer to a command."""
    if verdict is TransitionResult.ACCEPTED:
        return ACCEPTED
    return CommandAck(DENIED if verdict in _PERMANENT else TEMPORARILY_REJECTED, verdict.value)


def _merge_tables(tables: Iterable[Mapping[int, _Value]]) -> dict[int, _Value]:
    merged: dict[int, _Value] = {}
    for table in tables:
        if twice := merged.keys() & table.keys():
            raise ValueError(f"two services for number {min(twice)}, must be one")
        merged.update(table)
    return merged
