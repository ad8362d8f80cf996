"""Unsupported messages: reject each by name rather than silently.

A message to this autopilot that no service reads is rejected by its own name, see `refuse_unread`.

The sender gets the protocol's answer, if there is one, and all peers a STATUSTEXT. Each text is sent at most every
5 s, as some of these messages arrive many times a second.

MAVLink, messages 41, 48, 49, 69, 70, 84, 86, 119, 121, 126, 144, 156, 157, 256, 282, 287, 288, 320, 321, 323, 324.
"""

from collections.abc import Callable

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message, RejectReason
from firmware_model.mavlink.messages import AUTOPILOT
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services.position import origin_message
from firmware_model.mavlink.services.service import Service, VehicleContext

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
# By id: no answer of a protocol says no to these.
_WITHOUT_ANSWER = {
    wire.MAVLINK_MSG_ID_LOG_REQUEST_DATA: "no log on board: see the flight's recording",
    wire.MAVLINK_MSG_ID_LOG_ERASE: "no log on board: nothing to erase",
    wire.MAVLINK_MSG_ID_MISSION_SET_CURRENT: "no mission on board",
    wire.MAVLINK_MSG_ID_SETUP_SIGNING: "key not taken: start with --signing-key",
    wire.MAVLINK_MSG_ID_SERIAL_CONTROL: "this vehicle has no serial port, and no shell",
    wire.MAVLINK_MSG_ID_FOLLOW_TARGET: "follow-me not supported",
}
# Answers to this vehicle, or the end of an exchange: nobody waits for a word.
_LAST_WORDS = (
    wire.MAVLINK_MSG_ID_COMMAND_ACK,
    wire.MAVLINK_MSG_ID_MISSION_ACK,
    wire.MAVLINK_MSG_ID_LOG_REQUEST_END,
    wire.MAVLINK_MSG_ID_PARAM_EXT_ACK,
    wire.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS,
)
_MAX_TEXT = 50  # characters of a STATUSTEXT
_READS = (wire.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_READ, wire.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_LIST)


def make_service(context: VehicleContext) -> Service:
    """Return the service that rejects unsupported messages."""

    def reject(text: str) -> RejectReason:
        context.warn(text)
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
            **{number: always(text) for number, text in _WITHOUT_ANSWER.items()},
            wire.MAVLINK_MSG_ID_PARAM_EXT_SET: reject_value,
            wire.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: reject_origin,
        }
    )


def refuse_unread(message: Message, context: VehicleContext) -> RejectReason:
    """Return why a message that no service reads has no effect; reject one to this very system by its name."""
    is_ours = getattr(message, "target_system", 0) == context.system
    if (
        not is_ours
        or getattr(message, "target_component", 0) not in (0, AUTOPILOT)
        or message.get_msgId() in _LAST_WORDS
    ):
        return RejectReason.UNUSED_MESSAGE
    context.warn(f"{message.get_type()} not supported"[:_MAX_TEXT])
    return RejectReason.REFUSED
