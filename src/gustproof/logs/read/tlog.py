"""Read a MAVLink telemetry log, .tlog: before each frame stands its arrival, eight bytes [us], big-endian.

Only frames of the first autopilot are used, and torque commands to it. Stamps are those of its own clock where the
message has them, else arrivals set back by the usual delay of the gyro's messages. The gyro is the message of the
highest rate; ATTITUDE gives rates that the autopilot has filtered.

References
----------
MAVLink, message definitions; QGroundControl and MAVProxy, layout of the file.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.parameters import TORQUE_LIMIT_NAMES
from firmware_model.mavlink.frames import Frame, parse
from gustproof.logs.read.assemble import Draft, LoggedParameters, Rows, euler_angles, fastest, longest_piece
from gustproof.logs.read.flight_log import CommandUnit
from gustproof.logs.read.pulses import describe_pulses, motor_commands
from gustproof.logs.read.sample_store import SampleStore, read_blocks
from gustproof.logs.read.stamps import usual_step
from gustproof.types import Array

_V1, _V2 = wire.PROTOCOL_MARKER_V1, wire.PROTOCOL_MARKER_V2
_HEARTBEAT, _PARAMETER = wire.MAVLINK_MSG_ID_HEARTBEAT, wire.MAVLINK_MSG_ID_PARAM_VALUE
_SERVOS, _LANDED = wire.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
_LEAST = 20  # [bytes] of an arrival and the least frame
_INTEGERS = {wire.MAV_PARAM_TYPE_INT32: "<i4", wire.MAV_PARAM_TYPE_UINT32: "<u4"}
_IN_AIR = "in_air"
_STAMPS = {"time_usec": 1.0, "time_boot_ms": 1000.0}  # fields of the autopilot's clock, with their microseconds
_SAME_CLOCK_US = 50_000.0  # clocks that differ less by the arrivals are one
_MOST_DAMAGED = 300_000  # [bytes]; a search for frames takes 1 us a byte
_SYSTEMS = {wire.MAV_AUTOPILOT_PX4: "px4", wire.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot"}


class _Source(NamedTuple):
    """Place of a signal in a log."""

    message: int
    fields: tuple[str, ...]
    scale: float = 1.0
    """SI unit of a step of its numbers."""
    convert: Callable[[Array], Array] = lambda numbers: numbers


_MILLI_G = 9.80665e-3
_GYRO, _FORCE = ("xgyro", "ygyro", "zgyro"), ("xacc", "yacc", "zacc")
_RATES = ("rollspeed", "pitchspeed", "yawspeed")
_HIGHRES, _RAW, _SCALED = wire.MAVLINK_MSG_ID_HIGHRES_IMU, wire.MAVLINK_MSG_ID_RAW_IMU, wire.MAVLINK_MSG_ID_SCALED_IMU
_ATTITUDE, _QUATERNION = wire.MAVLINK_MSG_ID_ATTITUDE, wire.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
_SIGNALS = {
    "gyro": (
        _Source(_HIGHRES, _GYRO),
        _Source(_RAW, _GYRO, 1e-3),
        _Source(_SCALED, _GYRO, 1e-3),
        _Source(_ATTITUDE, _RATES),
        _Source(_QUATERNION, _RATES),
    ),
    "accelerometer": (
        _Source(_HIGHRES, _FORCE),
        _Source(_RAW, _FORCE, _MILLI_G),
        _Source(_SCALED, _FORCE, _MILLI_G),
    ),
    "attitude": (
        _Source(_ATTITUDE, ("roll", "pitch", "yaw")),
        _Source(_QUATERNION, ("q1", "q2", "q3", "q4"), convert=euler_angles),
    ),
    "reference": (_Source(wire.MAVLINK_MSG_ID_ATTITUDE_TARGET, ("q",), convert=euler_angles),),
}
_TORQUES = _Source(
    wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET, ("controls",), convert=lambda numbers: numbers[:, :3]
)
_SERVO_OUTPUTS = _Source(_SERVOS, tuple(f"servo{number}_raw" for number in range(1, 17)))
_LANDED_STATE = _Source(_LANDED, ("landed_state",), convert=lambda state: (state > 1.0).astype(np.float64))
_BASE_MODE = _Source(
    _HEARTBEAT, ("base_mode",), convert=lambda mode: (mode >= wire.MAV_MODE_FLAG_SAFETY_ARMED).astype(np.float64)
)
_WANTED = {source.message for sources in _SIGNALS.values() for source in sources}
_WANTED |= {_HEARTBEAT, _PARAMETER, _SERVOS, _LANDED, _TORQUES.message}


class _Parser:
    """State of reading: frames of the first autopilot, torque commands, and damage."""

    def __init__(self) -> None:
        self.store = SampleStore()
        self.sender: tuple[int, int] | None = None
        self.kind = wire.MAV_AUTOPILOT_INVALID
        self.damaged = 0
        self._lost = False

    def consume(self, buffer: bytes, place: int) -> int:
        """Take the whole frames of a buffer, see `read_blocks`."""
        at, end = 0, len(buffer)
        while at + _LEAST <= end:
            marker, after = buffer[at + 8], at + 16 + buffer[at + 9]
            message = buffer[at + 13]
            if marker == _V2:
                after += 17 if buffer[at + 10] & wire.MAVLINK_IFLAG_SIGNED else 4
                message = buffer[at + 15] | buffer[at + 16] << 8 | buffer[at + 17] << 16
            is_frame = marker in (_V1, _V2)
            if is_frame and after > end:
                break
            if is_frame and (self._lost or message in _WANTED):
                is_frame = self._take(buffer[at:after], place + at)
            self._lost = not is_frame
            self.damaged += self._lost
            at = at + 1 if self._lost else after
            if self.damaged > _MOST_DAMAGED:
                raise ValueError(f"more than {_MOST_DAMAGED:,} bytes of it are no frames")
        return at

    def _take(self, record: bytes, place: int) -> bool:
        """Keep a frame with its arrival before it, if it is wanted; return false if it is damaged."""
        (frame,) = parse(record[8:])
        if not isinstance(frame, Frame):
            return False
        message, sender = frame.message_id, (frame.system, frame.component)
        if message == _HEARTBEAT and self.sender is None and frame.payload[5] != wire.MAV_AUTOPILOT_INVALID:
            self.sender, self.kind = sender, frame.payload[5]
        if message in _WANTED and (sender == self.sender or (message == _TORQUES.message and self.sender is not None)):
            self.store.add(message, place, record[7::-1] + frame.payload)  # the arrival then is little-endian
        return True

    def table(self, message: int) -> tuple[NDArray[np.int64], NDArray[np.void]]:
        """Return places and frames (n,) of a message."""
        return self.store.table(message, _layout(message))


class _Samples(NamedTuple):
    """Samples of one signal with both clocks."""

    rows: Rows
    """With the stamps of the autopilot, or arrivals if it has none."""
    arrival_us: Array

    def between(self, begin: int, end: int) -> "_Samples":
        """Return the samples from place `begin` to `end`."""
        chosen = (self.rows.position >= begin) & (self.rows.position <= end)
        return _Samples(self.rows.take(chosen), self.arrival_us[chosen])

    def delay_us(self) -> float:
        """Return the usual time of arrival less stamp [us]."""
        return float(np.median(self.arrival_us - self.rows.time_us)) if len(self.arrival_us) else 0.0

    def on_clock(self, gyro: "_Samples") -> Rows:
        """Return the samples on the clock of the gyro: as stamped if that is theirs, else by their arrivals.

        A simulator that is slower than the clock stretches arrivals, so stamps are compared with those beside them.
        """
        ticks = gyro.rows.time_us
        after = np.searchsorted(gyro.rows.position, self.rows.position).clip(1, max(len(ticks) - 1, 1))
        apart = np.min(
            [np.abs(self.rows.time_us - ticks[(after - back).clip(0, len(ticks) - 1)]) for back in (0, 1)], 0
        )
        most = _SAME_CLOCK_US + (0.5 * usual_step(ticks) if len(ticks) > 1 else 0.0)
        if len(apart) == 0 or np.median(apart) <= most:
            return self.rows
        return replace(self.rows, time_us=self.arrival_us - gyro.delay_us())


def read_tlog(path: Path) -> Draft:
    """Return the signals of a log.

    Raises
    ------
    OSError
        If the file can't be read.
    ValueError
        If it is no such log, or no autopilot is in it.
    """
    parser = _Parser()
    left = read_blocks(path, parser.consume)
    if parser.sender is None:
        raise ValueError("no heartbeat of an autopilot in it")
    parameters = _parameters(parser)
    draft = Draft(source=path.name, system=_SYSTEMS.get(parser.kind, "mavlink"), rows={}, parameters=parameters.values)
    samples = _find_samples(parser, draft)
    if "gyro" not in samples:
        raise ValueError("no gyro in it")
    begin, end = longest_piece(samples["gyro"].rows, draft.findings)
    kept = {name: each.between(begin, end) for name, each in samples.items()}
    draft.rows = {name: each.on_clock(kept["gyro"]) for name, each in kept.items()}
    draft.in_air = draft.rows.pop(_IN_AIR, None)
    if parser.damaged:
        draft.findings.append(f"file: {parser.damaged:,} bytes are no frames: left out")
    if left:
        draft.findings.append(f"file: it ends within a frame, {left:,} bytes of it are there")
    if "motors" in samples:
        draft.findings += describe_pulses(parameters.values)
    draft.findings += parameters.findings()
    return draft


def _layout(message: int) -> np.dtype[np.void]:
    """Return the layout of a message on the wire, with its arrival [us] before it."""
    kind: Any = wire.mavlink_map[message]
    fields: list[Any] = [("arrival", "<u8")]
    types = re.findall(r"(\d*)([a-zA-Z])", kind.unpacker.format)
    for name, (count, letter) in zip(kind.ordered_fieldnames, types, strict=True):
        number = f"S{count}" if letter == "s" else np.dtype(letter).newbyteorder("<")
        fields.append((name, number, (int(count),) if count and letter != "s" else ()))
    return np.dtype(fields)


def _sample(parser: _Parser, source: _Source) -> _Samples | None:
    """Return the samples of a signal; `None` if there are none."""
    places, table = parser.table(source.message)
    if source is _TORQUES and parser.sender is not None:
        to_it = (table["group_mlx"] == 0) & (table["target_system"] == parser.sender[0])
        places, table = places[to_it], table[to_it]
    if not len(table):
        return None
    arrival_us = table["arrival"].astype(np.float64)
    names = table.dtype.names or ()
    stamps = [table[name] * unit_us for name, unit_us in _STAMPS.items() if name in names]
    numbers = np.concatenate([table[name].reshape(len(table), -1) for name in source.fields], axis=1)
    values = source.convert(numbers.astype(np.float64) * source.scale)
    return _Samples(Rows(position=places, time_us=stamps[0] if stamps else arrival_us, values=values), arrival_us)


def _find_samples(parser: _Parser, draft: Draft) -> dict[str, _Samples]:
    """Return the samples of each signal, and those that tell whether it is in the air; set the command's unit."""
    samples: dict[str, _Samples] = {}
    for signal, sources in _SIGNALS.items():
        found = [each for source in sources if (each := _sample(parser, source)) is not None]
        if found:
            best = fastest([each.rows for each in found]) if signal == "gyro" else found[0].rows
            samples[signal] = next(each for each in found if each.rows is best)
    others = {"command": _find_command(parser, draft), "motors": _find_motors(parser, draft.parameters)}
    others[_IN_AIR] = _sample(parser, _LANDED_STATE) or _sample(parser, _BASE_MODE)
    return samples | {name: each for name, each in others.items() if each is not None}


def _find_command(parser: _Parser, draft: Draft) -> _Samples | None:
    """Return the torque command, in N m if the limits are published as our autopilot does; then say so in `draft`."""
    command = _sample(parser, _TORQUES)
    if command is None or not draft.parameters.keys() >= {*TORQUE_LIMIT_NAMES}:
        return command
    draft.command_unit, draft.system = CommandUnit.NEWTON_METRES, "gustproof"
    limits = [draft.parameters[name] for name in TORQUE_LIMIT_NAMES]
    return command._replace(rows=replace(command.rows, values=command.rows.values * limits))


def _find_motors(parser: _Parser, parameters: dict[str, float]) -> _Samples | None:
    """Return the commands of the motors, `None` if they never run."""
    servos = _sample(parser, _SERVO_OUTPUTS)
    pulses = {} if servos is None else dict(enumerate(servos.rows.values.T, start=1))
    motors = motor_commands(pulses, parameters)
    if servos is None or motors is None or not np.any(motors):
        return None
    return servos._replace(rows=replace(servos.rows, values=motors))


def _parameters(parser: _Parser) -> LoggedParameters:
    """Return the parameters; integers of PX4 travel bytewise in a float field."""
    parameters = LoggedParameters()
    _, table = parser.table(_PARAMETER)
    for name, value, kind in zip(table["param_id"], table["param_value"], table["param_type"], strict=True):
        is_bytewise = parser.kind == wire.MAV_AUTOPILOT_PX4 and kind in _INTEGERS
        number = float(value.view(_INTEGERS[kind])) if is_bytewise else float(value)
        if (text := name.decode("ascii", "replace")).isidentifier():
            parameters.add(text, number)
    return parameters
