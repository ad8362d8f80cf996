"""Geodesy: positions in N, about a fixed origin, to latitude, longitude and height.

The earth is a sphere; the error is at most 0.3 % over the few hundred metres of a flight.
"""

import math

from firmware_model.types import Vector

ORIGIN_DEG = (47.397742, 8.545594)
"""[deg] Latitude and longitude of the origin: PX4's default home in simulation."""
ORIGIN_HEIGHT = 488.0
"""[m] Height of the origin above the sea."""
_EARTH_RATE = 7.2921e-5  # [rad/s] (IERS)
_METRES_PER_DEGREE = math.radians(1.0) * 6_371_000.0
_PARALLEL = math.cos(math.radians(ORIGIN_DEG[0]))


def to_geodetic(position_N: Vector) -> tuple[int, int, int]:
    """Return latitude and longitude [1e-7 deg] and height above the sea [mm] of a position [m] N."""
    latitude = ORIGIN_DEG[0] + position_N[0] / _METRES_PER_DEGREE
    longitude = ORIGIN_DEG[1] + position_N[1] / (_METRES_PER_DEGREE * _PARALLEL)
    return round(1e7 * latitude), round(1e7 * longitude), round(1000.0 * (ORIGIN_HEIGHT - position_N[2]))


def earth_rate(latitude: float) -> Vector:
    """Return the turn of the earth [rad/s] N at a latitude [rad]."""
    return _EARTH_RATE * math.cos(latitude), 0.0, -_EARTH_RATE * math.sin(latitude)


def to_centi(value: float) -> int:
    """Return a speed [m/s] in cm/s, clipped to 16 bits."""
    return clip_int16(100.0 * value)


def clip_int16(value: float) -> int:
    """Return the nearest integer, clipped to 16 bits."""
    return min(max(round(value), -32768), 32767)
