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
from firmware_model.mavlink.services.service import Service, VehicleContext, merge_services

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


def make_services(craft: VehicleContext) -> Service:
    """Return all services of a craft as one."""
    parts = merge_services(group.make_service(craft) for group in _GROUPS)
    return merge_services([parts, commands.make_service(craft, parts.commands)])
