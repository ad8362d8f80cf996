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
from firmware_model.mavlink.services.service import UNSUPPORTED, Answer, Client, Order, Service, VehicleContext

_UNSET = 2**31 - 1
_RELATIVE = (wire.MAV_FRAME_GLOBAL_RELATIVE_ALT, wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
_DEGREES = 1e-7  # one unit of a position in COMMAND_INT


def service(craft: VehicleContext, commands: Mapping[int, Callable[[Order, Client], Answer]]) -> Service:
    """Return the service that carries out `commands` and acknowledges each to its sender, with a text at a refusal."""

    def execute(command: Message, order: Order, client: Client) -> None:
        handler = commands.get(order.command)
        if absent := ABSENT.get(command.target_component):
            result, text = Answer(UNSUPPORTED, f"this vehicle has no {absent}")
        else:
            result, text = handler(order, client) if handler else Answer(UNSUPPORTED)
        client.send(
            wire.MAVLink_command_ack_message(
                order.command, result, 0, 0, command.get_srcSystem(), command.get_srcComponent()
            )
        )
        if text:
            craft.tell(text, wire.MAV_SEVERITY_WARNING)

    return Service(
        requests={
            wire.MAVLINK_MSG_ID_COMMAND_LONG: lambda command, client: execute(command, _long(command), client),
            wire.MAVLINK_MSG_ID_COMMAND_INT: lambda command, client: execute(command, _int(command), client),
        }
    )


def _long(command: Message) -> Order:
    numbers = (getattr(command, f"param{place}") for place in range(1, 8))
    return Order(command.command, tuple(_finite(number) for number in numbers), relative=False)


def _int(command: Message) -> Order:
    place = (None if number == _UNSET else number * _DEGREES for number in (command.x, command.y))
    first = (_finite(number) for number in (command.param1, command.param2, command.param3, command.param4))
    return Order(command.command, (*first, *place, _finite(command.z)), relative=command.frame in _RELATIVE)


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None
