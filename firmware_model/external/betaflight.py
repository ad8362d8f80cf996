"""Betaflight's simulator protocol without I/O: readings to its packet, its packet to rotor commands, and the client.

    UDP 9003   to it    18 doubles: time, rates, acceleration, attitude, velocity, place, pressure
    UDP 9004   to it    a double and 16 sticks of 1000..2000 us
    UDP 9002   from it  4 floats, thrust of front right, rear left, front left, rear right
    TCP 5761   both     MSP, and its command line

It has no lockstep: its loops run on the clock of the machine, and no two flights are equal. The packet sets its
attitude, so no estimator of its own flies; only its level loop, its rate loops and its mixer do.

Rates go to it forward, right, down: it changes the signs of pitch and yaw itself. A simulator that hands over rates in
its axes, forward, left, up, has both the wrong way round. Acceleration is the negative of specific force in those.
"""

import math
import struct
from collections.abc import Iterator
from typing import NamedTuple

from firmware_model.external.client import ExternalClient
from firmware_model.external.dialect import Dialect
from firmware_model.external.readings import Readings
from firmware_model.mavlink.frames import Address
from firmware_model.mavlink.services.geodesy import to_geodetic
from firmware_model.numerics.rotations import to_euler
from firmware_model.types import Quaternion

ANGLE_LIMIT, YAW_RATE_LIMIT = math.radians(60.0), math.radians(200.0)
"""[rad] and [rad/s] at full stick, as its parameters are set to."""
MOTORS = struct.Struct("<4f")
STATUS, ANGLE_BOX = 101, 1
"""MSP command that tells armed, mode and refusals; bit of the ANGLE mode in it, that of ARM is 0."""
DIALECT = Dialect(autopilot=0, mode_name="ANGLE", mode=(0.0, 0.0), custom_mode=1, thrust_range=(0.055, 1.0))
_STATE, _STICKS = struct.Struct("<18d"), struct.Struct("<d16H")
_STATUS = struct.Struct("<HHHIBHH")
_HEADING_P = 1.0  # [1/s] commanded yaw rate per error of heading: it holds none itself
_CENTRE, _SPAN, _LOW = 1500, 500, 1000  # [us]
_REFUSALS = (
    "no gyro,failsafe,no sticks,not disarmed,failsafe switch,runaway take-off,crash,throttle,tilt,starting,no prearm,"
    "load,calibrating,command line,menu,serial,MSP,paralysed,GPS,rescue,DShot telemetry,reboot required,DShot,"
    "accelerometer calibration,motor protocol,crash flip,altitude hold,position hold,arm switch"
)


class ArmingStatus(NamedTuple):
    """State that Betaflight tells over MSP."""

    is_armed: bool
    """True if armed."""
    is_in_angle: bool
    """True if its level loop holds the angles of the sticks."""
    refusals: tuple[str, ...]
    """Reasons for which it would not arm now."""


def pack_state(readings: Readings) -> bytes:
    """Return the packet of a sample."""
    p, q, r = readings.gyro_B
    f_x, f_y, f_z = readings.specific_force_B
    north, east, down = readings.gps_velocity_N
    latitude, longitude, height_mm = to_geodetic(readings.gps_position_N)
    return _STATE.pack(
        0.0,  # its clock goes by the differences of stamps and arrivals; without any it is the clock of the machine
        *(p, q, r),
        *(-f_x, f_y, f_z),
        *readings.q_NB,
        *(east, north, -down),
        *(longitude * 1e-7, latitude * 1e-7, height_mm * 1e-3),
        100.0 * readings.pressure,
    )


def pack_sticks(time_us: int, roll: float, pitch: float, yaw: float, throttle: float, *, arm: bool) -> bytes:
    """Return the packet of the sticks: roll, pitch, yaw -1..1 to the right, nose up, nose right; throttle 0..1."""
    roll_us, pitch_us, yaw_us = (round(_CENTRE + _SPAN * min(max(v, -1.0), 1.0)) for v in (roll, -pitch, yaw))
    throttle_us = round(_LOW + 2 * _SPAN * min(max(throttle, 0.0), 1.0))
    switch = _LOW + 2 * _SPAN * arm
    return _STICKS.pack(time_us * 1e-6, roll_us, pitch_us, throttle_us, yaw_us, switch, *[_LOW] * 11)


def pack_request(command: int) -> bytes:
    """Return an MSP request without data."""
    return b"$M<" + bytes((0, command, command))


def parse_answers(received: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Yield command, data and end of each whole MSP answer; noise and answers with a wrong sum are skipped."""
    start = received.find(b"$M>")
    while start >= 0 and len(received) >= start + 6 and len(received) >= start + 6 + received[start + 3]:
        end = start + 6 + received[start + 3]
        checked = 0
        for byte in received[start + 3 : end - 1]:
            checked ^= byte
        if checked == received[end - 1]:
            yield received[start + 4], received[start + 5 : end - 1], end
        start = received.find(b"$M>", end)


def parse_status(data: bytes) -> ArmingStatus:
    """Return the state in the data of a `STATUS` answer.

    Raises
    ------
    struct.error, IndexError
        If it is too short.
    """
    boxes, extra = _STATUS.unpack_from(data)[3], data[_STATUS.size] & 15
    (flags,) = struct.unpack_from("<I", data, _STATUS.size + 2 + extra)
    refusals = tuple(name for bit, name in enumerate(_REFUSALS.split(",")) if flags >> bit & 1)
    return ArmingStatus(bool(boxes & 1), bool(boxes >> ANGLE_BOX & 1), refusals)


class SticksClient(ExternalClient):
    """Client that flies by sticks in ANGLE mode; `observe` tells it the true attitude, `hear` the autopilot's state.

    Betaflight takes roll and pitch as angles and yaw as a rate, so this client holds the heading.
    """

    def __init__(self) -> None:
        super().__init__(DIALECT)
        self._heading = 0.0
        self._refusals: tuple[str, ...] | None = None

    def receive(self, datagram: bytes, address: Address, now_us: int) -> None:
        """Ignore a datagram: Betaflight sends its client none."""

    def observe(self, q_NB: Quaternion) -> None:
        """Take the true attitude."""
        self._heading = to_euler(q_NB)[2]

    def hear(self, status: ArmingStatus) -> None:
        """Take what Betaflight sent."""
        self.autopilot, self.is_armed = DIALECT.autopilot, status.is_armed
        self.custom_mode = int(status.is_in_angle)
        if status.refusals and status.refusals != self._refusals:
            self.texts.append(f"it does not arm: {', '.join(status.refusals)}")
        self._refusals = status.refusals

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        """Return the packet of the sticks; the throttle is low until it is armed."""
        self._now_us = now_us
        if self._address is None or self.target is None:
            return []
        phi, theta, psi = to_euler(self.target.q_NB or (1.0, 0.0, 0.0, 0.0))
        turn = math.remainder(psi - self._heading, 2.0 * math.pi)
        packet = pack_sticks(
            now_us,
            phi / ANGLE_LIMIT,
            theta / ANGLE_LIMIT,
            _HEADING_P * turn / YAW_RATE_LIMIT if self.is_armed else 0.0,
            (self.target.thrust or 0.0) if self.is_armed else 0.0,
            # A switch that was refused stays without effect until it has been low.
            arm=self.is_armed or (self.wants_flight and self._refusals == ()),
        )
        return [(packet, self._address)]
