"""File transfer: reject every request at once, so that clients need not wait for a time-out.

References
----------
MAVLink, file transfer protocol, message 110: payload header, error codes.
"""

import struct

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Client, Service, VehicleContext

_HEADER = struct.Struct("<HBBB")  # sequence, session, operation, bytes of data
_DATA = 12  # offset of the data
_LENGTH = 251
_FIRST_REPLY = 128  # operation codes from here on are replies
_NAK, _UNKNOWN_COMMAND = 129, 7  # NAK and its reason


def make_service(_: VehicleContext) -> Service:
    """Return the service that rejects every file operation."""

    def reject(request: Message, client: Client) -> None:
        sequence, session, operation, _ = _HEADER.unpack_from(bytes(request.payload))
        if operation >= _FIRST_REPLY:
            return
        answer = bytearray(_LENGTH)
        _HEADER.pack_into(answer, 0, (sequence + 1) % 2**16, session, _NAK, 1)
        answer[_HEADER.size], answer[_DATA] = operation, _UNKNOWN_COMMAND
        sender = request.get_srcSystem(), request.get_srcComponent()
        client.send(wire.MAVLink_file_transfer_protocol_message(0, *sender, answer))

    return Service(requests={wire.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: reject})
