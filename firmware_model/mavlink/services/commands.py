"""Command protocol: dispatch COMMAND_LONG and COMMAND_INT to their services, and acknowledge each.

MAVLink, command protocol: unused parameters are NaN, and 2^31 - 1 in the integers of COMMAND_INT.
"""

import math
from collections.abc import Mapping

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.messages import ABSENT
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services import service
from firmware_model.mavlink.services.service import CommandAck, Service, VehicleCommand, VehicleContext

_UNSET = 2**31 - 1
_RELATIVE = (wire.MAV_FRAME_GLOBAL_RELATIVE_ALT, wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
_DEGREES = 1e-7  # one unit of a position in COMMAND_INT


def make_service(context: VehicleContext, commands: Mapping[int, service.CommandHandler]) -> Service:
    """Return the service that executes `commands` and acknowledges each, with a STATUSTEXT on rejection."""

    def execute(message: Message, client: Client) -> None:
        handler = commands.get(message.command)
        if absent := ABSENT.get(message.target_component):
            result, text = CommandAck(service.UNSUPPORTED, f"this vehicle has no {absent}")
        else:
            result, text = handler(_parse(message), client) if handler else CommandAck(service.UNSUPPORTED)
        client.send(wire.MAVLink_command_ack_message(message.command, result, 0, 0, *service.sender(message)))
        if text:
            context.send_text(text, wire.MAV_SEVERITY_WARNING)

    return Service(requests=dict.fromkeys((wire.MAVLINK_MSG_ID_COMMAND_LONG, wire.MAVLINK_MSG_ID_COMMAND_INT), execute))


def _parse(message: Message) -> VehicleCommand:
    is_long = message.get_msgId() == wire.MAVLINK_MSG_ID_COMMAND_LONG
    numbers = [getattr(message, f"param{number}") for number in range(1, 8 if is_long else 5)]
    if is_long:
        return VehicleCommand(message.command, tuple(map(_finite_or_none, numbers)), relative=False)
    position = (None if value == _UNSET else value * _DEGREES for value in (message.x, message.y))
    params = (*map(_finite_or_none, numbers), *position, _finite_or_none(message.z))
    return VehicleCommand(message.command, params, relative=message.frame in _RELATIVE)


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
