"""Laws, designs and the limits of both as tables and text, and the figure of a design's singular values."""

import math
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from firmware_model.types import AXES
from gustproof.design.cascades.flagship import GAIN_TOLERANCE
from gustproof.design.derive import DesignReport, margins_to_dict
from gustproof.design.tune import Tuning
from gustproof.robust.lpv.lpvsyn import LftController
from gustproof.show.report.terminal import Renderable, figures_table
from gustproof.studies.rate.analyse import Analysis, pole_pairs
from gustproof.studies.rate.placement import ErrorLimits

_FREQUENCIES = np.geomspace(1e-3, 1e3, 600)
_NOTE = (
    "Limits are small-angle averages over many flights; few flights scatter. Gyro noise alone makes the attitude "
    "drift, whatever the law; only the part above 'any slew' can be tuned away. The second table holds linear laws "
    "that were found, so it lies above the limit: by 1 % at Ms 1.15, .2 % from 1.36 on. In the first table and in the "
    "column 'any', no law is better, linear or not."
)
MARGINS = {
    "crossover_rad_s": "crossover\n[rad/s]",
    "phase_margin_deg": "phase\n[deg]",
    "gain_margin": "gain up\n[-]",
    "gain_reduction_margin": "gain down\n[-]",
    "delay_margin_s": "delay\n[s]",
    "Ms": "Ms\n[-]",
}
"""Key and heading of each margin of an axis."""


def render_analysis(analysis: Analysis) -> Renderable:
    """Return the analysis as tables and text."""
    law = analysis.law
    facts = Table("", "", title=f"Law '{law.name}': {law.provenance.design}", show_header=False)
    facts.add_row("states", str(law.order))
    facts.add_row("sample time", f"{law.dt:g} s")
    facts.add_row("commands", law.output.value)
    facts.add_row("exact kinematics in its attitude estimate", "yes" if law.has_kinematics else "no")
    if law.schedule is not None:
        facts.add_row("scheduled on", ", ".join(dict.fromkeys(law.schedule.parameters)))
    parts: list[Renderable] = [facts]
    if analysis.hover.margins is not None:
        parts.append(margins_table("at hover, sampled and delayed", margins_to_dict(analysis.hover.margins)))
    parts.append(Text(f"poles of the law [rad/s]: {format_poles(pole_pairs(analysis.hover.law_poles))}"))
    if len(analysis.hover.loop_poles):
        parts.append(Text(f"poles of the loop [rad/s]: {format_poles(pole_pairs(analysis.hover.loop_poles))}"))
    alone = {"gust alone": analysis.gust_alone, "gyro noise alone": analysis.noise_alone}
    columns = {analysis.scenario.name: analysis.metrics, **alone}
    parts.append(figures_table("Simulated in-process (bit-identical to UDP)", columns))
    return Group(*parts, Text("\n".join(["Limits:", *(f"- {line}" for line in analysis.limits())])))


def render_design(report: DesignReport) -> Renderable:
    """Return levels, order, margins and controller poles of a design."""
    figures = report.to_dict()
    levels = Table("", "", title=f"Design {figures['design']}: {figures['description']}", show_header=False)
    least = figures["gamma_opt"]
    if least is not None:
        levels.add_row("least level, gamma_opt", f"{least:.5f}")
    levels.add_row("level designed for, gamma", f"{figures['gamma']:.5f}")
    frequency = figures["norm_omega_rad_s"]
    levels.add_row("norm achieved", f"{figures['norm']:.5f}" + (f" at {frequency:.3g} rad/s" if frequency else ""))
    for check in figures["checks"]:
        levels.add_row("checked", check)
    levels.add_row("controller states", str(figures["order"]))
    levels.add_row("stability augmentation in the model, leak", f"{figures['leak_per_s']:g} 1/s")
    kind = "by its schedule" if isinstance(report.result, LftController) else "yes"
    levels.add_row("exact kinematics in the law", kind if figures["scheduled"] else "no")
    for name, value in figures.get("step", {}).items():
        levels.add_row(f"step of the reference: {name}", format_margin(value))
    return Group(
        levels,
        margins_table("as designed, continuous", figures["continuous"]),
        margins_table(f"as flown, sampled every {figures['dt_s']:g} s, one sample of delay", figures["sampled"]),
        Text(f"controller poles [rad/s]: {format_poles(figures['poles_rad_s'])}"),
    )


def save_design_figure(report: DesignReport, path: Path) -> None:
    """Draw the singular values of a design."""
    from gustproof.show.report.figures import save_singular_values

    curves, transfers = report.singular_values(_FREQUENCIES), report.weighted_transfers(_FREQUENCIES)
    title = f"Design {report.design.name}"
    save_singular_values(_FREQUENCIES, curves, report.result.gamma, title, path, transfers)


def render_tuning(tuning: Tuning) -> Renderable:
    """Return the figures of a tuned law, the limit beside its error."""
    table = Table("", "law", "limit", title=f"Law '{tuning.law.name}': predicted in '{tuning.scenario}'")
    limits, flown = tuning.limits, tuning.least_rmse is None
    name = "least of laws with gyros alone" if tuning.law.uses_accelerometer else "least"
    least = "-" if tuning.least_rmse is None else f"{math.degrees(tuning.least_rmse):.4f} at this Ms and slew"
    table.add_row("RMSE, three axes [deg]", f"{math.degrees(tuning.rmse):.4f}", f"{name}: {least}")
    if tuning.any_Ms_rmse is not None:
        table.add_row("", "", f"{name}: {math.degrees(tuning.any_Ms_rmse):.4f} at any Ms")
    table.add_row("torque slew [N m/s]", f"{tuning.slew:.4g}", "-" if flown else f"≤ {limits.slew:.4g}")
    table.add_row("Ms, the worst axis [-]", f"{tuning.Ms:.3f}", f"≤ {limits.sensitivity_peak:.3g}")
    if tuning.off_nominal_Ms is not None:
        # A search keeps these on a grid of frequencies, and between them the sensitivity may rise a little above.
        wanted = f"≤ {limits.corner_peak:.3g} is the goal, on a grid of frequencies"
        table.add_row(
            "Ms, ends of the spreads [-]",
            format_margin(tuning.off_nominal_Ms),
            wanted if math.isfinite(limits.corner_peak) else "-",
        )
    table.add_row("phase margin [deg]", f"{math.degrees(tuning.phase_margin):.0f}", "-")
    gain = f"≥ {limits.gain:.3g} is the goal, with {100.0 * GAIN_TOLERANCE:g} % tolerance" if limits.gain > 1.0 else "-"
    table.add_row("gain margin [-]", format_margin(tuning.gain_margin), gain)
    table.add_row("delay margin [ms]", format_margin(1e3 * tuning.delay_margin), "-")
    return table


def render_limits(limits: ErrorLimits) -> RenderableType:
    """Return the limits by the information of a law, and the trade-off with the sensitivity peak."""
    known = Table("known to the law", title=f"Least possible RMSE in '{limits.scenario}' [deg]")
    known.add_column(f"slew {limits.slew:.4g} N m/s", justify="right")
    known.add_column("any slew", justify="right")
    known.add_row("gyros, the true spectra", f"{limits.gyro_deg:.4f}", f"{limits.gyro_any_slew_deg:.4f}")
    known.add_row("state and air, exactly", f"{limits.clairvoyant_deg:.2g}", f"{limits.clairvoyant_any_slew_deg:.2g}")
    traded = Table("slew [N m/s]", title="Least RMSE [deg] of linear gyro-only laws by sensitivity peak Ms")
    rows = {
        curve.slew: {f"{Ms:.2f}": rmse for Ms, rmse in zip(curve.Ms, curve.rmse_deg, strict=True)}
        | {"any": curve.any_Ms_deg}
        for curve in limits.curves
    }
    peaks = sorted({peak for row in rows.values() for peak in row})
    for peak in peaks:
        traded.add_column(peak, justify="right")
    for slew, row in rows.items():
        traded.add_row(f"{slew:.4g}", *(f"{row[peak]:.4f}" if peak in row else "-" for peak in peaks))
    return Group(known, traded, Text(_NOTE, style="dim"))


def margins_table(title: str, places: dict[str, Any]) -> Table:
    """Return the margins of `margins_to_dict` by the plant's side and axis."""
    table = Table("plant's", "axis", *MARGINS.values(), "disk\n[-]", title=f"Margins {title}")
    for place, figures in places.items():
        for axis in AXES:
            cells = (format_margin(figures[axis][name]) for name in MARGINS)
            table.add_row(place, axis, *cells, format_margin(figures["disk_margin"]) if axis == "roll" else "")
    return table


def format_margin(value: float | None) -> str:
    """Return a margin as text; `None` is infinite."""
    return "∞" if value is None else f"{value:.3g}"


def format_poles(poles: Iterable[tuple[float, float]]) -> str:
    """Return poles as text, one of each conjugate pair; how often one of several equal ones is there."""
    texts = Counter(f"{re:.3g}" if im == 0.0 else f"{re:.3g} ± {im:.3g}j" for re, im in poles if im >= 0.0)
    return ", ".join(f"{text} ({count} times)" if count > 1 else text for text, count in texts.items())
