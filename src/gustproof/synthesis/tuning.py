"""Gains of least attitude error in turbulence, for laws of any structure at the same price.

The price is a sensitivity peak of each axis and a torque slew pooled over the axes: what makes laws comparable.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import scipy.optimize

from gustproof.errors import DesignError
from gustproof.law import Matrix
from gustproof.synthesis.pid import AxisLaw
from gustproof.synthesis.turbulence import AxisModel, axis_figures, rms

_GRID = 200
"""Frequencies, evenly spaced in the logarithm, at which the search keeps the sensitivity peak."""
_BETWEEN = 1e-3
"""[-] share of the peak kept back for what the sensitivity may rise between two frequencies of the grid."""
_ROUNDING = 1e-6
"""[-] share of the slew kept back, because the search meets a limit to rounding only."""

Axis = Callable[[list[float], AxisModel], AxisLaw]
"""The law of one axis for the values of its gains."""


def tune(
    models: Sequence[AxisModel], axis: Axis, start: Sequence[float], name: str, *, sensitivity_peak: float, slew: float
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
    best = _minimized(models, axis, start, sensitivity_peak, slew)
    figures = [axis_figures(model, axis(gains, model)) for model, gains in zip(models, best, strict=True)]
    worst = max(each.sensitivity_peak for each in figures)
    pooled = math.sqrt(np.mean([each.slew**2 for each in figures]))
    if worst > sensitivity_peak or pooled > slew:
        raise DesignError(
            f"no {name} found at sensitivity peak {sensitivity_peak} and slew {slew} N*m/s: "
            f"the best had {worst:.4f} and {pooled:.4f}"
        )
    return best


def _minimized(
    models: Sequence[AxisModel], axis: Axis, start: Sequence[float], peak: float, slew: float
) -> list[list[float]]:
    dt = models[0].plant.dt
    omega = np.geomspace(1.0, 0.999 * math.pi / dt, _GRID)
    responses = [m.plant.response(omega)[:, 0, 0] * np.exp(-1j * omega * dt * m.delay_samples) for m in models]

    def laws(z: Matrix) -> list[AxisLaw]:
        return [axis(gains, model) for gains, model in zip(_gains(z, len(models)), models, strict=True)]

    def figures(z: Matrix) -> tuple[float, float]:
        each = [rms(model, law.controller(dt)) for model, law in zip(models, laws(z), strict=True)]
        rmse, pooled = np.sqrt(np.mean(np.array(each) ** 2, axis=0))
        return math.log(rmse), math.log(pooled)

    def error(z: Matrix) -> float:
        return figures(z)[0]

    def margins(z: Matrix) -> Matrix:
        controllers = [law.controller(dt).response(omega)[:, 0, 0] for law in laws(z)]
        differences = [np.abs(1.0 - K * G) for K, G in zip(controllers, responses, strict=True)]
        room = np.log(np.concatenate(differences)) + math.log(peak * (1.0 - _BETWEEN))
        return np.append(room, math.log(slew * (1.0 - _ROUNDING)) - figures(z)[1])

    room = scipy.optimize.NonlinearConstraint(margins, 0.0, np.inf)
    bounds = [(math.log(1e-3), math.log(1e4))] * (len(start) * len(models))
    found = scipy.optimize.minimize(
        error, np.tile(np.log(start), len(models)), method="SLSQP", bounds=bounds, constraints=room,
        options={"maxiter": 300, "ftol": 1e-9},
    )  # fmt: skip
    return _gains(found.x, len(models))


def _gains(z: Matrix, axes: int) -> list[list[float]]:
    gains: list[list[float]] = np.exp(z).reshape(axes, -1).tolist()
    return gains
