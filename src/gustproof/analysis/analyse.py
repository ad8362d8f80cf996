"""What a law is worth on a vehicle: margins, poles, responses, and what its error is made of."""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from firmware_model.config.moments import MomentStep
from firmware_model.config.scenario import AccelerometerFault, GyroFault, Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.analysis.hover_loop import HoverLoop, hover_loop
from gustproof.analysis.law_margins import SPREADS, axis_robustness
from gustproof.analysis.placement import Placement, locate
from gustproof.certify.sweep import Bracket
from gustproof.law.form import Law
from gustproof.lti.state_space import ComplexMatrix
from gustproof.scoring.metrics import Metrics, measure
from gustproof.simulate.direct import fly_direct
from gustproof.synthesis.derive import margins_to_dict

_AXES = ("roll", "pitch", "yaw")
"""What a vehicle's file may well be off by."""
_STEP_S = 5.0
_STEP_SHARE = 0.03  # [-] of the torque limit: small enough for every sound law to stay near level

Records = NDArray[np.void]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Analysis:
    """Linear figures of the loop at hover, and flights on the direct route."""

    law: Law
    """What was analysed."""
    scenario: Scenario
    """Air and rates of the flights."""
    seed: int
    """Seed of gusts and noise."""
    hover: HoverLoop
    """The linear loop at hover."""
    stability: tuple[Bracket, ...]
    """mu of roll, pitch, yaw, of inertia 20 % and lag 30 % off; none where the law couples axes or has no margins."""
    place: Placement | None
    """Foretold error beside the least of any linear gyro-only law at its price; `None` where there is no such price."""
    step: Records
    """Flight through a step of moment about each axis, without air or noise."""
    step_moment: tuple[float, float, float]
    """[N*m] B, height of the step."""
    flown: Records
    """Flight through the scenario."""
    whole: Metrics
    """Figures of that flight."""
    gust_alone: Metrics
    """Figures of the same flight with a noiseless gyro."""
    noise_alone: Metrics
    """Figures of the same flight in still air."""

    def limits(self) -> tuple[str, ...]:
        """Return what limits the law, in words, the largest share of the error first."""
        return tuple(_describe_limits(self))

    def document(self) -> dict[str, Any]:
        """Return the analysis as JSON has it; what is not finite is `None`."""
        document = {
            "law": self.law.name,
            "order": self.law.order,
            "dt_s": self.law.dt,
            "output": self.law.output.value,
            "scheduled": self.law.is_scheduled,
            "takes_references": self.law.takes_references,
            "reference_limit_deg": limit if math.isfinite(limit := self.law.reference_limit_deg) else None,
            "design": self.law.provenance.design,
            "scenario": self.scenario.name,
            "seed": self.seed,
            "margins": None if self.hover.margins is None else margins_to_dict(self.hover.margins),
            "off_nominal": {
                "inertia_spread": SPREADS.inertia,
                "actuator_lag_spread": SPREADS.actuator_lag,
                "stable_up_to_times": [1.0 / axis.upper for axis in self.stability],
            },
            "place": None if self.place is None else asdict(self.place),
            "law_poles_rad_s": pole_pairs(self.hover.law_poles),
            "loop_poles_rad_s": pole_pairs(self.hover.loop_poles),
            "flown": asdict(self.whole),
            "gust_alone": asdict(self.gust_alone),
            "noise_alone": asdict(self.noise_alone),
            "limits": list(self.limits()),
        }
        finite: dict[str, Any] = to_jsonable_python(document, inf_nan_mode="null")
        return finite


def analyse(law: Law, vehicle: Vehicle, scenario: Scenario, *, seed: int = 1) -> Analysis:
    """Return what a law does on a vehicle, at the sample time and delay of `scenario` and in its air.

    Raises
    ------
    ValueError
        If the law's sample time is not the scenario's.
    """
    roll, pitch, yaw = vehicle.torque_limit
    step_moment = (_STEP_SHARE * roll, _STEP_SHARE * pitch, _STEP_SHARE * yaw)
    gyro, accelerometer = GyroFault(noise=False), AccelerometerFault(noise=False)
    still = replace(scenario, wind=(), moment=(), duration_s=_STEP_S, gyro=gyro, accelerometer=accelerometer)
    stepped = replace(still, moment=(MomentStep(kind="step", amplitude_nm=step_moment, start_s=0.5),))
    quiet = replace(
        scenario, gyro=replace(scenario.gyro, noise=False), accelerometer=replace(scenario.accelerometer, noise=False)
    )
    flown = fly_direct(scenario, law, vehicle=vehicle, seed=seed)
    hover = hover_loop(law, vehicle, scenario)
    Ms = None if hover.margins is None else max(axis.Ms for axis in hover.margins.input)
    return Analysis(
        law=law,
        scenario=scenario,
        seed=seed,
        hover=hover,
        stability=axis_robustness(law, vehicle, scenario),
        place=None if Ms is None else locate(law, Ms, vehicle, scenario),
        step=fly_direct(stepped, law, vehicle=vehicle, seed=seed),
        step_moment=step_moment,
        flown=flown,
        whole=measure(flown, vehicle, scenario, 0.0),
        gust_alone=_measure_flight(quiet, law, vehicle, seed),
        noise_alone=_measure_flight(replace(scenario, wind=(), moment=()), law, vehicle, seed),
    )


def _describe_limits(analysis: Analysis) -> list[str]:
    flights = (analysis.whole, analysis.gust_alone, analysis.noise_alone)
    lines = []
    if unstable := bool(np.any(analysis.hover.loop_poles.real >= 0.0)):
        lines.append("the loop is unstable at hover")
    if not all(math.isfinite(flight.rmse_deg) and math.isfinite(flight.torque_slew_rms) for flight in flights):
        lines.append("the flight diverges: it has no figures")
    elif not unstable:
        lines += _price(analysis)
    if analysis.hover.margins is not None:
        loops = analysis.hover.margins.input
        worst = max(range(3), key=lambda axis: loops[axis].Ms)
        least = min(range(3), key=lambda axis: loops[axis].delay_margin)
        samples = loops[least].delay_margin / analysis.law.dt
        lines.append(
            f"robustness: Ms {loops[worst].Ms:.3g} in {_AXES[worst]}, at {_peak_frequency(analysis):.3g} rad/s"
        )
        if math.isfinite(samples):
            lines.append(f"delay: {samples:.3g} samples more make {_AXES[least]} unstable")
    if analysis.stability:
        room = 1.0 / max(axis.upper for axis in analysis.stability)
        spreads = f"{100.0 * SPREADS.inertia:g} % and the lag {100.0 * SPREADS.actuator_lag:g} %"
        lines.append(
            f"vehicle: the inertia may be off by {room:.2g} times {spreads} before it is unstable (mu, at hover)"
        )
    lines.append(f"references: {_references(analysis.law)}")
    if analysis.whole.saturated_s:
        lines.append(f"torque limit: reached for {analysis.whole.saturated_s:.3g} s")
    if analysis.law.uses_accelerometer:
        lines.append("gyro bias: seen in roll and pitch; in yaw a constant one turns the vehicle by bias times time")
    else:
        lines.append("gyro bias: a constant one turns the vehicle by bias times time; a gyro can't see attitude")
    return lines


def _price(analysis: Analysis) -> list[str]:
    """Return error and slew by their causes, and the error on average."""
    whole, gust, noise = (
        (m.rmse_deg, m.torque_slew_rms) for m in (analysis.whole, analysis.gust_alone, analysis.noise_alone)
    )
    shares = sorted((("gusts", gust[0]), ("gyro noise", noise[0])), key=lambda share: -share[1])
    causes = ", ".join(f"{name} alone {rmse:.3g} deg" for name, rmse in shares)
    room = "more bandwidth costs slew" if noise[1] > gust[1] else "there is room for more bandwidth"
    lines = [
        f"error: {whole[0]:.3g} deg RMSE in this flight; {causes}",
        f"torque slew: {whole[1]:.3g} N m/s, of which gyro noise alone makes {noise[1]:.3g}: {room}",
    ]
    if analysis.place is not None and analysis.place.least_rmse_deg is not None:
        lines.append(
            f"average over many flights: this law {analysis.place.rmse_deg:.3g} deg expected, best linear gyro-only "
            f"law at the same Ms and slew {analysis.place.least_rmse_deg:.3g} deg (this flight: {whole[0]:.3g}, seed "
            f"{analysis.seed})"
        )
    return lines


def _references(law: Law) -> str:
    if not law.takes_references:
        return "none are read, level is held"
    if math.isinf(law.reference_limit_deg):
        return "no limit is known"
    return f"held within {law.reference_limit_deg:g} deg of level about each axis; a larger one may tumble the vehicle"


def _peak_frequency(analysis: Analysis) -> float:
    return float(analysis.hover.omega[int(np.argmax(analysis.hover.sensitivities["S"]))])


def _measure_flight(scenario: Scenario, law: Law, vehicle: Vehicle, seed: int) -> Metrics:
    return measure(fly_direct(scenario, law, vehicle=vehicle, seed=seed), vehicle, scenario, 0.0)


def pole_pairs(poles: ComplexMatrix) -> list[tuple[float, float]]:
    """Return poles as pairs of real and imaginary part [rad/s], smallest modulus first."""
    return [(float(pole.real), float(pole.imag)) for pole in sorted(poles, key=abs)]
