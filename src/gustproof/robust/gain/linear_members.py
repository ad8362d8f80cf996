"""Lower bound of a gain with delays, sectors and slopes: linear members of the set, by frequency."""

from collections.abc import Mapping

import numpy as np

from gustproof.robust.gain.parts import Part
from gustproof.robust.lti.state_space import ComplexMatrix, Matrix
from gustproof.robust.uncertain.uncertain_system import Uncertain

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
    M, options = loop.M.response(omega), _options(loop, parts, omega)
    chosen = [0] * len(options)
    best = 0.0
    for _ in range(_ROUNDS):
        before = best
        for i, members in enumerate(options):
            tried = [_gains(loop, M, options, [*chosen[:i], k, *chosen[i + 1 :]]).max() for k in range(len(members))]
            chosen[i] = int(np.argmax(tried))
            best = float(tried[chosen[i]])
        if best <= before:
            break
    peak = int(np.argmax(_gains(loop, M, options, chosen)))
    near = np.geomspace(omega[max(peak - 1, 0)], omega[min(peak + 1, _POINTS - 1)], _POINTS)
    refined = _gains(loop, loop.M.response(near), _options(loop, parts, near), chosen)
    return max(best, float(refined.max()))


def _options(loop: Uncertain, parts: Mapping[str, Part], omega: Matrix) -> list[ComplexMatrix]:
    """Return p / q (m, k) of the members of each block."""
    real = np.outer([0.0, -1.0, 1.0], np.ones_like(omega)).astype(np.complex128)
    return [parts[block.name].members(omega) if block.name in parts else real for block in loop.blocks]


def _gains(loop: Uncertain, M: ComplexMatrix, options: list[ComplexMatrix], chosen: list[int]) -> Matrix:
    """Return the gain (k,) of one member at each frequency."""
    k = loop.n_w
    values = [members[at] for members, at in zip(options, chosen, strict=True)]
    delta = np.repeat(values, [block.shape[0] for block in loop.blocks], axis=0).T[:, :, None]
    inner = np.linalg.solve(np.eye(k) - delta * M[:, :k, :k], delta * M[:, :k, k:])
    return np.asarray(np.linalg.norm(M[:, k:, k:] + M[:, k:, :k] @ inner, 2, axis=(1, 2)))
