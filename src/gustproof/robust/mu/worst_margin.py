"""Bounds on the smallest disk margin of an uncertain loop."""

import numpy as np

from gustproof.robust.lti.margins import largest_disk
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.mu.robust_bounds import RobustBounds
from gustproof.robust.mu.robust_margin import largest_size
from gustproof.robust.mu.singular_value import disk_margin_bounds
from gustproof.robust.mu.sweep import Bracket, require_search, require_stable, to_continuous
from gustproof.robust.mu.worst_gain import bracket_gain, wcgain
from gustproof.robust.uncertain.interpolation import interpolate_blocks
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain
from gustproof.robust.uncertain.uncertainty import FullBlock

_LARGEST = 2.0
"""[-] largest disk margin: it covers every positive gain."""


def wcmargin(L: Uncertain, *, accuracy: float = 0.005, boxes: int = 16) -> RobustBounds:
    """Return bounds on the least multi-loop disk margin over the family (MATLAB: `wcdiskmargin`, once `wcmargin`).

    The negative-feedback loop with transfer `L` stays stable for every member and every disk of the lower bound in each
    channel at once. The worst member has a disk of the upper bound that makes it unstable. Both bounds are 0 if a
    member is unstable itself. No margin is above 2. That of one channel is the inverse of a worst gain. Of several,
    margins are tried in turn, each by the bounds of `wcgain` with a complex block for each channel.

    Parameters
    ----------
    L
        Square, uncertain loop transfer, stable in negative feedback at its nominal values.
    accuracy
        [-] relative distance of the bounds at which the search ends.
    boxes
        Most boxes of the real parameters at each margin tried.

    Raises
    ------
    ValueError
        If `L` is not square, has no blocks, or its loop is unstable or not well posed at its nominal values.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40 (2020), 78-95.

    Examples
    --------
    >>> from control import tf
    >>> from gustproof.robust import ureal, wcmargin
    >>> wcmargin(ureal("gain", 1.0, percent=50) * tf(2, [1, 2, 0]))
    Worst disk margin: 0.99775 to 1 at 1.732 rad/s
    gain: 1.5 of [0.5, 1.5]
    """
    require_search(accuracy, boxes)
    L = as_uncertain(L)
    if not L.blocks:
        raise ValueError("the loop has no blocks: nothing is uncertain, use diskmargin")
    if L.n_inputs != L.n_outputs:
        raise ValueError(f"the loop transfer is {L.n_outputs} x {L.n_inputs}, must be square")
    one = np.eye(L.n_outputs)
    S = (L + one).inverse() - 0.5 * one
    require_stable(to_continuous(S))
    alone: Bracket = wcgain(S, accuracy=accuracy, boxes=boxes)
    if alone.lower == np.inf:
        lower, upper, worst = 0.0, 0.0, alone
    elif S.n_inputs == 1:
        lower, upper, worst = largest_disk(alone.upper), largest_disk(alone.lower), alone
    else:

        def of_size(margin: float) -> tuple[bool, float, Bracket]:
            found = bracket_gain(_with_disks(S, margin), accuracy=0.25 * accuracy, boxes=boxes, wanted=1.0 / margin)
            return found.upper < 1.0 / margin, _margin_of_member(L, found, accuracy), found

        size = _margin_of_member(L, alone, accuracy)
        lower, upper, worst = largest_size(of_size, (1.0 - 0.5 * accuracy) * size, (size, alone), accuracy)
    names = [block.name for block in L.blocks]
    return RobustBounds(
        lower=min(lower, _LARGEST),
        upper=upper,
        omega=worst.omega,
        delta={name: value for name, value in worst.delta.items() if name in names},
        system=L,
        measure="Worst disk margin",
    )


def _with_disks(S: Uncertain, margin: float) -> Uncertain:
    """Return the loop closed by Delta and, but for the last channel, complex blocks whose norm 1 is a disk of a margin.

    The margin holds if the gain of the last channel is below its inverse.
    """
    disks = tuple(FullBlock(name=f"channel {k}") for k in range(S.n_inputs - 1))
    scale = np.concatenate([np.ones(S.n_w), np.full(len(disks), margin), [1.0]])
    return Uncertain(M=Lti(A=S.M.A, B=S.M.B * scale, C=S.M.C, D=S.M.D * scale, dt=S.M.dt), blocks=(*S.blocks, *disks))


def _margin_of_member(L: Uncertain, found: Bracket, accuracy: float) -> float:
    """Return the upper bound on the margin of the member found: 0 if its loop is unstable, 2 if there is no member."""
    delta = {block.name: found.delta[block.name] for block in L.blocks if block.name in found.delta}
    try:
        member = L.close(interpolate_blocks(L.blocks, delta, found.omega, L.M.dt))
    except ValueError:
        return _LARGEST
    try:
        return disk_margin_bounds(member, accuracy=0.25 * accuracy)[1]
    except ValueError:
        return 0.0
