"""Interface of a service: its tables of handlers and streams, and its views of the vehicle and of the client.

    def make_service(context: VehicleContext) -> Service      in each module of this package

A service holds no socket and reads no clock. Its tables are keyed by MAVLink's numbers; no number is in two services.
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
    """Sender of a request."""

    def send(self, message: Message | EncodedMessage) -> None:
        """Send a message to this client alone."""

    def interval_us(self, message_id: int) -> int | None:
        """Return the time [us] between two messages of a stream, `None` if it is off."""

    def set_interval(self, message_id: int, interval_us: int | None) -> None:
        """Set the time [us] between two messages of a stream: 0 for the default, `None` for off."""

    def note_sticks(self) -> None:
        """Record that the client moves sticks."""

    @property
    def moves_sticks(self) -> bool:
        """True if the client moved sticks recently."""


class VehicleContext(Protocol):
    """View of the vehicle and its peers that services use."""

    @property
    def autopilot(self) -> Autopilot:
        """Arming, modes and fail-safe."""

    @property
    def parameters(self) -> Parameters:
        """Parameters that clients read and change."""

    @property
    def loop(self) -> VehicleLoop:
        """Simulated vehicle."""

    @property
    def setpoint(self) -> Command | None:
        """Tracked set-point of an outside controller, if there is one."""

    @property
    def generic(self) -> bool:
        """True if the vehicle presents itself as a generic autopilot, not as PX4."""

    @property
    def in_fail_safe(self) -> bool:
        """True if the fail-safe flies."""

    @property
    def services(self) -> "Service":
        """All services, merged."""

    @property
    def clock_us(self) -> int:
        """[us] Clock of time-outs: wall time while clamped, model time from there on."""

    @property
    def stamp_us(self) -> int:
        """[us] Model time now, between samples too: the clock of message stamps."""

    @property
    def system(self) -> int:
        """System id."""

    def relay(self, message: Message, source: Client) -> None:
        """Forward a message of the on-board controller to all peers but its sender."""

    def broadcast(self, message: Message | EncodedMessage) -> None:
        """Send a message to all peers."""

    def send_text(self, text: str, severity: int) -> None:
        """Send a STATUSTEXT of at most 50 characters to all peers."""

    def apply_parameters(self) -> None:
        """Apply changed parameters."""


class VehicleCommand(NamedTuple):
    """A command, from COMMAND_LONG or COMMAND_INT."""

    command: int
    """MAV_CMD."""
    params: tuple[float | None, ...]
    """[units of the command] Parameters 1 to 7, positions in degrees and metres; `None` for an absent one."""
    relative: bool
    """True if the altitude in parameter 7 is above home, not above the sea."""

    def integer(self, number: int) -> int | None:
        """Return parameter `number`, 1 to 7, truncated to an integer; `None` if it is absent."""
        value = self.params[number - 1]
        return None if value is None else int(value)


class CommandAck(NamedTuple):
    """Result of a command."""

    result: int
    """MAV_RESULT."""
    text: str = ""
    """Reason of a rejection as STATUSTEXT, at most 50 characters."""


ACCEPTED = CommandAck(wire.MAV_RESULT_ACCEPTED)
DENIED = wire.MAV_RESULT_DENIED
TEMPORARILY_REJECTED = wire.MAV_RESULT_TEMPORARILY_REJECTED
UNSUPPORTED = wire.MAV_RESULT_UNSUPPORTED
# Results after which the same request will fail again.
_PERMANENT = (TransitionResult.NOT_FLOWN, TransitionResult.ON_STAND, TransitionResult.HEIGHT)


class Stream(NamedTuple):
    """A state message, sent on request and at intervals."""

    message: Callable[[], Message | EncodedMessage | None]
    """Return the message, `None` while there is nothing to report."""
    interval_us: int | None = None
    """[us] Default time between two messages; `None` for on request only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """One group of microservices."""

    requests: Mapping[int, Callable[[Message, Client], RejectReason | None]] = field(default_factory=dict)
    """Handlers of messages to the autopilot, by message id; they return a reason for a counted rejection."""
    commands: Mapping[int, Callable[[VehicleCommand, Client], CommandAck]] = field(default_factory=dict)
    """Handlers of commands, by MAV_CMD."""
    streams: Mapping[int, Stream] = field(default_factory=dict)
    """State messages, by message id."""
    on_request: Mapping[int, Callable[[int], Iterable[Message]]] = field(default_factory=dict)
    """Messages on request only, by message id; the argument is the command's second parameter."""


def merge_services(services: Iterable[Service]) -> Service:
    """Return one service with all tables merged.

    Raises
    ------
    ValueError
        If two services claim the same number.
    """
    parts = list(services)
    return Service(
        requests=_merge_tables(part.requests for part in parts),
        commands=_merge_tables(part.commands for part in parts),
        streams=_merge_tables(part.streams for part in parts),
        on_request=_merge_tables(part.on_request for part in parts),
    )


def make_ack(result: TransitionResult) -> CommandAck:
    """Return the acknowledgement of a command for the autopilot's result."""
    if result is TransitionResult.ACCEPTED:
        return ACCEPTED
    return CommandAck(DENIED if result in _PERMANENT else TEMPORARILY_REJECTED, result.value)


def _merge_tables(tables: Iterable[Mapping[int, _Value]]) -> dict[int, _Value]:
    merged: dict[int, _Value] = {}
    for table in tables:
        if duplicates := merged.keys() & table.keys():
            raise ValueError(f"number {min(duplicates)} is claimed by two services, needs one")
        merged.update(table)
    return merged
