"""Laws of a report in the frequency domain: sensitivities, singular values against the weights, poles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.types import AXES
from gustproof.design.derive import DesignReport, derive
from gustproof.design.designs import Design, Weight
from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.robust.lti.state_space import ComplexMatrix, Matrix, lft
from gustproof.show.report.html.charts import (
    Chart,
    ChartGroup,
    ChartKind,
    Curve,
    CurveStyle,
    bracket_unit,
    decibels,
    frequency_chart,
    merge_curves,
)
from gustproof.show.report.html.marks import Mark
from gustproof.show.report.html.runs import ReportRun
from gustproof.studies.rate.hover_loop import HoverLoop, hover_loop
from gustproof.studies.rate.law_margins import SPREADS, axis_robustness_over_frequency
from gustproof.studies.rate.robustness import RobustnessOverFrequency

_OMEGA = np.geomspace(1e-3, 1e3, 400)
_LEAST_GAIN = 0.01  # [-] -40 dB: smaller sensitivities would flatten the peaks
_LEAST_LINEAR = 0.5  # [-] the same of the chart that is not in dB
_SAME_TOLERANCE = 1e-6  # [-] relative difference allowed between a law and its new derivation on another machine


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReportLaw:
    """Law of a report with the loop that it flew in."""

    label: str
    """Label of its first run."""
    colour: int
    """Index of its first run in the palette."""
    law: Law
    """The law."""
    hover: HoverLoop
    """Its loop at hover, sampled and delayed."""
    robustness: tuple[RobustnessOverFrequency, ...]
    """Bounds over frequency for roll, pitch, yaw under `SPREADS`; empty if the law couples axes or is unstable."""
    design: DesignReport | None
    """Its design; `None` if it has none, or if the design does not give this law again."""


def collect_laws(runs: Sequence[ReportRun]) -> tuple[ReportLaw, ...]:
    """Return each law of the runs, once for each vehicle, sample rate and delay."""
    found: dict[tuple[object, ...], ReportLaw] = {}
    for i, run in enumerate(runs):
        if run.law is None:  # a real autopilot's loops are its own
            continue
        key = (run.law.name, run.vehicle, run.scenario.dt, run.scenario.delay_samples)
        if key not in found:
            hover = hover_loop(run.law, run.vehicle, run.scenario)
            found[key] = ReportLaw(
                label=run.label,
                colour=i,
                law=run.law,
                hover=hover,
                robustness=axis_robustness_over_frequency(run.law, run.vehicle, run.scenario),
                design=_rederive(run.law),
            )
    return tuple(found.values())


def frequency_charts(laws: Sequence[ReportLaw]) -> tuple[ChartGroup, ...]:
    """Return the sensitivities of all laws, and the singular values of each designed law against its weights."""
    groups = []
    torque_laws = [law for law in laws if law.hover.sensitivities]
    if torque_laws:
        groups += [_sensitivity_charts(torque_laws), _loop_charts(torque_laws)]
    known = [law for law in laws if law.robustness]
    if known:
        groups.append(_mu_charts(known))
    return (*groups, *(_weight_charts(law.label, law.design) for law in laws if law.design is not None))


def _sensitivity_charts(laws: Sequence[ReportLaw]) -> ChartGroup:
    """Return S in dB, its peak on an axis that is not logarithmic, and T in dB."""
    charts = []
    for name in ("S", "T"):
        gains = [(law, law.hover.sensitivities[name]) for law in laws]
        curves = tuple(_loop_curve(law, decibels(np.where(gain > _LEAST_GAIN, gain, np.nan))) for law, gain in gains)
        charts.append(frequency_chart(f"largest singular value of {name} [dB]", curves, ChartKind.DECIBEL))
    gains = [(law, law.hover.sensitivities["S"]) for law in laws]
    curves = tuple(_loop_curve(law, np.where(gain > _LEAST_LINEAR, gain, np.nan)) for law, gain in gains)
    marks = tuple(map(_peak_mark, laws))
    charts.insert(1, frequency_chart("S about its peak, dot: Ms [-]", curves, ChartKind.SEMILOG, marks))
    note = "At the plant's input, sampled and delayed as flown. A rate law has no torque loop of its own."
    return ChartGroup(title="Sensitivity S and complementary sensitivity T", charts=tuple(charts), note=note)


def _loop_charts(laws: Sequence[ReportLaw]) -> ChartGroup:
    """Return the gain of each axis' loop, with the crossovers."""
    charts = []
    for k, axis in enumerate(AXES):
        gains = [decibels(_within(np.abs(law.hover.loop[:, k]))) for law in laws]
        curves = tuple(_loop_curve(law, gain) for law, gain in zip(laws, gains, strict=True))
        crossings = [(law, law.hover.margins.input[k]) for law in laws if law.hover.margins is not None]
        marks = tuple(
            Mark(
                label=f"{math.degrees(margins.phase_margin):.0f}°",
                x=(margins.crossover, margins.crossover),
                colour=law.colour,
            )
            for law, margins in crossings
        )
        zero = Mark(label="0 dB", y=0.0)
        charts.append(frequency_chart(f"{axis} |L| [dB]", curves, ChartKind.DECIBEL, (zero, *marks)))
    note = "At the plant's input, sampled and delayed as flown, within 80 dB. Upward lines: crossover and phase margin."
    return ChartGroup(title="Loop gain", charts=tuple(charts), note=note)


def _mu_charts(laws: Sequence[ReportLaw]) -> ChartGroup:
    """Return mu of each axis over frequency: bounds proved on bands, and below them what members tried attain."""
    charts = []
    for k, axis in enumerate(AXES):
        curves = []
        for law in laws:
            found = law.robustness[k]
            steps = np.where(np.isfinite(found.mu_proved), found.mu_proved, np.nan)
            tried = np.where(found.mu_found > 0.0, found.mu_found, np.nan)
            for label, values, style in (
                (law.label, steps, CurveStyle.SOLID),
                (f"{law.label}, sampled", tried, CurveStyle.DASHED),
            ):
                if not np.all(np.isnan(values)):
                    ends = np.repeat(found.omega, 2)[1:-1]
                    y = np.repeat(values, 2)
                    curves.append(Curve(label=label, colour=law.colour, x=ends, y=y, style=style))
        floor = Mark(label="search ends", y=laws[0].robustness[k].mu_floor)
        if curves:
            charts.append(frequency_chart(f"{axis} mu [-]", tuple(curves), ChartKind.SEMILOG, (floor,)))
    times = 1.0 / laws[0].robustness[0].mu_floor
    note = (
        f"Constant inertia within {SPREADS.inertia:.0%} and lag within {SPREADS.actuator_lag:.0%}, times 1/mu. "
        f"Solid: proved at every frequency of its band. Dashed: found by sampling. Tried up to {times:.2g} times."
    )
    return ChartGroup(title="mu over frequency", charts=tuple(charts), note=note)


def _loop_curve(law: ReportLaw, values: Matrix) -> Curve:
    return Curve(label=law.label, colour=law.colour, x=law.hover.omega, y=values)


def _peak_mark(law: ReportLaw) -> Mark:
    """Return the peak of S as a dot with its value."""
    gains = law.hover.sensitivities["S"]
    omega, peak = float(law.hover.omega[np.argmax(gains)]), float(np.max(gains))
    return Mark(label=f"{peak:.2f}", x=(omega, omega), y=peak, colour=law.colour)


def _within(gains: Matrix) -> Matrix:
    """Return gains, NaN beyond 80 dB."""
    return np.where((gains > 1e-4) & (gains < 1e4), gains, np.nan)


def pole_charts(laws: Sequence[ReportLaw]) -> tuple[ChartGroup, ...]:
    """Return the poles of each law and of its closed loop in the complex plane."""
    charts = []
    for law in laws:
        curves = [_pole_curve("law", law.colour, law.hover.law_poles, CurveStyle.SOLID)]
        if len(law.hover.loop_poles):
            curves.insert(0, _pole_curve("loop", None, law.hover.loop_poles, CurveStyle.HOLLOW))
        title = f"{law.label}: imaginary part [rad/s]"
        charts.append(Chart(title=title, x_label="real part [rad/s]", kind=ChartKind.PLANE, curves=tuple(curves)))
    note = "log(z)/dt of the law at level attitude and of the loop at hover. Axes are logarithmic away from 0."
    return (ChartGroup(title="Poles", charts=tuple(charts), note=note),) if charts else ()


def _pole_curve(label: str, colour: int | None, poles: ComplexMatrix, style: CurveStyle) -> Curve:
    ordered = poles[np.lexsort((poles.imag, poles.real))]
    return Curve(label=label, colour=colour, x=ordered.real, y=ordered.imag, style=style)


def _weight_charts(label: str, report: DesignReport) -> ChartGroup:
    """Return the unweighted transfers of a design by axis, with the bounds set by its weights and level."""
    level = report.result.gamma
    charts = []
    for transfer in report.weighted_transfers(_OMEGA):
        effect_unit, cause_unit = map(bracket_unit, transfer.units)
        title = f"{transfer.cause} to {transfer.effect} [{effect_unit}/{cause_unit}]"
        charts.append(_bounded_chart(title, transfer.gains, transfer.bounds))
    response = lft(report.problem.plant(), report.result.lti).response(_OMEGA)
    weighted = np.linalg.norm(response, ord=2, axis=(1, 2))
    allowed = np.full(len(_OMEGA), level)
    bound = Curve(label=f"γ = {level:.4g}", colour=None, x=_OMEGA, y=allowed, style=CurveStyle.DASHED)
    largest = Curve(label="w to z", colour=0, x=_OMEGA, y=weighted)
    charts.append(frequency_chart("weighted: largest singular value [-]", (bound, largest)))
    note = (
        f"Design {report.design.name}, in its own continuous model with its leak. Solid: the gain of each axis, a "
        "singular value at hover, where the axes do not couple. Dashed: the bound set by the weights and the level γ."
    )
    return ChartGroup(title=f"Singular values against the weights: {label}", charts=tuple(charts), note=note)


def _bounded_chart(title: str, gains: Matrix, bounds: Matrix) -> Chart:
    curves = [
        Curve(label=f"bound, {axis}", colour=k, x=_OMEGA, y=bounds[:, k], style=CurveStyle.DASHED)
        for k, axis in enumerate(AXES)
    ]
    curves = [
        *merge_curves(curves, "bound, all axes"),
        *(Curve(label=axis, colour=k, x=_OMEGA, y=gains[:, k]) for k, axis in enumerate(AXES)),
    ]
    return frequency_chart(title, tuple(curves))


def _rederive(law: Law) -> DesignReport | None:
    """Return the design that a law's provenance names, if it gives the same law again."""
    if "leak_per_s" not in law.provenance.parameters:  # not made from weights
        return None
    try:
        design = _parse_design(law)
        again, report = derive(design, load_vehicle(design.vehicle))
    except (ConfigError, DesignError, ValueError, KeyError):  # a user's own: a vehicle or a weight is missing
        return None
    if again.order != law.order or again.output is not law.output:
        return None
    pairs = [(getattr(again, name), getattr(law, name)) for name in "ABCDG"]
    same = all(np.max(np.abs(a - b)) <= _SAME_TOLERANCE * max(float(np.max(np.abs(b))), 1.0) for a, b in pairs)
    return report if same else None


def _parse_design(law: Law) -> Design:
    """Return the design with the weights and the level in a law's provenance."""
    known = law.provenance.parameters
    title, _, description = law.provenance.design.partition(": ")
    W_d, W_n, W_e, W_u = (_parse_weight(name, known) for name in ("W_d", "W_n", "W_e", "W_u"))
    has_reference = bool({"W_r_roll", "W_r_low_roll"} & set(known))
    return Design(
        name=title,
        description=description,
        law=law.name,
        vehicle=law.provenance.vehicle,
        dt=law.dt,
        W_d=W_d,
        W_n=W_n,
        W_e=W_e,
        W_u=W_u,
        W_r=_parse_weight("W_r", known) if has_reference else None,
        leak=known["leak_per_s"],
        gamma=known["gamma"],
        rate_damping=known.get("rate_damping_per_s"),
        rate_loop_lag=known.get("rate_loop_lag_s"),
        scheduled=law.is_scheduled,
    )


def _parse_weight(name: str, known: dict[str, float]) -> Weight:
    corner = known.get(f"{name}_corner_rad_s")
    ends = [f"{name}{end}" for end in (("", "") if corner is None else ("_low", "_high"))]
    low, high = ((known[f"{end}_roll"], known[f"{end}_pitch"], known[f"{end}_yaw"]) for end in ends)
    return Weight(low=low, high=high, corner=1.0 if corner is None else corner)
