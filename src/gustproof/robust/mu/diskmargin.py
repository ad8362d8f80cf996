"""Disk margins of a loop: each channel alone, all at once, and at both ends of the plant."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import LinearSystem, Lti, as_controller, as_lti, sensitivity, series
from gustproof.robust.mu.singular_value import mu
from gustproof.robust.mu.sweep import Bracket
from gustproof.robust.shown import Shown
from gustproof.robust.uncertain.uncertain_system import Uncertain, stack
from gustproof.robust.uncertain.uncertainty import FullBlock

_ACCURACY = 4e-3
"""[-] relative distance of a lower bound from the best of D scalings."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class DiskMargin(Shown):
    """Bounds on a disk margin alpha, and the gains and phases that it covers in each of its channels at once."""

    where: str
    """Place at which the loop is broken."""
    lower: float
    """[-] the loop is stable for all factors of this disk."""
    upper: float
    """[-] some factors of this disk destabilise it."""
    omega: float
    """[rad/s] frequency at which they do."""
    gains: tuple[float, float]
    """[-] least and largest real factor that the lower bound covers."""
    phase_deg: float
    """[deg] change of phase, both ways, that the lower bound covers."""

    def lines(self) -> list[str]:
        """Return the margin in one line."""
        bounds = f"{self.lower:.4g}" if self.upper <= 1.005 * self.lower else f"{self.lower:.4g} to {self.upper:.4g}"
        low, high = self.gains
        covers = f"gains {low:.3g} to {high:.3g}, phase {self.phase_deg:.3g} deg"
        at = f" at {self.omega:.4g} rad/s" if math.isfinite(self.omega) else ""
        return [f"Disk margin {self.where}: {bounds}{at}, {covers}"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class DiskMargins(Shown):
    """Disk margins of a loop, broken at the plant's output, and with a controller at its input and at both."""

    loops: tuple[DiskMargin, ...]
    """Each channel of the loop alone, the others closed."""
    output: DiskMargin
    """All channels of the loop, or of the plant's output, at once."""
    input: DiskMargin | None = None
    """All channels of the plant's input at once."""
    both: DiskMargin | None = None
    """All channels of the plant's input and output at once."""

    def lines(self) -> list[str]:
        """Return a line for each place."""
        places = (self.output, self.input, self.both, *self.loops)
        return ["Disk margins", *(place.lines()[0].removeprefix("Disk margin ") for place in places if place)]


def diskmargin(L: LinearSystem, C: LinearSystem | ArrayLike | None = None, *, skew: float = 0.0) -> DiskMargins:
    """Return the disk margins of the negative-feedback loop of `L`, or of a plant `L` and a controller or gain `C`.

    Each channel is multiplied by a factor `(1 + (1 - skew)/2 d) / (1 - (1 + skew)/2 d)` with `|d| < alpha`
    (MATLAB: `diskmargin`). The skew 0 balances gains above and below 1, a positive one weighs increases. A disk that
    holds infinite gains is not counted: no margin is above `2 / (1 + skew)`.

    Raises
    ------
    ValueError
        If sizes or sample times do not fit, or the loop is unstable or not well posed.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40 (2020), 78-95.

    Examples
    --------
    >>> from control import tf
    >>> from gustproof.robust import diskmargin
    >>> diskmargin(tf(25, [1, 10, 10, 10])).output
    Disk margin at all outputs: 0.4581 at 1.955 rad/s, gains 0.627 to 1.59, phase 25.8 deg
    """
    if not math.isfinite(skew):
        raise ValueError(f"skew is {skew!r}, must be finite")
    plant = as_lti(L)
    controller = None if C is None else as_controller(C, plant.dt)
    at_output = plant if controller is None else series(controller, plant)
    S = sensitivity(at_output)
    n = S.n_outputs
    loops = tuple(_margin(S.subsystem([k], [k]), skew, f"at output {k + 1}") for k in range(n))
    output = _margin(S, skew, "at all outputs")
    if controller is None:
        return DiskMargins(loops=loops, output=output)
    at_input = series(plant, controller)
    # v = (u, y) with u = -C y and y = P u: the loop of all signals
    around = stack(controller, -plant).M
    p, m = plant.n_outputs, plant.n_inputs
    crossed = around.subsystem(slice(None), [*range(p, p + m), *range(p)])
    return DiskMargins(
        loops=loops,
        output=output,
        input=_margin(sensitivity(at_input), skew, "at all inputs"),
        both=_margin(sensitivity(crossed), skew, "at all inputs and outputs"),
    )


def _margin(S: Lti, skew: float, where: str) -> DiskMargin:
    """Return the margin of the loop with the sensitivity `S`, all of its channels at once."""
    M = Lti(A=S.A, B=S.B, C=S.C, D=S.D + 0.5 * (skew - 1.0) * np.eye(S.n_outputs), dt=S.dt)
    if S.n_outputs == 1:
        peak = hinf_norm(M)
        found = Bracket(lower=peak.gain, upper=peak.gain, omega=peak.omega, delta={})
        if not S.is_stable():
            raise ValueError("the loop is unstable: it has no margins")
    else:
        channels = tuple(FullBlock(name=f"channel {k}") for k in range(S.n_outputs))
        found = mu(Uncertain(M=M, blocks=channels), accuracy=_ACCURACY)
    most = 2.0 / (1.0 + skew) if skew > -1.0 else math.inf
    lower, upper = (min(1.0 / size if size > 0.0 else math.inf, most) for size in (found.upper, found.lower))
    low = (1.0 - 0.5 * (1.0 - skew) * lower) / (1.0 + 0.5 * (1.0 + skew) * lower)
    low = low if abs(low) > 1e-12 else 0.0
    left = 1.0 - 0.5 * (1.0 + skew) * lower
    high = (1.0 + 0.5 * (1.0 - skew) * lower) / left if left > 1e-12 else math.inf
    # where the circle on the real diameter from low to high meets the unit circle
    cosine = low if math.isinf(high) else (1.0 + low * high) / (low + high)
    phase = math.degrees(math.acos(cosine)) if abs(cosine) <= 1.0 else 180.0
    return DiskMargin(where=where, lower=lower, upper=upper, omega=found.omega, gains=(low, high), phase_deg=phase)
