import math

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.services import position
from firmware_model.types import LevelFlight

QUARTER = math.radians(45.0)


def told(craft, number: int):
    message = position.make_service(craft).streams[number].message()
    message.pack(wire.MAVLink(None, 1, 1))  # every number fits its field
    return message


def test_position_is_told_about_the_origin_ten_metres_up(craft):
    local = told(craft, wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
    assert (local.x, local.y, local.z) == (0.0, 0.0, -10.0)
    place = told(craft, wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert (place.lat, place.lon, place.alt, place.relative_alt) == (473_977_420, 85_455_940, 498_000, 10_000)
    assert told(craft, wire.MAVLINK_MSG_ID_VFR_HUD).alt == 498.0
    gps = told(craft, wire.MAVLINK_MSG_ID_GPS_RAW_INT)
    assert (gps.fix_type, gps.lat, gps.alt) == (3, 473_977_420, 498_000)
    assert (gps.eph, gps.epv, gps.satellites_visible) == (65535, 65535, 255)  # MAVLink's numbers for unknown


def test_home_is_where_the_vehicle_was_armed(craft, order, peer):
    craft.autopilot.home_N = (111.19492664455873, 0.0, 0.0)  # .001 deg of a sphere of 6371 km
    assert order(position.make_service(craft), wire.MAV_CMD_GET_HOME_POSITION)[0] == 0
    (home,) = peer.take()
    assert (home.latitude, home.longitude, home.altitude) == (473_987_420, 85_455_940, 488_000)
    assert home.x == pytest.approx(111.195, abs=1e-3)


@pytest.mark.parametrize(
    ("q_NB", "course"),
    [
        ((1.0, 0.0, 0.0, 0.0), 0.0),
        ((math.cos(QUARTER), 0.0, 0.0, math.sin(QUARTER)), math.pi / 2),  # east
        ((math.cos(QUARTER), 0.0, 0.0, -math.sin(QUARTER)), 1.5 * math.pi),  # west
    ],
)
def test_heading_runs_from_north_over_east(q_NB, course):
    assert position.heading(q_NB) == pytest.approx(course)


@pytest.mark.parametrize(
    ("velocity_N", "course"),
    [((1.0, 0.0, 0.0), 0), ((0.0, 2.0, 0.0), 9_000), ((-1.0, 0.0, 0.0), 18_000), ((0.0, -2.0, 0.0), 27_000)],
)
def test_course_over_ground_runs_from_north_over_east_in_hundredths_of_a_degree(craft, velocity_N, course, monkeypatch):
    places = {"position_N": (0.0, 0.0, -10.0), "velocity_N": velocity_N}
    monkeypatch.setattr(type(craft.loop), "true_vector", lambda _, name: places[name])
    gps = told(craft, wire.MAVLINK_MSG_ID_GPS_RAW_INT)
    assert (gps.cog, gps.vel) == (course, round(100.0 * math.hypot(*velocity_N)))


def test_hundred_metres_east_are_told_as_longitude_of_their_parallel(craft, monkeypatch):
    places = {"position_N": (0.0, 111.19492664455873, -10.0), "velocity_N": (0.5, -0.25, 2.0)}
    monkeypatch.setattr(type(craft.loop), "true_vector", lambda _, name: places[name])
    for _ in range(3):
        craft.loop.advance(LevelFlight(), 0)
    assert told(craft, wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED).time_boot_ms == 12
    place = told(craft, wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert place.time_boot_ms == 12
    assert told(craft, wire.MAVLINK_MSG_ID_GPS_RAW_INT).time_usec == 12_000
    shrunk = math.cos(math.radians(47.397742))
    assert (place.lat, place.lon) == (473_977_420, round(85_455_940 + 10_000 / shrunk))
    assert (place.vx, place.vy, place.vz) == (50, -25, 200)
