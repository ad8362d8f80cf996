"""Tune a law for any vehicle: the least attitude error in turbulence at a sensitivity peak and a torque slew.

Nothing is drawn at random: the same vehicle has the same law, bit by bit.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from firmware_model.config.scenario import Scenario, with_measured_delay
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.config.vehicle import Vehicle, load_vehicle
from firmware_model.config.waveforms import RandomGusts
from gustproof.airframe.covariance import axis_models
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.airframe.limits import output_feedback_limit
from gustproof.airframe.predict import predict
from gustproof.airframe.tradeoff import LinearLaws, TradeOff, linear_laws
from gustproof.design.cascades.flagship import flagship_law
from gustproof.design.cascades.indi import indi_law
from gustproof.design.cascades.pid_baseline import baseline_pid, tune_pid_gains
from gustproof.design.cascades.rate_loop import identify_rate_loop
from gustproof.design.cascades.tuning import SPREADS, TuningLimits
from gustproof.design.derive import derive
from gustproof.design.designs import Design, Weight, load_design
from gustproof.design.levelling import level_cascade
from gustproof.design.structures import LawKind
from gustproof.design.weights_search import gust_rms, scale, search_weights
from gustproof.errors import DesignError
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import measure
from gustproof.law.form import Law
from gustproof.robust.lti.margins import LoopMargins, input_margins, worst_loop
from gustproof.robust.lti.state_space import Matrix
from gustproof.robust.shown import Shown
from gustproof.types import finite_or_none

SENSITIVITY_PEAK = 1.4
"""[-] sensitivity peak if none is asked for."""
ROBUSTNESS_PRICE = 0.15
"""[-] most error over the least that the flagship pays for margins of delay and gain."""
_SLEWS_PER_GUST = 6.0
"""[-] `default_slew` times the actuator lag over the gust moment's rms: about 20 N*m/s for the vehicle `paper`."""
_CORNER_PEAKS = (1.7, 2.5, 4.0)
"""[-] peaks off nominal that are tried in turn, over the nominal one."""
_SHARES = (1.0, 2 / 3, 1 / 3)
"""[-] of the way from the margins of least error to those of a PID, tried in turn."""
_MORE_SLEW, _MORE_PEAK, _HALVINGS = (1.5, 2.5, 5.0, 10.0), (1.1, 1.25, 1.5), 3
"""[-] factors on a slew or a peak that could not be met; halvings of the interval of slew, once one is met."""
_MOMENT_WEIGHT = 0.02
"""[1/(N*m)] initial `W_m` of yaw in the design of `hinf`."""
_UNLEVELLED = 0.999
"""[-] share of sensitivity and slew for the cascade: levelling adds a little to both."""
_SLEWS, _PEAKS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0), (1.15, 1.2, 1.25, 1.3, 1.4, 1.5, 1.6, 1.8, 2.0)
"""[-] slews over the law's, and peaks, of the trade-off's points."""
_SEEDS = (1, 2, 3)
"""Seeds of the flights of a law of rates."""
_ROUNDS = 40
_ROUNDING = 1e-6
"""[-] relative excess over a limit that counts as rounding."""

Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Tuning(Shown):
    """A tuned law with its Ms, its slew and the least error at both."""

    kind: str
    """Structure, a `LawKind` or a baseline."""
    law: Law
    """Law, named after structure and vehicle."""
    vehicle: str
    """Name of the vehicle."""
    scenario: str
    """Name of the scenario that gives the turbulence."""
    limits: TuningLimits
    """Limits that the law keeps."""
    Ms: float
    """[-] largest sensitivity of the worst axis."""
    slew: float
    """[N*m/s] predicted rms torque slew, all axes together."""
    rmse: float
    """[rad] predicted error of the Euler angles, all axes together, average over many flights."""
    least_rmse: float | None
    """[rad] least error of linear gyro-only laws at this slew and sensitivity; `None` for a law of rates."""
    any_Ms_rmse: float | None
    """[rad] least error of all gyro-only laws at this slew, at any sensitivity."""
    off_nominal_Ms: float | None
    """[-] largest sensitivity at the corners of the vehicle's spreads; infinite if unstable at one."""
    phase_margin: float
    """[rad] of the worst axis, as the following."""
    gain_margin: float
    """[-] least destabilising factor above 1."""
    delay_margin: float
    """[s] least destabilising additional delay."""

    def lines(self) -> list[str]:
        """Return error, cost and margins."""
        least = "" if self.least_rmse is None else f", the least of linear laws {math.degrees(self.least_rmse):.3g}"
        spread = "" if self.off_nominal_Ms is None else f", {self.off_nominal_Ms:.3g} at the ends of the spreads"
        return [
            f"{self.law.name}, tuned for vehicle {self.vehicle} in {self.scenario}",
            f"error: {math.degrees(self.rmse):.3g} deg rms expected{least}",
            f"torque slew: {self.slew:.3g} N m/s rms, at most {self.limits.slew:.3g} wanted",
            f"Ms: {self.Ms:.3g}, at most {self.limits.sensitivity_peak:.3g} wanted{spread}",
            f"margins: phase {math.degrees(self.phase_margin):.3g} deg, gain {self.gain_margin:.3g} times, "
            f"delay {1000.0 * self.delay_margin:.3g} ms",
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as JSON values; the law by its name."""
        return {
            "law": self.law.name,
            "kind": str(self.kind),
            "vehicle": self.vehicle,
            "scenario": self.scenario,
            "wanted_Ms": self.limits.sensitivity_peak,
            "wanted_slew": self.limits.slew,
            "Ms": self.Ms,
            "slew": self.slew,
            "rmse_deg": math.degrees(self.rmse),
            "least_rmse_deg": None if self.least_rmse is None else math.degrees(self.least_rmse),
            "any_Ms_rmse_deg": None if self.any_Ms_rmse is None else math.degrees(self.any_Ms_rmse),
            "off_nominal_Ms": finite_or_none(self.off_nominal_Ms),
            "phase_margin_deg": math.degrees(self.phase_margin),
            "gain_margin": finite_or_none(self.gain_margin),
            "delay_margin_s": finite_or_none(self.delay_margin),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TuningTask:
    """Vehicle, turbulence and limits of a tuning."""

    kind: str
    """Structure."""
    vehicle: Vehicle
    """Nominal vehicle."""
    corners: Sequence[Vehicle]
    """Vehicles off nominal."""
    scenario: Scenario
    """Turbulence, sample time and delay."""
    limits: TuningLimits
    """Price, without margins."""
    progress: Progress
    """Function that shows how far the search is."""

    @property
    def name(self) -> str:
        """Name of the law."""
        return f"{self.kind}-{self.vehicle.name}"

    def least(self, limits: TuningLimits) -> float:
        """Return the least error [rad] of linear gyro-only laws at a sensitivity peak and a slew.

        Raises
        ------
        DesignError
            If the limits are too tight for the vehicle.
        """
        models = axis_models(self.vehicle, self.scenario)
        return linear_laws(models, around=limits.slew).minimize_error(limits.sensitivity_peak, limits.slew).rmse


Maker = Callable[[TuningTask, TuningLimits], Law]
"""Search of a law within limits; raises DesignError if there is none."""


def default_slew(vehicle: Vehicle, scenario: Scenario) -> float:
    """Return a torque slew [N*m/s] in proportion to the vehicle: 6 times the gust moment's rms over the actuator lag.

    Raises
    ------
    ValueError
        If the scenario has no turbulence.

    Examples
    --------
    >>> from gustproof import default_slew, load_scenario, load_vehicle
    >>> f"{default_slew(load_vehicle('iris'), load_scenario('paper-turbulence')):.1f} N m/s"
    '8.1 N m/s'
    """
    moment = math.sqrt(float(np.mean(gust_rms(axis_models(vehicle, scenario)) ** 2)))
    return _SLEWS_PER_GUST * moment / vehicle.actuator_lag


def wanted_slew(vehicle: Vehicle, scenario: Scenario, slew: float | None, sensitivity_peak: float) -> float:
    """Return the slew [N*m/s] to tune for, `default_slew` for `None`.

    Raises
    ------
    DesignError
        If nothing can be tuned for such limits, or in a scenario without turbulence.
    """
    if not any(isinstance(item, RandomGusts) for item in scenario.wind):
        raise DesignError(
            f"scenario '{scenario.name}' has no turbulence, no wind of kind 'dryden' or 'von_karman', to tune for"
        )
    wanted = default_slew(vehicle, scenario) if slew is None else slew
    if not (math.isfinite(wanted) and wanted > 0.0):
        raise DesignError(f"slew {wanted:g} N m/s: must be above 0, such as 20; calm air asks for none, so give one")
    most = 2.0 * math.hypot(*vehicle.torque_limit) / scenario.dt
    if wanted > most:
        raise DesignError(
            f"slew {wanted:g} N m/s: torques of vehicle '{vehicle.name}' change by at most {most:.0f} N m/s rms, from "
            "limit to limit at each sample"
        )
    if not 1.0 < sensitivity_peak < 10.0:
        raise DesignError(f"sensitivity peak {sensitivity_peak}: must be between 1 and 10")
    return wanted


def tune_law(
    kind: str,
    vehicles: VehicleSet,
    scenario: Scenario,
    *,
    slew: float | None = None,
    sensitivity_peak: float = SENSITIVITY_PEAK,
    progress: Progress = lambda _fraction, _text: None,
) -> Tuning:
    """Return the law of a structure with the least predicted error for the vehicle in the scenario's turbulence.

    The torque slew [N*m/s] is at most `slew`, by default `default_slew`; the sensitivity peak [-] of each axis is at
    most `sensitivity_peak`. It is limited too at the corners of the file's spreads of inertia and lag, or of 20 % and
    30 % where it has none. The flagship also gives up error for the margins of delay and gain of a PID, up to
    `ROBUSTNESS_PRICE` over the least error. A law of rates is flown on the vehicle's own loops: its slew is theirs.

    Raises
    ------
    DesignError
        If there is no such law; the text names a slew or a peak that could be met, if any.

    Examples
    --------
    >>> from gustproof import load_scenario, load_vehicle_set, tune_law
    >>> tuning = tune_law("pid", load_vehicle_set("iris"), load_scenario("paper-turbulence"))
    >>> f"{tuning.law.name}: Ms {tuning.Ms:.2f}, {tuning.slew:.1f} N m/s"
    'pid-iris: Ms 1.40, 8.1 N m/s'
    """
    chosen = LawKind(kind)
    task = make_task(chosen, vehicles, scenario, slew=slew, sensitivity_peak=sensitivity_peak, progress=progress)
    if chosen is LawKind.HINF_RATES:
        return _tune_rates(task)
    law, limits = find_law(task, _MAKERS[chosen], is_quick=chosen is not LawKind.HINF)
    if chosen is LawKind.FLAGSHIP:
        law, limits = _add_margins(task, law, limits)
    return judge_tuned(task, law, limits)


def make_task(
    kind: str,
    vehicles: VehicleSet,
    scenario: Scenario,
    *,
    slew: float | None,
    sensitivity_peak: float,
    progress: Progress,
) -> TuningTask:
    """Return the task to tune a structure; the arguments are those of `tune_law`.

    Raises
    ------
    DesignError
        See `wanted_slew`.
    """
    return TuningTask(
        kind=kind,
        vehicle=vehicles.nominal,
        corners=file_corners(vehicles),
        scenario=with_measured_delay(scenario, vehicles.nominal),
        limits=TuningLimits(
            sensitivity_peak=sensitivity_peak, slew=wanted_slew(vehicles.nominal, scenario, slew, sensitivity_peak)
        ),
        progress=progress,
    )


def file_corners(vehicles: VehicleSet) -> list[Vehicle]:
    """Return the vehicle with all inertias and the lag at the ends of their spreads, `SPREADS` where there are none."""
    nominal, known = vehicles.nominal, vehicles.spreads

    def end(name: str, value: float, spread: float, delta: float) -> float:
        return known[name].value(delta) if name in known else (1.0 + delta * spread) * value

    lag, spread = nominal.actuator_lag, SPREADS.actuator_lag
    lags = vehicles.lag_range or ((1.0 - spread) * lag, (1.0 + spread) * lag)
    corners = []
    for heavier in (-1.0, 1.0):
        x, y, z = (
            end(f"inertia_B.{axis}", J, SPREADS.inertia, heavier)
            for axis, J in zip("xyz", nominal.inertia_B, strict=True)
        )
        corners += [replace(nominal, inertia_B=(x, y, z), actuator_lag=each) for each in lags]
    return corners


def least_errors(vehicle: Vehicle, scenario: Scenario, tuning: Tuning) -> tuple[list[TradeOff], list[TradeOff]]:
    """Return the least errors of linear laws around those of a tuning: over the slew, and over the sensitivity peak."""
    linear = linear_laws(axis_models(vehicle, scenario), around=tuning.slew)
    points = [(tuning.Ms, factor * tuning.slew) for factor in _SLEWS]
    return _points(linear, points), _points(linear, [(peak, tuning.slew) for peak in _PEAKS])


def _points(linear: LinearLaws, points: Sequence[tuple[float, float]]) -> list[TradeOff]:
    found = []
    for peak, slew in points:
        with suppress(DesignError):  # too small a peak or slew
            found.append(linear.minimize_error(peak, slew))
    return found


def worst_margins(law: Law, vehicle: Vehicle, scenario: Scenario) -> LoopMargins:
    """Return the worst of each margin over roll, pitch and yaw of a torque law at hover.

    Raises
    ------
    ValueError
        If the loop is unstable.
    """
    axes = input_margins(hover_plant(vehicle, scenario, with_attitude=law.uses_accelerometer), loop_law(law))
    return worst_loop(axes)


def _make_aided(task: TuningTask, limits: TuningLimits) -> Law:
    less = replace(limits, sensitivity_peak=_UNLEVELLED * limits.sensitivity_peak, slew=_UNLEVELLED * limits.slew)
    cascade = flagship_law(task.vehicle, task.scenario, name=task.name, limits=less, corners=task.corners)
    return level_cascade(cascade, task.vehicle, task.scenario)


def _make_hinf(task: TuningTask, limits: TuningLimits) -> Law:
    """Return the law of the design `aided` without its accelerometer: every axis weighted as yaw is there."""
    aided = load_design("aided")
    gust = gust_rms(axis_models(load_vehicle(aided.vehicle), task.scenario))
    gust /= gust[2]

    def as_yaw(weight: Weight, share: Matrix) -> Weight:
        return scale(replace(weight, low=(weight.low[2],) * 3, high=(weight.high[2],) * 3), share)

    x, y, z = (_MOMENT_WEIGHT / gust).tolist()
    design = replace(
        aided,
        description="gyros alone, weighted by the gusts' spectrum; self-scheduled",
        W_l=None,
        W_d=as_yaw(aided.W_d, gust),
        W_u=as_yaw(aided.W_u, 1.0 / gust),
        W_n=as_yaw(aided.W_n, np.ones(3)),
        W_e=as_yaw(aided.W_e, np.ones(3)),
        W_m=(x, y, z),
    )
    return _make_from_design(design, task, limits)


def _make_from_design(design: Design, task: TuningTask, limits: TuningLimits) -> Law:
    named = replace(design, name=task.name, law=task.name, gamma=None, dt=task.scenario.dt)
    return search_weights(named, task.vehicle, task.scenario, limits, task.corners)


_MAKERS: dict[LawKind, Maker] = {
    LawKind.FLAGSHIP: lambda task, limits: flagship_law(
        task.vehicle, task.scenario, name=task.name, limits=limits, corners=task.corners
    ),
    LawKind.PID: lambda task, limits: baseline_pid(
        task.vehicle, task.scenario, name=task.name, limits=limits, corners=task.corners
    ),
    LawKind.INDI: lambda task, limits: indi_law(
        task.vehicle, task.scenario, name=task.name, limits=limits, corners=task.corners
    ),
    LawKind.AIDED: _make_aided,
    LawKind.HINF: _make_hinf,
}


def find_law(task: TuningTask, make: Maker, *, is_quick: bool) -> tuple[Law, TuningLimits]:
    """Return the law with the least peak off nominal that is found, of those tried, and its limits.

    `make` searches a law of the task within limits. If it `is_quick`, a refusal names limits that could be met.

    Raises
    ------
    DesignError
        If there is none.
    """
    task.progress(0.1, "least error")
    try:
        _refuse_the_impossible(task, task.limits)
        return _tune_off_nominal(task, make)
    except DesignError as error:
        raise DesignError(f"{error}{_what_could_be_met(task, make) if is_quick else ''}") from None


def _refuse_the_impossible(task: TuningTask, limits: TuningLimits) -> None:
    """Reject limits that no linear gyro-only law can meet, before searching."""
    if task.kind != LawKind.AIDED:
        task.least(limits)


def _tune_off_nominal(task: TuningTask, make: Maker) -> tuple[Law, TuningLimits]:
    """Return the law with the least peak off nominal that is found, of those tried; the largest is tried second."""
    wanted = task.limits
    tight, *others, loose = (replace(wanted, corner_peak=share * wanted.sensitivity_peak) for share in _CORNER_PEAKS)
    with suppress(DesignError):
        return _make(task, make, tight), tight
    last = _make(task, make, loose)
    for limits in others:
        with suppress(DesignError):
            return _make(task, make, limits), limits
    return last, loose


def _make(task: TuningTask, make: Maker, limits: TuningLimits) -> Law:
    law = make(task, limits)
    check_limits(task, law, limits)
    return law


def check_limits(task: TuningTask, law: Law, limits: TuningLimits) -> None:
    """Refuse a law that exceeds the limits of sensitivity or slew.

    Raises
    ------
    DesignError
        If it does.
    """
    found, predicted = worst_margins(law, task.vehicle, task.scenario), predict(law, task.vehicle, task.scenario)
    peak, slew = limits.sensitivity_peak, limits.slew
    if predicted is None or not found.Ms <= (1.0 + _ROUNDING) * peak or not predicted.slew <= (1.0 + _ROUNDING) * slew:
        had = "" if predicted is None else f": the best had {found.Ms:.4g} and {predicted.slew:.4g}"
        raise DesignError(f"no {task.kind} found at sensitivity peak {peak:.4g} and slew {slew:.4g} N m/s{had}")


def _what_could_be_met(task: TuningTask, make: Maker) -> str:
    """Return, in words, a slew or a peak near the wanted one for which there is a law; empty if none is found."""
    peak, slew = task.limits.sensitivity_peak, task.limits.slew

    def is_met(slew: float, peak: float) -> bool:
        task.progress(0.5, f"what could be met: slew {slew:.3g} N m/s, Ms {peak:.3g}")
        wanted = TuningLimits(sensitivity_peak=peak, slew=slew, corner_peak=_CORNER_PEAKS[-1] * peak)
        try:
            _refuse_the_impossible(task, wanted)
            _make(task, make, wanted)
        except DesignError:
            return False
        return True

    low = slew
    for factor in _MORE_SLEW:
        high = factor * slew
        if is_met(high, peak):
            for _ in range(_HALVINGS):
                middle = math.sqrt(low * high)
                low, high = (low, middle) if is_met(middle, peak) else (middle, high)
            return f"; with this peak a slew of {high:.3g} N m/s can be met"
        low = high
    for factor in _MORE_PEAK:
        if is_met(slew, factor * peak):
            return f"; with this slew a peak of {factor * peak:.3g} can be met"
    return ""


def _add_margins(task: TuningTask, law: Law, limits: TuningLimits) -> tuple[Law, TuningLimits]:
    """Return the flagship with more margins of delay and gain, as long as they cost no more than they may.

    They are those of the best PID at the same Ms and slew, or part of the way there.
    """
    vehicle, scenario = task.vehicle, task.scenario
    task.progress(0.3, "margins of a PID")
    try:
        gains = tune_pid_gains(vehicle, scenario, task.limits)
        pid = worst_margins(baseline_pid(vehicle, scenario, limits=task.limits, gains=gains), vehicle, scenario)
        most = (1.0 + ROBUSTNESS_PRICE) * task.least(task.limits)
    except DesignError:  # nothing to measure against
        return law, limits
    own = worst_margins(law, vehicle, scenario)
    later, stronger = max(pid.delay_margin - own.delay_margin, 0.0), max(pid.gain_margin / own.gain_margin, 1.0)
    for number, share in enumerate(_SHARES):
        task.progress(0.4 + 0.15 * number, f"error for margins, try {number + 1} of {len(_SHARES)}")
        delay = scenario.delay_samples + math.floor((own.delay_margin + share * later) / scenario.dt)
        wanted = replace(limits, delay_samples=delay, gain=own.gain_margin * stronger**share)
        try:
            robust = flagship_law(vehicle, scenario, name=task.name, limits=wanted, corners=task.corners, pid=gains)
            check_limits(task, robust, wanted)
        except DesignError:
            continue
        predicted = predict(robust, vehicle, scenario)
        if predicted is not None and predicted.rmse <= most:
            return robust, wanted
    return law, limits


def judge_tuned(task: TuningTask, law: Law, limits: TuningLimits) -> Tuning:
    """Return a torque law that a search has found, with its Ms, its slew and the least error there."""
    task.progress(0.95, "figures")
    found, predicted = worst_margins(law, task.vehicle, task.scenario), predict(law, task.vehicle, task.scenario)
    assert predicted is not None  # a torque law
    models = axis_models(task.vehicle, task.scenario)
    try:
        linear = linear_laws(models, around=predicted.slew).minimize_error(found.Ms, predicted.slew)
    except DesignError:
        linear = None
    return Tuning(
        kind=task.kind,
        law=law,
        vehicle=task.vehicle.name,
        scenario=task.scenario.name,
        limits=limits,
        Ms=found.Ms,
        slew=predicted.slew,
        rmse=predicted.rmse,
        least_rmse=None if linear is None else linear.rmse,
        any_Ms_rmse=output_feedback_limit(models, predicted.slew).rmse,
        off_nominal_Ms=max(_peak(law, corner, task.scenario) for corner in task.corners),
        phase_margin=found.phase_margin,
        gain_margin=found.gain_margin,
        delay_margin=found.delay_margin,
    )


def _peak(law: Law, vehicle: Vehicle, scenario: Scenario) -> float:
    try:
        return worst_margins(law, vehicle, scenario).Ms
    except ValueError:  # unstable
        return math.inf


def _tune_rates(task: TuningTask) -> Tuning:
    """Return the law of design R1 over the identified rate loops, slowed until its sensitivity is within the limit.

    Error and slew are flown, as its torques are those of the vehicle's own loops.
    """
    task.progress(0.2, "rate loops")
    lag = float(np.max(identify_rate_loop(task.vehicle).tau))
    named = replace(load_design("R1"), name=task.name, law=task.name)
    design = replace(named, rate_loop_lag=lag, dt=task.scenario.dt, gamma=None)
    for _ in range(_ROUNDS):
        law, report = derive(design, task.vehicle)
        found = worst_loop(report.sampled.input)
        if found.Ms <= task.limits.sensitivity_peak:
            break
        design = replace(design, W_u=scale(design.W_u, np.full(3, 1.3)))
    else:
        peak = task.limits.sensitivity_peak
        raise DesignError(f"no law of rates has a sensitivity peak of {peak} over rate loops of {lag:.3g} s")
    task.progress(0.8, "flights")
    flights = [
        measure(fly_direct(task.scenario, law, vehicle=task.vehicle, seed=seed), task.vehicle, task.scenario)
        for seed in _SEEDS
    ]
    error, slew = (
        math.sqrt(np.mean([getattr(f, name) ** 2 for f in flights])) for name in ("rmse_deg", "torque_slew_rms")
    )
    return Tuning(
        kind=task.kind,
        law=law,
        vehicle=task.vehicle.name,
        scenario=task.scenario.name,
        limits=task.limits,
        Ms=found.Ms,
        slew=slew,
        rmse=math.radians(error),
        least_rmse=None,
        any_Ms_rmse=None,
        off_nominal_Ms=None,
        phase_margin=found.phase_margin,
        gain_margin=found.gain_margin,
        delay_margin=found.delay_margin,
    )
