"""ArduPilot's JSON interface without its sockets: motor outputs in, readings of a sample out.

The autopilot sends a frame and waits for the answer, so a frame is a sample. Its outputs act from the present sample,
and its answer tells the next one. A frame that repeats a count asks for the same answer again. A lower count comes
from an autopilot that has restarted.

References
----------
ArduPilot, SITL, JSON interface: frames of 16 and 32 outputs, names and units of the answer.
"""

import math
import struct
from enum import Enum
from typing import NamedTuple

from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.guest.readings import Readings

_MAGIC = {struct.calcsize(f"<HHI{outputs}H"): magic for outputs, magic in ((16, 18458), (32, 29569))}  # by the length
_FRAME = struct.Struct("<HHI4H")  # magic, rate, count, and the outputs that a quadrotor uses
_THRUSTS = [min(max((pulse - 1000) / 1000.0, 0.0), 1.0) for pulse in range(1 << 16)]  # by pulse [us]
# [s/us] The autopilot cuts each difference of stamps to whole microseconds: it must not come out a little less.
_CLOCK = 1e-6 * (1.0 + 4e-7)
_FIRST_US = 1  # of its clock: at 0 it reads the machine's clock until the next sample, and no two flights are equal
# The autopilot reads a value two characters after its name's end and takes the first name that fits, so no space may
# stand before a value, and `velocity` before every longer name that contains it.
_ANSWER = (
    b'\n{"timestamp":%.9f,"imu":{"gyro":[%.9g,%.9g,%.9g],"accel_body":[%.9g,%.9g,%.9g]},'
    b'"position":[%.9g,%.9g,%.9g],"velocity":[%.9g,%.9g,%.9g],"quaternion":[%.9g,%.9g,%.9g,%.9g],'
    b'"rng_1":%.4f,"windvane":{"direction":%.6f,"speed":%.6f},"velocity_wind":[%.7g,%.7g,%.7g]}\n'
)
_QUADRANTS = {(1, 1): 0, (-1, -1): 1, (1, -1): 2, (-1, 1): 3}  # signs of x and y of outputs 1 to 4 of FRAME_TYPE 1
_SPINS = (1, 1, -1, -1)  # of these


class FrameKind(Enum):
    """Meaning of a received datagram."""

    NEW = "new"
    """Outputs for the present sample."""
    REPEATED = "repeated"
    """Asks for the last answer again."""
    RESTARTED = "restarted"
    """From an autopilot that has lost its count, and with it its state."""
    FOREIGN = "foreign"
    """No frame of this interface."""


class Frame(NamedTuple):
    """A datagram from the autopilot."""

    kind: FrameKind
    """Meaning."""
    rotors: tuple[float, ...] = ()
    """[0..1] thrust of each rotor as a fraction of its largest, in the order of the vehicle file."""
    rate_hz: int = 0
    """[Hz] frames, as the autopilot has them."""


class FrameReader:
    """Reads the frames of one autopilot; `outputs` holds the number of each rotor's output, from 0."""

    def __init__(self, outputs: tuple[int, ...]) -> None:
        self._outputs = outputs
        self._count = -1

    def read(self, datagram: bytes) -> Frame:
        """Return what a datagram means; never raise."""
        expected = _MAGIC.get(len(datagram))
        if expected is None:
            return Frame(FrameKind.FOREIGN)
        magic, rate_hz, count, *pulses = _FRAME.unpack_from(datagram)
        if magic != expected:
            return Frame(FrameKind.FOREIGN)
        if count <= self._count:
            return Frame(FrameKind.REPEATED if count == self._count else FrameKind.RESTARTED)
        self._count = count
        return Frame(FrameKind.NEW, tuple([_THRUSTS[pulses[output]] for output in self._outputs]), rate_hz)


def encode_answer(readings: Readings) -> bytes:
    """Return the answer that tells a sample: measured rates and specific force, true motion and mean wind.

    The autopilot simulates its other sensors from the true motion. `rng_1` is the height [m] above the ground. The wind
    vane tells where the air comes from, clockwise from the nose [rad], and its speed [m/s]; `velocity_wind` where it
    blows.
    """
    position, velocity, wind = readings.position_N, readings.velocity_N, readings.wind_N
    north, east = velocity[0] - wind[0], velocity[1] - wind[1]
    w, x, y, z = readings.q_NB
    heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return _ANSWER % (
        (readings.time_us + _FIRST_US) * _CLOCK,
        *readings.gyro_B,
        *readings.specific_force_B,
        *position,
        *velocity,
        *readings.q_NB,
        max(-position[2], 0.0),
        math.remainder(math.atan2(east, north) - heading, math.tau),
        math.hypot(north, east),
        *wind,
    )


def map_outputs(vehicle: Vehicle) -> tuple[int, ...]:
    """Return the number, from 0, of the output that drives each rotor of a quadrotor X (FRAME_CLASS 1, FRAME_TYPE 1).

    Raises
    ------
    ConfigError
        If no output has a rotor's place and direction.
    """
    outputs = []
    for number, ((x, y, _), spin) in enumerate(zip(vehicle.rotors.position_B, vehicle.rotors.spin, strict=True)):
        output = _QUADRANTS.get((_sign(x), _sign(y)))
        if output is None or output in outputs or _SPINS[output] != spin:
            raise ConfigError(
                f"vehicle '{vehicle.name}': rotors.{number} at ({x:g}, {y:g}) m with spin {spin} is none of "
                "ArduPilot's quadrotor X: front right 1, rear left 1, front left -1, rear right -1"
            )
        outputs.append(output)
    return tuple(outputs)


def _sign(value: float) -> int:
    return (value > 0.0) - (value < 0.0)
