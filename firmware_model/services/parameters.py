"""The parameter service: read one, list all, set one; every request is answered.

References
----------
MAVLink, parameter protocol, messages 20 to 23 and 345.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.frames import Message
from firmware_model.params import Parameters, Refusal
from firmware_model.services.service import Client, Craft, Service

_ERRORS = {
    Refusal.READ_ONLY: wire.MAV_PARAM_ERROR_READ_ONLY,
    Refusal.OUT_OF_RANGE: wire.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE,
}


def service(craft: Craft) -> Service:
    """Return the service of the craft's parameters."""
    parameters = craft.parameters

    def list_all(_: Message, client: Client) -> None:
        for parameter in parameters.table:
            client.send(_value(parameters, parameter.name))

    def read(request: Message, client: Client) -> None:
        name = request.param_id
        if 0 <= request.param_index < len(parameters.table):
            name = parameters.table[request.param_index].name
        known = parameters.index(name) is not None
        client.send(_value(parameters, name) if known else _error(request, wire.MAV_PARAM_ERROR_DOES_NOT_EXIST))

    def write(request: Message, client: Client) -> None:
        name = request.param_id
        if parameters.index(name) is None:
            client.send(_error(request, wire.MAV_PARAM_ERROR_DOES_NOT_EXIST))
            return
        refusal = parameters.set_wire_value(name, request.param_value)
        if refusal is None:
            craft.apply_parameters()
        # Whoever shows parameters must hear of a change that another one made.
        craft.broadcast(_value(parameters, name))
        if refusal is not None:
            client.send(_error(request, _ERRORS[refusal]))

    return Service(
        requests={
            wire.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: list_all,
            wire.MAVLINK_MSG_ID_PARAM_REQUEST_READ: read,
            wire.MAVLINK_MSG_ID_PARAM_SET: write,
        }
    )


def _value(parameters: Parameters, name: str) -> Message:
    value, integer = parameters.wire_value(name)
    kind = wire.MAV_PARAM_TYPE_INT32 if integer else wire.MAV_PARAM_TYPE_REAL32
    return wire.MAVLink_param_value_message(name.encode(), value, kind, len(parameters.table), parameters.index(name))


def _error(request: Message, error: int) -> Message:
    name = request.param_id.encode("ascii", "replace")[:16]
    return wire.MAVLink_param_error_message(request.get_srcSystem(), request.get_srcComponent(), name, -1, error)
