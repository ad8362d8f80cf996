"""Lower bound of a gain with delays, sectors and slopes: linear members of the set, by frequency."""

from collections.abc import Mapping

import numpy as np

from gustproof.certify.gain.parts import Part
from gustproof.lti.state_space import ComplexMatrix
from gustproof.model.lft import Uncertain

_POINTS = 400
"""Number of frequencies, over two decades beyond the loop's poles on either side."""
_ROUNDS = 3
"""Largest number of rounds over all blocks."""


def worst_member(loop: Uncertain, parts: Mapping[str, Part]) -> float:
    """Return the largest gain that some linear member of the set has at some frequency.

    No harmonic of that frequency is amplified less in the limit of long times; an unstable member has no finite gain at
    all. Blocks are improved in turn: real parameters over -1, 0 and 1, `parts` over some of their linear members.
    """
    poles = np.abs(loop.M.poles())
    omega = np.geomspace(1e-2 * max(poles.min(), 1e-6), 1e2 * poles.max(), _POINTS)
    M = loop.M.response(omega)
    real = np.outer([0.0, -1.0, 1.0], np.ones(_POINTS)).astype(np.complex128)
    options = [parts[block.name].members(omega) if block.name in parts else real for block in loop.blocks]
    sizes = [block.shape[0] for block in loop.blocks]
    chosen = [0] * len(sizes)
    best = _peak(M, options, sizes, chosen)
    for _ in range(_ROUNDS):
        before = best
        for i, members in enumerate(options):
            tried = [_peak(M, options, sizes, [*chosen[:i], k, *chosen[i + 1 :]]) for k in range(len(members))]
            chosen[i] = int(np.argmax(tried))
            best = tried[chosen[i]]
        if best <= before:
            break
    return best


def _peak(M: ComplexMatrix, options: list[ComplexMatrix], sizes: list[int], chosen: list[int]) -> float:
    """Return the largest gain of one member over the frequencies."""
    k = sum(sizes)
    delta = np.vstack(
        [np.tile(members[at], (size, 1)) for members, size, at in zip(options, sizes, chosen, strict=True)]
    ).T[:, :, None]
    inner = np.linalg.solve(np.eye(k) - delta * M[:, :k, :k], delta * M[:, :k, k:])
    return float(np.linalg.norm(M[:, k:, k:] + M[:, k:, :k] @ inner, 2, axis=(1, 2)).max())
