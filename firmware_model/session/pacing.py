"""The pace of a flight: which sample is due when, which set-point answers it, and when to stop waiting.

    scripted   clamped --begin--> [due: WAIT | RESEND | ADVANCE] --> ended
    standing             begin--> [due: WAIT | ADVANCE] without end

In lockstep a sample is due when the set-point with its stamp is there; after a wall time-out it is sent again, and
after a stated number of times the fail-safe begins. In real time samples are due on absolute deadlines, and a late
set-point means that the last one is held. A sample that is late itself is made up for, up to `MAX_CATCH_UP_US`; beyond
that model time slips against wall time. Without OFFBOARD nobody is waited for.

Over a link with faults an `Exchange` says what is waited for in lockstep, in every mode, and which set-points come
through; there, too, the last one is held.

A scripted flight begins when its controller is there and ends with the scenario, or before it by landing. A standing
vehicle begins with its process, on the ground; its model time is wall time less what has slipped.
"""

import math
from collections import Counter
from collections.abc import Callable
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from firmware_model.autopilot.guidance import NavigationState
from firmware_model.autopilot.modes import Autopilot, AutopilotEvent, Mode
from firmware_model.mavlink.frames import RejectReason
from firmware_model.mavlink.messages import stamp_difference
from firmware_model.session.latency import Latency
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import Command, Setpoint, Trim

RESEND_US = 100_000
"""[us] wall time after which a lockstep sample is sent again."""
MAX_RESENDS = 30
"""Times that a lockstep sample is sent again before the fail-safe."""
MAX_CATCH_UP_US = 250_000
"""[us] lateness that is made up for in real time; a process that was away for longer lets model time slip."""
_SLIP_REPORT_US = 10_000_000  # wall time from one word on it to the next
_NEVER_US = 1 << 62

_OFFBOARD = Mode.OFFBOARD  # asked for several times a sample, and to look up a member of an Enum takes .1 us


class NextAction(Enum):
    """What is to be done now."""

    WAIT = "wait"
    """Nothing before the deadline."""
    RESEND = "resend"
    """Send the sample again."""
    ADVANCE = "advance"
    """Fly this sample."""


_WAIT, _ADVANCE = NextAction.WAIT, NextAction.ADVANCE


class TimingFault(Enum):
    """What went other than planned, counted; the values are the names of the counters."""

    RESENT = "resent"
    """Lockstep: a sample was sent again, as its answer did not come."""
    HELD = "held"
    """Real time, or over a link: no new set-point from one sample to the next, the last one was held."""
    OVERRUN = "overrun"
    """Real time: a sample was flown more than a sample time late."""
    SLIPPED = "slipped"
    """Real time: the vehicle was later than can be made up for, and model time was set back by that."""
    REFUSED = "mode_refused"
    """A mode that the script asks for was refused."""


class FlightClock:
    """One vehicle from its first sample to its last; the caller owns clock and wire."""

    def __init__(
        self,
        loop: VehicleLoop,
        autopilot: Autopilot,
        record: Callable[[NDArray[np.float64]], None],
        *,
        sample_us: int,
        lockstep: bool,
        standing: bool = False,
        linked: bool = False,
    ) -> None:
        self.loop, self.autopilot, self.lockstep, self.standing = loop, autopilot, lockstep, standing
        self.linked = linked
        self.counters: Counter[TimingFault] = Counter()
        self.lateness = Latency()
        self.setpoint: Command | None = None
        self._stamps_us: dict[type[Command], int] = {}
        self.started_us: int | None = None
        self.advanced_us = 0
        self.slipped_us = self.paused_us = 0
        self.running = False
        self.ended_us: int | None = None
        self.left_offboard = False
        self._record, self._sample_us = record, sample_us
        self._time_us = 0
        self.answered = False
        self._unasked = lockstep and linked
        self._in_trim = False
        self._attempts = 0
        self._resend_at_us = 0
        self._slip_report_at_us = 0
        self._paused_at_us: int | None = None

    @property
    def time_us(self) -> int:
        """[us] model time of the current sample."""
        return self._time_us

    @property
    def wall_us(self) -> int:
        """[us] wall time from t = 0 to the sample flown last, without pauses."""
        return 0 if self.started_us is None else max(self.advanced_us - self.started_us - self.paused_us, 0)

    def clock_us(self, now_us: int) -> int:
        """Return the autopilot's clock: wall time while clamped, then model time from there on."""
        return now_us if self.started_us is None else self.started_us + self._time_us

    def sample_age_us(self, now_us: int) -> int:
        """Return the time that has passed since the current sample; none in lockstep, where time waits."""
        if self.lockstep or not self.running:
            return 0
        return min(max(now_us - self.paused_us - self.slipped_us - self.clock_us(now_us), 0), self._sample_us)

    def tick(self, now_us: int) -> None:
        """Tell the autopilot the time, before anything is asked of it."""
        self.autopilot.clock_us = self.clock_us(now_us)

    def offer(self, command: Command) -> RejectReason | None:
        """Take a set-point that arrived at the last tick, or say why not.

        In lockstep only the stamp of the current sample is taken; in real time any that is not older than the last of
        its message, as other controllers stamp with clocks of their own. A stream that has died takes its stamps with
        it.
        """
        if self.lockstep:
            if command.time_us != self._time_us and (difference := stamp_difference(command, self._time_us)):
                previous = stamp_difference(command, self._time_us - self._sample_us) == 0
                return (
                    RejectReason.EARLY if difference > 0 else RejectReason.DUPLICATE if previous else RejectReason.STALE
                )
            if self.answered and self.running:
                return RejectReason.DUPLICATE
        elif self.is_overtaken(command):
            return RejectReason.STALE
        self.hear(command)
        return None

    def is_overtaken(self, command: Command) -> bool:
        """Whether a newer set-point of the same message was heard.

        The stamps of two messages can't be compared: MAVSDK's of torques are ms where the wire has us.
        """
        return command.time_us < self._stamps_us.get(type(command), 0)

    def ready(self) -> bool:
        """Whether the first sample may be flown: at once, or scripted: armed, in OFFBOARD, sample 0 answered."""
        if self.started_us is not None:
            return False
        return self.standing or (self.answered and self.autopilot.armed and self.autopilot.mode is _OFFBOARD)

    def begin(self, now_us: int) -> None:
        """Let time run: t = 0."""
        self.started_us = now_us
        self.running = True
        self.tick(now_us)
        if not self.standing:
            self.autopilot.begin()
            self.autopilot.on_setpoint()
        if self.linked:
            # What answered sample 0 so far came past the link.
            self._forget_setpoint()
            self.answered, self._in_trim = self._unasked, True

    def pause(self, now_us: int, *, paused: bool) -> None:
        """Let model time stand still, or go on from where it stands; what is flown is the same to the bit."""
        if paused and self._paused_at_us is None:
            self._paused_at_us = now_us
        elif not paused and self._paused_at_us is not None:
            if self.started_us is not None:
                self.paused_us += now_us - max(self._paused_at_us, self.started_us)
            self._paused_at_us = None
            self._resend_at_us = now_us + RESEND_US

    def due(self, now_us: int) -> NextAction:
        """Return what is to be done; a resend counts as done."""
        if not self.running or self._paused_at_us is not None:
            return _WAIT
        if not self.lockstep:
            return _ADVANCE if now_us >= self._due_us() else _WAIT
        if self.answered or not (self.linked or self.autopilot.mode is _OFFBOARD):
            return _ADVANCE
        if now_us < self._resend_at_us:
            return _WAIT
        if self._attempts < MAX_RESENDS:
            self._attempts += 1
            self._resend_at_us = now_us + RESEND_US
            self.counters[TimingFault.RESENT] += 1
            return NextAction.RESEND
        return _ADVANCE

    def advance(self, now_us: int) -> None:
        """Fly the current sample."""
        autopilot, command = self.autopilot, self.setpoint
        self.tick(now_us)
        if self.lockstep:
            self._check_lockstep()
        else:
            self._check_real_time(now_us)
        setpoint: Setpoint
        if autopilot.mode is _OFFBOARD and not self.standing and command is not None:
            setpoint = command  # nothing else can come of it, and a lockstep flight has no time for the question
        elif self._in_trim and autopilot.mode is _OFFBOARD:
            setpoint = Trim()
        else:
            setpoint = autopilot.setpoint(self.setpoint, self._situation())
            self.left_offboard = True
        self._record(self.loop.advance(setpoint, autopilot.mode.value))
        self._time_us += self._sample_us
        self.answered, self._attempts = self._unasked, 0
        self.advanced_us = now_us
        self._resend_at_us = now_us + RESEND_US
        if not self.standing and (self.loop.finished or not autopilot.armed):
            self.running = False
            self.ended_us = now_us
            autopilot.end()

    def asks(self) -> bool:
        """Whether lockstep waits for the commanding peer, which is to be sent the current sample."""
        return self.running and self.lockstep and self.autopilot.mode is _OFFBOARD

    def expect(self, now_us: int) -> None:
        """Wait in lockstep for `answered`, as a sample is sent now over a link."""
        self.answered, self._attempts = False, 0
        self._resend_at_us = now_us + RESEND_US

    def hear(self, command: Command) -> None:
        """Take a set-point, whatever its stamp."""
        self.setpoint, self.answered = command, True
        self._stamps_us[type(command)] = command.time_us
        self.autopilot.on_setpoint()

    @property
    def paused(self) -> bool:
        """Whether model time stands still."""
        return self._paused_at_us is not None

    def deadline_us(self) -> int | None:
        """Return the wall time at which `due` changes by itself, `None` if it never does."""
        if not self.running:
            return None
        if self._paused_at_us is not None:
            return _NEVER_US
        if not self.lockstep:
            return self._due_us()
        waits = not self.answered and (self.linked or self.autopilot.mode is _OFFBOARD)
        return self._resend_at_us if waits else self.advanced_us

    def wall_time_us(self, time_us: int) -> int:
        """Return the wall time of a model time, in real time."""
        return self.clock_us(0) - self._time_us + time_us + self.paused_us + self.slipped_us

    def _forget_setpoint(self) -> None:
        self.setpoint = None
        self._stamps_us.clear()

    def _due_us(self) -> int:
        """Return the wall time [us] at which the current sample is flown in real time: at its end."""
        return self.wall_time_us(self._time_us + self._sample_us)

    def _situation(self) -> NavigationState:
        """Return what navigation says: ideal in position, the on-board estimate in attitude."""
        loop = self.loop
        loop.observe()
        w, x, y, z = loop.estimate_q_NB
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        tilt = math.acos(min(max(1.0 - 2.0 * (x * x + y * y), -1.0), 1.0))
        return NavigationState(loop.true_vector("position_N"), yaw, tilt, loop.on_ground)

    def _check_lockstep(self) -> None:
        if not self.answered or (self.linked and not self.autopilot.is_stream_alive):
            self._lose_stream()

    def _check_real_time(self, now_us: int) -> None:
        if not self.answered and self.autopilot.mode is _OFFBOARD:
            self.counters[TimingFault.HELD] += 1
        late_us = now_us - self._due_us()
        self.lateness.add(late_us)
        if late_us > self._sample_us:
            self.counters[TimingFault.OVERRUN] += 1
        if late_us > MAX_CATCH_UP_US:
            self.slipped_us += late_us
            self.counters[TimingFault.SLIPPED] += 1
            if now_us >= self._slip_report_at_us:
                self._slip_report_at_us = now_us + _SLIP_REPORT_US
                self.autopilot.add_event(AutopilotEvent.SLIPPED)
        if not self.autopilot.is_stream_alive:
            self._lose_stream()

    def _lose_stream(self) -> None:
        self._forget_setpoint()
        self._in_trim = False
        self.autopilot.on_stream_lost()
