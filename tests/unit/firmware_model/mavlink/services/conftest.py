"""A vehicle as services see it, and a peer that keeps what it is sent, as it comes off the wire."""

from dataclasses import dataclass, field, replace

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Autopilot, Settings
from firmware_model.autopilot.parameters import Parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.mavlink.frames import RejectReason, parse
from firmware_model.mavlink.services.service import Service, VehicleCommand
from firmware_model.sim.vehicle_loop import VehicleLoop

SENDER = wire.MAVLink(None, 255, 190)


def received(message, packer=SENDER):
    """Return the message as its receiver decodes it."""
    (frame,) = parse(message.pack(packer))
    return frame.message()


class Peer:
    def __init__(self) -> None:
        self.sent: list = []
        self.intervals: dict[int, int | None] = {}
        self.moves_sticks = False

    def send(self, message) -> None:
        self.sent.append(received(message, wire.MAVLink(None, 1, 1)))

    def interval_us(self, message_id: int) -> int | None:
        return self.intervals.get(message_id)

    def set_interval(self, message_id: int, interval_us: int | None) -> None:
        self.intervals[message_id] = interval_us

    def note_sticks(self) -> None:
        self.moves_sticks = True

    def take(self) -> list:
        sent, self.sent = self.sent, []
        return sent


@dataclass
class Craft:
    autopilot: Autopilot
    parameters: Parameters
    loop: VehicleLoop
    setpoint: object = None
    generic: bool = False
    services: Service = field(default_factory=Service)
    clock_us: int = 0
    stamp_us: int = 0
    system: int = 1
    applied: int = 0
    texts: list[str] = field(default_factory=list)
    shared: Peer = field(default_factory=Peer)

    def broadcast(self, message) -> None:
        self.shared.send(message)

    def send_text(self, text: str, severity: int) -> None:
        assert len(text) <= 50
        self.texts.append(text)

    def warn(self, text: str) -> None:
        self.send_text(text, wire.MAV_SEVERITY_WARNING)

    def apply_parameters(self) -> None:
        self.applied += 1


@pytest.fixture
def craft() -> Craft:
    return _craft()


@pytest.fixture(scope="module")
def any_craft() -> Craft:
    """One vehicle for hundreds of cases that leave texts alone behind."""
    return _craft()


def _craft() -> Craft:
    vehicle, scenario = load_vehicle("paper"), replace(load_scenario("paper"), duration_s=1.0)
    loop = VehicleLoop(vehicle, scenario, 1)
    return Craft(Autopilot(Settings(), free=True), Parameters(vehicle, scenario), loop)


@pytest.fixture
def peer() -> Peer:
    return Peer()


@pytest.fixture
def heard(peer):
    """Send a message to a service; returns why it had no effect, if that counts."""

    def heard(service: Service, message) -> RejectReason | None:
        message = received(message)
        return service.requests[message.get_msgId()](message, peer)

    return heard


@pytest.fixture
def ask(heard, peer):
    """Send a message to a service; returns what the peer is sent."""

    def ask(service: Service, message) -> list:
        heard(service, message)
        return peer.take()

    return ask


@pytest.fixture
def order(peer):
    """Give a command to a service; returns result and text."""

    def order(service: Service, command: int, *numbers: float | None, relative: bool = False) -> tuple[int, str]:
        given = (*numbers, *[None] * (7 - len(numbers)))
        return tuple(service.commands[command](VehicleCommand(command, given, relative), peer))

    return order
