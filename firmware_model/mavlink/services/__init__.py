"""MAVLink microservices, one file a group; each knows its own messages and no socket. A new one is a line here."""

from firmware_model.mavlink.services import (
    actuators,
    clock,
    commands,
    files,
    identity,
    logs,
    mission,
    modes,
    motion,
    parameters,
    piloting,
    position,
    refusals,
    relay,
    setpoints,
    status,
    streams,
)
from firmware_model.mavlink.services.service import Service, VehicleContext, combined

_GROUPS = (
    actuators,
    clock,
    files,
    identity,
    logs,
    mission,
    modes,
    motion,
    parameters,
    piloting,
    position,
    refusals,
    relay,
    setpoints,
    status,
    streams,
)


def composed(craft: VehicleContext) -> Service:
    """Return all services of a craft as one."""
    parts = combined(group.service(craft) for group in _GROUPS)
    return combined([parts, commands.service(craft, parts.commands)])
