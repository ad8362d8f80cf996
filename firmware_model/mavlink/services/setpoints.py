"""Echo of the tracked set-points to all peers.

References
----------
MAVLink, messages 83, 140.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Service, Stream, VehicleContext
from firmware_model.types import AttitudeTarget, TorqueCommand


def make_service(context: VehicleContext) -> Service:
    """Return the service that echoes the set-points."""

    def attitude() -> Message | None:
        return messages.echo_message(context.setpoint) if isinstance(context.setpoint, AttitudeTarget) else None

    def torque() -> Message | None:
        return messages.echo_message(context.setpoint) if isinstance(context.setpoint, TorqueCommand) else None

    return Service(
        streams={
            wire.MAVLINK_MSG_ID_ATTITUDE_TARGET: Stream(attitude, 100_000),
            wire.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET: Stream(torque, 100_000),
        }
    )
