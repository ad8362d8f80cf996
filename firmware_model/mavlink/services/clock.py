"""Time: the clock of the messages' stamps, compared with a peer's, and answers to pings.

References
----------
MAVLink, time synchronization protocol and ping protocol; messages 2, 4, 111.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Client, Service, Stream, VehicleContext

_NO_DATE = 0


def make_service(craft: VehicleContext) -> Service:
    """Return the service that tells the craft's time."""

    def nanoseconds() -> int:
        return 1000 * craft.stamp_us

    def answer_timesync(message: Message, client: Client) -> None:
        if message.tc1 == 0:  # else it is the answer to a question of ours
            client.send(wire.MAVLink_timesync_message(nanoseconds(), message.ts1))

    def ask_timesync() -> Message:
        return wire.MAVLink_timesync_message(0, nanoseconds())

    def answer_ping(message: Message, client: Client) -> None:
        if message.target_system == 0 and message.target_component == 0:  # else it is an answer
            client.send(
                wire.MAVLink_ping_message(
                    message.time_usec, message.seq, message.get_srcSystem(), message.get_srcComponent()
                )
            )

    def system_time() -> Message:
        return wire.MAVLink_system_time_message(_NO_DATE, craft.stamp_us // 1000)

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
