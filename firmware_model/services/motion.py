"""How the vehicle moves: what it measures, what it takes for its attitude, and the truth.

References
----------
MAVLink, messages 30, 31, 105, 115.
"""

import math

import numpy as np
from pymavlink.dialects.v20 import all as wire

from firmware_model import messages
from firmware_model.frames import Message
from firmware_model.rotations import euler_angles
from firmware_model.services.service import Craft, Service, Stream
from firmware_model.signals import ImuSample, Quaternion, Vector

_HOME_DEG = (47.397742, 8.545594)  # PX4's own simulated home, where its users expect a simulated vehicle
_HOME_ALTITUDE_M = 488.0
_METRES_PER_DEGREE = math.radians(1.0) * 6_371_000.0  # spherical earth; 0.3 % at most over a hover
_MILLI_G = 1000.0 / 9.80665


def service(craft: Craft) -> Service:
    """Return the service that tells how the craft moves."""
    loop = craft.loop

    def truth() -> Message:
        vectors = (loop.truth(name) for name in ("omega_B", "position_N", "velocity_N"))
        return truth_message(loop.observe(), loop.q_NB, *vectors)

    return Service(
        streams={
            wire.MAVLINK_MSG_ID_HIGHRES_IMU: Stream(lambda: messages.imu_message(loop.observe()), 20_000),
            wire.MAVLINK_MSG_ID_ATTITUDE: Stream(lambda: attitude_message(loop.observe(), loop.estimate_q_NB), 10_000),
            wire.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: Stream(
                lambda: attitude_quaternion_message(loop.observe(), loop.estimate_q_NB), 20_000
            ),
            wire.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: Stream(truth, 20_000),
        }
    )


def attitude_message(sample: ImuSample, q_NB: Quaternion) -> Message:
    """Return ATTITUDE from the on-board estimate `q_NB` and the measured rates."""
    euler = euler_angles(np.array([q_NB]))[0].tolist()
    return wire.MAVLink_attitude_message(sample.time_us // 1000, *euler, *sample.gyro_B)


def attitude_quaternion_message(sample: ImuSample, q_NB: Quaternion) -> Message:
    """Return ATTITUDE_QUATERNION from the on-board estimate `q_NB` and the measured rates."""
    return wire.MAVLink_attitude_quaternion_message(sample.time_us // 1000, *q_NB, *sample.gyro_B)


def truth_message(
    sample: ImuSample, q_NB: Quaternion, omega_B: Vector, position_N: Vector, velocity_N: Vector
) -> Message:
    """Return HIL_STATE_QUATERNION: the true state about a fixed home, in degrees, mm, cm/s and mG."""
    latitude = _HOME_DEG[0] + position_N[0] / _METRES_PER_DEGREE
    longitude = _HOME_DEG[1] + position_N[1] / (_METRES_PER_DEGREE * math.cos(math.radians(_HOME_DEG[0])))
    altitude_mm = round(1000.0 * (_HOME_ALTITUDE_M - position_N[2]))
    airspeed = min(round(100.0 * math.hypot(*velocity_N)), 65535)
    return wire.MAVLink_hil_state_quaternion_message(
        sample.time_us, q_NB, *omega_B, round(1e7 * latitude), round(1e7 * longitude), altitude_mm,
        *(_int16(100.0 * v) for v in velocity_N), airspeed, airspeed,
        *(_int16(_MILLI_G * f) for f in sample.specific_force_B),
    )  # fmt: skip


def _int16(value: float) -> int:
    return min(max(round(value), -32768), 32767)
