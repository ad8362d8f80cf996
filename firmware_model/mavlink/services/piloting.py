"""Piloting: arm, take off, hold, return, land, and set modes.

Take-off altitudes are above the sea, as in PX4. An altitude not above home, as from a client that counts from home, is
replaced by the take-off altitude of the parameters, with a STATUSTEXT.

Sticks are not supported. A client that moves sticks and requests an altitude or position mode means to steer by them,
and is rejected. STABILIZED is accepted: a way out of OFFBOARD is open to everybody.

MAVLink, commands 17, 20, 21, 22, 176, 185, 192, 262, 400; message 11, which older programs send.
"""

from collections.abc import Callable

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Autopilot, Mode, TransitionResult
from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services import service
from firmware_model.mavlink.services.geodesy import ORIGIN_HEIGHT
from firmware_model.mavlink.services.identity import STANDARD_MODES
from firmware_model.mavlink.services.service import CommandAck, Service, VehicleCommand, VehicleContext, make_ack

_MODES = {mode.value: mode for mode in Mode}
_BY_STANDARD_MODE = {int(number): mode for mode, number in STANDARD_MODES.items()}
_STICK_MODES = (Mode.ALTCTL, Mode.POSCTL)
_FORCE_DISARM = 21196  # MAVLink's magic number to disarm in the air
_NO_ROUTE = "go-to not supported (only RTL)"
_NOT_REVERSIBLE = "flight termination cannot be undone"
_TOO_LOW = "take-off altitude < home, using MIS_TAKEOFF_ALT"


def make_service(context: VehicleContext) -> Service:
    """Return the service that pilots the vehicle."""
    autopilot = context.autopilot

    def set_mode_by_message(message: Message, client: Client) -> None:
        given = message.base_mode & wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        result = _set_mode(autopilot, _MODES.get(message.custom_mode) if given else None, client)
        if result is not TransitionResult.ACCEPTED:  # SET_MODE has no acknowledgement
            context.send_text(result.value, wire.MAV_SEVERITY_WARNING)

    def ignore_params(act: Callable[[], TransitionResult]) -> service.CommandHandler:
        return lambda _command, _client: make_ack(act())

    return Service(
        requests={wire.MAVLINK_MSG_ID_SET_MODE: set_mode_by_message},
        commands={
            wire.MAV_CMD_COMPONENT_ARM_DISARM: lambda command, _: _arm_or_disarm(autopilot, command),
            wire.MAV_CMD_DO_FLIGHTTERMINATION: lambda command, _: _terminate(autopilot, command),
            wire.MAV_CMD_DO_SET_MODE: lambda command, client: make_ack(
                _set_mode(autopilot, _parse_mode(command), client)
            ),
            wire.MAV_CMD_DO_SET_STANDARD_MODE: lambda command, client: _set_standard_mode(autopilot, command, client),
            wire.MAV_CMD_NAV_TAKEOFF: lambda command, _: _take_off(context, command),
            wire.MAV_CMD_NAV_LAND: ignore_params(autopilot.land),
            wire.MAV_CMD_NAV_RETURN_TO_LAUNCH: ignore_params(autopilot.return_home),
            wire.MAV_CMD_NAV_LOITER_UNLIM: ignore_params(autopilot.hold),
            wire.MAV_CMD_DO_REPOSITION: lambda command, _: _reposition(autopilot, command),
        },
    )


def _arm_or_disarm(autopilot: Autopilot, command: VehicleCommand) -> CommandAck:
    wanted = command.integer(1)
    if wanted not in (0, 1):
        return CommandAck(service.DENIED)
    return make_ack(autopilot.arm() if wanted else autopilot.disarm(force=command.integer(2) == _FORCE_DISARM))


def _terminate(autopilot: Autopilot, command: VehicleCommand) -> CommandAck:
    if command.integer(1) != 1:
        return CommandAck(service.DENIED, _NOT_REVERSIBLE)
    return make_ack(autopilot.disarm(force=True))


def _parse_mode(command: VehicleCommand) -> Mode | None:
    base, main, sub = command.integer(1), command.integer(2), command.integer(3) or 0
    # Bit 0 of the base mode: main and sub mode are given (MAVSDK sends 33).
    if base is None or not base & 1 or main is None or main <= 0:
        return None
    return _MODES.get(main << 16 | sub << 24)


def _set_mode(autopilot: Autopilot, mode: Mode | None, client: Client) -> TransitionResult:
    if mode is None:
        return TransitionResult.NOT_FLOWN
    return TransitionResult.STICKS if mode in _STICK_MODES and client.moves_sticks else autopilot.set_mode(mode)


def _set_standard_mode(autopilot: Autopilot, command: VehicleCommand, client: Client) -> CommandAck:
    mode = _BY_STANDARD_MODE.get(command.integer(1) or 0)
    if mode is None:  # the command's description asks for this result
        return CommandAck(wire.MAV_RESULT_FAILED, TransitionResult.NOT_FLOWN.value)
    return make_ack(_set_mode(autopilot, mode, client))


def _take_off(context: VehicleContext, command: VehicleCommand) -> CommandAck:
    autopilot, height = context.autopilot, command.params[6]
    if height is not None and not command.relative:
        height -= ORIGIN_HEIGHT - autopilot.home_N[2]
        if height <= 0.0:
            context.send_text(_TOO_LOW, wire.MAV_SEVERITY_WARNING)
            height = None
    return make_ack(autopilot.take_off(height))


def _reposition(autopilot: Autopilot, command: VehicleCommand) -> CommandAck:
    # Ground stations send this command without a position to pause.
    pauses = command.params[4:6] == (None, None)
    return make_ack(autopilot.hold()) if pauses else CommandAck(service.UNSUPPORTED, _NO_ROUTE)
