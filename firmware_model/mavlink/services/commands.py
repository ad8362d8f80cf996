"""Command protocol: dispatch COMMAND_LONG and COMMAND_INT to their services, and acknowledge each.

References
----------
MAVLink, command protocol: unused parameters are NaN, and 2^31 - 1 in the integers of COMMAND_INT.
"""

import math
from collections.abc import Callable, Mapping

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.messages import ABSENT
from firmware_model.mavlink.services.service import (
    UNSUPPORTED,
    Client,
    CommandAck,
    Service,
    VehicleCommand,
    VehicleContext,
)

_UNSET = 2**31 - 1
_RELATIVE = (wire.MAV_FRAME_GLOBAL_RELATIVE_ALT, wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
_DEGREES = 1e-7  # one unit of a position in COMMAND_INT


def make_service(
    context: VehicleContext, commands: Mapping[int, Callable[[VehicleCommand, Client], CommandAck]]
) -> Service:
    """Return the service that executes `commands` and acknowledges each, with a STATUSTEXT on rejection."""

    def execute(message: Message, command: VehicleCommand, client: Client) -> None:
        handler = commands.get(command.command)
        if absent := ABSENT.get(message.target_component):
            result, text = CommandAck(UNSUPPORTED, f"this vehicle has no {absent}")
        else:
            result, text = handler(command, client) if handler else CommandAck(UNSUPPORTED)
        sender = message.get_srcSystem(), message.get_srcComponent()
        client.send(wire.MAVLink_command_ack_message(command.command, result, 0, 0, *sender))
        if text:
            context.send_text(text, wire.MAV_SEVERITY_WARNING)

    def execute_long(message: Message, client: Client) -> None:
        execute(message, _parse_command_long(message), client)

    def execute_int(message: Message, client: Client) -> None:
        execute(message, _parse_command_int(message), client)

    return Service(
        requests={
            wire.MAVLINK_MSG_ID_COMMAND_LONG: execute_long,
            wire.MAVLINK_MSG_ID_COMMAND_INT: execute_int,
        }
    )


def _parse_command_long(message: Message) -> VehicleCommand:
    params = (getattr(message, f"param{number}") for number in range(1, 8))
    return VehicleCommand(message.command, tuple(_finite_or_none(value) for value in params), relative=False)


def _parse_command_int(message: Message) -> VehicleCommand:
    position = (None if value == _UNSET else value * _DEGREES for value in (message.x, message.y))
    first = (_finite_or_none(value) for value in (message.param1, message.param2, message.param3, message.param4))
    params = (*first, *position, _finite_or_none(message.z))
    return VehicleCommand(message.command, params, relative=message.frame in _RELATIVE)


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
