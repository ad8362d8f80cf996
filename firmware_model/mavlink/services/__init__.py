"""MAVLink microservices, one module per group, without sockets. To add one, list it in `_GROUPS`."""

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


def make_services(context: VehicleContext) -> Service:
    """Return all services of a vehicle, merged into one."""
    parts = merge_services(group.make_service(context) for group in _GROUPS)
    return merge_services([parts, commands.make_service(context, parts.commands)])
