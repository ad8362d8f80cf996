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

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.external.readings import Readings
from firmware_model.numerics.compiled import compiled, kernel
from firmware_model.numerics.elementary import arctan2
from firmware_model.numerics.rotations import rotate
from firmware_model.types import Quaternion, Vector

Text = NDArray[np.uint8]

_MAGIC = {struct.calcsize(f"<HHI{outputs}H"): magic for outputs, magic in ((16, 18458), (32, 29569))}  # by the length
_FRAME = struct.Struct("<HHI4H")  # magic, rate, count, and the outputs that a quadrotor uses
_THRUSTS = [min(max((pulse - 1000) / 1000.0, 0.0), 1.0) for pulse in range(1 << 16)]  # by pulse [us]
# [s/us] The autopilot cuts each difference of stamps to whole microseconds: it must not come out a little less.
_CLOCK = 1e-6 * (1.0 + 4e-7)
_FIRST_US = 1  # of its clock: at 0 it reads the machine's clock until the next sample, and no two flights are equal
_DIGITS, _DECIMALS = ord("%"), ord("#")  # places of a number with nine digits, and with nine decimals
# The autopilot reads a value two characters after its name's end and takes the first name that fits, so no space may
# stand before a value, and `velocity` before every longer name that contains it.
_ANSWER = np.frombuffer(
    b'\n{"timestamp":#,"imu":{"gyro":[%,%,%],"accel_body":[%,%,%]},'
    b'"position":[%,%,%],"velocity":[%,%,%],"quaternion":[%,%,%,%],'
    b'"rng_1":%,"windvane":{"direction":%,"speed":%},"velocity_wind":[%,%,%]}\n',
    dtype=np.uint8,
)
_MOST = 20  # characters of a number: its sign, its point, and the 18 digits that fit 64 bits
_POWERS = np.array([10**places for places in range(_MOST - 2)])
_LONGEST = sum(_MOST if byte in (_DIGITS, _DECIMALS) else 1 for byte in _ANSWER)
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


class ServoFrame(NamedTuple):
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

    def read(self, datagram: bytes) -> ServoFrame:
        """Return what a datagram means; never raise."""
        expected = _MAGIC.get(len(datagram))
        if expected is None:
            return ServoFrame(FrameKind.FOREIGN)
        magic, rate_hz, count, *pulses = _FRAME.unpack_from(datagram)
        if magic != expected:
            return ServoFrame(FrameKind.FOREIGN)
        if count <= self._count:
            return ServoFrame(FrameKind.REPEATED if count == self._count else FrameKind.RESTARTED)
        self._count = count
        return ServoFrame(FrameKind.NEW, tuple([_THRUSTS[pulses[output]] for output in self._outputs]), rate_hz)


def encode_answer(readings: Readings) -> bytes:
    """Return the answer that tells a sample: measured rates and specific force, true motion and mean wind.

    The autopilot simulates its other sensors from the true motion. `rng_1` is the height [m] above the ground. The wind
    vane tells where the air comes from, clockwise from the nose [rad], and its speed [m/s]; `velocity_wind` where it
    blows. Numbers have nine digits, so that a float32 passes unchanged. Text by Python's `%` takes three times as long.
    """
    text = np.empty(_LONGEST, dtype=np.uint8)
    length = _write_answer(
        text,
        (readings.time_us + _FIRST_US) * _CLOCK,
        readings.gyro_B,
        readings.specific_force_B,
        readings.position_N,
        readings.velocity_N,
        readings.q_NB,
        readings.wind_N,
    )
    return text[:length].tobytes()


@compiled
def _write_answer(
    text: Text,
    time_s: float,
    gyro_B: Vector,
    specific_force_B: Vector,
    position_N: Vector,
    velocity_N: Vector,
    q_NB: Quaternion,
    wind_N: Vector,
) -> int:
    """Write the answer to `text`, and return its length."""
    north, east = velocity_N[0] - wind_N[0], velocity_N[1] - wind_N[1]
    nose_north, nose_east, _ = rotate(q_NB, (1.0, 0.0, 0.0))
    direction = arctan2(nose_north * east - nose_east * north, nose_north * north + nose_east * east)
    others = (max(-position_N[2], 0.0), direction, math.sqrt(north * north + east * east))
    numbers = (time_s, *gyro_B, *specific_force_B, *position_N, *velocity_N, *q_NB, *others, *wind_N)
    at = number = 0
    for byte in _ANSWER:
        if byte in (_DIGITS, _DECIMALS):
            value = numbers[number]
            at = _write_number(text, at, value, 9 if byte == _DECIMALS else _count_decimals(abs(value)))
            number += 1
        else:
            text[at] = byte
            at += 1
    return at


@kernel
def _count_decimals(value: float) -> int:
    """Return how many decimals a number has with nine digits."""
    decimals = 8
    while decimals and value * _POWERS[decimals] >= 1e9:
        decimals -= 1
    while decimals < len(_POWERS) - 1 and value * _POWERS[decimals] < 1e8:
        decimals += 1
    return decimals


@kernel
def _write_number(text: Text, at: int, value: float, decimals: int) -> int:
    """Write a number at a place, without zeros at its end, and return the place after it."""
    if not abs(value) < 1e9:  # or NaN, of a flight beyond all numbers
        value = math.copysign(1e9, value)
    if value < 0.0:
        text[at] = ord("-")
        at += 1
    scaled = int(abs(value) * _POWERS[decimals] + 0.5)
    while decimals and scaled % 10 == 0:
        scaled //= 10
        decimals -= 1
    digits = decimals + 1
    while digits < len(_POWERS) and scaled >= _POWERS[digits]:
        digits += 1
    end = place = at + digits + (1 if decimals else 0)
    for digit in range(digits):
        if digit == decimals and digit:
            place -= 1
            text[place] = ord(".")
        place -= 1
        text[place] = ord("0") + scaled % 10
        scaled //= 10
    return end


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
