"""Motion: measurements, estimated attitude, true state, and the wind at the vehicle.

MAVLink, messages 30, 31, 105, 115, 231; command 43004, a wind that a ground station or a companion estimates.
"""

import math

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services.geodesy import ORIGIN_HEIGHT, clip_int16, to_centi, to_geodetic
from firmware_model.mavlink.services.service import (
    ACCEPTED,
    DENIED,
    CommandAck,
    Service,
    Stream,
    VehicleCommand,
    VehicleContext,
)
from firmware_model.numerics.compiled import compiled
from firmware_model.numerics.rotations import rotate, to_euler
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import ImuSample, Quaternion, Vector

_MILLI_G = 1000.0 / 9.80665
_UNKNOWN = math.nan
_FASTEST_WIND = 150.0  # [m/s] more than any that was measured


def make_service(context: VehicleContext) -> Service:
    """Return the service of the vehicle's motion."""
    loop = context.loop

    def attitude() -> Message:
        return attitude_message(loop.observe(), loop.estimate_q_NB)

    def attitude_quaternion() -> Message:
        return attitude_quaternion_message(loop.observe(), loop.estimate_q_NB)

    def truth() -> Message:
        sample = loop.observe()
        omega_B, position_N, velocity_N = (loop.true_vector(name) for name in ("omega_B", "position_N", "velocity_N"))
        airspeed = math.dist(velocity_N, air_velocity_N(loop))
        return truth_message(sample, loop.q_NB, omega_B, position_N, velocity_N, airspeed)

    def wind() -> Message:
        time_us = loop.observe().time_us
        return wind_message(time_us, air_velocity_N(loop), loop.true_vector("position_N"))

    def hear_wind(command: VehicleCommand, _: Client) -> CommandAck:
        speed, _accuracy, bearing = command.params[:3]
        if speed is None or not 0.0 <= speed <= _FASTEST_WIND or bearing is None:
            return CommandAck(DENIED, "wind: needs a speed to 150 m/s and a bearing")
        context.send_text(describe_wind(speed, bearing, air_velocity_N(loop)), wire.MAV_SEVERITY_INFO)
        return ACCEPTED

    return Service(
        commands={wire.MAV_CMD_EXTERNAL_WIND_ESTIMATE: hear_wind},
        streams={
            wire.MAVLINK_MSG_ID_HIGHRES_IMU: Stream(loop.observe, 20_000),
            wire.MAVLINK_MSG_ID_ATTITUDE: Stream(attitude, 10_000),
            wire.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: Stream(attitude_quaternion, 20_000),
            wire.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: Stream(truth, 20_000),
            wire.MAVLINK_MSG_ID_WIND_COV: Stream(wind, 100_000),
        },
    )


def describe_wind(speed: float, bearing: float, air_N: Vector) -> str:
    """Return how far a level wind of `speed` [m/s] from `bearing` [deg] is from the air velocity [m/s] N, in words.

    Navigation is ideal here, so no estimator takes the wind: whoever estimates one is told how good it is.
    """
    angle = math.radians(bearing)
    off = math.hypot(-speed * math.cos(angle) - air_N[0], -speed * math.sin(angle) - air_N[1])
    return f"wind {speed:.1f} m/s from {bearing % 360.0:.0f} deg: off by {off:.1f} m/s"


def air_velocity_N(loop: VehicleLoop) -> Vector:
    """Return the air velocity at the vehicle [m/s] N, mean wind plus gust."""
    loop.observe()
    return _air_velocity_N(loop.q_NB, loop.true_vector("gust_B"), loop.true_vector("wind_N"))


@compiled  # a plain kernel called from Python would be recompiled in each process and delay its first second
def _air_velocity_N(q_NB: Quaternion, gust_B: Vector, wind_N: Vector) -> Vector:
    gust = rotate(q_NB, gust_B)
    return wind_N[0] + gust[0], wind_N[1] + gust[1], wind_N[2] + gust[2]


def attitude_message(sample: ImuSample, q_NB: Quaternion) -> Message:
    """Return ATTITUDE from the on-board estimate `q_NB` and the measured rates."""
    return wire.MAVLink_attitude_message(sample.time_us // 1000, *to_euler(q_NB), *sample.gyro_B)


def attitude_quaternion_message(sample: ImuSample, q_NB: Quaternion) -> Message:
    """Return ATTITUDE_QUATERNION from the on-board estimate `q_NB` and the measured rates."""
    return wire.MAVLink_attitude_quaternion_message(sample.time_us // 1000, *q_NB, *sample.gyro_B)


def truth_message(
    sample: ImuSample, q_NB: Quaternion, omega_B: Vector, position_N: Vector, velocity_N: Vector, airspeed: float
) -> Message:
    """Return HIL_STATE_QUATERNION: the true state, in degrees, mm, cm/s and mG."""
    air_cm = min(round(100.0 * airspeed), 65535)
    velocity = (to_centi(v) for v in velocity_N)
    force = (clip_int16(_MILLI_G * f) for f in sample.specific_force_B)
    return wire.MAVLink_hil_state_quaternion_message(
        sample.time_us, q_NB, *omega_B, *to_geodetic(position_N), *velocity, air_cm, air_cm, *force
    )


def wind_message(time_us: int, air_N: Vector, position_N: Vector) -> Message:
    """Return WIND_COV: the exact air velocity at the vehicle [m/s] N; its variability is unknown."""
    height = ORIGIN_HEIGHT - position_N[2]
    return wire.MAVLink_wind_cov_message(time_us, *air_N, _UNKNOWN, _UNKNOWN, height, 0.0, 0.0)
