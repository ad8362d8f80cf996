"""Storage on board, of which there is none: no files, no logs, no missions, fences or rally points.

Every request is answered at once, so that clients need not wait for a time-out; flights are recorded in the journal.
MAVLink, file transfer and mission protocols, messages 39 to 47, 51, 73, 110, 117, 118.
"""

import struct
from collections.abc import Callable

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services.service import Service, VehicleContext, sender

_MISSION_KINDS = (wire.MAV_MISSION_TYPE_MISSION, wire.MAV_MISSION_TYPE_FENCE, wire.MAV_MISSION_TYPE_RALLY)
_HEADER = struct.Struct("<HBBB")  # file transfer: sequence, session, operation, bytes of data
_DATA = 12  # offset of the data
_LENGTH = 251
_FIRST_REPLY = 128  # operation codes from here on are replies
_NAK, _UNKNOWN_COMMAND = 129, 7  # NAK and its reason


def make_service(_: VehicleContext) -> Service:
    """Return the service of empty lists, which rejects every upload and every file operation."""
    unsupported = _acknowledge(wire.MAV_MISSION_UNSUPPORTED)
    return Service(
        requests={
            wire.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: _reject_file_operation,
            wire.MAVLINK_MSG_ID_LOG_REQUEST_LIST: _list_logs,
            wire.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: _send_mission_count,
            wire.MAVLINK_MSG_ID_MISSION_REQUEST: _acknowledge(wire.MAV_MISSION_INVALID_SEQUENCE),
            wire.MAVLINK_MSG_ID_MISSION_REQUEST_INT: _acknowledge(wire.MAV_MISSION_INVALID_SEQUENCE),
            wire.MAVLINK_MSG_ID_MISSION_COUNT: _answer_upload,
            wire.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: unsupported,
            wire.MAVLINK_MSG_ID_MISSION_ITEM: unsupported,
            wire.MAVLINK_MSG_ID_MISSION_ITEM_INT: unsupported,
            wire.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: _acknowledge(wire.MAV_MISSION_ACCEPTED),
        }
    )


def _list_logs(_: Message, client: Client) -> None:
    client.send(wire.MAVLink_log_entry_message(0, 0, 0, 0, 0))


def _reject_file_operation(request: Message, client: Client) -> None:
    sequence, session, operation, _ = _HEADER.unpack_from(bytes(request.payload))
    if operation < _FIRST_REPLY:
        answer = bytearray(_LENGTH)
        _HEADER.pack_into(answer, 0, (sequence + 1) % 2**16, session, _NAK, 1)
        answer[_HEADER.size], answer[_DATA] = operation, _UNKNOWN_COMMAND
        client.send(wire.MAVLink_file_transfer_protocol_message(0, *sender(request), answer))


def _send_mission_count(request: Message, client: Client) -> None:
    if request.mission_type in _MISSION_KINDS:
        client.send(wire.MAVLink_mission_count_message(*sender(request), 0, mission_type=request.mission_type))
    else:
        _acknowledge(wire.MAV_MISSION_UNSUPPORTED)(request, client)


def _answer_upload(request: Message, client: Client) -> None:
    # An upload of no items is complete with its announcement.
    _acknowledge(wire.MAV_MISSION_UNSUPPORTED if request.count else wire.MAV_MISSION_ACCEPTED)(request, client)


def _acknowledge(result: int) -> Callable[[Message, Client], None]:
    """Return the handler that answers a request of the mission protocol with a MAV_MISSION_RESULT."""
    return lambda request, client: client.send(
        wire.MAVLink_mission_ack_message(*sender(request), result, mission_type=request.mission_type)
    )
