"""Bounds on the smallest disk margin of an uncertain loop."""

import numpy as np

from gustproof.robust.lti.state_space import Lti
from gustproof.robust.mu.singular_value import disk_margin_bounds, mu
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain
from gustproof.robust.uncertain.uncertainty import FullBlock

_TRIALS = 24
"""Most margins tried."""


def wcmargin(L: Uncertain, *, accuracy: float = 0.02) -> tuple[float, float]:
    """Return the lower and upper bound on the least multi-loop disk margin over the unit ball (MATLAB: `wcmargin`).

    The negative-feedback loop with transfer `L` stays stable for every Delta of norm 1 and every disk of the lower
    bound in each channel at once. Some Delta and disk of the upper bound make it unstable. Both bounds are 0 if the
    loop itself is unstable in the ball. Margins are tried in turn, each by the bounds of `mu` with one complex block
    for each channel.

    Parameters
    ----------
    L
        Square, uncertain loop transfer, stable in negative feedback at Delta = 0.
    accuracy
        [-] relative resolution of each bound; what mu leaves open stays between them.

    Raises
    ------
    ValueError
        If `L` is not square, has no blocks, or its loop is unstable or not well posed at Delta = 0.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40 (2020), 78-95.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import ureal, wcmargin
    >>> loop = ureal("gain", range=(0.5, 1.5)) @ ss([[0, 1], [0, -2]], [[0], [1]], [[2, 0]], 0)
    >>> lower, upper = wcmargin(loop, accuracy=0.05)
    >>> lower <= 1.0 <= upper  # 1.15 with the nominal gain
    True
    """
    L = as_uncertain(L)
    if not L.blocks:
        raise ValueError("the loop has no blocks: nothing is uncertain, use disk_margin_bounds")
    if L.n_inputs != L.n_outputs:
        raise ValueError(f"the loop transfer is {L.n_outputs} x {L.n_inputs}, must be square")
    one = np.eye(L.n_outputs)
    S = (L + one).inverse() - 0.5 * one
    of_delta = S.M.subsystem(slice(0, S.n_z), slice(0, S.n_w))
    if mu(Uncertain(M=of_delta, blocks=S.blocks), accuracy=0.25 * accuracy).lower >= 1.0:
        return 0.0, 0.0
    # the nominal loop is a member
    refuted = disk_margin_bounds(L.nominal_system(), accuracy=0.25 * accuracy)[1]
    proved, unproved, unrefuted = 0.0, refuted, 0.0
    to_prove, to_refute = (1.0 - 0.5 * accuracy) * refuted, refuted
    for _ in range(_TRIALS):
        if unproved - proved > accuracy * unproved:
            margin = to_prove if proved < to_prove < unproved else 0.5 * (proved + unproved)
        elif refuted - unrefuted > accuracy * refuted:
            margin = to_refute if unrefuted < to_refute < refuted else 0.5 * (unrefuted + refuted)
        else:
            break
        found = mu(_with_disks(S, margin), accuracy=0.25 * accuracy)
        proved, unproved = (max(proved, margin), unproved) if found.upper < 1.0 else (proved, min(unproved, margin))
        refuted, unrefuted = (
            (min(refuted, margin), unrefuted) if found.lower >= 1.0 else (refuted, max(unrefuted, margin))
        )
        # mu falls more slowly than the margin: its inverse overshoots by little where it is near 1
        to_prove = (1.0 - 0.5 * accuracy) * margin / found.upper
        to_refute = (1.0 + 0.5 * accuracy) * margin / max(found.lower, 1e-9)
    return proved, refuted


def _with_disks(S: Uncertain, margin: float) -> Uncertain:
    """Return the loop closed by Delta and a complex block for each channel, whose norm 1 is the disk of a margin."""
    scale = np.concatenate([np.ones(S.n_w), np.full(S.n_inputs, margin)])
    M = Lti(A=S.M.A, B=S.M.B * scale, C=S.M.C, D=S.M.D * scale, dt=S.M.dt)
    return Uncertain(M=M, blocks=(*S.blocks, *(FullBlock(name=f"channel {k}") for k in range(S.n_inputs))))
