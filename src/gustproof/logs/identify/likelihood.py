"""Maximum likelihood of the rate model by Fisher scoring; actuator lag and delay are shared by the axes.

Flights are closed loops: the command answers the disturbance, so regression on it alone is biased. Prediction errors
of a model with its own disturbance are not, if that has the right shape (Ljung, System Identification, 1999, 13.4).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from gustproof.logs.identify.rate_response import Indices, prediction_errors
from gustproof.logs.identify.stretches import Stretch
from gustproof.types import Array

LAG, DELAY, DAMPING, NOISE, SLOW, SLOW_DRIVE, FAST, FAST_DRIVE, GAINS = range(9)
"""Places of an axis' parameters: logarithms apart from delay, damping and gains."""
DAMPING_PRIOR = 2.0
"""[1/s] standard deviation of the damping before the flight: rotors' drag gives 0 to 3. A slow lag under weak
excitation can't be told from damping otherwise: both are poles."""
DELAY_PRIOR = (0.008, 0.008)
"""[s] mean and standard deviation of the delay before the flight: output drivers and speed controllers take 1 to 20 ms.
Slow or sparse samples show the sum of lag and delay, not which is which."""
SHARED = 2
"""First parameters of an axis, which all axes share."""
HIGHEST_DAMPING = 25.0
"""[1/s] no fit goes beyond; one that ends there has found no multirotor."""
_LOW = np.array([np.log(0.001), -0.01, 0.0, -40.0, np.log(0.02), -40.0, np.log(4.0), -40.0])
_HIGH = np.array([np.log(0.4), 0.12, HIGHEST_DAMPING, 5.0, np.log(40.0), 30.0, np.log(200.0), 35.0])
_REACH = np.array([0.5, 0.02, 2.0, 2.0, 1.0, 2.0, 1.0, 2.0])  # of one step
_STEP = np.array([1e-4, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])


def at_bound(theta: Array) -> bool:
    """Return whether lag or delay of an axis are at a bound of their search, where that bounds nothing."""
    return bool(theta[DELAY] <= _LOW[DELAY] or np.any(theta[:SHARED] >= _HIGH[:SHARED]))


def is_prompt(theta: Array) -> bool:
    """Return whether an axis shows no lag: the least of the search stands for it, less than any motor has."""
    return bool(theta[LAG] <= _LOW[LAG])


class RatePrediction(NamedTuple):
    """Prediction of an axis under some parameters."""

    response: Array
    """(n, k) of the rate to each channel."""
    errors: Array
    """(n, 1 + k) [rad/s] of predicting the rate, and of predicting each response."""
    variance: Array
    """(n,) [rad^2/s^2] of the rate's errors."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisData:
    """Measurements of one axis."""

    stretches: Sequence[Stretch]
    """Stretches."""
    axis: int
    """Column of the rate."""
    channels: list[int]
    """Columns of the command."""
    square: bool
    """True if the commands are of motors, whose thrust is the square of their speed."""

    @cached_property
    def time(self) -> Array:
        """(n,) [s] of all bins."""
        return np.concatenate([s.time for s in self.stretches])

    @cached_property
    def _count(self) -> Array:
        """(n,) gyro samples in each bin."""
        return np.concatenate([s.count for s in self.stretches])

    @cached_property
    def _start(self) -> Array:
        """(n,) 1 where a stretch begins."""
        return np.concatenate([np.arange(len(s.time)) == 0 for s in self.stretches]).astype(np.float64)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return GAINS + len(self.channels)

    def response(self, theta: Array) -> Array:
        """Return the rate's response (n, k) to each channel."""
        model = np.array([np.exp(theta[LAG]), theta[DELAY], theta[DAMPING]])
        return np.concatenate([s.response(self.channels, model, square=self.square) for s in self.stretches])

    @cached_property
    def rate(self) -> Array:
        """(n,) [rad/s] measured."""
        return np.concatenate([s.rate[:, self.axis] for s in self.stretches])

    def subtract(self, response: Array, gains: Array) -> Array:
        """Return the measured rate (n, 1) [rad/s] less the `response` (n, k) to the channels times their gains (k,)."""
        return np.asarray(self.rate - response @ gains)[:, None]

    def predict(self, theta: Array) -> RatePrediction:
        """Return the prediction under `theta`."""
        response = self.response(theta)
        return RatePrediction(response, *self.predict_signals(theta, np.column_stack([self.rate, response])))

    def predict_signals(self, theta: Array, signals: Array) -> tuple[Array, Array]:
        """Return the errors (n, k) of predicting signals (n, k) under `theta`, and their variance (n,)."""
        signals = np.ascontiguousarray(signals)  # for another layout the kernel would be compiled anew
        errors, variance = np.empty_like(signals), np.empty(len(signals))
        model = np.array([theta[DAMPING], *np.exp(theta[NOISE:GAINS])])
        state = np.empty((3, signals.shape[1]))
        prediction_errors(self.time, self._count, self._start, signals, model, state, errors, variance)
        errors[self._start != 0.0] = 0.0
        return errors, variance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Linear:
    """Errors of one axis and their derivatives."""

    error: Array
    """(n,) [rad/s]."""
    variance: Array
    """(n,) [rad^2/s^2]."""
    d_error: Array
    """(n, p) by each parameter."""
    d_variance: Array
    """(n, p) by each parameter."""

    @property
    def scores(self) -> Array:
        """(n, p) derivatives of the log likelihood of each sample."""
        weight = 0.5 * (self.error**2 / self.variance - 1.0) / self.variance
        return -self.d_error * (self.error / self.variance)[:, None] + self.d_variance * weight[:, None]

    @property
    def information(self) -> Array:
        """(p, p) Fisher's information."""
        error, variance = self.d_error / np.sqrt(self.variance)[:, None], self.d_variance / self.variance[:, None]
        return np.asarray(error.T @ error + 0.5 * variance.T @ variance)


def axis_cost(theta: Array, found: RatePrediction) -> float:
    """Return minus the log likelihood of an axis predicted under `theta`, with the prior."""
    error = found.errors[:, 0] - found.errors[:, 1:] @ theta[GAINS:]
    prior = (theta[DAMPING] / DAMPING_PRIOR) ** 2
    return 0.5 * float(np.sum(np.log(found.variance) + error**2 / found.variance) + prior)


def _shared_cost(theta: Array) -> float:
    """Return minus the logarithm of the prior of what all axes share."""
    mean, deviation = DELAY_PRIOR
    return 0.5 * float((theta[DELAY] - mean) / deviation) ** 2


def linearise(data: AxisData, theta: Array, found: RatePrediction) -> _Linear:
    """Return errors and derivatives; those by the gains are exact, others forward differences.

    The axis is predicted under `theta`.
    """
    response, errors, variance = found
    gains = theta[GAINS:]
    error, rest = errors[:, 0] - errors[:, 1:] @ gains, data.subtract(response, gains)
    d_error = np.empty((len(error), data.size), order="F")
    d_variance = np.zeros_like(d_error)
    d_error[:, GAINS:] = -errors[:, 1:]
    for i in range(GAINS):
        near = theta.copy()
        near[i] += _STEP[i]
        moved = rest if i > DAMPING else data.subtract(data.response(near), gains)
        its_error, its_variance = data.predict_signals(near, moved)
        d_error[:, i] = (its_error[:, 0] - error) / _STEP[i]
        d_variance[:, i] = (its_variance - variance) / _STEP[i]
    return _Linear(error=error, variance=variance, d_error=d_error, d_variance=d_variance)


def solve_gains(data: AxisData, theta: Array) -> Array:
    """Return `theta` with the gains that fit best under its other parameters."""
    _, errors, variance = data.predict(theta)
    weighted = errors / np.sqrt(variance)[:, None]
    gains = np.linalg.lstsq(weighted[:, 1:], weighted[:, 0], rcond=None)[0]
    return np.concatenate([theta[:GAINS], gains])


def places(axes: Sequence[AxisData]) -> list[Indices]:
    """Return the place of each axis' parameters in the vector of all."""
    ends = np.cumsum([SHARED, *(data.size - SHARED for data in axes)])
    return [np.concatenate([np.arange(SHARED), np.arange(a, b)]) for a, b in pairwise(ends)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Maximum of the likelihood."""

    theta: Array
    """(p,) lag and delay, then each axis' other parameters."""
    axes: Sequence[AxisData]
    """Data."""
    found: Sequence[RatePrediction]
    """Predictions at the maximum, of each axis."""
    cost: float
    """[-] minus the log likelihood."""
    free: Array
    """(p,) False for parameters at a bound, or held."""

    @cached_property
    def linear(self) -> list[_Linear]:
        """Derivatives at the maximum, of each axis."""
        return _linearise_all(self.axes, self.theta, self.found)

    def axis(self, i: int) -> Array:
        """Return the parameters of an axis."""
        return np.asarray(self.theta[places(self.axes)[i]])

    def information(self) -> Array:
        """Return Fisher's information (p, p)."""
        return _assemble(self.axes, self.linear, self.theta)[1]

    def assumed_delay(self) -> float:
        """Return the share [-] of the delay's variance before the flight that the flight leaves: at 1 it tells none."""
        at = np.flatnonzero(self.free)
        if DELAY not in at:
            return 0.0
        unit = (at == DELAY).astype(np.float64)
        variance = float(unit @ solve_scaled(self.information()[np.ix_(at, at)], unit))
        return variance / DELAY_PRIOR[1] ** 2


def _linearise_all(axes: Sequence[AxisData], theta: Array, found: Sequence[RatePrediction]) -> list[_Linear]:
    """Return the derivatives of each axis, predicted under the parameters of all."""
    return [linearise(data, theta[at], one) for data, at, one in zip(axes, places(axes), found, strict=True)]


def _assemble(axes: Sequence[AxisData], linear: Sequence[_Linear], theta: Array) -> tuple[Array, Array]:
    """Return score (p,) and information (p, p) of all axes."""
    index = places(axes)
    size = int(index[-1][-1]) + 1
    score, information = np.zeros(size), np.zeros((size, size))
    for at, one in zip(index, linear, strict=True):
        score[at] += one.scores.sum(axis=0)
        score[at[DAMPING]] -= theta[at[DAMPING]] / DAMPING_PRIOR**2
        information[np.ix_(at, at)] += one.information
        information[at[DAMPING], at[DAMPING]] += 1.0 / DAMPING_PRIOR**2
    mean, deviation = DELAY_PRIOR
    score[DELAY] -= (theta[DELAY] - mean) / deviation**2
    information[DELAY, DELAY] += 1.0 / deviation**2
    return score, information


def solve_scaled(H: Array, g: Array, mu: float = 1e-9) -> Array:
    """Return `H^-1 g`; H is scaled to a diagonal of one and damped by `mu`, so directions without data stay."""
    scale = np.sqrt(np.diag(H)) + 1e-12
    scaled = (g.T / scale).T
    return np.asarray((np.linalg.solve(H / np.outer(scale, scale) + mu * np.eye(len(H)), scaled).T / scale).T)


def maximise(axes: Sequence[AxisData], theta: Array, *, rounds: int = 40) -> Fit:
    """Return the maximum near `theta`, found by Levenberg's damping of Fisher scoring."""
    index = places(axes)
    low, high = np.full(len(theta), -np.inf), np.full(len(theta), np.inf)
    reach = np.full(len(theta), np.inf)
    for at in index:
        low[at[:GAINS]], high[at[:GAINS]], reach[at[:GAINS]] = _LOW, _HIGH, _REACH

    def evaluate(point: Array) -> tuple[float, list[RatePrediction]]:
        found = [data.predict(point[at]) for data, at in zip(axes, index, strict=True)]
        costs = [axis_cost(point[at], one) for at, one in zip(index, found, strict=True)]
        return sum(costs) + _shared_cost(point), found

    theta, mu, free = np.clip(theta, low, high), 1e-3, np.ones(len(theta), dtype=bool)
    cost, found = evaluate(theta)
    for _ in range(rounds):
        score, information = _assemble(axes, _linearise_all(axes, theta, found), theta)
        free = ~((theta <= low) & (score < 0.0) | (theta >= high) & (score > 0.0))
        H, g = information[np.ix_(free, free)], score[free]
        before = cost
        for _ in range(8):
            step = solve_scaled(H, g, mu)
            trial = theta.copy()
            trial[free] += np.clip(step, -reach[free], reach[free])
            trial = np.clip(trial, low, high)
            its_cost, its_own = evaluate(trial)
            if its_cost < cost:
                theta, cost, found, mu = trial, its_cost, its_own, max(mu / 10.0, 1e-9)
                break
            mu *= 10.0
        if before - cost < 1e-3:
            break
    return Fit(theta=theta, axes=axes, found=found, cost=cost, free=free)
