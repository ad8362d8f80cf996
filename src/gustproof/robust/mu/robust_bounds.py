"""Bounds on what the worst member of an uncertain family does, with that member in the parameters' own units."""

import math
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from typing import TYPE_CHECKING, Any

import numpy as np

from gustproof.robust.mu.sweep import Bracket
from gustproof.robust.shown import Shown
from gustproof.robust.uncertain.interpolation import interpolate_blocks
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import DeltaBlock, RealBlock

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes

_ROUNDING = 1e-5
"""[-] share of an interval that counts as rounding where its ends are shown."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class RobustBounds(Shown, Bracket):
    """Lower and upper bound on a measure of an uncertain system, and the member that has one of them.

    A worst gain has its lower bound from that member, a margin its upper one.
    """

    system: Uncertain
    """The family."""
    measure: str
    """Name of the bounded quantity."""

    @property
    def worst(self) -> dict[str, Any]:
        """Worst value of each block, in its own unit: a number, or a complex matrix at `omega`."""
        return {block.name: _own_value(block, self.delta[block.name]) for block in self._found()}

    @property
    def worst_member(self) -> "control.StateSpace":
        """The system at these values, its complex ones made stable systems that have them at `omega`."""
        known = {block.name: self.delta[block.name] for block in self._found()}
        delta = interpolate_blocks(self.system.blocks, known, self.omega, self.system.M.dt)
        try:
            return self.system.close(delta).to_control(**self.system.labels())
        except ValueError:
            raise ValueError("no worst member: at the worst values the loop without lag has no solution") from None

    def _found(self) -> list[DeltaBlock]:
        return [block for block in self.system.blocks if block.name in self.delta]

    def lines(self) -> list[str]:
        """Return the bounds, then the worst value of each parameter."""
        where = f" at {self.omega:.4g} rad/s" if self._found() and math.isfinite(self.omega) else ""
        title = f"{self.measure}: {self.lower:.5g} to {self.upper:.5g}{where}"
        return [title, *(f"{block.name}: {self._describe(block)}" for block in self._found())]

    def _describe(self, block: DeltaBlock) -> str:
        return _show(block, self.worst[block.name])

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Return axes with the gains of the family, its nominal and its worst member over frequency."""
        return self.system.plot_sigma(worst=self.worst_member, ax=ax)


class RobustMargin(RobustBounds):
    """Bounds on how many times the deviations of the ranges a system stands, with what that covers."""

    __slots__ = ()

    @property
    def covered(self) -> dict[str, Any]:
        """Values within the lower bound, of all blocks at once, each in its own unit.

        Of a parameter an interval, of another block the largest distance from its nominal value.
        """
        return {
            block.name: block.interval(self.lower) if isinstance(block, RealBlock) else self.lower * block.bound
            for block in self.system.blocks
        }

    def _describe(self, block: DeltaBlock) -> str:
        covered = self.covered[block.name]
        if not isinstance(block, RealBlock):
            return f"{_show(block, self.worst[block.name])}, covered up to {_inward(covered, covered)}"
        low, high = covered
        width = min(high, block.high) - max(low, block.low)
        return f"{_show(block, self.worst[block.name])}, covered [{_inward(low, -width)}, {_inward(high, width)}]"


def _inward(value: float, width: float) -> str:
    """Return an end of an interval in four digits, rounded inwards; beyond it lies the sign of `width`."""
    if math.isinf(value) or abs(value) <= _ROUNDING * abs(width):
        return f"{value:g}" if math.isinf(value) else "0"
    exact = Decimal(value + _ROUNDING * width)
    down = ROUND_FLOOR if width > 0.0 else ROUND_CEILING
    return f"{float(exact.quantize(Decimal(1).scaleb(exact.adjusted() - 3), rounding=down)):.4g}"


def _own_value(block: DeltaBlock, delta: Any) -> Any:
    if isinstance(block, RealBlock):
        return float(block.value(float(np.asarray(delta))))
    value = block.nominal * np.eye(block.n_outputs, block.n_inputs) + block.bound * np.asarray(delta)
    return complex(value.item()) if value.size == 1 else value


def _show(block: DeltaBlock, value: Any) -> str:
    if isinstance(block, RealBlock):
        value = value if abs(value) > 1e-9 * (block.high - block.low) else 0.0
        return f"{value:.4g} of [{block.low:g}, {block.high:g}]"
    size = np.linalg.norm(np.atleast_2d(value) - block.nominal * np.eye(block.n_outputs, block.n_inputs), 2)
    return f"{value:.4g} of size {size:.4g}" if isinstance(value, complex) else f"a matrix of size {size:.4g}"
