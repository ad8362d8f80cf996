"""Margins of an uncertain system: how much of its uncertainty it stands, for stability and for a level of gain."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.mu.robust_bounds import RobustBounds
from gustproof.robust.mu.singular_value import mu
from gustproof.robust.mu.sweep import Bracket
from gustproof.robust.mu.worst_gain import wcgain
from gustproof.robust.uncertain.interpolation import interpolate_blocks
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain

_TRIALS = 24
"""Most sizes of the uncertainty tried."""
_CLOSE = 1e-6
"""[-] relative width at which the search along one direction stops."""
_LARGEST = 1e6
"""[-] size of the uncertainty beyond which it does not matter."""


def robstab(system: Uncertain, *, accuracy: float = 0.005, boxes: int = 16) -> RobustBounds:
    """Return bounds on the robust stability margin, and values that destabilise (MATLAB: `robstab`).

    The system is stable for all deviations from nominal of the lower bound times those of the ranges. The worst values
    deviate by the upper bound: with them a pole is on the boundary, at `omega`. A margin above 1 covers the ranges.
    Where a nominal value is not the middle of its range, its deviation is counted as in `RealBlock`, by the rational
    form of MATLAB. Inputs and outputs do not matter. Parameters are constant in time.

    Parameters
    ----------
    system
        Stable at its nominal values.
    accuracy
        [-] relative distance of the bound from the least one of D-G scalings.
    boxes
        Most boxes of the real parameters at each level tried where scalings leave more; 1 for scalings alone.

    Raises
    ------
    ValueError
        If the system is not stable at its nominal values, or nothing is uncertain.

    References
    ----------
    A. Packard, J. C. Doyle, The complex structured singular value, Automatica 29 (1993), 71-109.

    Examples
    --------
    >>> from control import tf
    >>> from gustproof.robust import feedback, robstab, ureal
    >>> gain = ureal("gain", 4.0, percent=25)
    >>> robstab(feedback(gain * tf(1, [1, 3, 3, 1])))
    Robust stability margin: 4 to 4 at 1.732 rad/s
    gain: 8 of [3, 5]
    """
    system = as_uncertain(system)
    alone = Uncertain(M=system.M.subsystem(slice(0, system.n_z), slice(0, system.n_w)), blocks=system.blocks)
    found = mu(alone, accuracy=accuracy, boxes=boxes)
    return RobustBounds(
        lower=1.0 / found.upper if found.upper > 0.0 else math.inf,
        upper=1.0 / found.lower if found.lower > 0.0 else math.inf,
        omega=found.omega,
        delta=found.delta,
        system=system,
        measure="Robust stability margin",
    )


def robgain(system: Uncertain, gamma: float, *, accuracy: float = 0.02, boxes: int = 1) -> RobustBounds:
    """Return bounds on the margin up to which the H-infinity norm stays below `gamma` (MATLAB: `robgain`).

    For all deviations of the lower bound times those of the ranges the system is stable and its norm below `gamma`. The
    worst values deviate by the upper bound at most: their norm is `gamma` or more, or they destabilise. Sizes are tried
    in turn, each with the bounds of `wcgain` and its `boxes`.

    Raises
    ------
    ValueError
        If the system is not stable at its nominal values, or has no blocks, inputs or outputs.

    Examples
    --------
    >>> from control import tf
    >>> from gustproof.robust import robgain, ureal
    >>> found = robgain(ureal("gain", 2.0, percent=25) * tf(1, [1, 1]), 3.0)
    >>> 1.97 < found.lower <= 2.0 <= found.upper < 2.03  # the gain 3 is twice the deviation away
    True
    """
    system = as_uncertain(system)
    if not (math.isfinite(gamma) and gamma > 0.0):
        raise ValueError(f"gamma is {gamma!r}, must be positive")
    nominal = hinf_norm(system.nominal_system())
    worst = Bracket(lower=0.0, upper=0.0, omega=nominal.omega, delta={})
    lower, unproved, size, upper = 0.0, math.inf, 1.0, math.inf if nominal.gain < gamma else 0.0
    while min(upper, unproved) > (1.0 + accuracy) * lower and lower < _LARGEST:
        found = wcgain(_resize(system, size), accuracy=0.25 * accuracy, boxes=boxes)
        lower, unproved = (max(lower, size), unproved) if found.upper < gamma else (lower, min(unproved, size))
        reached = _reach(system, found, gamma, size)
        if reached < upper:
            upper, worst = reached, replace(found, delta={k: reached * np.asarray(v) for k, v in found.delta.items()})
        below, middle = (1.0 - 0.5 * accuracy) * upper, 0.5 * (lower + unproved)
        size = min(4.0 * size, below if below < unproved else middle)
    return RobustBounds(
        lower=lower if lower < _LARGEST else math.inf,
        upper=upper,
        omega=worst.omega,
        delta=worst.delta,
        system=system,
        measure=f"Margin of a gain below {gamma:g}",
    )


def _resize(system: Uncertain, size: float) -> Uncertain:
    """Return the family with deviations of a `size` in place of 1."""
    M, scale = system.M, np.append(np.full(system.n_w, size), np.ones(system.n_inputs))
    return replace(system, M=Lti(A=M.A, B=M.B * scale, C=M.C, D=M.D * scale, dt=M.dt))


def _reach(system: Uncertain, found: Bracket, gamma: float, start: float) -> float:
    """Return the least size at which the member in the direction found has the gain `gamma`; infinite if it has not."""
    direction = interpolate_blocks(system.blocks, found.delta, found.omega, system.M.dt)

    def is_within(size: float) -> bool:
        values = {
            name: replace(value, C=size * value.C, D=size * value.D)
            if isinstance(value, Lti)
            else size * np.asarray(value)
            for name, value in direction.items()
        }
        return hinf_norm(system.close(values)).gain < gamma

    inside, outside = 0.0, start
    while is_within(outside):
        inside, outside = outside, 2.0 * outside
        if outside > _LARGEST:
            return math.inf
    while outside > (1.0 + _CLOSE) * inside:
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if is_within(middle) else (inside, middle)
    return outside


def largest_size(
    of_size: Callable[[float], Uncertain], refuted: float, accuracy: float
) -> tuple[float, float, Bracket]:
    """Return bounds on the largest size with mu below 1, and the Delta that refutes the upper one.

    Sizes are tried in turn, each by the bounds of `mu`. `refuted` is a size known to be too large.
    """
    proved, unproved, unrefuted = 0.0, refuted, 0.0
    to_prove, to_refute = (1.0 - 0.5 * accuracy) * refuted, refuted
    worst = Bracket(lower=0.0, upper=math.inf, omega=0.0, delta={})
    for _ in range(_TRIALS):
        if unproved - proved > accuracy * unproved:
            size = to_prove if proved < to_prove < unproved else 0.5 * (proved + unproved)
        elif refuted - unrefuted > accuracy * refuted:
            size = to_refute if unrefuted < to_refute < refuted else 0.5 * (unrefuted + refuted)
        else:
            break
        found = mu(of_size(size), accuracy=0.25 * accuracy)
        proved, unproved = (max(proved, size), unproved) if found.upper < 1.0 else (proved, min(unproved, size))
        if found.lower < 1.0:
            unrefuted = max(unrefuted, size)
        elif size < refuted:
            refuted, worst = size, found
        # mu falls more slowly than the size: its inverse overshoots by little where it is near 1
        to_prove = (1.0 - 0.5 * accuracy) * size / found.upper
        to_refute = (1.0 + 0.5 * accuracy) * size / max(found.lower, 1e-9)
    return proved, refuted, worst
