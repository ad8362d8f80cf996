"""MAVLink microservices, one module per group, without sockets. To add one, list it in `_GROUPS`."""

from firmware_model.mavlink.services import (
    clock,
    commands,
    identity,
    motion,
    outputs,
    parameters,
    piloting,
    position,
    refusals,
    status,
    storage,
    streams,
)
from firmware_model.mavlink.services.service import Service, VehicleContext, merge_services

_GROUPS = (clock, identity, motion, outputs, parameters, piloting, position, refusals, status, storage, streams)


def make_services(context: VehicleContext) -> Service:
    """Return all services of a vehicle, merged into one."""
    parts = merge_services(group.make_service(context) for group in _GROUPS)
    return merge_services([parts, commands.make_service(context, parts.commands)])
