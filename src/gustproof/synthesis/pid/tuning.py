"""Gains of least attitude error in turbulence, for laws of any structure within the same limits.

The limits are a sensitivity peak of each axis and a torque slew pooled over the axes. They make laws comparable.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import scipy.optimize

from gustproof.errors import DesignError
from gustproof.law.cascade import AxisLaw
from gustproof.law.form import Matrix
from gustproof.performance.covariance import AxisModel, axis_performance, rms

_GRID = 200
"""Number of frequencies, evenly spaced in the logarithm, at which the sensitivity peak is constrained."""
_GRID_MARGIN = 1e-3
"""[-] share of the peak reserved for a rise of the sensitivity between two frequencies of the grid."""
_PEAK_TOLERANCE = 1e-2
"""[-] relative excess of the peak below which it is attributed to the space between two frequencies."""
_ROUNDS = 3
"""Number of searches, each tightened by the excess of the previous one between two frequencies."""
_ROUNDING = 1e-6
"""[-] share of the slew reserved, because the search satisfies a limit up to rounding only."""

AxisBuilder = Callable[[list[float], AxisModel], AxisLaw]
"""Function from positive gains and the model of an axis to its law."""


def tune(
    models: Sequence[AxisModel],
    axis: AxisBuilder,
    start: Sequence[float],
    name: str,
    *,
    sensitivity_peak: float,
    slew: float,
) -> list[list[float]]:
    """Return the gains of each axis with the least attitude error, pooled over the axes.

    Sequential quadratic programming (SLSQP) on the logarithms of all gains, from one start. It finds a local optimum.

    Parameters
    ----------
    models
        Axes in the turbulence to tune for.
    axis
        Builder of the law of an axis.
    start
        Gains to start from, the same for each axis.
    name
        Name of the structure in the error message.
    sensitivity_peak
        [-] largest sensitivity peak of each axis.
    slew
        [N*m/s] largest rms torque slew, pooled over the axes.

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle.
    """
    best, limit = [list(start)] * len(models), sensitivity_peak * (1.0 - _GRID_MARGIN)
    for _ in range(_ROUNDS):
        best = _minimize(models, axis, best, limit, slew)
        axes = [axis_performance(model, axis(gains, model)) for model, gains in zip(models, best, strict=True)]
        worst = max(each.sensitivity_peak for each in axes)
        pooled = math.sqrt(np.mean([each.slew**2 for each in axes]))
        if worst <= sensitivity_peak and pooled <= slew:
            return best
        if worst > (1.0 + _PEAK_TOLERANCE) * sensitivity_peak:
            break
        limit *= sensitivity_peak / worst * (1.0 - _ROUNDING)
    raise DesignError(
        f"no {name} found at sensitivity peak {sensitivity_peak} and slew {slew} N*m/s: "
        f"the best had {worst:.4f} and {pooled:.4f}"
    )


def _minimize(
    models: Sequence[AxisModel], axis: AxisBuilder, start: Sequence[Sequence[float]], peak: float, slew: float
) -> list[list[float]]:
    dt, n = models[0].plant.dt, len(models)
    omega = np.geomspace(1.0, 0.999 * math.pi / dt, _GRID)
    responses = [m.plant.response(omega)[:, 0, 0] * np.exp(-1j * omega * dt * m.delay_samples) for m in models]

    @cache  # a gain affects one axis, and the search evaluates error and margins at the same gains
    def evaluate(k: int, gains: tuple[float, ...]) -> tuple[float, float, Matrix]:
        controller = axis(list(gains), models[k]).controller(dt)
        difference = np.abs(1.0 - controller.response(omega)[:, 0, 0] * responses[k])
        return *rms(models[k], controller), np.log(difference) + math.log(peak)

    def evaluate_all(z: Matrix) -> list[tuple[float, float, Matrix]]:
        return [evaluate(k, tuple(gains)) for k, gains in enumerate(_unpack_gains(z, n))]

    def error(z: Matrix) -> float:
        return 0.5 * math.log(sum(rmse**2 for rmse, _, _ in evaluate_all(z)) / n)

    def margins(z: Matrix) -> Matrix:
        pooled = 0.5 * math.log(sum(slew**2 for _, slew, _ in evaluate_all(z)) / n)
        room = np.concatenate([room for _, _, room in evaluate_all(z)])
        return np.append(room, math.log(slew * (1.0 - _ROUNDING)) - pooled)

    constraint = scipy.optimize.NonlinearConstraint(margins, 0.0, np.inf)
    found = scipy.optimize.minimize(
        error,
        np.log(start).ravel(),
        method="SLSQP",
        bounds=[(math.log(1e-3), math.log(1e4))] * np.size(start),
        constraints=constraint,
        options={"maxiter": 300, "ftol": 1e-9},
    )
    return _unpack_gains(found.x, n)


def _unpack_gains(z: Matrix, axes: int) -> list[list[float]]:
    gains: list[list[float]] = np.exp(z).reshape(axes, -1).tolist()
    return gains
