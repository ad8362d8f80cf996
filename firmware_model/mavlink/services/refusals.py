"""Unsupported messages: reject each by name rather than silently.

The sender gets the protocol's answer, if there is one, and all peers a STATUSTEXT. Each text is sent at most every
5 s, as some of these messages arrive many times a second.

MAVLink, messages 48, 49, 69, 70, 84, 86, 156, 157, 282, 287, 288, 320, 321, 323, 324.
"""

from collections.abc import Callable

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message, RejectReason
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services.position import origin_message
from firmware_model.mavlink.services.service import Service, VehicleContext
from firmware_model.types import NEVER_US

_REPEAT_US = 5_000_000  # least time between two equal texts
_NO_EXTENDED = "no extended parameters: use PARAM_*"
# Bits of POSITION_TARGET_TYPEMASK, all set if a quantity is not given.
_IGNORED = {"position": 0o7, "velocity": 0o70, "acceleration": 0o700}
_POSITIONS = (wire.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED, wire.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT)
_STICKS = (wire.MAVLINK_MSG_ID_MANUAL_CONTROL, wire.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE)
_GIMBAL = (
    wire.MAVLINK_MSG_ID_MOUNT_CONFIGURE,
    wire.MAVLINK_MSG_ID_MOUNT_CONTROL,
    wire.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_ATTITUDE,
    wire.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_PITCHYAW,
    wire.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_MANUAL_CONTROL,
)
_READS = (wire.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_READ, wire.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_LIST)


def make_service(context: VehicleContext) -> Service:
    """Return the service that rejects unsupported messages."""
    sent_us: dict[str, int] = {}

    def reject(text: str) -> RejectReason:
        if context.clock_us >= sent_us.get(text, -NEVER_US) + _REPEAT_US:
            sent_us[text] = context.clock_us
            context.send_text(text, wire.MAV_SEVERITY_WARNING)
        return RejectReason.REFUSED

    def always(text: str) -> Callable[[Message, Client], RejectReason]:
        return lambda _message, _client: reject(text)

    def reject_position(message: Message, _: Client) -> RejectReason:
        given = (name for name, bits in _IGNORED.items() if message.type_mask & bits != bits)
        return reject(f"{next(given, 'yaw')} set-points rejected: send attitude")

    def reject_sticks(_: Message, client: Client) -> RejectReason:
        client.note_sticks()
        return reject("sticks not supported: use OFFBOARD")

    def reject_origin(_: Message, client: Client) -> RejectReason:
        client.send(origin_message(context))
        return reject("origin is fixed: request ignored")

    def reject_value(message: Message, client: Client) -> RejectReason:
        name = message.param_id.encode("ascii", "replace")[:16]
        client.send(wire.MAVLink_param_ext_ack_message(name, b"", message.param_type, wire.PARAM_ACK_FAILED))
        return reject(_NO_EXTENDED)

    return Service(
        requests={
            **dict.fromkeys(_POSITIONS, reject_position),
            **dict.fromkeys(_STICKS, reject_sticks),
            **dict.fromkeys(_GIMBAL, always("this vehicle has no gimbal")),
            **dict.fromkeys(_READS, always(_NO_EXTENDED)),
            wire.MAVLINK_MSG_ID_PARAM_EXT_SET: reject_value,
            wire.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: reject_origin,
        }
    )
