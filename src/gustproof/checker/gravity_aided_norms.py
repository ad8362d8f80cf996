"""Upper bounds of the l1 norms of an axis whose law reads tilt: the true angle is a state of its loop.

Part of the check: doubles with bounds of their rounding. The state is that of `kernel_norms` and, last, an angle with
`angle+ = (1 - leak h) angle + integral of the rate + inputs`. For roll and pitch the leak is 0 and it is the true
angle, which the law's tilt is. For yaw it follows the law's own heading; the leak keeps it bounded.

**Tail.** Such a loop settles over minutes. With any invertible T, `M = T^-1 Phi T` and `v = |T^-1 x|`, every z >= 0
with `v + |M| z <= z` is above `sum_k |M|^k v`. So for a signal `s`

    sum_k |s Phi^k x| <= |s T| z.

T holds approximate eigenvectors. Then |M| is nearly the diagonal of moduli, and slow modes lose nothing.

**Rounding** is that of `kernel_norms`: a state is wrong by at most `sum_j S^N(e_j) defect_j`.

References
----------
M. A. Dahleh, I. J. Diaz-Bobillo, Control of Uncertain Systems: A Linear Programming Approach, 1995 (l1 norms).
"""

from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gustproof.checker.kernel_norms import (
    COMMAND,
    OMEGA,
    TORQUE,
    UP,
    X0,
    X1,
    AxisNorms,
    axis_loop,
    check_work,
    sample_map,
    unit_roundings,
)
from gustproof.checker.system import LoopSystem, Refusal

Array = NDArray[np.float64]
ANGLE, OFFSET, TURN, LAG = -8, -7, -6, -5
"""Positions in a box's row of the angle, angle minus x0, its change per time, and mean rate minus x1."""
LEAK = Fraction(1, 16)
"""[1/s] leak of the angle of yaw."""
_ULP = 2.0**-52
_DIVERGED = 1e30
"""Size of a state after a unit input that shows an unstable loop."""
_BLOCK = 1024
"""Samples whose signals are summed up at once."""
_SPARE = 1e-6
"""[-] share of the largest mode that is added to each, so that z is found."""


class GravityAidedNorms(NamedTuple):
    """Upper bounds of an axis's norms for all time."""

    axis: AxisNorms
    """Norms of one cell, to each state, `OFFSET`, `TURN`, `LAG`, then the rate's change, gap and demand.

    A unit of acceleration moves the angle by half a sample's turn too; a unit of excess moves law and angle.
    """
    sums: Array
    """(signals,) sum of moduli after a unit of the angle, without its own sample."""
    changes: Array
    """(signals,) first modulus and total variation of the same response."""


class _Loop(NamedTuple):
    """Loop of an axis in doubles."""

    Phi: Array
    """(m, m) state to next state."""
    inputs: Array
    """(m, m + 3) units of each state, of acceleration, of the excess and of the gyro."""
    signals: Array
    """(m + 6, m) state to signals."""
    sizes: Array
    """(m + 6, m) moduli that were summed up to `signals`; times a rounding they bound its errors."""
    direct: Array
    """(m + 6, m + 3) modulus of what an input of a sample adds to the signals of that sample."""


@lru_cache(maxsize=8)
def gravity_aided_norms(system: LoopSystem, axis: int, samples: int) -> GravityAidedNorms:
    """Return the norms of an axis of a law that reads tilt, from a simulation of `samples`.

    Raises
    ------
    Refusal
        If the loop is unstable, or its slow modes are not separated.
    """
    check_work(system, samples)
    loop = _make_loop(system, axis)
    total, change, peak, x = _simulate(loop, samples)
    m, first = len(loop.Phi), np.abs(loop.signals @ loop.inputs)[:, len(loop.Phi) - 1]
    worst = np.max(peak, axis=1)
    if not np.max(worst) < _DIVERGED:
        raise Refusal("the norms have no bound: the loop is unstable")
    defect = unit_roundings(loop.Phi[None], worst[None])[0]
    if not np.sum(defect) * (samples + 1) < 0.4:
        raise Refusal("rounding spoils the norms: the loop is unstable")
    wrong = 2.0 * UP * (total[:, :m] @ defect)  # of a signal, at any sample
    own = (m + 16) * _ULP * (loop.sizes @ worst)  # of the sum that makes the signal
    error = (samples + 1) * (wrong + own)
    modes = _settle(loop.Phi, np.abs(x), x, wrong[:m])
    grown = 1.0 + 2.0 * samples * _ULP
    rest = _reach(loop.signals, loop.sizes, modes)
    whole = UP * (grown * UP * total + error[:, None] + rest + loop.direct)
    moves = loop.signals @ loop.Phi - loop.signals
    moved = _reach(moves, loop.sizes @ np.abs(loop.Phi) + loop.sizes, modes)[:, m - 1]
    changes = UP * (grown * UP * (first + change) + 2.0 * error + moved)
    sums = UP * (grown * UP * total[:, m - 1] + error + rest[:, m - 1])
    entries = whole[:, :m].copy()
    entries[:, OMEGA] = whole[:, m]
    cells = [1.0 / float(value) for value in (system.inertia[axis], system.lag)]
    inertia, lag = (np.array([[value, 8.0 * _ULP * value]]) for value in cells)
    norms = AxisNorms(
        entries[None], whole[None, :, m + 1], whole[None, :, m + 2], np.zeros((1, len(whole))), inertia, lag, 0.0
    )
    return GravityAidedNorms(norms, sums, changes)


def _make_loop(system: LoopSystem, axis: int) -> _Loop:
    """Return the closed loop of one axis over a sample, with its true angle as the last state."""
    if system.tilt is None:
        raise Refusal("the law reads no tilt")
    h, inverse = float(system.dt), 1.0 / float(system.inertia[axis])
    own = range(axis, len(system.A), 3)
    inner, gyro = axis_loop(system, axis, np.array([inverse]), np.array([1.0 / float(system.lag)]))
    m = inner.shape[1] + 1
    Phi = np.zeros((m, m))
    Phi[:-1, :-1] = inner[0]
    turned = sample_map(system, axis, 1.0 / float(system.lag))[3]
    Phi[-1, OMEGA], Phi[-1, TORQUE], Phi[-1, COMMAND] = turned[0], inverse * turned[1], inverse * turned[2]
    mean = Phi[-1] / h
    Phi[-1, -1] = 1.0
    if axis < 2:
        Phi[COMMAND, -1] = float(system.tilt.D[axis][axis])
        Phi[X0:-1, -1] = [float(system.tilt.B[i][axis]) for i in own]
    else:
        Phi[-1, -1] -= float(LEAK) * h
    inputs = np.zeros((m, m + 3))
    inputs[:, :m] = np.eye(m)
    inputs[OMEGA, m], inputs[-1, m] = 1.0, 0.5 * h
    inputs[X0:-1, m + 1], inputs[-1, m + 1] = [float(system.G[i][axis]) for i in own], h
    inputs[:-1, m + 2] = gyro[0]
    unit = np.eye(m)
    offset = unit[-1] - unit[X0]
    rows = [offset, (offset @ Phi - offset) / h, mean - unit[X1], Phi[OMEGA] - unit[OMEGA]]
    sizes = [np.abs(offset), (np.abs(offset) @ np.abs(Phi) + np.abs(offset)) / h, np.abs(mean) + unit[X1]]
    sizes += [np.abs(Phi[OMEGA]) + unit[OMEGA]]
    rows += [unit[COMMAND] - unit[TORQUE], unit[COMMAND]]
    sizes += [unit[COMMAND] + unit[TORQUE], unit[COMMAND]]
    direct = np.zeros((m + 6, m + 3))
    direct[m + 1] = np.abs(offset @ inputs) / h * UP
    direct[m + 2, m] = 0.5
    return _Loop(Phi, inputs, np.vstack([unit, rows]), np.vstack([unit, sizes]), direct)


def _simulate(loop: _Loop, samples: int) -> tuple[Array, Array, Array, Array]:
    """Return sums of moduli, sums of changes after a unit of the angle, largest moduli of states, and the last ones."""
    m, x = len(loop.Phi), loop.inputs
    states, before = np.empty((min(samples, _BLOCK), *x.shape)), loop.signals @ x
    total, change, peak = np.zeros_like(before), np.zeros(len(before)), np.zeros_like(x)
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, samples, _BLOCK):
            block = states[: samples - start]
            for k in range(len(block)):
                block[k] = x
                x = loop.Phi @ x
            signals = loop.signals @ block
            peak = np.maximum(peak, np.max(np.abs(block), axis=0))
            angle = np.concatenate([before[None, :, m - 1], signals[:, :, m - 1]])
            change += np.sum(np.abs(np.diff(angle, axis=0)), axis=0)
            before = signals[-1]
            total += np.sum(np.abs(signals), axis=0)
        change += np.abs((loop.signals @ x - before)[:, m - 1])
    return total, change, peak, x


class _Modes(NamedTuple):
    """Bound of all that follows from the last states."""

    basis: Array
    """(m, m) T, complex."""
    sums: Array
    """(m, columns) z: sums of moduli of the modes over all later samples."""


def _settle(Phi: Array, sizes: Array, x: Array, wrong: Array) -> _Modes:
    """Return the modes of x+ = Phi x, and bounds of the sums of their sizes over all samples from states x on.

    The states (m, k) are those of k responses after the simulated samples. The true ones are within `wrong` (m,) of
    them, and `sizes` is |x|.

    Raises
    ------
    Refusal
        If no sums are found: the loop is unstable, or its modes are not separated.
    """
    m = len(Phi)
    basis = np.linalg.eig(Phi)[1]
    try:
        inverse = np.linalg.inv(basis)
    except np.linalg.LinAlgError:
        raise Refusal("the loop's modes are not separated") from None
    one = 16.0 * (m + 16) * _ULP  # a complex product of m terms, some times over
    size, left = np.abs(basis), np.abs(inverse)
    off = np.abs(np.eye(m) - inverse @ basis) + one * (left @ size)
    share = UP * np.max(np.sum(off, axis=1))  # of the largest mode by which `inverse` is wrong
    if not share < 0.25:
        raise Refusal("the loop's modes are not separated")
    step = np.abs(inverse @ (Phi @ basis)) + one * (left @ (np.abs(Phi) @ size))
    step = UP * (step + 2.0 * share * np.max(step, axis=0))
    start = np.abs(inverse @ x) + one * (left @ sizes) + (left @ wrong)[:, None]
    start = UP * (start + 2.0 * share * np.max(start, axis=0))
    spare = start + _SPARE * np.max(start, axis=0)
    sums = np.linalg.solve(np.eye(m) - step, spare)
    if not (np.all(sums >= 0.0) and np.all(UP * (start + step @ sums) <= sums)):
        raise Refusal("the norms have no bound: the loop is unstable")
    return _Modes(basis, sums)


def _reach(signals: Array, sizes: Array, modes: _Modes) -> Array:
    """Return bounds (signals, columns) of the sums of all later moduli of signals, see `_Loop` for `sizes`."""
    one = 16.0 * (len(modes.basis) + 16) * _ULP
    seen = np.abs(signals @ modes.basis) + one * (sizes @ np.abs(modes.basis))
    reach: Array = UP * (seen @ modes.sums)
    return reach
