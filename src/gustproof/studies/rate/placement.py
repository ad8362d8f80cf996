"""Least possible attitude errors in turbulence, and the distance of each law from them, in degrees."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.waveforms import RandomGusts
from gustproof.airframe.covariance import axis_models
from gustproof.airframe.limits import full_information_limit, output_feedback_limit
from gustproof.airframe.predict import predict
from gustproof.airframe.tradeoff import LinearLaws, TradeOff, linear_laws
from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.studies.rate.law_margins import HoverMargins

SLEW = 20.0
"""[N*m/s] rms torque slew of the stated limits: that of the strong baselines."""
SLEWS = (10.0, SLEW, 40.0)
"""[N*m/s] slews of the curves."""
PEAKS = (1.15, 1.18, 1.22, 1.28, 1.36, 1.45, 1.6, 1.8, 2.0)
"""[-] sensitivity peaks of the points of each curve."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TradeOffCurve:
    """Least error of linear laws over the sensitivity peak, at one slew."""

    slew: float
    """[N*m/s] rms torque slew, all axes together."""
    Ms: tuple[float, ...]
    """[-] sensitivity peaks of the worst axis."""
    rmse_deg: tuple[float, ...]
    """[deg] least error at each peak."""
    any_Ms_deg: float
    """[deg] least error of any gyro-only law at this slew, for any sensitivity."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorLimits:
    """Least errors in the turbulence of a scenario: averages over many flights, three axes together."""

    scenario: str
    """Name of the scenario."""
    slew: float
    """[N*m/s] rms torque slew of the limits."""
    gyro_deg: float
    """[deg] least error of any gyro-only law, at any margins."""
    gyro_any_slew_deg: float
    """[deg] the same at unlimited slew: the integral of the gyro's noise."""
    clairvoyant_deg: float
    """[deg] least error of any law with exact knowledge of state and air."""
    clairvoyant_any_slew_deg: float
    """[deg] the same at unlimited slew: the effect of delay and actuator lag."""
    curves: tuple[TradeOffCurve, ...]
    """Trade-off with the sensitivity peak."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """Predicted error and slew of a law, and the least error at the same slew and sensitivity peak."""

    Ms: float
    """[-] largest sensitivity of the worst axis."""
    slew: float
    """[N*m/s] predicted rms torque slew, all axes together."""
    rmse_deg: float
    """[deg] predicted error, average over many flights."""
    own_rate: float | None
    """[rad/s] predicted rms rate where the gyro's noise keeps its ratio to this rate; `None` at no such noise."""
    own_rate_rmse_deg: float | None
    """[deg] predicted error with that noise, in place of the one that the vehicle's reference rate sets."""
    least_rmse_deg: float | None
    """[deg] least error of linear gyro-only laws at this slew and peak; `None` if none was found."""


Places = Mapping[str, Placement | None]
"""Placement of each law by name; `None` for a rate law, which has no torque loop of its own."""


def performance_limits(
    laws: Mapping[str, Law],
    margins: Mapping[str, HoverMargins | None],
    vehicle: Vehicle,
    scenario: Scenario,
    slew: float = SLEW,
) -> tuple[ErrorLimits, Places]:
    """Return the limits of a vehicle in the scenario's turbulence and the placement of each law; takes seconds.

    `slew` [N*m/s] is that of the limits; the curves are for half of it, for it, and for its double.

    Raises
    ------
    ValueError
        If the scenario has no turbulence.
    DesignError
        If no law can hold this vehicle's attitude at this slew.
    """
    models = axis_models(vehicle, scenario)
    linear = linear_laws(models, around=slew)
    found = ErrorLimits(
        scenario=scenario.name,
        slew=slew,
        gyro_deg=math.degrees(output_feedback_limit(models, slew).rmse),
        gyro_any_slew_deg=math.degrees(output_feedback_limit(models, math.inf).rmse),
        clairvoyant_deg=math.degrees(full_information_limit(models, slew).rmse),
        clairvoyant_any_slew_deg=math.degrees(full_information_limit(models, math.inf).rmse),
        curves=tuple(_trade_off_curve(linear, each * slew / SLEW) for each in SLEWS),
    )
    peaks = {name: None if margin is None else margin.Ms for name, margin in margins.items()}
    places = {
        name: None if (Ms := peaks[name]) is None else _locate(law, Ms, linear, vehicle, scenario)
        for name, law in laws.items()
    }
    return found, places


def locate(law: Law, Ms: float, vehicle: Vehicle, scenario: Scenario) -> Placement | None:
    """Return the placement of a law with sensitivity peak `Ms` [-] in the scenario's turbulence.

    The result is `None` for a rate law, without turbulence, and if no law can hold attitude at the slew `SLEW`.
    """
    if not any(isinstance(item, RandomGusts) for item in scenario.wind):
        return None
    try:
        return _locate(law, Ms, linear_laws(axis_models(vehicle, scenario), around=SLEW), vehicle, scenario)
    except DesignError:
        return None


def _locate(law: Law, Ms: float, linear: LinearLaws, vehicle: Vehicle, scenario: Scenario) -> Placement | None:
    predicted = predict(law, vehicle, scenario)
    if predicted is None:
        return None
    least = _least_error(linear, Ms, predicted.slew) if predicted.slew else None
    own = predicted.own_rate_rmse
    return Placement(
        Ms=Ms,
        slew=predicted.slew,
        rmse_deg=math.degrees(predicted.rmse),
        own_rate=predicted.own_rate,
        own_rate_rmse_deg=None if own is None else math.degrees(own),
        least_rmse_deg=None if least is None else math.degrees(least.rmse),
    )


def _trade_off_curve(linear: LinearLaws, slew: float) -> TradeOffCurve:
    points = [point for point in (_least_error(linear, peak, slew) for peak in PEAKS) if point is not None]
    return TradeOffCurve(
        slew=slew,
        Ms=tuple(point.sensitivity_peak for point in points),
        rmse_deg=tuple(math.degrees(point.rmse) for point in points),
        any_Ms_deg=math.degrees(output_feedback_limit(linear.models, slew).rmse),
    )


def _least_error(linear: LinearLaws, peak: float, slew: float) -> TradeOff | None:
    try:
        return linear.minimize_error(peak, slew)
    except DesignError:
        return None
