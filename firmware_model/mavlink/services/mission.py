"""Missions, fences and rally points: empty lists that accept no items.

References
----------
MAVLink, mission protocol, messages 39 to 47, 51, 73.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Client, Service, VehicleContext

_KINDS = (wire.MAV_MISSION_TYPE_MISSION, wire.MAV_MISSION_TYPE_FENCE, wire.MAV_MISSION_TYPE_RALLY)


def make_service(_: VehicleContext) -> Service:
    """Return the service of empty mission, fence and rally lists."""
    return Service(
        requests={
            wire.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: _send_count,
            wire.MAVLINK_MSG_ID_MISSION_REQUEST: _reject_request,
            wire.MAVLINK_MSG_ID_MISSION_REQUEST_INT: _reject_request,
            wire.MAVLINK_MSG_ID_MISSION_COUNT: _reject_upload,
            wire.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: _reject,
            wire.MAVLINK_MSG_ID_MISSION_ITEM: _reject,
            wire.MAVLINK_MSG_ID_MISSION_ITEM_INT: _reject,
            wire.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: _acknowledge_clear,
        }
    )


def _send_count(request: Message, client: Client) -> None:
    if request.mission_type not in _KINDS:
        _reject(request, client)
        return
    sender = request.get_srcSystem(), request.get_srcComponent()
    client.send(wire.MAVLink_mission_count_message(*sender, 0, mission_type=request.mission_type))


def _reject_upload(request: Message, client: Client) -> None:
    # An upload of no items is complete with its announcement.
    _acknowledge(request, client, wire.MAV_MISSION_UNSUPPORTED if request.count else wire.MAV_MISSION_ACCEPTED)


def _reject_request(request: Message, client: Client) -> None:
    _acknowledge(request, client, wire.MAV_MISSION_INVALID_SEQUENCE)


def _reject(request: Message, client: Client) -> None:
    _acknowledge(request, client, wire.MAV_MISSION_UNSUPPORTED)


def _acknowledge_clear(request: Message, client: Client) -> None:
    _acknowledge(request, client, wire.MAV_MISSION_ACCEPTED)


def _acknowledge(request: Message, client: Client, result: int) -> None:
    sender = request.get_srcSystem(), request.get_srcComponent()
    client.send(wire.MAVLink_mission_ack_message(*sender, result, mission_type=request.mission_type))
