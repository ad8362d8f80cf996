"""The command protocol: COMMAND_LONG and COMMAND_INT to whichever service does it, and an answer to each.

References
----------
MAVLink, command protocol; unused parameters arrive as NaN, in the integers of COMMAND_INT as 2^31 - 1.
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
    craft: VehicleContext, commands: Mapping[int, Callable[[VehicleCommand, Client], CommandAck]]
) -> Service:
    """Return the service that carries out `commands` and acknowledges each to its sender, with a text at a refusal."""

    def execute(command: Message, order: VehicleCommand, client: Client) -> None:
        handler = commands.get(order.command)
        if absent := ABSENT.get(command.target_component):
            result, text = CommandAck(UNSUPPORTED, f"this vehicle has no {absent}")
        else:
            result, text = handler(order, client) if handler else CommandAck(UNSUPPORTED)
        client.send(
            wire.MAVLink_command_ack_message(
                order.command, result, 0, 0, command.get_srcSystem(), command.get_srcComponent()
            )
        )
        if text:
            craft.tell(text, wire.MAV_SEVERITY_WARNING)

    return Service(
        requests={
            wire.MAVLINK_MSG_ID_COMMAND_LONG: lambda command, client: execute(
                command, _parse_command_long(command), client
            ),
            wire.MAVLINK_MSG_ID_COMMAND_INT: lambda command, client: execute(
                command, _parse_command_int(command), client
            ),
        }
    )


def _parse_command_long(command: Message) -> VehicleCommand:
    numbers = (getattr(command, f"param{place}") for place in range(1, 8))
    return VehicleCommand(command.command, tuple(_finite_or_none(number) for number in numbers), relative=False)


def _parse_command_int(command: Message) -> VehicleCommand:
    place = (None if number == _UNSET else number * _DEGREES for number in (command.x, command.y))
    first = (_finite_or_none(number) for number in (command.param1, command.param2, command.param3, command.param4))
    return VehicleCommand(
        command.command, (*first, *place, _finite_or_none(command.z)), relative=command.frame in _RELATIVE
    )


def _finite_or_none(number: float) -> float | None:
    return number if math.isfinite(number) else None
