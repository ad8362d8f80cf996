"""Decide on arming, modes, the off-board stream, the fail-safe and the set-point of each sample.

No physics and no bytes: requests, clock and navigation state come in; results, events and set-points go out.

    disarmed --arm--> on the ground --TAKEOFF, or thrust in OFFBOARD--> in the air --LAND, RETURN--> disarmed

    any mode --set_mode(OFFBOARD), stream alive--> OFFBOARD --set_mode(another)--> that mode
                                                            --stream lost--> the fail-safe's mode

A stream that comes back changes no mode: OFFBOARD must be set again. There are no sticks: MANUAL, STABILIZED and ALTCTL
are level flight with altitude hold, and drift with the wind; POSCTL and HOLD stay in place.
"""

import math
from dataclasses import dataclass
from enum import Enum

from firmware_model.autopilot import guidance
from firmware_model.autopilot.guidance import Leg, NavigationState
from firmware_model.types import Command, LevelFlight, MotorsOff, Setpoint, TorqueCommand, Vector

ENTRY_GAP_US = 500_000
"""[us] largest age of the last set-point on entry to OFFBOARD: the stream must be faster than 2 Hz, PX4's rule."""
LAND_DETECTION_US = 1_000_000
"""[us] time on the ground, or level on the stand, that ends a landing."""
_LEVEL_TILT = 0.1  # [rad] tilt below which the vehicle on the stand is level
_MAX_ARMING_TILT = math.radians(45.0)  # [rad] tilt above which the vehicle lies on its side and arming is refused
_CRASH_TILT = math.radians(60.0)  # [rad] tilt beyond which a vehicle on the ground has crashed; PX4's FD_FAIL_R
_CRASH_DETECTION_US = 2_000_000  # [us] time at such a tilt that ends in disarming
_TAKEOFF_RANGE_M = (1.0, 500.0)  # [m] heights of a take-off


class Mode(Enum):
    """Flight modes by PX4's custom mode number, `main << 16 | sub << 24`."""

    MANUAL = 1 << 16
    """Level with altitude hold, because there are no sticks."""
    ALTCTL = 2 << 16
    """Level with altitude hold."""
    POSCTL = 3 << 16
    """Position held."""
    TAKEOFF = 4 << 16 | 2 << 24
    """Climb to the take-off height once armed, then HOLD."""
    HOLD = 4 << 16 | 3 << 24
    """Position held."""
    RETURN = 4 << 16 | 5 << 24
    """Climb to the return height, fly home, land there, disarm."""
    LAND = 4 << 16 | 6 << 24
    """Land here, disarm; on the stand: level, disarm."""
    ACRO = 5 << 16
    """Sticks as rates; not modelled."""
    OFFBOARD = 6 << 16
    """Set-points of an outside controller."""
    STABILIZED = 7 << 16
    """Level with altitude hold."""


class LandedState(Enum):
    """Phase of a flight, by MAV_LANDED_STATE's number."""

    ON_GROUND = 1
    """On its feet; on the stand: clamped."""
    IN_AIR = 2
    """In flight; on the stand: free in attitude."""
    TAKEOFF = 3
    """Climbing to the take-off height."""
    LANDING = 4
    """Descending to the ground."""


class FailSafe(Enum):
    """Action when the stream stops in OFFBOARD, by PX4's number in COM_OBL_RC_ACT."""

    STABILIZED = 2
    """Level with altitude hold."""
    LAND = 4
    """Land, disarm."""
    HOLD = 5
    """Stay in place."""


class TransitionResult(Enum):
    """Answer to a request; each value is a text of at most 50 characters, the length of STATUSTEXT."""

    ACCEPTED = "accepted"
    """Done, or already the case."""
    NO_STREAM = "OFFBOARD rejected: no usable set-points"
    """OFFBOARD, or arming in it, without a live stream."""
    IN_FLIGHT = "in the air: land first, or force it"
    """Disarming in the air."""
    AIRBORNE = "in the air: take-off refused"
    """Take-off in flight."""
    ON_STAND = "held on the test stand: refused"
    """Translation of a vehicle held on the stand."""
    HEIGHT = "take-off height must be 1 to 500 m"
    """Take-off to a height out of range."""
    LANDING_MODE = "in a landing mode: arming refused"
    """Arming in LAND or RETURN."""
    TIPPED = "tilted by more than 45 deg: motors stay off"
    """Arming on the side."""
    STICKS = "sticks are not flown: mode refused"
    """Stick mode requested by a client that moves sticks."""
    NOT_FLOWN = "this vehicle does not fly that mode"
    """Mode that is not modelled."""


class AutopilotEvent(Enum):
    """Event that no request caused; each value is a text of at most 50 characters, the length of STATUSTEXT."""

    LOST_STABILIZED = "set-points lost: failsafe STABILIZED"
    """The stream stopped in OFFBOARD; the vehicle levels."""
    LOST_LAND = "set-points lost: failsafe LAND"
    """The stream stopped in OFFBOARD; the vehicle lands."""
    LOST_HOLD = "set-points lost: failsafe HOLD"
    """The stream stopped in OFFBOARD; the vehicle stays in place."""
    LOST_ON_GROUND = "set-points stopped on the ground: HOLD"
    """The stream stopped in OFFBOARD before take-off."""
    STALLED = "set-points stalled: attitude held on board"
    """Torques or rates stopped for a moment; the vehicle holds its attitude until they are back."""
    STREAM_BACK = "set-points are back: OFFBOARD may be set again"
    """The stream is alive again, and is not flown."""
    HEIGHT_REACHED = "take-off height reached: HOLD"
    """The take-off is over."""
    LANDED = "landed: disarmed"
    """The landing is over."""
    CRASHED = "crashed: disarmed"
    """It lay on its side or back on the ground."""
    SLIPPED = "machine too slow: model time slips"
    """Real time: samples were late, and the delay is not caught up."""

    @property
    def is_fail_safe(self) -> bool:
        """True if it is a fail-safe."""
        return self in _FAIL_SAFE_EVENTS.values()

    @property
    def is_critical(self) -> bool:
        """True if it is a fail-safe, or a crash."""
        return self.is_fail_safe or self is AutopilotEvent.CRASHED


_FAIL_SAFE_EVENTS = dict(
    zip(FailSafe, (AutopilotEvent.LOST_STABILIZED, AutopilotEvent.LOST_LAND, AutopilotEvent.LOST_HOLD), strict=True)
)
_LEVEL_MODES = frozenset({Mode.MANUAL, Mode.ALTCTL, Mode.STABILIZED})
_LANDING_MODES = frozenset({Mode.LAND, Mode.RETURN})
_OFFBOARD = Mode.OFFBOARD  # looked up several times a sample, and a member of an Enum takes .1 us


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Settings that may be changed in flight."""

    stream_timeout_us: int = 1_000_000
    """[us] of the autopilot's clock without set-points, until the fail-safe (COM_OF_LOSS_T)."""
    fail_safe: FailSafe = FailSafe.STABILIZED
    """Action of the fail-safe (COM_OBL_RC_ACT)."""
    takeoff_height: float = 2.5
    """[m] above home, default height of a take-off (MIS_TAKEOFF_ALT)."""
    return_height: float = 15.0
    """[m] above home, least height of the return (RTL_RETURN_ALT)."""
    land_speed: float = 0.5
    """[m/s] down, near the ground (MPC_LAND_SPEED)."""


class Autopilot:
    """Arming state, mode and off-board stream of one vehicle, free to fly or on the stand.

    The caller sets `clock_us` before every call: model time, or wall time while model time stands still.
    """

    def __init__(self, settings: Settings, *, free: bool) -> None:
        self.settings, self.free = settings, free
        self.clock_us = 0
        self.mode = Mode.STABILIZED
        self.armed = False
        self.airborne = False
        self.in_fail_safe = False
        self.home_N: Vector = (0.0, 0.0, 0.0)
        self._navigation_state = NavigationState(self.home_N, 0.0, 0.0, True)
        self._last_setpoint_us: int | None = None
        self._landed_since_us: int | None = None
        self._crashed_since_us: int | None = None
        self._takeoff_height = settings.takeoff_height
        self._legs: tuple[Leg, ...] = ()
        self._yaw = 0.0
        self._events: list[AutopilotEvent] = []

    @property
    def landed_state(self) -> LandedState:
        """Phase of the flight."""
        if self.armed and self.mode is Mode.TAKEOFF:
            return LandedState.TAKEOFF
        if not self.airborne:
            return LandedState.ON_GROUND
        descends = self.mode is Mode.LAND or (self.mode is Mode.RETURN and len(self._legs) == 1)
        return LandedState.LANDING if self.armed and descends else LandedState.IN_AIR

    @property
    def is_stream_alive(self) -> bool:
        """True if the last set-point is younger than the time-out."""
        return self._is_stream_younger(self.settings.stream_timeout_us)

    def arm(self) -> TransitionResult:
        """Arm the vehicle; home is its position then."""
        if self.armed:
            return TransitionResult.ACCEPTED
        if self.mode in _LANDING_MODES:
            return TransitionResult.LANDING_MODE
        if self.mode is _OFFBOARD and not self.is_stream_alive:
            return TransitionResult.NO_STREAM
        if self._navigation_state.tilt > _MAX_ARMING_TILT:
            return TransitionResult.TIPPED
        self.armed = True
        return TransitionResult.ACCEPTED

    def disarm(self, force: bool = False) -> TransitionResult:
        """Disarm the vehicle; in the air only by force, and then it falls."""
        if self.armed and self.airborne and not force:
            return TransitionResult.IN_FLIGHT
        self.armed = False
        return TransitionResult.ACCEPTED

    def begin(self) -> None:
        """Begin a scripted flight, in the air."""
        self.airborne = True

    def end(self) -> None:
        """End a scripted flight, and disarm."""
        self.airborne = self.armed = False

    def set_mode(self, mode: Mode) -> TransitionResult:
        """Change the mode; OFFBOARD needs a live stream."""
        if mode is Mode.ACRO:
            return TransitionResult.NOT_FLOWN
        if mode is _OFFBOARD and not self._is_stream_younger(min(ENTRY_GAP_US, self.settings.stream_timeout_us)):
            return TransitionResult.NO_STREAM
        if mode is Mode.TAKEOFF:
            return self.take_off(None)
        if mode is Mode.RETURN and not self.free:
            return TransitionResult.ON_STAND
        if mode is not self.mode or self.in_fail_safe:
            self._enter_mode(mode)
        return TransitionResult.ACCEPTED

    def take_off(self, height: float | None) -> TransitionResult:
        """Climb to `height` [m] above home, or to the set height for `None`, as soon as the vehicle is armed."""
        if not self.free:
            return TransitionResult.ON_STAND
        height = self.settings.takeoff_height if height is None else height
        if self.airborne:
            repeated = self.mode is Mode.TAKEOFF and height == self._takeoff_height
            return TransitionResult.ACCEPTED if repeated else TransitionResult.AIRBORNE
        if self._navigation_state.tilt > _MAX_ARMING_TILT:
            return TransitionResult.TIPPED
        if not _TAKEOFF_RANGE_M[0] <= height <= _TAKEOFF_RANGE_M[1]:  # true for NaN too
            return TransitionResult.HEIGHT
        self._takeoff_height = height
        self._enter_mode(Mode.TAKEOFF)
        return TransitionResult.ACCEPTED

    def land(self) -> TransitionResult:
        """Land here, then disarm."""
        return self.set_mode(Mode.LAND)

    def return_home(self) -> TransitionResult:
        """Fly home, land there, then disarm."""
        return self.set_mode(Mode.RETURN)

    def hold(self) -> TransitionResult:
        """Stay in place."""
        return self.set_mode(Mode.HOLD)

    def on_setpoint(self) -> None:
        """Register the arrival of a set-point."""
        if self.in_fail_safe and not self.is_stream_alive:
            self.add_event(AutopilotEvent.STREAM_BACK)
        self._last_setpoint_us = self.clock_us

    def on_stream_lost(self) -> None:
        """Drop the stream; in OFFBOARD, enter the fail-safe."""
        self._last_setpoint_us = None
        if self.mode is not _OFFBOARD:
            return
        if not self.airborne:
            self._enter_mode(Mode.HOLD)
            self.add_event(AutopilotEvent.LOST_ON_GROUND)
            return
        fail_safe = self.settings.fail_safe
        self._enter_mode(Mode[fail_safe.name])
        self.in_fail_safe = True
        self.add_event(_FAIL_SAFE_EVENTS[fail_safe])

    def add_event(self, event: AutopilotEvent) -> None:
        """Queue an event for `take_events`."""
        self._events.append(event)

    def take_events(self) -> list[AutopilotEvent]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def setpoint(self, command: Command | None, now: NavigationState) -> Setpoint:
        """Return the set-point of a sample; `command` is the outside controller's, flown in OFFBOARD."""
        self._navigation_state = now
        self._update_crashed(now)
        self._update_landed(now)
        if not self.armed:
            if not self.airborne:
                self.home_N = now.position_N
            return MotorsOff()
        if self.mode is _OFFBOARD and command is not None:
            return command if self.airborne or _has_thrust(command) else MotorsOff()
        if not (self.airborne or self.mode is Mode.TAKEOFF):
            return MotorsOff()
        if not self.free or self.mode in _LEVEL_MODES or self.mode is _OFFBOARD:
            return LevelFlight()
        return self._follow_legs(now)

    def _follow_legs(self, now: NavigationState) -> Setpoint:
        if not self._legs:
            self._legs, self._yaw = self._plan(now), now.yaw
        if guidance.is_reached(self._legs[0], now):
            if self.mode is Mode.TAKEOFF:
                self.mode = Mode.HOLD
                self.add_event(AutopilotEvent.HEIGHT_REACHED)
            self._legs = self._legs[1:] or self._legs
        return guidance.leg_target(self._legs[0], now, self.home_N, self._yaw, self.settings.land_speed)

    def _plan(self, now: NavigationState) -> tuple[Leg, ...]:
        match self.mode:
            case Mode.TAKEOFF:
                return guidance.plan_takeoff(now, self.home_N, self._takeoff_height)
            case Mode.LAND:
                return guidance.plan_landing(now)
            case Mode.RETURN:
                return guidance.plan_return(now, self.home_N, self.settings.return_height)
        return guidance.plan_hold(now)

    def _update_landed(self, now: NavigationState) -> None:
        """Update whether the vehicle flies, and end a landing."""
        landing = self.mode in _LANDING_MODES
        if self.free:
            has_landed = now.on_ground
            self.airborne = self.airborne or not has_landed
        else:
            has_landed = landing and now.tilt < _LEVEL_TILT
            self.airborne = self.armed
        if not has_landed:
            self._landed_since_us = None
            return
        self._landed_since_us = self.clock_us if self._landed_since_us is None else self._landed_since_us
        if self.clock_us >= self._landed_since_us + LAND_DETECTION_US or not self.airborne:
            self.airborne = False
            if landing and self.armed:
                self.armed = False
                self._enter_mode(Mode.HOLD)
                self.add_event(AutopilotEvent.LANDED)

    def _update_crashed(self, now: NavigationState) -> None:
        """Disarm a vehicle that has lain on the ground beyond `_CRASH_TILT` for a while, whatever its mode.

        Its rotors would throw it about for ever. It may bounce meanwhile, so it needs contact first and last alone.
        """
        if not (self.free and self.armed and now.tilt > _CRASH_TILT):
            self._crashed_since_us = None
        elif now.on_ground:
            self._crashed_since_us = self.clock_us if self._crashed_since_us is None else self._crashed_since_us
            if self.clock_us >= self._crashed_since_us + _CRASH_DETECTION_US:
                self.armed = self.airborne = False
                self._enter_mode(Mode.HOLD)
                self.add_event(AutopilotEvent.CRASHED)

    def _enter_mode(self, mode: Mode) -> None:
        self.mode, self.in_fail_safe, self._legs, self._landed_since_us = mode, False, (), None

    def _is_stream_younger(self, age_us: int) -> bool:
        return self._last_setpoint_us is not None and self.clock_us < self._last_setpoint_us + age_us


def _has_thrust(command: Command) -> bool:
    """Return whether a command carries a thrust: altitude hold on the ground is no take-off."""
    return (command.throttle if isinstance(command, TorqueCommand) else command.thrust) is not None
