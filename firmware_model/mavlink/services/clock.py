"""Time: clock offset between vehicle and peer, system time, and answers to pings. MAVLink, messages 2, 4, 111."""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services.service import Service, Stream, VehicleContext, sender

_NO_DATE = 0


def make_service(context: VehicleContext) -> Service:
    """Return the service of the vehicle's clock."""

    def answer_timesync(message: Message, client: Client) -> None:
        if message.tc1 == 0:  # otherwise it answers our own request
            client.send(wire.MAVLink_timesync_message(1000 * context.stamp_us, message.ts1))

    def ask_timesync() -> Message:
        return wire.MAVLink_timesync_message(0, 1000 * context.stamp_us)

    def answer_ping(message: Message, client: Client) -> None:
        if message.target_system == 0 and message.target_component == 0:  # otherwise it is an answer
            client.send(wire.MAVLink_ping_message(message.time_usec, message.seq, *sender(message)))

    def system_time() -> Message:
        return wire.MAVLink_system_time_message(_NO_DATE, context.stamp_us // 1000)

    return Service(
        requests={wire.MAVLINK_MSG_ID_TIMESYNC: answer_timesync, wire.MAVLINK_MSG_ID_PING: answer_ping},
        streams={
            wire.MAVLINK_MSG_ID_TIMESYNC: Stream(ask_timesync, 100_000),
            wire.MAVLINK_MSG_ID_SYSTEM_TIME: Stream(system_time, 1_000_000),
        },
    )
