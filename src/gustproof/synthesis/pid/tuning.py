"""Gains of least attitude error in turbulence, for laws of any structure within the same limits.

The limits are a sensitivity peak of each axis and a torque slew pooled over the axes. They make laws comparable.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, fields, replace
from functools import cache
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import scipy.optimize

from gustproof.errors import DesignError
from gustproof.law.cascade import AxisLaw
from gustproof.law.form import Matrix
from gustproof.performance.covariance import AxisModel, axis_performance, pool_axes, rms

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

SENSITIVITY_PEAK, SLEW = 1.36, 19.9
"""[-] and [N*m/s] limits of the shipped laws. The slew keeps single flights, with their scatter, below 20."""
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

Record = TypeVar("Record", bound="DataclassInstance")
AxisBuilder = Callable[[Sequence[float], AxisModel], AxisLaw]


def tune(
    models: Sequence[AxisModel],
    build: Callable[[Record, AxisModel], AxisLaw],
    start: Record,
    name: str,
    *,
    sensitivity_peak: float,
    slew: float,
) -> list[Record]:
    """Return the gains of each axis with the least attitude error, pooled over the axes.

    Sequential quadratic programming (SLSQP) on the logarithms of all gains, from `start` on each axis: a dataclass of
    positive numbers. It finds a local optimum. `build` makes the law of an axis from its gains and its model in
    turbulence. The sensitivity peak [-] of each axis is at most `sensitivity_peak`, the rms torque slew pooled over the
    axes at most `slew` [N*m/s].

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle. Its text calls the structure `name`.
    """

    def gains_of(values: Sequence[float]) -> Record:
        return replace(start, **{field.name: value for field, value in zip(fields(start), values, strict=True)})

    def axis(values: Sequence[float], model: AxisModel) -> AxisLaw:
        return build(gains_of(values), model)

    best, limit = [list(astuple(start))] * len(models), sensitivity_peak * (1.0 - _GRID_MARGIN)
    for _ in range(_ROUNDS):
        best = _minimize(models, axis, best, limit, slew)
        axes = [axis_performance(model, axis(gains, model)) for model, gains in zip(models, best, strict=True)]
        worst, (_, pooled) = max(each.sensitivity_peak for each in axes), pool_axes(axes)
        if worst <= sensitivity_peak and pooled <= slew:
            return [gains_of(values) for values in best]
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
        return [evaluate(k, tuple(gains)) for k, gains in enumerate(np.exp(z).reshape(n, -1).tolist())]

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
    gains: list[list[float]] = np.exp(found.x).reshape(n, -1).tolist()
    return gains


def axis_parameters(gains: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the gains of roll, pitch and yaw by axis and name, for a law's provenance."""
    axes = zip(("roll", "pitch", "yaw"), gains, strict=True)
    return {f"{axis}_{name}": value for axis, values in axes for name, value in values.items()}
