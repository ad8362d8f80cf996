"""Readings of all sensors at a sample, with noise: what an external autopilot gets of the simulated world."""

import math
from typing import Any, NamedTuple

import numpy as np

from firmware_model.mavlink.services.geodesy import ORIGIN_DEG, ORIGIN_HEIGHT, earth_rate
from firmware_model.numerics.compiled import compiled, kernel
from firmware_model.numerics.elementary import normals
from firmware_model.numerics.random import NAVIGATION_STREAM
from firmware_model.numerics.rotations import conjugate, rotate
from firmware_model.numerics.soa import get, get_vector, put, put_vector, single
from firmware_model.recording.journal import FORCE_B, GYRO_B, OMEGA, POSITION, Q_NB, VELOCITY, WIND
from firmware_model.sim.vehicle_loop import Array, VehicleLoop
from firmware_model.types import Quaternion, Vector

FIELD_N = (0.21744, 0.01294, 0.43045)
"""[gauss] N, magnetic field at the origin of the geodesy, by the World Magnetic Model 2020 in mid 2024.

Autopilots correct the compass by a table of that model: 3.41 deg east, 63.2 deg down, .4824 gauss.
"""
_NUMBERS = 33  # in `Readings` after its time
EARTH_RATE_N = earth_rate(math.radians(ORIGIN_DEG[0]))
"""[rad/s] N, turn of the earth at the origin: a gyro measures it, and estimators subtract it."""
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
    has_fix: bool = True
    """False while the satellite receiver has no fix."""


def read_sensors(loop: VehicleLoop, seed: int, time_us: int) -> Readings:
    """Return the readings at a loop's sample; `time_us` [us] is the world's clock."""
    numbers = np.empty(_NUMBERS)
    _measure(loop.record(), seed, loop.sample, numbers)
    n: Any = tuple(numbers.tolist())
    return Readings(
        time_us, n[:3], n[3:6], n[6:9], n[9], n[10], n[11:14], n[14:17], n[17:20], n[20:23], n[23:27], n[27:30], n[30:]
    )


@kernel
def atmosphere(height: float) -> tuple[float, float]:
    """Return pressure [hPa] and temperature [degC] at a height [m] above the sea, ISO 2533, below 11 km."""
    ratio = 1.0 - 0.0065 / 288.15 * height
    return 1013.25 * ratio**5.25588, 15.0 - 0.0065 * height


@kernel
def _add_noise(value: Vector, sigma: Vector, normal: Vector) -> Vector:
    return value[0] + sigma[0] * normal[0], value[1] + sigma[1] * normal[1], value[2] + sigma[2] * normal[2]


@compiled
def _measure(record: Array, seed: int, sample: int, numbers: Array) -> None:
    """Write the numbers of `Readings` after its time to `told`, from the journal's `record` of the sample.

    Rates get the turn of the earth; field, pressure and fix get noise. Arrays pass to compiled code in half the time of
    tuples.
    """
    one, out = single(record), single(numbers)
    a, b, c, d = normals(seed, NAVIGATION_STREAM, sample, 0)
    e, f, g, _ = normals(seed, NAVIGATION_STREAM, sample, 1)
    h, i, j, _ = normals(seed, NAVIGATION_STREAM, sample, 2)
    position, velocity = get_vector(one, POSITION), get_vector(one, VELOCITY)
    q_NB = (get(one, Q_NB), get(one, Q_NB + 1), get(one, Q_NB + 2), get(one, Q_NB + 3))
    to_B = conjugate(q_NB)
    pressure, temperature = atmosphere(ORIGIN_HEIGHT - position[2])
    put_vector(out, 0, _add_noise(get_vector(one, GYRO_B), (1.0, 1.0, 1.0), rotate(to_B, EARTH_RATE_N)))
    put_vector(out, 3, get_vector(one, FORCE_B))
    put_vector(out, 6, _add_noise(rotate(to_B, FIELD_N), (_FIELD_NOISE, _FIELD_NOISE, _FIELD_NOISE), (a, b, c)))
    put(out, 9, pressure + _PRESSURE_NOISE * d)
    put(out, 10, temperature)
    put_vector(out, 11, _add_noise(position, _POSITION_NOISE, (e, f, g)))
    put_vector(out, 14, _add_noise(velocity, _VELOCITY_NOISE, (h, i, j)))
    put_vector(out, 17, position)
    put_vector(out, 20, velocity)
    for index in range(4):
        put(out, 23 + index, q_NB[index])
    put_vector(out, 27, get_vector(one, OMEGA))
    put_vector(out, 30, get_vector(one, WIND))
