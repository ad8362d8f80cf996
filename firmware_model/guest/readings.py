"""Readings of all sensors at a sample, with noise: what a guest autopilot gets of the simulated world."""

import math
from typing import NamedTuple

from firmware_model.mavlink.services.geodesy import ORIGIN_DEG, ORIGIN_HEIGHT
from firmware_model.numerics.compiled import compiled
from firmware_model.numerics.elementary import normals
from firmware_model.numerics.random import NAVIGATION_STREAM
from firmware_model.numerics.rotations import conjugate, rotate
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import Quaternion, Vector

FIELD_N = (0.21744, 0.01294, 0.43045)
"""[gauss] N, magnetic field at the origin of the geodesy, by the World Magnetic Model 2020 in mid 2024.

Autopilots correct the compass by a table of that model: 3.41 deg east, 63.2 deg down, .4824 gauss.
"""
DECLINATION = math.atan2(FIELD_N[1], FIELD_N[0])
"""[rad] from true to magnetic north."""
_LATITUDE = math.radians(ORIGIN_DEG[0])
EARTH_RATE_N = (7.2921e-5 * math.cos(_LATITUDE), 0.0, -7.2921e-5 * math.sin(_LATITUDE))
"""[rad/s] N, turn of the earth at the origin (IERS): a gyro measures it, and estimators subtract it."""
_FIELD_NOISE = 0.0002  # [gauss] rms of a sample, as of a common magnetometer at rest
_PRESSURE_NOISE = 0.02  # [hPa] rms of a sample, .17 m of height
_POSITION_NOISE = (0.2, 0.2, 0.3)  # [m] rms of a fix
_VELOCITY_NOISE = (0.05, 0.05, 0.08)  # [m/s] rms of a fix


class Readings(NamedTuple):
    """Everything that sensors tell at a sample, and the truth beside it; noise on every measured value."""

    time_us: int
    """[us] clock of the world, from its first sample on."""
    gyro_B: Vector
    """[rad/s] B, measured."""
    specific_force_B: Vector
    """[m/s^2] B, measured."""
    field_B: Vector
    """[gauss] B, measured magnetic field."""
    pressure: float
    """[hPa] measured static pressure, standard atmosphere."""
    temperature: float
    """[degC] of the standard atmosphere."""
    gps_position_N: Vector
    """[m] N, measured about the origin."""
    gps_velocity_N: Vector
    """[m/s] N, measured."""
    position_N: Vector
    """[m] N, true."""
    velocity_N: Vector
    """[m/s] N, true."""
    q_NB: Quaternion
    """True attitude, B to N, scalar first."""
    omega_B: Vector
    """[rad/s] B, true."""
    wind_N: Vector
    """[m/s] true mean wind, blowing toward."""


def read_sensors(loop: VehicleLoop, seed: int, time_us: int) -> Readings:
    """Return the readings at a loop's sample; `time_us` [us] is the world's clock."""
    imu = loop.observe()
    position, velocity = loop.true_vector("position_N"), loop.true_vector("velocity_N")
    q_NB = loop.q_NB
    a, b, c, pressure_noise = _normals(seed, NAVIGATION_STREAM, loop.sample, 0)
    fix, speed = (_normals(seed, NAVIGATION_STREAM, loop.sample, block) for block in (1, 2))
    to_B = conjugate(q_NB)
    field, earth_B = rotate(to_B, FIELD_N), rotate(to_B, EARTH_RATE_N)
    pressure, temperature = atmosphere(ORIGIN_HEIGHT - position[2])
    return Readings(
        time_us=time_us,
        gyro_B=_add_noise(imu.gyro_B, earth_B, (1.0,) * 3),
        specific_force_B=imu.specific_force_B,
        field_B=_add_noise(field, (_FIELD_NOISE,) * 3, (a, b, c)),
        pressure=pressure + _PRESSURE_NOISE * pressure_noise,
        temperature=temperature,
        gps_position_N=_add_noise(position, _POSITION_NOISE, fix[:3]),
        gps_velocity_N=_add_noise(velocity, _VELOCITY_NOISE, speed[:3]),
        position_N=position,
        velocity_N=velocity,
        q_NB=q_NB,
        omega_B=loop.true_vector("omega_B"),
        wind_N=loop.true_vector("wind_N"),
    )


def atmosphere(height: float) -> tuple[float, float]:
    """Return pressure [hPa] and temperature [degC] at a height [m] above the sea, ISO 2533, below 11 km."""
    ratio = 1.0 - 0.0065 / 288.15 * height
    return 1013.25 * ratio**5.25588, 15.0 - 0.0065 * height


def _add_noise(value: Vector, sigma: Vector, normal: tuple[float, ...]) -> Vector:
    a, b, c = (v + s * n for v, s, n in zip(value, sigma, normal, strict=True))
    return a, b, c


@compiled
def _normals(seed: int, stream: int, sample: int, block: int) -> tuple[float, float, float, float]:
    return normals(seed, stream, sample, block)
