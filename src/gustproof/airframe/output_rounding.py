"""Torque slew that comes of rotor commands in whole steps, such as microseconds of a pulse.

A step of the rounded command differs from that of the command itself. Of a change of `n + f` steps, `n` whole and `f`
a fraction, it is `n` or `n + 1`, the latter with probability `f`: the variance is `f (1 - f)`.
"""

import math

import numpy as np

from firmware_model.config.vehicle import Rotors
from firmware_model.types import Vector

_TERMS = 4000  # of the Fourier series of f (1 - f), enough for changes of a thousandth of a step


def rounding_slew(axes_slew: Vector, rotors: Rotors, thrust_step: float, dt: float) -> float:
    """Return the rms torque slew [N*m/s] that rounding adds, pooled over the axes, to that of a law by squares.

    The torque's changes from sample to sample count as normal, independent, and spread over the steps.

    Parameters
    ----------
    axes_slew
        [N*m/s] rms torque slew of the law about each axis.
    rotors
        Rotors, each with a command of its own.
    thrust_step
        [N] thrust of one step; 0 for commands that are not rounded.
    dt
        [s] sample time.
    """
    if thrust_step == 0.0:
        return 0.0
    wrench = rotors.wrench[:3]
    shares = np.linalg.pinv(rotors.wrench)[:, :3]  # torques to thrusts
    change = dt / thrust_step * math.sqrt(float(np.mean(np.sum((shares * axes_slew) ** 2, axis=1))))
    k = math.pi * np.arange(1, _TERMS + 1)
    variance = 1.0 / 6.0 - float(np.sum(np.exp(-2.0 * (k * change) ** 2) / k**2))
    return thrust_step / dt * math.sqrt(max(variance, 0.0) * float(np.mean(np.sum(wrench**2, axis=1))))
