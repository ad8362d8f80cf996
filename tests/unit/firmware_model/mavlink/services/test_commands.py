import math

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.services import commands
from firmware_model.mavlink.services.service import ACCEPTED, TEMPORARILY_REJECTED, CommandAck

LAND, UNKNOWN = wire.MAV_CMD_NAV_LAND, wire.MAV_CMD_NAV_WAYPOINT


@pytest.fixture
def orders() -> list:
    return []


@pytest.fixture
def service(craft, orders):
    return commands.make_service(craft, {LAND: lambda order, _: orders.append(order) or ACCEPTED})


def test_long_command_that_gives_nothing_has_no_numbers(service, ask, orders):
    (answer,) = ask(service, wire.MAVLink_command_long_message(1, 1, LAND, 0, *[math.nan] * 6, math.inf))
    assert orders[0].params == (None,) * 7
    assert (answer.get_type(), answer.command, answer.result) == ("COMMAND_ACK", LAND, 0)
    assert (answer.target_system, answer.target_component) == (255, 190)


@pytest.mark.parametrize(("frame", "relative"), [(0, False), (3, True), (5, False), (6, True)])
def test_place_in_an_int_command_is_in_degrees(service, ask, orders, frame, relative):
    ask(
        service,
        wire.MAVLink_command_int_message(
            1, 1, frame, LAND, 0, 0, 1.0, math.nan, 2.0, 3.0, 473_977_420, -85_455_940, 10.0
        ),
    )
    assert orders[0].params == pytest.approx((1.0, None, 2.0, 3.0, 47.397742, -8.545594, 10.0))
    assert orders[0].relative is relative


def test_unset_place_in_an_int_command_is_none(service, ask, orders):
    ask(
        service,
        wire.MAVLink_command_int_message(1, 1, 5, LAND, 0, 0, 0.0, 0.0, 0.0, 0.0, 2**31 - 1, 2**31 - 1, math.nan),
    )
    assert orders[0].params[4:] == (None, None, None)


def test_unknown_command_is_unsupported(service, ask):
    (answer,) = ask(service, wire.MAVLink_command_long_message(1, 1, UNKNOWN, 0, *[0.0] * 7))
    assert answer.result == wire.MAV_RESULT_UNSUPPORTED


@pytest.mark.parametrize(("component", "name"), [(154, "gimbal"), (169, "winch")])
def test_command_to_a_component_that_is_not_there_is_unsupported(service, craft, ask, orders, component, name):
    (answer,) = ask(service, wire.MAVLink_command_long_message(1, component, LAND, 0, *[0.0] * 7))
    assert answer.result == wire.MAV_RESULT_UNSUPPORTED
    assert (craft.texts, orders) == ([f"this vehicle has no {name}"], [])


def test_refusal_is_told_to_all(craft, ask):
    service = commands.make_service(
        craft, {LAND: lambda _order, _client: CommandAck(TEMPORARILY_REJECTED, "not in the rain")}
    )
    (answer,) = ask(service, wire.MAVLink_command_long_message(1, 1, LAND, 0, *[0.0] * 7))
    assert answer.result == wire.MAV_RESULT_TEMPORARILY_REJECTED
    assert craft.texts == ["not in the rain"]
