"""Gains of least attitude error in turbulence, for laws of any structure at the same price.

The price is a sensitivity peak of each axis and a torque slew pooled over the axes: what makes laws comparable.
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
"""Frequencies, evenly spaced in the logarithm, at which the search keeps the sensitivity peak."""
_GRID_MARGIN = 1e-3
"""[-] share of the peak kept back for what the sensitivity may rise between two frequencies of the grid."""
_PEAK_TOLERANCE = 1e-2
"""[-] relative excess of the peak below which it is put down to what lies between two frequencies."""
_ROUNDS = 3
"""Searches, each with what the one before missed between two frequencies kept back too."""
_ROUNDING = 1e-6
"""[-] share of the slew kept back, because the search meets a limit to rounding only."""

AxisBuilder = Callable[[list[float], AxisModel], AxisLaw]
"""The law of one axis for the values of its gains."""


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
        The axes, in the turbulence to be tuned for.
    axis
        Makes the law of an axis of positive gains.
    start
        Gains to start from, the same for each axis.
    name
        What the structure is called in a refusal.
    sensitivity_peak
        [-] largest sensitivity peak of each axis.
    slew
        [N*m/s] largest rms torque slew, pooled over the axes.

    Raises
    ------
    DesignError
        If no such gains are found: the demands are too tight for this vehicle.
    """
    best, kept = [list(start)] * len(models), sensitivity_peak * (1.0 - _GRID_MARGIN)
    for _ in range(_ROUNDS):
        best = _minimize(models, axis, best, kept, slew)
        figures = [axis_performance(model, axis(gains, model)) for model, gains in zip(models, best, strict=True)]
        worst = max(each.sensitivity_peak for each in figures)
        pooled = math.sqrt(np.mean([each.slew**2 for each in figures]))
        if worst <= sensitivity_peak and pooled <= slew:
            return best
        if worst > (1.0 + _PEAK_TOLERANCE) * sensitivity_peak:
            break
        kept *= sensitivity_peak / worst * (1.0 - _ROUNDING)
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

    @cache  # a gain concerns one axis, and error and margins are asked for at the same gains
    def judged(k: int, gains: tuple[float, ...]) -> tuple[float, float, Matrix]:
        controller = axis(list(gains), models[k]).controller(dt)
        difference = np.abs(1.0 - controller.response(omega)[:, 0, 0] * responses[k])
        return *rms(models[k], controller), np.log(difference) + math.log(peak)

    def each(z: Matrix) -> list[tuple[float, float, Matrix]]:
        return [judged(k, tuple(gains)) for k, gains in enumerate(_unpack_gains(z, n))]

    def error(z: Matrix) -> float:
        return 0.5 * math.log(sum(rmse**2 for rmse, _, _ in each(z)) / n)

    def margins(z: Matrix) -> Matrix:
        spent = 0.5 * math.log(sum(slew**2 for _, slew, _ in each(z)) / n)
        room = np.concatenate([room for _, _, room in each(z)])
        return np.append(room, math.log(slew * (1.0 - _ROUNDING)) - spent)

    room = scipy.optimize.NonlinearConstraint(margins, 0.0, np.inf)
    bounds = [(math.log(1e-3), math.log(1e4))] * np.size(start)
    found = scipy.optimize.minimize(
        error, np.log(start).ravel(), method="SLSQP", bounds=bounds, constraints=room,
        options={"maxiter": 300, "ftol": 1e-9},
    )  # fmt: skip
    return _unpack_gains(found.x, n)


def _unpack_gains(z: Matrix, axes: int) -> list[list[float]]:
    gains: list[list[float]] = np.exp(z).reshape(axes, -1).tolist()
    return gains
