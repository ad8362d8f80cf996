"""The vehicle as a sans-I/O MAVLink peer: the pace of the flight, who flies it, and the services around it.

    datagram --receive--> parse -> set-points | the service that answers such a message
    time     --poll-----> fly samples that are due -> streams, heartbeats, answers --> datagrams

Before t = 0 of a scripted flight the airframe is clamped and sample 0 is repeated on wall time. The flight begins when
the vehicle is armed in OFFBOARD. In lockstep sample k is sent to the commanding peer and waited for; in real time
samples are due on absolute deadlines and a late command holds the last one. A standing vehicle begins when it is first
polled. Where the script interferes with the conversation, an `ScriptedLink` leads it.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Autopilot, Mode, TransitionResult
from firmware_model.autopilot.parameters import GUST_SCALE_NAME, PAUSE_NAME, Parameters
from firmware_model.config.events import ControllerKill, ModeChange
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import Address, EncodedMessage, Frame, Message, RejectReason, parse
from firmware_model.mavlink.peers import Peer, PeerTable, RequestContext
from firmware_model.mavlink.services import make_services
from firmware_model.mavlink.services.service import Client
from firmware_model.mavlink.signing import Signing
from firmware_model.session.lockstep import FastPath
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.pacing import FlightClock, NextAction, TimingFault
from firmware_model.session.scripted_link import ScriptedLink
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import Command, ImuSample

HEARTBEAT_US = 1_000_000
"""[us] wall time from heartbeat to heartbeat."""
START_TIMEOUT_US = 60_000_000
"""[us] wall time that a lockstep flight waits for its first command."""
_MAX_BATCH = 250  # samples flown in one poll at most, so that heartbeats and Ctrl-C are not kept waiting

_WAIT, _ADVANCE = NextAction.WAIT, NextAction.ADVANCE  # to look up a member of an Enum takes .1 us
_IMU = wire.MAVLINK_MSG_ID_HIGHRES_IMU
_STATE_MESSAGES = (
    wire.MAVLINK_MSG_ID_HEARTBEAT,
    wire.MAVLINK_MSG_ID_CURRENT_MODE,
    wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
)
_COMMANDS = (wire.MAVLINK_MSG_ID_COMMAND_LONG, wire.MAVLINK_MSG_ID_COMMAND_INT)
_SETPOINTS = (wire.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET)


class VehicleEndpoint:
    """One vehicle, `standing` or in one scripted flight; give it datagrams and the time, send what it returns.

    It is the `Craft` of its services.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        scenario: Scenario,
        seed: int,
        record: Callable[[NDArray[np.float64]], None],
        *,
        lockstep: bool,
        standing: bool = False,
        system: int = 1,
        expected: Iterable[Address] = (),
        signing: Signing | None = None,
        generic: bool = False,
        flush: Callable[[], None] = lambda: None,
    ) -> None:
        self.generic = generic
        self.parameters = Parameters(vehicle, scenario, bytewise=not generic)
        self.autopilot = Autopilot(self.parameters.settings(), free=scenario.free)
        self.loop = VehicleLoop(vehicle, scenario, seed, interactive=standing)
        linked = scenario.has_link_script and not standing
        self.flight = FlightClock(
            self.loop, self.autopilot, record,
            sample_us=scenario.sample_us, lockstep=lockstep, standing=standing, linked=linked,
        )  # fmt: skip
        self.exchange = ScriptedLink(scenario, seed, self.flight, self.loop) if linked else None
        self._pace = self.exchange or self.flight
        self._flush = flush
        self.outcome: VehicleOutcome | None = None
        self.finished = False
        self.counters: Counter[RejectReason] = Counter()
        self._signing = signing
        self.system = system
        self.services = make_services(self)
        self._streams, self._requests = self.services.streams, self.services.requests
        intervals_us = {number: stream.interval_us for number, stream in self._streams.items() if stream.interval_us}
        self._peers = PeerTable(system, signing, intervals_us, expected, min_interval_us=scenario.sample_us)
        self._outbox: list[tuple[bytes, Address]] = []
        self._commander: Peer | None = None
        self._killed_peer: Peer | None = None
        self._stream_lost = False
        self._now_us = self._heartbeat_at_us = 0
        self._fast_path = FastPath(self.flight, scenario, system, possible=lockstep and not linked and signing is None)
        self._created_us: int | None = None
        self._announced_state: tuple[Mode, bool, bool] | None = None

    def interrupt(self) -> None:
        """End the flight here: Ctrl-C or a termination signal."""
        self.outcome = self.outcome or VehicleOutcome.INTERRUPTED
        self.finished = True

    def receive(self, datagram: bytes, peer: Address, now_us: int) -> None:
        """Take a datagram; never raises, what can't be used is counted by its cause."""
        self._now_us = now_us
        sample = self._fast_path.take(datagram, peer, now_us)
        if sample is not None:
            self._outbox.append((sample, peer))
            return
        self.flight.tick(now_us)
        if self._signing is not None:
            self._signing.tick(now_us)
        for item in parse(datagram):
            cause = item if isinstance(item, RejectReason) else self._take(item, peer, now_us)
            if cause is not None:
                self.drop(cause, peer)

    def drop(self, cause: RejectReason, peer: Address) -> None:
        """Count something of a peer's that has no effect."""
        self.counters[cause] += 1
        self._peers.drop(peer, cause)

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Do what is due and return the datagrams to send."""
        self._now_us = now_us
        if self._fast_path.taken() and now_us < self._heartbeat_at_us:
            return self._sent()
        if self._signing is not None:
            self._signing.tick(now_us)
        if self.flight.ready():
            self.flight.begin(now_us)
            if self.exchange is not None:
                self._begin_sample(self.exchange, now_us)
        for _ in range(_MAX_BATCH):
            due = self._pace.due(now_us)
            if due is _WAIT:
                break
            if due is _ADVANCE:
                self._advance(now_us)
            if self.exchange is not None:
                self._step_script(self.exchange, due, now_us)
            elif not self.flight.lockstep:
                self._stream(self.flight.clock_us(now_us))  # each sample of those that are made up for
            elif self._commander is not None and self.flight.asks():
                self._send(messages.imu_message(self.loop.observe()), self._commander)
        if self.exchange is not None and not self.flight.lockstep:
            for sample in self.exchange.deliveries(self.stamp_us):
                self._deliver(sample)
        self._stream(self.flight.clock_us(now_us))
        autopilot = self.autopilot
        state = autopilot.mode, autopilot.armed, autopilot.airborne
        if now_us >= self._heartbeat_at_us or state != self._announced_state:
            self._beat(now_us, state)
        self._fast_path.prepare(self._commander, self._peers)
        return self._sent()

    def deadline_us(self) -> int:
        """Return the wall time at which `poll` has something to do, at the latest."""
        flight_us = self._pace.deadline_us()
        return min(self._heartbeat_at_us, self._peers.next_us if flight_us is None else flight_us)

    @property
    def setpoint(self) -> Command | None:
        """What is tracked, if an outside controller said so."""
        return self.flight.setpoint

    @property
    def failed(self) -> bool:
        """Whether the fail-safe flies."""
        return self.autopilot.in_fail_safe

    @property
    def clock_us(self) -> int:
        """[us] the clock of time-outs: wall time while clamped, model time from there on."""
        return self.flight.clock_us(self._now_us)

    @property
    def stamp_us(self) -> int:
        """[us] model time now, between two samples too: the clock of the messages' stamps."""
        return self.loop.time_us + self.flight.sample_age_us(self._now_us)

    def relay(self, message: Message, source: Client) -> None:
        """Pass a message of the on-board controller on to all peers but the one that it came from."""
        if self._signing is not None and not message.get_header().incompat_flags & wire.MAVLINK_IFLAG_SIGNED:
            return  # what nobody has signed is not signed here
        for listener in self._peers:
            if not (isinstance(source, RequestContext) and source.listener is listener):
                self._outbox.append((listener.pack(message, messages.CONTROLLER), listener.address))

    @property
    def links(self) -> dict[str, dict[str, Any]]:
        """What came and went between here and each peer."""
        return self._peers.figures()

    def broadcast(self, message: Message | EncodedMessage) -> None:
        """Send a message to all peers."""
        for listener in self._peers:
            self._send(message, listener)

    def tell(self, text: str, severity: int) -> None:
        """Tell all peers a line of at most 50 characters."""
        self.broadcast(wire.MAVLink_statustext_message(severity, text.encode()))

    def apply_parameters(self) -> None:
        """Let changed parameters act."""
        self.autopilot.settings = self.parameters.settings()
        self.loop.set_gust_scale(self.parameters[GUST_SCALE_NAME])
        self.loop.set_stabilizer(self.parameters.stabilizer())
        self.loop.set_position_loop(self.parameters.position_loop())
        self.flight.pause(self._now_us, paused=bool(self.parameters[PAUSE_NAME]))

    def _sent(self) -> list[tuple[bytes, Address]]:
        outbox, self._outbox = self._outbox, []
        return outbox

    def _take(self, frame: Frame, peer: Address, now_us: int) -> RejectReason | None:
        # Before anything else: who does not prove himself takes no place among the peers.
        if self._signing is not None and (cause := self._signing.refusal(frame)):
            return cause
        listener = self._heard(peer, frame, now_us)
        return RejectReason.TOO_MANY_PEERS if listener is None else self._dispatch(frame, listener)

    def _dispatch(self, frame: Frame, listener: Peer) -> RejectReason | None:
        kind = frame.message_id
        if kind in _SETPOINTS:
            return self._take_setpoint(frame, listener)
        handler = self._requests.get(kind)
        if handler is None:
            return None if kind == wire.MAVLINK_MSG_ID_HEARTBEAT else RejectReason.UNUSED_MESSAGE
        request = frame.message()
        system = getattr(request, "target_system", getattr(request, "target", 0))
        component = getattr(request, "target_component", 0)
        absent = kind in _COMMANDS and component in messages.ABSENT
        if not messages.is_addressed_to(self.system, system, messages.AUTOPILOT if absent else component):
            return RejectReason.OTHER_TARGET
        speaker = component if absent else messages.AUTOPILOT
        return handler(request, RequestContext(listener, self._outbox, self.clock_us, speaker))

    def _take_setpoint(self, frame: Frame, listener: Peer) -> RejectReason | None:
        rival = self._commander is not None and self._commander is not listener
        if (rival and self.autopilot.is_stream_alive) or listener is self._killed_peer:
            return RejectReason.NOT_IN_COMMAND
        command = messages.parse_command(frame, self.system)
        if isinstance(command, RejectReason):
            return command
        if self.exchange is not None and self.flight.running:
            cause = self.exchange.answer(command, len(frame.raw), self.stamp_us)
        else:
            cause = self.flight.offer(command)
        if cause is None:
            self._commander = listener
        return cause

    def _advance(self, now_us: int) -> None:
        self.flight.advance(now_us)
        for event in self.autopilot.take_events():
            self._stream_lost = self._stream_lost or event.is_critical
            self.tell(event.value, wire.MAV_SEVERITY_CRITICAL if event.is_critical else wire.MAV_SEVERITY_INFO)
        if self.flight.ended_us is not None:
            flown = VehicleOutcome.LEFT_OFFBOARD if self.flight.left_offboard else VehicleOutcome.DONE
            self.outcome = VehicleOutcome.STREAM_LOST if self._stream_lost else flown
            self.finished = True

    def _step_script(self, exchange: ScriptedLink, due: NextAction, now_us: int) -> None:
        """Go on with a conversation that the script interferes with, after what was due."""
        if due is not _ADVANCE:
            # The controller knows the mode with each sample, however long the script let it be silent.
            state = self.autopilot.mode, self.autopilot.armed, self.autopilot.airborne
            if state != self._announced_state:
                self._beat(now_us, state)
            if exchange.sample is not None:
                self._deliver(exchange.sample)
            return
        if self.flight.running:
            self._begin_sample(exchange, now_us)
        if not self.flight.lockstep:
            self._stream(self.flight.clock_us(now_us))

    def _begin_sample(self, exchange: ScriptedLink, now_us: int) -> None:
        """Begin a sample of the conversation, and let happen what the script says."""
        incidents = exchange.begin_sample(now_us)
        if incidents is not None:
            self._flush()  # whoever reads the journal is to know that it is time
        for incident in incidents or ():
            if isinstance(incident, ControllerKill):
                self._killed_peer, self._commander = self._commander, None
            elif isinstance(incident, ModeChange):
                verdict = self.autopilot.set_mode(Mode[incident.mode.upper()])
                if verdict is not TransitionResult.ACCEPTED:
                    self.flight.counters[TimingFault.REFUSED] += 1
                    self.tell(verdict.value, wire.MAV_SEVERITY_WARNING)

    def _deliver(self, sample: ImuSample) -> None:
        """Send a sample to who is in command, or to whoever may take the place of one that was killed."""
        joining = self.exchange is not None and self.exchange.joining
        for listener in self._peers:
            invited = joining and listener.controller and listener is not self._killed_peer
            if invited or listener is self._commander:
                self._send(messages.imu_message(sample), listener)

    def _has_sample_stream(self, listener: Peer) -> bool:
        """Whether a peer gets every sample of the flight as it is taken, or as it comes through the link."""
        if listener is self._commander:
            return self.flight.lockstep or self.exchange is not None
        return self.exchange is not None and self.flight.lockstep and listener.controller

    def _stream(self, clock_us: int) -> None:
        for listener in self._peers:
            for message_id in listener.take_due(clock_us):
                if message_id == _IMU and self.flight.running and self._has_sample_stream(listener):
                    continue
                message = self._streams[message_id].message()
                if message is not None:
                    self._send(message, listener)

    def _beat(self, now_us: int, state: tuple[Mode, bool, bool]) -> None:
        """Send HEARTBEAT to all, with more if `state` is new, and forget who has been silent for too long."""
        self._heartbeat_at_us = now_us + HEARTBEAT_US
        if self._commander in self._peers.remove_silent(now_us):
            self._commander = None
        changed = self._announced_state not in (None, state)
        self._announced_state = state
        for message_id in _STATE_MESSAGES if changed else _STATE_MESSAGES[:1]:
            self.broadcast(self._streams[message_id].message())
        self._created_us = now_us if self._created_us is None else self._created_us
        waiting = self.flight.lockstep and self.flight.started_us is None
        if waiting and now_us > self._created_us + START_TIMEOUT_US:
            self.outcome = VehicleOutcome.NO_CONTROLLER
            self.finished = True

    def _heard(self, address: Address, frame: Frame, now_us: int) -> Peer | None:
        listener = self._peers.at(address)
        if listener is not None:
            if not listener.controller:
                listener.identify(frame, lockstep=self.flight.lockstep, clock_us=self.flight.clock_us(now_us))
            listener.last_seen_us = now_us
            listener.traffic.count(frame)
        return listener

    def _send(self, message: Message | EncodedMessage, listener: Peer) -> None:
        self._outbox.append((listener.traffic.pack(message), listener.address))
