"""Margins of an uncertain system: how much of its uncertainty it stands, for stability and for a level of gain."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gustproof.robust.lti.norms import Peak, hinf_norm
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.mu.robust_bounds import RobustMargin
from gustproof.robust.mu.singular_value import mu
from gustproof.robust.mu.sweep import Bracket, require_search, require_stable, to_continuous
from gustproof.robust.mu.worst_gain import bracket_gain, require_gain
from gustproof.robust.uncertain.interpolation import interpolate_blocks
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain
from gustproof.robust.uncertain.uncertainty import RealBlock

_CLOSE = 1e-6
"""[-] relative width at which the search along one direction stops."""
_LARGEST = 1e6
"""[-] size of the uncertainty beyond which it does not matter."""


def robstab(system: Uncertain, *, accuracy: float = 0.005, boxes: int = 16) -> RobustMargin:
    """Return bounds on the robust stability margin, and values that destabilise (MATLAB: `robstab`).

    The system is stable for all deviations from nominal of the lower bound times those of the ranges. The worst values
    deviate by the upper bound: with them a pole is on the boundary, at `omega`. A margin above 1 covers the ranges;
    `covered` has the intervals that the lower bound covers, each in its own unit. Where a nominal value is not the
    middle of its range, deviations are counted as in `RealBlock`, by the rational form of MATLAB. Inputs and outputs do
    not matter. Parameters are constant in time.

    Parameters
    ----------
    system
        Stable at its nominal values.
    accuracy
        [-] relative distance of the bound from the least one of D-G scalings.
    boxes
        Most boxes of the real parameters at each level tried where scalings leave more; 1 for scalings alone, as
        where there are more than eight.

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
    gain: 8 of [3, 5], covered [0, 8]
    """
    require_search(accuracy, boxes)
    system = as_uncertain(system)
    alone = Uncertain(M=system.M.subsystem(slice(0, system.n_z), slice(0, system.n_w)), blocks=system.blocks)
    found = mu(alone, accuracy=accuracy, boxes=boxes)
    return RobustMargin(
        lower=1.0 / found.upper if found.upper > 0.0 else math.inf,
        upper=1.0 / found.lower if found.lower > 0.0 else math.inf,
        omega=found.omega,
        delta=found.delta,
        system=system,
        measure="Robust stability margin",
    )


def robgain(system: Uncertain, gamma: float, *, accuracy: float = 0.005, boxes: int = 16) -> RobustMargin:
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
    require_search(accuracy, boxes)
    system = as_uncertain(system)
    require_gain(system)
    if not (math.isfinite(gamma) and gamma > 0.0):
        raise ValueError(f"gamma is {gamma!r}, must be positive and finite")
    require_stable(to_continuous(system))
    nominal = hinf_norm(system.nominal_system())

    def of_size(size: float) -> tuple[bool, float, Bracket]:
        found = bracket_gain(_resize(system, size), accuracy=0.25 * accuracy, boxes=boxes, wanted=gamma)
        reached, omega = _reach(system, found, gamma, size)
        delta = {name: reached * np.asarray(value) for name, value in found.delta.items()}
        return found.upper < gamma, reached, replace(found, delta=delta, omega=omega)

    at_zero = Bracket(lower=0.0, upper=0.0, omega=nominal.omega, delta={})
    known = math.inf if nominal.gain < gamma else 0.0, at_zero
    lower, upper, worst = largest_size(of_size, 1.0, known, accuracy)
    return RobustMargin(
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


def _reach(system: Uncertain, found: Bracket, gamma: float, start: float) -> tuple[float, float]:
    """Return the least size at which the member in the direction found has the gain `gamma`, infinite if it has not.

    The frequency is that of the gain there; of complex values, the one that they were found at.
    """
    direction = interpolate_blocks(system.blocks, found.delta, found.omega, system.M.dt)

    def norm(size: float) -> Peak:
        values = {
            name: replace(value, C=size * value.C, D=size * value.D)
            if isinstance(value, Lti)
            else size * np.asarray(value)
            for name, value in direction.items()
        }
        try:
            member = system.close(values)
        except ValueError:  # without a solution
            return Peak(gain=math.inf, omega=math.inf, error=0.0)
        return hinf_norm(member)

    inside, outside = 0.0, start
    while norm(outside).gain < gamma:
        inside, outside = outside, 2.0 * outside
        if outside > _LARGEST:
            return math.inf, found.omega
    while outside > (1.0 + _CLOSE) * inside:
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if norm(middle).gain < gamma else (inside, middle)
    is_real = all(isinstance(block, RealBlock) for block in system.blocks)
    return outside, norm(inside).omega if is_real else found.omega


def largest_size(
    of_size: Callable[[float], tuple[bool, float, Bracket]],
    size: float,
    known: tuple[float, Bracket],
    accuracy: float,
) -> tuple[float, float, Bracket]:
    """Return bounds on the largest size that is proved, and what refutes the upper one.

    Sizes are tried in turn, `size` first. `of_size` says of one whether it is proved, and gives a size that its second
    value refutes; `known` is such a pair.
    """
    (upper, worst), lower, unproved, is_below = known, 0.0, math.inf, False
    while min(upper, unproved) > (1.0 + accuracy) * lower and lower < _LARGEST:
        proved, reached, found = of_size(size)
        lower, unproved = (max(lower, size), unproved) if proved else (lower, min(unproved, size))
        if reached < upper:
            upper, worst = reached, found
        # just below what refutes, unless that was tried: another direction may be worse by little each time
        below, middle = (1.0 - 0.5 * accuracy) * upper, 0.5 * (lower + unproved)
        is_below = below < unproved and not is_below
        size = min(4.0 * size, (middle, below)[is_below])
    return lower, upper, worst
