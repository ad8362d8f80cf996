"""Identity: what speaks here, and in which state; HEARTBEAT and AUTOPILOT_VERSION.

References
----------
MAVLink, messages 0, 148; commands 519, 520, which older programs send.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model import messages
from firmware_model.frames import Message
from firmware_model.services.service import ACCEPTED, Answer, Client, Craft, Order, Service, Stream

_FIRMWARE_VERSION = 1 << 24 | 15 << 16  # 1.15.0, type byte 0: development; clients ask PX4 for at least 1.4.1


def service(craft: Craft) -> Service:
    """Return the service that tells what the craft is."""

    def heartbeat() -> Message:
        autopilot = craft.autopilot
        return messages.heartbeat_message(autopilot.mode.value, autopilot.armed, critical=craft.failed)

    def send_version(_: Order, client: Client) -> Answer:
        client.send(version_message())
        return ACCEPTED

    return Service(
        commands={wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: send_version},
        streams={wire.MAVLINK_MSG_ID_HEARTBEAT: Stream(heartbeat)},
        shows={wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION: lambda _: [version_message()]},
    )


def version_message() -> Message:
    """Return AUTOPILOT_VERSION: MAVLink 2, bytewise parameters, attitude targets; a development build."""
    capabilities = (
        wire.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | wire.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )
    return wire.MAVLink_autopilot_version_message(
        capabilities, _FIRMWARE_VERSION, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
    )
