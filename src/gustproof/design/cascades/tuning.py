"""Gains of least attitude error in turbulence, for laws of any structure within the same limits.

The limits are a sensitivity peak of each axis and a torque slew pooled over the axes. They make laws comparable.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields, replace
from functools import cache
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import scipy

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.types import AXES
from gustproof.airframe.covariance import AxisModel, axis_models, axis_performance, pool_axes, rms
from gustproof.errors import DesignError
from gustproof.law.cascade import AxisLaw
from gustproof.law.form import Matrix
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.uncertain.uncertainty import Spreads

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_GRID = 200
"""Number of frequencies, evenly spaced in the logarithm, at which the sensitivity peak is constrained."""
_GRID_MARGIN = 1e-3
"""[-] share of the peak reserved for a rise of the sensitivity between two frequencies of the grid."""
_PEAK_TOLERANCE = 5e-2
"""[-] relative excess of the peak below which it is attributed to the space between two frequencies. With more, or
so much more slew, the search has failed."""
_ROUNDS = 5
"""Number of searches, each tightened by the excess of the previous one between two frequencies."""
_ROUNDING = 1e-6
"""[-] share of the slew reserved, because the search satisfies a limit up to rounding only."""
_BOUNDS = (1e-3, 1e4)
"""Least and largest gain, in their units, if there are no others."""
_UNSTABLE = 1e6
"""[rad] and [N*m/s] error and slew of a loop whose covariance overflows."""
SLOWER = (1.0, 0.6, 0.35)
"""[-] speeds of the starts, over `loop_speed`, tried in this order."""

Record = TypeVar("Record", bound="DataclassInstance")
AxisBuilder = Callable[[Sequence[float], AxisModel], AxisLaw]
AxisModels = Sequence[AxisModel]
"""One axis: nominal, then off nominal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TuningLimits:
    """Limits of sensitivity and slew."""

    sensitivity_peak: float = 1.36
    """[-] largest sensitivity peak of each axis."""
    slew: float = 19.9
    """[N*m/s] largest rms torque slew, pooled over the axes."""
    corner_peak: float = math.inf
    """[-] largest sensitivity peak of the vehicles off nominal."""
    delay_samples: int = 0
    """[samples] from a measurement to its command's action, up to which each axis stays stable; 0: no such limit."""
    gain: float = 1.0
    """[-] factor on the loop gain up to which each axis stays stable; 1: no such limit."""

    def parameters(self) -> dict[str, float]:
        """Return the limits that are set, for a law's provenance."""
        return {
            "sensitivity_peak": self.sensitivity_peak,
            "slew_nm_per_s": self.slew,
            **({"off_nominal_sensitivity_peak": self.corner_peak} if math.isfinite(self.corner_peak) else {}),
            **({"stable_delay_samples": self.delay_samples} if self.delay_samples else {}),
            **({"stable_gain": self.gain} if self.gain > 1.0 else {}),
        }


FAIR_LIMITS = TuningLimits()
"""Limits of the laws `pid-fair` and `indi`. The slew keeps single flights, with their scatter, below 20."""
SPREADS = Spreads(inertia=0.2, actuator_lag=0.3)
"""Box of inertia and actuator lag where nothing is known."""


def corner_vehicles(vehicle: Vehicle, spreads: Spreads) -> list[Vehicle]:
    """Return the vehicles with all inertias and the lag at the ends of their ranges."""
    ends = []
    for heavier in (-spreads.inertia, spreads.inertia):
        I_x, I_y, I_z = ((1.0 + heavier) * inertia for inertia in vehicle.inertia_B)
        for slower in (-spreads.actuator_lag, spreads.actuator_lag):
            lag = (1.0 + slower) * vehicle.actuator_lag
            ends.append(replace(vehicle, inertia_B=(I_x, I_y, I_z), actuator_lag=lag))
    return ends


def models_of_axes(vehicle: Vehicle, corners: Sequence[Vehicle], scenario: Scenario) -> list[AxisModels]:
    """Return roll, pitch and yaw in the scenario's turbulence, each nominal and then at every corner."""
    return list(zip(*(axis_models(each, scenario) for each in (vehicle, *corners)), strict=True))


def loop_speed(vehicle: Vehicle, scenario: Scenario) -> float:
    """Return how fast [-] loops on this vehicle can be, 1 for lag and delay of the vehicle `paper`.

    The starts of all searches are stated for that vehicle. Speeds are inversely proportional to lag and delay.
    """
    return (0.05 + 0.004) / (vehicle.actuator_lag + scenario.delay_samples * scenario.dt)


def tune(
    axes: Sequence[AxisModels],
    build: Callable[[Record, AxisModel], AxisLaw],
    starts: Iterable[Record],
    name: str,
    limits: TuningLimits,
    bounds: tuple[Record, Record] | None = None,
) -> list[Record]:
    """Return the gains of each axis with the least attitude error, pooled over the axes.

    Sequential quadratic programming (SLSQP) on the logarithms of all gains, from each of `starts` until one leads to
    gains within the limits. A start is a dataclass of positive numbers, for each axis. `build` makes the law of an axis
    from its gains and its model in turbulence. Delay and gain in the limits are not used. `bounds` are the least and
    the largest gains, by default very small and very large ones.

    The optimum is local. The peak is constrained at a grid of frequencies, which may split one flat optimum into
    several. Rounding, which differs between processors, chooses one: INDI has gains 7 % apart, errors .02 %.

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle. Its text calls the structure `name`.
    """
    found = ""
    for start in starts:
        result, found = _tune_from(axes, build, start, limits, bounds)
        if result is not None:
            return result
    peak, slew = limits.sensitivity_peak, limits.slew
    raise DesignError(f"no {name} found at sensitivity peak {peak} and slew {slew} N*m/s: {found}")


def _tune_from(
    axes: Sequence[AxisModels],
    build: Callable[[Record, AxisModel], AxisLaw],
    start: Record,
    limits: TuningLimits,
    bounds: tuple[Record, Record] | None,
) -> tuple[list[Record] | None, str]:
    """Return the gains from one start, `None` if they are not within the limits, and how far they came."""

    def gains_of(values: Sequence[float]) -> Record:
        return replace(start, **{field.name: value for field, value in zip(fields(start), values, strict=True)})

    def axis(values: Sequence[float], model: AxisModel) -> AxisLaw:
        return build(gains_of(values), model)

    widths = [*zip(*map(astuple, bounds), strict=True)] if bounds else [_BOUNDS] * len(fields(start))
    best, peak = [list(astuple(start))] * len(axes), limits.sensitivity_peak * (1.0 - _GRID_MARGIN)
    for _ in range(_ROUNDS):
        with np.errstate(all="ignore"):  # a search passes unstable loops
            best = _minimize(axes, axis, best, replace(limits, sensitivity_peak=peak), widths)
            found = [axis_performance(model, axis(gains, model)) for (model, *_), gains in zip(axes, best, strict=True)]
        worst, (_, pooled) = max(each.sensitivity_peak for each in found), pool_axes(found)
        if worst <= limits.sensitivity_peak and pooled <= limits.slew:
            return [gains_of(values) for values in best], ""
        if not max(worst / limits.sensitivity_peak, pooled / limits.slew) <= 1.0 + _PEAK_TOLERANCE:
            break
        peak *= limits.sensitivity_peak / worst * (1.0 - _ROUNDING)
    return None, f"the best had {worst:.4g} and {pooled:.4g}" if math.isfinite(worst) else "the best is unstable"


def _rms(model: AxisModel, controller: Lti) -> tuple[float, float]:
    """Return error and slew as `rms` does; large ones of an unstable loop."""
    try:
        error, slew = rms(model, controller)
    except ValueError:
        return _UNSTABLE, _UNSTABLE
    return error if error < _UNSTABLE else _UNSTABLE, slew if slew < _UNSTABLE else _UNSTABLE


def _minimize(
    axes: Sequence[AxisModels],
    axis: AxisBuilder,
    start: Sequence[Sequence[float]],
    limits: TuningLimits,
    bounds: Sequence[tuple[float, float]],
) -> list[list[float]]:
    models = [model for model, *_ in axes]
    dt, n, slew = models[0].plant.dt, len(axes), limits.slew
    omega = np.geomspace(1.0, 0.999 * math.pi / dt, _GRID)
    responses = [
        np.array([m.plant.response(omega)[:, 0, 0] * np.exp(-1j * omega * dt * m.delay_samples) for m in each])
        for each in axes
    ]
    peaks = np.log([[limits.sensitivity_peak], *[[limits.corner_peak]] * (len(axes[0]) - 1)])

    @cache  # a gain affects one axis, and the search evaluates error and margins at the same gains
    def evaluate(k: int, gains: tuple[float, ...]) -> tuple[float, float, Matrix]:
        try:
            controller = axis(list(gains), models[k]).controller(dt)
        except DesignError:  # a synthesis that has no solution at these values
            return _UNSTABLE, _UNSTABLE, np.full(responses[k].size, -math.log(_UNSTABLE))
        difference = np.abs(1.0 - controller.response(omega)[:, 0, 0] * responses[k])
        return *_rms(models[k], controller), (np.log(difference) + peaks).ravel()

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
        bounds=[(math.log(low), math.log(high)) for low, high in bounds] * n,
        constraints=constraint,
        options={"maxiter": 150, "ftol": 1e-9},
    )
    gains: list[list[float]] = np.exp(found.x).reshape(n, -1).tolist()
    return gains


def axis_parameters(gains: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the gains of roll, pitch and yaw by axis and name, for a law's provenance."""
    axes = zip(AXES, gains, strict=True)
    return {f"{axis}_{name}": value for axis, values in axes for name, value in values.items()}
