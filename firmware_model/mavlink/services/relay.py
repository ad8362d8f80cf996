"""Relay: forward HEARTBEAT and STATUSTEXT of the on-board controller to all other peers.

A ground station has a link to the vehicle only; the relay shows it the controller and the law that flies. Forwarded
messages have their own sequence numbers to each peer, so that no peer counts gaps for messages to others.

References
----------
MAVLink, messages 0, 253; routing.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.messages import CONTROLLER
from firmware_model.mavlink.services.service import Client, Service, VehicleContext


def make_service(context: VehicleContext) -> Service:
    """Return the service that forwards the controller's heartbeats and texts."""

    def relay(message: Message, client: Client) -> None:
        if (message.get_srcSystem(), message.get_srcComponent()) == (context.system, CONTROLLER):
            context.relay(message, client)

    return Service(requests={wire.MAVLINK_MSG_ID_HEARTBEAT: relay, wire.MAVLINK_MSG_ID_STATUSTEXT: relay})
