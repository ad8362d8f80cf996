"""PX4's simulator protocol without I/O: readings to the frames it expects, and its answer to rotor commands.

    HIL_SENSOR       every sample; its stamp sets PX4's clock
    HIL_GPS          every 50th sample
    HIL_STATE_QUATERNION   every 5th sample, the truth for PX4's own log
    HIL_ACTUATOR_CONTROLS  PX4's answer to a sample, once its estimator is done

MAVLink, common message set, messages 93, 107, 113, 115.
"""

import math
import struct
from typing import NamedTuple

from pymavlink.dialects.v20 import all as wire

from firmware_model.config.vehicle import GRAVITY
from firmware_model.external.readings import Readings
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import Frame, FrameTemplate, parse
from firmware_model.mavlink.services.geodesy import clip_int16, to_centi, to_geodetic
from firmware_model.types import Vector

GPS_EVERY, TRUTH_EVERY = 50, 5
"""Samples from message to message."""
_SYSTEM, _COMPONENT = 1, 200  # of the simulator; PX4 does not look at them
_ALL_FIELDS = 0x1FFF  # HIL_SENSOR_UPDATED_FLAGS: all but the reset bit
_FIX, _SATELLITES = 3, 12
_ERRORS_CM = (40, 60)  # horizontal and vertical, as the noise of the fixes
_ARMED = wire.MAV_MODE_FLAG_SAFETY_ARMED
_LOCKSTEP = 1  # flag of HIL_ACTUATOR_CONTROLS
_V2_OVERHEAD = 12  # [bytes] of a frame without signature
_GYRO_COUNT, _FORCE_COUNT = math.radians(2000.0) / 32768.0, GRAVITY / 2048.0  # [rad/s], [m/s^2] of PX4's int16
_CONTROLS = struct.Struct("<QQ16fB")


class ActuatorAnswer(NamedTuple):
    """PX4's answer to one sample."""

    time_us: int
    """[us] stamp of the sample."""
    controls: tuple[float, ...]
    """[0..1] commands of the outputs, in the order of PX4's motors; zeros while disarmed."""
    is_armed: bool
    """True if PX4 is armed."""
    is_lockstep: bool
    """True if PX4's clock is that of the samples."""


class SimulatorLink:
    """Frames of one link: `pack` the readings of a sample, `feed` received bytes, then take `answer`."""

    def __init__(self) -> None:
        self._channel = Channel(_SYSTEM, _COMPONENT)
        self._sensor = _template(wire.MAVLINK_MSG_ID_HIL_SENSOR, "<Q13fH")  # the rest are zeros, which are cut
        self._gps = _template(wire.MAVLINK_MSG_ID_HIL_GPS, "<QiiiHHHhhhHBB")
        self._truth = _template(wire.MAVLINK_MSG_ID_HIL_STATE_QUATERNION, "<Q7fiiihhhHHhhh")
        self._sample = 0
        self._buffer = b""
        self.answer: ActuatorAnswer | None = None
        self.autopilot: int | None = None

    def pack(self, readings: Readings) -> bytes:
        """Return the frames of a sample."""
        make = self._channel.make
        frames = b""
        if self._sample % GPS_EVERY == 0:
            frames += make(self._gps, *_gps_fields(readings))
        if self._sample % TRUTH_EVERY == 0:
            frames += make(self._truth, *_truth_fields(readings))
        self._sample += 1
        force_B, gyro_B = _counts(readings.specific_force_B, _FORCE_COUNT), _counts(readings.gyro_B, _GYRO_COUNT)
        air = readings.pressure, 0.0, pressure_height(readings.pressure), readings.temperature
        frames += make(self._sensor, readings.time_us, *force_B, *gyro_B, *readings.field_B, *air, _ALL_FIELDS)
        return frames

    def feed(self, received: bytes) -> None:
        """Take bytes of the stream; keep the newest answer."""
        self._buffer += received
        while len(self._buffer) > 1:
            size = self._buffer[1] + _V2_OVERHEAD
            if self._buffer[0] != wire.PROTOCOL_MARKER_V2:
                self._buffer = self._buffer[1:]
            elif len(self._buffer) < size:
                return
            else:
                frame, self._buffer = self._buffer[:size], self._buffer[size:]
                for item in parse(frame):
                    if isinstance(item, Frame):
                        self._on_frame(item)

    def _on_frame(self, frame: Frame) -> None:
        if frame.message_id == wire.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS:
            time_us, flags, *controls, mode = _CONTROLS.unpack(frame.payload)
            self.answer = ActuatorAnswer(time_us, tuple(controls), bool(mode & _ARMED), bool(flags & _LOCKSTEP))
        elif frame.message_id == wire.MAVLINK_MSG_ID_HEARTBEAT:
            self.autopilot = frame.message().autopilot


def pressure_height(pressure: float) -> float:
    """Return the height [m] above the sea at a pressure [hPa], the inverse of `atmosphere`."""
    return float((1.0 - (pressure / 1013.25) ** (1.0 / 5.25588)) * 288.15 / 0.0065)


def _template(number: int, layout: str) -> FrameTemplate:
    return FrameTemplate(number, _SYSTEM, _COMPONENT, layout, b"")


def _counts(value: Vector, count: float) -> Vector:
    """Return a measurement in whole counts, as a converter gives it: PX4 cuts toward zero, which shortens all turns."""
    x, y, z = (round(component / count) * count * (1.0 + 1e-6) for component in value)
    return x, y, z


def _gps_fields(readings: Readings) -> tuple[int, ...]:
    north, east, down = readings.gps_velocity_N
    course = math.degrees(math.atan2(east, north)) % 360.0
    speed = min(round(100.0 * math.hypot(north, east)), 65535)
    velocity = to_centi(north), to_centi(east), to_centi(down)
    place = to_geodetic(readings.gps_position_N)
    fix = (_FIX, _SATELLITES) if readings.has_fix else (0, 0)
    return (readings.time_us, *place, *_ERRORS_CM, speed, *velocity, round(100.0 * course) % 36000, *fix)


def _truth_fields(readings: Readings) -> tuple[float, ...]:
    force: Vector = readings.specific_force_B
    milli_g = (clip_int16(1000.0 * component / GRAVITY) for component in force)
    velocity = (to_centi(component) for component in readings.velocity_N)
    air = [w - v for w, v in zip(readings.wind_N, readings.velocity_N, strict=True)]
    speed = min(round(100.0 * math.hypot(*air)), 65535)
    place = to_geodetic(readings.position_N)
    return (readings.time_us, *readings.q_NB, *readings.omega_B, *place, *velocity, speed, speed, *milli_g)
