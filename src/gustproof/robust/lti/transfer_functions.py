"""State spaces of transfer functions, in units in which python-control loses none of them.

Its conversions drop what is small next to 1. Of the four lags `1e-16 / (s + 1e-4)^4` nothing would be left.
"""

import math
import warnings
from typing import Any

import numpy as np

from gustproof.types import Array

_PLACES, _DIRECTION = 9, np.exp(0.9j)
"""Places at which responses are compared, and their direction: right of the axis, where a loop has no poles."""
_ALIKE, _NEGLIGIBLE = 1e-4, 1e-9
"""[-] parts of an entry, and of the largest entry, by which responses may differ."""


def give_states(system: Any) -> Any:
    """Return a `control.StateSpace` of a `control.TransferFunction`, with its responses.

    Raises
    ------
    ValueError
        If it is improper, has several channels and no slycot is installed, or no unit of time keeps its response.
    """
    from control import TransferFunction, tf2ss  # takes seconds: imported on use only
    from scipy.signal import BadCoefficients

    if not isinstance(system, TransferFunction):
        raise ValueError(f"{type(system).__name__} is no linear system: take one of python-control")
    if not all(np.isfinite(part).all() for name in ("num", "den") for row in _parts(system, name) for part in row):
        raise ValueError("the transfer function has a coefficient that is no finite number")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BadCoefficients)  # what it drops is looked at here
            plain = tf2ss(system)
            if _responds_alike(plain, system):
                return plain
            speed, size = _units(system)
            scaled = tf2ss(_in_units(system, speed, size))
    except (ValueError, NotImplementedError) as error:
        raise ValueError(f"the transfer function has no state space: {error}") from None
    found = type(scaled)(speed * scaled.A, speed * scaled.B, size * scaled.C, size * scaled.D, system.dt)
    if not _responds_alike(found, system):
        raise ValueError("the transfer function has no state space with its response: give a state space")
    return found


def _parts(system: Any, name: str) -> list[list[Array]]:
    """Return numerators or denominators without leading zeros."""
    return [[np.trim_zeros(np.asarray(part, dtype=np.float64), "f") for part in row] for row in getattr(system, name)]


def _units(system: Any) -> tuple[float, float]:
    """Return powers of two: the mean speed of a transfer function's poles, 1 if it is discrete, and its size there."""
    bits = []
    for den in (den for row in _parts(system, "den") for den in row):
        order = int(np.flatnonzero(den)[-1])
        if order and not system.dt:
            bits.append(math.log2(abs(den[order] / den[0])) / order)
    speed = 2.0 ** round(float(np.mean(bits)) if bits else 0.0)
    scaled = _parts(_in_units(system, speed, 1.0), "num")
    largest = max((float(np.max(np.abs(num), initial=0.0)) for row in scaled for num in row), default=0.0)
    return speed, 2.0 ** round(math.log2(largest)) if largest else 1.0


def _in_units(system: Any, speed: float, size: float) -> Any:
    """Return a transfer function over `size`, of `s / speed`; its denominators begin with 1."""
    nums, dens = _parts(system, "num"), _parts(system, "den")
    for num_row, den_row in zip(nums, dens, strict=True):
        for j, (num, den) in enumerate(zip(num_row, den_row, strict=True)):
            powers = np.arange(0.0, -len(den), -1.0)
            den_row[j] = den / den[0] * speed**powers
            num_row[j] = num / (den[0] * size) * speed ** powers[len(den) - len(num) :] if num.size else np.zeros(1)
    return type(system)(nums, dens, system.dt)


def _responds_alike(found: Any, system: Any) -> bool:
    """Return whether a state space has the responses of a transfer function."""
    roots = [np.roots(den) for row in _parts(system, "den") for den in row]
    speeds = np.abs(np.concatenate([np.ones(1), *roots]))
    speeds = speeds[speeds > 0.0]
    places = np.geomspace(0.1 * speeds.min(), 10.0 * speeds.max(), _PLACES) * _DIRECTION
    if system.dt:
        places = 1.0 + np.geomspace(0.01, 10.0, _PLACES) * _DIRECTION
    right, has = (np.asarray(each(places, squeeze=False)) for each in (system, found))
    allowed = _ALIKE * np.abs(right) + _NEGLIGIBLE * np.max(np.abs(right), axis=(0, 1), initial=0.0)
    return bool(np.all(np.abs(has - right) <= allowed))
