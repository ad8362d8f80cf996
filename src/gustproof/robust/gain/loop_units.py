"""Loops in balanced units for the search of multipliers, and multipliers brought back into the units of the loop.

Units are powers of two, so nothing is rounded. The inequality of a loop is a congruence of that of the loop in other
units, times a positive number: one is definite if the other is.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from gustproof.checker.evidence_types import BlockTable
from gustproof.checker.quadratic_constraints import make_filter
from gustproof.robust.gain.constrained_multipliers import ConstrainedMultipliers
from gustproof.robust.gain.multipliers import Multipliers
from gustproof.robust.gain.rate_bounded_multipliers import RateBoundedMultipliers
from gustproof.robust.lti.state_space import Matrix
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import rows
from gustproof.robust.uncertain.units import ChannelUnits, Units, balance

Found = Multipliers | RateBoundedMultipliers | ConstrainedMultipliers
"""Multipliers of any kind."""

_QUADRATIC = ("X", "Y", "T", "causal", "anticausal")
"""Multipliers of a delay, sector or slope."""
_NEAR = 2.0**6
"""[-] units up to this factor from the loop's own would change nothing but the last digits of a proof."""


def search_units(loop: Uncertain) -> Units:
    """Return the units in which multipliers of a loop are searched: its own if these are near enough."""
    found = balance(loop.M, loop.blocks)
    every = np.concatenate([found.x, found.channels.z, found.channels.w, [found.channels.output]])
    if np.all((every >= 1.0 / _NEAR) & (every <= _NEAR)):
        z, w, _ = found.channels
        return Units(x=np.ones_like(found.x), channels=ChannelUnits(np.ones_like(z), np.ones_like(w), 1.0))
    return found


def in_units(loop: Uncertain, units: Units) -> Uncertain:
    """Return the same loop in other units; its gain is so many `units.channels.output`."""
    return Uncertain(M=units.change(loop.M, output=units.channels.output), blocks=loop.blocks)


def to_loop_units(found: Found, loop: Uncertain, units: Units, slow: Sequence[bool]) -> Found:
    """Return multipliers that were found for a loop in `units` as those that prove the same of the loop in its own.

    `slow` tells of each block whether its speed is bounded.
    """
    w, square = units.channels.w, units.channels.output**2
    own, level = [w[at] for at in rows(loop.blocks)], units.channels.output * found.level
    if isinstance(found, ConstrainedMultipliers):
        filters = [np.full(len(make_filter(block).A), u[0]) for block, u in zip(found.blocks, own, strict=True)]
        return replace(
            found,
            coordinates=found.coordinates / np.concatenate([units.x, *filters]),
            P=square * found.P,
            blocks=tuple(_scale_block(block, u, square) for block, u in zip(found.blocks, own, strict=True)),
            level=level,
        )
    coordinates = found.coordinates / units.x
    if isinstance(found, Multipliers):
        D, G = _scale_all(found.D, own, square), _scale_all(found.G, own, square)
        return replace(found, coordinates=coordinates, P=square * found.P, D=D, G=G, level=level)
    channels = np.concatenate(list(itertools.compress(own, slow)))
    into = np.concatenate([np.ones(len(coordinates)), w, np.ones(loop.n_inputs)])
    twice = [u for u in own for _ in "DG"]
    flat = [_scale_all(list(itertools.chain(*pairs)), twice, square) for pairs in found.scalings]
    return replace(
        found,
        coordinates=coordinates,
        P=tuple(square * term for term in found.P),
        Y=square * found.Y / channels[:, None] / into,
        scalings=tuple(tuple(zip(parts[::2], parts[1::2], strict=True)) for parts in flat),
        level=level,
    )


def _scale_all(parts: Sequence[Matrix], own: Sequence[Matrix], square: float) -> tuple[Matrix, ...]:
    return tuple(_scale(part, u, square) for part, u in zip(parts, own, strict=True))


def _scale(part: Matrix, u: Matrix, square: float) -> Matrix:
    return np.asarray(square * part / np.outer(u, u))


def _scale_block(block: BlockTable, u: Matrix, square: float) -> BlockTable:
    """Return the entries of a block with its multipliers, which are quadratic in its signals, in units of `u`."""
    if "D" in block:
        scaled = {name: _scale(np.array(block[name]), u, square) for name in ("D", "G")}
    else:
        scaled = {name: square / u[0] ** 2 * np.array(value) for name, value in block.items() if name in _QUADRATIC}
    return cast(BlockTable, block | {name: value.tolist() for name, value in scaled.items()})
