"""The autopilot's decisions: no vehicle flies here, the test says where it is."""

import math
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.guidance import NavigationState
from firmware_model.autopilot.modes import (
    Autopilot,
    AutopilotEvent,
    FailSafe,
    LandedState,
    Mode,
    Settings,
    TransitionResult,
)
from firmware_model.types import (
    AttitudeTarget,
    Command,
    LevelFlight,
    MotorsOff,
    PositionTarget,
    Setpoint,
    TorqueCommand,
)

TIMEOUT = 1_000_000
ENTRY_GAP_US = 500_000  # 2 Hz, PX4's rule
LAND_DETECTION_US = 1_000_000
SAMPLE_US = 4_000
LEVEL_THRUST = AttitudeTarget(time_us=0, q_NB=(1.0, 0.0, 0.0, 0.0), omega_B=None, thrust=0.5)
TORQUE = TorqueCommand(time_us=0, torque_B=(0.0, 0.0, 0.0), throttle=None)


class Craft:
    """An autopilot that is told where it is, sample by sample."""

    def __init__(self, *, free: bool = True, **settings) -> None:
        self.autopilot = Autopilot(Settings(**settings), free=free)
        self.command: Command | None = None
        self.at(height=0.0)

    def at(
        self, north: float = 0.0, east: float = 0.0, *, height: float, yaw: float = 0.0, tilt: float = 0.0
    ) -> Setpoint:
        """Fly one sample there; the ground is at height 0."""
        self.now = NavigationState((north, east, -height), yaw, tilt, height <= 0.0)
        self.autopilot.clock_us += SAMPLE_US
        return self.autopilot.setpoint(self.command, self.now)

    def stay(self, us: int) -> Setpoint:
        """Fly on in the same place."""
        for _ in range(us // SAMPLE_US):
            self.autopilot.clock_us += SAMPLE_US
            flown = self.autopilot.setpoint(self.command, self.now)
        return flown

    def fly_to(self, mode: Mode, height: float = 10.0) -> None:
        """Be in the air in a mode."""
        assert self.autopilot.arm() is TransitionResult.ACCEPTED
        assert self.autopilot.take_off(height) is TransitionResult.ACCEPTED
        self.at(height=0.5 * height)
        self.at(height=height)
        if mode is Mode.OFFBOARD:
            self.autopilot.on_setpoint()
            self.command = LEVEL_THRUST
        assert self.autopilot.set_mode(mode) is TransitionResult.ACCEPTED
        self.autopilot.take_events()


@pytest.fixture
def craft() -> Craft:
    return Craft()


@pytest.fixture
def autopilot(craft) -> Autopilot:
    return craft.autopilot


@pytest.mark.parametrize(
    ("mode", "number"),
    [
        (Mode.MANUAL, 0x0001_0000), (Mode.ALTCTL, 0x0002_0000), (Mode.POSCTL, 0x0003_0000), (Mode.HOLD, 0x0304_0000),
        (Mode.TAKEOFF, 0x0204_0000), (Mode.RETURN, 0x0504_0000), (Mode.LAND, 0x0604_0000), (Mode.ACRO, 0x0005_0000),
        (Mode.OFFBOARD, 0x0006_0000), (Mode.STABILIZED, 0x0007_0000),
    ],
)  # fmt: skip
def test_modes_have_the_numbers_of_px4(mode, number):
    assert mode.value == number


@pytest.mark.parametrize("name", ["ON_GROUND", "IN_AIR", "TAKEOFF", "LANDING"])
def test_landed_states_have_the_numbers_of_mavlink(name):
    assert LandedState[name].value == getattr(wire, f"MAV_LANDED_STATE_{name}")


@pytest.mark.parametrize("text", [item.value for item in (*TransitionResult, *AutopilotEvent)])
def test_texts_fit_a_statustext(text):
    assert len(text.encode()) <= 50


# The off-board stream.


def test_offboard_is_refused_without_a_stream(autopilot):
    assert autopilot.set_mode(Mode.OFFBOARD) is TransitionResult.NO_STREAM
    assert autopilot.mode is Mode.STABILIZED


def test_offboard_is_entered_only_while_the_stream_is_faster_than_2_hz(autopilot):
    autopilot.on_setpoint()
    autopilot.clock_us += ENTRY_GAP_US
    assert autopilot.set_mode(Mode.OFFBOARD) is TransitionResult.NO_STREAM
    autopilot.clock_us -= 1
    assert autopilot.set_mode(Mode.OFFBOARD) is TransitionResult.ACCEPTED
    assert autopilot.mode is Mode.OFFBOARD


def test_stream_is_dead_when_the_time_out_is_full(autopilot):
    autopilot.on_setpoint()
    autopilot.clock_us += TIMEOUT - 1
    assert autopilot.is_stream_alive
    autopilot.clock_us += 1
    assert not autopilot.is_stream_alive


def test_time_out_may_be_changed_in_flight(autopilot):
    autopilot.on_setpoint()
    autopilot.clock_us += 300_000
    autopilot.settings = replace(autopilot.settings, stream_timeout_us=200_000)
    assert not autopilot.is_stream_alive


@pytest.mark.parametrize(
    ("fail_safe", "mode", "event", "flown"),
    [
        (FailSafe.STABILIZED, Mode.STABILIZED, AutopilotEvent.LOST_STABILIZED, LevelFlight()),
        (FailSafe.LAND, Mode.LAND, AutopilotEvent.LOST_LAND, PositionTarget((3.0, 4.0, -10.0), 0.7, 1.5)),
        (FailSafe.HOLD, Mode.HOLD, AutopilotEvent.LOST_HOLD, PositionTarget((3.0, 4.0, -10.0), 0.7, None)),
    ],
)
def test_lost_stream_in_offboard_enters_the_fail_safe_once(fail_safe, mode, event, flown):
    craft = Craft(fail_safe=fail_safe)
    craft.fly_to(Mode.OFFBOARD)
    assert craft.at(3.0, 4.0, height=10.0, yaw=0.7) is LEVEL_THRUST
    craft.autopilot.on_stream_lost()
    craft.autopilot.on_stream_lost()
    assert craft.autopilot.take_events() == [event]
    assert event.is_critical
    assert craft.autopilot.mode is mode
    assert craft.autopilot.in_fail_safe
    assert craft.stay(SAMPLE_US) == flown


def test_lost_stream_outside_offboard_changes_nothing(craft, autopilot):
    craft.fly_to(Mode.POSCTL)
    autopilot.on_stream_lost()
    assert autopilot.mode is Mode.POSCTL
    assert not autopilot.in_fail_safe
    assert autopilot.take_events() == []


def test_lost_stream_on_the_ground_leaves_offboard_and_arming_possible():
    craft = Craft(fail_safe=FailSafe.LAND)
    craft.autopilot.on_setpoint()
    craft.autopilot.set_mode(Mode.OFFBOARD)
    craft.autopilot.on_stream_lost()
    assert craft.autopilot.take_events() == [AutopilotEvent.LOST_ON_GROUND]
    assert craft.autopilot.mode is Mode.HOLD
    assert craft.autopilot.arm() is TransitionResult.ACCEPTED


def test_returning_stream_is_told_once_and_not_flown_until_offboard_is_asked_for_again(craft, autopilot):
    craft.fly_to(Mode.OFFBOARD)
    autopilot.on_stream_lost()
    autopilot.take_events()
    for told in ([AutopilotEvent.STREAM_BACK], []):
        autopilot.on_setpoint()
        assert autopilot.take_events() == told
    assert craft.stay(SAMPLE_US) == LevelFlight()
    assert autopilot.set_mode(Mode.OFFBOARD) is TransitionResult.ACCEPTED
    assert craft.stay(SAMPLE_US) is LEVEL_THRUST
    assert not autopilot.in_fail_safe


def test_pilot_takes_the_vehicle_from_a_living_stream_and_gives_it_back(craft, autopilot):
    craft.fly_to(Mode.OFFBOARD)
    assert autopilot.hold() is TransitionResult.ACCEPTED
    assert isinstance(craft.stay(SAMPLE_US), PositionTarget)
    autopilot.on_setpoint()
    assert isinstance(craft.stay(SAMPLE_US), PositionTarget)
    assert autopilot.set_mode(Mode.OFFBOARD) is TransitionResult.ACCEPTED
    assert craft.stay(SAMPLE_US) is LEVEL_THRUST


@pytest.mark.parametrize("mode", [Mode.STABILIZED, Mode.HOLD])
def test_pilot_who_takes_over_ends_the_fail_safe(craft, autopilot, mode):
    craft.fly_to(Mode.OFFBOARD)
    autopilot.on_stream_lost()
    autopilot.set_mode(mode)
    assert not autopilot.in_fail_safe


# Arming and disarming.


def test_arming_and_disarming_on_the_ground(autopilot):
    for _ in range(2):
        assert autopilot.arm() is TransitionResult.ACCEPTED
        assert autopilot.armed
        assert autopilot.disarm() is TransitionResult.ACCEPTED
        assert not autopilot.armed


def test_disarming_is_refused_in_the_air_and_done_by_force(craft, autopilot):
    craft.fly_to(Mode.HOLD)
    assert autopilot.disarm() is TransitionResult.IN_FLIGHT
    assert autopilot.armed
    assert autopilot.disarm(force=True) is TransitionResult.ACCEPTED
    assert craft.stay(SAMPLE_US) == MotorsOff()
    assert autopilot.landed_state is LandedState.IN_AIR  # it falls
    craft.at(height=0.0)
    craft.stay(LAND_DETECTION_US)
    assert autopilot.landed_state is LandedState.ON_GROUND


def test_arming_is_refused_in_a_landing_mode(craft, autopilot):
    autopilot.set_mode(Mode.LAND)
    assert autopilot.arm() is TransitionResult.LANDING_MODE
    autopilot.set_mode(Mode.HOLD)
    assert autopilot.arm() is TransitionResult.ACCEPTED


def test_arming_is_refused_in_offboard_whose_stream_has_stopped(autopilot):
    autopilot.on_setpoint()
    autopilot.set_mode(Mode.OFFBOARD)
    autopilot.clock_us += TIMEOUT
    assert autopilot.arm() is TransitionResult.NO_STREAM


def test_an_autopilot_that_was_told_nothing_yet_stands_level():
    fresh = Autopilot(Settings(), free=True)
    assert (fresh.take_off(None), fresh.arm()) == (TransitionResult.ACCEPTED, TransitionResult.ACCEPTED)


def test_arming_and_take_off_are_refused_to_a_vehicle_on_its_side(craft, autopilot):
    for more, found in ((1e-9, TransitionResult.TIPPED), (0.0, TransitionResult.ACCEPTED)):
        craft.at(height=0.0, tilt=math.radians(45.0) + more)
        assert (autopilot.take_off(None), autopilot.arm()) == (found, found)


def test_armed_vehicle_on_the_ground_keeps_its_motors_off_and_stays_armed(craft, autopilot):
    autopilot.arm()
    for mode in (Mode.STABILIZED, Mode.POSCTL, Mode.HOLD):
        autopilot.set_mode(mode)
        assert craft.stay(20_000_000) == MotorsOff()
    assert autopilot.armed
    assert autopilot.landed_state is LandedState.ON_GROUND


# Take-off, hold, landing, return.


def test_take_off_climbs_over_the_spot_and_holds_there(craft, autopilot):
    craft.at(1.0, 2.0, height=0.0, yaw=0.3)
    autopilot.arm()
    assert autopilot.take_off(10.0) is TransitionResult.ACCEPTED
    assert craft.stay(SAMPLE_US) == PositionTarget((1.0, 2.0, -10.0), 0.3, None)
    assert autopilot.landed_state is LandedState.TAKEOFF
    craft.at(1.0, 2.0, height=9.0, yaw=0.3)
    assert autopilot.mode is Mode.TAKEOFF
    assert craft.at(1.1, 2.0, height=9.8, yaw=0.5) == PositionTarget((1.0, 2.0, -10.0), 0.3, None)
    assert autopilot.mode is Mode.HOLD
    assert autopilot.landed_state is LandedState.IN_AIR
    assert autopilot.take_events() == [AutopilotEvent.HEIGHT_REACHED]
    assert craft.at(3.0, 2.0, height=9.8) == PositionTarget(
        (1.0, 2.0, -10.0), 0.3, None
    )  # where it was to be, not where it is


def test_take_off_waits_for_arming(craft, autopilot):
    assert autopilot.set_mode(Mode.TAKEOFF) is TransitionResult.ACCEPTED
    assert craft.stay(5_000_000) == MotorsOff()
    assert autopilot.landed_state is LandedState.ON_GROUND
    assert autopilot.arm() is TransitionResult.ACCEPTED
    assert craft.stay(SAMPLE_US) == PositionTarget((0.0, 0.0, -2.5), 0.0, None)


@pytest.mark.parametrize("height", [math.nextafter(1.0, 0.0), -10.0, math.nextafter(500.0, 501.0), math.nan, math.inf])
def test_take_off_to_nowhere_is_refused(autopilot, height):
    assert autopilot.take_off(height) is TransitionResult.HEIGHT
    assert autopilot.mode is Mode.STABILIZED


@pytest.mark.parametrize("height", [1.0, 500.0])
def test_take_off_to_either_end_of_the_range_is_accepted(autopilot, height):
    assert autopilot.take_off(height) is TransitionResult.ACCEPTED


def test_take_off_in_the_air_is_refused_but_a_repeated_request_is_not(craft, autopilot):
    autopilot.arm()
    autopilot.take_off(10.0)
    craft.at(height=5.0)
    assert autopilot.take_off(10.0) is TransitionResult.ACCEPTED
    assert autopilot.take_off(20.0) is TransitionResult.AIRBORNE
    craft.at(height=10.0)
    assert autopilot.take_off(10.0) is TransitionResult.AIRBORNE


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.POSCTL])
def test_hold_stays_where_it_was_asked_for(craft, autopilot, mode):
    craft.fly_to(Mode.STABILIZED)
    craft.at(5.0, 6.0, height=7.0, yaw=-1.0)
    autopilot.set_mode(mode)
    asked = craft.stay(SAMPLE_US)
    assert asked == PositionTarget((5.0, 6.0, -7.0), -1.0, None)
    autopilot.set_mode(mode)
    assert craft.at(8.0, 9.0, height=4.0) == asked


@pytest.mark.parametrize("mode", [Mode.STABILIZED, Mode.ALTCTL, Mode.MANUAL])
def test_level_modes_do_not_hold_the_place(craft, mode):
    craft.fly_to(mode)
    assert craft.at(5.0, 6.0, height=7.0) == LevelFlight()


def test_landing_slows_down_near_the_ground_and_disarms_on_it(craft, autopilot):
    craft.fly_to(Mode.HOLD, height=20.0)
    autopilot.land()
    sinking = [craft.at(height=height) for height in (20.0, 3.0, 0.5)]
    assert [(leg.position_N[:2], leg.v_down) for leg in sinking] == [
        ((0.0, 0.0), 1.5),
        ((0.0, 0.0), pytest.approx(0.9)),
        ((0.0, 0.0), 0.5),
    ]
    assert autopilot.landed_state is LandedState.LANDING
    craft.at(height=0.0)
    craft.stay(LAND_DETECTION_US - SAMPLE_US)
    assert autopilot.armed
    assert craft.stay(SAMPLE_US) == MotorsOff()
    assert (autopilot.armed, autopilot.mode, autopilot.landed_state) == (False, Mode.HOLD, LandedState.ON_GROUND)
    assert autopilot.take_events() == [AutopilotEvent.LANDED]


def test_bounce_is_not_a_landing(craft, autopilot):
    craft.fly_to(Mode.LAND)
    for _ in range(3):
        craft.at(height=0.0)
        craft.stay(LAND_DETECTION_US // 2)
        craft.at(height=0.1)
    assert autopilot.armed


def test_ground_in_another_mode_stops_the_motors_and_does_not_disarm(craft, autopilot):
    craft.fly_to(Mode.STABILIZED)
    craft.at(height=0.0)
    assert craft.stay(LAND_DETECTION_US) == MotorsOff()
    assert autopilot.armed
    assert autopilot.landed_state is LandedState.ON_GROUND


def test_return_climbs_flies_home_lands_and_disarms(craft, autopilot):
    craft.at(1.0, 1.0, height=0.0)
    craft.fly_to(Mode.STABILIZED, height=5.0)
    craft.at(30.0, 40.0, height=5.0)
    assert autopilot.return_home() is TransitionResult.ACCEPTED
    assert craft.stay(SAMPLE_US).position_N == (30.0, 40.0, -15.0)
    assert craft.at(30.0, 40.0, height=14.8).position_N == (1.0, 1.0, -15.0)
    assert autopilot.landed_state is LandedState.IN_AIR
    down = craft.at(1.2, 1.2, height=15.0)
    assert (down.position_N[:2], down.v_down) == ((1.0, 1.0), 1.5)
    assert autopilot.landed_state is LandedState.LANDING
    craft.at(1.0, 1.0, height=0.0)
    craft.stay(LAND_DETECTION_US)
    assert not autopilot.armed


def test_return_from_above_home_only_descends(craft):
    craft.fly_to(Mode.RETURN, height=5.0)
    assert craft.stay(SAMPLE_US).v_down == 1.5


def test_return_stays_as_high_as_it_is(craft):
    craft.fly_to(Mode.STABILIZED, height=40.0)
    craft.at(30.0, 0.0, height=40.0)
    craft.autopilot.return_home()
    craft.stay(SAMPLE_US)
    assert craft.stay(SAMPLE_US).position_N == (0.0, 0.0, -40.0)


# Off-board on the ground.


def test_offboard_takes_off_by_thrust_but_not_by_holding_height(craft, autopilot):
    autopilot.on_setpoint()
    autopilot.set_mode(Mode.OFFBOARD)
    autopilot.arm()
    craft.command = TORQUE
    assert craft.stay(SAMPLE_US) == MotorsOff()
    craft.command = LEVEL_THRUST
    assert craft.stay(SAMPLE_US) is LEVEL_THRUST
    craft.at(height=0.1)
    craft.command = TORQUE
    assert craft.stay(SAMPLE_US) is TORQUE
    assert autopilot.landed_state is LandedState.IN_AIR


def test_mode_that_is_not_modelled_is_refused(autopilot):
    assert autopilot.set_mode(Mode.ACRO) is TransitionResult.NOT_FLOWN


# The test stand.


def test_stand_is_free_while_armed_and_lands_by_levelling():
    craft = Craft(free=False)
    assert craft.stay(SAMPLE_US) == MotorsOff()
    craft.autopilot.arm()
    assert craft.stay(SAMPLE_US) == LevelFlight()
    assert craft.autopilot.landed_state is LandedState.IN_AIR
    assert craft.autopilot.disarm() is TransitionResult.IN_FLIGHT
    craft.autopilot.land()
    craft.at(height=10.0, tilt=0.1)
    assert craft.stay(2 * LAND_DETECTION_US) == LevelFlight()
    assert craft.autopilot.landed_state is LandedState.LANDING
    craft.at(height=10.0, tilt=math.nextafter(0.1, 0.0))
    craft.stay(LAND_DETECTION_US)
    assert craft.autopilot.landed_state is LandedState.ON_GROUND
    assert not craft.autopilot.armed


@pytest.mark.parametrize("mode", [Mode.TAKEOFF, Mode.RETURN])
def test_stand_does_not_travel(mode):
    assert Craft(free=False).autopilot.set_mode(mode) is TransitionResult.ON_STAND


def test_stand_flies_the_outside_controller():
    craft = Craft(free=False)
    craft.autopilot.on_setpoint()
    craft.autopilot.set_mode(Mode.OFFBOARD)
    craft.autopilot.arm()
    craft.command = TORQUE
    assert craft.stay(SAMPLE_US) is TORQUE


# A crash.


@pytest.mark.parametrize("mode", [Mode.OFFBOARD, Mode.HOLD, Mode.STABILIZED])
def test_vehicle_that_lies_on_its_rotors_for_two_seconds_is_disarmed_and_says_so(craft, autopilot, mode):
    craft.fly_to(mode)
    craft.at(height=0.0, tilt=math.radians(60.0) + 1e-9)
    craft.stay(2_000_000 - SAMPLE_US)
    assert autopilot.armed
    assert isinstance(craft.stay(SAMPLE_US), MotorsOff)
    assert (autopilot.armed, autopilot.airborne, autopilot.mode) == (False, False, Mode.HOLD)
    assert autopilot.take_events() == [AutopilotEvent.CRASHED]
    assert AutopilotEvent.CRASHED.is_critical
    assert not AutopilotEvent.CRASHED.is_fail_safe  # no set-points were lost
    craft.stay(5_000_000)
    assert autopilot.take_events() == []
    assert autopilot.arm() is TransitionResult.TIPPED


def test_crashed_vehicle_that_bounces_is_disarmed_too(craft, autopilot):
    craft.fly_to(Mode.HOLD)
    for k in range(600):
        craft.at(height=0.1 * (k % 7), tilt=2.0)
    assert not autopilot.armed


@pytest.mark.parametrize(("height", "tilt_deg"), [(0.0, 60.0), (0.5, 180.0)])
def test_leaning_vehicle_and_one_upside_down_in_the_air_fly_on(craft, autopilot, height, tilt_deg):
    craft.fly_to(Mode.HOLD)
    craft.at(height=height, tilt=math.radians(tilt_deg))
    craft.stay(10_000_000)
    assert autopilot.armed
    assert AutopilotEvent.CRASHED not in autopilot.take_events()


def test_vehicle_that_comes_upright_again_begins_its_two_seconds_anew(craft, autopilot):
    craft.fly_to(Mode.HOLD)
    for _ in range(4):
        craft.at(height=0.0, tilt=2.0)
        craft.stay(1_900_000)
        craft.at(height=0.0, tilt=0.5)
    assert autopilot.armed


def test_vehicle_on_the_stand_does_not_crash():
    craft = Craft(free=False)
    craft.autopilot.arm()
    craft.at(height=0.0, tilt=3.0)
    craft.stay(10_000_000)
    assert craft.autopilot.armed
