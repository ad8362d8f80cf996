import math
import struct

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.services import parameters

REAL, INTEGER = wire.MAV_PARAM_TYPE_REAL32, wire.MAV_PARAM_TYPE_INT32


def whole(number: int) -> float:
    return struct.unpack("<f", struct.pack("<i", number))[0]


@pytest.fixture
def service(craft):
    return parameters.make_service(craft)


def test_list_has_every_parameter_once_and_in_order(service, craft, ask):
    listed = ask(service, wire.MAVLink_param_request_list_message(1, 1))
    assert [value.param_id for value in listed] == [parameter.name for parameter in craft.parameters.table]
    assert [value.param_index for value in listed] == list(range(len(listed)))
    assert {value.param_count for value in listed} == {len(listed)}


@pytest.mark.parametrize(("name", "index"), [(b"COM_OF_LOSS_T", -1), (b"", 4)])
def test_parameter_is_read_by_name_and_by_index(service, ask, name, index):
    (value,) = ask(service, wire.MAVLink_param_request_read_message(1, 1, name, index))
    assert (value.param_id, value.param_value, value.param_index) == ("COM_OF_LOSS_T", 1.0, 4)


def test_first_and_last_parameter_are_read_by_index(service, craft, ask):
    names = [parameter.name for parameter in craft.parameters.table]
    for index in (0, len(names) - 1):
        (value,) = ask(service, wire.MAVLink_param_request_read_message(1, 1, b"", index))
        assert (value.param_id, value.param_index) == (names[index], index)
    (error,) = ask(service, wire.MAVLink_param_request_read_message(1, 1, b"", len(names)))
    assert error.error == wire.MAV_PARAM_ERROR_DOES_NOT_EXIST


@pytest.mark.parametrize(("name", "index"), [(b"NOPE", -1), (b"", 999), (b"COM_OF_LOSS_T", -2)])
def test_unknown_parameter_is_refused_at_once(service, ask, name, index):
    (error,) = ask(service, wire.MAVLink_param_request_read_message(1, 1, name, index))
    assert (error.get_type(), error.error) == ("PARAM_ERROR", wire.MAV_PARAM_ERROR_DOES_NOT_EXIST)


def test_set_acts_and_is_told_to_all(service, craft, ask):
    assert ask(service, wire.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", whole(4), INTEGER)) == []
    assert craft.parameters["COM_OBL_RC_ACT"] == 4
    (value,) = craft.shared.take()
    assert struct.pack("<f", value.param_value) == (4).to_bytes(4, "little")
    assert craft.applied == 1


@pytest.mark.parametrize(
    ("name", "value", "kind", "error"),
    [
        (b"NOPE", 1.0, REAL, 1),
        (b"COM_OF_LOSS_T", math.nan, REAL, 2),
        (b"COM_OF_LOSS_T", 61.0, REAL, 2),
        (b"COM_OBL_RC_ACT", whole(3), INTEGER, 2),
        (b"GP_TRQ_MAX_R", 1.0, REAL, 5),
        (b"COM_OBL_RC_ACT", 4.0, REAL, 7),
        (b"COM_OF_LOSS_T", 2.0, INTEGER, 7),
    ],
)
def test_refused_value_is_named_and_nothing_acts(service, craft, ask, name, value, kind, error):
    answers = ask(service, wire.MAVLink_param_set_message(1, 1, name, value, kind))
    assert answers[0].get_type() == "PARAM_ERROR"
    assert (answers[0].param_id.encode(), answers[0].error) == (name, error)
    assert (craft.applied, craft.shared.sent) == (0, [])
    assert bool(craft.texts) is (error != 1)
