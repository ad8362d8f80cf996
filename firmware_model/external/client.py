"""Client of an external autopilot over MAVLink: arms it, sets its mode, sends attitude set-points, and listens.

A protocol core without I/O, on the world's clock: a flight at any speed gives the same set-points at the same samples.

MAVLink, common message set, messages 0, 4, 20, 22, 23, 31, 76, 77, 82, 83, 148, 231, 253, 350; commands 176,
400, 511, 512. ArduPilot's own message 168.
"""

import math
import struct
from collections import deque
from collections.abc import Mapping

from pymavlink.dialects.v20 import all as wire

from firmware_model.external.dialect import Dialect
from firmware_model.external.read_back import ParameterReader
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import Address, EncodedMessage, Frame, Message, RejectReason, parse
from firmware_model.mavlink.messages import AUTOPILOT, command_long_message, command_message
from firmware_model.recording.estimates import Estimate
from firmware_model.types import AttitudeTarget, Quaternion, Vector

PERIOD_US = 20_000
"""[us] Time between two set-points, and between two estimates of the autopilot."""
_HEARTBEAT_US = 1_000_000
_RETRY_US, _READ_US = 500_000, 250_000
_SETTINGS_SENT = 5  # times that a parameter is set at most
_TEXTS = 40  # latest texts that are kept
_SYSTEM, _COMPONENT = 245, wire.MAV_COMP_ID_ONBOARD_COMPUTER
_STREAMS = (wire.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, wire.MAVLINK_MSG_ID_ATTITUDE_TARGET)
_WINDS = {
    wire.MAV_AUTOPILOT_PX4: (wire.MAVLINK_MSG_ID_WIND_COV,),
    wire.MAV_AUTOPILOT_ARDUPILOTMEGA: (wire.MAVLINK_MSG_ID_WIND,),
}
_ATTITUDE = struct.Struct("<I4f")  # both streams begin with stamp [ms] and quaternion
_ARRAY = struct.Struct("<QH10s5f")  # DEBUG_FLOAT_ARRAY: stamp [us], id, name, quaternion, thrust; the rest are zeros
_FOREIGN_MODE = 1.0  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED


class ExternalClient:
    """Client of one external autopilot: `meet` it, pass datagrams and the world's time, send what it returns.

    With `wants_echo` a ping follows each set-point; it `awaits_echo` until it is answered: the autopilot has read both.

    It asks for arming and mode again and again while `wants_flight`, and for the law inside while `wants_law`. Until
    the autopilot is armed it reads the parameters that its `reader` wants.
    """

    def __init__(self, dialect: Dialect, reader: ParameterReader | None = None) -> None:
        self._dialect, self._system = dialect, 0
        self._address: Address | None = None
        self.channel = Channel(_SYSTEM, _COMPONENT)
        self.finished = False
        self.wants_flight = self.wants_law = self.wants_echo = self.awaits_echo = False
        self.target: AttitudeTarget | None = None
        self.autopilot: int | None = None
        self.custom_mode: int | None = None
        self.is_armed = False
        self.version = ""
        self.texts: deque[str] = deque(maxlen=_TEXTS)
        self.refusals: dict[int, int] = {}
        self.estimates: list[Estimate] = []
        self._settings: dict[str, tuple[float, int]] = {}
        self._setpoint: Quaternion = (math.nan,) * 4
        self._wind_N: Vector = (math.nan,) * 3
        self._heartbeat_at_us = self._retry_at_us = self._read_at_us = self._now_us = 0
        self._outbox: list[bytes] = []
        self.reader = reader or ParameterReader()
        self._handlers = {
            wire.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            wire.MAVLINK_MSG_ID_PING: self._on_ping,
            wire.MAVLINK_MSG_ID_PARAM_VALUE: self._on_parameter,
            wire.MAVLINK_MSG_ID_STATUSTEXT: self._on_text,
            wire.MAVLINK_MSG_ID_COMMAND_ACK: self._on_ack,
            wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._on_version,
            wire.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._on_attitude,
            wire.MAVLINK_MSG_ID_ATTITUDE_TARGET: self._on_target,
            wire.MAVLINK_MSG_ID_WIND_COV: self._on_wind_cov,
            wire.MAVLINK_MSG_ID_WIND: self._on_wind,
        }

    @property
    def is_in_mode(self) -> bool:
        """True if the autopilot's last heartbeat named the mode that follows set-points."""
        return self.custom_mode == self._dialect.custom_mode

    def meet(self, system: int, port: int | None) -> None:
        """Take the autopilot's MAVLink `system`, and its UDP `port` on this machine; `None` if it speaks first."""
        self._system, self._address = system, None if port is None else (0, ("127.0.0.1", port))

    def receive(self, datagram: bytes, address: Address, now_us: int) -> None:
        """Handle a datagram; never raise."""
        self._address = self._address or address
        for item in parse(datagram):
            if isinstance(item, RejectReason):
                self.count_reject(item, address)
            elif item.system == self._system and item.component == AUTOPILOT:
                self.channel.count(item)
                if handler := self._handlers.get(item.message_id):
                    handler(item)

    def count_reject(self, cause: RejectReason, address: Address) -> None:
        """Count a datagram that has no effect."""
        self.channel.dropped[cause] += 1

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Return the datagrams that are due at the world's time [us]."""
        self._now_us = now_us
        if self._address is None:
            return []
        self._send_repeated(now_us)
        if self.target is not None:
            self._send_target(self.target._replace(time_us=now_us))
        self.awaits_echo = self.wants_echo
        if self.wants_echo:
            self._send(wire.MAVLink_ping_message(now_us, 0, 0, 0))
        address, outbox, self._outbox = self._address, self._outbox, []
        return [(datagram, address) for datagram in outbox]

    def deadline_us(self) -> int:
        """Return the latest time for the next call of `poll`."""
        return self._now_us + PERIOD_US

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Set parameters in flight: each is sent until it is told back, a few times at most, as versions lack some."""
        self._settings |= {name: (value, _SETTINGS_SENT) for name, value in values.items()}

    def take_estimates(self) -> list[Estimate]:
        """Return the estimates since the last call."""
        taken, self.estimates = self.estimates, []
        return taken

    def _send_repeated(self, now_us: int) -> None:
        """Send what is repeated at its own pace, if it is due."""
        if now_us >= self._heartbeat_at_us:
            self._heartbeat_at_us = now_us + _HEARTBEAT_US
            kind, none = wire.MAV_TYPE_ONBOARD_CONTROLLER, wire.MAV_AUTOPILOT_INVALID
            self._send(wire.MAVLink_heartbeat_message(kind, none, 0, 0, wire.MAV_STATE_ACTIVE, 3))
        for name, (value, _) in self._settings.items():
            kind = wire.MAV_PARAM_TYPE_REAL32
            self._send(wire.MAVLink_param_set_message(self._system, AUTOPILOT, name.encode(), value, kind))
        self._settings = {name: (value, left - 1) for name, (value, left) in self._settings.items() if left > 1}
        if now_us >= self._retry_at_us and self.autopilot is not None:
            self._retry_at_us = now_us + _RETRY_US
            self._request()
        if now_us >= self._read_at_us and self.autopilot is not None and not self.is_armed:
            self._read_at_us = now_us + _READ_US
            for name in self.reader.next_names():
                self._send(wire.MAVLink_param_request_read_message(self._system, AUTOPILOT, name.encode(), -1))

    def _request(self) -> None:
        """Ask for everything that has not come yet."""
        if not self.version:
            self._command(wire.MAV_CMD_REQUEST_MESSAGE, wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        if not self.estimates and not self.is_armed:
            for number in (*_STREAMS, *_WINDS.get(self.autopilot or 0, ())):
                self._command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, number, PERIOD_US)
        if self.wants_flight and not self.is_in_mode:
            self._command(wire.MAV_CMD_DO_SET_MODE, _FOREIGN_MODE, *self._dialect.mode)
        elif self.wants_flight and not self.is_armed:
            self._command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        if self.wants_law:
            self._command(round(self._dialect.law_switch[0]), *self._dialect.law_switch[1:])

    def _send_target(self, target: AttitudeTarget) -> None:
        if not self._dialect.array_name:
            self._send(command_message(target, self._system))
            return
        fields = target.time_us, 0, self._dialect.array_name.encode(), *(target.q_NB or ()), target.thrust or 0.0
        self._send(EncodedMessage(wire.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY, _ARRAY.pack(*fields)))

    def _command(self, number: int, *parameters: float) -> None:
        self._send(command_long_message(number, self._system, *parameters))

    def _send(self, message: Message | EncodedMessage) -> None:
        self._outbox.append(self.channel.pack(message))

    def _on_heartbeat(self, frame: Frame) -> None:
        message = frame.message()
        self.autopilot, self.custom_mode = message.autopilot, message.custom_mode
        self.is_armed = bool(message.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED)

    def _on_ping(self, frame: Frame) -> None:
        message = frame.message()
        if (message.target_system, message.time_usec) == (_SYSTEM, self._now_us):
            self.awaits_echo = False

    def _on_parameter(self, frame: Frame) -> None:
        message = frame.message()
        self._settings.pop(message.param_id, None)
        self.reader.take(message)

    def _on_text(self, frame: Frame) -> None:
        self.texts.append(frame.message().text)

    def _on_ack(self, frame: Frame) -> None:
        message = frame.message()
        if message.result in (wire.MAV_RESULT_ACCEPTED, wire.MAV_RESULT_IN_PROGRESS):
            self.refusals.pop(message.command, None)
        else:
            self.refusals[message.command] = message.result

    def _on_version(self, frame: Frame) -> None:
        message = frame.message()
        number = message.flight_sw_version
        self.version = ".".join(str(number >> shift & 255) for shift in (24, 16, 8))
        digits = bytes(message.flight_custom_version)
        # PX4 stores the hash's first bytes last to first; ArduPilot stores its letters.
        said = digits.decode() if digits.isalnum() else digits[::-1].hex().rstrip("0")
        self.version += f" ({said})" if any(digits) else ""

    def _on_attitude(self, frame: Frame) -> None:
        time_ms, w, x, y, z = _ATTITUDE.unpack_from(frame.payload)
        self.estimates.append(Estimate(1000 * time_ms, (w, x, y, z), self._setpoint, self._wind_N))

    def _on_target(self, frame: Frame) -> None:
        _, w, x, y, z = _ATTITUDE.unpack_from(frame.payload)
        self._setpoint = (w, x, y, z)

    def _on_wind_cov(self, frame: Frame) -> None:
        message = frame.message()
        self._wind_N = message.wind_x, message.wind_y, message.wind_z

    def _on_wind(self, frame: Frame) -> None:
        message = frame.message()  # the direction is that which the wind comes from
        level, heading = math.sqrt(max(message.speed**2 - message.speed_z**2, 0.0)), math.radians(message.direction)
        self._wind_N = -level * math.cos(heading), -level * math.sin(heading), message.speed_z


def describe_refusals(client: ExternalClient) -> str:
    """Return an autopilot's own words on why it does not fly: its latest texts, each once, and refused commands."""
    words = list(dict.fromkeys(client.texts))[-4:]
    results, commands = wire.enums["MAV_RESULT"], wire.enums["MAV_CMD"]
    for command, result in client.refusals.items():
        words.append(f"{commands[command].name}: {results[result].name}")
    return "; ".join(words) or "it gave no reason"


def quote_last_texts(client: ExternalClient) -> str:
    """Return the last two texts of an autopilot that no longer flies; they need not be the cause."""
    return f"it said last: {'; '.join(list(client.texts)[-2:]) or 'nothing'}"
