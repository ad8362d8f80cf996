"""Samples and set-points on their way between vehicle and controller, where the script interferes with them.

    sample k --to_controller--> sent, and its answer awaited --to_vehicle--> set-point of the sample it arrives at

A set-point that arrives from t_k on and before t_k+1 is flown as the answer to sample k would be: a delay of the link
by n samples is the same as `delay_samples` higher by n. Until the first one arrives the vehicle stays in trim, then the
last one is held; in lockstep too the stream dies by the autopilot's time-out in model time. The vehicle waits for the
answers to those samples that it really sends, and asks its controller in every mode, so that OFFBOARD can be set again.

Nothing passes here before t = 0. Heartbeats and requests never do, as they go by wall time: the link loses none. A
controller that hangs or is dead is sent nothing. In lockstep time waits for the one that takes its place, as it did
for the first, until that one has answered and the mode is OFFBOARD.
"""

from collections.abc import Iterator
from typing import Any

from firmware_model.autopilot.modes import Mode
from firmware_model.config.events import ControllerHang, ControllerKill, ModeChange
from firmware_model.config.scenario import Scenario
from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import RejectReason
from firmware_model.session.link import LinkCounter, LinkDirection
from firmware_model.session.pacing import RESEND_US, FlightClock, NextAction, TimingFault
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import Command, ImuSample

JOIN_TIMEOUT_US = 60_000_000
"""[us] wall time that a lockstep flight waits for the controller that takes the place of another."""
_NEVER_US = 1 << 62

ControllerEvent = ModeChange | ControllerHang | ControllerKill


class ScriptedLink:
    """The conversation of one scripted flight with its controller; the endpoint asks it `due` in the flight's place."""

    def __init__(self, scenario: Scenario, seed: int, flight: FlightClock, loop: VehicleLoop) -> None:
        self.joining = False
        self.sample: ImuSample | None = None
        self._flight, self._loop, self._sample_us = flight, loop, scenario.sample_us
        self._to_controller: LinkDirection[ImuSample] = LinkDirection(scenario.link, "to_controller", seed)
        self._to_vehicle: LinkDirection[tuple[int, Command]] = LinkDirection(scenario.link, "to_vehicle", seed)
        self._events_at: dict[int, list[ControllerEvent]] = {}
        self._outages: list[tuple[int, int]] = []
        self._join_sample: int | None = None
        for item in scenario.event:
            if isinstance(item, ControllerEvent):
                self._note(item, scenario.control_rate_hz)
        self._at_us = 0  # model time at which the controller has the sample that was sent last
        self._sent_us = self._heard_us = -1  # stamps: newest sample sent, newest one whose answer has arrived
        self._joined = self._gone = False
        self._join_by_us = self._resend_at_us = 0

    def begin_sample(self, now_us: int) -> list[ControllerEvent] | None:
        """Let the current sample enter the link, and return what happens before it is flown, if anything does."""
        loop = self._loop
        self._flight.tick(now_us)
        sample = loop.observe()
        self._to_controller.send(sample, messages.imu_message(sample).size, loop.time_us)
        if loop.sample == self._join_sample and self._flight.lockstep:
            self.joining, self._joined = True, False
            self._resend_at_us, self._join_by_us = now_us, now_us + JOIN_TIMEOUT_US
        return self._events_at.get(loop.sample)

    def due(self, now_us: int) -> NextAction:
        """Return what is to be done; RESEND: send `sample`, for the first time too."""
        flight = self._flight
        due = flight.due(now_us)
        if due is not NextAction.ADVANCE:
            return due
        if flight.lockstep:
            if self.joining:
                return self._wait_for_join(now_us)
            if not flight.answered:
                self._gone = True
                return due
            if self._deliver(now_us):
                return NextAction.RESEND
        self._accept_arrivals(now_us)
        return due

    def deliveries(self, time_us: int) -> Iterator[ImuSample]:
        """Yield the samples that have come to the controller by a model time, in real time."""
        for arrival_us, sample in self._to_controller.take_all(time_us + 1):
            if self._is_received(arrival_us):
                yield sample

    def answer(self, command: Command, size: int, time_us: int) -> RejectReason | None:
        """Take a set-point of `size` bytes that was really received at a model time, or say why not."""
        flight = self._flight
        if not flight.lockstep:
            self._to_vehicle.send((command.time_us, command), size, time_us)
            return None
        if self.sample is None or (difference := messages.stamp_difference(command, self.sample.time_us)) > 0:
            return RejectReason.EARLY
        if difference < 0:
            return RejectReason.STALE
        if self.joining:
            self._joined = True
            flight.autopilot.on_setpoint()
            return None
        if flight.answered:
            return RejectReason.DUPLICATE
        flight.answered = True
        self._to_vehicle.send((self.sample.time_us, command), size, self._at_us)
        return None

    def deadline_us(self) -> int | None:
        """Return the wall time at which `due` or `deliveries` change by themselves, `None` if they never do."""
        flight = self._flight
        deadline_us = flight.deadline_us()
        if deadline_us is None or flight.paused:
            return deadline_us
        if self.joining:
            return self._resend_at_us
        return deadline_us if flight.lockstep else min(deadline_us, flight.wall_time_us(self._to_controller.next_us))

    def figures(self) -> dict[str, Any]:
        """Return what the link did, by direction."""
        return {"to_controller": self._to_controller.figures(), "to_vehicle": self._to_vehicle.figures()}

    def _note(self, item: ControllerEvent, rate_hz: int) -> None:
        self._events_at.setdefault(round(item.at_s * rate_hz), []).append(item)
        if isinstance(item, ModeChange):
            return
        away_s = item.for_s if isinstance(item, ControllerHang) else item.recovers_after_s
        start_us = round(item.at_s * rate_hz) * self._sample_us
        if away_s is None:
            self._outages.append((start_us, _NEVER_US))
            return
        back = round((item.at_s + away_s) * rate_hz)
        self._outages.append((start_us, back * self._sample_us))
        if isinstance(item, ControllerKill):
            self._join_sample = back
            self._events_at.setdefault(back, [])

    def _wait_for_join(self, now_us: int) -> NextAction:
        """Let time wait for a new controller; it is sent the current sample until it flies."""
        if self._joined and self._flight.autopilot.mode is Mode.OFFBOARD:
            self.joining = self._gone = False
        elif now_us >= self._join_by_us:
            self.joining, self._gone = False, True
        elif now_us >= self._resend_at_us:
            self._resend_at_us = now_us + RESEND_US
            self.sample = self._loop.observe()
            self._sent_us = self.sample.time_us  # the newcomer answers nothing older that is still on its way
            return NextAction.RESEND
        else:
            return NextAction.WAIT
        return self.due(now_us)

    def _deliver(self, now_us: int) -> bool:
        """Take the next sample that comes to the controller before this one is over; whether there is one to send.

        It is waited for, unless a newer one overtook it: no law answers that. A repeated one is answered again.
        """
        for arrival_us, sample in self._to_controller.take_all(self._loop.time_us + self._sample_us):
            if self._is_received(arrival_us):
                self.sample, self._at_us = sample, arrival_us
                if sample.time_us >= self._sent_us:
                    self._sent_us = sample.time_us
                    self._flight.expect(now_us)
                return True
        return False

    def _accept_arrivals(self, now_us: int) -> None:
        """Let the set-points that arrive before this sample is over be heard."""
        flight, heard = self._flight, False
        flight.tick(now_us)
        for _, (stamp_us, command) in self._to_vehicle.take_all(self._loop.time_us + self._sample_us):
            if flight.lockstep:
                overtaken = flight.setpoint is not None and stamp_us < self._heard_us
            else:
                overtaken = flight.is_overtaken(command)
            if overtaken:
                self._to_vehicle.counters[LinkCounter.OVERTAKEN] += 1
                continue
            self._heard_us, heard = stamp_us, True
            flight.hear(command)
        if flight.lockstep and not heard and flight.autopilot.mode is Mode.OFFBOARD:
            flight.counters[TimingFault.HELD] += 1

    def _is_received(self, time_us: int) -> bool:
        """Whether somebody hears what comes to the controller at a model time."""
        heard = not self._gone and not any(start_us <= time_us < stop_us for start_us, stop_us in self._outages)
        self._to_controller.counters[LinkCounter.UNHEARD] += not heard
        return heard
