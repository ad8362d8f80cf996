"""What the autopilot decides: arming, modes, whether the off-board stream is alive, and the fail-safe.

No physics and no bytes: requests and time come in, verdicts and events go out.

    STABILIZED --set_mode(OFFBOARD), stream alive--> OFFBOARD --stream lost, or another mode asked--> STABILIZED
"""

from enum import Enum


class Mode(Enum):
    """Flight modes by PX4's custom mode number, `main << 16 | sub << 24`."""

    MANUAL = 1 << 16
    """Sticks, levelled by the on-board loop."""
    ALTCTL = 2 << 16
    """Sticks, altitude held."""
    POSCTL = 3 << 16
    """Sticks, position held."""
    HOLD = 4 << 16 | 3 << 24
    """Hold position."""
    LAND = 4 << 16 | 6 << 24
    """Land here."""
    ACRO = 5 << 16
    """Sticks as rates."""
    OFFBOARD = 6 << 16
    """Set-points of an outside controller."""
    STABILIZED = 7 << 16
    """Level, by the on-board loop."""


LEVELLING = frozenset({Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.HOLD, Mode.STABILIZED})
"""Modes that the on-board loop flies by levelling, as there are no sticks and the hover position is held."""


class Verdict(Enum):
    """Answer to a request; the values are texts for people, at most 50 characters as STATUSTEXT has them."""

    ACCEPTED = "accepted"
    """Done, or so already."""
    NO_STREAM = "no off-board set-points: OFFBOARD refused"
    """OFFBOARD without a living stream."""
    IN_FLIGHT = "in flight: disarms when the scenario has ended"
    """Disarming in the air."""
    NOT_FLOWN = "this vehicle does not fly that mode"
    """A mode that is not modelled."""


class Event(Enum):
    """Something that happened to the flight by itself; the values are texts for people, at most 50 characters."""

    STREAM_LOST = "set-points stopped: fail-safe to STABILIZED"
    """The stream stopped in OFFBOARD; the on-board loop flies on."""


class Autopilot:
    """Arming state, mode and off-board stream of one vehicle; the caller owns the clock."""

    def __init__(self, stream_timeout_us: int) -> None:
        self.mode = Mode.STABILIZED
        self.armed = False
        self.airborne = False
        self.stream_timeout_us = stream_timeout_us
        self._last_setpoint_us: int | None = None

    def arm(self) -> Verdict:
        """Arm the vehicle."""
        self.armed = True
        return Verdict.ACCEPTED

    def disarm(self) -> Verdict:
        """Disarm the vehicle, unless it flies."""
        if self.airborne:
            return Verdict.IN_FLIGHT
        self.armed = False
        return Verdict.ACCEPTED

    def take_off(self) -> None:
        """Note that the clamp has opened."""
        self.airborne = True

    def land(self) -> None:
        """Note that the scenario has ended; disarms."""
        self.airborne = self.armed = False

    def set_mode(self, mode: Mode, now_us: int) -> Verdict:
        """Change the mode; OFFBOARD needs a living stream."""
        if mode is Mode.OFFBOARD:
            if not self.stream_alive(now_us):
                return Verdict.NO_STREAM
        elif mode not in LEVELLING:
            return Verdict.NOT_FLOWN
        self.mode = mode
        return Verdict.ACCEPTED

    def setpoint(self, now_us: int) -> None:
        """Note that a set-point arrived."""
        self._last_setpoint_us = now_us

    def stream_alive(self, now_us: int) -> bool:
        """Whether the last set-point is younger than the time-out."""
        return self._last_setpoint_us is not None and now_us < self._last_setpoint_us + self.stream_timeout_us

    def lose_stream(self) -> Event | None:
        """Forget the stream; in OFFBOARD, enter the fail-safe."""
        self._last_setpoint_us = None
        if self.mode is not Mode.OFFBOARD:
            return None
        self.mode = Mode.STABILIZED
        return Event.STREAM_LOST
