"""The flagship: the shaped cascade that holds attitude best in turbulence, at the price of the fair PID.

Least error pooled over the axes at a given sensitivity peak of each axis and a given pooled torque slew, as the fair
PID; besides, a peak is kept at each corner of a box of inertia and actuator lag.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.errors import DesignError
from gustproof.law.cascade import cascade_law
from gustproof.law.form import Law, Provenance
from gustproof.model.uncertainty import Spreads
from gustproof.performance.covariance import AxisModel, AxisPerformance, axis_models, axis_performance
from gustproof.synthesis.pid.biquad_search import AxisSearch
from gustproof.synthesis.pid.pid_biquad import BiquadGains, biquad_axis
from gustproof.version import __version__

_AXES = ("roll", "pitch", "yaw")
_WEIGHT = 1e-9
"""[s^2 rad^2/(N*m)^2] price of mean square slew that the search begins with."""
_ROUNDS = 12
"""Prices tried at most; the slew falls with about the third root of its price, so that a few do."""
_SLEW_TOLERANCE = 1e-4
"""[-] how near the slew comes to what is allowed, from below."""
_NEUTRAL = (2.0, 4.0, 8.0)
"""[-] where the biquad stands at each start of the search, in actuator bandwidths; there it is 1, and does nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TuningLimits:
    """The price of attitude, and how far the vehicle may be off."""

    sensitivity_peak: float = 1.36
    """[-] largest sensitivity peak of each axis."""
    slew: float = 19.8
    """[N*m/s] largest rms torque slew, pooled over the axes; below 20 by twice a single flight's scatter, .1."""
    corner_peak: float = 2.0
    """[-] largest sensitivity peak at the corners of the box."""
    spreads: Spreads = Spreads(inertia=0.2, actuator_lag=0.3)  # noqa: RUF009 - frozen
    """The box."""


SHIPPED_LIMITS = TuningLimits()
"""What the shipped law was asked for: the price of `pid-fair`."""


def flagship_law(
    vehicle: Vehicle, scenario: Scenario, *, name: str = "flagship", demands: TuningLimits = SHIPPED_LIMITS
) -> Law:
    """Return the law with the shapes of `tune_flagship`; its provenance has shapes, demands and what is foretold.

    Raises
    ------
    DesignError
        See `tune_flagship`.
    """
    shapes = tune_flagship(vehicle, scenario, demands)
    axes = [biquad_axis(shape, inertia, scenario.dt) for shape, inertia in zip(shapes, vehicle.inertia_B, strict=True)]
    rmse, slew = _pool_axes(_figures(axis_models(vehicle, scenario), shapes))
    parameters = {
        "sensitivity_peak": demands.sensitivity_peak,
        "slew_nm_per_s": demands.slew,
        "off_nominal_sensitivity_peak": demands.corner_peak,
        "inertia_spread": demands.spreads.inertia,
        "actuator_lag_spread": demands.spreads.actuator_lag,
        "foretold_rmse_deg": math.degrees(rmse),
        "foretold_slew_nm_per_s": slew,
    }
    for axis, shape in zip(_AXES, shapes, strict=True):
        parameters |= {f"{axis}_{name}": value for name, value in shape._asdict().items()}
    provenance = Provenance(
        design=f"strapdown cascade with a biquad, of least attitude error in scenario '{scenario.name}'",
        vehicle=vehicle.name,
        parameters=parameters,
        version=__version__,
    )
    return cascade_law(name, axes, vehicle, scenario.dt, provenance)


def tune_flagship(
    vehicle: Vehicle, scenario: Scenario, demands: TuningLimits
) -> tuple[BiquadGains, BiquadGains, BiquadGains]:
    """Return the shapes of roll, pitch and yaw with the least attitude error, pooled over the axes.

    The axes share one price of slew, which is what shares the slew best among them; it is raised until the demand is
    met. The best of the optima that a few fixed starts lead to: the same shapes every time.

    Parameters
    ----------
    vehicle, scenario
        What is flown; turbulence, delay, sample time and duration are the scenario's.
    demands
        The price.

    Raises
    ------
    DesignError
        If no such shapes are found: the demands are too tight for this vehicle.
    """
    models = axis_models(vehicle, scenario)
    others = [axis_models(each, scenario) for each in corner_vehicles(vehicle, demands.spreads)]
    searches = [
        AxisSearch(model, [each[k] for each in others], demands.sensitivity_peak, demands.corner_peak)
        for k, model in enumerate(models)
    ]
    starts: list[Sequence[BiquadGains]] = [[_initial_gains(vehicle, each) for each in _NEUTRAL]] * len(models)
    refusal = DesignError(
        f"no shaped cascade found at sensitivity peak {demands.sensitivity_peak}, {demands.corner_peak} off nominal, "
        f"and slew {demands.slew} N*m/s"
    )
    weight = _WEIGHT
    for _ in range(_ROUNDS):
        shapes = []
        for search, start in zip(searches, starts, strict=True):
            found = search.best(start, weight)
            if found is None:
                raise refusal
            shapes.append(found.shape)
        figures = _figures(models, shapes)
        excess = _pool_axes(figures)[1] / demands.slew
        if 1.0 - _SLEW_TOLERANCE < excess <= 1.0:
            if max(axis.sensitivity_peak for axis in figures) > demands.sensitivity_peak:
                break
            return shapes[0], shapes[1], shapes[2]
        weight *= (excess / (1.0 - 0.5 * _SLEW_TOLERANCE)) ** 3
        starts = [[shape] for shape in shapes]
    raise refusal


def corner_vehicles(vehicle: Vehicle, spreads: Spreads) -> list[Vehicle]:
    """Return the vehicles with all inertias and the lag at the ends of their ranges."""
    ends = []
    for heavier, slower in itertools.product(
        (-spreads.inertia, spreads.inertia), (-spreads.actuator_lag, spreads.actuator_lag)
    ):
        I_x, I_y, I_z = ((1.0 + heavier) * inertia for inertia in vehicle.inertia_B)
        ends.append(replace(vehicle, inertia_B=(I_x, I_y, I_z), actuator_lag=(1.0 + slower) * vehicle.actuator_lag))
    return ends


def _initial_gains(vehicle: Vehicle, neutral: float) -> BiquadGains:
    """Return a cascade as fast as actuators with little delay allow, and a biquad that is 1."""
    bandwidth = 1.0 / vehicle.actuator_lag
    corner = neutral * bandwidth
    return BiquadGains(
        angle_p=0.4 * bandwidth, gain=3.75 * bandwidth, lead_frequency=0.45 * bandwidth, lead_damping=0.8,
        cutoff=3.6 * bandwidth, zero_frequency=corner, zero_damping=0.7, pole_frequency=corner, pole_damping=0.7,
    )  # fmt: skip


def _figures(models: Sequence[AxisModel], shapes: Sequence[BiquadGains]) -> list[AxisPerformance]:
    return [
        axis_performance(model, biquad_axis(shape, model.inertia, model.plant.dt))
        for model, shape in zip(models, shapes, strict=True)
    ]


def _pool_axes(figures: Sequence[AxisPerformance]) -> tuple[float, float]:
    """Return rms attitude [rad] and slew [N*m/s] of all axes."""
    return (
        math.sqrt(np.mean([axis.rmse**2 for axis in figures])),
        math.sqrt(np.mean([axis.slew**2 for axis in figures])),
    )
