"""The figure by which robustness is explained: gains of a family, its nominal and its worst member."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from gustproof.robust.lti.state_space import Lti

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINTS = 400
"""Number of frequencies drawn, over the range of the poles and a decade beyond."""
_RISE = 1e3
"""[-] most that the axis goes beyond the nominal gains: a worst member on the edge of stability has no end."""


def draw_family(members: Sequence[Lti], nominal: Lti, worst: Lti | None, ax: "Axes | None") -> "Axes":
    """Return axes with the largest gain of each system over frequency [rad/s]."""
    from matplotlib.figure import Figure  # takes a second: imported on use only
    from matplotlib.pyplot import subplots

    if ax is None:
        figure, ax = subplots(figsize=(6.4, 4.0), layout="constrained")
        assert isinstance(figure, Figure)
    known = [*members, nominal, *([] if worst is None else [worst])]
    dt = nominal.dt
    speeds = np.concatenate([np.abs(np.log(system.poles()) / dt if dt else system.poles()) for system in known])
    speeds = speeds[(speeds > 0.0) & np.isfinite(speeds)]
    first, last = (np.min(speeds), np.max(speeds)) if speeds.size else (1.0, 1.0)
    omega = np.geomspace(0.1 * first, np.pi / dt if dt else 10.0 * last, _POINTS)
    for k, system in enumerate(known):
        gains = np.linalg.norm(system.response(omega), 2, axis=(1, 2))
        if k < len(members):
            ax.loglog(omega, gains, color="0.75", linewidth=0.8, label="members" if k == 0 else None)
        else:
            label, color = ("nominal", "C0") if k == len(members) else ("worst", "C3")
            ax.loglog(omega, gains, color=color, label=label)
    usual = _RISE * float(np.max(np.linalg.norm(nominal.response(omega), 2, axis=(1, 2)), initial=1.0))
    ax.set_ylim(top=min(usual, ax.get_ylim()[1]))
    ax.set(xlabel="frequency [rad/s]", ylabel="largest gain")
    ax.legend()
    return ax
