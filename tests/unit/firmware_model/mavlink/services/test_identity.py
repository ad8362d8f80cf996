import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode, TransitionResult
from firmware_model.mavlink.services import identity

ALL = wire.MAVLINK_MSG_ID_AVAILABLE_MODES


@pytest.mark.parametrize("free", [True, False])
def test_modes_are_contiguous_unique_and_flown(craft, free):
    craft.autopilot.free = free
    shown = list(identity.make_service(craft).on_request[ALL](0))
    assert [mode.mode_index for mode in shown] == list(range(1, shown[0].number_modes + 1))
    assert len({mode.mode_name for mode in shown}) == len(shown)
    for mode in shown:
        craft.autopilot.on_setpoint()
        assert craft.autopilot.set_mode(Mode(mode.custom_mode)) is TransitionResult.ACCEPTED


def test_one_mode_is_shown_by_its_index(craft):
    show = identity.make_service(craft).on_request[ALL]
    (third,) = show(3)
    assert third.mode_index == 3
    assert show(0)[2].custom_mode == third.custom_mode
    assert show(99) == []


def test_present_mode_is_told(craft):
    craft.autopilot.set_mode(Mode.POSCTL)
    message = identity.make_service(craft).streams[wire.MAVLINK_MSG_ID_CURRENT_MODE].message()
    assert (message.custom_mode, message.standard_mode) == (3 << 16, wire.MAV_STANDARD_MODE_POSITION_HOLD)
