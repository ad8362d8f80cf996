"""Piloting: arm, take off, hold, return, land, and any other mode.

Heights of a take-off count from the sea, as PX4 has it. One that is not above home, as of a client that counts from
home, is not flown to: the take-off height of the parameters is, and that is said.

No sticks are flown. Who sends some and asks for a height or a place to be held means to steer by them, and is refused.
STABILIZED is not: a way out of OFFBOARD is open to everybody.

References
----------
MAVLink, commands 17, 20, 21, 22, 176, 185, 192, 400; message 11, which older programs send.
"""

from collections.abc import Callable

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode, TransitionResult
from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.place import ORIGIN_HEIGHT
from firmware_model.mavlink.services.service import (
    DENIED,
    UNSUPPORTED,
    Client,
    CommandAck,
    Service,
    VehicleCommand,
    VehicleContext,
    make_ack,
)

_MODES = {mode.value: mode for mode in Mode}
_STICK_MODES = (Mode.ALTCTL, Mode.POSCTL)
_FORCE_DISARM = 21196  # the number that MAVLink asks for beside an order to disarm in the air
_NO_ROUTE = "this vehicle flies to no place but home"
_NOT_ENDED = "a flight that was terminated stays so"
_TOO_LOW = "take-off height is below home: MIS_TAKEOFF_ALT"


def make_service(craft: VehicleContext) -> Service:
    """Return the service that pilots the craft."""
    autopilot = craft.autopilot

    def arm(order: VehicleCommand, _: Client) -> CommandAck:
        wanted = order.whole(1)
        if wanted not in (0, 1):
            return CommandAck(DENIED)
        return make_ack(autopilot.arm() if wanted else autopilot.disarm(force=order.whole(2) == _FORCE_DISARM))

    def terminate(order: VehicleCommand, _: Client) -> CommandAck:
        if order.whole(1) != 1:
            return CommandAck(DENIED, _NOT_ENDED)
        return make_ack(autopilot.disarm(force=True))

    def change_mode(mode: Mode | None, client: Client) -> TransitionResult:
        if mode is None:
            return TransitionResult.NOT_FLOWN
        return TransitionResult.STICKS if mode in _STICK_MODES and client.moves_sticks else autopilot.set_mode(mode)

    def set_mode(order: VehicleCommand, client: Client) -> CommandAck:
        base, main, sub = order.whole(1), order.whole(2), order.whole(3) or 0
        # Bit 0 of the base mode says that main and sub mode are given (MAVSDK sends 33).
        given = base is not None and base & 1 and main is not None and main > 0
        mode = _MODES.get(main << 16 | sub << 24) if given and main is not None else None
        return make_ack(change_mode(mode, client))

    def set_mode_by_message(message: Message, client: Client) -> None:
        given = message.base_mode & wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        mode = _MODES.get(message.custom_mode) if given else None
        verdict = change_mode(mode, client)
        if verdict is not TransitionResult.ACCEPTED:  # there is no other answer to this message
            craft.tell(verdict.value, wire.MAV_SEVERITY_WARNING)

    def take_off(order: VehicleCommand, _: Client) -> CommandAck:
        height = order.numbers[6]
        if height is not None and not order.relative:
            height -= ORIGIN_HEIGHT - autopilot.home_N[2]
            if height <= 0.0:
                craft.tell(_TOO_LOW, wire.MAV_SEVERITY_WARNING)
                height = None
        return make_ack(autopilot.take_off(height))

    def reposition(order: VehicleCommand, _: Client) -> CommandAck:
        # Without a place this is what ground stations send for a pause.
        return make_ack(autopilot.hold()) if order.numbers[4:6] == (None, None) else CommandAck(UNSUPPORTED, _NO_ROUTE)

    def simply(act: Callable[[], TransitionResult]) -> Callable[[VehicleCommand, Client], CommandAck]:
        return lambda _order, _client: make_ack(act())

    return Service(
        requests={wire.MAVLINK_MSG_ID_SET_MODE: set_mode_by_message},
        commands={
            wire.MAV_CMD_COMPONENT_ARM_DISARM: arm,
            wire.MAV_CMD_DO_FLIGHTTERMINATION: terminate,
            wire.MAV_CMD_DO_SET_MODE: set_mode,
            wire.MAV_CMD_NAV_TAKEOFF: take_off,
            wire.MAV_CMD_NAV_LAND: simply(autopilot.land),
            wire.MAV_CMD_NAV_RETURN_TO_LAUNCH: simply(autopilot.return_home),
            wire.MAV_CMD_NAV_LOITER_UNLIM: simply(autopilot.hold),
            wire.MAV_CMD_DO_REPOSITION: reposition,
        },
    )
