"""The controller as a sans-I/O MAVLink peer: finds the vehicle, reads its limits, and answers each sample.

    SEEKING --heartbeat--> READING --time stands--> ARMING --accepted--> ENTERING --accepted--> FLYING
                              |                                             ^                   ^    |
                              +--time runs: flown by a pilot-- in the air --+      OFFBOARD set |    | another mode
                              +--on the ground, landing or taking off--------------> STANDING_BY <---+

A vehicle whose time stands at 0 waits for this controller, which arms it, and flies until it is disarmed. One whose
time runs has a pilot: the controller asks for OFFBOARD once, if it finds the vehicle flying, and never arms it. Another
mode takes the vehicle away; the controller asks for nothing, and flies again when OFFBOARD is set. While it is not in
command the law is kept at its initial state, so that it begins afresh.

PX4 obeys set-points in OFFBOARD alone, and lets nobody into that mode before they flow: they flow while the controller
stands by. To any other autopilot it then sends none. ArduPilot obeys them in GUIDED, unasked: it is sent none at all.

A request is repeated on wall time until it is answered, and given up after a stated number of times. The samples are
asked for at the law's rate, and their stamps say whether they come so: until then no set-point is sent. Of samples that
waited together each one is a step of the law, in order; only the newest are answered, as an autopilot has no use for
the others' commands, and a link may have no room.
"""

import math
from collections import Counter, deque
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
"""[us] wall time from heartbeat to heartbeat."""
RETRY_US = 200_000
"""[us] wall time after which a request is repeated."""
RETRIES = 50
"""Times that a request is repeated before the controller gives up."""
VEHICLE_TIMEOUT_US = 5_000_000
"""[us] wall time without a word after which the vehicle is taken for lost."""


class Phase(Enum):
    """How far the controller has come."""

    SEEKING = "no autopilot answers"
    """Waits for the vehicle's heartbeat; the value says what failed if it ends here."""
    READING = "the autopilot does not tell its parameters"
    """Reads torque limits, hover thrust and sample rate, and waits for samples at the law's rate."""
    ARMING = "the autopilot does not arm"
    """Asks to arm."""
    ENTERING = "the autopilot does not enter OFFBOARD"
    """Asks for OFFBOARD."""
    FLYING = "the flight was left"
    """The vehicle follows the law."""
    STANDING_BY = "the vehicle was taken out of OFFBOARD"
    """Another flies; to PX4 set-points go on, so that OFFBOARD can be set at any time."""


# Looked up once, as a look-up of a member takes .1 us and some are asked for each sample.
_FLYING, _READING, _STANDING_BY = Phase.FLYING, Phase.READING, Phase.STANDING_BY
_STREAMING = (_FLYING, _STANDING_BY)
_TAKEOVER_MODES = (
    frozenset(  # what a pilot flies without an end in view; a take-off, a landing or a way home is not broken off
        mode.value for mode in (Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.HOLD, Mode.STABILIZED)
    )
)
_ANSWERED = 16  # samples that waited together; what jitter brings is answered in full
_INTERVALS = 10  # between samples; their median says at what rate these come
_RATE_TOLERANCE = 0.1  # [-] of the law's sample time: a clock's error is far less, another rate's far more
_FAMILIES = {wire.MAV_AUTOPILOT_PX4: "PX4", wire.MAV_AUTOPILOT_GENERIC: "a generic autopilot"}
_ARDUPILOT = "ArduPilot is not supported yet: it obeys set-points in GUIDED without being asked, so none is sent"
_TELLING = {
    Phase.ARMING: "arms the vehicle",
    Phase.ENTERING: "asks for OFFBOARD",
    Phase.FLYING: "law '{law}' flies",
    Phase.STANDING_BY: "law '{law}' stands by, and flies when OFFBOARD is set",
}


class ControllerOutcome(Enum):
    """How the controller's part ended."""

    DONE = "done"
    """The vehicle has landed."""
    NOT_STARTED = "not_started"
    """The flight could not begin; the phase says where."""
    WRONG_RATE = "wrong_rate"
    """The vehicle samples, or sends its samples, at another rate than the law's."""
    NOT_SUPPORTED = "not_supported"
    """Another autopilot than is understood here."""
    AUTOPILOT_LOST = "autopilot_lost"
    """The vehicle fell silent."""
    MODE_LOST = "mode_lost"
    """The vehicle was landed out of OFFBOARD."""
    INTERRUPTED = "interrupted"
    """Ctrl-C or a termination signal."""


class ControllerEndpoint:
    """One law for one vehicle; give it datagrams and the time, send what it returns.

    `tell` is told, for people, what it has found and what it does.
    """

    def __init__(
        self,
        law: Law,
        vehicle: Address,
        signing: Signing | None = None,
        references: References = (),
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.phase = Phase.SEEKING
        self.outcome: ControllerOutcome | None = None
        self.message = ""
        self.late = 0
        self._tell = tell
        self.traffic = Channel(1, CONTROLLER, signing)
        self._signing = signing
        self._law, self._vehicle, self._references = law, vehicle, references
        self._packer = self.traffic.packer
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
        self._heard_us = 0
        self._handlers: dict[int, Callable[[Message], None]] = {
            wire.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            wire.MAVLINK_MSG_ID_PARAM_VALUE: self._on_parameter,
            wire.MAVLINK_MSG_ID_COMMAND_ACK: self._on_acknowledgement,
            wire.MAVLINK_MSG_ID_STATUSTEXT: self._on_text,
        }

    @property
    def finished(self) -> bool:
        """Whether there is nothing more to do."""
        return self.outcome is not None

    @property
    def missed(self) -> int:
        """Samples that were taken while the law flew, and never came."""
        return self._controller.missed if self._controller else 0

    @property
    def counters(self) -> Counter[RejectReason]:
        """What had no effect, by cause."""
        return self.traffic.dropped

    def interrupt(self) -> None:
        """End here: Ctrl-C or a termination signal."""
        self._end(ControllerOutcome.INTERRUPTED, "interrupted")

    def receive(self, datagram: bytes, peer: Address, now_us: int) -> None:
        """Take a datagram; never raises, what can't be used is counted by its cause."""
        if self._fast_path_ready and self._turn(datagram, peer, now_us):
            return
        self._fast_path_ready = False
        if self._signing is not None:
            self._signing.tick(now_us)
        for item in parse(datagram):
            cause = item if isinstance(item, RejectReason) else self._dispatch(item, peer, now_us)
            if cause is not None:
                self.drop(cause, peer)

    def drop(self, cause: RejectReason, peer: Address) -> None:
        """Count something that has no effect, whoever sent it."""
        self.traffic.dropped[cause] += 1

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Do what is due and return the datagrams to send."""
        if self._signing is not None:
            self._signing.tick(now_us)
        if self._answers and self._controller is not None:
            for answer in self._answers:
                self._outbox.append((self._packed(self._controller, *answer), self._vehicle))
            self._answers.clear()
        if now_us >= self._heartbeat_at_us:
            self._heartbeat_at_us = now_us + HEARTBEAT_US
            self._send(
                wire.MAVLink_heartbeat_message(
                    wire.MAV_TYPE_ONBOARD_CONTROLLER, wire.MAV_AUTOPILOT_INVALID, 0, 0, wire.MAV_STATE_ACTIVE, 3
                )
            )
        if self.phase in _STREAMING:
            if now_us > self._heard_us + VEHICLE_TIMEOUT_US:
                self._end(ControllerOutcome.AUTOPILOT_LOST, "the autopilot has fallen silent")
        elif now_us >= self._retry_at_us:
            self._retry(now_us)
        outbox, self._outbox = self._outbox, []
        return outbox

    def deadline_us(self) -> int:
        """Return the wall time at which `poll` has something to do, at the latest."""
        other_us = self._heard_us + VEHICLE_TIMEOUT_US + 1 if self.phase in _STREAMING else self._retry_at_us
        return min(self._heartbeat_at_us, other_us)

    def _dispatch(self, frame: Frame, peer: Address, now_us: int) -> RejectReason | None:
        if peer != self._vehicle or frame.component != AUTOPILOT:
            return RejectReason.OTHER_TARGET
        if self._signing is not None and (cause := self._signing.check(frame)):
            return cause
        self.traffic.count(frame)
        self._heard_us = now_us
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
        answer = controller.answer(sample, afresh=self._law_reset)
        if isinstance(answer, RejectReason):
            return answer
        if not self._missing_streams:
            self.late += newer and bool(self._answers)
            self._answers.append((sample.time_us, controller.fractions))
        self._fast_path_ready = self.phase is _FLYING and self._signing is None
        return None

    def _read_on(self, time_us: int) -> None:
        """Join if all is known, and samples come as fast as the law steps; or end, if they are not to come so."""
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

    def _turn(self, datagram: bytes, peer: Address, now_us: int) -> bool:
        """Answer the sample that nearly always comes next, as `_on_sample` does; or refuse it, and nothing is done."""
        controller, traffic, system = self._controller, self.traffic, self._packer.srcSystem
        if peer != self._vehicle or controller is None:
            return False
        fields = traffic.read(self._samples, (system, AUTOPILOT), datagram)
        if fields is None:
            return False
        time_us, f_x, f_y, f_z, p, q, r = fields
        if time_us <= controller.last_sample_us or not math.isfinite(f_x + f_y + f_z + p + q + r):
            return False
        traffic.count_read((system, AUTOPILOT))
        self._heard_us = now_us
        controller.step(time_us, (p, q, r), (f_x, f_y, f_z))
        if self._answers:
            self.late += 1
        self._answers.append((time_us, controller.fractions))
        return True

    def _packed(self, controller: Controller, time_us: int, fractions: Vector) -> bytes:
        """Return the command that answers a sample as a datagram."""
        if self._signing is not None:
            command = controller.command(time_us, fractions)
            return self.traffic.pack(messages.command_message(command, self._packer.srcSystem))
        if controller.torque:
            return self.traffic.make(self._commands, time_us, *fractions, math.nan)
        return self.traffic.make(self._commands, messages.boot_ms(time_us), *fractions, controller.hover)

    @property
    def _interval_us(self) -> float:
        """[us] from sample to sample, by their stamps; NaN before it is known."""
        return median(self._intervals_us) if len(self._intervals_us) > 1 else math.nan

    def _lacking(self) -> tuple[ControllerOutcome, str]:
        """Return as what it ends if the vehicle does not say all that is to be known, and what is missing."""
        absent = [name for name, value in self._parameters.items() if value is None]
        if absent == list(TORQUE_LIMIT_NAMES):
            text = f"the autopilot has no {', '.join(absent)}: law '{self._law.name}' commands torques, which PX4 does "
            return (
                ControllerOutcome.NOT_STARTED,
                text + "not take; it needs a law of rates: --law hinf-rates --via rates",
            )
        if absent:
            return ControllerOutcome.NOT_STARTED, f"{self.phase.value}: {', '.join(absent)}"
        if math.isnan(self._interval_us):
            return ControllerOutcome.NOT_STARTED, "no samples: the autopilot sends no HIGHRES_IMU on this link"
        return ControllerOutcome.WRONG_RATE, self._wrong_rate("it is asked for that, and stays there")

    def _wrong_rate(self, why: str) -> str:
        arrives, needs = f"HIGHRES_IMU arrives at {1e6 / self._interval_us:.3g} Hz", f"needs {self._rate_hz:g} Hz"
        return f"{arrives}, law '{self._law.name}' {needs}: {why}"

    def _take_over(self, time_us: int) -> None:
        """Arm a vehicle that waits, take one that flies; stand by one on the ground, on its way up or down.

        One that is in OFFBOARD has lost its controller a moment ago: nothing is to be asked for.
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
        # Another mode than the one that was found is the pilot's will.
        overruled = self._piloted and self.phase is Phase.ENTERING and mode not in (self._mode, Mode.OFFBOARD.value)
        self._mode = mode
        if self.phase is Phase.SEEKING:
            self._find(message.autopilot, message.get_srcSystem())
        elif overruled:
            self._enter(_STANDING_BY)
        elif self.phase in _STREAMING:
            self._update_phase()

    def _find(self, autopilot: int, system: int) -> None:
        """Begin to read from an autopilot that is understood; end at another."""
        if autopilot not in _FAMILIES:
            other = f"{_name('MAV_AUTOPILOT', autopilot)} is not supported"
            self._end(
                ControllerOutcome.NOT_SUPPORTED, _ARDUPILOT if autopilot == wire.MAV_AUTOPILOT_ARDUPILOTMEGA else other
            )
            return
        self._px4 = autopilot == wire.MAV_AUTOPILOT_PX4
        self._packer.srcSystem = system  # an on-board controller shares the vehicle's system id
        reads = f"reads {', '.join(self._parameters)}, asks for HIGHRES_IMU at {self._rate_hz:g} Hz"
        self._tell(f"found {_FAMILIES[autopilot]}, system {system}: {reads}")
        self._enter(_READING)

    def _update_phase(self) -> None:
        """Fly while the vehicle is armed in OFFBOARD; a flight that waited for this controller ends with disarming."""
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
        answer = f"{_name('MAV_CMD', message.command)} is answered by {_name('MAV_RESULT', message.result)}"
        if message.command == wire.MAV_CMD_SET_MESSAGE_INTERVAL:
            self._rate_granted = self._rate_granted or accepted
            self._declined = answer if declined else None
            return
        asked = {
            Phase.ARMING: (wire.MAV_CMD_COMPONENT_ARM_DISARM, Phase.ENTERING),
            Phase.ENTERING: (wire.MAV_CMD_DO_SET_MODE, Phase.FLYING),
        }.get(self.phase)
        if asked is None or message.command != asked[0]:
            return
        if accepted:
            self._enter(asked[1])
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
        if phase in _TELLING:
            self._tell(_TELLING[phase].format(law=self._law.name))
        if phase in _STREAMING:
            doing = "flies" if phase is _FLYING else "stands by"
            text = f"law '{self._law.name}' {doing}".encode("ascii", "replace")
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
                    interval_us = round(1e6 * self._law.dt)
                    self._command(
                        wire.MAV_CMD_SET_MESSAGE_INTERVAL, float(wire.MAVLINK_MSG_ID_HIGHRES_IMU), interval_us
                    )
            case Phase.ARMING:
                self._command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
            case Phase.ENTERING:
                self._command(
                    wire.MAV_CMD_DO_SET_MODE, wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, Mode.OFFBOARD.value >> 16
                )

    def _command(self, command: int, first: float, second: float = 0.0) -> None:
        self._send(
            wire.MAVLink_command_long_message(
                self._packer.srcSystem, AUTOPILOT, command, 0, first, second, 0.0, 0.0, 0.0, 0.0, 0.0
            )
        )

    def _send(self, message: Message | EncodedMessage) -> None:
        self._outbox.append((self.traffic.pack(message), self._vehicle))

    def _end(self, outcome: ControllerOutcome, message: str) -> None:
        if self.outcome is None:
            self.outcome, self.message = outcome, message


def _name(enumeration: str, value: int) -> str:
    """Return what MAVLink calls a value."""
    entry = wire.enums[enumeration].get(value)
    return entry.name if entry else f"{enumeration} {value}"
