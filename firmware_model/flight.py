"""The pace of a flight: which sample is due when, which set-point answers it, and when to stop waiting.

    clamped --begin--> [due: WAIT | RESEND | ADVANCE] --> landed

In lockstep a sample is due when the set-point with its stamp is there; after a wall time-out it is sent again, and
after a stated number of times the fail-safe begins. In real time samples are due on absolute deadlines, and a late
set-point means that the last one is held. Without OFFBOARD nobody is waited for.
"""

from collections import Counter
from collections.abc import Callable
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from firmware_model.autopilot import Autopilot, Event, Mode
from firmware_model.frames import Dropped
from firmware_model.loop import VehicleLoop
from firmware_model.messages import stamp_difference
from firmware_model.signals import Command, Level, Setpoint

RESEND_US = 100_000
"""[us] wall time after which a lockstep sample is sent again."""
RESENDS = 30
"""Times that a lockstep sample is sent again before the fail-safe."""

_LEVEL = Level()
_OFFBOARD = Mode.OFFBOARD  # asked for several times a sample, and to look up a member of an Enum takes .1 us


class Due(Enum):
    """What is to be done now."""

    WAIT = "wait"
    """Nothing before the deadline."""
    RESEND = "resend"
    """Send the sample again."""
    ADVANCE = "advance"
    """Fly this sample."""


_WAIT, _ADVANCE = Due.WAIT, Due.ADVANCE


class Hitch(Enum):
    """What went other than planned, counted; the values are the names of the counters."""

    RESENT = "resent"
    """Lockstep: a sample was sent again, as its answer did not come."""
    HELD = "held"
    """Real time: no new set-point from one sample to the next, the last one was held."""
    OVERRUN = "overrun"
    """Real time: a sample was flown more than a sample time late."""


class Flight:
    """One scripted flight from clamp to landing; the caller owns clock and wire."""

    def __init__(
        self,
        loop: VehicleLoop,
        autopilot: Autopilot,
        record: Callable[[NDArray[np.float64]], None],
        *,
        sample_us: int,
        lockstep: bool,
    ) -> None:
        self.loop, self.autopilot, self.lockstep = loop, autopilot, lockstep
        self.counters: Counter[Hitch] = Counter()
        self.setpoint: Command | None = None
        self.started_us: int | None = None
        self.advanced_us = 0
        self.airborne = False
        self.landed_us: int | None = None
        self._record, self._sample_us = record, sample_us
        self._time_us = 0
        self._answered = False
        self._attempts = 0
        self._resend_at_us = 0

    @property
    def wall_us(self) -> int:
        """[us] wall time from t = 0 to the sample flown last."""
        return 0 if self.started_us is None else max(self.advanced_us - self.started_us, 0)

    def clock_us(self, now_us: int) -> int:
        """Return the autopilot's clock: wall time while clamped, then model time from there on."""
        return now_us if self.started_us is None else self.started_us + self._time_us

    def offer(self, command: Command, now_us: int) -> Dropped | None:
        """Take a set-point, or say why not.

        In lockstep only the stamp of the current sample is taken; in real time any that is not older than the last,
        as other controllers stamp with clocks of their own.
        """
        if self.lockstep:
            if command.time_us != self._time_us and (difference := stamp_difference(command, self._time_us)):
                previous = stamp_difference(command, self._time_us - self._sample_us) == 0
                return Dropped.EARLY if difference > 0 else Dropped.DUPLICATE if previous else Dropped.STALE
            if self._answered and self.airborne:
                return Dropped.DUPLICATE
        elif self.setpoint is not None and command.time_us < self.setpoint.time_us:
            return Dropped.STALE
        self.setpoint, self._answered = command, True
        self.autopilot.setpoint(self.clock_us(now_us))
        return None

    def ready(self) -> bool:
        """Whether the clamp may open: armed, in OFFBOARD, sample 0 answered."""
        clamped = self.started_us is None
        return clamped and self._answered and self.autopilot.armed and self.autopilot.mode is _OFFBOARD

    def begin(self, now_us: int) -> None:
        """Open the clamp: t = 0."""
        self.started_us = now_us
        self.airborne = True
        self.autopilot.take_off()
        self.autopilot.setpoint(now_us)

    def due(self, now_us: int) -> Due:
        """Return what is to be done; a resend counts as done."""
        if not self.airborne:
            return _WAIT
        if not self.lockstep:
            return _ADVANCE if now_us >= self.clock_us(now_us) + self._sample_us else _WAIT
        if self._answered or self.autopilot.mode is not _OFFBOARD:
            return _ADVANCE
        if now_us < self._resend_at_us:
            return _WAIT
        if self._attempts < RESENDS:
            self._attempts += 1
            self._resend_at_us = now_us + RESEND_US
            self.counters[Hitch.RESENT] += 1
            return Due.RESEND
        return _ADVANCE

    def advance(self, now_us: int) -> Event | None:
        """Fly the current sample; return what happened to the stream."""
        event = self._check_lockstep() if self.lockstep else self._check_real_time(now_us)
        mode = self.autopilot.mode
        setpoint: Setpoint = self.setpoint if mode is _OFFBOARD and self.setpoint is not None else _LEVEL
        self._record(self.loop.advance(setpoint, mode.value))
        self._time_us += self._sample_us
        self._answered, self._attempts = False, 0
        self.advanced_us = now_us
        self._resend_at_us = now_us + RESEND_US
        if self.loop.finished:
            self.airborne = False
            self.landed_us = now_us
            self.autopilot.land()
        return event

    def asks(self) -> bool:
        """Whether the commanding peer is to be sent the current sample: always, but in lockstep only in OFFBOARD."""
        return self.airborne and (not self.lockstep or self.autopilot.mode is _OFFBOARD)

    def deadline_us(self) -> int | None:
        """Return the wall time at which `due` changes by itself, `None` if it never does."""
        if not self.airborne:
            return None
        if not self.lockstep:
            return self.clock_us(0) + self._sample_us
        waits = self.autopilot.mode is _OFFBOARD and not self._answered
        return self._resend_at_us if waits else self.advanced_us

    def _check_lockstep(self) -> Event | None:
        if self._answered:
            return None
        self.setpoint = None
        return self.autopilot.lose_stream()

    def _check_real_time(self, now_us: int) -> Event | None:
        clock_us = self.clock_us(now_us)
        if not self._answered and self.autopilot.mode is _OFFBOARD:
            self.counters[Hitch.HELD] += 1
        if now_us > clock_us + 2 * self._sample_us:
            self.counters[Hitch.OVERRUN] += 1
        if self.autopilot.stream_alive(clock_us):
            return None
        self.setpoint = None
        return self.autopilot.lose_stream()
