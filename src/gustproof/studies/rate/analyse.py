"""Analysis of a law on a vehicle: margins, poles, responses, and the causes of its error."""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from firmware_model.config.scenario import AccelerometerFault, GyroFault, Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.waveforms import MomentStep
from firmware_model.types import AXES
from gustproof.design.derive import margins_to_dict
from gustproof.flight.recording.flown import Drawn
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import Metrics, measure
from gustproof.law.form import Law, Output
from gustproof.law.schedule import corners, law_at, schedule_limits
from gustproof.robust.lti.state_space import ComplexMatrix
from gustproof.studies.rate.hover_loop import HoverLoop, hover_loop
from gustproof.studies.rate.law_margins import SPREADS, axis_robustness
from gustproof.studies.rate.placement import Placement, locate
from gustproof.studies.rate.robustness import StabilityRange
from gustproof.types import Records

_STEP_S = 5.0
_STEP_SHARE = 0.03  # [-] of the torque limit: small enough for every stable law to stay near level


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Analysis(Drawn):
    """Linear figures of the loop at hover, and flights on the direct route."""

    law: Law
    """Analysed law."""
    scenario: Scenario
    """Air and rates of the flights."""
    seed: int
    """Seed of gusts and noise."""
    hover: HoverLoop
    """Linear loop at hover."""
    stability: tuple[StabilityRange, ...]
    """Multiples of inertia off by 20 % and lag off by 30 %, for roll, pitch, yaw; empty if the law couples axes or is
    unstable."""
    placement: Placement | None
    """Predicted error and the least of linear gyro-only laws at the same Ms and slew; `None` without such a limit."""
    scheduled_Ms: float | None
    """[-] largest Ms at the corners of a schedule's box, parameters held, the vehicle at hover; infinite if one is
    unstable. `None` without a schedule or for a rate law."""
    step_records: Records
    """Flight under a moment step about each axis, without wind or noise."""
    step_moment: tuple[float, float, float]
    """[N*m] B, height of the step."""
    records: Records
    """Flight through the scenario."""
    metrics: Metrics
    """Figures of that flight."""
    gust_alone: Metrics
    """Figures of the same flight with a noiseless gyro."""
    noise_alone: Metrics
    """Figures of the same flight in still air."""

    def lines(self) -> list[str]:
        """Return the flight's figures and the limits of the law."""
        figures, title = self.metrics.lines()[1:], f"{self.law.name} in {self.scenario.name}, seed {self.seed}"
        return [title, *figures, *self.limits()]

    def limits(self) -> tuple[str, ...]:
        """Return the limits of the law, in words, the largest share of the error first."""
        return tuple(_describe_limits(self))

    def to_dict(self) -> dict[str, Any]:
        """Return the analysis as JSON values; numbers that are not finite become `None`."""
        document = {
            "law": self.law.name,
            "order": self.law.order,
            "dt_s": self.law.dt,
            "output": self.law.output.value,
            "scheduled": self.law.is_scheduled,
            "takes_references": self.law.takes_references,
            "rate_limit_rad_s": None if self.law.rate_limit is None else self.law.rate_limit.limits.tolist(),
            "attitude_limit_deg": np.degrees(self.law.attitude_limits).tolist(),
            "design": self.law.provenance.design,
            "scenario": self.scenario.name,
            "seed": self.seed,
            "margins": None if self.hover.margins is None else margins_to_dict(self.hover.margins),
            "off_nominal": {
                "inertia_spread": SPREADS.inertia,
                "actuator_lag_spread": SPREADS.actuator_lag,
                "certified_by": "branch and bound over inertia, lag and frequency in floats, rounding bounded",
                "certified_up_to_times": [axis.certified for axis in self.stability],
                "unstable_at": [axis.unstable and asdict(axis.unstable) for axis in self.stability],
            },
            "schedule": None if self.law.schedule is None else schedule_limits(self.law.schedule),
            "scheduled_Ms": self.scheduled_Ms,
            "place": None if self.placement is None else asdict(self.placement),
            "law_poles_rad_s": pole_pairs(self.hover.law_poles),
            "loop_poles_rad_s": pole_pairs(self.hover.loop_poles),
            "flown": asdict(self.metrics),
            "gust_alone": asdict(self.gust_alone),
            "noise_alone": asdict(self.noise_alone),
            "limits": list(self.limits()),
        }
        finite: dict[str, Any] = to_jsonable_python(document, inf_nan_mode="null")
        return finite


def analyse(law: Law, vehicle: Vehicle, scenario: Scenario, *, seed: int = 1) -> Analysis:
    """Analyse a law on a vehicle, at the sample time and delay of `scenario` and in its air.

    Raises
    ------
    ValueError
        If the law's sample time is not the scenario's.

    Examples
    --------
    >>> from gustproof import analyse, load_law, load_scenario, load_vehicle
    >>> analysis = analyse(load_law("hinf-d1"), load_vehicle("paper"), load_scenario("gust-roll"))
    >>> margins = analysis.hover.margins
    >>> [round(axis.Ms, 2) for axis in margins.input]
    [1.28, 1.3, 1.35]
    """
    roll, pitch, yaw = vehicle.torque_limit
    step_moment = (_STEP_SHARE * roll, _STEP_SHARE * pitch, _STEP_SHARE * yaw)
    gyro, accelerometer = GyroFault(noise=False), AccelerometerFault(noise=False)
    still = replace(scenario, wind=(), moment=(), duration_s=_STEP_S, gyro=gyro, accelerometer=accelerometer)
    stepped = replace(still, moment=(MomentStep(kind="step", amplitude_nm=step_moment, start_s=0.5),))
    quiet = replace(
        scenario, gyro=replace(scenario.gyro, noise=False), accelerometer=replace(scenario.accelerometer, noise=False)
    )
    records = fly_direct(scenario, law, vehicle=vehicle, seed=seed)
    hover = hover_loop(law, vehicle, scenario)
    Ms = None if hover.margins is None else max(axis.Ms for axis in hover.margins.input)
    return Analysis(
        law=law,
        scenario=scenario,
        seed=seed,
        hover=hover,
        stability=axis_robustness(law, vehicle, scenario),
        placement=None if Ms is None else locate(law, Ms, vehicle, scenario),
        scheduled_Ms=_scheduled_peak(law, vehicle, scenario),
        step_records=fly_direct(stepped, law, vehicle=vehicle, seed=seed),
        step_moment=step_moment,
        records=records,
        metrics=measure(records, vehicle, scenario, law=law),
        gust_alone=_measure_flight(quiet, law, vehicle, seed),
        noise_alone=_measure_flight(replace(scenario, wind=(), moment=()), law, vehicle, seed),
    )


def _scheduled_peak(law: Law, vehicle: Vehicle, scenario: Scenario) -> float | None:
    if law.schedule is None or law.output is not Output.TORQUE:
        return None
    loops = [hover_loop(law_at(law, corner), vehicle, scenario).margins for corner in corners(law.schedule)]
    return max(math.inf if each is None else max(axis.Ms for axis in each.input) for each in loops)


def _describe_schedule(analysis: Analysis) -> str:
    assert analysis.law.schedule is not None
    limits = ", ".join(f"{name} {limit:.3g}" for name, limit in schedule_limits(analysis.law.schedule).items())
    peak = "" if analysis.scheduled_Ms is None else f"; Ms at the corners, held, {analysis.scheduled_Ms:.3g} at most"
    return f"schedule: parameters count up to {limits} (rad, rad/s), beyond as at it{peak}"


def _describe_limits(analysis: Analysis) -> list[str]:
    flights = (analysis.metrics, analysis.gust_alone, analysis.noise_alone)
    lines = []
    if unstable := bool(np.any(analysis.hover.loop_poles.real >= 0.0)):
        lines.append("the loop is unstable at hover")
    if not all(math.isfinite(flight.rmse_deg) and math.isfinite(flight.torque_slew_rms) for flight in flights):
        lines.append("the flight diverges: no figures")
    elif not unstable:
        lines += _describe_error(analysis)
    lines += _describe_robustness(analysis)
    if analysis.law.schedule is not None:
        lines.append(_describe_schedule(analysis))
    if not analysis.law.takes_references:
        lines.append("references: not supported, the law holds level")
    lines.append(_describe_rate_limit(analysis.law))
    if analysis.metrics.saturated_s:
        lines.append(f"torque limit: reached for {analysis.metrics.saturated_s:.3g} s")
    observable = "observable in roll and pitch; in yaw a constant bias gives an error of bias times time"
    lost = "a constant bias gives an error of bias times time, as gyros do not measure attitude"
    lines.append(f"gyro bias: {observable if analysis.law.uses_accelerometer else lost}")
    return lines


def _describe_robustness(analysis: Analysis) -> list[str]:
    lines = []
    if analysis.hover.margins is not None:
        loops = analysis.hover.margins.input
        worst = max(range(3), key=lambda axis: loops[axis].Ms)
        least = min(range(3), key=lambda axis: loops[axis].delay_margin)
        samples = loops[least].delay_margin / analysis.law.dt
        peak_omega = analysis.hover.omega[int(np.argmax(analysis.hover.sensitivities["S"]))]
        lines.append(f"robustness: Ms {loops[worst].Ms:.3g} in {AXES[worst]}, at {peak_omega:.3g} rad/s")
        if math.isfinite(samples):
            lines.append(f"delay: {samples:.3g} more samples make {AXES[least]} unstable")
    if analysis.stability:
        lines.append(f"vehicle: {_describe_stability(analysis.stability)}")
    return lines


def _describe_stability(axes: tuple[StabilityRange, ...]) -> str:
    """Return the certified range of inertia and lag, rounded down, and the nearest unstable member known."""
    proven = min(axis.certified for axis in axes)
    inertia, lag = (math.floor(1000.0 * proven * spread) / 10.0 for spread in (SPREADS.inertia, SPREADS.actuator_lag))
    certified = f"certified stable at hover (rounding bounded) for inertia ±{inertia:g} % and lag ±{lag:g} % together"
    known = [(axis.unstable, name) for axis, name in zip(axes, AXES, strict=True) if axis.unstable]
    if not known:
        return f"{certified}, no unstable case found"
    nearest, name = min(known, key=lambda pair: pair[0].times)
    return f"{certified}, {name} unstable at {100.0 * nearest.inertia:+.3g} % and {100.0 * nearest.actuator_lag:+.3g} %"


def _describe_error(analysis: Analysis) -> list[str]:
    """Return error and slew by cause, and the mean error."""
    whole, gust, noise = (
        (m.rmse_deg, m.torque_slew_rms) for m in (analysis.metrics, analysis.gust_alone, analysis.noise_alone)
    )
    shares = sorted((("gusts", gust[0]), ("gyro noise", noise[0])), key=lambda share: -share[1])
    causes = ", ".join(f"{name} alone {rmse:.3g} deg" for name, rmse in shares)
    room = "more bandwidth costs slew" if noise[1] > gust[1] else "more bandwidth is possible"
    lines = [
        f"error: {whole[0]:.3g} deg RMSE in this flight; {causes}",
        f"torque slew: {whole[1]:.3g} N m/s, of which {noise[1]:.3g} from gyro noise alone: {room}",
    ]
    placement = analysis.placement
    if placement is not None and placement.least_rmse_deg is not None:
        lines.append(
            f"average over many flights: this law {placement.rmse_deg:.3g} deg expected, best linear gyro-only law at "
            f"the same Ms and slew {placement.least_rmse_deg:.3g} deg (this flight: {whole[0]:.3g}, seed "
            f"{analysis.seed})"
        )
    return lines


def _describe_rate_limit(law: Law) -> str:
    if law.rate_limit is None:
        return "rate commanded from attitude: no limit, a large attitude error may tumble the vehicle"
    rates = ", ".join(f"{limit:.3g}" for limit in law.rate_limit.limits)
    angles = ", ".join(f"{angle:.3g}" for angle in np.degrees(law.attitude_limits))
    return (
        f"rate commanded from attitude: limited to {rates} rad/s, so errors beyond {angles} deg are flown back at that "
        "rate; margins, mu and predictions are for smaller ones"
    )


def _measure_flight(scenario: Scenario, law: Law, vehicle: Vehicle, seed: int) -> Metrics:
    return measure(fly_direct(scenario, law, vehicle=vehicle, seed=seed), vehicle, scenario, law=law)


def pole_pairs(poles: ComplexMatrix) -> list[tuple[float, float]]:
    """Return poles as pairs of real and imaginary part [rad/s], in order of modulus."""
    return [(float(pole.real), float(pole.imag)) for pole in sorted(poles, key=abs)]
