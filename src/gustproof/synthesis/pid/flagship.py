"""The flagship: the cascade with a biquad of least attitude error in turbulence, within the limits of `pid-fair`.

As for `pid-fair`, the error pooled over the axes is least at a given sensitivity peak of each axis and a given pooled
torque slew. In addition, a peak is limited at each corner of a box of inertia and actuator lag. Equal peaks are not
equal robustness: on request, each axis also stays stable at a stated delay and up to a stated loop gain.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.errors import DesignError
from gustproof.law.cascade import cascade_law
from gustproof.law.form import Law, Provenance
from gustproof.lti.margins import loop_margins
from gustproof.model.uncertainty import Spreads
from gustproof.performance.covariance import (
    AxisModel,
    AxisPerformance,
    axis_models,
    axis_performance,
    open_loop,
    pool_axes,
)
from gustproof.synthesis.pid.biquad_search import AxisSearch
from gustproof.synthesis.pid.pid_biquad import BiquadGains, biquad_axis
from gustproof.synthesis.pid.tuning import axis_parameters
from gustproof.version import __version__

_WEIGHT = 1e-9
"""[s^2 rad^2/(N*m)^2] initial weight of mean square slew."""
_ROUNDS = 20
"""Largest number of weights tried; the slew falls with about the third root of its weight, so a few suffice."""
_SLEW_TOLERANCE = 1e-4
"""[-] largest relative distance of the slew below its limit."""
_STRESS_PEAK, _LAST_PEAK = 10.0, 20.0
"""[-] sensitivity peaks below and near a delay or gain that must be stable: finite at all of them, so none is lost."""
_GAIN_SHARES, _DELAY_SHARES = (0.37, 0.45, 0.55, 0.66, 0.77, 0.88, 0.965), (0.36, 0.64, 0.82, 1.0)
"""[-] of the largest gain and delay, at which the peaks are limited; the margins themselves are tested in the end."""
_NEUTRAL = (2.0, 4.0, 8.0)
"""[-] frequency of the biquad at each start of the search, in actuator bandwidths; initially its gain is 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TuningLimits:
    """Limits of sensitivity and slew, and the spread of the vehicle."""

    sensitivity_peak: float = 1.36
    """[-] largest sensitivity peak of each axis."""
    slew: float = 19.8
    """[N*m/s] largest rms torque slew, pooled over the axes; below 20 by twice a single flight's scatter, .1."""
    corner_peak: float = 2.0
    """[-] largest sensitivity peak at the corners of the box."""
    spreads: Spreads = Spreads(inertia=0.2, actuator_lag=0.3)  # noqa: RUF009 - frozen
    """Box of inertia and actuator lag."""
    delay_samples: int = 0
    """[samples] from a measurement to its command's action, up to which each axis stays stable; 0: no such limit."""
    gain: float = 1.0
    """[-] factor on the loop gain up to which each axis stays stable; 1: no such limit."""


SHIPPED_LIMITS = TuningLimits()
"""Limits of the law `flagship`, comparable with those of `pid-fair` in peak and slew."""
ROBUST_LIMITS = TuningLimits(corner_peak=2.34, delay_samples=11, gain=7.3)
"""Limits of the law `flagship-robust`: no worse than `pid-fair` in any of them."""


def flagship_law(
    vehicle: Vehicle, scenario: Scenario, *, name: str = "flagship", limits: TuningLimits = SHIPPED_LIMITS
) -> Law:
    """Return the law with the gains of `tune_flagship`; its provenance has gains, limits and predicted performance.

    Raises
    ------
    DesignError
        See `tune_flagship`.
    """
    gains = tune_flagship(vehicle, scenario, limits)
    axes = [
        biquad_axis(each, inertia, scenario.dt, vehicle.stabilizer.rate_limit)
        for each, inertia in zip(gains, vehicle.inertia_B, strict=True)
    ]
    rmse, slew = pool_axes(_axis_performances(axis_models(vehicle, scenario), gains))
    parameters = {
        "sensitivity_peak": limits.sensitivity_peak,
        "slew_nm_per_s": limits.slew,
        "off_nominal_sensitivity_peak": limits.corner_peak,
        "inertia_spread": limits.spreads.inertia,
        "actuator_lag_spread": limits.spreads.actuator_lag,
        **({"stable_delay_samples": limits.delay_samples} if limits.delay_samples else {}),
        **({"stable_gain": limits.gain} if limits.gain > 1.0 else {}),
        "foretold_rmse_deg": math.degrees(rmse),
        "foretold_slew_nm_per_s": slew,
    }
    parameters |= axis_parameters(each._asdict() for each in gains)
    provenance = Provenance(
        design=f"strapdown cascade with a biquad, of least attitude error in scenario '{scenario.name}'",
        vehicle=vehicle.name,
        parameters=parameters,
        version=__version__,
    )
    return cascade_law(name, axes, vehicle, scenario.dt, provenance)


def tune_flagship(
    vehicle: Vehicle, scenario: Scenario, limits: TuningLimits
) -> tuple[BiquadGains, BiquadGains, BiquadGains]:
    """Return the gains of roll, pitch and yaw with the least attitude error, pooled over the axes.

    All axes have the same weight of slew, which shares the slew optimally among them. It is raised until the slew is
    within its limit. A few fixed starts are searched and the best optimum is taken: the same gains every time. The
    scenario gives turbulence, delay, sample time and duration.

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle.
    """
    models = axis_models(vehicle, scenario)
    others = [axis_models(each, scenario) for each in corner_vehicles(vehicle, limits.spreads)]
    axes = [
        AxisSearch(
            model, limits.sensitivity_peak, [*((each, limits.corner_peak) for each in off), *_stress(model, limits)]
        )
        for model, *off in zip(models, *others, strict=True)
    ]
    starts: list[Sequence[BiquadGains]] = [_starts(vehicle, limits)] * len(models)
    refusal = DesignError(
        f"no shaped cascade found at sensitivity peak {limits.sensitivity_peak}, {limits.corner_peak} off nominal, "
        f"and slew {limits.slew} N*m/s, stable to {limits.delay_samples} samples of delay and {limits.gain} of gain"
    )
    weight = _WEIGHT
    for _ in range(_ROUNDS):
        gains = []
        for axis, start in zip(axes, starts, strict=True):
            found = axis.search(start, weight)
            if found is None:
                raise refusal
            gains.append(found.gains)
        performances = _axis_performances(models, gains)
        excess = pool_axes(performances)[1] / limits.slew
        if 1.0 - _SLEW_TOLERANCE < excess <= 1.0:
            if not all(_is_within(*axis, limits) for axis in zip(models, gains, performances, strict=True)):
                break
            return gains[0], gains[1], gains[2]
        weight *= (excess / (1.0 - 0.5 * _SLEW_TOLERANCE)) ** 3
        starts = [[each] for each in gains]
    raise refusal


def corner_vehicles(vehicle: Vehicle, spreads: Spreads) -> list[Vehicle]:
    """Return the vehicles with all inertias and the lag at the ends of their ranges."""
    ends = []
    for heavier in (-spreads.inertia, spreads.inertia):
        I_x, I_y, I_z = ((1.0 + heavier) * inertia for inertia in vehicle.inertia_B)
        for slower in (-spreads.actuator_lag, spreads.actuator_lag):
            lag = (1.0 + slower) * vehicle.actuator_lag
            ends.append(replace(vehicle, inertia_B=(I_x, I_y, I_z), actuator_lag=lag))
    return ends


def _stress(model: AxisModel, limits: TuningLimits) -> Iterator[tuple[AxisModel, float]]:
    """Yield the axis with more delay, then with more gain, up to the limits, and the sensitivity peak of each."""
    delays = [round(share * limits.delay_samples) for share in _DELAY_SHARES] if limits.delay_samples else []
    gains = [share * limits.gain for share in _GAIN_SHARES] if limits.gain > 1.0 else []
    peaks = [_STRESS_PEAK] * (len(_GAIN_SHARES) - 1) + [_LAST_PEAK]
    for delay, peak in zip(reversed(delays), reversed(peaks), strict=False):
        yield replace(model, delay_samples=delay), peak
    for gain, peak in zip(gains, peaks, strict=False):
        yield replace(model, plant=replace(model.plant, B=gain * model.plant.B)), peak


def _is_within(model: AxisModel, gains: BiquadGains, found: AxisPerformance, limits: TuningLimits) -> bool:
    """Return whether the gains of an axis keep its limits of sensitivity, delay and gain."""
    if found.sensitivity_peak > limits.sensitivity_peak:
        return False
    margins = loop_margins(
        open_loop(model, biquad_axis(gains, model.inertia, model.plant.dt).controller(model.plant.dt))
    )
    delay = model.delay_samples + margins.delay_margin / model.plant.dt
    return delay >= limits.delay_samples and margins.gain_margin >= limits.gain


def _starts(vehicle: Vehicle, limits: TuningLimits) -> list[BiquadGains]:
    """Return the starts of the search; with limits of delay or gain slower ones, with a resonance behind the loop."""
    starts = [_initial_gains(vehicle, each) for each in _NEUTRAL]
    if not (limits.delay_samples or limits.gain > 1.0):
        return starts
    bandwidth = 1.0 / vehicle.actuator_lag
    slow = BiquadGains(
        angle_p=0.28 * bandwidth,
        gain=2.2 * bandwidth,
        lead_frequency=0.58 * bandwidth,
        lead_damping=0.67,
        cutoff=3.3 * bandwidth,
        zero_frequency=16.0 * bandwidth,
        zero_damping=0.8,
        pole_frequency=11.5 * bandwidth,
        pole_damping=0.25,
    )
    return [starts[0], slow, slow._replace(angle_p=0.9 * slow.angle_p, gain=0.9 * slow.gain)]


def _initial_gains(vehicle: Vehicle, neutral: float) -> BiquadGains:
    """Return a cascade as fast as the actuators permit at small delay, with a biquad of gain 1."""
    bandwidth = 1.0 / vehicle.actuator_lag
    corner = neutral * bandwidth
    return BiquadGains(
        angle_p=0.4 * bandwidth,
        gain=3.75 * bandwidth,
        lead_frequency=0.45 * bandwidth,
        lead_damping=0.8,
        cutoff=3.6 * bandwidth,
        zero_frequency=corner,
        zero_damping=0.7,
        pole_frequency=corner,
        pole_damping=0.7,
    )


def _axis_performances(models: Sequence[AxisModel], gains: Sequence[BiquadGains]) -> list[AxisPerformance]:
    return [
        axis_performance(model, biquad_axis(each, model.inertia, model.plant.dt))
        for model, each in zip(models, gains, strict=True)
    ]
