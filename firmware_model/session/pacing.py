"""Pacing of a flight: when samples are due, which set-points answer them, and when to stop waiting.

    scripted     clamped --begin--> [next_action: WAIT | RESEND | ADVANCE] --> ended
    interactive             begin--> [next_action: WAIT | ADVANCE] without end

In lockstep, a sample is due when the set-point with its stamp has arrived. After a wall-time time-out it is sent again;
after `MAX_RESENDS` times the fail-safe begins. In real time, samples are due on absolute deadlines, and the last
set-point is held while the next one is late. Overdue samples are made up for, up to `MAX_CATCH_UP_US`; beyond that,
model time slips against wall time. Outside OFFBOARD the vehicle waits for no set-point.

Over a faulty link, `ScriptedLink` decides which answers lockstep awaits, in every mode, and which set-points arrive.
There, too, the last one is held.

A scripted flight begins when its controller is there, and ends with the scenario or an earlier landing. An interactive
vehicle begins with its process, on the ground; its model time is wall time less slips and pauses.
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
from firmware_model.types import NEVER_US, AttitudeTarget, Command, Setpoint, TorqueCommand, Trim

RESEND_US = 100_000
"""[us] Wall time after which a lockstep sample is sent again."""
MAX_RESENDS = 30
"""Most repetitions of a lockstep sample before the fail-safe."""
MAX_CATCH_UP_US = 250_000
"""[us] Largest delay that is made up for in real time; after a longer one, model time slips."""
STALL_US = 50_000
"""[us] Least model time without a set-point after which the vehicle holds its attitude instead of torques or rates."""
_RESTART_US = 100_000  # least model time of old stamps alone, after which they are those of a clock that was set anew
STALL_INTERVALS = 3
"""And so many intervals of the stream: a client that sends at 20 Hz does not stall."""
_SLIP_REPORT_US = 10_000_000  # least wall time between two reports of a slip

_OFFBOARD = Mode.OFFBOARD  # used several times a sample; looking up an Enum member takes .1 us


class NextAction(Enum):
    """Next action of a flight."""

    WAIT = "wait"
    """Nothing before the deadline."""
    RESEND = "resend"
    """Send the sample again."""
    ADVANCE = "advance"
    """Fly this sample."""


_WAIT, _ADVANCE = NextAction.WAIT, NextAction.ADVANCE


class TimingFault(Enum):
    """Counted deviation from the plan; the values are the counters' names."""

    RESENT = "resent"
    """Lockstep: a sample was sent again for lack of an answer."""
    HELD = "held"
    """Real time or scripted link: no new set-point arrived within a sample, so the last one was held."""
    STALLED = "stalled"
    """Set-points of torques or rates stopped for `STALL_US`, so the vehicle held its attitude until the next one."""
    OVERRUN = "overrun"
    """Real time: a sample was flown more than one sample time late."""
    SLIPPED = "slipped"
    """Real time: the delay exceeded `MAX_CATCH_UP_US`, and model time slipped by it."""
    REFUSED = "mode_refused"
    """The autopilot rejected a mode that the script requested."""


class FlightClock:
    """Clock of one flight, from first to last sample; the caller owns time and wire.

    `record` is called with the journal's record of each sample, (numbers,), or with those of several, (n, numbers).
    """

    def __init__(
        self,
        loop: VehicleLoop,
        autopilot: Autopilot,
        record: Callable[[NDArray[np.float64]], None],
        *,
        sample_us: int,
        lockstep: bool,
        interactive: bool = False,
        has_scripted_link: bool = False,
    ) -> None:
        self.loop, self.autopilot, self.lockstep, self.interactive = loop, autopilot, lockstep, interactive
        self.has_scripted_link = has_scripted_link
        self.counters: Counter[TimingFault] = Counter()
        self.latency = Latency()
        self.setpoint: Command | None = None
        self._stamps_us: dict[type[Command], int] = {}
        self._behind_us: dict[type[Command], tuple[int, int]] = {}  # stamp of the last old one; time of the first
        self._accepted_us, self._stalls_at_us = 0, NEVER_US
        self.started_us: int | None = None
        self.advanced_us = 0
        self.slipped_us = self.paused_us = 0
        self.running = False
        self.ended_us: int | None = None
        self.left_offboard = False
        self._record, self._sample_us = record, sample_us
        self._time_us = 0
        self.answered = False
        self._is_self_answered = lockstep and has_scripted_link
        self._in_trim = False
        self._attempts = 0
        self._resend_at_us = 0
        self._slip_report_at_us = 0
        self._paused_at_us: int | None = None

    @property
    def time_us(self) -> int:
        """[us] Model time of the current sample."""
        return self._time_us

    @property
    def wall_us(self) -> int:
        """[us] Wall time from t = 0 to the last flown sample, without pauses."""
        return 0 if self.started_us is None else max(self.advanced_us - self.started_us - self.paused_us, 0)

    def clock_us(self, now_us: int) -> int:
        """Return the autopilot's clock [us]: wall time while clamped, model time from there on."""
        return now_us if self.started_us is None else self.started_us + self._time_us

    def sample_age_us(self, now_us: int) -> int:
        """Return the time [us] since the current sample; 0 in lockstep, where time waits."""
        if self.lockstep or not self.running:
            return 0
        return min(max(now_us - self.paused_us - self.slipped_us - self.clock_us(now_us), 0), self._sample_us)

    def tick(self, now_us: int) -> None:
        """Set the autopilot's clock; call before its other methods."""
        self.autopilot.clock_us = self.clock_us(now_us)

    def offer(self, command: Command) -> RejectReason | None:
        """Accept a set-point that arrived at the last tick, or return why not.

        In lockstep, only the stamp of the current sample is accepted. In real time, any stamp not older than the last
        one of its message is, as other controllers stamp with their own clocks. A lost stream's stamps are forgotten,
        and so are stamps that all later ones fall behind for `_RESTART_US`: one wrong stamp ends no stream.
        """
        if self.lockstep:
            if command.time_us != self._time_us and (difference := stamp_difference(command, self._time_us)):
                if difference > 0:
                    return RejectReason.EARLY
                previous = stamp_difference(command, self._time_us - self._sample_us) == 0
                return RejectReason.DUPLICATE if previous else RejectReason.STALE
            if self.answered and self.running:
                return RejectReason.DUPLICATE
        elif self.is_overtaken(command):
            return RejectReason.STALE
        self.accept(command)
        return None

    def is_overtaken(self, command: Command) -> bool:
        """Return whether a newer set-point of the same message has arrived.

        Stamps of different messages are not comparable: MAVSDK stamps torques in ms where the wire has us.
        """
        newest_us = self._stamps_us.get(type(command))
        if newest_us is None or stamp_difference(command, newest_us) >= 0:
            return False
        behind_us, since_us = self._behind_us.get(type(command), (command.time_us - 1, self._time_us))
        if stamp_difference(command, behind_us) == 0:  # repeated: no clock stands still
            since_us = self._time_us
        self._behind_us[type(command)] = command.time_us, since_us
        return self._time_us < since_us + _RESTART_US

    def is_ready(self) -> bool:
        """Return whether the flight may begin: at once, or if scripted: armed, in OFFBOARD, sample 0 answered."""
        if self.started_us is not None:
            return False
        return self.interactive or (self.answered and self.autopilot.armed and self.autopilot.mode is _OFFBOARD)

    def begin(self, now_us: int) -> None:
        """Start model time: t = 0."""
        self.started_us = now_us
        self.running = True
        self.tick(now_us)
        if not self.interactive:
            self.autopilot.begin()
            self.autopilot.on_setpoint()
        if self.has_scripted_link:
            # The answer to sample 0 so far has bypassed the link.
            self._forget_setpoint()
            self.answered, self._in_trim = self._is_self_answered, True

    def pause(self, now_us: int, *, paused: bool) -> None:
        """Pause or resume model time; the flight is the same to the bit."""
        if paused and self._paused_at_us is None:
            self._paused_at_us = now_us
        elif not paused and self._paused_at_us is not None:
            if self.started_us is not None:
                self.paused_us += now_us - max(self._paused_at_us, self.started_us)
            self._paused_at_us = None
            self._resend_at_us = now_us + RESEND_US

    def next_action(self, now_us: int) -> NextAction:
        """Return the next action; a resend is counted as done."""
        if not self.running or self._paused_at_us is not None:
            return _WAIT
        if not self.lockstep:
            return _ADVANCE if now_us >= self._sample_deadline_us() else _WAIT
        if self.answered or not (self.has_scripted_link or self.autopilot.mode is _OFFBOARD):
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
        autopilot = self.autopilot
        self.tick(now_us)
        if self.lockstep:
            self._check_lockstep()
        else:
            self._check_real_time(now_us)
        if self._time_us >= self._stalls_at_us:
            self._hold_attitude()
        command = self.setpoint
        setpoint: Setpoint
        if autopilot.mode is _OFFBOARD and not self.interactive and command is not None:
            setpoint = command  # `autopilot.setpoint` would return the same, too slowly for lockstep
        elif self._in_trim and autopilot.mode is _OFFBOARD:
            setpoint = Trim()
        else:
            setpoint = autopilot.setpoint(command, self._navigation_state())
            self.left_offboard = True
        self._record(self.loop.advance(setpoint, autopilot.mode.value))
        self._begin_next(now_us)
        if not self.interactive and (self.loop.finished or not autopilot.armed):
            self.running = False
            self.ended_us = now_us
            autopilot.end()

    def continue_after(self, records: NDArray[np.float64], command: Command, now_us: int) -> None:
        """Go on after samples that machine code has flown, each on the answer to it, the last one on `command`."""
        self.loop.continue_after(len(records))
        self._record(records)
        if len(records) > 1:
            self._time_us += (len(records) - 1) * self._sample_us
            self._accepted_us = self._time_us - self._sample_us
        self.tick(now_us)
        self.accept(command)
        self._begin_next(now_us)

    def _begin_next(self, now_us: int) -> None:
        """Begin the sample after the current one."""
        self._time_us += self._sample_us
        self.answered, self._attempts = self._is_self_answered, 0
        self.advanced_us = now_us
        self._resend_at_us = now_us + RESEND_US

    def is_awaiting_peer(self) -> bool:
        """Return whether lockstep waits for the commanding peer to answer the current sample."""
        return self.running and self.lockstep and self.autopilot.mode is _OFFBOARD

    def await_answer(self, now_us: int) -> None:
        """Wait in lockstep for `answered`, as a sample is sent over the scripted link now."""
        self.answered, self._attempts = False, 0
        self._resend_at_us = now_us + RESEND_US

    def accept(self, command: Command) -> None:
        """Accept a set-point with any stamp."""
        self.setpoint, self.answered = command, True
        self._stamps_us[type(command)] = command.time_us
        self._behind_us.pop(type(command), None)
        time_us = self._time_us
        self._stalls_at_us = time_us + max(STALL_US, STALL_INTERVALS * (time_us - self._accepted_us))
        self._accepted_us = time_us
        self.autopilot.on_setpoint()

    @property
    def paused(self) -> bool:
        """True if model time is paused."""
        return self._paused_at_us is not None

    def deadline_us(self) -> int | None:
        """Return the wall time [us] at which `next_action` changes by itself, `None` for never."""
        if not self.running:
            return None
        if self._paused_at_us is not None:
            return NEVER_US
        if not self.lockstep:
            return self._sample_deadline_us()
        waits = not self.answered and (self.has_scripted_link or self.autopilot.mode is _OFFBOARD)
        return self._resend_at_us if waits else self.advanced_us

    def wall_time_us(self, time_us: int) -> int:
        """Return the wall time [us] of a model time [us], in real time."""
        return self.clock_us(0) - self._time_us + time_us + self.paused_us + self.slipped_us

    def _hold_attitude(self) -> None:
        """Replace torques or rates by the attitude estimated now, until the next set-point.

        A constant torque turns the vehicle by degrees within tenths of a second, as the gust that it met goes on.
        """
        command = self.setpoint
        if self.autopilot.mode is not _OFFBOARD:
            return
        self._stalls_at_us = NEVER_US
        if command is None or (isinstance(command, AttitudeTarget) and command.q_NB is not None):
            return
        thrust = command.throttle if isinstance(command, TorqueCommand) else command.thrust
        self.loop.observe()
        attitude = self.loop.estimate_q_NB
        self.setpoint = AttitudeTarget(time_us=command.time_us, q_NB=attitude, omega_B=None, thrust=thrust)
        if not self.counters[TimingFault.STALLED]:
            self.autopilot.add_event(AutopilotEvent.STALLED)
        self.counters[TimingFault.STALLED] += 1

    def _forget_setpoint(self) -> None:
        self.setpoint, self._stalls_at_us = None, NEVER_US
        self._stamps_us.clear()
        self._behind_us.clear()

    def _sample_deadline_us(self) -> int:
        """Return the wall time [us] at which the current sample is due in real time: at its end."""
        return self.wall_time_us(self._time_us + self._sample_us)

    def _navigation_state(self) -> NavigationState:
        """Return the navigation state: the true position, and the attitude as estimated on board."""
        loop = self.loop
        loop.observe()
        w, x, y, z = loop.estimate_q_NB
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        tilt = math.acos(min(max(1.0 - 2.0 * (x * x + y * y), -1.0), 1.0))
        return NavigationState(loop.true_vector("position_N"), yaw, tilt, loop.on_ground)

    def _check_lockstep(self) -> None:
        if not self.answered or (self.has_scripted_link and not self.autopilot.is_stream_alive):
            self._drop_stream()

    def _check_real_time(self, now_us: int) -> None:
        if not self.answered and self.autopilot.mode is _OFFBOARD:
            self.counters[TimingFault.HELD] += 1
        late_us = now_us - self._sample_deadline_us()
        self.latency.add(late_us)
        if late_us > self._sample_us:
            self.counters[TimingFault.OVERRUN] += 1
        if late_us > MAX_CATCH_UP_US:
            self.slipped_us += late_us
            self.counters[TimingFault.SLIPPED] += 1
            if now_us >= self._slip_report_at_us:
                self._slip_report_at_us = now_us + _SLIP_REPORT_US
                self.autopilot.add_event(AutopilotEvent.SLIPPED)
        if not self.autopilot.is_stream_alive:
            self._drop_stream()

    def _drop_stream(self) -> None:
        self._forget_setpoint()
        self._in_trim = False
        self.autopilot.on_stream_lost()
