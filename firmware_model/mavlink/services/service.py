"""Interface of a service: its tables of handlers and streams, and its view of the vehicle.

    def make_service(context: VehicleContext) -> Service      in each module of this package

A service holds no socket and reads no clock. Its tables are keyed by MAVLink's numbers; no number is in two services.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import NamedTuple, Protocol, TypeVar

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Autopilot, TransitionResult
from firmware_model.autopilot.parameters import Parameters
from firmware_model.mavlink.frames import EncodedMessage, Message, RejectReason
from firmware_model.mavlink.peers import Client
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import Command, ImuSample

_Value = TypeVar("_Value")


class VehicleContext(Protocol):
    """View of the vehicle and its peers that services use."""

    autopilot: Autopilot
    """Arming, modes and fail-safe."""
    parameters: Parameters
    """Parameters that clients read and change."""
    loop: VehicleLoop
    """Simulated vehicle."""
    generic: bool
    """True if the vehicle presents itself as a generic autopilot, not as PX4."""
    services: "Service"
    """All services, merged."""
    system: int
    """System id."""

    @property
    def setpoint(self) -> Command | None:
        """Tracked set-point of an outside controller, if there is one."""

    @property
    def clock_us(self) -> int:
        """[us] Clock of time-outs: wall time while clamped, model time from there on."""

    @property
    def stamp_us(self) -> int:
        """[us] Model time now, between samples too: the clock of message stamps."""

    def relay(self, message: Message, source: Client) -> None:
        """Forward a message of the on-board controller to all peers but its sender."""

    def broadcast(self, message: Message | EncodedMessage) -> None:
        """Send a message to all peers."""

    def send_text(self, text: str, severity: int) -> None:
        """Send a STATUSTEXT of at most 50 characters to all peers."""

    def warn(self, text: str) -> None:
        """Send a warning of at most 50 characters to all peers, unless it was sent within the last 5 s."""

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
CommandHandler = Callable[[VehicleCommand, Client], CommandAck]


class Stream(NamedTuple):
    """A state message, sent on request and at intervals."""

    message: Callable[[], Message | EncodedMessage | ImuSample | None]
    """Return the message, a sample for HIGHRES_IMU, `None` while there is nothing to report."""
    interval_us: int | None = None
    """[us] Default time between two messages; `None` for on request only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """One group of microservices."""

    requests: Mapping[int, Callable[[Message, Client], RejectReason | None]] = field(default_factory=dict)
    """Handlers of messages to the autopilot, by message id; they return a reason for a counted rejection."""
    commands: Mapping[int, CommandHandler] = field(default_factory=dict)
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
    tables = [table.name for table in fields(Service)]
    return Service(**{name: _merge_tables(getattr(part, name) for part in parts) for name in tables})


def make_ack(result: TransitionResult) -> CommandAck:
    """Return the acknowledgement of a command for the autopilot's result."""
    if result is TransitionResult.ACCEPTED:
        return ACCEPTED
    return CommandAck(DENIED if result in _PERMANENT else TEMPORARILY_REJECTED, result.value)


def sender(message: Message) -> tuple[int, int]:
    """Return system and component of a message's sender, the target of its answer."""
    return message.get_srcSystem(), message.get_srcComponent()


def _merge_tables(tables: Iterable[Mapping[int, _Value]]) -> dict[int, _Value]:
    merged: dict[int, _Value] = {}
    for table in tables:
        if duplicates := merged.keys() & table.keys():
            raise ValueError(f"number {min(duplicates)} is claimed by two services, needs one")
        merged.update(table)
    return merged
