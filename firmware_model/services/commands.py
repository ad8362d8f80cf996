"""The command service: COMMAND_LONG to arm, to change the mode, and to ask for messages; each one is acknowledged.

References
----------
MAVLink, command protocol; unused parameters may arrive as NaN.
"""

import math
from typing import Protocol

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot import Autopilot, Mode, Verdict
from firmware_model.frames import Message

_RESULTS = {
    Verdict.ACCEPTED: wire.MAV_RESULT_ACCEPTED,
    Verdict.NO_STREAM: wire.MAV_RESULT_TEMPORARILY_REJECTED,
    Verdict.IN_FLIGHT: wire.MAV_RESULT_TEMPORARILY_REJECTED,
    Verdict.NOT_FLOWN: wire.MAV_RESULT_DENIED,
}


class Sender(Protocol):
    """What a command may ask of the stream to its sender."""

    def set_interval(self, message_id: int, interval_us: int) -> bool:
        """Set the time between two messages, 0 for the default, -1 for never; False if it is not streamed."""

    def request(self, message_id: int) -> bool:
        """Send a message once; False if there is no such."""


def execute(command: Message, autopilot: Autopilot, sender: Sender, clock_us: int) -> tuple[int, str]:
    """Return the MAV_RESULT of a COMMAND_LONG, and the text that explains a refusal to people."""
    first, second, third = (_whole(value) for value in (command.param1, command.param2, command.param3))
    match command.command:
        case wire.MAV_CMD_COMPONENT_ARM_DISARM if first in (0, 1):
            return _told(autopilot.arm() if first else autopilot.disarm())
        case wire.MAV_CMD_DO_SET_MODE if first is not None and second is not None:
            mode = _mode(first, second, third or 0)
            return _told(autopilot.set_mode(mode, clock_us) if mode else Verdict.NOT_FLOWN)
        case wire.MAV_CMD_SET_MESSAGE_INTERVAL if first is not None and second is not None:
            return _done(second >= -1 and sender.set_interval(first, second)), ""
        case wire.MAV_CMD_REQUEST_MESSAGE if first is not None:
            return _done(sender.request(first)), ""
        case wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return _done(sender.request(wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION)), ""
        case (
            wire.MAV_CMD_COMPONENT_ARM_DISARM
            | wire.MAV_CMD_DO_SET_MODE
            | wire.MAV_CMD_SET_MESSAGE_INTERVAL
            | wire.MAV_CMD_REQUEST_MESSAGE
        ):
            return wire.MAV_RESULT_DENIED, ""
    return wire.MAV_RESULT_UNSUPPORTED, ""


def acknowledgement(command: Message, result: int) -> Message:
    """Return the COMMAND_ACK to the sender of `command`."""
    return wire.MAVLink_command_ack_message(
        command.command,
        result,
        target_system=command.get_srcSystem(),
        target_component=command.get_srcComponent(),
    )


def _mode(base: int, main: int, sub: int) -> Mode | None:
    """Return the mode asked for; bit 0 of the base mode says that main and sub mode are given (MAVSDK sends 33)."""
    number = main << 16 | sub << 24
    return Mode(number) if base & 1 and main > 0 and number in {mode.value for mode in Mode} else None


def _told(verdict: Verdict) -> tuple[int, str]:
    return _RESULTS[verdict], "" if verdict is Verdict.ACCEPTED else verdict.value


def _done(done: bool) -> int:
    return int(wire.MAV_RESULT_ACCEPTED if done else wire.MAV_RESULT_DENIED)


def _whole(value: float) -> int | None:
    return int(value) if math.isfinite(value) else None
