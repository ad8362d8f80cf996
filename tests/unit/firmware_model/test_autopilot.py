import pytest

from firmware_model.autopilot import Autopilot, Event, Mode, Verdict

TIMEOUT = 1_000_000


@pytest.fixture
def autopilot() -> Autopilot:
    return Autopilot(TIMEOUT)


@pytest.mark.parametrize(
    ("mode", "number"),
    [
        (Mode.MANUAL, 0x0001_0000), (Mode.ALTCTL, 0x0002_0000), (Mode.POSCTL, 0x0003_0000), (Mode.HOLD, 0x0304_0000),
        (Mode.LAND, 0x0604_0000), (Mode.ACRO, 0x0005_0000), (Mode.OFFBOARD, 0x0006_0000),
        (Mode.STABILIZED, 0x0007_0000),
    ],
)  # fmt: skip
def test_modes_have_the_numbers_of_px4(mode, number):
    assert mode.value == number


def test_offboard_is_refused_without_a_stream(autopilot):
    assert autopilot.set_mode(Mode.OFFBOARD, 0) is Verdict.NO_STREAM
    assert autopilot.mode is Mode.STABILIZED


def test_offboard_is_entered_while_the_stream_lives(autopilot):
    autopilot.setpoint(100)
    assert autopilot.set_mode(Mode.OFFBOARD, 100 + TIMEOUT - 1) is Verdict.ACCEPTED
    assert autopilot.mode is Mode.OFFBOARD


def test_stream_is_dead_when_the_time_out_is_full(autopilot):
    autopilot.setpoint(100)
    assert autopilot.set_mode(Mode.OFFBOARD, 100 + TIMEOUT) is Verdict.NO_STREAM


def test_lost_stream_in_offboard_enters_stabilized_once(autopilot):
    autopilot.setpoint(0)
    autopilot.set_mode(Mode.OFFBOARD, 0)
    assert autopilot.lose_stream() is Event.STREAM_LOST
    assert autopilot.mode is Mode.STABILIZED
    assert not autopilot.stream_alive(1)
    assert autopilot.lose_stream() is None


def test_lost_stream_outside_offboard_changes_nothing(autopilot):
    autopilot.set_mode(Mode.POSCTL, 0)
    assert autopilot.lose_stream() is None
    assert autopilot.mode is Mode.POSCTL


@pytest.mark.parametrize("mode", [Mode.ACRO, Mode.LAND])
def test_mode_that_is_not_modelled_is_refused(autopilot, mode):
    assert autopilot.set_mode(mode, 0) is Verdict.NOT_FLOWN


def test_disarming_is_refused_in_flight_only(autopilot):
    assert autopilot.arm() is Verdict.ACCEPTED
    assert autopilot.disarm() is Verdict.ACCEPTED
    autopilot.arm()
    autopilot.take_off()
    assert autopilot.disarm() is Verdict.IN_FLIGHT
    assert autopilot.armed
    autopilot.land()
    assert not autopilot.armed


@pytest.mark.parametrize("text", [item.value for item in (*Verdict, *Event)])
def test_texts_fit_a_statustext(text):
    assert len(text.encode()) <= 50
