"""The air of a scenario as a Gaussian process, derived from the texts of a scenario file and a vehicle file.

Part of the check: standard library only. The low-altitude Dryden model is read per axis, as filters sampled with the
law. Their states have the stationary covariance P and follow `x+ = A x + n` with the covariance `P - A P A'` of n. A is
the exponential series to 2^-100; spectra and lengths are the specification's, rounded to doubles.

Gusts are those in B, so their moment does not depend on attitude. Each axis has its moment from one component, and
from another the angular gust that acts through the rate damping.

References
----------
MIL-F-8785C, Military Specification: Flying Qualities of Piloted Airplanes, 1980, section 3.7 (low-altitude model).
"""

import math
import tomllib
from fractions import Fraction
from typing import NamedTuple, cast

from gustproof.checker.evidence_types import VehicleDocument, WindTable
from gustproof.checker.rational import RationalMatrix, exponential
from gustproof.checker.system import LoopSystem, Refusal, Row, Rows, finite

_FOOT = 0.3048
_CEILING = 304.8
"""[m] end of the low-altitude model, 1000 ft."""
_KNOT = 0.514444
_INTENSITIES = {"light": 15.0 * _KNOT, "moderate": 30.0 * _KNOT, "severe": 45.0 * _KNOT}
"""[m/s] wind at 20 ft."""
_SPECIFICATIONS = ("MIL-F-8785C", "MIL-HDBK-1797")
"""Both describe the same gusts below 1000 ft."""
_MEANT = frozenset({"name", "description", "duration_s", "altitude_m", "control_rate_hz", "physics_rate_hz"}) | {
    *("delay_samples", "gust_scale", "wind", "require", "translation")
}
"""Keys of a scenario that the proof knows; with any other the flight is another one."""
_MEANT_OF_WIND = frozenset({"kind", "wind_speed_20ft_mps", "intensity", "airspeed_mps", "specification"})
_MOST_STEPS = 250_000
"""Samples of the longest flight, some ten seconds of work."""
_ROOT = Fraction(math.sqrt(3.0))
_UP = 1 + Fraction(1, 1 << 40)
"""[-] covers the rounding of the few functions that give an intensity."""


class AxisAir(NamedTuple):
    """Filters of one axis."""

    A: Rows
    """(k, k) [-] state to next state."""
    P: Rows
    """(k, k) [-] stationary covariance."""
    moment: Row
    """(k,) [N*m] state to moment, held over a sample."""
    turn: Row
    """(k,) [rad/s^2] state to the angular acceleration by the angular gust, held likewise."""


class DrydenAir(NamedTuple):
    """Turbulence and gyro noise of a flight on the stand."""

    axes: tuple[AxisAir, AxisAir, AxisAir]
    """Roll, pitch, yaw."""
    noise: Fraction
    """[rad/s] rms of a gyro sample's white noise."""
    duration: Fraction
    """[s] of the flight."""
    steps: int
    """Samples of the flight, rounded up."""
    wind: float
    """[m/s] at 20 ft."""
    airspeed: float
    """[m/s] at which the field passes."""
    altitude: float
    """[m] above ground."""
    gust_scale: float
    """[-] factor on all gusts."""


def read_air(scenario_text: str, vehicle_text: str, system: LoopSystem) -> DrydenAir:
    """Return the air of a scenario (TOML) past the vehicle (TOML) that the system is made of.

    Raises
    ------
    Refusal
        If the scenario has more than turbulence on a level stand, or another sample time or delay. Or if the gyro has
        a bias or noise that is not white.
    """
    scenario, vehicle = tomllib.loads(scenario_text), cast(VehicleDocument, tomllib.loads(vehicle_text))
    if others := sorted(set(scenario) - _MEANT):
        raise Refusal(f"the scenario has more than turbulence on a level stand: {', '.join(others)}")
    if scenario.get("translation", "held") != "held":
        raise Refusal("the scenario is a free flight, the proof is about a stand")
    rate = _number("control_rate_hz", scenario.get("control_rate_hz", 250))
    if scenario.get("delay_samples", 1) != 1 or Fraction(float(1 / rate)) != system.dt:
        raise Refusal("the scenario has another delay than a sample, or another sample time than the law")
    duration = _number("duration_s", scenario["duration_s"])
    steps = math.ceil(duration / system.dt)
    if not steps <= _MOST_STEPS:
        raise Refusal(f"the flight has {steps} samples, the proof takes {_MOST_STEPS} at most")
    wind = _read_wind(scenario.get("wind", []))
    scale = float(_number("gust_scale", scenario.get("gust_scale", 1.0), least=0.0))
    strength, altitude = _speed(wind), float(_number("altitude_m", scenario.get("altitude_m", 10.0), most=_CEILING))
    airspeed = float(_number("airspeed_mps", wind.get("airspeed_mps", max(strength, 1.0)), least=1.0))
    filters = _filters(strength, airspeed, altitude, float(_number("span", vehicle["span"])))
    axes = tuple(_read_axis(filters, vehicle, scale, system, axis) for axis in range(3))
    return DrydenAir(
        axes=(axes[0], axes[1], axes[2]),
        noise=_read_noise(vehicle, float(rate)),
        duration=duration,
        steps=steps,
        wind=strength,
        airspeed=airspeed,
        altitude=altitude,
        gust_scale=scale,
    )


def _read_wind(winds: list[WindTable]) -> WindTable:
    if len(winds) != 1 or winds[0]["kind"] != "dryden":
        raise Refusal("the scenario has no turbulence, or other winds, and the proof is about one 'dryden' alone")
    wind = winds[0]
    if set(wind) - _MEANT_OF_WIND or wind.get("specification", _SPECIFICATIONS[0]) not in _SPECIFICATIONS:
        raise Refusal("the turbulence has keys or a specification that the proof does not know")
    if ("intensity" in wind) == ("wind_speed_20ft_mps" in wind):
        raise Refusal("the turbulence needs either a speed or an intensity")
    return wind


def _speed(wind: WindTable) -> float:
    named = _INTENSITIES[wind["intensity"]] if "intensity" in wind else wind["wind_speed_20ft_mps"]
    return float(_number("wind_speed_20ft_mps", named))


class _Filter(NamedTuple):
    """Filter of a gust component in one unit, stationary: `x' = F x + n`."""

    F: Rows
    """(k, k) [1/s]."""
    P: Rows
    """(k, k) [-] stationary covariance."""
    gust: Row
    """(k,) [m/s] state to gust, or nothing."""
    turn: Row
    """(k,) [rad/s] state to angular gust, or nothing."""


def _filters(strength: float, V: float, altitude: float, span: float) -> dict[str, _Filter]:
    """Return the filters of the six components by name, MIL-F-8785C (3.7.1.2, 3.7.3.4)."""
    height = max(altitude / _FOOT, 10.0)
    shear = 0.177 + 0.000823 * height
    sigma_w = 0.1 * strength
    sigma_u, L_u, L_w = sigma_w / shear**0.4, height / shear**1.2 * _FOOT, height * _FOOT
    square_p = sigma_w**2 / L_w * 0.8 * (math.pi * L_w / (4.0 * span)) ** (1.0 / 3.0) * math.pi**2 / (8.0 * span)
    return {
        "u": _first_order(L_u / V, sigma_u),
        "p": _first_order(4.0 * span / (math.pi * V), math.sqrt(square_p)),
        "v": _transverse(sigma_u, L_u / V),
        "w": _transverse(sigma_w, L_w / V),
        "r": _turning(sigma_u, L_u / V, 3.0 * span / (math.pi * V), math.pi / (3.0 * span)),
        "q": _turning(sigma_w, L_w / V, 4.0 * span / (math.pi * V), -math.pi / (4.0 * span)),
    }


def _first_order(tau: float, sigma: float) -> _Filter:
    size = (Fraction(sigma) * _UP,)
    return _Filter(((-1 / Fraction(tau),),), ((Fraction(1),),), size, size)


def _transverse(sigma: float, tau: float) -> _Filter:
    """Return the filter of v or w: `sigma sqrt(tau) (1 + sqrt(3) tau s) / (1 + tau s)^2`, in two lags of one chain."""
    pole, half, quarter = 1 / Fraction(tau), Fraction(1, 2), Fraction(1, 4)
    size = Fraction(sigma) * _UP
    return _Filter(
        ((-pole, Fraction(0)), (pole, -pole)),
        ((half, quarter), (quarter, quarter)),
        (size * _ROOT, size * (1 - _ROOT)),
        (),
    )


def _turning(sigma: float, tau: float, lag: float, slope: float) -> _Filter:
    """Return the filter of q or r: `slope` times the gust less its low pass by `lag`, a third state.

    The covariance solves the Lyapunov equation, row by row.
    """
    two = _transverse(1.0, tau)
    pole, fast = 1 / Fraction(tau), 1 / Fraction(lag)
    c, P = (_ROOT, 1 - _ROOT), two.P
    first = fast * (c[0] * P[0][0] + c[1] * P[0][1]) / (pole + fast)
    second = (pole * first + fast * (c[0] * P[1][0] + c[1] * P[1][1])) / (pole + fast)
    third = c[0] * first + c[1] * second
    none, size = Fraction(0), Fraction(slope * sigma) * _UP
    F = ((*two.F[0], none), (*two.F[1], none), (fast * c[0], fast * c[1], -fast))
    covariance = ((*P[0], first), (*P[1], second), (first, second, third))
    return _Filter(F, covariance, (), (size * c[0], size * c[1], -size))


def _read_axis(
    filters: dict[str, _Filter], vehicle: VehicleDocument, scale: float, system: LoopSystem, axis: int
) -> AxisAir:
    """Return the air of an axis: v and p roll the vehicle, u and q pitch it, w and r yaw it."""
    gust, angular = filters["vuw"[axis]], filters["pqr"[axis]]
    gain = Fraction(scale) * _number("gust_gain", vehicle["gust_gain"], least=0.0)
    gain *= (1, -1, _number("gust_yaw_ratio", vehicle["gust_yaw_ratio"], least=0.0))[axis]
    zero = (Fraction(0),)
    first, second = len(gust.F), len(angular.F)
    return AxisAir(
        A=_blocks(_exponential(gust.F, system.dt), _exponential(angular.F, system.dt)),
        P=_blocks(gust.P, angular.P),
        moment=tuple(gain * value for value in gust.gust) + second * zero,
        turn=first * zero + tuple(system.damping[axis] * Fraction(scale) * value for value in angular.turn),
    )


def _blocks(first: Rows | RationalMatrix, second: Rows | RationalMatrix) -> Rows:
    zero = (Fraction(0),)
    return (*((*row, *len(second) * zero) for row in first), *((*len(first) * zero, *row) for row in second))


def _exponential(F: Rows, dt: Fraction) -> RationalMatrix:
    """Return `exp(F dt)` within 2^-100."""
    if max(abs(value) for row in F for value in row) * dt * len(F) > 4:
        raise Refusal("a sample is too long for the air's time constants")
    return exponential([list(row) for row in F], dt, terms=80, bits=160)


def _read_noise(vehicle: VehicleDocument, rate: float) -> Fraction:
    """Return the rms of a gyro sample; the vehicle file states it at 250 Hz."""
    gyro = vehicle["gyro"]
    if gyro.get("noise_model", "constant") != "constant":
        raise Refusal("the gyro's noise is not constant")
    if any(_number("gyro.bias_B", value, least=-math.inf) for value in gyro.get("bias_B", ())):
        raise Refusal("the gyro has a bias")
    ratio = 10.0 ** (-float(_number("gyro.snr_db", gyro["snr_db"], least=-math.inf)) / 20.0)
    sigma = ratio * float(_number("gyro.reference_rate", gyro["reference_rate"])) * math.sqrt(rate / 250.0)
    return Fraction(sigma) * _UP


def _number(name: str, value: object, *, least: float | None = None, most: float = math.inf) -> Fraction:
    """Return a number of a file, nominal; without `least` it must be positive."""
    number = finite(name, value["nominal"] if isinstance(value, dict) else value)
    if not (number > 0 if least is None else number >= least) or number > most:
        raise Refusal(f"{name} is {float(number)}, out of its range")
    return number
