"""Time: clock offset between vehicle and peer, system time, and answers to pings.

References
----------
MAVLink, time synchronization protocol and ping protocol; messages 2, 4, 111.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Client, Service, Stream, VehicleContext

_NO_DATE = 0


def make_service(context: VehicleContext) -> Service:
    """Return the service of the vehicle's clock."""

    def nanoseconds() -> int:
        return 1000 * context.stamp_us

    def answer_timesync(message: Message, client: Client) -> None:
        if message.tc1 == 0:  # otherwise it answers our own request
            client.send(wire.MAVLink_timesync_message(nanoseconds(), message.ts1))

    def ask_timesync() -> Message:
        return wire.MAVLink_timesync_message(0, nanoseconds())

    def answer_ping(message: Message, client: Client) -> None:
        if message.target_system == 0 and message.target_component == 0:  # otherwise it is an answer
            sender = message.get_srcSystem(), message.get_srcComponent()
            client.send(wire.MAVLink_ping_message(message.time_usec, message.seq, *sender))

    def system_time() -> Message:
        return wire.MAVLink_system_time_message(_NO_DATE, context.stamp_us // 1000)

    return Service(
        requests={
            wire.MAVLINK_MSG_ID_TIMESYNC: answer_timesync,
            wire.MAVLINK_MSG_ID_PING: answer_ping,
        },
        streams={
            wire.MAVLINK_MSG_ID_TIMESYNC: Stream(ask_timesync, 100_000),
            wire.MAVLINK_MSG_ID_SYSTEM_TIME: Stream(system_time, 1_000_000),
        },
    )
