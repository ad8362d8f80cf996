"""Parameter protocol: read, list and set; every request is answered.

MAVLink, parameter protocol, messages 20 to 23 and 345.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.parameters import ParameterRejectReason, Parameters
from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services.service import Service, VehicleContext, sender

_ERRORS = {
    ParameterRejectReason.READ_ONLY: wire.MAV_PARAM_ERROR_READ_ONLY,
    ParameterRejectReason.OUT_OF_RANGE: wire.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE,
    ParameterRejectReason.WRONG_TYPE: 7,  # MAV_PARAM_ERROR_TYPE_MISMATCH, younger than pymavlink's dialect
}
_NO_INDEX = -1


def make_service(context: VehicleContext) -> Service:
    """Return the service of the vehicle's parameters."""
    parameters = context.parameters

    def list_all(_: Message, client: Client) -> None:
        for parameter in parameters.table:
            client.send(_value_message(parameters, parameter.name))

    def read(request: Message, client: Client) -> None:
        index = request.param_index if request.param_index != _NO_INDEX else parameters.index(request.param_id)
        if index is not None and 0 <= index < len(parameters.table):
            client.send(_value_message(parameters, parameters.table[index].name))
        else:
            client.send(_error_message(request, request.param_index, wire.MAV_PARAM_ERROR_DOES_NOT_EXIST))

    def write(request: Message, client: Client) -> None:
        name = request.param_id
        if parameters.index(name) is None:
            client.send(_error_message(request, _NO_INDEX, wire.MAV_PARAM_ERROR_DOES_NOT_EXIST))
            return
        integer = request.param_type != wire.MAV_PARAM_TYPE_REAL32
        reason = parameters.set_wire_value(name, request.param_value, integer=integer)
        if reason is None:
            context.apply_parameters()
            # Every peer that displays parameters needs changes by other peers.
            context.broadcast(_value_message(parameters, name))
            return
        # Send the error first: a client that gets the old value first repeats its request. Then send the value, for
        # clients that ignore errors.
        client.send(_error_message(request, _NO_INDEX, _ERRORS[reason]))
        client.send(_value_message(parameters, name))
        allowed = parameters.table[parameters.index(name) or 0].allowed_text
        suffix = f": {allowed}" if reason is ParameterRejectReason.OUT_OF_RANGE else ""
        context.send_text(f"{name} {reason.value}{suffix}", wire.MAV_SEVERITY_WARNING)

    return Service(
        requests={
            wire.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: list_all,
            wire.MAVLINK_MSG_ID_PARAM_REQUEST_READ: read,
            wire.MAVLINK_MSG_ID_PARAM_SET: write,
        }
    )


def _value_message(parameters: Parameters, name: str) -> Message:
    value, integer = parameters.wire_value(name)
    kind = wire.MAV_PARAM_TYPE_INT32 if integer else wire.MAV_PARAM_TYPE_REAL32
    return wire.MAVLink_param_value_message(name.encode(), value, kind, len(parameters.table), parameters.index(name))


def _error_message(request: Message, index: int, error: int) -> Message:
    name = request.param_id.encode("ascii", "replace")[:16]
    return wire.MAVLink_param_error_message(*sender(request), name, index, error)
