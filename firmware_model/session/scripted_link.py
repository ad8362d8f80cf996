"""Scripted link: samples and set-points under link faults and controller events.

    sample k --to_controller--> sent, and its answer awaited --to_vehicle--> set-point of the sample it arrives at

A set-point that arrives from t_k on and before t_k+1 is flown like the answer to sample k. A link delay of n samples
thus equals `delay_samples` higher by n. Until the first set-point arrives, the vehicle stays in trim; then the last one
is held. In lockstep, too, the stream times out in model time. The vehicle waits for the answers to the samples that it
really sends. It sends samples in every mode, so that the controller can set OFFBOARD again.

The link carries nothing before t = 0. Heartbeats and requests bypass it, as they run on wall time: none is lost.
A hanging or dead controller gets no samples. In lockstep, time waits for its replacement, as for the first controller,
until that one has answered and the mode is OFFBOARD.
"""

from collections.abc import Iterator
from typing import Any

from firmware_model.autopilot.modes import Mode
from firmware_model.config.events import ControllerEvent, ControllerHang, ControllerKill, ModeChange
from firmware_model.config.scenario import Scenario
from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import RejectReason
from firmware_model.session.link import LinkCounter, LinkDirection
from firmware_model.session.pacing import RESEND_US, FlightClock, NextAction, TimingFault
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import NEVER_US, Command, ImuSample

JOIN_TIMEOUT_US = 60_000_000
"""[us] Wall time that a lockstep flight waits for a replacement controller."""


class ScriptedLink:
    """Link of one scripted flight to its controller; it replaces the `FlightClock` as the endpoint's pacer."""

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
                self._schedule_event(item, scenario)
        self._arrival_us = 0  # model time at which the last sample reaches the controller
        self._newest_sent_us = self._newest_answer_us = -1  # stamps: newest sample sent, newest answered sample
        self._joined = self._controller_lost = False
        self._join_by_us = self._resend_at_us = 0

    def begin_sample(self, now_us: int) -> list[ControllerEvent] | None:
        """Send the current sample into the link; return the events before it is flown, `None` if there are none."""
        loop = self._loop
        self._flight.tick(now_us)
        sample = loop.observe()
        self._to_controller.send(sample, messages.imu_message(sample).size, loop.time_us)
        if loop.sample == self._join_sample and self._flight.lockstep:
            self.joining, self._joined = True, False
            self._resend_at_us, self._join_by_us = now_us, now_us + JOIN_TIMEOUT_US
        return self._events_at.get(loop.sample)

    def next_action(self, now_us: int) -> NextAction:
        """Return the next action; RESEND means to send `sample`, also for the first time."""
        flight = self._flight
        action = flight.next_action(now_us)
        if action is not NextAction.ADVANCE:
            return action
        if flight.lockstep:
            if self.joining:
                return self._wait_for_join(now_us)
            if not flight.answered:
                self._controller_lost = True
                return action
            if self._take_delivery(now_us):
                return NextAction.RESEND
        self._accept_arrivals()
        return action

    def take_deliveries(self, time_us: int) -> Iterator[ImuSample]:
        """Yield the samples that have reached the controller by a model time [us], in real time."""
        for arrival_us, sample in self._to_controller.take_all(time_us + 1):
            if self._is_received(arrival_us):
                yield sample

    def offer(self, command: Command, size: int, time_us: int) -> RejectReason | None:
        """Send a received set-point of `size` bytes into the link at a model time [us], or return why not."""
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
        self._to_vehicle.send((self.sample.time_us, command), size, self._arrival_us)
        return None

    def deadline_us(self) -> int | None:
        """Return the wall time [us] at which `next_action` or `take_deliveries` changes, `None` for never."""
        flight = self._flight
        deadline_us = flight.deadline_us()
        if deadline_us is None or flight.paused:
            return deadline_us
        if self.joining:
            return self._resend_at_us
        return deadline_us if flight.lockstep else min(deadline_us, flight.wall_time_us(self._to_controller.next_us))

    def stats(self) -> dict[str, Any]:
        """Return the link's counters by direction."""
        return {"to_controller": self._to_controller.stats(), "to_vehicle": self._to_vehicle.stats()}

    def _schedule_event(self, item: ControllerEvent, scenario: Scenario) -> None:
        begins = scenario.nearest_sample(item.at_s)
        self._events_at.setdefault(begins, []).append(item)
        if isinstance(item, ModeChange):
            return
        away_s = item.for_s if isinstance(item, ControllerHang) else item.recovers_after_s
        start_us = begins * self._sample_us
        if away_s is None:
            self._outages.append((start_us, NEVER_US))
            return
        back = scenario.nearest_sample(item.at_s + away_s)
        self._outages.append((start_us, back * self._sample_us))
        if isinstance(item, ControllerKill):
            self._join_sample = back
            self._events_at.setdefault(back, [])

    def _wait_for_join(self, now_us: int) -> NextAction:
        """Hold time and repeat the current sample until a new controller flies, or the time-out."""
        if self._joined and self._flight.autopilot.mode is Mode.OFFBOARD:
            self.joining = self._controller_lost = False
        elif now_us >= self._join_by_us:
            self.joining, self._controller_lost = False, True
        elif now_us >= self._resend_at_us:
            self._resend_at_us = now_us + RESEND_US
            self.sample = self._loop.observe()
            # The new controller answers no older sample that is still on its way.
            self._newest_sent_us = self.sample.time_us
            return NextAction.RESEND
        else:
            return NextAction.WAIT
        return self.next_action(now_us)

    def _take_delivery(self, now_us: int) -> bool:
        """Take the next sample that reaches the controller before the current one ends; return whether there is one.

        Its answer is awaited, unless a newer sample overtook it: no law answers that. A repeated sample is answered
        again.
        """
        for arrival_us, sample in self._to_controller.take_all(self._loop.time_us + self._sample_us):
            if self._is_received(arrival_us):
                self.sample, self._arrival_us = sample, arrival_us
                if sample.time_us >= self._newest_sent_us:
                    self._newest_sent_us = sample.time_us
                    self._flight.await_answer(now_us)
                return True
        return False

    def _accept_arrivals(self) -> None:
        """Accept the set-points that arrive before the current sample ends."""
        flight, has_arrived = self._flight, False
        for _, (stamp_us, command) in self._to_vehicle.take_all(self._loop.time_us + self._sample_us):
            if flight.lockstep:
                overtaken = flight.setpoint is not None and stamp_us < self._newest_answer_us
            else:
                overtaken = flight.is_overtaken(command)
            if overtaken:
                self._to_vehicle.counters[LinkCounter.OVERTAKEN] += 1
                continue
            self._newest_answer_us, has_arrived = stamp_us, True
            flight.accept(command)
        if flight.lockstep and not has_arrived and flight.autopilot.mode is Mode.OFFBOARD:
            flight.counters[TimingFault.HELD] += 1

    def _is_received(self, time_us: int) -> bool:
        """Return whether a controller receives at a model time [us]; count a sample that it misses."""
        in_outage = any(start_us <= time_us < stop_us for start_us, stop_us in self._outages)
        is_received = not (self._controller_lost or in_outage)
        if not is_received:
            self._to_controller.counters[LinkCounter.UNHEARD] += 1
        return is_received
