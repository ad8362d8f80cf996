"""Position of the vehicle and of home. Navigation is ideal: position, velocity and heading are the true ones.

MAVLink, messages 24, 32, 33, 74, 242; command 410, which older programs send.
"""

import math
from functools import partial

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.peers import Client
from firmware_model.mavlink.services import service
from firmware_model.mavlink.services.geodesy import ORIGIN_HEIGHT, to_centi, to_geodetic
from firmware_model.mavlink.services.motion import air_velocity_N
from firmware_model.mavlink.services.service import Service, Stream, VehicleContext
from firmware_model.types import Quaternion, Vector

_UNKNOWN, _UNKNOWN16, _UNKNOWN8 = math.nan, 2**16 - 1, 2**8 - 1
_LEVEL = (1.0, 0.0, 0.0, 0.0)


def make_service(context: VehicleContext) -> Service:
    """Return the service of the positions of vehicle and home."""

    def home() -> Message:
        place = context.autopilot.home_N
        approach = (_UNKNOWN, _UNKNOWN, _UNKNOWN)
        return wire.MAVLink_home_position_message(*to_geodetic(place), *place, _LEVEL, *approach, context.stamp_us)

    def send_home(_: service.VehicleCommand, client: Client) -> service.CommandAck:
        client.send(home())
        return service.ACCEPTED

    return Service(
        commands={wire.MAV_CMD_GET_HOME_POSITION: send_home},
        streams={
            wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED: Stream(partial(_local_message, context), 33_000),
            wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Stream(partial(_global_message, context), 100_000),
            wire.MAVLINK_MSG_ID_VFR_HUD: Stream(partial(_hud_message, context), 100_000),
            wire.MAVLINK_MSG_ID_GPS_RAW_INT: Stream(partial(_gps_message, context), 200_000),
            wire.MAVLINK_MSG_ID_HOME_POSITION: Stream(home, 2_000_000),
            wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: Stream(partial(origin_message, context)),
        },
    )


def origin_message(context: VehicleContext) -> Message:
    """Return the place of the origin, which is fixed."""
    return wire.MAVLink_gps_global_origin_message(*to_geodetic((0.0, 0.0, 0.0)), context.stamp_us)


def heading(q_NB: Quaternion) -> float:
    """Return the heading of an attitude [rad], from north toward east, 0 to 2 pi."""
    w, x, y, z = q_NB
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)) % (2.0 * math.pi)


def _local_message(context: VehicleContext) -> Message:
    time_us, position, velocity = _read_navigation(context)
    return wire.MAVLink_local_position_ned_message(time_us // 1000, *position, *velocity)


def _global_message(context: VehicleContext) -> Message:
    time_us, position, velocity = _read_navigation(context)
    course = round(100.0 * math.degrees(heading(context.loop.q_NB))) % 36_000
    above_home = round(1000.0 * (context.autopilot.home_N[2] - position[2]))
    speeds = map(to_centi, velocity)
    return wire.MAVLink_global_position_int_message(
        time_us // 1000, *to_geodetic(position), above_home, *speeds, course
    )


def _hud_message(context: VehicleContext) -> Message:
    _, position, velocity = _read_navigation(context)
    speed = math.hypot(velocity[0], velocity[1])
    course = round(math.degrees(heading(context.loop.q_NB))) % 360
    airspeed = math.dist(velocity, air_velocity_N(context.loop))
    throttle = round(100.0 * min(max(context.loop.thrust, 0.0), 1.0))
    return wire.MAVLink_vfr_hud_message(airspeed, speed, course, throttle, ORIGIN_HEIGHT - position[2], -velocity[2])


def _gps_message(context: VehicleContext) -> Message:
    time_us, position, velocity = _read_navigation(context)
    speed_cm = min(round(100.0 * math.hypot(velocity[0], velocity[1])), 65534)
    course = round(100.0 * math.degrees(math.atan2(velocity[1], velocity[0]))) % 36_000
    motion = (_UNKNOWN16, _UNKNOWN16, speed_cm, course, _UNKNOWN8)
    return wire.MAVLink_gps_raw_int_message(time_us, wire.GPS_FIX_TYPE_3D_FIX, *to_geodetic(position), *motion)


def _read_navigation(context: VehicleContext) -> tuple[int, Vector, Vector]:
    """Return the sample's time [us], and the position [m] and velocity [m/s] N at it."""
    loop = context.loop
    return loop.observe().time_us, loop.true_vector("position_N"), loop.true_vector("velocity_N")
