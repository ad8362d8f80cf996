"""Bounds on the smallest disk margin of an uncertain loop."""

import numpy as np

from gustproof.robust.lti.state_space import Lti
from gustproof.robust.mu.robust_bounds import RobustBounds
from gustproof.robust.mu.robust_margin import largest_size
from gustproof.robust.mu.singular_value import disk_margin_bounds, mu
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain
from gustproof.robust.uncertain.uncertainty import FullBlock


def wcmargin(L: Uncertain, *, accuracy: float = 0.02) -> RobustBounds:
    """Return bounds on the least multi-loop disk margin over the family (MATLAB: `wcdiskmargin`, once `wcmargin`).

    The negative-feedback loop with transfer `L` stays stable for every member and every disk of the lower bound in each
    channel at once. The worst member has a disk of the upper bound that makes it unstable. Both bounds are 0 if a
    member is unstable itself. Margins are tried in turn, each by the bounds of `mu` with one complex block for each
    channel. No margin is above 2.

    Parameters
    ----------
    L
        Square, uncertain loop transfer, stable in negative feedback at its nominal values.
    accuracy
        [-] relative resolution of each bound; what mu leaves open stays between them.

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
    >>> found = wcmargin(ureal("gain", 1.0, percent=50) * tf(2, [1, 2, 0]), accuracy=0.05)
    >>> found.lower <= 1.0 <= found.upper  # 1.15 with the nominal gain
    True
    """
    L = as_uncertain(L)
    if not L.blocks:
        raise ValueError("the loop has no blocks: nothing is uncertain, use diskmargin")
    if L.n_inputs != L.n_outputs:
        raise ValueError(f"the loop transfer is {L.n_outputs} x {L.n_inputs}, must be square")
    one = np.eye(L.n_outputs)
    S = (L + one).inverse() - 0.5 * one
    of_delta = S.M.subsystem(slice(0, S.n_z), slice(0, S.n_w))
    alone = mu(Uncertain(M=of_delta, blocks=S.blocks), accuracy=0.25 * accuracy)
    if alone.lower >= 1.0:
        lower, upper, worst = 0.0, 0.0, alone
    else:
        # the nominal loop is a member
        nominal = disk_margin_bounds(L.nominal_system(), accuracy=0.25 * accuracy)[1]
        lower, upper, worst = largest_size(lambda margin: _with_disks(S, margin), nominal, accuracy)
    names = [block.name for block in L.blocks]
    return RobustBounds(
        lower=lower,
        upper=upper,
        omega=worst.omega,
        delta={name: value for name, value in worst.delta.items() if name in names},
        system=L,
        measure="Worst disk margin",
    )


def _with_disks(S: Uncertain, margin: float) -> Uncertain:
    """Return the loop closed by Delta and a complex block for each channel, whose norm 1 is the disk of a margin."""
    scale = np.concatenate([np.ones(S.n_w), np.full(S.n_inputs, margin)])
    M = Lti(A=S.M.A, B=S.M.B * scale, C=S.M.C, D=S.M.D * scale, dt=S.M.dt)
    return Uncertain(M=M, blocks=(*S.blocks, *(FullBlock(name=f"channel {k}") for k in range(S.n_inputs))))
