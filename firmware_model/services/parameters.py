"""The parameter service: read one, list all, set one; every request is answered.

References
----------
MAVLink, parameter protocol, messages 20 to 23 and 345.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.frames import Message
from firmware_model.params import Parameters, Refusal

_ERRORS = {
    Refusal.READ_ONLY: wire.MAV_PARAM_ERROR_READ_ONLY,
    Refusal.OUT_OF_RANGE: wire.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE,
}


def replies(parameters: Parameters, request: Message) -> list[Message]:
    """Return the answers to PARAM_REQUEST_READ, PARAM_REQUEST_LIST or PARAM_SET."""
    kind = request.get_msgId()
    if kind == wire.MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
        return [_value(parameters, parameter.name) for parameter in parameters.table]
    name = request.param_id
    if kind == wire.MAVLINK_MSG_ID_PARAM_REQUEST_READ and 0 <= request.param_index < len(parameters.table):
        name = parameters.table[request.param_index].name
    if parameters.index(name) is None:
        return [_error(request, name, wire.MAV_PARAM_ERROR_DOES_NOT_EXIST)]
    if kind == wire.MAVLINK_MSG_ID_PARAM_SET:
        refusal = parameters.set_wire_value(name, request.param_value)
        if refusal is not None:
            return [_value(parameters, name), _error(request, name, _ERRORS[refusal])]
    return [_value(parameters, name)]


def _value(parameters: Parameters, name: str) -> Message:
    value, integer = parameters.wire_value(name)
    kind = wire.MAV_PARAM_TYPE_INT32 if integer else wire.MAV_PARAM_TYPE_REAL32
    return wire.MAVLink_param_value_message(name.encode(), value, kind, len(parameters.table), parameters.index(name))


def _error(request: Message, name: str, error: int) -> Message:
    return wire.MAVLink_param_error_message(
        request.get_srcSystem(), request.get_srcComponent(), name.encode("ascii", "replace")[:16], -1, error
    )
