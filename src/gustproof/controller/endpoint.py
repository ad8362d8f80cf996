"""The controller as a sans-I/O MAVLink peer: find the vehicle, read its limits, answer each sample.

    SEEKING --heartbeat--> READING --time stands--> ARMING --accepted--> ENTERING --accepted--> FLYING
                              |                                             ^                   ^    |
                              +--time runs: flown by a pilot-- in the air --+      OFFBOARD set |    | another mode
                              +--on the ground, landing or taking off--------------> STANDING_BY <---+

A vehicle whose time stands at 0 waits for this controller, which arms it and flies it until it is disarmed. If the
time runs, a pilot is flying: the controller requests OFFBOARD once if the vehicle is in the air, and never arms it. Any
other mode takes the vehicle away. The controller then requests nothing, and flies again when OFFBOARD is set. While it
is not in command the law stays at its initial state.

PX4 obeys set-points in OFFBOARD alone, and enters that mode only while they flow, so the controller streams while
standing by. It then sends none to any other autopilot. ArduPilot obeys set-points in GUIDED without a request, so it
gets none at all.

A request is repeated on wall time until it is answered, and given up after a stated number of times. Samples are
requested at the law's rate; no set-point is sent before their stamps show that rate. Of samples that waited together
each one is a step of the law, in order. Only the newest are answered: the autopilot has no use for older commands, and
the link may have no room.
"""

import math
from collections import deque
from collections.abc import Callable
from enum import Enum
from statistics import median

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode
from firmware_model.autopilot.parameters import HOVER_NAME, RATE_NAME, TORQUE_LIMIT_NAMES
from firmware_model.mavlink import messages
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import Address, EncodedMessage, Frame, Message, RejectReason, parse
from firmware_model.mavlink.messages import AUTOPILOT, CONTROLLER
from firmware_model.mavlink.signing import Signing
from firmware_model.types import Vector
from gustproof.controller.core import Controller, References
from gustproof.law.form import Law, Output

HEARTBEAT_US = 1_000_000
"""[us] wall time between heartbeats."""
RETRY_US = 200_000
"""[us] wall time after which a request is repeated."""
RETRIES = 50
"""Number of repeats before the controller gives up."""
VEHICLE_TIMEOUT_US = 5_000_000
"""[us] wall time without a message after which the vehicle counts as lost."""


class Phase(Enum):
    """Progress of the controller; each value states the failure of a flight that ends there."""

    SEEKING = "no autopilot answers"  # wait for the vehicle's heartbeat
    READING = "the autopilot does not report its parameters"
    """Read torque limits, hover thrust and sample rate; wait for samples at the law's rate."""
    ARMING = "the autopilot does not arm"  # request arming
    ENTERING = "the autopilot does not enter OFFBOARD"  # request OFFBOARD
    FLYING = "the flight was left"  # the vehicle follows the law
    STANDING_BY = "the vehicle left OFFBOARD"
    """Another flies; PX4 still gets set-points, so that OFFBOARD can be set at any time."""


# Looked up once: a member costs .1 us, and some are read each sample.
_FLYING, _READING, _STANDING_BY = Phase.FLYING, Phase.READING, Phase.STANDING_BY
_STREAMING = (_FLYING, _STANDING_BY)
# Modes of open-ended flight by a pilot: take-off, landing and return are not interrupted.
_PILOT_MODES = (Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.HOLD, Mode.STABILIZED)
_TAKEOVER_MODES = frozenset(mode.value for mode in _PILOT_MODES)
_ANSWERED = 16  # newest samples that are answered of those that waited together: all that jitter brings
_INTERVALS = 10  # between samples; their median gives the rate
_RATE_TOLERANCE = 0.1  # [-] of the law's sample time: a clock's error is far less, another rate's far more
_FAMILIES = {wire.MAV_AUTOPILOT_PX4: "PX4", wire.MAV_AUTOPILOT_GENERIC: "a generic autopilot"}
_ARDUPILOT = "ArduPilot is not supported yet: in GUIDED it obeys set-points without a request, so none is sent"
_PROGRESS = {
    Phase.ARMING: "arming the vehicle",
    Phase.ENTERING: "requesting OFFBOARD",
    Phase.FLYING: "{law} in control",
    Phase.STANDING_BY: "{law} standing by: in control once OFFBOARD is set",
}


class ControllerOutcome(Enum):
    """End of the controller's part of a flight."""

    DONE = "done"  # the vehicle has landed
    NOT_STARTED = "not_started"  # the flight could not begin; the phase shows the failed step
    WRONG_RATE = "wrong_rate"  # the vehicle takes or sends samples at another rate than the law's
    NOT_SUPPORTED = "not_supported"  # the autopilot is of an unsupported family
    AUTOPILOT_LOST = "autopilot_lost"  # the vehicle sends no more messages
    MODE_LOST = "mode_lost"  # the vehicle was landed out of OFFBOARD
    INTERRUPTED = "interrupted"  # Ctrl-C or a termination signal


class ControllerEndpoint:
    """One law for one vehicle; pass it datagrams and the time, send the datagrams it returns.

    `report` is called with lines for people on its progress.
    """

    def __init__(
        self,
        law: Law,
        vehicle: Address,
        signing: Signing | None = None,
        references: References = (),
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.phase = Phase.SEEKING
        self.outcome: ControllerOutcome | None = None
        self.message = ""
        self.late = 0
        self._report = report
        self.channel = Channel(1, CONTROLLER, signing)
        self._signing = signing
        self._law, self._vehicle, self._references = law, vehicle, references
        self._packer = self.channel.packer
        self._outbox: list[tuple[bytes, Address]] = []
        self._answers: deque[tuple[int, Vector]] = deque(maxlen=_ANSWERED)
        self._controller: Controller | None = None
        self._fast_path_ready = False
        self._piloted = self._law_reset = self._missing_streams = False
        self._armed, self._mode = False, 0
        self._px4 = False
        self._rate_hz = 1.0 / law.dt
        self._intervals_us: deque[int] = deque(maxlen=_INTERVALS)
        self._sampled_us: int | None = None
        self._rate_granted = False
        self._declined: str | None = None
        wanted = (*(TORQUE_LIMIT_NAMES if law.output is Output.TORQUE else ()), HOVER_NAME, RATE_NAME)
        self._parameters: dict[str, float | None] = dict.fromkeys(wanted)
        self._heartbeat_at_us = self._retry_at_us = 0
        self._retries = 0
        self._last_received_us = 0
        self._handlers: dict[int, Callable[[Message], None]] = {
            wire.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            wire.MAVLINK_MSG_ID_PARAM_VALUE: self._on_parameter,
            wire.MAVLINK_MSG_ID_COMMAND_ACK: self._on_acknowledgement,
            wire.MAVLINK_MSG_ID_STATUSTEXT: self._on_text,
        }

    @property
    def finished(self) -> bool:
        """True if the controller's part has ended."""
        return self.outcome is not None

    @property
    def missed(self) -> int:
        """Number of samples that the vehicle took while the law flew, and that never came."""
        return self._controller.missed if self._controller else 0

    def interrupt(self) -> None:
        """End here: Ctrl-C or a termination signal."""
        self._end(ControllerOutcome.INTERRUPTED, "interrupted")

    def receive(self, datagram: bytes, peer: Address, now_us: int) -> None:
        """Process a datagram; never raises: unusable input is counted by its cause."""
        if self._fast_path_ready and self._answer_fast(datagram, peer, now_us):
            return
        self._fast_path_ready = False
        if self._signing is not None:
            self._signing.tick(now_us)
        for item in parse(datagram):
            cause = item if isinstance(item, RejectReason) else self._dispatch(item, peer, now_us)
            if cause is not None:
                self.count_reject(cause, peer)

    def count_reject(self, cause: RejectReason, peer: Address) -> None:
        """Count a message without effect, whoever sent it."""
        self.channel.dropped[cause] += 1

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Do the work that is due and return the datagrams to send."""
        if self._signing is not None:
            self._signing.tick(now_us)
        if self._answers and self._controller is not None:
            for answer in self._answers:
                self._outbox.append((self._packed(self._controller, *answer), self._vehicle))
            self._answers.clear()
        if now_us >= self._heartbeat_at_us:
            self._heartbeat_at_us = now_us + HEARTBEAT_US
            kind, family = wire.MAV_TYPE_ONBOARD_CONTROLLER, wire.MAV_AUTOPILOT_INVALID
            self._send(wire.MAVLink_heartbeat_message(kind, family, 0, 0, wire.MAV_STATE_ACTIVE, 3))
        if self.phase in _STREAMING:
            if now_us > self._last_received_us + VEHICLE_TIMEOUT_US:
                self._end(ControllerOutcome.AUTOPILOT_LOST, "the autopilot sends no more messages")
        elif now_us >= self._retry_at_us:
            self._retry(now_us)
        outbox, self._outbox = self._outbox, []
        return outbox

    def deadline_us(self) -> int:
        """Return the latest wall time of the next call of `poll`."""
        other_us = self._last_received_us + VEHICLE_TIMEOUT_US + 1 if self.phase in _STREAMING else self._retry_at_us
        return min(self._heartbeat_at_us, other_us)

    def _dispatch(self, frame: Frame, peer: Address, now_us: int) -> RejectReason | None:
        if peer != self._vehicle or frame.component != AUTOPILOT:
            return RejectReason.OTHER_TARGET
        if self._signing is not None and (cause := self._signing.check(frame)):
            return cause
        self.channel.count(frame)
        self._last_received_us = now_us
        if frame.message_id == wire.MAVLINK_MSG_ID_HIGHRES_IMU:
            return self._on_sample(frame)
        handler = self._handlers.get(frame.message_id)
        if handler is None:
            return RejectReason.UNUSED_MESSAGE
        handler(frame.message())
        return None

    def _on_sample(self, frame: Frame) -> RejectReason | None:
        sample = messages.parse_imu(frame)
        if isinstance(sample, RejectReason):
            return sample
        if self.phase is _READING:
            self._read_on(sample.time_us)
        controller = self._controller
        if controller is None or self.phase is _READING:
            return None
        newer = sample.time_us > controller.last_sample_us
        answer = controller.answer(sample, reset=self._law_reset)
        if isinstance(answer, RejectReason):
            return answer
        if not self._missing_streams:
            self.late += newer and bool(self._answers)
            self._answers.append((sample.time_us, controller.fractions))
        self._fast_path_ready = self.phase is _FLYING and self._signing is None
        return None

    def _read_on(self, time_us: int) -> None:
        """Take over once all is known and samples come at the law's rate; end if the vehicle declines that rate."""
        if self._sampled_us is not None:
            self._intervals_us.append(time_us - self._sampled_us)
        self._sampled_us = time_us
        interval_us = self._interval_us
        stands = time_us == 0 or interval_us == 0
        if stands or abs(interval_us * 1e-6 * self._rate_hz - 1.0) < _RATE_TOLERANCE:
            if self._controller is not None:
                self._take_over(time_us)
        elif self._declined and len(self._intervals_us) == _INTERVALS:
            self._end(ControllerOutcome.WRONG_RATE, self._wrong_rate(self._declined))

    def _answer_fast(self, datagram: bytes, peer: Address, now_us: int) -> bool:
        """Fast path for one valid, newer sample; return False, without side effects, for any other datagram."""
        controller, channel, system = self._controller, self.channel, self._packer.srcSystem
        if peer != self._vehicle or controller is None:
            return False
        fields = channel.read(self._samples, (system, AUTOPILOT), datagram)
        if fields is None:
            return False
        time_us, f_x, f_y, f_z, p, q, r = fields
        if time_us <= controller.last_sample_us or not math.isfinite(f_x + f_y + f_z + p + q + r):
            return False
        channel.count_read((system, AUTOPILOT))
        self._last_received_us = now_us
        controller.step(time_us, (p, q, r), (f_x, f_y, f_z))
        if self._answers:
            self.late += 1
        self._answers.append((time_us, controller.fractions))
        return True

    def _packed(self, controller: Controller, time_us: int, fractions: Vector) -> bytes:
        """Return the command for a sample as a datagram."""
        if self._signing is not None:
            command = controller.command(time_us, fractions)
            return self.channel.pack(messages.command_message(command, self._packer.srcSystem))
        if controller.torque:
            return self.channel.make(self._commands, time_us, *fractions, math.nan)
        return self.channel.make(self._commands, messages.boot_ms(time_us), *fractions, controller.hover)

    @property
    def _interval_us(self) -> float:
        """[us] median time between samples, by their stamps; NaN before it is known."""
        return median(self._intervals_us) if len(self._intervals_us) > 1 else math.nan

    def _lacking(self) -> tuple[ControllerOutcome, str]:
        """Return outcome and message for a vehicle that does not provide everything needed."""
        absent = [name for name, value in self._parameters.items() if value is None]
        if absent == list(TORQUE_LIMIT_NAMES):
            text = f"the autopilot has no {', '.join(absent)}: law '{self._law.name}' commands torques, PX4 takes rates"
            return ControllerOutcome.NOT_STARTED, f"{text}: --law hinf-rates --via rates"
        if absent:
            return ControllerOutcome.NOT_STARTED, f"{self.phase.value}: {', '.join(absent)}"
        if math.isnan(self._interval_us):
            return ControllerOutcome.NOT_STARTED, "no samples: the autopilot sends no HIGHRES_IMU on this link"
        return ControllerOutcome.WRONG_RATE, self._wrong_rate("the autopilot does not change it on request")

    def _wrong_rate(self, why: str) -> str:
        arrives, needs = f"HIGHRES_IMU arrives at {1e6 / self._interval_us:.3g} Hz", f"needs {self._rate_hz:g} Hz"
        return f"{arrives}, law '{self._law.name}' {needs}: {why}"

    def _take_over(self, time_us: int) -> None:
        """Arm a vehicle that waits, take over one that flies; stand by on the ground, in take-off or landing.

        A vehicle in OFFBOARD has just lost its controller: no request is needed.
        """
        self._piloted = time_us > 0
        if not self._piloted:
            self._enter(Phase.ARMING)
        elif self._armed and self._mode == Mode.OFFBOARD.value:
            self._enter(_FLYING)
        elif self._armed and self._mode in _TAKEOVER_MODES:
            self._enter(Phase.ENTERING)
        else:
            self._enter(_STANDING_BY)

    def _on_text(self, message: Message) -> None:
        self.message = message.text

    def _on_heartbeat(self, message: Message) -> None:
        self._armed, mode = bool(message.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED), message.custom_mode
        # A change of mode is the pilot's decision.
        overruled = self._piloted and self.phase is Phase.ENTERING and mode not in (self._mode, Mode.OFFBOARD.value)
        self._mode = mode
        if self.phase is Phase.SEEKING:
            self._find(message.autopilot, message.get_srcSystem())
        elif overruled:
            self._enter(_STANDING_BY)
        elif self.phase in _STREAMING:
            self._update_phase()

    def _find(self, autopilot: int, system: int) -> None:
        """Begin to read from a supported autopilot; end at another."""
        if autopilot not in _FAMILIES:
            other = f"{_name('MAV_AUTOPILOT', autopilot)} is not supported"
            why = _ARDUPILOT if autopilot == wire.MAV_AUTOPILOT_ARDUPILOTMEGA else other
            self._end(ControllerOutcome.NOT_SUPPORTED, why)
            return
        self._px4 = autopilot == wire.MAV_AUTOPILOT_PX4
        self._packer.srcSystem = system  # an on-board controller shares the vehicle's system id
        reads = f"reading {', '.join(self._parameters)}, requesting HIGHRES_IMU at {self._rate_hz:g} Hz"
        self._report(f"found {_FAMILIES[autopilot]}, system {system}: {reads}")
        self._enter(_READING)

    def _update_phase(self) -> None:
        """Fly while the vehicle is armed in OFFBOARD; disarming ends a flight that this controller began."""
        if self._armed and self._mode == Mode.OFFBOARD.value:
            wanted = _FLYING
        elif self._armed or self._piloted:
            wanted = _STANDING_BY
        elif self.phase is _FLYING:
            self._end(ControllerOutcome.DONE, "")
            return
        else:
            self._end(ControllerOutcome.MODE_LOST, self.message or self.phase.value)
            return
        if wanted is not self.phase:
            self._enter(wanted)

    def _on_parameter(self, message: Message) -> None:
        name = message.param_id
        if self.phase is not _READING or self._controller is not None or name not in self._parameters:
            return
        self._parameters[name] = messages.parse_parameter(message)
        known = [value for value in self._parameters.values() if value is not None]
        if len(known) < len(self._parameters):
            return
        rate = known.pop()
        if rate * self._law.dt != 1.0:
            text = f"law '{self._law.name}' steps every {self._law.dt} s, the vehicle samples at {rate:g} Hz"
            self._end(ControllerOutcome.WRONG_RATE, f"{text}: set {RATE_NAME} to {self._rate_hz:g}")
            return
        hover = known.pop()
        roll, pitch, yaw = known or (1.0, 1.0, 1.0)
        self._controller = Controller(self._law, (roll, pitch, yaw), hover, self._references)
        system = self._packer.srcSystem
        self._samples = messages.imu_template(system)
        self._commands = messages.torque_template(system) if self._controller.torque else messages.rate_template(system)

    def _on_acknowledgement(self, message: Message) -> None:
        accepted = message.result == wire.MAV_RESULT_ACCEPTED
        declined = not accepted and message.result != wire.MAV_RESULT_TEMPORARILY_REJECTED
        answer = f"the answer to {_name('MAV_CMD', message.command)} is {_name('MAV_RESULT', message.result)}"
        if message.command == wire.MAV_CMD_SET_MESSAGE_INTERVAL:
            self._rate_granted = self._rate_granted or accepted
            self._declined = answer if declined else None
            return
        request = {
            Phase.ARMING: (wire.MAV_CMD_COMPONENT_ARM_DISARM, Phase.ENTERING),
            Phase.ENTERING: (wire.MAV_CMD_DO_SET_MODE, Phase.FLYING),
        }.get(self.phase)
        if request is None or message.command != request[0]:
            return
        if accepted:
            self._enter(request[1])
        elif not declined:
            return
        elif self._piloted:
            self._enter(_STANDING_BY)
        else:
            self._end(ControllerOutcome.NOT_STARTED, f"{self.phase.value}: {self.message or answer}")

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._retries = self._retry_at_us = 0
        self._law_reset = phase is _STANDING_BY or (self._piloted and phase is Phase.ENTERING)
        self._missing_streams = phase is _STANDING_BY and not self._px4
        if phase in _PROGRESS:
            self._report(_PROGRESS[phase].format(law=self._law.name))
        if phase in _STREAMING:
            state = "in control" if phase is _FLYING else "standing by"
            text = f"{self._law.name} {state}".encode("ascii", "replace")
            self._send(wire.MAVLink_statustext_message(wire.MAV_SEVERITY_INFO, text[:50]))

    def _retry(self, now_us: int) -> None:
        self._retry_at_us = now_us + RETRY_US
        self._retries += 1
        if self._retries > RETRIES:
            if self._piloted:
                self._enter(_STANDING_BY)
            elif self.phase is _READING:
                self._end(*self._lacking())
            else:
                self._end(ControllerOutcome.NOT_STARTED, self.phase.value)
            return
        system = self._packer.srcSystem
        match self.phase:
            case Phase.READING:
                for name in [name for name, value in self._parameters.items() if value is None]:
                    self._send(wire.MAVLink_param_request_read_message(system, AUTOPILOT, name.encode(), -1))
                if not (self._rate_granted or self._declined):
                    stream, interval_us = float(wire.MAVLINK_MSG_ID_HIGHRES_IMU), round(1e6 * self._law.dt)
                    self._command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, stream, interval_us)
            case Phase.ARMING:
                self._command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
            case Phase.ENTERING:
                custom, main_mode = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, Mode.OFFBOARD.value >> 16
                self._command(wire.MAV_CMD_DO_SET_MODE, custom, main_mode)

    def _command(self, command: int, first: float, second: float = 0.0) -> None:
        numbers = first, second, 0.0, 0.0, 0.0, 0.0, 0.0
        self._send(wire.MAVLink_command_long_message(self._packer.srcSystem, AUTOPILOT, command, 0, *numbers))

    def _send(self, message: Message | EncodedMessage) -> None:
        self._outbox.append((self.channel.pack(message), self._vehicle))

    def _end(self, outcome: ControllerOutcome, message: str) -> None:
        if self.outcome is None:
            self.outcome, self.message = outcome, message


def _name(enumeration: str, value: int) -> str:
    """Return MAVLink's name of a value."""
    entry = wire.enums[enumeration].get(value)
    return entry.name if entry else f"{enumeration} {value}"
