"""The vehicle as a sans-I/O MAVLink peer: who listens, what is streamed, commands, and the pace of the flight.

    datagram --receive--> parse -> set-points, commands, parameters
    time     --poll-----> fly samples that are due -> streams, heartbeats, answers --> datagrams

Before t = 0 the airframe is clamped and sample 0 is repeated on wall time. The flight begins when the vehicle is armed
in OFFBOARD. In lockstep sample k is sent to the commanding peer and waited for; in real time samples are due on
absolute deadlines and a late command holds the last one.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as wire

from firmware_model import messages
from firmware_model.autopilot import Autopilot, Event, Mode
from firmware_model.flight import Due, Flight
from firmware_model.frames import Dropped, Frame, Message, Outgoing, Peer, parse
from firmware_model.listener import NEVER_US, Listener
from firmware_model.loop import VehicleLoop
from firmware_model.params import STREAM_TIMEOUT_NAME, Parameters
from firmware_model.scenario import Scenario
from firmware_model.services import commands
from firmware_model.services import parameters as parameter_service
from firmware_model.signals import AttitudeTarget, TorqueCommand
from firmware_model.vehicle import Vehicle

HEARTBEAT_US = 1_000_000
"""[us] wall time from heartbeat to heartbeat."""
SILENCE_US = 10_000_000
"""[us] wall time after which a silent peer is forgotten."""
START_TIMEOUT_US = 60_000_000
"""[us] wall time that a lockstep flight waits for its first command."""
MAX_PEERS = 16
"""Peers served at once; more are refused, so that a flood of addresses can't fill the memory."""
_BATCH = 250  # samples flown in one poll at most, so that heartbeats and Ctrl-C are not kept waiting

_WAIT, _ADVANCE = Due.WAIT, Due.ADVANCE  # to look up a member of an Enum takes .1 us
_IMU = wire.MAVLINK_MSG_ID_HIGHRES_IMU
_REQUESTS = (
    wire.MAVLINK_MSG_ID_COMMAND_LONG,
    wire.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
    wire.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
    wire.MAVLINK_MSG_ID_PARAM_SET,
)
_SETPOINTS = (wire.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET)


class Outcome(Enum):
    """How a flight ended."""

    DONE = "done"
    """Flown to its end in OFFBOARD."""
    STREAM_LOST = "stream_lost"
    """The set-points stopped; the on-board loop flew to the end."""
    LEFT_OFFBOARD = "left_offboard"
    """Another mode was asked for; the on-board loop flew to the end."""
    NO_CONTROLLER = "no_controller"
    """Nobody began the lockstep flight in time."""
    INTERRUPTED = "interrupted"
    """Ctrl-C or a termination signal."""


@dataclass(frozen=True, slots=True)
class _Asker:
    """A command's reach into the streams of its sender."""

    endpoint: "VehicleEndpoint"
    """Whose streams they are."""
    listener: Listener
    """The sender."""
    clock_us: int
    """[us] time of the request."""

    def set_interval(self, message_id: int, interval_us: int) -> bool:
        """Set the time between two messages to this peer."""
        return self.listener.set_interval(message_id, interval_us, self.clock_us)

    def request(self, message_id: int) -> bool:
        """Send a message once."""
        return self.endpoint.send_once(message_id, self.listener)


class VehicleEndpoint:
    """One vehicle in one scripted flight; give it datagrams and the time, send what it returns."""

    def __init__(
        self,
        vehicle: Vehicle,
        scenario: Scenario,
        seed: int,
        record: Callable[[NDArray[np.float64]], None],
        *,
        lockstep: bool,
        system: int = 1,
        expected: Iterable[Peer] = (),
    ) -> None:
        self.parameters = Parameters(vehicle, scenario)
        self.autopilot = Autopilot(self._stream_timeout_us())
        loop = VehicleLoop(vehicle, scenario, seed)
        self.flight = Flight(loop, self.autopilot, record, sample_us=scenario.sample_us, lockstep=lockstep)
        self.outcome: Outcome | None = None
        self.finished = False
        self.counters: Counter[Dropped] = Counter()
        self._system = system
        self._outbox: list[tuple[bytes, Peer]] = []
        self._listeners = {address: self._new_listener(address, expected=True) for address in expected}
        self._commander: Listener | None = None
        self._stream_lost = False
        self._heartbeat_at_us = 0
        self._created_us: int | None = None
        self._announced: tuple[Mode, bool] | None = None

    def interrupt(self) -> None:
        """End the flight here: Ctrl-C or a termination signal."""
        self.outcome = self.outcome or Outcome.INTERRUPTED
        self.finished = True

    def receive(self, datagram: bytes, peer: Peer, now_us: int) -> None:
        """Take a datagram; never raises, what can't be used is counted by its cause."""
        for item in parse(datagram):
            if isinstance(item, Dropped):
                self.counters[item] += 1
            elif (listener := self._heard(peer, item, now_us)) is None:
                self.counters[Dropped.TOO_MANY_PEERS] += 1
            elif cause := self._dispatch(item, listener, now_us):
                self.counters[cause] += 1

    def poll(self, now_us: int) -> list[tuple[bytes, Peer]]:
        """Do what is due and return the datagrams to send."""
        if self.flight.ready():
            self.flight.begin(now_us)
        for _ in range(_BATCH):
            due = self.flight.due(now_us)
            if due is _WAIT:
                break
            if due is _ADVANCE:
                self._advance(now_us)
            if self._commander is not None and self.flight.asks():
                self._send(messages.imu_message(self.flight.loop.observe()), self._commander)
        self._stream(self.flight.clock_us(now_us))
        if now_us >= self._heartbeat_at_us or self._announced != (self.autopilot.mode, self.autopilot.armed):
            self._beat(now_us)
        outbox, self._outbox = self._outbox, []
        return outbox

    def deadline_us(self) -> int:
        """Return the wall time at which `poll` has something to do, at the latest."""
        flight_us = self.flight.deadline_us()
        if flight_us is None:
            flight_us = min((listener.next_us for listener in self._listeners.values()), default=NEVER_US)
        return min(self._heartbeat_at_us, flight_us)

    def send_once(self, message_id: int, listener: Listener) -> bool:
        """Send the message with this id as it stands; False if there is none."""
        message = self._message(message_id)
        if message is not None:
            self._send(message, listener)
        return message is not None

    def _dispatch(self, frame: Frame, listener: Listener, now_us: int) -> Dropped | None:
        kind = frame.message_id
        if kind in _SETPOINTS:
            return self._take_setpoint(frame, listener, now_us)
        if kind not in _REQUESTS:
            return None if kind == wire.MAVLINK_MSG_ID_HEARTBEAT else Dropped.UNUSED_MESSAGE
        request = frame.message()
        if not messages.is_for(self._system, request.target_system, request.target_component):
            return Dropped.OTHER_TARGET
        if kind == wire.MAVLINK_MSG_ID_COMMAND_LONG:
            self._execute(request, listener, self.flight.clock_us(now_us))
            return None
        for reply in parameter_service.replies(self.parameters, request):
            # Whoever shows parameters must hear of a change that another one made.
            shared = kind == wire.MAVLINK_MSG_ID_PARAM_SET and reply.get_msgId() == wire.MAVLINK_MSG_ID_PARAM_VALUE
            for receiver in self._listeners.values() if shared else (listener,):
                self._send(reply, receiver)
        self.autopilot.stream_timeout_us = self._stream_timeout_us()
        return None

    def _execute(self, command: Message, listener: Listener, clock_us: int) -> None:
        asker = _Asker(self, listener, clock_us)
        result, text = commands.execute(command, self.autopilot, asker, clock_us)
        self._send(commands.acknowledgement(command, result), listener)
        if text:
            self._tell(text, wire.MAV_SEVERITY_WARNING)

    def _take_setpoint(self, frame: Frame, listener: Listener, now_us: int) -> Dropped | None:
        rival = self._commander is not None and self._commander is not listener
        if rival and self.autopilot.stream_alive(self.flight.clock_us(now_us)):
            return Dropped.NOT_IN_COMMAND
        command = messages.command(frame, self._system)
        if isinstance(command, Dropped):
            return command
        cause = self.flight.offer(command, now_us)
        if cause is None:
            self._commander = listener
        return cause

    def _advance(self, now_us: int) -> None:
        event = self.flight.advance(now_us)
        if event is not None:
            self._stream_lost = self._stream_lost or event is Event.STREAM_LOST
            self._tell(event.value, wire.MAV_SEVERITY_CRITICAL)
        if self.flight.landed_us is not None:
            offboard = self.autopilot.mode is Mode.OFFBOARD
            flown = Outcome.DONE if offboard else Outcome.LEFT_OFFBOARD
            self.outcome = Outcome.STREAM_LOST if self._stream_lost else flown
            self.finished = True

    def _stream(self, clock_us: int) -> None:
        for listener in self._listeners.values():
            for message_id in listener.take_due(clock_us):
                # The commander gets every sample of the flight as it is taken.
                if message_id != _IMU or listener is not self._commander or not self.flight.airborne:
                    self.send_once(message_id, listener)

    def _beat(self, now_us: int) -> None:
        """Send HEARTBEAT to all, and forget who has been silent for too long."""
        self._heartbeat_at_us = now_us + HEARTBEAT_US
        self._announced = (self.autopilot.mode, self.autopilot.armed)
        for listener in list(self._listeners.values()):
            if listener.heard_us is not None and now_us > listener.heard_us + SILENCE_US:
                self._forget(listener)
        for listener in self._listeners.values():
            self.send_once(wire.MAVLINK_MSG_ID_HEARTBEAT, listener)
        self._created_us = now_us if self._created_us is None else self._created_us
        waiting = self.flight.lockstep and self.flight.started_us is None
        if waiting and now_us > self._created_us + START_TIMEOUT_US:
            self.outcome = Outcome.NO_CONTROLLER
            self.finished = True

    def _forget(self, listener: Listener) -> None:
        del self._listeners[listener.address]
        if listener is self._commander:
            self._commander = None
        if listener.expected:
            self._listeners[listener.address] = self._new_listener(listener.address, expected=True)

    def _heard(self, address: Peer, frame: Frame, now_us: int) -> Listener | None:
        listener = self._listeners.get(address)
        if listener is None:
            if len(self._listeners) >= MAX_PEERS:
                return None
            listener = self._listeners[address] = self._new_listener(address, expected=False)
        if not listener.controller:
            listener.identify(frame, lockstep=self.flight.lockstep, clock_us=self.flight.clock_us(now_us))
        listener.heard_us = now_us
        return listener

    def _stream_timeout_us(self) -> int:
        return round(1e6 * self.parameters[STREAM_TIMEOUT_NAME])

    def _new_listener(self, address: Peer, *, expected: bool) -> Listener:
        return Listener(address, self._system, expected=expected)

    def _tell(self, text: str, severity: int) -> None:
        for listener in self._listeners.values():
            self._send(wire.MAVLink_statustext_message(severity, text.encode()), listener)

    def _send(self, message: Message | Outgoing, listener: Listener) -> None:
        self._outbox.append((listener.pack(message), listener.address))

    def _message(self, message_id: int) -> Message | Outgoing | None:
        loop, setpoint = self.flight.loop, self.flight.setpoint
        match message_id:
            case wire.MAVLINK_MSG_ID_HEARTBEAT:
                failed = self._stream_lost and self.autopilot.mode is not Mode.OFFBOARD
                return messages.heartbeat_message(self.autopilot.mode.value, self.autopilot.armed, critical=failed)
            case wire.MAVLINK_MSG_ID_HIGHRES_IMU:
                return messages.imu_message(loop.observe())
            case wire.MAVLINK_MSG_ID_ATTITUDE:
                return messages.attitude_message(loop.observe(), loop.estimate_q_NB)
            case wire.MAVLINK_MSG_ID_ATTITUDE_QUATERNION:
                return messages.attitude_quaternion_message(loop.observe(), loop.estimate_q_NB)
            case wire.MAVLINK_MSG_ID_HIL_STATE_QUATERNION:
                sample, truth = loop.observe(), loop.truth
                return messages.truth_message(
                    sample, loop.q_NB, truth("omega_B"), truth("position_N"), truth("velocity_N")
                )
            case wire.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET if isinstance(setpoint, TorqueCommand):
                return messages.command_echo(setpoint)
            case wire.MAVLINK_MSG_ID_ATTITUDE_TARGET if isinstance(setpoint, AttitudeTarget):
                return messages.command_echo(setpoint)
            case wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                return messages.version_message()
        return None
