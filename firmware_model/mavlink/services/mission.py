"""Missions, fences and rally points: there are none, and none are taken.

References
----------
MAVLink, mission protocol, messages 39 to 47, 51, 73.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Client, Service, VehicleContext

_KINDS = (wire.MAV_MISSION_TYPE_MISSION, wire.MAV_MISSION_TYPE_FENCE, wire.MAV_MISSION_TYPE_RALLY)


def service(_: VehicleContext) -> Service:
    """Return the service that holds no items."""
    return Service(
        requests={
            wire.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: _count,
            wire.MAVLINK_MSG_ID_MISSION_REQUEST: _no_such_item,
            wire.MAVLINK_MSG_ID_MISSION_REQUEST_INT: _no_such_item,
            wire.MAVLINK_MSG_ID_MISSION_COUNT: _take_none,
            wire.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: _refuse,
            wire.MAVLINK_MSG_ID_MISSION_ITEM: _refuse,
            wire.MAVLINK_MSG_ID_MISSION_ITEM_INT: _refuse,
            wire.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: _clear,
        }
    )


def _count(request: Message, client: Client) -> None:
    if request.mission_type not in _KINDS:
        _refuse(request, client)
        return
    client.send(
        wire.MAVLink_mission_count_message(
            request.get_srcSystem(), request.get_srcComponent(), 0, mission_type=request.mission_type
        )
    )


def _take_none(request: Message, client: Client) -> None:
    # A list of no items is stored as soon as it is announced.
    _acknowledge(request, client, wire.MAV_MISSION_UNSUPPORTED if request.count else wire.MAV_MISSION_ACCEPTED)


def _no_such_item(request: Message, client: Client) -> None:
    _acknowledge(request, client, wire.MAV_MISSION_INVALID_SEQUENCE)


def _refuse(request: Message, client: Client) -> None:
    _acknowledge(request, client, wire.MAV_MISSION_UNSUPPORTED)


def _clear(request: Message, client: Client) -> None:
    _acknowledge(request, client, wire.MAV_MISSION_ACCEPTED)


def _acknowledge(request: Message, client: Client, result: int) -> None:
    client.send(
        wire.MAVLink_mission_ack_message(
            request.get_srcSystem(), request.get_srcComponent(), result, mission_type=request.mission_type
        )
    )
