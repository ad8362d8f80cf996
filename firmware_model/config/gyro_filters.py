"""Filters of PX4's and ArduPilot's gyro as coefficients: those that their loops see it behind, and most of their logs.

A notch that moves is taken at one frequency, the median of a log. It is told as NAME_FLOWN [Hz] beside the parameters
NAME_... of the notch. NAME_ROTORS is how many rotors have one each.

A filter of the second order is `y = b0 x + b1 x1 + b2 x2 - a1 y1 - a2 y2`, where 1 and 2 count samples back.

References
----------
ArduPilot, libraries Filter and AP_InertialSensor, Copter 4.7-dev of July 2025. PX4, module
sensors/vehicle_angular_velocity, main of February 2025.
"""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

LEAST_SHARE = 1e-3
"""[-] least frequency and bandwidth of a filter, as a share of the rate, so that its coefficients keep their digits."""
ARDUPILOT_NOTCHES = ("INS_HNTCH", "INS_HNTC2")
"""Beginnings of the names of ArduPilot's harmonic notches."""
ARDUPILOT_NOTCH = {"FREQ": 80.0, "BW": 40.0, "ATT": 40.0, "HMNCS": 3.0, "OPTS": 0.0}
"""Values [Hz, dB or bits] of a notch that is switched on and has no others."""
LOW_PASS_END = 0.4
"""[-] share of the sample rate to which ArduPilot cuts the corner of its low-pass."""
PX4_BY_ROTORS, MOST_ROTORS = 1, 8
"""Bit of IMU_GYRO_DNF_EN for notches that follow the speed of rotors; most rotors that have one."""
_MOST_HARMONICS = 10
_PX4_NOTCHES = ("IMU_GYRO_NF0", "IMU_GYRO_NF1")
_DOUBLE, _TRIPLE, _HARMONICS = 1, 16, 16  # bits of OPTS, number of bits of HMNCS
_NOTCH_END = 0.48  # share of the sample rate above which a notch is off


class Biquad(NamedTuple):
    """Coefficients of a filter of the second order."""

    b0: float
    """Of the new sample."""
    b1: float
    """Of the sample before."""
    b2: float
    """Of the one before that."""
    a1: float
    """Of the output before."""
    a2: float
    """Of the one before that."""


def gyro_filters(kind: str, parameters: Mapping[str, float], rate: float) -> list[Biquad]:
    """Return the filters of the gyro by the parameters of `px4` or `ardupilot`, at `rate` [Hz].

    One that is not among the parameters is off. A notch that moves is taken at the median of a log, if that is told.
    Else ArduPilot's is taken at its parameter, and PX4's is off.
    """
    filters = {"px4": _px4_filters, "ardupilot": _ardupilot_filters}
    return list(filters[kind](parameters, rate)) if kind in filters else []


def _px4_filters(parameters: Mapping[str, float], rate: float) -> Iterator[Biquad]:
    for name in _PX4_NOTCHES:
        frequency, bandwidth = parameters.get(f"{name}_FRQ", 0.0), parameters.get(f"{name}_BW", 20.0)
        if 0.0 < frequency < 0.5 * rate and bandwidth > 0.0:
            place, width = max(frequency, LEAST_SHARE * rate), max(bandwidth / rate, LEAST_SHARE)
            yield notch(place, math.tan(math.pi * width), 0.0, rate)
    for frequency, width in _px4_moving(parameters):
        if frequency < 0.5 * rate:
            yield notch(frequency, math.tan(math.pi * max(width / rate, LEAST_SHARE)), 0.0, rate)
    if 0.0 < (cutoff := parameters.get("IMU_GYRO_CUTOFF", 0.0)) < 0.5 * rate:
        yield butterworth(cutoff, rate)


def _px4_moving(parameters: Mapping[str, float]) -> Iterator[tuple[float, float]]:
    """Yield frequency and bandwidth [Hz] of the notches at the rotors' speed and its harmonics, if a log tells it."""
    flown, width, harmonics, low = (
        parameters.get(f"IMU_GYRO_DNF_{key}", usual)
        for key, usual in (("FLOWN", 0.0), ("BW", 15.0), ("HMC", 3.0), ("MIN", 25.0))
    )
    if flown > 0.0 and int(parameters.get("IMU_GYRO_DNF_EN", 0.0)) & PX4_BY_ROTORS:
        for k in range(min(max(int(harmonics), 1), _MOST_HARMONICS)):
            place = max((k + 1) * flown, max(low, width) + 0.5 * k * width)
            yield from [(place, width)] * min(int(parameters.get("IMU_GYRO_DNF_ROTORS", 1.0)), MOST_ROTORS)


def _ardupilot_filters(parameters: Mapping[str, float], rate: float) -> Iterator[Biquad]:
    for name in ARDUPILOT_NOTCHES:
        if parameters.get(f"{name}_ENABLE", 0.0):
            values = {key: parameters.get(f"{name}_{key}", value) for key, value in ARDUPILOT_NOTCH.items()}
            moved, rotors = (parameters.get(f"{name}_{key}", 0.0) for key in ("FLOWN", "ROTORS"))
            if moved > 0.0 and parameters.get(f"{name}_MODE", 0.0):
                least = values["FREQ"] * parameters.get(f"{name}_FM_RAT", 1.0)
                yield from _harmonics(values, rate, max(moved, least), min(max(int(rotors), 1), MOST_ROTORS))
            else:
                yield from _harmonics(values, rate)
    if (cutoff := parameters.get("INS_GYRO_FILTER", 0.0)) > 0.0:
        yield butterworth(min(cutoff, LOW_PASS_END * rate), rate)


def _harmonics(
    values: Mapping[str, float], rate: float, moved: float | None = None, rotors: int = 1
) -> Iterator[Biquad]:
    """Yield the filters of a harmonic notch, `moved` to some [Hz]; several beside each other share its bandwidth.

    With the frequency its bandwidth grows, and each of the `rotors` has one.
    """
    bandwidth, options = values["BW"], int(values["OPTS"])
    spread = (-1.0, 1.0) if options & _DOUBLE else (0.0, -1.0, 1.0) if options & _TRIPLE else (0.0,)
    center = min(max(values["FREQ"], 0.52 * bandwidth), _NOTCH_END * rate)
    share = 0.5 * bandwidth / len(spread)
    if not LEAST_SHARE * center < share < center:
        return
    ratio = (center / (center - share)) ** 2  # of the ends of the bandwidth
    quality, depth = math.sqrt(ratio) / (ratio - 1.0), 10.0 ** (-values["ATT"] / 20.0)
    wanted = [k * (moved or center) for k in range(1, _HARMONICS + 1) if int(values["HMNCS"]) >> (k - 1) & 1]
    for each in (frequency for frequency in wanted if frequency < _NOTCH_END * rate):
        for side in spread * rotors:
            place = each * (1.0 + side * bandwidth / (32.0 * center))
            yield notch(place, math.sin(2.0 * math.pi * place / rate) / (2.0 * quality), depth, rate)


def butterworth(cutoff: float, rate: float) -> Biquad:
    """Return the low-pass with a corner at `cutoff` [Hz], but a thousandth of `rate` [Hz] at least; exact there.

    References
    ----------
    A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, section 7.1: bilinear transform, Butterworth.
    """
    t = math.tan(math.pi * max(cutoff / rate, LEAST_SHARE))
    c = 1.0 + math.sqrt(2.0) * t + t * t
    b = t * t / c
    return Biquad(b, 2.0 * b, b, 2.0 * (t * t - 1.0) / c, (1.0 - math.sqrt(2.0) * t + t * t) / c)


def notch(frequency: float, alpha: float, depth: float, rate: float) -> Biquad:
    """Return the notch at `frequency` [Hz], at `rate` [Hz].

    `alpha` [-] is the tangent of half its bandwidth's angle, `depth` [-] its gain at the frequency.

    References
    ----------
    R. Bristow-Johnson, Cookbook formulae for audio equalizer biquad filter coefficients: peaking and notch filters.
    """
    cosine = math.cos(2.0 * math.pi * frequency / rate)
    a0, b1 = 1.0 + alpha, -2.0 * cosine
    return Biquad((1.0 + alpha * depth) / a0, b1 / a0, (1.0 - alpha * depth) / a0, b1 / a0, (1.0 - alpha) / a0)
