"""Watch a controller fly the vehicle: what it sends, what it is answered, and when."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Address, Frame, Message, RejectReason, parse
from firmware_model.mavlink.messages import boot_ms, parse_imu
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.types import ImuSample

_LOOK_US = 50_000  # between two looks at the controller's process
_COMMANDS = (wire.MAVLINK_MSG_ID_COMMAND_LONG, wire.MAVLINK_MSG_ID_COMMAND_INT)
_WITHHELD = (30, 60, 90)  # samples whose first answer is lost on purpose, so that the vehicle sends them again
_MANY_ANSWERS = 100  # after which a trial in lockstep ends if answers are slow
SLOW_SAMPLES = 2.0
"""[-] sample times that half of the answers may take."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """A set-point that came."""

    stamp_ms: int
    """[ms] its stamp."""
    sample: int
    """Number of the sample that waited for an answer."""
    age_us: int | None
    """[us] wall time since the sample with its stamp was sent; `None` before the flight, or if there is none."""
    values: tuple[float, float, float, float]
    """Roll, pitch, yaw and thrust as sent: torques [-] or rates [rad/s]; NaN for rates beside an attitude."""
    is_torque: bool
    """True for SET_ACTUATOR_CONTROL_TARGET."""


@dataclass(slots=True)
class Sightings:
    """Everything seen of a controller."""

    heard_us: int | None = None
    """[us] wall time of the first datagram; `None` if none came."""
    began_us: int | None = None
    """[us] wall time at which the flight began; `None` if it did not."""
    datagrams: int = 0
    """Datagrams that came in flight."""
    messages: Counter[str] = field(default_factory=Counter)
    """Messages by name."""
    senders: Counter[tuple[int, int]] = field(default_factory=Counter)
    """Messages by system and component of the sender."""
    targets: Counter[tuple[int, int]] = field(default_factory=Counter)
    """Commands and set-points by system and component that they are for."""
    requests: set[int] = field(default_factory=set)
    """MAV_CMD of the commands that came; SET_MODE counts as one."""
    results: dict[int, list[int]] = field(default_factory=dict)
    """MAV_RESULT of the answers to each command, in order."""
    answers: list[Answer] = field(default_factory=list)
    """Set-points that came."""
    samples: list[ImuSample] = field(default_factory=list)
    """Samples of the flight that were sent, each once."""
    unequal: list[tuple[Answer, Answer]] = field(default_factory=list)
    """First and second answer to repeated samples, where they differ."""
    examples: dict[RejectReason, str] = field(default_factory=dict)
    """First message of those that were rejected for a cause, in words."""


class Witness:
    """Endpoint in front of a vehicle: it notes what passes, and loses a few answers so that samples come again.

    `is_alive` tells whether the controller's process still runs. A trial ends with the flight or the process. It also
    ends when the flight has not begun `patience_s` [s] after the first message, or `startup_s` [s] without one.
    """

    def __init__(
        self,
        vehicle: VehicleEndpoint,
        sample_us: int,
        is_alive: Callable[[], bool],
        *,
        patience_s: float,
        startup_s: float,
    ) -> None:
        self.vehicle, self.sample_us, self.seen = vehicle, sample_us, Sightings()
        self.died = self.is_slow = False
        self._is_alive = is_alive
        self._patience_us, self._startup_us = round(1e6 * patience_s), round(1e6 * startup_s)
        self._created_us: int | None = None
        self._look_us = 0
        self._sent_us: dict[int, int] = {}
        self._repeated: set[int] = set()
        self._withheld: dict[int, Answer] = {}

    @property
    def finished(self) -> bool:
        """True if the trial is over."""
        return self.vehicle.finished

    def receive(self, datagram: bytes, address: Address, now_us: int) -> None:
        """Note a datagram, and pass it on unless it is to be lost."""
        seen, before = self.seen, self.vehicle.counters.copy()
        seen.heard_us = now_us if seen.heard_us is None else seen.heard_us
        seen.datagrams += seen.began_us is not None
        frames = [item for item in parse(datagram) if isinstance(item, Frame)]
        lost = [self._note(frame, now_us) for frame in frames]
        if lost and all(lost):
            return
        self.vehicle.receive(datagram, address, now_us)
        for cause in self.vehicle.counters - before:
            seen.examples.setdefault(cause, ", ".join(_describe(frame) for frame in frames))

    def count_reject(self, cause: RejectReason, address: Address) -> None:
        """Count a datagram that was discarded unread."""
        self.seen.datagrams += 1
        self.vehicle.count_reject(cause, address)

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Do what is due, note the datagrams to send, and return them."""
        if now_us >= self._look_us:
            self._look(now_us)
        sent = self.vehicle.poll(now_us)
        if self.seen.began_us is None and self.vehicle.flight.started_us is not None:
            self.seen.began_us = now_us
        for datagram, _ in sent:
            for item in parse(datagram):
                if isinstance(item, Frame):
                    self._note_sent(item, now_us)
        return sent

    def deadline_us(self) -> int:
        """Return the wall time at which `poll` is needed at the latest."""
        return min(self.vehicle.deadline_us(), self._look_us)

    def _look(self, now_us: int) -> None:
        """End the trial if there is nothing more to see."""
        self._look_us, seen = now_us + _LOOK_US, self.seen
        self._created_us = now_us if self._created_us is None else self._created_us
        begins_by_us = (
            self._created_us + self._startup_us if seen.heard_us is None else seen.heard_us + self._patience_us
        )
        self.died = not (self._is_alive() or self.vehicle.finished)
        self.is_slow = self.vehicle.flight.lockstep and self.answers_slowly(_MANY_ANSWERS)
        if self.died or self.is_slow or (seen.began_us is None and now_us > begins_by_us):
            self.vehicle.interrupt()

    def answers_slowly(self, at_least: int) -> bool:
        """Return whether half of the answers, if there are enough, took more than `SLOW_SAMPLES`."""
        age_us = self.median_age_us
        return len(self.seen.answers) >= at_least and age_us > SLOW_SAMPLES * self.sample_us

    @property
    def median_age_us(self) -> float:
        """[us] median age of the answers in flight; NaN if there is none."""
        return median([each.age_us for each in self.seen.answers if each.age_us is not None] or [math.nan])

    @property
    def ignored_repeat(self) -> bool:
        """True if the last answer was lost, and the repeated sample got none."""
        return bool(self.seen.answers) and any(first is self.seen.answers[-1] for first in self._withheld.values())

    @property
    def stalled_at(self) -> int:
        """Number of the sample behind the last answered one."""
        return self.seen.answers[-1].sample + (not self.ignored_repeat)

    @property
    def is_machine_busy(self) -> bool:
        """True if the vehicle itself was late for half of its samples."""
        return self.vehicle.flight.latency.percentile_us(50.0) > 0.5 * self.sample_us

    def _note(self, frame: Frame, now_us: int) -> bool:
        """Note a message; return whether it is to be lost."""
        seen, message = self.seen, frame.message()
        seen.messages[message.get_type()] += 1
        seen.senders[frame.system, frame.component] += 1
        if frame.message_id == wire.MAVLINK_MSG_ID_SET_MODE:
            seen.requests.add(wire.MAV_CMD_DO_SET_MODE)
        if frame.message_id in _COMMANDS:
            seen.requests.add(message.command)
            seen.targets[message.target_system, message.target_component] += 1
        values = _setpoint(message)
        if values is None:
            return False
        seen.targets[message.target_system, message.target_component] += 1
        is_torque = frame.message_id == wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET
        stamp_ms = boot_ms(message.time_usec) if is_torque else message.time_boot_ms
        sent_us = self._sent_us.get(stamp_ms)
        answer = Answer(
            stamp_ms=stamp_ms,
            sample=self.vehicle.loop.sample,
            age_us=None if sent_us is None else now_us - sent_us,
            values=values,
            is_torque=is_torque,
        )
        seen.answers.append(answer)
        return self._is_lost(answer)

    def _is_lost(self, answer: Answer) -> bool:
        """Return whether an answer is to be lost; compare the one to the repeated sample with it."""
        flight, sample = self.vehicle.flight, answer.sample
        answers_it = flight.running and flight.lockstep and answer.stamp_ms == boot_ms(flight.time_us)
        if not answers_it or sample not in _WITHHELD:
            return False
        first = self._withheld.setdefault(sample, answer)
        if sample not in self._repeated:
            return True
        if repr(first.values) != repr(answer.values) and answer.sample == first.sample:  # NaN equals NaN here
            self.seen.unequal.append((first, answer))
        return False

    def _note_sent(self, frame: Frame, now_us: int) -> None:
        if frame.message_id == wire.MAVLINK_MSG_ID_COMMAND_ACK:
            message = frame.message()
            self.seen.results.setdefault(message.command, []).append(message.result)
        if frame.message_id != wire.MAVLINK_MSG_ID_HIGHRES_IMU or not self.vehicle.flight.running:
            return
        sample = parse_imu(frame)
        if isinstance(sample, RejectReason):
            return
        stamp_ms = boot_ms(sample.time_us)
        if stamp_ms in self._sent_us:
            self._repeated.add(self.vehicle.loop.sample)
            return
        self._sent_us[stamp_ms] = now_us
        self.seen.samples.append(sample)


def _setpoint(message: Message) -> tuple[float, float, float, float] | None:
    """Return roll, pitch, yaw and thrust of a set-point as sent; `None` for any other message."""
    if message.get_msgId() == wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET:
        roll, pitch, yaw, thrust = message.controls[:4]
        return roll, pitch, yaw, thrust
    if message.get_msgId() != wire.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET:
        return None
    if not message.type_mask & wire.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE:
        return math.nan, math.nan, math.nan, message.thrust
    return message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate, message.thrust


def _describe(frame: Frame) -> str:
    """Return a message in words: its name, and the numbers of a set-point."""
    message = frame.message()
    values = _setpoint(message)
    numbers = f" {', '.join(f'{value:g}' for value in values)}" if values else ""
    return f"{message.get_type()}{numbers}"
