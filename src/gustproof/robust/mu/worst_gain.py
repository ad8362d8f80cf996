"""Bounds on the largest H-infinity norm of an uncertain family, with branch and bound where they differ."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.mu.robust_bounds import RobustBounds
from gustproof.robust.mu.scalings import best_scalings
from gustproof.robust.mu.sweep import (
    Bracket,
    add_performance_block,
    require_search,
    sweep,
    to_continuous,
    unwarp_frequency,
)
from gustproof.robust.mu.worst_delta import most_singular_delta, most_unstable_delta, worst_delta
from gustproof.robust.uncertain.elements import ultidyn, ureal
from gustproof.robust.uncertain.interpolation import interpolate_blocks
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain, join, stack
from gustproof.robust.uncertain.uncertainty import RealBlock

_CLIMBS = 8
"""Most frequencies tried for a better lower bound."""
_PROGRESS = 1e-5
"""[-] relative progress of the lower bound below which no other frequency is tried."""
MOST_HALVED = 8
"""Most real parameters whose ranges are halved: each halving tries all of them, and takes minutes beyond."""
ParameterBox = Mapping[str, tuple[float, float]]
"""Lower and upper limit of the normalised value of each real parameter."""


def wcgain(system: Uncertain, *, accuracy: float = 0.005, boxes: int = 16) -> RobustBounds:
    """Return bounds on the largest H-infinity norm over the family, and its worst member (MATLAB: `wcgain`).

    Parameters are constant in time. The search halves the box with the largest upper bound where that helps most. It
    stops at `boxes` boxes of the real parameters, or once the bounds differ by at most twice `accuracy`.

    Parameters
    ----------
    system
        With inputs and outputs; the upper bound is infinite if a member is unstable.
    accuracy
        [-] relative distance of each upper bound from the least one of D-G scalings.
    boxes
        Largest number of boxes; 1 for scalings alone, as where there are more than eight parameters.

    Raises
    ------
    ValueError
        If the system has no blocks, inputs or outputs.

    References
    ----------
    M. P. Newlin, P. M. Young, Mixed mu problems and branch and bound techniques, Int. J. of Robust and Nonlinear
    Control 7 (1997), 145-164.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof.robust import ureal, wcgain
    >>> wcgain(ureal("gain", 2.0, percent=20) * ss(-1.0, 1.0, 1.0, 0.0))
    Worst gain: 2.4 to 2.406 at 0 rad/s
    gain: 2.4 of [1.6, 2.4]
    """
    require_search(accuracy, boxes)
    system = as_uncertain(system)
    require_gain(system)
    found = bracket_gain(system, accuracy=accuracy, boxes=boxes)
    if np.isinf(found.upper):
        found = _destabilising(system, found)
    elif found.gap > 2.0 * accuracy and len(whole_box(system)) < len(system.blocks):
        found = _climb(system, found)
    return RobustBounds(
        lower=found.lower,
        upper=found.upper,
        omega=found.omega,
        delta=found.delta,
        system=system,
        measure="Worst gain",
    )


def bracket_gain(system: Uncertain, *, accuracy: float, boxes: int, wanted: float | None = None) -> Bracket:
    """Return the bracket of `wcgain`, with a level `wanted` only until one of the bounds is beyond it.

    The upper bound is infinite where nothing was proved.
    """
    whole = whole_box(system)
    leaves = [(whole, _box_gain(system, whole, accuracy, wanted))]
    while True:
        best = max((bracket for _, bracket in leaves), key=lambda bracket: bracket.lower)
        box, bracket = max(leaves, key=lambda leaf: leaf[1].upper)
        enough = wanted or (1.0 + 2.0 * accuracy) * best.lower
        if bracket.upper <= enough or best.lower >= (wanted or np.inf):
            return replace(best, upper=bracket.upper)
        if len(leaves) >= boxes or not 0 < len(whole) <= MOST_HALVED:
            known = replace(best, upper=bracket.upper)
            return known if wanted else _bound_open_boxes(system, leaves, known, accuracy, enough)
        leaves.remove((box, bracket))
        leaves += _halve(system, box, bracket, accuracy, enough)


def whole_box(system: Uncertain) -> ParameterBox:
    """Return the box of all real parameters."""
    return {block.name: (-1.0, 1.0) for block in system.blocks if isinstance(block, RealBlock)}


def _climb(system: Uncertain, found: Bracket) -> Bracket:
    """Return the bracket with the lower bound from the frequencies at which the worst members peak, in turn."""
    M, dt = to_continuous(system), system.M.dt
    for _ in range(_CLIMBS):
        try:
            member = system.close(interpolate_blocks(system.blocks, found.delta, found.omega, dt))
        except ValueError:  # without lag it has no solution
            break
        peak = hinf_norm(member)
        if not np.isfinite([peak.gain, peak.omega]).all():
            break
        warped = 2.0 / dt * np.tan(0.5 * peak.omega * dt) if dt else peak.omega
        worst = worst_delta(M.response(warped)[0], system.blocks)
        if not worst.gain > (1.0 + _PROGRESS) * found.lower:
            break
        delta = worst.parts(system.blocks)
        found = replace(found, lower=min(worst.gain, found.upper), omega=peak.omega, delta=delta)
    return found


def _halve(
    system: Uncertain, box: ParameterBox, bracket: Bracket, accuracy: float, enough: float
) -> list[tuple[ParameterBox, Bracket]]:
    """Return the halves of a box with their brackets; an upper bound not proved below `enough` is that of the box."""
    halves = best_halves(system, box, bracket.omega, accuracy)
    found = [_box_gain(system, half, accuracy, enough) for half in halves]
    return [(half, replace(own, upper=min(own.upper, bracket.upper))) for half, own in zip(halves, found, strict=True)]


def _bound_open_boxes(
    system: Uncertain, leaves: list[tuple[ParameterBox, Bracket]], known: Bracket, accuracy: float, enough: float
) -> Bracket:
    """Return the bracket over all boxes, where those not proved below `enough` get a bound of their own."""
    if len(leaves) == 1:
        return known
    own = [_box_gain(system, box, accuracy, None) for box, bracket in leaves if bracket.upper > enough]
    best = max([known, *own], key=lambda each: each.lower)
    return replace(best, upper=max(enough, *(each.upper for each in own)))


def require_gain(system: Uncertain) -> None:
    """Raise unless there is something uncertain, and an input and an output."""
    if not all((system.blocks, system.n_inputs, system.n_outputs)):
        raise ValueError("the system has no worst gain: no blocks, no inputs or no outputs")


def restrict(system: Uncertain, box: ParameterBox, *, radius: float = 1.0) -> Uncertain:
    """Return the family with its real parameters restricted to a box and normalised to it.

    Full blocks are restricted to norm `radius`.
    """
    delta = []
    for block in system.blocks:
        if isinstance(block, RealBlock):
            low, high = box[block.name]
            delta += [ureal(block.name, range=(low, high))] * block.repeats
        else:
            one = radius * np.eye(block.n_outputs) @ ultidyn(block.name, block.n_outputs, block.n_inputs)
            delta += [one] * block.repeats
    return join(stack(*delta), system.M, system.n_w, system.n_z)


def _box_gain(system: Uncertain, box: ParameterBox, accuracy: float, wanted: float | None) -> Bracket:
    """Return the bracket of the gain in a box, with delta in the coordinates of the whole family."""
    family = restrict(system, box)
    M = to_continuous(family)
    if not M.is_stable():
        centre = {name: 0.5 * (low + high) for name, (low, high) in box.items()}
        peak = hinf_norm(system.member(centre))
        return Bracket(lower=peak.gain, upper=np.inf, omega=peak.omega, delta=centre)
    upper, grid = sweep(M, add_performance_block(family), gain=True, accuracy=accuracy, wanted=wanted)
    found = [(worst_delta(M.response(omega)[0], family.blocks), omega) for omega in grid]
    worst, omega = max(found, key=lambda pair: pair[0].gain)
    delta = worst.parts(family.blocks)
    for name, (low, high) in box.items():
        delta[name] = 0.5 * (low + high) + 0.5 * (high - low) * float(np.asarray(delta[name]))
    if len(box) < len(system.blocks):
        return Bracket(lower=worst.gain, upper=upper, omega=unwarp_frequency(omega, system), delta=delta)
    # the norm of the member itself is the true figure; it may exceed the gain at the frequencies tried
    peak = hinf_norm(system.member(delta))
    if peak.gain < worst.gain:
        return Bracket(lower=worst.gain, upper=upper, omega=unwarp_frequency(omega, system), delta=delta)
    return Bracket(lower=peak.gain, upper=upper, omega=peak.omega, delta=delta)


def _destabilising(system: Uncertain, found: Bracket) -> Bracket:
    """Return an infinite gain with a member of the family that is unstable, or what was found if none is met."""
    M, z, w = to_continuous(system), system.n_z, system.n_w
    if np.isinf(found.lower):
        return found
    if M.order:
        worst, pole = most_unstable_delta(M, system.blocks)
        omega, meets = abs(pole.imag), worst.gain >= 0.0
    else:
        worst, omega = most_singular_delta(M.D[:z, :w].astype(np.complex128), system.blocks), 0.0
        meets = worst.gain >= 1.0
    if not meets:
        return found
    size = 1.0 if M.order else worst.gain
    delta = {name: np.asarray(value) / size for name, value in worst.parts(system.blocks).items()}
    return Bracket(lower=np.inf, upper=np.inf, omega=unwarp_frequency(omega, system), delta=delta)


def best_halves(
    system: Uncertain, box: ParameterBox, omega: float, accuracy: float, *, gain: bool = True, radius: float = 1.0
) -> list[ParameterBox]:
    """Return the halves of a box, along the parameter with the least larger bound at `omega`.

    The bound is that of the gain from inputs to outputs, or of mu; full blocks are of norm `radius`.
    """
    cuts = []
    for name, (low, high) in box.items():
        middle = 0.5 * (low + high)
        halves: list[ParameterBox] = [{**box, name: (low, middle)}, {**box, name: (middle, high)}]
        levels = []
        for half in halves:
            family = restrict(system, half, radius=radius)
            M = family.M.response(min(omega, 1e9))[0]
            blocks = add_performance_block(family) if gain else family.blocks
            levels.append(best_scalings(M, blocks, gain=gain, accuracy=accuracy).level(M))
        cuts.append((max(levels), halves))
    return min(cuts, key=lambda cut: cut[0])[1]
