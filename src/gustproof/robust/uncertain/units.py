"""Units of states and channels in which an uncertain system is balanced: no bound depends on those it came in.

A number times the identity, or any matrix of a ball, is the same block of Delta in other units of its channels. Units
are powers of two: a system changes them without rounding, and what is proved in new units is proved in the old ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gustproof.robust.lti.balancing import separating_units, state_units
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix
from gustproof.robust.uncertain.uncertainty import DeltaBlock, RealBlock, columns, rows

_POINTS = 9
"""Frequencies at which channels are compared, from a tenth of the slowest pole to ten times the fastest."""
_LEAST_NOMINAL = 2.0**-20
"""[-] gain at Delta = 0, next to that through Delta, below which it may be rounding and gives no unit."""
_MOST = 200
"""Largest exponent of two of a unit: products of scalings and squares are numbers still."""


class ChannelUnits(NamedTuple):
    """Units of the channels of Delta and of what lies beyond: `M[i, j]` becomes `M[i, j] w[j] / z[i]`."""

    z: Matrix
    """(n_z,) of the inputs of Delta."""
    w: Matrix
    """(n_w,) of the outputs of Delta: those of z where a block is a parameter, or square."""
    output: float
    """[-] unit of all other outputs, in which gains beyond Delta are about 1; other inputs keep theirs."""

    def all_z(self, p: int, output: float) -> Matrix:
        """Return the units (p,) of all outputs of M, of which those beyond Delta have the unit `output`."""
        return np.append(self.z, np.full(p - self.z.size, output))

    def all_w(self, m: int) -> Matrix:
        """Return the units (m,) of all inputs of M."""
        return np.append(self.w, np.ones(m - self.w.size))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Units:
    """Units of a system, each a power of two."""

    x: Matrix
    """(n,) of the states."""
    channels: ChannelUnits
    """Of inputs and outputs."""

    def change(self, M: Lti, *, output: float = 1.0) -> Lti:
        """Return the same system in these units; outputs beyond Delta are in the unit `output`."""
        x, z, w = self.x, self.channels.all_z(M.n_outputs, output), self.channels.all_w(M.n_inputs)
        A, B = M.A * x / x[:, None], M.B * w / x[:, None]
        return Lti(A=A, B=B, C=M.C * x / z[:, None], D=M.D * w / z[:, None], dt=M.dt)


def balance(M: Lti, blocks: tuple[DeltaBlock, ...]) -> Units:
    """Return units in which a continuous system, whose first channels `blocks` close, is balanced.

    Channels are compared by their largest responses on a coarse grid of frequencies. Those beyond the blocks keep their
    units, but for a common one of the outputs: with it, their gain is about 1.
    """
    x = state_units(M)
    speeds = np.abs(M.poles())
    speeds = speeds[speeds > 0.0]
    ends = 0.1 * np.min(speeds, initial=np.inf), 10.0 * np.max(speeds, initial=0.0)
    omega = np.geomspace(*ends, _POINTS) if speeds.size else np.zeros(1)
    states_alone = Lti(A=M.A * x / x[:, None], B=M.B / x[:, None], C=M.C * x, D=M.D)
    channels = channel_units(states_alone.response(omega), blocks)
    first = Units(x=x, channels=channels)
    return Units(x=x * state_units(first.change(M, output=channels.output)), channels=channels)


def channel_units(responses: ComplexMatrix, blocks: tuple[DeltaBlock, ...]) -> ChannelUnits:
    """Return units in which responses (f, p, m) are balanced; each repeat of a parameter has one of its own."""
    z_groups, w_groups = _groups(blocks, columns(blocks)), _groups(blocks, rows(blocks))
    p, m = responses.shape[1:]
    into = [*z_groups, slice(z_groups[-1].stop if z_groups else 0, p)]
    out = [*w_groups, slice(w_groups[-1].stop if w_groups else 0, m)]
    squares = np.abs(responses) ** 2
    by_row = np.stack([squares[:, at].sum(axis=1) for at in into], axis=1)
    each = np.sqrt(np.stack([by_row[:, :, at].sum(axis=2) for at in out], axis=2))
    through_delta = float(np.max(np.sum(each[:, -1, :-1] * each[:, :-1, -1], axis=1)))
    nominal = float(np.max(each[:, -1, -1]))
    output = _power_of_two(nominal if nominal > _LEAST_NOMINAL * through_delta else through_delta)
    sizes = each.max(axis=0)
    sizes[-1] /= output
    units = separating_units(sizes)
    units = np.clip(units[:-1] / units[-1], 2.0**-_MOST, 2.0**_MOST)
    z, w = (
        np.repeat(units, np.array([at.stop - at.start for at in groups], dtype=int)) for groups in (z_groups, w_groups)
    )
    return ChannelUnits(z, w, output)


def _groups(blocks: tuple[DeltaBlock, ...], parts: Sequence[slice]) -> list[slice]:
    """Return the channels that have one unit: those of a full block, and each one of a parameter."""
    found: list[slice] = []
    for block, part in zip(blocks, parts, strict=True):
        single = isinstance(block, RealBlock) or block.repeats > 1
        found += [slice(k, k + 1) for k in range(part.start, part.stop)] if single else [part]
    return found


def _power_of_two(value: float) -> float:
    """Return the nearest power of two; 1 for 0."""
    return float(2.0 ** np.rint(np.log2(value))) if value > 0.0 else 1.0
