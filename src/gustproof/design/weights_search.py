"""Weights of an H-infinity design for a vehicle: the least attitude error in turbulence within given limits."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import scipy

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle, load_vehicle
from gustproof.airframe.covariance import AxisModel, axis_models
from gustproof.airframe.hover import hover_plant, is_stable_at_hover, loop_law
from gustproof.airframe.predict import predict
from gustproof.design.cascades.tuning import TuningLimits
from gustproof.design.derive import make_law, solve_central
from gustproof.design.designs import Design, Weight, design_problem
from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.robust.lti.state_space import Matrix

_SLOWEST, _GRID = 0.03, 300
"""[rad/s] lowest, and number, of the frequencies at which the sensitivity peak is limited."""
_KEPT_BACK = 1e-3
"""[-] share of each limit that the search leaves, for what is between two frequencies."""
_NO_LAW = 5.0
"""Cost without a stable law, and what it lacks: logarithms beyond those of any law, but near enough to leave it."""
_EVALUATIONS = 120


def gust_rms(models: Sequence[AxisModel]) -> Matrix:
    """Return the rms gust moment of each axis [N*m]."""
    return np.array([math.sqrt((m.gust.C @ m.gust_covariance @ m.gust.C.T).item()) for m in models])


def search_weights(
    design: Design, vehicle: Vehicle, scenario: Scenario, limits: TuningLimits, corners: Sequence[Vehicle]
) -> Law:
    """Return the law of a torque design with the weights of gust, command and moment scaled for the vehicle.

    One factor for each weight: Powell's linear approximations (COBYLA) on their logarithms. Initially the weights are
    in proportion to the gusts of the vehicle over those of the design's own. The same law every time.

    Raises
    ------
    DesignError
        If no law found keeps the limits.
    """
    own = load_vehicle(design.vehicle)
    models = axis_models(vehicle, scenario)
    ratio = gust_rms(models) / gust_rms(axis_models(own, scenario))
    noise = models[0].noise / axis_models(own, scenario)[0].noise if models[0].noise else 1.0
    omega = np.geomspace(_SLOWEST, 0.999 * math.pi / scenario.dt, _GRID)
    plants = [
        hover_plant(each, scenario, with_attitude=design.W_l is not None).response(omega)
        for each in (vehicle, *corners)
    ]
    peaks = [limits.sensitivity_peak, *[limits.corner_peak] * len(corners)]

    def law_at(factors: Matrix) -> Law:
        gust, command, moment = np.exp(factors)
        scaled = replace(
            design,
            W_d=scale(design.W_d, gust * ratio),
            W_n=scale(design.W_n, np.full(3, noise)),
            W_u=scale(design.W_u, command / ratio),
            W_m=tuple((moment * np.array(design.W_m or (0.0,) * 3) / ratio).tolist()),
        )
        return make_law(scaled, vehicle, solve_central(scaled, design_problem(scaled, vehicle)))

    @cache  # the search asks for error and room at the same factors
    def figures(factors: tuple[float, ...]) -> tuple[float, Matrix]:
        try:
            law = law_at(np.array(factors))
        except DesignError:
            return _NO_LAW, np.full(1 + len(plants), -_NO_LAW)
        if not all(is_stable_at_hover(law, each, scenario) for each in (vehicle, *corners)):
            return _NO_LAW, np.full(1 + len(plants), -_NO_LAW)
        found = predict(law, vehicle, scenario)
        assert found is not None  # a torque law
        K = loop_law(law).response(omega)
        S = [1.0 / np.abs(1.0 - np.diagonal(K @ G, axis1=1, axis2=2)) for G in plants]
        excess = [found.slew / limits.slew, *(float(np.max(s)) / peak for s, peak in zip(S, peaks, strict=True))]
        return math.log(found.rmse), -np.log(excess) - _KEPT_BACK

    def error(factors: Matrix) -> float:
        return figures(tuple(factors.tolist()))[0]

    def room(factors: Matrix) -> Matrix:
        return figures(tuple(factors.tolist()))[1]

    best = scipy.optimize.minimize(
        error,
        np.zeros(3),
        method="COBYLA",
        constraints=scipy.optimize.NonlinearConstraint(room, 0.0, np.inf),
        options={"rhobeg": 0.7, "maxiter": _EVALUATIONS, "tol": 1e-3},
    )
    if best.fun >= _NO_LAW:
        raise DesignError(f"design {design.name}: no weights stabilise vehicle '{vehicle.name}'")
    return law_at(best.x)


def scale(weight: Weight, factor: Matrix) -> Weight:
    """Return the weight with each axis times its factor (3,)."""
    low, high = (tuple((np.array(each) * factor).tolist()) for each in (weight.low, weight.high))
    return replace(weight, low=low, high=high)
