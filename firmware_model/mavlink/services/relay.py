"""The on-board controller's voice: its HEARTBEAT and its STATUSTEXT, passed on to all other peers.

A ground station knows the vehicle's link only; so it sees that there is a controller, and hears which law flies. What
is passed on has sequence numbers of its own to each peer, so that nobody misses what was not meant for him.

References
----------
MAVLink, messages 0, 253; routing.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.messages import CONTROLLER
from firmware_model.mavlink.services.service import Client, Service, VehicleContext


def make_service(craft: VehicleContext) -> Service:
    """Return the service that passes on what the controller says to people."""

    def relay(message: Message, client: Client) -> None:
        if (message.get_srcSystem(), message.get_srcComponent()) == (craft.system, CONTROLLER):
            craft.relay(message, client)

    return Service(requests={wire.MAVLINK_MSG_ID_HEARTBEAT: relay, wire.MAVLINK_MSG_ID_STATUSTEXT: relay})
