"""The controller as a sans-I/O MAVLink peer: find the vehicle, read its limits, answer each sample.

    SEEKING --heartbeat--> READING --time stands--> ARMING --accepted--> ENTERING --accepted--> FLYING
                              |                                             ^                   ^    |
                              +--time runs: flown by a pilot-- in the air --+      OFFBOARD set |    | another mode
                              +--on the ground, landing or taking off--------------> STANDING_BY <---+

The mode that takes set-points is OFFBOARD, or GUIDED of ArduPilot. A vehicle whose time stands at 0 waits for this
controller, which arms it and flies it until it is disarmed. If the time runs, a pilot is flying: the controller
requests the mode once if the vehicle is in the air, and never arms it. Any other mode takes the vehicle away. The
controller then requests nothing, and flies again when the mode is set. While it is not in command the law is held at
its start. That is level, or roll and pitch of ATTITUDE for a law that carries an attitude estimate.

PX4 obeys set-points in OFFBOARD alone, and enters that mode only while they flow, so the controller streams while
standing by. It then sends none to any other autopilot: ArduPilot obeys set-points in GUIDED without a request. That is
also the mode of its take-off, so ArduPilot is flown only once it reports to be in the air.

A request is repeated on wall time until it is answered, and given up after a stated number of times. Samples are
requested at the law's rate; no set-point is sent before their stamps show that they come often enough. Of samples that
waited together each one is a step of the law, in order. Only the newest are answered: the autopilot has no use for
older commands, and the link may have no room.

The thrust beside rates is the controller's own: a height loop on LOCAL_POSITION_NED, or the published hover thrust. A
vehicle whose time stands at 0 always gets the hover thrust.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from enum import Enum

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import LandedState
from firmware_model.autopilot.parameters import RATE_NAME, TORQUE_LIMIT_NAMES
from firmware_model.mavlink import messages
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import Address, EncodedMessage, Frame, Message, RejectReason, parse
from firmware_model.mavlink.messages import AUTOPILOT, CONTROLLER, command_long_message
from firmware_model.mavlink.services.geodesy import earth_rate
from firmware_model.mavlink.signing import Signing
from firmware_model.mavlink.wire import LockstepLine, make_line
from firmware_model.types import ImuSample, Vector
from gustproof.flight.controllers.stepper import StepError, StepFault
from gustproof.flight.endpoint.core import ControllerCore, Flown, References, sample_time
from gustproof.flight.endpoint.exchange import LawTurns, answer_samples
from gustproof.flight.endpoint.families import (
    FAMILIES,
    THRUST_OPTION,
    AutopilotFamily,
    describe_fail_safe,
    mode_parameters,
    takes_thrust,
)
from gustproof.flight.endpoint.height import HeightLoop
from gustproof.flight.endpoint.stream import SampleStream
from gustproof.law.form import Output

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
    """Read torque limits, hover thrust and sample rate; wait for samples that come often enough."""
    ARMING = "the autopilot does not arm"  # request arming
    ENTERING = "the autopilot does not enter {mode}"  # request the mode that takes set-points
    FLYING = "the flight was left"  # the vehicle follows the law
    STANDING_BY = "the vehicle left {mode}"
    """Another flies; PX4 still gets set-points, so that OFFBOARD can be set at any time."""


# Looked up once: a member costs .1 us, and some are read each sample.
_FLYING, _READING, _STANDING_BY = Phase.FLYING, Phase.READING, Phase.STANDING_BY
_STREAMING = (_FLYING, _STANDING_BY)
_ANSWERED = 16  # newest samples that are answered of those that waited together: all that jitter brings
_ATTITUDE_AGE_US = 500_000  # of the newest ATTITUDE at the start of the law
_CLIMB_RATE_ZERO = 0.5  # thrust that ArduPilot reads as no climb, unless thrust is a thrust
_NAVIGATION = {  # messages requested from a vehicle whose time runs, with their intervals [us]
    wire.MAVLINK_MSG_ID_ATTITUDE: 20_000,
    wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20_000,
    wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 200_000,
}
_WAYS_OUT = {
    "LOCAL_POSITION_NED": "--height free needs no height",
    "ATTITUDE": "--attitude own starts level without it",
}
_PROGRESS = {
    Phase.ARMING: "arming the vehicle",
    Phase.ENTERING: "requesting {mode}",
    Phase.FLYING: "{law} in control",
    Phase.STANDING_BY: "{law} standing by: in control once {mode} is set",
}


class ControllerOutcome(Enum):
    """End of the controller's part of a flight."""

    DONE = "done"  # the vehicle has landed
    NOT_STARTED = "not_started"  # the flight could not begin; the phase shows the failed step
    WRONG_RATE = "wrong_rate"  # the vehicle takes or sends samples at another rate than the law's
    NOT_SUPPORTED = "not_supported"  # the autopilot is of an unsupported family
    AUTOPILOT_LOST = "autopilot_lost"  # the vehicle sends no more messages
    MODE_LOST = "mode_lost"  # the vehicle was landed out of OFFBOARD
    RAISED = StepFault.RAISED.value
    NOT_FINITE = StepFault.NOT_FINITE.value
    HUNG = StepFault.HUNG.value
    """Ends of a user's controller, see `gustproof.flight.controllers.stepper.StepFault`."""
    INTERRUPTED = "interrupted"  # Ctrl-C or a termination signal


class ControllerEndpoint:
    """One law or user's controller for one vehicle; pass it datagrams and the time, send the datagrams it returns.

    `report` is called with lines for people on its progress. Of a vehicle that a pilot flew, with `hold_height` the
    thrust beside rates holds the height, and with `correct_attitude` ATTITUDE corrects the law's estimate. `recorder`
    is called in flight with each sample and the command after it; once it returns true the flight ends and the vehicle
    is handed back.
    """

    def __init__(
        self,
        law: Flown,
        vehicle: Address,
        signing: Signing | None = None,
        references: References = (),
        report: Callable[[str], None] = lambda _: None,
        *,
        hold_height: bool = False,
        correct_attitude: bool = False,
        recorder: Callable[[ImuSample, Vector], bool] | None = None,
    ) -> None:
        self.phase = Phase.SEEKING
        self.outcome: ControllerOutcome | None = None
        self.message = ""
        self.late = 0
        self._report = report
        self.channel = Channel(1, CONTROLLER, signing)
        self._signing = signing
        self._recorder = recorder
        self.vehicle = vehicle
        self._law, self._dt, self._references = law, sample_time(law), references
        self.failure: StepError | None = None
        self._packer = self.channel.packer
        self._outbox: list[tuple[bytes, Address]] = []
        self._answers: deque[tuple[int, Vector]] = deque(maxlen=_ANSWERED)
        self._controller: ControllerCore | None = None
        self._line: LockstepLine | None = None
        self._exchanges = False
        self._piloted = self._time_runs = self._law_reset = self._missing_streams = False
        self._armed, self._mode = False, 0
        self._family: AutopilotFamily = FAMILIES[wire.MAV_AUTOPILOT_PX4]
        self._stream = SampleStream(law.name, self._dt, self._family.samples)
        self._parameters: dict[str, float | None] = {}
        self._fail_safe: dict[str, float] = {}
        self._hold_height = hold_height and law.output is Output.RATES
        self._height: HeightLoop | None = None
        self._correct_attitude = correct_attitude
        self._attitude: tuple[int, Vector] | None = None
        self._attitude_ms = 0
        self._landed = 0
        self._navigation = _navigation(law)
        self._absent = set(self._navigation)
        self._navigation_handlers: dict[int, Callable[[Message], None]] = {
            wire.MAVLINK_MSG_ID_ATTITUDE: self._on_attitude,
            wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._on_position,
            wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._on_landed_state,
        }
        self._heartbeat_at_us = self._retry_at_us = 0
        self._retries = 0
        self._last_received_us = 0
        self._handlers: dict[int, Callable[[Message], None]] = {
            wire.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            wire.MAVLINK_MSG_ID_PARAM_VALUE: self._on_parameter,
            wire.MAVLINK_MSG_ID_COMMAND_ACK: self._on_acknowledgement,
            wire.MAVLINK_MSG_ID_STATUSTEXT: self._on_text,
            wire.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: self._on_tilt,
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
        """End here: Ctrl-C or a termination signal. A vehicle that a pilot flew is handed back to stay in place."""
        if self.phase in (_FLYING, Phase.ENTERING) and self._time_runs and not self.finished:
            self._request_mode(self._family.hold_mode)
        self._end(ControllerOutcome.INTERRUPTED, "interrupted")

    def receive(self, datagram: bytes, peer: Address, now_us: int) -> None:
        """Process a datagram; never raises. Unusable input is counted; a user's controller that fails ends it."""
        try:
            self._receive(datagram, peer, now_us)
        except StepError as failure:
            self.failure = failure
            self._end(ControllerOutcome(failure.fault.value), str(failure))

    def _receive(self, datagram: bytes, peer: Address, now_us: int) -> None:
        self._exchanges = False
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
                self._outbox.append((self._pack_command(self._controller, *answer), self.vehicle))
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
        is_known = self.phase is Phase.SEEKING or frame.system == self._packer.srcSystem
        if peer != self.vehicle or frame.component != AUTOPILOT or not is_known:
            return RejectReason.OTHER_TARGET
        if self._signing is not None and (cause := self._signing.check(frame)):
            return cause
        self.channel.count(frame)
        self._last_received_us = now_us
        if frame.message_id == self._stream.message_id:
            return self._on_sample(frame, now_us)
        handler = self._handlers.get(frame.message_id)
        if handler is None:
            return RejectReason.UNUSED_MESSAGE
        handler(frame.message())
        return None

    def _on_sample(self, frame: Frame, now_us: int) -> RejectReason | None:
        sample = messages.parse_imu(frame)
        if isinstance(sample, RejectReason):
            return sample
        if self.phase is _READING:
            self._read_on(sample.time_us)
        controller = self._controller
        return None if controller is None or self.phase is _READING else self._answer(controller, sample, now_us)

    def _answer(self, controller: ControllerCore, sample: ImuSample, now_us: int) -> RejectReason | None:
        """Step the law with a sample, and queue its command."""
        newer = sample.time_us > controller.last_sample_us
        reset = self._law_reset or (self._time_runs and controller.last_sample_us < 0)
        answer = controller.answer(sample, reset=reset, attitude=self._start_attitude(now_us))
        if isinstance(answer, RejectReason):
            return answer
        if not self._missing_streams:
            self.late += newer and bool(self._answers)
            self._answers.append((sample.time_us, controller.fractions))
        if self._recorder is not None and self.phase is _FLYING:
            self._record(sample, controller.fractions)
        is_plain = self._signing is None and self._recorder is None
        self._exchanges = self.phase is _FLYING and is_plain and controller.exchanges
        return None

    def _record(self, sample: ImuSample, command: Vector) -> None:
        """Pass a sample to the recorder; end the flight and hand the vehicle back once it has enough."""
        if self._recorder is not None and self._recorder(sample, command):
            self._request_mode(self._family.hold_mode)
            self._end(ControllerOutcome.DONE, "")

    def _start_attitude(self, now_us: int) -> Vector | None:
        """Return the autopilot's newest attitude [rad], if it is new enough to start the law."""
        if self._attitude is None or now_us > self._attitude[0] + _ATTITUDE_AGE_US:
            return None
        return self._attitude[1]

    def _read_on(self, time_us: int) -> None:
        """Take over once all is known and samples come often enough; end if the vehicle declines to send more."""
        self._stream.observe(time_us)
        if self._stream.interval_us > 0.0 and not self._time_runs:
            self._time_runs = True
            self._handlers |= self._navigation_handlers
        if self._stream.is_refused:
            self._end(ControllerOutcome.WRONG_RATE, self._stream.describe_fault())
        elif self._controller is not None and self._stream.is_flyable and not self._lacks_navigation():
            self._take_over(self._controller, time_us)

    def _lacks_navigation(self) -> bool:
        """Return whether a message is still to come without which a vehicle whose time runs is not flown."""
        return self._time_runs and bool(self._missing_navigation())

    def _missing_navigation(self) -> list[int]:
        needed = set()
        if self._height is not None:
            needed.add(wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
        if self._family.mode_takes_off:
            needed.add(wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        if self._correct_attitude and self._law.is_scheduled:
            needed.add(wire.MAVLINK_MSG_ID_ATTITUDE)
        return [number for number in self._absent if number in needed]

    def exchange(self, socket: int, clock: Callable[[], int]) -> LockstepLine | None:
        """Answer the samples that come on a connected socket, for as long as nothing else comes.

        Return the line, with the datagram that ended it if one did; `None` if something else is due first.
        """
        if (begun := self.begin_exchange()) is None:
            return None
        answer_samples(socket, begun)
        self.end_exchange(begun, clock())
        return begun.line

    def begin_exchange(self) -> LawTurns | None:
        """Return what `answer_samples` needs; `None` if anything but samples is awaited. Then end it."""
        if not self._exchanges or self._controller is None or self._answers:
            return None
        if self._line is None:
            self._line = make_line(self._samples.buffer(), self._commands.buffer(), self.vehicle[1])
        self._line.begin(self.channel.next_from((self._packer.srcSystem, AUTOPILOT)), self._packer.seq)
        return self._controller.begin_turns(self._line)

    def end_exchange(self, begun: LawTurns, now_us: int) -> None:
        """Go on after the samples that were answered."""
        if (turns := begun.line.turns) and self._controller is not None:
            self._last_received_us = now_us
            self.channel.count_next((self._packer.srcSystem, AUTOPILOT), turns)
            self.channel.count_sent(turns)
            self._controller.end_turns(begun)

    def _pack_command(self, controller: ControllerCore, time_us: int, fractions: Vector) -> bytes:
        """Return the command for a sample as a datagram."""
        if controller.torque:
            return self.channel.make(self._commands, time_us, *fractions, math.nan)
        return self.channel.make(self._commands, messages.boot_ms(time_us), *fractions, controller.thrust)

    def _describe_lack(self) -> tuple[ControllerOutcome, str]:
        """Return outcome and message for a vehicle that does not provide everything needed."""
        absent = [name for name, value in self._parameters.items() if value is None]
        if absent == list(TORQUE_LIMIT_NAMES):
            text = f"the autopilot has no {', '.join(absent)}: law '{self._law.name}' commands torques, PX4 takes rates"
            return ControllerOutcome.NOT_STARTED, f"{text}: --law hinf-rates --via rates"
        if absent:
            return ControllerOutcome.NOT_STARTED, f"{self.phase.value}: {', '.join(absent)}"
        if fault := self._stream.describe_fault():
            has_samples = self._stream.interval_us > 0.0
            return ControllerOutcome.WRONG_RATE if has_samples else ControllerOutcome.NOT_STARTED, fault
        names = [wire.mavlink_map[number].msgname for number in self._missing_navigation()]
        hints = "".join(f"; {hint}" for name, hint in _WAYS_OUT.items() if name in names)
        return ControllerOutcome.NOT_STARTED, f"the autopilot does not send {', '.join(names)}{hints}"

    def _take_over(self, controller: ControllerCore, time_us: int) -> None:
        """Arm a vehicle that waits, take over one that flies; stand by on the ground, in take-off or landing.

        A vehicle already in the mode that takes set-points has just lost its controller: no request is needed.
        """
        self._piloted, controller.interpolating = time_us > 0, self._time_runs
        rate_hz, step_us = self._parameters.get(RATE_NAME), round(1e6 * self._dt)
        # Stamps are whole microseconds: 3333 from one to the next at 300 Hz.
        if not self._time_runs and rate_hz is not None and not abs(rate_hz * step_us - 1e6) <= 0.5 * rate_hz:
            text = f"law '{self._law.name}' steps every {self._dt} s, the vehicle samples at {rate_hz:g} Hz"
            self._end(ControllerOutcome.WRONG_RATE, f"{text}: set {RATE_NAME} to {round(1.0 / self._dt)}")
            return
        if self._time_runs:
            self._request_navigation(self._navigation)
            self._request_parameters(filter(None, (*self._family.fail_safe, self._family.estimator)))
            self._report_flight()
        if not self._piloted:
            self._enter(Phase.ARMING)
        elif self._is_given:
            self._enter(_FLYING)
        elif self._armed and self._mode in self._family.takeover_modes and self._is_airborne:
            self._enter(Phase.ENTERING)
        else:
            self._enter(_STANDING_BY)

    def _report_flight(self) -> None:
        """Report to people how samples, attitude, height and thrust are dealt with."""
        if text := self._stream.describe():
            self._report(text)
        if not self._law.is_scheduled:
            self._report(
                f"attitude: law '{self._law.name}' has no estimate that could start at ATTITUDE: "
                "it holds as level the attitude in which it takes over"
            )
        if self._law.output is not Output.RATES:
            return
        if self._height is not None:
            self._report("height: held by thrust, from LOCAL_POSITION_NED")
        elif takes_thrust(self._parameters):
            self._report("height: not held, thrust is the published hover thrust")
        else:
            self._report(
                f"height: {self._family.name} holds it; thrust is a climb rate until {THRUST_OPTION} has bit 3"
            )

    @property
    def _is_airborne(self) -> bool:
        """True if the vehicle reports to be in the air, or its family need not."""
        return self._landed == LandedState.IN_AIR.value or (self._landed == 0 and not self._family.mode_takes_off)

    @property
    def _is_given(self) -> bool:
        """True if the vehicle obeys set-points, and its pilot has left it to them."""
        obeys = self._armed and self._mode in self._family.modes
        return obeys and (self._is_airborne or not self._family.mode_takes_off)

    def _on_attitude(self, message: Message) -> None:
        angles = float(message.roll), float(message.pitch), float(message.yaw)
        if not math.isfinite(sum(angles)):
            return
        self._absent.discard(message.get_msgId())
        if (
            self._correct_attitude
            and self._controller is not None
            and self._attitude is not None
            and self.phase is _FLYING
        ):
            self._controller.correct(angles, 1e-3 * max(message.time_boot_ms - self._attitude_ms, 0))
        self._attitude, self._attitude_ms = (self._last_received_us, angles), message.time_boot_ms

    def _on_position(self, message: Message) -> None:
        """Set the thrust that holds the height; while another flies the height is his."""
        down, v_down = float(message.z), float(message.vz)
        if not math.isfinite(down + v_down):
            return
        self._absent.discard(message.get_msgId())
        if self._height is not None and self._controller is not None:
            if self.phase is not _FLYING:
                self._height.release()
            self._controller.thrust = self._height.thrust(message.time_boot_ms, down, v_down)

    def _on_landed_state(self, message: Message) -> None:
        self._absent.discard(message.get_msgId())
        self._landed = message.landed_state
        if self._family.mode_takes_off and self.phase in _STREAMING:
            self._update_phase()

    def _on_tilt(self, message: Message) -> None:
        """Track what the position loop asks for of a vehicle that waits for this controller.

        Where time runs, a pilot has left the attitude to the law, and ArduPilot tells what its own navigation wants.
        """
        is_asked = math.isfinite(message.nav_roll + message.nav_pitch) and not self._time_runs
        if is_asked and self._controller is not None:
            self._controller.tilt = math.radians(message.nav_roll), math.radians(message.nav_pitch)

    def _on_text(self, message: Message) -> None:
        self.message = message.text
        if message.severity <= wire.MAV_SEVERITY_WARNING:
            self._report(f"the autopilot reports: {message.text}")

    def _on_heartbeat(self, message: Message) -> None:
        self._armed, mode = bool(message.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED), message.custom_mode
        # A change of mode is the pilot's decision.
        overruled = self._piloted and self.phase is Phase.ENTERING and mode not in {self._mode, *self._family.modes}
        self._mode = mode
        if self.phase is Phase.SEEKING:
            self._find(message.autopilot, message.get_srcSystem())
        elif overruled:
            self._enter(_STANDING_BY)
        elif self.phase in _STREAMING:
            self._update_phase()

    def _find(self, autopilot: int, system: int) -> None:
        """Begin to read from a supported autopilot; end at another."""
        family = FAMILIES.get(autopilot)
        if family is None:
            self._end(ControllerOutcome.NOT_SUPPORTED, f"{_name('MAV_AUTOPILOT', autopilot)} is not supported")
            return
        torque = self._law.output is Output.TORQUE
        if torque and not family.takes_torques:
            text = f"{family.name} takes no torques, law '{self._law.name}' commands them: --law hinf-rates --via rates"
            self._end(ControllerOutcome.NOT_SUPPORTED, text)
            return
        self._family = family
        self._stream = SampleStream(self._law.name, self._dt, family.samples)
        self._parameters = dict.fromkeys((*(TORQUE_LIMIT_NAMES if torque else ()), *family.parameters))
        self._packer.srcSystem = system  # an on-board controller shares the vehicle's system id
        reads = f"reading {', '.join(self._parameters)}, requesting HIGHRES_IMU at {1.0 / self._dt:g} Hz"
        self._report(f"found {family.name}, system {system}: {reads}")
        self._enter(_READING)

    def _update_phase(self) -> None:
        """Fly while the vehicle is given; disarming ends a flight that this controller began."""
        if self._is_given:
            wanted = _FLYING
        elif self._armed or self._piloted:
            wanted = _STANDING_BY
        elif self.phase is _FLYING:
            self._end(ControllerOutcome.DONE, "")
            return
        else:
            self._end(ControllerOutcome.MODE_LOST, self.message or self._describe_phase())
            return
        if wanted is not self.phase:
            self._enter(wanted)

    def _on_parameter(self, message: Message) -> None:
        name, value = message.param_id, messages.parse_parameter(message, bytewise=self._family.bytewise)
        if not _is_usable(name, value):
            return
        if name in self._family.fail_safe and self._piloted:
            self._on_fail_safe(name, value)
            return
        if name == self._family.estimator and value:
            self._request_origin()
        if self.phase is not _READING or self._controller is not None or name not in self._parameters:
            return
        self._parameters[name] = value
        known = {each: number for each, number in self._parameters.items() if number is not None}
        if len(known) == len(self._parameters):
            self._make_controller(known)

    def _on_fail_safe(self, name: str, value: float) -> None:
        self._fail_safe[name] = value
        if len(self._fail_safe) == len(self._family.fail_safe):
            self._report(describe_fail_safe(self._family, self._fail_safe))
            self._fail_safe = {}

    def _request_origin(self) -> None:
        """Request where the vehicle flies: that gives the turn of the earth."""
        if (controller := self._controller) is None:
            return

        def on_origin(message: Message) -> None:
            controller.earth_rate_N = earth_rate(math.radians(1e-7 * message.latitude))

        self._handlers[wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN] = on_origin
        self._command(wire.MAV_CMD_REQUEST_MESSAGE, wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)

    def _make_controller(self, known: Mapping[str, float]) -> None:
        hover = known[self._family.parameters[0]]
        thrust = hover if takes_thrust(known) else _CLIMB_RATE_ZERO
        roll, pitch, yaw = (known.get(name, 1.0) for name in TORQUE_LIMIT_NAMES)
        self._controller = ControllerCore(self._law, (roll, pitch, yaw), thrust, self._references)
        if self._hold_height and takes_thrust(known):
            self._height = HeightLoop(hover)
        system = self._packer.srcSystem
        self._line, self._samples = None, messages.imu_template(system)
        self._commands = messages.torque_template(system) if self._controller.torque else messages.rate_template(system)

    def _on_acknowledgement(self, message: Message) -> None:
        accepted = message.result == wire.MAV_RESULT_ACCEPTED
        declined = not accepted and message.result != wire.MAV_RESULT_TEMPORARILY_REJECTED
        answer = f"the answer to {_name('MAV_CMD', message.command)} is {_name('MAV_RESULT', message.result)}"
        if message.command == wire.MAV_CMD_SET_MESSAGE_INTERVAL:
            self._stream.on_answer(accepted=accepted, declined=answer if declined else None)
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
            self._end(ControllerOutcome.NOT_STARTED, f"{self._describe_phase()}: {self.message or answer}")

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._retries = self._retry_at_us = 0
        self._law_reset = phase is _STANDING_BY or (self._piloted and phase is Phase.ENTERING)
        self._missing_streams = phase is _STANDING_BY and not self._family.streams_on_standby
        if phase in _PROGRESS:
            self._report(_PROGRESS[phase].format(law=self._law.name, mode=self._family.mode_name))
        if phase in _STREAMING:
            state = "in control" if phase is _FLYING else "standing by"
            text = f"{self._law.name} {state}".encode("ascii", "replace")
            self._send(wire.MAVLink_statustext_message(wire.MAV_SEVERITY_INFO, text[:50]))

    def _retry(self, now_us: int) -> None:
        self._retry_at_us = now_us + RETRY_US
        self._retries += 1
        if self._retries > RETRIES:
            if self.phase is _READING:
                self._end(*self._describe_lack())
            elif self._piloted:
                self._enter(_STANDING_BY)
            else:
                self._end(ControllerOutcome.NOT_STARTED, self._describe_phase())
            return
        match self.phase:
            case Phase.READING:
                self._request_missing()
            case Phase.ARMING:
                self._command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
            case Phase.ENTERING:
                self._request_mode(self._family.mode)

    def _request_missing(self) -> None:
        """Request parameters, samples and, once these are settled, navigation of a vehicle whose time runs."""
        self._request_parameters(name for name, value in self._parameters.items() if value is None)
        if (wanted := self._stream.request()) is not None:
            self._command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, *wanted)
        elif self._time_runs:
            self._request_navigation(self._absent)

    def _request_navigation(self, numbers: Iterable[int]) -> None:
        for number in numbers:
            self._command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, number, _NAVIGATION[number])

    def _request_mode(self, mode: int) -> None:
        self._command(wire.MAV_CMD_DO_SET_MODE, wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *mode_parameters(mode))

    def _request_parameters(self, names: Iterable[str]) -> None:
        for name in names:
            self._send(wire.MAVLink_param_request_read_message(self._packer.srcSystem, AUTOPILOT, name.encode(), -1))

    def _describe_phase(self) -> str:
        return self.phase.value.format(mode=self._family.mode_name)

    def _command(self, command: int, *parameters: float) -> None:
        self._send(command_long_message(command, self._packer.srcSystem, *parameters))

    def _send(self, message: Message | EncodedMessage) -> None:
        self._outbox.append((self.channel.pack(message), self.vehicle))

    def _end(self, outcome: ControllerOutcome, message: str) -> None:
        if self.outcome is None:
            self.outcome, self.message = outcome, message


def _navigation(law: Flown) -> Mapping[int, int]:
    """Return the messages that a law needs of a vehicle whose time runs, with their intervals [us]."""
    if law.output is Output.RATES:
        return _NAVIGATION
    attitude = wire.MAVLINK_MSG_ID_ATTITUDE
    return {attitude: _NAVIGATION[attitude]} if law.is_scheduled else {}


def _is_usable(name: str, value: float) -> bool:
    """Return whether the value of a parameter can be flown by; if not, it counts as not reported."""
    return math.isfinite(value) and (name not in TORQUE_LIMIT_NAMES or value > 0.0)


def _name(enumeration: str, value: int) -> str:
    """Return MAVLink's name of a value."""
    entry = wire.enums[enumeration].get(value)
    return entry.name if entry else f"{enumeration} {value}"
