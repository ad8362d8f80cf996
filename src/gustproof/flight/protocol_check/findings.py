"""Judge what a controller was seen to do: findings by name, each with what the protocol asks."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import all as wire

from firmware_model.config.vehicle import Vehicle
from firmware_model.mavlink.frames import DAMAGE_REASONS, RejectReason
from firmware_model.mavlink.messages import AUTOPILOT, CONTROLLER, boot_ms
from firmware_model.session.outcome import VehicleOutcome
from gustproof.flight.protocol_check.witness import SLOW_SAMPLES, Answer, Witness
from gustproof.types import Array

KICK_RATE = 0.15
"""[rad/s] rate about each axis that the kick of a trial gives the vehicle."""
KICK_S = (0.2, 0.3)
"""[s] start and end of the kick."""
DURATION_S = 1.6
"""[s] of a trial."""
_MOST_DATAGRAMS = 4.0  # per sample
_FEW_ANSWERS = 20  # below which answers are not judged as late
_BEYOND_SHARE = 0.05  # of the answers beyond the limits, above which their unit is wrong
_STOPPED = 0.6  # [-] of the kick's rate that may be left at the end; the slowest shipped law has .4
_HARDEST = 1.5  # [-] rms of the torque that takes the kick's rate away within one actuator lag; shipped laws have .3
_LARGEST = 1e6  # [-] or [rad/s] of a command that counts
_LAST_S = 0.4  # [s] at the end of a trial, in which the rate counts

ASKED = {
    "not-connected": "send a HEARTBEAT to the address in GUSTPROOF_ADDRESS: the vehicle speaks to those who speak",
    "no-heartbeat": "send HEARTBEAT each second, of type MAV_TYPE_ONBOARD_CONTROLLER",
    "wrong-system-id": "send as system 1 and to system 1: a controller on board shares the vehicle's system",
    "wrong-component-id": "send as component 191, MAV_COMP_ID_ONBOARD_COMPUTER, and to component 1, the autopilot",
    "damaged-message": "send whole MAVLink frames with the checksum of the common message set, one or more a datagram",
    "unknown-message": "send messages of the common set that an autopilot takes",
    "refused-command": "send commands that the vehicle can obey in its state",
    "never-arms": "send MAV_CMD_COMPONENT_ARM_DISARM with 1 until it is accepted",
    "never-offboard": "send MAV_CMD_DO_SET_MODE with 1 and 6, PX4's OFFBOARD, until it is accepted",
    "not-begun": "answer the sample with stamp 0, arm and set OFFBOARD: then the flight begins",
    "left-offboard": "stay in OFFBOARD to the end of the flight",
    "silent": "answer each HIGHRES_IMU by a set-point, the one with stamp 0 too: OFFBOARD needs set-points first",
    "hung": "answer each HIGHRES_IMU to the end of the flight",
    "died": "run until HEARTBEAT tells that the vehicle is disarmed",
    "late": "answer within a sample time in real time",
    "not-judged": "answer within a sample time in real time: check again when the machine has less to do",
    "flooding": "send one set-point a sample, and a HEARTBEAT each second",
    "wrong-stamp": "copy time_usec of the sample into the set-point, in whole milliseconds into time_boot_ms",
    "not-finite": "send finite torques or rates, and unit quaternions; NaN is for the throttle alone",
    "no-thrust": "send controls in group 0, or rates with a thrust",
    "ignores-repeats": "answer a sample that is sent again: its answer was lost",
    "unequal-answers": "give a sample that is sent again the same answer, and step the law once",
    "out-of-range": "send torques as fractions from -1 to 1 of GP_TRQ_MAX_R, _P and _Y, thrust from 0 to 1",
    "wrong-units": "send torques as fractions of GP_TRQ_MAX_R, _P and _Y, or rates in rad/s; gyros are in rad/s",
    "wrong-sign": "push against the rotation: axes are forward, right, down on both ways",
}
"""Requirement of the protocol behind each finding, by its name."""
_REJECTED = {
    "wrong-stamp": (RejectReason.EARLY, RejectReason.STALE),
    "not-finite": (RejectReason.NOT_FINITE, RejectReason.BAD_QUATERNION),
    "no-thrust": (RejectReason.NO_SETPOINT,),
    "damaged-message": tuple(cause for cause in DAMAGE_REASONS if cause is not RejectReason.UNKNOWN_MESSAGE),
    "unknown-message": (RejectReason.UNKNOWN_MESSAGE, RejectReason.UNUSED_MESSAGE, RejectReason.REFUSED),
}
_COUNTED = (*_REJECTED["wrong-stamp"], *_REJECTED["not-finite"], *_REJECTED["no-thrust"])


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Something that a controller does wrong."""

    name: str
    """Name, a key of `ASKED`."""
    seen: str
    """Observation, in words with numbers."""
    trial: str
    """Name of the `Trial` in which it was seen."""

    @property
    def asked(self) -> str:
        """Requirement of the protocol."""
        return ASKED[self.name]

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as JSON values, with what the protocol asks."""
        return {"name": self.name, "seen": self.seen, "spell": self.trial, "asked": self.asked}


class Trial(NamedTuple):
    """A flight of a check, as it was seen."""

    name: str
    """`lockstep` or `real time`."""
    witness: Witness
    """Everything that it noted."""
    ending: str
    """End of the controller's process, in words."""
    vehicle: Vehicle
    """Vehicle that was flown."""


_Seen = tuple[str, str]
"""Name of a finding and observation."""


def judge(trial: Trial) -> list[Finding]:
    """Return the findings of a trial, in the order in which they are to be mended."""
    seen = trial.witness.seen
    if seen.heard_us is None:
        name = "died" if trial.witness.died else "not-connected"
        found = [(name, trial.ending if trial.witness.died else "no datagram came")]
    else:
        parts = _PARTS if seen.messages else (_rejections,)
        found = [each for part in parts for each in part(trial)]
        found += [] if found else _begun(trial)
    return [Finding(name=name, seen=seen, trial=trial.name) for name, seen in found]


def _identity(trial: Trial) -> Iterator[_Seen]:
    """Yield a missing heartbeat and wrong ids."""
    seen = trial.witness.seen
    if not seen.messages["HEARTBEAT"]:
        yield "no-heartbeat", f"none among {seen.messages.total()} messages"
    system = trial.witness.vehicle.system
    for (sender, component), count in seen.senders.items():
        if sender != system:
            yield "wrong-system-id", f"{count} messages are from system {sender}"
        elif component != CONTROLLER:
            yield "wrong-component-id", f"{count} messages are from component {component}"
    for (target, component), count in seen.targets.items():
        if target not in (0, system):
            yield "wrong-system-id", f"{count} messages are for system {target}"
        elif component not in (0, AUTOPILOT):
            yield "wrong-component-id", f"{count} messages are for component {component}"


def _rejections(trial: Trial) -> Iterator[_Seen]:
    """Yield what the vehicle rejected, by its own counters."""
    vehicle = trial.witness.vehicle
    counters = vehicle.counters
    for name, causes in _REJECTED.items():
        found = [cause for cause in causes if counters[cause]]
        if name == "wrong-stamp" and vehicle.outcome is VehicleOutcome.LEFT_OFFBOARD:
            continue  # outside OFFBOARD no sample waits for its answer
        if found:
            count = sum(counters[cause] for cause in found)
            example = trial.witness.seen.examples.get(found[0], "")
            yield name, f"{count} rejected as {found[0].value}{f', the first: {example}' if example else ''}"


def _requests(trial: Trial) -> Iterator[_Seen]:
    """Yield commands that never came, or were refused for good."""
    seen = trial.witness.seen
    if seen.began_us is None and not trial.witness.died:
        if wire.MAV_CMD_COMPONENT_ARM_DISARM not in seen.requests:
            yield "never-arms", "no command to arm came"
        if wire.MAV_CMD_DO_SET_MODE not in seen.requests:
            yield "never-offboard", "no command to set the mode came"
    passing = (wire.MAV_RESULT_ACCEPTED, wire.MAV_RESULT_TEMPORARILY_REJECTED)
    for command, results in seen.results.items():
        refused = [result for result in results if result not in passing]
        if refused:
            result = wire.enums["MAV_RESULT"][refused[0]].name
            yield "refused-command", f"{_command_name(command)} was answered by {result}, {len(refused)} times"


def _endings(trial: Trial) -> Iterator[_Seen]:
    """Yield a controller that died, fell silent or left OFFBOARD."""
    witness, seen = trial.witness, trial.witness.seen
    rejected = any(witness.vehicle.counters[cause] for cause in _COUNTED)
    flown = f"at sample {witness.vehicle.loop.sample}"
    if witness.died:
        yield "died", f"{trial.ending}, {flown if seen.began_us else 'before the flight began'}"
    elif not seen.answers:
        yield "silent", "no set-point came"
    elif witness.vehicle.outcome is VehicleOutcome.STREAM_LOST and not rejected:
        yield "ignores-repeats" if witness.ignored_repeat else "hung", f"no answer to sample {witness.stalled_at}"
    elif witness.vehicle.outcome is VehicleOutcome.LEFT_OFFBOARD:
        yield "left-offboard", "it set another mode"


def _stream(trial: Trial) -> Iterator[_Seen]:
    """Yield set-points that come late, too often, or unequal for one sample."""
    witness, seen = trial.witness, trial.witness.seen
    rate = seen.datagrams / max(len(seen.samples), 1)
    if rate > _MOST_DATAGRAMS and seen.datagrams > _FEW_ANSWERS:
        yield "flooding", f"{rate:.0f} datagrams a sample"
    if not witness.vehicle.flight.lockstep and witness.answers_slowly(_FEW_ANSWERS):
        limit_ms = 1e-3 * SLOW_SAMPLES * witness.sample_us
        late = f"half of the answers took {1e-3 * witness.median_age_us:.1f} ms or more, over {limit_ms:g} ms"
        if witness.is_machine_busy:
            yield "not-judged", f"{late}, but the vehicle was late too, on this busy machine"
        else:
            yield "late", late
    for first, second in seen.unequal[:1]:
        yield "unequal-answers", f"sample {first.sample}: {_numbers(first)}, then {_numbers(second)}"


def _response(trial: Trial) -> Iterator[_Seen]:
    """Yield a finding if the commands have a wrong unit or sign, by how the vehicle turns after the scripted kick."""
    witness, seen = trial.witness, trial.witness.seen
    if witness.vehicle.outcome is not VehicleOutcome.DONE or witness.vehicle.counters[RejectReason.NOT_FINITE]:
        return
    if not witness.vehicle.flight.lockstep and (witness.is_machine_busy or witness.answers_slowly(_FEW_ANSWERS)):
        return  # what comes late stops no kick, however right; in lockstep units and signs showed
    beyond = [answer for answer in seen.answers if _is_beyond(answer, trial.vehicle)]
    share = len(beyond) / len(seen.answers)
    motion = _Motion(trial)
    if beyond and share <= _BEYOND_SHARE:
        yield "out-of-range", f"{len(beyond)} of {len(seen.answers)} set-points, the first: {_numbers(beyond[0])}"
    if motion.pushes_along:
        yield "wrong-sign", f"{motion.describe()}; the commands pushed along the rotation"
    elif share > _BEYOND_SHARE:
        yield "wrong-units", f"{100.0 * share:.0f} % of the set-points are beyond the limits, as {_numbers(beyond[0])}"
    elif not motion.is_stopped or motion.is_too_hard:
        yield "wrong-units", motion.describe()


def _begun(trial: Trial) -> list[_Seen]:
    """Return the finding of a flight that did not begin, if nothing else tells why."""
    if trial.witness.seen.began_us is not None:
        return []
    refused = [_command_name(command) for command in trial.witness.seen.results]
    return [("not-begun", f"commands that came: {', '.join(refused) or 'none'}")]


_PARTS = (_identity, _rejections, _requests, _endings, _stream, _response)


class _Motion:
    """Rates after the kick, and the commands that answer them."""

    def __init__(self, trial: Trial) -> None:
        commands = {answer.stamp_ms: answer for answer in trial.witness.seen.answers}
        rows = [
            (1e-6 * sample.time_us, *sample.gyro_B, *commands[stamp].values[:3])
            for sample in trial.witness.seen.samples
            if (stamp := boot_ms(sample.time_us)) in commands and sample.time_us >= 1e6 * KICK_S[1]
        ]
        table = np.array(rows).reshape(-1, 7)
        rates, command = table[:, 1:4], np.clip(np.nan_to_num(table[:, 4:]), -_LARGEST, _LARGEST)
        last = rates[table[:, 0] >= DURATION_S - _LAST_S]
        self._left = _rms(last) / KICK_RATE
        is_torque = all(answer.is_torque for answer in commands.values())
        self._hardness, against = 0.0, np.cumsum(rates, axis=0)
        if is_torque:
            torque = _rms(np.clip(command, -1.0, 1.0) * np.array(trial.vehicle.torque_limit))
            needed = np.array(trial.vehicle.inertia_B) * KICK_RATE / trial.vehicle.actuator_lag
            self._hardness, against = float(np.max(torque / needed)), rates
        self._along = float(np.sum(command * against))

    @property
    def is_stopped(self) -> bool:
        """True if little of the kick's rate is left."""
        return bool(np.all(self._left <= _STOPPED))

    @property
    def pushes_along(self) -> bool:
        """True if the commands drove the rotation."""
        return not self.is_stopped and self._along > 0.0

    @property
    def is_too_hard(self) -> bool:
        """True if the torques are far larger than those that stop the rotation at once."""
        return self._hardness > _HARDEST

    def describe(self) -> str:
        """Return the response in words."""
        left = ", ".join(f"{100.0 * share:.0f} %" for share in self._left)
        text = f"of a rotation of {KICK_RATE} rad/s about each axis {left} were left after {DURATION_S - KICK_S[1]:g} s"
        hard = f"; the torques were {self._hardness:.0f} times those that stop it within the actuators' lag"
        return text + (hard if self.is_too_hard else "")


def _rms(values: Array) -> Array:
    """Return the root mean square of each column; 0 of none."""
    mean: Array = np.sqrt(np.mean(values**2, axis=0)) if len(values) else np.zeros(values.shape[1])
    return mean


def _is_beyond(answer: Answer, vehicle: Vehicle) -> bool:
    """Return whether a set-point exceeds what the message or the vehicle's own rate loop takes."""
    *axes, thrust = answer.values
    limit = 1.0 if answer.is_torque else vehicle.stabilizer.rate_limit
    return any(abs(value) > limit for value in axes) or not (math.isnan(thrust) or 0.0 <= thrust <= 1.0)


def _numbers(answer: Answer) -> str:
    return ", ".join(f"{value:.4g}" for value in answer.values)


def _command_name(command: int) -> str:
    entry = wire.enums["MAV_CMD"].get(command)
    return entry.name if entry else f"MAV_CMD {command}"
