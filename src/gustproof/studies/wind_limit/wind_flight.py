"""Flights in mean wind and turbulence: the tilt that holds the place, and the scenario of a wind."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import root

from firmware_model.config.files import validate
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.numerics.rotations import from_euler, rotation_matrix, to_B, to_N
from firmware_model.physics.aerodynamics import AIR_DENSITY
from firmware_model.types import Vector
from gustproof.law.form import Law
from gustproof.studies.wind_limit.kept import MINUTE_S, Kept, needs_place
from gustproof.types import Array

SETTLE_S = 12.0
"""[s] before the judged minute: the mean wind grows, then the vehicle comes to rest."""
PLACE_SETTLE_S = 40.0
"""[s] the same around a position loop, whose integral finds the tilt within some 10 s."""
_RISE_S, _STEPS = 8, 8  # of the mean wind, and of the tilt with it
_MOST_TILT = math.radians(60.0)
_MOST_THRUST = 0.9  # [-] of all rotors, as of the on-board loop of height
_ROUGHNESS, _FOOT = 0.6096, 0.3048  # [m] MIL-F-8785C, 3.7.3.2: 2.0 ft
_AFTER_GUST_S, _BEFORE_GUST_S = 6.0, 1.0


def mean_wind(speed_20ft: float, altitude: float) -> float:
    """Return the mean wind [m/s] at an altitude [m] for that at 20 ft, MIL-F-8785C 3.7.3.2."""
    return speed_20ft * math.log(altitude / _ROUGHNESS) / math.log(20.0 * _FOOT / _ROUGHNESS)


def toward(from_deg: float) -> Vector:
    """Return the unit vector N along which a level wind from a bearing [deg] blows."""
    bearing = math.radians(from_deg)
    return -math.cos(bearing), -math.sin(bearing), 0.0


def find_tilt(vehicle: Vehicle, speed: float, from_deg: float) -> tuple[float, float] | None:
    """Return roll and pitch [rad] at which a vehicle that heads north stays in place in a level wind [m/s].

    Drag of rotors and body are those of the simulation, see `firmware_model.physics.aerodynamics`. It is `None` if that
    needs more than 60 deg, or nine tenths of the largest thrust.
    """
    north, east, _ = toward(from_deg)
    wind_N = (speed * north, speed * east, 0.0)
    weight = vehicle.mass * GRAVITY
    body = 0.5 * AIR_DENSITY * vehicle.drag_area

    def force_left(x: Array) -> Array:
        roll, pitch, thrust = x.tolist()
        R = rotation_matrix(from_euler(roll, pitch, 0.0))
        u, v, w = to_B(R, wind_N)
        rotors, size = math.sqrt(max(thrust, 0.0)), body * math.sqrt(u * u + v * v + w * w)
        plane, axis = vehicle.rotor_drag * rotors + size, vehicle.heave_drag * rotors + size
        north, east, down = to_N(R, (plane * u, plane * v, axis * w - thrust * weight))
        return np.array([north, east, down + weight]) / weight

    found = root(force_left, np.array([0.0, 0.0, 1.0]))
    roll, pitch, thrust = found.x.tolist()
    fits = found.success and math.cos(roll) * math.cos(pitch) > math.cos(_MOST_TILT) and abs(roll) < _MOST_TILT
    return (roll, pitch) if fits and thrust * weight <= _MOST_THRUST * vehicle.rotors.total_thrust else None


def tracks_references(law: Law) -> bool:
    """Return whether a law has attitude set-points, with which it can hold a place in wind."""
    return bool(np.any(law.B[:, 3:6]) or np.any(law.D[:, 3:6]))


def wind_scenario(
    base: Scenario, vehicle: Vehicle, kept: Sequence[Kept], *, mean: float, turbulence: float, from_deg: float
) -> Scenario | None:
    """Return a flight against a mean wind, in turbulence; `None` if no tilt holds the place.

    Both are wind speeds [m/s] at 20 ft. `base` gives height, rates and delay. The mean wind grows within `_RISE_S`, and
    the attitude's set-point with it; if a drift is judged, the position loop finds the tilt, and may fail to. The
    judged minute follows.
    """
    events, speed, tilts = (
        list[dict[str, Any]](),
        mean_wind(mean, base.altitude_m),
        mean > 0.0 and not needs_place(kept),
    )
    for step in range(1, _STEPS + 1) if tilts else ():
        tilt = find_tilt(vehicle, speed * step / _STEPS, from_deg)
        if tilt is None:
            return None
        roll, pitch = (round(math.degrees(angle), 4) for angle in tilt)
        events.append({"kind": "attitude", "at_s": _RISE_S * (step - 0.5) / _STEPS, "euler_deg": [roll, pitch, 0.0]})
    winds: list[dict[str, Any]] = []
    if turbulence > 0.0:
        winds.append({"kind": "dryden", "wind_speed_20ft_mps": turbulence})
    if mean > 0.0:
        winds.append({"kind": "ramp", "speed_mps": speed, "from_deg": from_deg, "rise_s": float(_RISE_S)})
    about = f"mean wind of {mean:.4g} m/s and turbulence of {turbulence:.4g} m/s at 20 ft, from {from_deg:g} deg"
    settle_s = PLACE_SETTLE_S if needs_place(kept) else SETTLE_S
    return _make(base, kept, about, settle_s, settle_s + MINUTE_S, winds, events)


def gust_scenario(
    base: Scenario, kept: Sequence[Kept], *, length_s: float, direction: tuple[float, float, float]
) -> Scenario:
    """Return a flight in calm air through one 1-cos gust of 1 m/s at its peak, in a direction (N, blowing toward)."""
    gust = {
        "kind": "one_minus_cosine",
        "amplitude_mps": list(direction),
        "frame": "ned",
        "length_s": length_s,
        "start_s": _BEFORE_GUST_S,
    }
    duration = math.ceil(_BEFORE_GUST_S + length_s + _AFTER_GUST_S)
    about = f"1-cos gust of {length_s:.3g} s"
    return _make(base, kept, about, 0.0, float(duration), [gust], [])


def _make(
    base: Scenario,
    kept: Sequence[Kept],
    about: str,
    from_s: float,
    duration_s: float,
    wind: list[dict[str, Any]],
    event: list[dict[str, Any]],
) -> Scenario:
    """Return `base` in free flight in other wind, with other events, and requirements that count from a time [s] on."""
    document = {
        "name": "wind-limit",
        "description": about,
        "duration_s": duration_s,
        "translation": "position_hold" if needs_place(kept) else "free",
        "altitude_m": base.altitude_m,
        "control_rate_hz": base.control_rate_hz,
        "physics_rate_hz": base.physics_rate_hz,
        "delay_samples": base.delay_samples,
        "wind": wind,
        "event": event,
        "require": [table for each in kept for table in each.tables(from_s, base.altitude_m)],
    }
    return validate(Scenario, document, "wind")
