"""The vehicle as a sans-I/O MAVLink endpoint: flight clock, commanding peer, and MAVLink services.

    datagram --receive--> parse -> set-point, or the service that handles the message
    time     --poll-----> fly the samples that are due -> streams, heartbeats, answers --> datagrams

Before t = 0 of a scripted flight the airframe is clamped, and sample 0 is repeated on wall time. The flight begins when
the vehicle is armed in OFFBOARD. In lockstep, sample k goes to the commanding peer, and the vehicle waits for the
answer. In real time, samples are due on absolute deadlines, and the last command is held while the next one is late.
An interactive vehicle begins at its first poll. If the script has link faults or events, a `ScriptedLink` carries
samples and set-points.
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
from firmware_model.errors import ConfigError
from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import Address, EncodedMessage, Frame, Message, RejectReason, parse
from firmware_model.mavlink.peers import Client, Peer, PeerTable
from firmware_model.mavlink.services import make_services
from firmware_model.mavlink.services.refusals import refuse_unread
from firmware_model.mavlink.signing import Signing
from firmware_model.mavlink.wire import MOST_TURNS, LockstepLine, make_line
from firmware_model.session.exchange import SampleTurns, fly_samples, read_command
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.pacing import FlightClock, NextAction, TimingFault
from firmware_model.session.scripted_link import ScriptedLink
from firmware_model.sim.inner_loop import RATES, TORQUE
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import NEVER_US, Command, ImuSample, TorqueCommand

HEARTBEAT_US = 1_000_000
"""[us] Wall time from heartbeat to heartbeat."""
START_TIMEOUT_US = 60_000_000
"""[us] Wall time that a lockstep flight waits for its first command."""
_MAX_BATCH = 250  # samples flown in one poll at most, so that heartbeats and Ctrl-C need not wait

_MOST_UNWRITTEN_US = 800_000  # model time in one call of machine code, whose records are in memory alone
_WARN_AGAIN_US = 5_000_000  # [us] least time between two equal warnings

_WAIT, _ADVANCE = NextAction.WAIT, NextAction.ADVANCE  # looking up an Enum member takes .1 us
_IMU = wire.MAVLINK_MSG_ID_HIGHRES_IMU
_STATE_MESSAGES = (
    wire.MAVLINK_MSG_ID_HEARTBEAT,
    wire.MAVLINK_MSG_ID_CURRENT_MODE,
    wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
)
_COMMANDS = (wire.MAVLINK_MSG_ID_COMMAND_LONG, wire.MAVLINK_MSG_ID_COMMAND_INT)
_REFUSED_SETPOINTS = {
    RejectReason.NOT_FINITE: "set-points refused: NaN or infinite",
    RejectReason.BAD_QUATERNION: "set-points refused: quaternion not of length 1",
    RejectReason.NO_SETPOINT: "set-points refused: no thrust, or no target",
}
_UNSIGNED = "signatures not checked: start with --signing-key"
_CLOCKS = {
    RejectReason.AHEAD_OF_CLOCK: "signature refused: a clock is over 1 min ahead",
    RejectReason.OUT_OF_DATE: "signature refused: a clock is over 1 min behind",
}
_SETPOINTS = (wire.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET)


class VehicleEndpoint:
    """One vehicle, `interactive` or in one scripted flight: pass it datagrams and the time, send what it returns.

    It is the `VehicleContext` of its services. Set `flush` to a function that flushes the journal; it is called when an
    event of the script begins, and before machine code flies.

    Raises
    ------
    ConfigError
        If the scenario has an event that it would not notice.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        scenario: Scenario,
        seed: int,
        record: Callable[[NDArray[np.float64]], None],
        *,
        lockstep: bool,
        interactive: bool = False,
        system: int = 1,
        expected: Iterable[Address] = (),
        signing: Signing | None = None,
        generic: bool = False,
    ) -> None:
        if scenario.unread:
            raise ConfigError(scenario.unread)
        self.generic = generic
        self.parameters = Parameters(vehicle, scenario, bytewise=not generic)
        self.autopilot = Autopilot(self.parameters.settings(), free=scenario.free)
        self.loop = VehicleLoop(vehicle, scenario, seed, interactive=interactive)
        linked = scenario.has_link_script and not interactive
        self.flight = FlightClock(
            self.loop,
            self.autopilot,
            record,
            sample_us=scenario.sample_us,
            lockstep=lockstep,
            interactive=interactive,
            has_scripted_link=linked,
        )
        self.scripted_link = ScriptedLink(scenario, seed, self.flight, self.loop) if linked else None
        self._pacer = self.scripted_link or self.flight
        self.flush: Callable[[], None] = lambda: None
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
        self._warned_us: dict[str, int] = {}
        self._now_us = self._heartbeat_at_us = 0
        self._created_us: int | None = None
        self._announced_state: tuple[Mode, bool, bool] | None = None
        self.exchanges = lockstep and not linked and signing is None and not scenario.holds_place
        """True if machine code may fly its samples, see `exchange`."""
        self._line: tuple[tuple[Address, bool], LockstepLine] | None = None
        self._last, self._sample_us = scenario.samples - 1, scenario.sample_us
        self._most_turns = max(min(_MOST_UNWRITTEN_US // scenario.sample_us, MOST_TURNS), 1)
        self._records = np.empty((MOST_TURNS, self.loop.record().size))

    def interrupt(self) -> None:
        """End the flight here: Ctrl-C or a termination signal."""
        self.outcome = self.outcome or VehicleOutcome.INTERRUPTED
        self.finished = True

    def receive(self, datagram: bytes, address: Address, now_us: int) -> None:
        """Handle a datagram; never raise, count an unusable one by its reason."""
        self._now_us = now_us
        self.flight.tick(now_us)
        if self._signing is not None:
            self._signing.tick(now_us)
        for item in parse(datagram):
            cause = item if isinstance(item, RejectReason) else self._handle_frame(item, address, now_us)
            if cause is not None:
                self.count_reject(cause, address)

    def count_reject(self, cause: RejectReason, address: Address) -> None:
        """Count a datagram or message that has no effect."""
        self.counters[cause] += 1
        self._peers.count_reject(cause, address)

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Do what is due and return the datagrams to send."""
        self._now_us = now_us
        if self._signing is not None:
            self._signing.tick(now_us)
        if self.flight.is_ready():
            self.flight.begin(now_us)
            if self.scripted_link is not None:
                self._begin_sample(self.scripted_link, now_us)
        self._fly_due_samples(now_us)
        self._send_streams(self.flight.clock_us(now_us))
        if now_us >= self._heartbeat_at_us or self._state != self._announced_state:
            self._send_heartbeat(now_us)
        outbox, self._outbox = self._outbox, []
        return outbox

    def deadline_us(self) -> int:
        """Return the wall time at which `poll` is needed at the latest."""
        flight_us = self._pacer.deadline_us()
        return min(self._heartbeat_at_us, self._peers.next_us if flight_us is None else flight_us)

    @property
    def setpoint(self) -> Command | None:
        """Tracked set-point of an outside controller, if there is one."""
        return self.flight.setpoint

    @property
    def clock_us(self) -> int:
        """[us] Clock of time-outs: wall time while clamped, model time from there on."""
        return self.flight.clock_us(self._now_us)

    @property
    def stamp_us(self) -> int:
        """[us] Model time now, between samples too: the clock of message stamps."""
        return self.loop.time_us + self.flight.sample_age_us(self._now_us)

    @property
    def links(self) -> dict[str, dict[str, Any]]:
        """Packet counters by peer."""
        return self._peers.stats()

    def relay(self, message: Message, source: Client) -> None:
        """Forward a message of the on-board controller to all peers but its sender."""
        if self._signing is not None and not message.get_header().incompat_flags & wire.MAVLINK_IFLAG_SIGNED:
            return  # forwarding would sign a message that its sender did not sign
        for peer in self._peers:
            if source.peer is not peer:
                peer.post(message, self._outbox, messages.CONTROLLER)

    def broadcast(self, message: Message | EncodedMessage) -> None:
        """Send a message to all peers."""
        for peer in self._peers:
            self._send(message, peer)

    def send_text(self, text: str, severity: int) -> None:
        """Send a STATUSTEXT of at most 50 characters to all peers."""
        self.broadcast(wire.MAVLink_statustext_message(severity, text.encode()))

    def warn(self, text: str) -> None:
        """Send a warning of at most 50 characters to all peers, unless it was sent within the last 5 s."""
        if self.clock_us >= self._warned_us.get(text, -NEVER_US) + _WARN_AGAIN_US:
            self._warned_us[text] = self.clock_us
            self.send_text(text, wire.MAV_SEVERITY_WARNING)

    def apply_parameters(self) -> None:
        """Apply changed parameters."""
        self.autopilot.settings = self.parameters.settings()
        self.loop.set_gust_scale(self.parameters[GUST_SCALE_NAME])
        self.loop.set_stabilizer(self.parameters.stabilizer())
        self.loop.set_position_loop(self.parameters.position_loop())
        self.flight.pause(self._now_us, paused=bool(self.parameters[PAUSE_NAME]))

    @property
    def _state(self) -> tuple[Mode, bool, bool]:
        return self.autopilot.mode, self.autopilot.armed, self.autopilot.airborne

    # Lockstep in machine code.

    def exchange(self, socket: int, clock: Callable[[], int]) -> LockstepLine | None:
        """Fly samples on the set-points that come on the only socket, for as long as nothing else comes or is due.

        Return the line, with the datagram that ended it if one did; `None` if something else is due first.
        """
        if (begun := self.begin_exchange()) is None:
            return None
        fly_samples(socket, begun)
        self.end_exchange(begun, clock())
        return begun.line

    def begin_exchange(self) -> SampleTurns | None:
        """Return what `fly_samples` needs; `None` if anything but set-points and samples is due. Then end it.

        All earlier records are handed to the operating system first: a crash loses less than a second of them.
        """
        commander, loop = self._commander, self.loop
        if commander is None or (turns := self._count_turns(commander)) <= 0:
            return None
        torque = isinstance(self.flight.setpoint, TorqueCommand)
        if self._line is None or self._line[0] != (commander.address, torque):
            taken = (messages.torque_template if torque else messages.rate_template)(self.system).buffer()
            line = make_line(taken, messages.imu_template(self.system).buffer(), commander.address[1])
            self._line = (commander.address, torque), line
        self.flush()
        line, channel = self._line[1], commander.channel
        line.begin(channel.next_from((self.system, messages.CONTROLLER)), channel.packer.seq)
        kind, mode = TORQUE if torque else RATES, self.autopilot.mode.value
        most = min(turns, self._most_turns)
        return SampleTurns(most, kind, mode, loop.sample, loop.arrays(), line, self._records)

    def end_exchange(self, begun: SampleTurns, now_us: int) -> None:
        """Go on after the samples that were flown."""
        commander, flown = self._commander, begun.line.turns
        if flown and commander is not None:
            self._now_us = commander.last_seen_us = now_us
            commander.channel.count_next((self.system, messages.CONTROLLER), flown)
            commander.channel.count_sent(flown)
            command = read_command(begun.loop, begun.sample + flown - 1)
            self.flight.continue_after(self._records[:flown], command, now_us)

    def _count_turns(self, commander: Peer) -> int:
        """Return for how many samples nothing but set-points and samples is due."""
        flight = self.flight
        if not (self.exchanges and flight.is_awaiting_peer() and commander.is_samples_only):
            return 0
        if flight.answered or flight.paused or commander.channel.is_version_1:
            return 0
        streams_us = min((peer.next_us for peer in self._peers if peer is not commander), default=NEVER_US)
        ahead = (streams_us - flight.clock_us(0) - 1) // self._sample_us
        return min(ahead, self._last - self.loop.sample)

    # Messages.

    def _handle_frame(self, frame: Frame, address: Address, now_us: int) -> RejectReason | None:
        # The signature comes first: an unproven sender gets no place among the peers.
        if self._signing is not None and (cause := self._signing.check(frame)):
            if (text := _CLOCKS.get(cause)) and text not in self._warned_us:  # once: replays cause it too
                self.warn(text)
            return cause
        peer = self._register_peer(address, frame, now_us)
        return RejectReason.TOO_MANY_PEERS if peer is None else self._dispatch(frame, peer)

    def _register_peer(self, address: Address, frame: Frame, now_us: int) -> Peer | None:
        peer = self._peers.get_or_add(address)
        if peer is not None:
            if not peer.controller:
                peer.identify(frame, lockstep=self.flight.lockstep, clock_us=self.flight.clock_us(now_us))
            is_new, peer.last_seen_us = peer.last_seen_us is None, now_us
            peer.channel.count(frame)
            if is_new:  # it need not wait for the next one, up to a second
                self._send(self._streams[wire.MAVLINK_MSG_ID_HEARTBEAT].message(), peer)
            if frame.is_signed and self._signing is None and not peer.is_told_unsigned:
                peer.is_told_unsigned = True
                self._send(wire.MAVLink_statustext_message(wire.MAV_SEVERITY_WARNING, _UNSIGNED.encode()), peer)
        return peer

    def _dispatch(self, frame: Frame, peer: Peer) -> RejectReason | None:
        kind = frame.message_id
        if kind in _SETPOINTS:
            return self._handle_setpoint(frame, peer)
        handler = self._requests.get(kind)
        if handler is None:
            return refuse_unread(frame.message(), self)
        request = frame.message()
        system = getattr(request, "target_system", getattr(request, "target", 0))
        component = getattr(request, "target_component", 0)
        absent = kind in _COMMANDS and component in messages.ABSENT
        if not messages.is_addressed_to(self.system, system, messages.AUTOPILOT if absent else component):
            return RejectReason.OTHER_TARGET
        answering = component if absent else messages.AUTOPILOT
        return handler(request, Client(peer, self._outbox, self.clock_us, answering))

    def _handle_setpoint(self, frame: Frame, peer: Peer) -> RejectReason | None:
        rival = self._commander is not None and self._commander is not peer
        if (rival and self.autopilot.is_stream_alive) or peer is self._killed_peer:
            return RejectReason.NOT_IN_COMMAND
        command = messages.parse_command(frame, self.system)
        if isinstance(command, RejectReason):
            if text := _REFUSED_SETPOINTS.get(command):
                self.warn(text)
            return command
        cause = self._offer(command, len(frame.raw))
        if cause is None:
            self._commander = peer
        repeated = (cause is not None or not self.flight.running) and self._answers_repetition(command, peer)
        peer.answers_due -= repeated
        return None if repeated else cause

    def _offer(self, command: Command, size: int) -> RejectReason | None:
        if self.scripted_link is not None and self.flight.running:
            return self.scripted_link.offer(command, size, self.stamp_us)
        return self.flight.offer(command)

    def _answers_repetition(self, command: Command, peer: Peer) -> bool:
        """Return whether a set-point may answer a repetition of sample 0 from before t = 0, in lockstep."""
        return self.flight.lockstep and peer.answers_due > 0 and messages.stamp_difference(command, 0) == 0

    # Flight.

    def _fly_due_samples(self, now_us: int) -> None:
        """Fly the samples that are due, and send those that their peers wait for."""
        link = self.scripted_link
        for _ in range(_MAX_BATCH):
            action = self._pacer.next_action(now_us)
            if action is _WAIT:
                break
            if action is _ADVANCE:
                self._advance(now_us)
            if link is not None:
                self._step_script(link, action, now_us)
            elif not self.flight.lockstep:
                self._send_streams(self.flight.clock_us(now_us))  # each of several overdue samples
            elif self._commander is not None and self.flight.is_awaiting_peer():
                self._send_sample(self.loop.observe(), self._commander)
        if link is not None and not self.flight.lockstep:
            for sample in link.take_deliveries(self.stamp_us):
                self._deliver(sample)

    def _advance(self, now_us: int) -> None:
        """Fly the current sample, announce the autopilot's events, and note the end of the flight."""
        self.flight.advance(now_us)
        for event in self.autopilot.take_events():
            self._stream_lost = self._stream_lost or event.is_fail_safe
            self.send_text(event.value, wire.MAV_SEVERITY_CRITICAL if event.is_critical else wire.MAV_SEVERITY_INFO)
        if self.flight.ended_us is not None:
            flown = VehicleOutcome.LEFT_OFFBOARD if self.flight.left_offboard else VehicleOutcome.DONE
            self.outcome = VehicleOutcome.STREAM_LOST if self._stream_lost else flown
            self.finished = True

    def _step_script(self, link: ScriptedLink, action: NextAction, now_us: int) -> None:
        """Continue over the scripted link after an action."""
        if action is not _ADVANCE:
            # The controller gets the mode with each sample, however long the script kept it silent.
            if self._state != self._announced_state:
                self._send_heartbeat(now_us)
            assert link.sample is not None  # sent, or taken from the link, before it is sent again
            self._deliver(link.sample)
            return
        if self.flight.running:
            self._begin_sample(link, now_us)
        if not self.flight.lockstep:
            self._send_streams(self.flight.clock_us(now_us))

    def _begin_sample(self, link: ScriptedLink, now_us: int) -> None:
        """Begin a sample over the scripted link, and apply its events."""
        events = link.begin_sample(now_us)
        if events is not None:
            self.flush()  # a reader of the journal must see that the event's time has come
        for event in events or ():
            if isinstance(event, ControllerKill):
                self._killed_peer, self._commander = self._commander, None
            elif isinstance(event, ModeChange):
                result = self.autopilot.set_mode(Mode[event.mode.upper()])
                if result is not TransitionResult.ACCEPTED:
                    self.flight.counters[TimingFault.REFUSED] += 1
                    self.send_text(result.value, wire.MAV_SEVERITY_WARNING)

    # Streams and samples.

    def _deliver(self, sample: ImuSample) -> None:
        """Send a sample to the commanding peer, or to controllers that may replace a killed one."""
        joining = self.scripted_link is not None and self.scripted_link.joining
        for peer in self._peers:
            invited = joining and peer.controller and peer is not self._killed_peer
            if invited or peer is self._commander:
                self._send_sample(sample, peer)

    def _has_sample_stream(self, peer: Peer) -> bool:
        """Return whether a peer gets every sample of the flight as it is taken, or as it comes through the link."""
        if peer is self._commander:
            return self.flight.lockstep or self.scripted_link is not None
        return self.scripted_link is not None and self.flight.lockstep and peer.controller

    def _send_streams(self, clock_us: int) -> None:
        for peer in self._peers:
            for message_id in peer.take_due(clock_us):
                if message_id == _IMU and self.flight.running and self._has_sample_stream(peer):
                    continue
                if (message := self._streams[message_id].message()) is not None:
                    self._send(message, peer)
                    peer.answers_due += message_id == _IMU and self.flight.started_us is None

    def _send_heartbeat(self, now_us: int) -> None:
        """Send HEARTBEAT to all peers, with more messages after a change of state, and remove silent peers."""
        self._heartbeat_at_us = now_us + HEARTBEAT_US
        if self._commander in self._peers.remove_silent(now_us):
            self._commander = None
        changed = self._announced_state not in (None, self._state)
        self._announced_state = self._state
        for message_id in _STATE_MESSAGES if changed else _STATE_MESSAGES[:1]:
            self.broadcast(self._streams[message_id].message())
        self._created_us = now_us if self._created_us is None else self._created_us
        waiting = self.flight.lockstep and self.flight.started_us is None
        if waiting and now_us > self._created_us + START_TIMEOUT_US:
            self.outcome = VehicleOutcome.NO_CONTROLLER
            self.finished = True

    def _send_sample(self, sample: ImuSample, peer: Peer) -> None:
        self._outbox.append((peer.pack_sample(sample), peer.address))

    def _send(self, message: Message | EncodedMessage | ImuSample, peer: Peer) -> None:
        peer.post(message, self._outbox)
