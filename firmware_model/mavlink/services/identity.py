"""Identity: heartbeats of vehicle and controller, version, and flight modes with their displayed names.

A ground station has a link to the vehicle only. The relay of HEARTBEAT and STATUSTEXT of the on-board controller to all
other peers shows it the controller and the law that flies. Forwarded messages have their own sequence numbers to each
peer, so that no peer counts gaps for messages to others.

After one AVAILABLE_MODES a client waits for all of them, so every index from 1 on exists.

MAVLink, routing and standard modes protocol, messages 0, 148, 253, 435, 436; command 520, which older programs send.
PROTOCOL_VERSION has left the dialect.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode
from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services import service
from firmware_model.mavlink.services.service import Service, Stream, VehicleContext

_FIRMWARE_VERSION = 1 << 24 | 15 << 16  # 1.15.0, type byte 0: development; clients require at least 1.4.1 of PX4
_CAPABILITIES = (
    wire.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | wire.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | wire.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_NO_VERSION = [0] * 8
_MODE_NAMES = {Mode.ALTCTL: "Altitude", Mode.POSCTL: "Position"}
STANDARD_MODES = {
    Mode.POSCTL: wire.MAV_STANDARD_MODE_POSITION_HOLD,
    Mode.ALTCTL: wire.MAV_STANDARD_MODE_ALTITUDE_HOLD,
    Mode.RETURN: wire.MAV_STANDARD_MODE_SAFE_RECOVERY,
    Mode.LAND: wire.MAV_STANDARD_MODE_LAND,
    Mode.TAKEOFF: wire.MAV_STANDARD_MODE_TAKEOFF,
}
"""Modes that have a number of MAV_STANDARD_MODE."""


def make_service(context: VehicleContext) -> Service:
    """Return the service of the vehicle's identity."""
    autopilot = context.autopilot
    refused = {Mode.ACRO} if autopilot.free else {Mode.ACRO, Mode.TAKEOFF, Mode.RETURN}
    flown = [mode for mode in Mode if mode not in refused]

    def heartbeat() -> Message:
        mode, critical = autopilot.mode.value, autopilot.in_fail_safe
        return messages.heartbeat_message(
            mode, autopilot.armed, critical=critical, generic=context.generic, rotors=context.loop.rotor_count
        )

    def relay(message: Message, client: Client) -> None:
        if service.sender(message) == (context.system, messages.CONTROLLER):
            context.relay(message, client)

    def version() -> Message:
        bytewise = 0 if context.generic else wire.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        return wire.MAVLink_autopilot_version_message(
            _CAPABILITIES | bytewise, _FIRMWARE_VERSION, 0, 0, 0, _NO_VERSION, _NO_VERSION, _NO_VERSION, 0, 0, 0
        )

    def send_version(_: service.VehicleCommand, client: Client) -> service.CommandAck:
        client.send(version())
        return service.ACCEPTED

    def current_mode() -> Message:
        mode = autopilot.mode
        return wire.MAVLink_current_mode_message(_standard_mode(mode), mode.value, mode.value)

    return Service(
        requests={wire.MAVLINK_MSG_ID_HEARTBEAT: relay, wire.MAVLINK_MSG_ID_STATUSTEXT: relay},
        commands={wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: send_version},
        streams={
            wire.MAVLINK_MSG_ID_HEARTBEAT: Stream(heartbeat),
            wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION: Stream(version),
            wire.MAVLINK_MSG_ID_CURRENT_MODE: Stream(current_mode, 2_000_000),
        },
        on_request={wire.MAVLINK_MSG_ID_AVAILABLE_MODES: lambda index: _list_modes(flown, index)},
    )


def _list_modes(flown: list[Mode], index: int) -> list[Message]:
    """Return the mode of an index, counted from 1; all modes for 0, none for any other index."""
    return [
        wire.MAVLink_available_modes_message(
            len(flown), i, _standard_mode(mode), mode.value, 0, _MODE_NAMES.get(mode, mode.name.capitalize()).encode()
        )
        for i, mode in enumerate(flown, 1)
        if index in (0, i)
    ]


def _standard_mode(mode: Mode) -> int:
    return int(STANDARD_MODES.get(mode, wire.MAV_STANDARD_MODE_NON_STANDARD))
