"""Streams: message intervals of a peer, and any message on request.

MAVLink, commands 510, 511, 512, messages 66 and 244. MAVProxy and older programs still send 66 and 510.
"""

from functools import partial

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services import service
from firmware_model.mavlink.services.service import ACCEPTED, CommandAck, Service, VehicleCommand, VehicleContext

# Messages of the groups of REQUEST_DATA_STREAM, as far as this vehicle has them.
_GROUPS = {
    wire.MAV_DATA_STREAM_RAW_SENSORS: (wire.MAVLINK_MSG_ID_HIGHRES_IMU,),
    wire.MAV_DATA_STREAM_EXTENDED_STATUS: (wire.MAVLINK_MSG_ID_SYS_STATUS, wire.MAVLINK_MSG_ID_GPS_RAW_INT),
    wire.MAV_DATA_STREAM_RC_CHANNELS: (wire.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,),
    wire.MAV_DATA_STREAM_POSITION: (wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED, wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT),
    wire.MAV_DATA_STREAM_EXTRA1: (wire.MAVLINK_MSG_ID_ATTITUDE,),
    wire.MAV_DATA_STREAM_EXTRA2: (wire.MAVLINK_MSG_ID_VFR_HUD,),
    wire.MAV_DATA_STREAM_EXTRA3: (wire.MAVLINK_MSG_ID_SYSTEM_TIME, wire.MAVLINK_MSG_ID_BATTERY_STATUS),
}


def make_service(context: VehicleContext) -> Service:
    """Return the service of streams."""
    return Service(
        requests={wire.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: partial(_request_group, context)},
        commands={
            wire.MAV_CMD_SET_MESSAGE_INTERVAL: partial(_set_interval, context),
            wire.MAV_CMD_GET_MESSAGE_INTERVAL: partial(_get_interval, context),
            wire.MAV_CMD_REQUEST_MESSAGE: partial(_request_message, context),
        },
    )


def _set_interval(context: VehicleContext, command: VehicleCommand, client: Client) -> CommandAck:
    message_id, interval_us = command.integer(1), command.integer(2)
    if message_id is None or interval_us is None or interval_us < -1:
        return CommandAck(service.DENIED)
    if (ack := _check_known(context, message_id)) is ACCEPTED:
        client.set_interval(message_id, None if interval_us < 0 else interval_us)
    return ack


def _get_interval(context: VehicleContext, command: VehicleCommand, client: Client) -> CommandAck:
    return _send_interval(context, command.integer(1), client)


def _send_interval(context: VehicleContext, message_id: int | None, client: Client) -> CommandAck:
    if message_id is None or not 0 <= message_id < 2**16:
        return CommandAck(service.DENIED)
    if (ack := _check_known(context, message_id)) is ACCEPTED:
        interval_us = client.interval_us(message_id)
        client.send(wire.MAVLink_message_interval_message(message_id, -1 if interval_us is None else interval_us))
    return ack


def _request_message(context: VehicleContext, command: VehicleCommand, client: Client) -> CommandAck:
    message_id = command.integer(1)
    if message_id is None:
        return CommandAck(service.DENIED)
    if message_id == wire.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
        return _send_interval(context, command.integer(2), client)
    if on_request := context.services.on_request.get(message_id):
        messages = list(on_request(command.integer(2) or 0))
    elif (ack := _check_known(context, message_id)) is ACCEPTED:
        message = context.services.streams[message_id].message()
        messages = [] if message is None else [message]
    else:
        return ack
    for message in messages:
        client.send(message)
    return ACCEPTED if messages else CommandAck(service.TEMPORARILY_REJECTED)


def _request_group(context: VehicleContext, message: Message, client: Client) -> None:
    rate = message.req_message_rate
    interval_us = 1_000_000 // rate if message.start_stop and rate else None
    everything = message.req_stream_id == wire.MAV_DATA_STREAM_ALL
    for group, message_ids in _GROUPS.items():
        if everything or group == message.req_stream_id:
            for message_id in context.services.streams.keys() & message_ids:
                client.set_interval(message_id, interval_us)


def _check_known(context: VehicleContext, message_id: int) -> CommandAck:
    """Accept a message that has a stream; deny an id that no message can have."""
    if message_id in context.services.streams:
        return ACCEPTED
    return CommandAck(service.UNSUPPORTED if 0 <= message_id < 2**24 else service.DENIED)
