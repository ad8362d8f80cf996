"""The flown part of a log, and where notches that move were in it."""

from dataclasses import replace

import numpy as np

from firmware_model.errors import ConfigError
from gustproof.logs.read.flight_log import FlightLog

_MOSTLY = 0.5  # of the samples that must tell a frequency
_TOLD = "a notch that moved: "


def crop(log: FlightLog, begin: float | None, end: float | None) -> FlightLog:
    """Return the log with what is between `begin` and `end` [s] in the air, the ends of the log by default.

    Raises
    ------
    ConfigError
        If they are not in order, or outside the log.
    """
    if begin is None and end is None:
        return log
    first, last = (float(log.gyro.time[i]) for i in (0, -1))
    begin, end = first if begin is None else begin, last if end is None else end
    if not first <= begin < end <= last:
        raise ConfigError(
            f"--from {begin:g} --to {end:g}: must be in order and within the log, {first:g} .. {last:g} s"
        )
    told = tuple(line for line in log.findings if not line.startswith(("airborne: ", _TOLD)))
    return place_notches(replace(log, airborne=((begin, end),), findings=told))


def place_notches(log: FlightLog) -> FlightLog:
    """Return the log with the median of each of its notches in the air among the parameters, and a line on it.

    NAME_FLOWN [Hz] is the median, NAME_ROTORS the number of rotors that have one each.
    """
    flown, lines = dict[str, float](), list[str]()
    for name, signal in log.notches.items():
        values = log.in_air(signal)
        known = values[values > 0.0]
        if known.size > _MOSTLY * values.size:
            low, middle, high = np.quantile(known, [0.05, 0.5, 0.95]).tolist()
            flown |= {f"{name}_FLOWN": middle, f"{name}_ROTORS": float(values.shape[1])}
            lines.append(f"{_TOLD}{name} at {middle:.0f} Hz, from {low:.0f} to {high:.0f}: it is taken at its median")
    return replace(log, parameters={**log.parameters, **flown}, findings=(*log.findings, *lines))
