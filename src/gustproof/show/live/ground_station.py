"""Ground station of the live page: receives telemetry as any client does, and sets two parameters.

It is a sans-I/O peer like the vehicle itself; `firmware_model.process.udp.serve` carries its datagrams. It requests the
streams that the page shows and stops all others. In lockstep it shows no stream: each message would cost the flight
time, and the journal has the same data.

References
----------
MAVLink, messages 0, 20, 22, 23, 111, 115, 140, 231, 253, 345; command 511.
"""

import struct
from collections.abc import Callable
from queue import SimpleQueue
from threading import Event
from typing import Any

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode
from firmware_model.autopilot.parameters import GUST_SCALE_NAME, PAUSE_NAME
from firmware_model.mavlink import messages
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import Address, Frame, Message, RejectReason, parse
from firmware_model.mavlink.messages import AUTOPILOT, command_long_message
from firmware_model.types import Vector
from gustproof.show.live.telemetry_buffer import TelemetryBuffer

HEARTBEAT_US = 1_000_000
"""[us] wall time between heartbeats."""
RETRY_US = 200_000
"""[us] wall time after which an unconfirmed parameter is set again."""
STREAM_US = 20_000
"""[us] time between two messages of a shown stream."""
_POLL_US = 20_000  # longest delay of a user's request
_SYSTEM, _COMPONENT = 255, wire.MAV_COMP_ID_MISSIONPLANNER  # MAVLink's usual ids of a ground station
_TEXTS = 6
_DIGITS = 6
_MODES = {mode.value: mode.name for mode in Mode}
_STREAMS = (
    wire.MAVLINK_MSG_ID_HIL_STATE_QUATERNION,
    wire.MAVLINK_MSG_ID_WIND_COV,
    wire.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET,
)
_PARAMETER_FACTS = {GUST_SCALE_NAME: "gust_scale", PAUSE_NAME: "paused"}
_INTEGER_PARAMETERS = (PAUSE_NAME,)


class GroundStation:
    """Ground station of one vehicle; pass it datagrams and the time, send the datagrams it returns."""

    def __init__(self, vehicle: Address, buffer: TelemetryBuffer, torque_limit: Vector, *, streams: bool) -> None:
        self.finished = False
        self.parameters_confirmed = Event()
        self._end_requested = Event()
        self._has_received = self._final_poll = False
        self.channel = Channel(_SYSTEM, _COMPONENT)
        self._vehicle, self._buffer, self._torque_limit = vehicle, buffer, torque_limit
        self._requests: SimpleQueue[tuple[str, float]] = SimpleQueue()
        self._pending: dict[str, float] = {}
        self._streams = _STREAMS if streams else ()
        self._missing_streams: set[int] = set()
        self._stop_request_us: dict[int, int] = {}
        self._outbox: list[tuple[bytes, Address]] = []
        self._system: int | None = None
        self._next_heartbeat_us = self._retry_at_us = self._now_us = 0
        self._newest_us: dict[str, int] = {}
        self._received = 0
        self._timesync_ns = -1
        self._round_trip_ms: float | None = None
        self._handlers: dict[int, Callable[[Message], None]] = {
            wire.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            wire.MAVLINK_MSG_ID_PARAM_VALUE: self._on_parameter,
            wire.MAVLINK_MSG_ID_PARAM_ERROR: self._on_error,
            wire.MAVLINK_MSG_ID_STATUSTEXT: self._on_text,
            wire.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            wire.MAVLINK_MSG_ID_COMMAND_ACK: lambda _: None,
        }
        shown = zip(_STREAMS, (self._on_state, self._on_wind, self._on_torque), strict=True)
        self._handlers |= dict(shown if streams else ())

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter; safe from any thread."""
        self.parameters_confirmed.clear()
        self._requests.put((name, value))

    def end(self) -> None:
        """Finish once everything sent until now has been received; safe from any thread."""
        self._end_requested.set()

    def receive(self, datagram: bytes, peer: Address, now_us: int) -> None:
        """Process a datagram; never raises: unusable input is counted by its cause."""
        self._now_us, self._has_received = now_us, True
        for item in parse(datagram):
            if peer != self._vehicle:
                self.count_reject(RejectReason.OTHER_TARGET, peer)
            elif isinstance(item, RejectReason):
                self.count_reject(item, peer)
            else:
                self._dispatch(item)

    def count_reject(self, cause: RejectReason, peer: Address) -> None:
        """Count a message without effect."""
        self.channel.dropped[cause] += 1

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Do the work that is due and return the datagrams to send."""
        self._now_us = now_us
        if self._end_requested.is_set():
            self.finished, self._final_poll = self._final_poll and not self._has_received, True
            self._has_received = False
        while not self._requests.empty():  # this thread alone takes from it
            name, value = self._requests.get_nowait()
            self._pending[name] = value
            self._retry_at_us = now_us
        if now_us >= self._next_heartbeat_us:
            self._next_heartbeat_us = now_us + HEARTBEAT_US
            self._send_heartbeat()
        if self._pending and now_us >= self._retry_at_us and self._system is not None:
            self._retry_at_us = now_us + RETRY_US
            for name, value in self._pending.items():
                self._set(name, value)
        outbox, self._outbox = self._outbox, []
        return outbox

    def deadline_us(self) -> int:
        """Return the latest wall time of the next call of `poll`."""
        return self._now_us + _POLL_US

    def _send_heartbeat(self) -> None:
        """Send a heartbeat and a time request; request streams that have not come since the last heartbeat."""
        kind, family = wire.MAV_TYPE_GCS, wire.MAV_AUTOPILOT_INVALID
        self._send(wire.MAVLink_heartbeat_message(kind, family, 0, 0, wire.MAV_STATE_ACTIVE, 3))
        self._publish_link()
        if self._system is None:
            return
        self._timesync_ns = 1000 * self._now_us
        self._send(wire.MAVLink_timesync_message(0, self._timesync_ns))
        for number in self._missing_streams:
            self._set_message_interval(number, STREAM_US)
        self._missing_streams = set(self._streams)

    def _dispatch(self, frame: Frame) -> None:
        self.channel.count(frame)
        number = frame.message_id
        if frame.component != AUTOPILOT and number != wire.MAVLINK_MSG_ID_STATUSTEXT:
            return
        self._missing_streams.discard(number)
        handler = self._handlers.get(number)
        if handler is not None:
            handler(frame.message())
        elif self._now_us >= self._stop_request_us.get(number, 0):
            self._stop_request_us[number] = self._now_us + HEARTBEAT_US
            self._set_message_interval(number, -1)

    def _on_heartbeat(self, message: Message) -> None:
        first = self._system is None
        self._system = message.get_srcSystem()
        mode, armed = message.custom_mode, bool(message.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED)
        self._buffer.update(mode=_MODES.get(mode, str(mode)), armed=armed)
        if first:
            self._next_heartbeat_us = self._now_us
            for name in _PARAMETER_FACTS:
                self._send(wire.MAVLink_param_request_read_message(self._system, AUTOPILOT, name.encode(), -1))
            for number in self._streams:
                self._set_message_interval(number, STREAM_US)
            self._signal_if_confirmed()

    def _on_parameter(self, message: Message) -> None:
        name = message.param_id
        if name not in _PARAMETER_FACTS:
            return
        value = messages.parse_parameter(message)
        fact = bool(value) if name in _INTEGER_PARAMETERS else round(value, _DIGITS)
        self._buffer.update(**{_PARAMETER_FACTS[name]: fact})
        if name in self._pending and abs(value - self._pending[name]) < 1e-6:
            del self._pending[name]
        self._signal_if_confirmed()

    def _on_error(self, message: Message) -> None:
        self._pending.pop(message.param_id, None)
        self._signal_if_confirmed()

    def _signal_if_confirmed(self) -> None:
        if not self._pending and self._requests.empty():
            self.parameters_confirmed.set()

    def _on_text(self, message: Message) -> None:
        self._buffer.update(texts=[*self._buffer["texts"], message.text][-_TEXTS:])

    def _on_timesync(self, message: Message) -> None:
        if message.ts1 == self._timesync_ns:
            self._round_trip_ms = (self._now_us - self._timesync_ns // 1000) / 1000
        else:  # a time request of the vehicle
            self._set_message_interval(wire.MAVLINK_MSG_ID_TIMESYNC, -1)

    def _on_state(self, message: Message) -> None:
        rates = message.rollspeed, message.pitchspeed, message.yawspeed
        self._add("attitude", message.time_usec, *message.attitude_quaternion, *rates)

    def _on_wind(self, message: Message) -> None:
        self._add("wind", message.time_usec, message.wind_x, message.wind_y, message.wind_z)

    def _on_torque(self, message: Message) -> None:
        pairs = zip(message.controls, self._torque_limit, strict=False)
        # The stamp is the command's; the vehicle holds a command until a newer one comes.
        time_us = max(message.time_usec, self._newest_us.get("attitude", 0))
        self._add("torque", time_us, *(control * limit for control, limit in pairs))

    def _add(self, name: str, time_us: int, *numbers: float) -> None:
        if time_us <= self._newest_us.get(name, -1):  # before t = 0 the same sample repeats
            return
        self._newest_us[name] = time_us
        self._buffer.add(name, [[time_us * 1e-6, *(round(number, _DIGITS) for number in numbers)]])

    def _publish_link(self) -> None:
        figures: dict[str, Any] = self.channel.stats()
        rate, self._received = figures["in"] - self._received, figures["in"]
        shown = {"rate": rate, "lost": figures["lost"], "bad": figures["bad"], "round_trip_ms": self._round_trip_ms}
        self._buffer.update(link=shown)

    def _set(self, name: str, value: float) -> None:
        kind = wire.MAV_PARAM_TYPE_REAL32
        if name in _INTEGER_PARAMETERS:  # integers travel bytewise, as in PX4
            value, kind = struct.unpack("<f", struct.pack("<i", int(value)))[0], wire.MAV_PARAM_TYPE_INT32
        self._send(wire.MAVLink_param_set_message(self._system, AUTOPILOT, name.encode(), value, kind))

    def _set_message_interval(self, number: int, interval_us: int) -> None:
        self._send(command_long_message(wire.MAV_CMD_SET_MESSAGE_INTERVAL, self._system or 0, number, interval_us))

    def _send(self, message: Message) -> None:
        self._outbox.append((self.channel.pack(message), self._vehicle))
