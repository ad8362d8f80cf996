"""The controller as a sans-I/O MAVLink peer: finds the vehicle, reads its limits, and answers each sample.

    SEEKING --heartbeat--> READING --time stands--> ARMING --accepted--> ENTERING --accepted--> FLYING
                              |                                             ^                   ^    |
                              +--time runs: flown by a pilot-- in the air --+      OFFBOARD set |    | another mode
                              +--on the ground, landing or taking off--------------> STANDING_BY <---+

A vehicle whose time stands at 0 waits for this controller, which arms it, and flies until it is disarmed. One whose
time runs has a pilot: the controller asks for OFFBOARD once, if it finds the vehicle flying, and never arms it. Another
mode takes the vehicle away; the controller goes on streaming, asks for nothing, and flies again when OFFBOARD is set.
While it is not in command the law is kept at its initial state, so that it begins afresh.

A request is repeated on wall time until it is answered, and given up after a stated number of times. Samples are
answered as soon as the parameters are known, as the autopilot enters OFFBOARD only when set-points flow.
"""

import math
from collections import Counter
from collections.abc import Callable
from enum import Enum

from pymavlink.dialects.v20 import all as wire

from firmware_model import messages
from firmware_model.autopilot import Mode
from firmware_model.frames import Dropped, Frame, Message, Outgoing, Peer, parse
from firmware_model.messages import AUTOPILOT, CONTROLLER
from firmware_model.params import HOVER_NAME, RATE_NAME, TORQUE_LIMIT_NAMES
from firmware_model.signing import Signing
from firmware_model.traffic import Traffic
from gustproof.controller.core import Controller, References
from gustproof.law import Law, Output

HEARTBEAT_US = 1_000_000
"""[us] wall time from heartbeat to heartbeat."""
RETRY_US = 200_000
"""[us] wall time after which a request is repeated."""
RETRIES = 50
"""Times that a request is repeated before the controller gives up."""
SILENCE_US = 5_000_000
"""[us] wall time without a word after which the vehicle is taken for lost."""


class Phase(Enum):
    """How far the controller has come."""

    SEEKING = "no autopilot answers"
    """Waits for the vehicle's heartbeat; the value says what failed if it ends here."""
    READING = "the autopilot does not tell its parameters"
    """Reads torque limits, hover thrust and sample rate."""
    ARMING = "the autopilot does not arm"
    """Asks to arm."""
    ENTERING = "the autopilot does not enter OFFBOARD"
    """Asks for OFFBOARD."""
    FLYING = "the flight was left"
    """The vehicle follows the law."""
    STANDING_BY = "the vehicle was taken out of OFFBOARD"
    """Another flies; set-points go on, so that OFFBOARD can be set at any time."""


# Looked up once, as a look-up of a member takes .1 us and some are asked for each sample.
_FLYING, _READING, _STANDING_BY = Phase.FLYING, Phase.READING, Phase.STANDING_BY
_JOINED = (_FLYING, _STANDING_BY)
_TAKEN = frozenset(  # what a pilot flies without an end in view; a take-off, a landing or a way home is not broken off
    mode.value for mode in (Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.HOLD, Mode.STABILIZED)
)


class Outcome(Enum):
    """How the controller's part ended."""

    DONE = "done"
    """The vehicle has landed."""
    NOT_STARTED = "not_started"
    """The flight could not begin; the phase says where."""
    WRONG_RATE = "wrong_rate"
    """The vehicle samples at another rate than the law."""
    AUTOPILOT_LOST = "autopilot_lost"
    """The vehicle fell silent."""
    MODE_LOST = "mode_lost"
    """The vehicle was landed out of OFFBOARD."""
    INTERRUPTED = "interrupted"
    """Ctrl-C or a termination signal."""


class ControllerEndpoint:
    """One law for one vehicle; give it datagrams and the time, send what it returns."""

    def __init__(self, law: Law, vehicle: Peer, signing: Signing | None = None, references: References = ()) -> None:
        self.phase = Phase.SEEKING
        self.outcome: Outcome | None = None
        self.message = ""
        self.traffic = Traffic(1, CONTROLLER, signing)
        self._signing = signing
        self._law, self._vehicle, self._references = law, vehicle, references
        self._packer = self.traffic.packer
        self._outbox: list[tuple[bytes, Peer]] = []
        self._controller: Controller | None = None
        self._turning = False
        self._piloted = self._resting = False
        self._armed, self._mode = False, 0
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
    def counters(self) -> Counter[Dropped]:
        """What had no effect, by cause."""
        return self.traffic.dropped

    def interrupt(self) -> None:
        """End here: Ctrl-C or a termination signal."""
        self._end(Outcome.INTERRUPTED, "interrupted")

    def receive(self, datagram: bytes, peer: Peer, now_us: int) -> None:
        """Take a datagram; never raises, what can't be used is counted by its cause."""
        if self._turning and self._turn(datagram, peer, now_us):
            return
        self._turning = False
        if self._signing is not None:
            self._signing.tick(now_us)
        for item in parse(datagram):
            cause = item if isinstance(item, Dropped) else self._dispatch(item, peer, now_us)
            if cause is not None:
                self.drop(cause, peer)

    def drop(self, cause: Dropped, peer: Peer) -> None:
        """Count something that has no effect, whoever sent it."""
        self.traffic.dropped[cause] += 1

    def poll(self, now_us: int) -> list[tuple[bytes, Peer]]:
        """Do what is due and return the datagrams to send."""
        if self._signing is not None:
            self._signing.tick(now_us)
        if now_us >= self._heartbeat_at_us:
            self._heartbeat_at_us = now_us + HEARTBEAT_US
            self._send(
                wire.MAVLink_heartbeat_message(
                    wire.MAV_TYPE_ONBOARD_CONTROLLER, wire.MAV_AUTOPILOT_INVALID, 0, 0, wire.MAV_STATE_ACTIVE, 3
                )
            )
        if self.phase in _JOINED:
            if now_us > self._heard_us + SILENCE_US:
                self._end(Outcome.AUTOPILOT_LOST, "the autopilot has fallen silent")
        elif now_us >= self._retry_at_us:
            self._retry(now_us)
        outbox, self._outbox = self._outbox, []
        return outbox

    def deadline_us(self) -> int:
        """Return the wall time at which `poll` has something to do, at the latest."""
        other_us = self._heard_us + SILENCE_US + 1 if self.phase in _JOINED else self._retry_at_us
        return min(self._heartbeat_at_us, other_us)

    def _dispatch(self, frame: Frame, peer: Peer, now_us: int) -> Dropped | None:
        if peer != self._vehicle or frame.component != AUTOPILOT:
            return Dropped.OTHER_TARGET
        if self._signing is not None and (cause := self._signing.refusal(frame)):
            return cause
        self.traffic.count(frame)
        self._heard_us = now_us
        if frame.message_id == wire.MAVLINK_MSG_ID_HIGHRES_IMU:
            return self._on_sample(frame)
        handler = self._handlers.get(frame.message_id)
        if handler is None:
            return Dropped.UNUSED_MESSAGE
        handler(frame.message())
        return None

    def _on_sample(self, frame: Frame) -> Dropped | None:
        if self._controller is None:
            return None
        sample = messages.imu_sample(frame)
        answer = sample if isinstance(sample, Dropped) else self._controller.answer(sample, afresh=self._resting)
        if isinstance(answer, Dropped):
            return answer
        self._send(messages.command_message(answer, self._packer.srcSystem))
        if self.phase is _READING:
            self._join(answer.time_us)
        self._turning = self.phase is _FLYING and self._signing is None
        return None

    def _turn(self, datagram: bytes, peer: Peer, now_us: int) -> bool:
        """Answer the sample that nearly always comes next, as `_on_sample` does; or refuse it, and nothing is done."""
        controller, traffic, system = self._controller, self.traffic, self._packer.srcSystem
        if peer != self._vehicle or controller is None:
            return False
        fields = traffic.read(self._samples, (system, AUTOPILOT), datagram)
        if fields is None:
            return False
        time_us, f_x, f_y, f_z, p, q, r = fields
        if time_us <= controller.answered_us or not math.isfinite(f_x + f_y + f_z + p + q + r):
            return False
        traffic.count_next((system, AUTOPILOT))
        self._heard_us = now_us
        command = controller.step(time_us, (p, q, r), (f_x, f_y, f_z))
        if controller.torque:
            answer = traffic.make(self._commands, time_us, *command, math.nan)
        else:
            answer = traffic.make(self._commands, messages.boot_ms(time_us), *command, controller.hover)
        self._outbox.append((answer, peer))
        return True

    def _join(self, time_us: int) -> None:
        """Arm a vehicle that waits, take one that flies; stand by one on the ground, on its way up or down.

        One that is in OFFBOARD has lost its controller a moment ago: nothing is to be asked for.
        """
        self._piloted = time_us > 0
        if not self._piloted:
            self._enter(Phase.ARMING)
        elif self._armed and self._mode == Mode.OFFBOARD.value:
            self._enter(_FLYING)
        elif self._armed and self._mode in _TAKEN:
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
            # An on-board controller shares the vehicle's system id.
            self._packer.srcSystem = message.get_srcSystem()
            self._enter(Phase.READING)
        elif overruled:
            self._enter(_STANDING_BY)
        elif self.phase in _JOINED:
            self._follow()

    def _follow(self) -> None:
        """Fly while the vehicle is armed in OFFBOARD; a flight that waited for this controller ends with disarming."""
        if self._armed and self._mode == Mode.OFFBOARD.value:
            wanted = _FLYING
        elif self._armed or self._piloted:
            wanted = _STANDING_BY
        elif self.phase is _FLYING:
            self._end(Outcome.DONE, "")
            return
        else:
            self._end(Outcome.MODE_LOST, self.message or self.phase.value)
            return
        if wanted is not self.phase:
            self._enter(wanted)

    def _on_parameter(self, message: Message) -> None:
        name = message.param_id
        if self._controller is not None or name not in self._parameters:
            return
        self._parameters[name] = messages.parameter(message)
        known = [value for value in self._parameters.values() if value is not None]
        if len(known) < len(self._parameters):
            return
        rate = known.pop()
        if rate * self._law.dt != 1.0:
            text = f"law '{self._law.name}' steps every {self._law.dt} s, the vehicle samples at {rate:g} Hz"
            self._end(Outcome.WRONG_RATE, text)
            return
        hover = known.pop()
        roll, pitch, yaw = known or (1.0, 1.0, 1.0)
        self._controller = Controller(self._law, (roll, pitch, yaw), hover, self._references)
        system = self._packer.srcSystem
        self._samples = messages.samples(system)
        self._commands = messages.torques(system) if self._controller.torque else messages.rates(system)

    def _on_acknowledgement(self, message: Message) -> None:
        asked = {
            Phase.ARMING: (wire.MAV_CMD_COMPONENT_ARM_DISARM, Phase.ENTERING),
            Phase.ENTERING: (wire.MAV_CMD_DO_SET_MODE, Phase.FLYING),
        }.get(self.phase)
        if asked is None or message.command != asked[0]:
            return
        if message.result == wire.MAV_RESULT_ACCEPTED:
            self._enter(asked[1])
        elif message.result == wire.MAV_RESULT_TEMPORARILY_REJECTED:
            return
        elif self._piloted:
            self._enter(_STANDING_BY)
        else:
            self._end(Outcome.NOT_STARTED, f"{self.phase.value}: {self.message or 'refused'}")

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._retries = self._retry_at_us = 0
        self._resting = phase is _STANDING_BY or (self._piloted and phase is Phase.ENTERING)
        if phase in _JOINED:
            doing = "flies" if phase is _FLYING else "stands by"
            text = f"law '{self._law.name}' {doing}".encode("ascii", "replace")
            self._send(wire.MAVLink_statustext_message(wire.MAV_SEVERITY_INFO, text[:50]))

    def _retry(self, now_us: int) -> None:
        self._retry_at_us = now_us + RETRY_US
        self._retries += 1
        if self._retries > RETRIES:
            if self._piloted:
                self._enter(_STANDING_BY)
            else:
                self._end(Outcome.NOT_STARTED, self.phase.value)
            return
        system = self._packer.srcSystem
        match self.phase:
            case Phase.READING:
                for name in [name for name, value in self._parameters.items() if value is None]:
                    self._send(wire.MAVLink_param_request_read_message(system, AUTOPILOT, name.encode(), -1))
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

    def _send(self, message: Message | Outgoing) -> None:
        self._outbox.append((self.traffic.pack(message), self._vehicle))

    def _end(self, outcome: Outcome, message: str) -> None:
        if self.outcome is None:
            self.outcome, self.message = outcome, message
