"""Logs on board: an empty list; flights are recorded in the journal.

References
----------
MAVLink, messages 117, 118.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Client, Service, VehicleContext


def make_service(_: VehicleContext) -> Service:
    """Return the service of an empty log list."""

    def list_logs(_: Message, client: Client) -> None:
        client.send(wire.MAVLink_log_entry_message(0, 0, 0, 0, 0))

    return Service(requests={wire.MAVLINK_MSG_ID_LOG_REQUEST_LIST: list_logs})
