"""Messages that ask for what this vehicle has not: each is refused by name, as silence says nothing.

Where the protocol has an answer, its sender gets it. A text says the rest; it comes once in a while, as some of these
come many times a second.

References
----------
MAVLink, messages 48, 49, 69, 70, 84, 86, 156, 157, 282, 287, 288, 320, 321, 323, 324.
"""

from collections.abc import Callable

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message, RejectReason
from firmware_model.mavlink.services.service import Client, Service, VehicleContext

_AGAIN_US = 5_000_000  # from a text to the same one
_NEVER_US = -(1 << 62)
_NO_EXTENDED = "no extended parameters: use PARAM_*"
# The bits of POSITION_TARGET_TYPEMASK that are all set where a quantity is not given.
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


def make_service(craft: VehicleContext) -> Service:
    """Return the service that refuses."""
    told_us: dict[str, int] = {}

    def refuse(text: str) -> RejectReason:
        if craft.clock_us >= told_us.get(text, _NEVER_US) + _AGAIN_US:
            told_us[text] = craft.clock_us
            craft.tell(text, wire.MAV_SEVERITY_WARNING)
        return RejectReason.REFUSED

    def simply(text: str) -> Callable[[Message, Client], RejectReason]:
        return lambda _message, _client: refuse(text)

    def refuse_position(message: Message, _: Client) -> RejectReason:
        asked = (name for name, bits in _IGNORED.items() if message.type_mask & bits != bits)
        return refuse(f"{next(asked, 'yaw')} set-points refused: send attitude")

    def refuse_sticks(_: Message, client: Client) -> RejectReason:
        client.hear_sticks()
        return refuse("sticks are not flown: use OFFBOARD")

    def refuse_origin(_: Message, client: Client) -> RejectReason:
        origin = craft.services.streams[wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN].message()
        if origin is not None:
            client.send(origin)
        return refuse("the origin is fixed: not set")

    def refuse_value(message: Message, client: Client) -> RejectReason:
        name = message.param_id.encode("ascii", "replace")[:16]
        client.send(wire.MAVLink_param_ext_ack_message(name, b"", message.param_type, wire.PARAM_ACK_FAILED))
        return refuse(_NO_EXTENDED)

    return Service(
        requests={
            **dict.fromkeys(_POSITIONS, refuse_position),
            **dict.fromkeys(_STICKS, refuse_sticks),
            **dict.fromkeys(_GIMBAL, simply("this vehicle has no gimbal")),
            **dict.fromkeys(_READS, simply(_NO_EXTENDED)),
            wire.MAVLINK_MSG_ID_PARAM_EXT_SET: refuse_value,
            wire.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: refuse_origin,
        }
    )
