import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode, Settings, TransitionResult
from firmware_model.mavlink.services import identity, piloting

ACCEPTED, NOT_NOW, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
STANDARD = wire.MAV_CMD_DO_SET_STANDARD_MODE
ARM, MODE, TAKEOFF = wire.MAV_CMD_COMPONENT_ARM_DISARM, wire.MAV_CMD_DO_SET_MODE, wire.MAV_CMD_NAV_TAKEOFF


@pytest.fixture
def service(craft):
    return piloting.make_service(craft)


def test_arm_and_disarm(service, craft, order):
    assert order(service, ARM, 1.0) == (ACCEPTED, "")
    assert craft.autopilot.armed
    assert order(service, ARM, 0.0) == (ACCEPTED, "")
    assert not craft.autopilot.armed


def test_disarming_in_the_air_needs_force(service, craft, order):
    order(service, ARM, 1.0)
    craft.autopilot.airborne = True
    assert order(service, ARM, 0.0) == (NOT_NOW, TransitionResult.IN_FLIGHT.value)
    assert order(service, ARM, 0.0, 21196.0) == (ACCEPTED, "")
    assert not craft.autopilot.armed


def test_termination_stops_the_motors_and_is_not_taken_back(service, craft, order):
    order(service, ARM, 1.0)
    craft.autopilot.airborne = True
    assert order(service, wire.MAV_CMD_DO_FLIGHTTERMINATION, 0.0)[0] == DENIED
    assert order(service, wire.MAV_CMD_DO_FLIGHTTERMINATION, 1.0) == (ACCEPTED, "")
    assert not craft.autopilot.armed


@pytest.mark.parametrize(
    ("command", "numbers", "mode"),
    [
        (wire.MAV_CMD_NAV_LAND, (), Mode.LAND),
        (wire.MAV_CMD_NAV_RETURN_TO_LAUNCH, (), Mode.RETURN),
        (wire.MAV_CMD_NAV_LOITER_UNLIM, (), Mode.HOLD),
        (wire.MAV_CMD_DO_REPOSITION, (-1.0, 1.0), Mode.HOLD),  # QGroundControl's pause
        (MODE, (33.0, 4.0, 6.0), Mode.LAND),  # as MAVSDK asks
        (MODE, (1.0, 3.0), Mode.POSCTL),
    ],
)
def test_command_brings_its_mode(service, craft, order, command, numbers, mode):
    assert order(service, command, *numbers) == (ACCEPTED, "")
    assert craft.autopilot.mode is mode


def test_no_place_but_home_is_flown_to(service, craft, order):
    result, text = order(service, wire.MAV_CMD_DO_REPOSITION, -1.0, 1.0, None, None, 47.4, 8.5, 500.0)
    assert (result, bool(text)) == (UNSUPPORTED, True)
    assert craft.autopilot.mode is Mode.STABILIZED


@pytest.mark.parametrize(
    ("height", "relative", "flown", "texts"),
    [
        (None, False, 2.5, 0),  # MIS_TAKEOFF_ALT
        (498.0, False, 10.0, 0),  # above the sea; home is at 488 m
        (10.0, True, 10.0, 0),
        (488.05, False, 0.05, 0),
        (488.0, False, 2.5, 1),
        (10.0, False, 2.5, 1),  # underground; said and not flown
    ],
)
def test_take_off_height_counts_from_the_sea(service, craft, order, height, relative, flown, texts):
    asked = []
    craft.autopilot.take_off = lambda height: asked.append(height) or TransitionResult.ACCEPTED
    service = piloting.make_service(craft)
    assert order(service, TAKEOFF, None, None, None, None, None, None, height, relative=relative)[0] == ACCEPTED
    assert (asked[0] or Settings().takeoff_height) == pytest.approx(flown)
    assert len(craft.texts) == texts


def test_take_off_height_above_the_sea_is_counted_from_home(service, craft, order):
    craft.autopilot.home_N = (100.0, -200.0, -30.0)  # on a hill, at 518 m
    assert order(service, TAKEOFF, None, None, None, None, None, None, 530.0)[0] == ACCEPTED
    assert craft.autopilot._takeoff_height == pytest.approx(12.0)


@pytest.mark.parametrize("numbers", [(0.0, 7.0), (1.0,), (1.0, -7.0), (1.0, 5.0), (1.0, 99.0), (1.0, 4.0, 99.0)])
def test_mode_that_is_not_flown_is_denied_with_a_reason(service, craft, order, numbers):
    assert order(service, MODE, *numbers) == (DENIED, TransitionResult.NOT_FLOWN.value)


def test_piloting_refuses_modes_of_sticks_to_who_moves_some(service, craft, order, ask, peer):
    peer.moves_sticks = True
    for main in (2.0, 3.0):
        assert order(service, MODE, 1.0, main) == (NOT_NOW, TransitionResult.STICKS.value)
    ask(service, wire.MAVLink_set_mode_message(1, 1, Mode.POSCTL.value))
    assert craft.texts == [TransitionResult.STICKS.value]
    assert craft.autopilot.mode is Mode.STABILIZED
    assert order(service, MODE, 1.0, 4.0, 3.0) == (ACCEPTED, "")
    assert order(service, MODE, 1.0, 7.0) == (ACCEPTED, "")


def test_old_set_mode_is_obeyed_and_its_refusal_told(service, craft, ask):
    ask(service, wire.MAVLink_set_mode_message(1, 1, Mode.ALTCTL.value))
    assert craft.autopilot.mode is Mode.ALTCTL
    ask(service, wire.MAVLink_set_mode_message(1, 1, Mode.OFFBOARD.value))
    assert craft.texts == [TransitionResult.NO_STREAM.value]
    ask(service, wire.MAVLink_set_mode_message(1, 0, Mode.LAND.value))
    assert craft.autopilot.mode is Mode.ALTCTL


@pytest.mark.parametrize(
    ("number", "mode"),
    [
        (wire.MAV_STANDARD_MODE_POSITION_HOLD, Mode.POSCTL),
        (wire.MAV_STANDARD_MODE_ALTITUDE_HOLD, Mode.ALTCTL),
        (wire.MAV_STANDARD_MODE_SAFE_RECOVERY, Mode.RETURN),
        (wire.MAV_STANDARD_MODE_LAND, Mode.LAND),
        (wire.MAV_STANDARD_MODE_TAKEOFF, Mode.TAKEOFF),
    ],
)
def test_standard_mode_is_set_by_its_number(service, craft, order, number, mode):
    assert order(service, STANDARD, float(number)) == (ACCEPTED, "")
    assert craft.autopilot.mode is mode


@pytest.mark.parametrize("number", [None, 0.0, float(wire.MAV_STANDARD_MODE_ORBIT), 99.0, -1.0])
def test_standard_mode_that_this_vehicle_lacks_fails(service, craft, order, number):
    assert order(service, STANDARD, number) == (FAILED, TransitionResult.NOT_FLOWN.value)
    assert craft.autopilot.mode is Mode.STABILIZED


def test_every_standard_mode_that_is_announced_can_be_set(service, craft, order):
    shown = identity.make_service(craft).on_request[wire.MAVLINK_MSG_ID_AVAILABLE_MODES](0)
    announced = [each.standard_mode for each in shown if each.standard_mode]
    assert len(announced) == 5
    assert {order(service, STANDARD, float(number))[0] for number in announced} == {ACCEPTED}


def test_standard_mode_of_sticks_is_refused_to_who_moves_some(service, order, peer):
    peer.moves_sticks = True
    refused = (NOT_NOW, TransitionResult.STICKS.value)
    assert order(service, STANDARD, float(wire.MAV_STANDARD_MODE_POSITION_HOLD)) == refused
