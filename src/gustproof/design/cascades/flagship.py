"""The flagship: the cascade with a biquad of least attitude error in turbulence, within the limits of `pid-fair`.

As for `pid-fair`, the error pooled over the axes is least at a given sensitivity peak of each axis and a given pooled
torque slew. In addition, a peak is limited at each corner of a box of inertia and actuator lag. Equal peaks are not
equal robustness: on request, each axis also stays stable at a stated delay and up to a stated loop gain.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.airframe.covariance import (
    AxisModel,
    AxisPerformance,
    axis_models,
    axis_performance,
    open_loop,
    pool_axes,
)
from gustproof.design.cascades.biquad_search import AxisSearch
from gustproof.design.cascades.pid_biquad import BiquadGains, biquad_axis
from gustproof.design.cascades.tuning import (
    SLOWER,
    SPREADS,
    TuningLimits,
    axis_parameters,
    corner_vehicles,
    loop_speed,
    models_of_axes,
)
from gustproof.errors import DesignError
from gustproof.law.cascade import Gains, cascade_law
from gustproof.law.form import Law, Provenance
from gustproof.robust.lti.margins import loop_margins

_WEIGHT = 1e-9
"""[s^2 rad^2/(N*m)^2] initial weight of mean square slew, at the slew of `SHIPPED_LIMITS`."""
_ROUNDS = 20
"""Largest number of weights tried."""
_POWER = 3.0
"""[-] of the slew that its weight falls with, at first."""
_SLEW_TOLERANCE, _PATIENCE, _LATE_TOLERANCE = 1e-4, 8, 0.02
"""[-] largest relative distance of the slew below its limit; number of weights tried for it; distance after these."""
_TOLERANCES = [_SLEW_TOLERANCE] * _PATIENCE + [_LATE_TOLERANCE] * (_ROUNDS - _PATIENCE)
_STALE = 0.05
"""[-] width of the interval of weights below which an end far from the wanted slew is given up."""
_STRESS_PEAK, _LAST_PEAK = 10.0, 20.0
"""[-] sensitivity peaks below and near a delay or gain that must be stable: finite at all of them, so none is lost."""
GAIN_TOLERANCE = 0.03
"""[-] share of the largest gain that may be missing: peaks are limited up to nearly that gain."""
_GAIN_SHARES, _DELAY_SHARES = (0.37, 0.45, 0.55, 0.66, 0.77, 0.88, 0.965), (0.36, 0.64, 0.82, 1.0)
"""[-] of the largest gain and delay, at which the peaks are limited; the margins themselves are tested in the end."""
_NEUTRAL = (2.0, 4.0, 8.0)
"""[-] frequency of the biquad at each start of the search, in actuator bandwidths; initially its gain is 1."""


ThreeGains = tuple[BiquadGains, BiquadGains, BiquadGains]

SHIPPED_LIMITS = TuningLimits(slew=19.8, corner_peak=2.0)
"""Limits of the law `flagship`: slew below 20 by twice a single flight's scatter, .1."""
ROBUST_LIMITS = TuningLimits(slew=19.8, corner_peak=2.34, delay_samples=11, gain=7.3)
"""Limits of the law `flagship-robust`: no worse than `pid-fair` in any of them."""


def flagship_law(
    vehicle: Vehicle,
    scenario: Scenario,
    *,
    name: str = "flagship",
    limits: TuningLimits = SHIPPED_LIMITS,
    corners: Sequence[Vehicle] | None = None,
    pid: Sequence[Gains] | None = None,
) -> Law:
    """Return the law with the gains of `tune_flagship`; its provenance has gains, limits and predicted performance.

    `corners` default to inertia and lag at the ends of `SPREADS`.

    Raises
    ------
    DesignError
        See `tune_flagship`.
    """
    corners = corner_vehicles(vehicle, SPREADS) if corners is None else corners
    gains = tune_flagship(vehicle, scenario, limits, corners, pid)
    axes = [
        biquad_axis(each, inertia, scenario.dt, vehicle.stabilizer.rate_limit)
        for each, inertia in zip(gains, vehicle.inertia_B, strict=True)
    ]
    rmse, slew = pool_axes(_axis_performances(axis_models(vehicle, scenario), gains))
    inertias = [each / J for corner in corners for each, J in zip(corner.inertia_B, vehicle.inertia_B, strict=True)]
    parameters = {
        **limits.parameters(),
        "inertia_spread": max(abs(ratio - 1.0) for ratio in inertias),
        "actuator_lag_spread": max(abs(corner.actuator_lag / vehicle.actuator_lag - 1.0) for corner in corners),
        "foretold_rmse_deg": math.degrees(rmse),
        "foretold_slew_nm_per_s": slew,
        **axis_parameters(each._asdict() for each in gains),
    }
    provenance = Provenance.of(
        vehicle,
        f"strapdown cascade with a biquad, of least attitude error in scenario '{scenario.name}'",
        parameters,
    )
    return cascade_law(name, axes, vehicle, scenario.dt, provenance)


def tune_flagship(
    vehicle: Vehicle,
    scenario: Scenario,
    limits: TuningLimits,
    corners: Sequence[Vehicle],
    pid: Sequence[Gains] | None = None,
) -> ThreeGains:
    """Return the gains of roll, pitch and yaw with the least attitude error, pooled over the axes.

    All axes have the same weight of slew, which shares the slew optimally among them. It is raised until the slew is
    within its limit. A few fixed starts are searched, the gains of a `pid` too if given, and the best optimum is taken:
    the same gains every time. The scenario gives turbulence, delay, sample time and duration. `corners` are vehicles
    off nominal, for the limit of the peak there.

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle.
    """
    axes = models_of_axes(vehicle, corners, scenario)
    models = [model for model, *_ in axes]
    searches = [
        AxisSearch(
            model,
            limits.sensitivity_peak,
            [*((each, limits.corner_peak) for each in off), *_stress(model, limits)],
            guarded=len(off),
        )
        for model, *off in axes
    ]
    bandwidth = 20.0 * loop_speed(vehicle, scenario)
    fixed = _starts(bandwidth, limits)
    starts = [_add_biquad(pid[0], 4.0 * bandwidth), *fixed[1:]] if pid else fixed
    found = _search_weights(searches, starts, models, limits)
    if vehicle.actuator_lag < scenario.dt:  # the usual starts are unstable, as samples and not the lag limit the loop
        for speed in SLOWER[1:]:
            found = found or _search_weights(searches, _starts(speed * bandwidth, limits), models, limits)
    if found is None:
        raise DesignError(
            f"no shaped cascade found at sensitivity peak {limits.sensitivity_peak}, {limits.corner_peak} off nominal, "
            f"and slew {limits.slew} N*m/s, stable to {limits.delay_samples} samples of delay and {limits.gain} of gain"
        )
    return found


def _search_weights(
    searches: Sequence[AxisSearch],
    starts: list[BiquadGains],
    models: Sequence[AxisModel],
    limits: TuningLimits,
) -> ThreeGains | None:
    """Return the gains of least error within the limits over the weights of slew that are tried; `None` for none."""
    found: ThreeGains | None = None
    gains: list[BiquadGains] | None = None
    least, weight = math.inf, _Weight(limits.slew)
    for number in range(_ROUNDS):
        gains = _search_axes(searches, gains, starts, weight.value)
        if gains is None:
            break
        performances = _axis_performances(models, gains)
        rmse, slew = pool_axes(performances)
        excess = slew / limits.slew
        within = all(_is_within(*axis, limits) for axis in zip(models, gains, performances, strict=True))
        if within and excess <= 1.0 and rmse < least:
            least, found = rmse, (gains[0], gains[1], gains[2])
        if 1.0 - _TOLERANCES[number] < excess <= 1.0:
            break
        weight.follow(excess, number)
    return found


def _search_axes(
    searches: Sequence[AxisSearch], near: Sequence[BiquadGains] | None, starts: list[BiquadGains], weight: float
) -> list[BiquadGains] | None:
    """Return the optimum of each axis at a weight of slew; `None` if one has none.

    It is searched from gains `near` it if there are any. Else it is from those of the axis before and from `starts`:
    axes differ little in gains of angular acceleration.
    """
    gains = list[BiquadGains]()
    for number, search in enumerate(searches):
        first = [near[number]] if near else [*gains[-1:], *starts]
        result = search.search(first, weight)
        if result is None:
            return None
        gains.append(result.gains)
    return gains


class _Weight:
    """Weight of mean square slew, and the interval that it is in."""

    def __init__(self, slew: float) -> None:
        # a weight of mean square error per mean square slew: the unit of slew is that of its limit
        self.value = _WEIGHT * (SHIPPED_LIMITS.slew / slew) ** 2
        self._low, self._high = 0.0, math.inf
        self._last: tuple[float, float] | None = None

    def follow(self, excess: float, number: int) -> None:
        """Move towards a slew at its limit, from one that is `excess` times it, after `number` moves."""
        power = _POWER
        if self._last and number >= _PATIENCE // 2:  # slow: the secant in logarithms
            value, before = self._last
            power = math.log(self.value / value) / math.log(before / excess) if excess != before else 0.0
        self._last = self.value, excess
        if excess > 1.0:
            self._low = self.value
        else:
            self._high = self.value
        if self._high < (1.0 + _STALE) * self._low:  # the optimum has jumped since one end was found
            self._low, self._high = (self._low, math.inf) if excess > 1.0 else (0.0, self._high)
        self.value *= (excess / (1.0 - 0.5 * _SLEW_TOLERANCE)) ** min(max(power, 2.0), 20.0)
        if not self._low < self.value < self._high:  # the optimum jumps
            self.value = math.sqrt(self._low * self._high)


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
    return delay >= limits.delay_samples and margins.gain_margin >= (1.0 - GAIN_TOLERANCE) * limits.gain


def _starts(bandwidth: float, limits: TuningLimits) -> list[BiquadGains]:
    """Return the starts of the search; with limits of delay or gain slower ones, with a resonance behind the loop.

    `bandwidth` [rad/s] is that of the actuators, or less where the delay is long.
    """
    # a cascade as fast as the actuators permit at small delay, with a biquad of gain 1
    starts = [
        BiquadGains(
            angle_p=0.4 * bandwidth,
            gain=3.75 * bandwidth,
            lead_frequency=0.45 * bandwidth,
            lead_damping=0.8,
            cutoff=3.6 * bandwidth,
            zero_frequency=neutral * bandwidth,
            zero_damping=0.7,
            pole_frequency=neutral * bandwidth,
            pole_damping=0.7,
        )
        for neutral in _NEUTRAL
    ]
    if not (limits.delay_samples or limits.gain > 1.0):
        return starts
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


def _add_biquad(pid: Gains, corner: float) -> BiquadGains:
    """Return the gains of a PID with a biquad of gain 1 at `corner` [rad/s]."""
    cutoff = 2.0 * math.pi * pid.derivative_cutoff
    gain = pid.rate_p + pid.rate_d * cutoff
    lead = math.sqrt(pid.rate_i * cutoff / gain)
    damping = 0.5 * (pid.rate_p * cutoff + pid.rate_i) / (gain * lead)
    return BiquadGains(pid.angle_p, gain, lead, damping, cutoff, corner, 0.7, corner, 0.7)


def _axis_performances(models: Sequence[AxisModel], gains: Sequence[BiquadGains]) -> list[AxisPerformance]:
    return [
        axis_performance(model, biquad_axis(each, model.inertia, model.plant.dt))
        for model, each in zip(models, gains, strict=True)
    ]
