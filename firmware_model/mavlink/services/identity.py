"""Identity: HEARTBEAT and AUTOPILOT_VERSION.

References
----------
MAVLink, messages 0, 148; command 520, which older programs send. PROTOCOL_VERSION has left the dialect.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import (
    ACCEPTED,
    Client,
    CommandAck,
    Service,
    Stream,
    VehicleCommand,
    VehicleContext,
)

_FIRMWARE_VERSION = 1 << 24 | 15 << 16  # 1.15.0, type byte 0: development; clients require at least 1.4.1 of PX4
_CAPABILITIES = (
    wire.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | wire.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | wire.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_NO_VERSION = [0] * 8


def make_service(context: VehicleContext) -> Service:
    """Return the service of the vehicle's identity."""

    def heartbeat() -> Message:
        autopilot = context.autopilot
        return messages.heartbeat_message(
            autopilot.mode.value, autopilot.armed, critical=context.in_fail_safe, generic=context.generic
        )

    def version() -> Message:
        return version_message(generic=context.generic)

    def send_version(_: VehicleCommand, client: Client) -> CommandAck:
        client.send(version())
        return ACCEPTED

    return Service(
        commands={wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: send_version},
        streams={
            wire.MAVLINK_MSG_ID_HEARTBEAT: Stream(heartbeat),
            wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION: Stream(version),
        },
    )


def version_message(*, generic: bool) -> Message:
    """Return AUTOPILOT_VERSION of a development build; integer parameters are bytewise unless `generic`."""
    bytewise = 0 if generic else wire.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    return wire.MAVLink_autopilot_version_message(
        _CAPABILITIES | bytewise, _FIRMWARE_VERSION, 0, 0, 0, _NO_VERSION, _NO_VERSION, _NO_VERSION, 0, 0, 0
    )
