"""Quasi-Newton search on a function with a gradient almost everywhere: BFGS with a weak Wolfe line search.

Where several branches of a maximum are active, BFGS represents their crease as a large curvature and moves along it.
Finally all nearly active branches are lowered at once, by steps from a small quadratic program in the metric of BFGS.
"""

import math
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from gustproof.robust.lti.state_space import Matrix

_ARMIJO, _WOLFE = 1e-4, 0.5
_WEIGHT_STEPS = 300
_HALVINGS = 30
"""Largest number of steps of a line search; each halves or doubles."""
_STALL = 20
"""Number of steps over which progress is measured."""
_CYCLES, _JOINT_STEPS = 6, 120
_FIRST_STEP, _LEAST_SHARE = 0.1, 1e-3
"""[-] relative size of the first step, and part of the largest parameter as which smaller ones count in it."""
_NEAR = 0.05
"""[-] branches within this fraction of the largest are lowered together."""
_CYCLE_GAIN = 1e-4
"""[-] relative progress of a cycle below which no other follows."""


class Branch(NamedTuple):
    """Value and gradient of one branch of a maximum."""

    value: float
    """[-] value."""
    gradient: Matrix
    """(size,) gradient."""


class Function(Protocol):
    """Largest of some branches, each smooth in the parameters theta (size,); what `minimize` makes small."""

    def value(self, theta: Matrix) -> float:
        """Return the value; infinite where it is not defined."""

    def branches(self, theta: Matrix, near: float) -> list[Branch]:
        """Return the branches within the fraction `near` of the largest, the largest first."""


STEPPED: ContextVar[Callable[[float], None]] = ContextVar("STEPPED", default=lambda _: None)
"""Hears the value before each step: one step of a large problem takes seconds, and a search hundreds."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Minimum:
    """Local minimum that `minimize` found."""

    theta: Matrix
    """(size,) parameters."""
    value: float
    """[-] value of the function."""


def minimize(
    function: Function,
    theta: Matrix,
    *,
    steps: int,
    tolerance: float = 1e-6,
    stop_below: float = -np.inf,
    relative: bool = False,
) -> Minimum:
    """Return a local minimum near `theta`, where the function must be finite; never a higher value.

    Each cycle takes BFGS steps on the largest branch, then steps that lower all nearly active ones. Cycles repeat until
    neither kind helps.

    Parameters
    ----------
    function
        Function to minimise.
    theta
        (size,) initial parameters.
    steps
        Largest number of BFGS steps in a cycle.
    tolerance
        [-] relative progress in 20 steps below which a series of steps ends.
    stop_below
        Value below which the search stops.
    relative
        True to measure the first steps by relative changes of the parameters, which may be of very different sizes.

    References
    ----------
    A. S. Lewis, M. L. Overton, Nonsmooth optimization via quasi-Newton methods, Mathematical Programming 141 (2013),
    135-163. P. Apkarian, D. Noll, Nonsmooth H-infinity synthesis, IEEE TAC 51 (2006), 71-86.
    """
    least, value = np.inf, function.value(theta)
    stops = tolerance, stop_below
    for _ in range(_CYCLES):
        theta, value, metric = _bfgs(function, theta, value, steps, stops, relative=relative)
        theta, value, _ = _bfgs(function, theta, value, _JOINT_STEPS, stops, relative=relative, metric=metric)
        if value <= stop_below or least - value <= _CYCLE_GAIN * abs(value):
            break
        least = value
    return Minimum(theta=theta, value=value)


def _bfgs(
    function: Function,
    theta: Matrix,
    value: float,
    steps: int,
    stops: tuple[float, float],
    *,
    relative: bool,
    metric: Matrix | None = None,
) -> tuple[Matrix, float, Matrix]:
    """Return parameters, value and metric after quasi-Newton steps on the largest branch.

    With the `metric` of steps before, all nearly active branches are lowered together instead. A metric that has become
    stale is replaced by each of the two first ones in turn. `stops` are the tolerance and the value that end it.
    """
    tolerance, stop_below = stops
    history, near = [value], 0.0 if metric is None else _NEAR
    branches, fresh = function.branches(theta, near), int(metric is None)  # first metrics tried in turn
    W = _first_metric(theta, branches, relative=relative) if metric is None else metric
    for _ in range(steps):
        STEPPED.get()(value)
        if value <= stop_below or not branches:
            break
        gradient = _combine_gradients(branches, W)
        direction = -W @ gradient
        found = _weak_wolfe(function, theta, value, direction, gradient, stop_below)
        if found is None:
            if fresh == 2:
                break
            W, fresh = _first_metric(theta, branches, relative=relative == (fresh == 0)), fresh + 1
            continue
        length, value, reached = found
        theta = theta + length * direction
        branches = function.branches(theta, near) if near or not reached else reached
        if branches:
            W = _update_metric(W, length * direction, _combine_gradients(branches, W) - gradient, fresh=fresh > 0)
        fresh = 0
        history.append(value)
        if len(history) > _STALL and history[-1 - _STALL] - value <= tolerance * abs(value):
            break
    return theta, value, W


def _first_metric(theta: Matrix, branches: list[Branch], *, relative: bool) -> Matrix:
    """Return the identity, or a metric in which the first step changes the parameters by a tenth of themselves."""
    squares = theta**2 + (_LEAST_SHARE * np.max(np.abs(theta))) ** 2
    slope = float(branches[0].gradient @ (squares * branches[0].gradient)) if branches else 0.0
    return np.diag(_FIRST_STEP / np.sqrt(slope) * squares) if relative and slope > 0.0 else np.eye(theta.size)


def _weak_wolfe(
    function: Function, theta: Matrix, value: float, direction: Matrix, gradient: Matrix, stop_below: float
) -> tuple[float, float, list[Branch]] | None:
    """Return a step length, the value and, if known, the branch there, or `None` if none lowers the function enough.

    A value at `stop_below` ends it: a growth that falls for ever must not carry the parameters away.
    """
    slope = float(gradient @ direction)
    if not slope < 0.0:
        return None
    low, high, length = 0.0, np.inf, 1.0
    best: tuple[float, float, list[Branch]] | None = None
    for _ in range(_HALVINGS):
        trial = theta + length * direction
        reached = function.value(trial)
        if not reached <= value + _ARMIJO * length * slope:
            high = length
        else:
            if reached <= stop_below:
                return length, reached, []
            branches = function.branches(trial, 0.0)
            best = length, reached, []
            if not branches or float(branches[0].gradient @ direction) >= _WOLFE * slope:
                return length, reached, branches
            low = length
        length = 0.5 * (low + high) if math.isfinite(high) else 2.0 * low
    return best


def _update_metric(W: Matrix, s: Matrix, y: Matrix, *, fresh: bool) -> Matrix:
    """Return the inverse Hessian after a step `s` with a change `y` of the gradient."""
    curvature = float(s @ y)
    if curvature <= 1e-14 * float(np.linalg.norm(s) * np.linalg.norm(y)):
        return W
    if fresh:
        W = curvature / float(y @ W @ y) * W
    Wy = W @ y
    parallel = (1.0 + float(y @ Wy) / curvature) * np.outer(s, s) / curvature
    return np.asarray(W + parallel - (np.outer(s, Wy) + np.outer(Wy, s)) / curvature)


def _combine_gradients(branches: list[Branch], W: Matrix) -> Matrix:
    """Return the convex combination g of gradients with the steepest step `-W g` for the largest linearised branch."""
    if len(branches) == 1:
        return branches[0].gradient
    values = np.array([branch.value for branch in branches])
    G = np.stack([branch.gradient for branch in branches])
    Q, gap = G @ W @ G.T, values[0] - values
    return np.asarray(_simplex_minimum(Q, gap) @ G)


def _simplex_minimum(Q: Matrix, gap: Matrix) -> Matrix:
    """Return convex weights x that minimise `x^T Q x / 2 + gap^T x`, Q semidefinite, by pairwise Frank-Wolfe steps."""
    x = np.zeros(gap.size)
    x[0] = 1.0
    for _ in range(_WEIGHT_STEPS):
        slope = Q @ x + gap
        towards, away = int(slope.argmin()), int(np.where(x > 0.0, slope, -np.inf).argmax())
        if slope[away] - slope[towards] <= 1e-9 * (abs(slope[away]) + abs(slope[towards])):
            break
        # weight moves from the worst vertex in use to the best one
        curvature = Q[towards, towards] - 2.0 * Q[towards, away] + Q[away, away]
        shift = min(x[away], (slope[away] - slope[towards]) / curvature if curvature > 0.0 else np.inf)
        x[towards] += shift
        x[away] -= shift
    return x
