"""Time histories, loops and trade-offs as PNG, PDF or SVG. A law keeps its colour in every figure."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatter

from firmware_model.errors import ConfigError
from firmware_model.types import AXES
from gustproof.airframe.lpv import PARAMETERS, scheduling_parameters
from gustproof.airframe.tradeoff import TradeOff
from gustproof.design.derive import WeightedTransfer
from gustproof.design.tune import Tuning
from gustproof.flight.scoring.metrics import Metrics, attitude
from gustproof.show.report.figure_style import font_size, is_paper, legend_columns, new_figure, panels, save_figure
from gustproof.studies.campaign.comparison import ComparisonRow
from gustproof.studies.rate.analyse import Analysis
from gustproof.studies.rate.hover_loop import HoverLoop
from gustproof.studies.rate.law_margins import SPREADS
from gustproof.studies.rate.placement import ErrorLimits, Places
from gustproof.studies.rate.robustness import RobustnessOverFrequency
from gustproof.types import Array, Records

Flights = Mapping[str, Records]

# No two laws have one hue: these are 25 degrees apart, or grey and black. Four are of Okabe and Ito's palette.
_COLOURS = {
    "pid-default": "#999999",
    "hinf-d1": "#0072b2",
    "hinf-d1-noise": "#5b4bd6",
    "hinf-d2": "#009e73",
    "pid-fair": "#d55e00",
    "hinf-scheduled": "#000000",
    "hinf-rates": "#d6304a",
    "indi": "#559911",
    "flagship": "#aa2277",
    "flagship-robust": "#9a3fd1",
    "aided": "#8a7d00",
}
_DEFAULT_COLOUR = "#22a01f"
_SHADES = ("#c9b8e8", "#7b5cc4", "#3d1f8f")  # of limits: darker for more slew
_INK, _GRID = "#333333", "#dddddd"
_CURVES = ("#0072b2", "#009e73", "#cc79a7", "#e69f00")
_MOST_TRACES = 4  # noisy traces in one panel that an eye can tell apart
_AXIS_COLOURS = ("#0072b2", "#d55e00", "#009e73")
_MOST_DB = 80.0
_LEAST_SENSITIVITY_DB = -40.0  # smaller sensitivities would flatten the peaks
_SPREADS = f"inertia ±{SPREADS.inertia:.0%}, lag ±{SPREADS.actuator_lag:.0%}"
_GAINS = (1e-4, 1e15)
"""[-] range of the drawn gains."""
_ROUNDING = 1e-6
"""[-] singular values that stay below this share of the transfer's largest are rounding errors of 0."""


HISTORIES: dict[str, tuple[str, tuple[str, ...], Callable[[Records], Array]]] = {
    "euler-angles": (
        "Euler angles",
        ("roll φ [deg]", "pitch θ [deg]", "yaw ψ [deg]"),
        lambda records: np.degrees(attitude(records)),
    ),
    "body-rates": ("Body rates", ("p [rad/s]", "q [rad/s]", "r [rad/s]"), lambda records: records["omega_B"]),
    "torques": (
        "Commanded torques",
        tuple(f"{axis} torque [N m]" for axis in AXES),
        lambda records: records["torque_command_B"],
    ),
}
"""Title, axes and values (n, 3) of each kind of time history."""


def save_moments(records: Records, path: Path) -> None:
    """Draw the disturbance moments of one flight."""
    labels = tuple(f"{axis} moment [N m]" for axis in AXES)
    save_figure(_draw_stacked({"": records}, lambda r: r["moment_B"], labels, "Disturbance torques"), path)


def save_histories(kind: str, flights: Flights, title: str, path: Path) -> None:
    """Draw one of `HISTORIES` of several laws in the same air."""
    save_figure(draw_histories(kind, flights, title), path)


def draw_histories(kind: str, flights: Flights, title: str) -> Figure:
    """Return the figure of one of `HISTORIES` of several laws.

    Raises
    ------
    ValueError
        If there is no such kind.
    """
    if kind not in HISTORIES:
        raise ValueError(f"no kind {kind!r} of a figure: {', '.join(HISTORIES)}")
    heading, labels, values = HISTORIES[kind]
    return _draw_stacked(flights, values, labels, f"{heading}: {title}", closer=kind == "euler-angles")


def save_scheduling(records: Records, law: str, path: Path) -> None:
    """Draw rho(t) of one flight with the bounds of the paper's Table II."""
    rho = scheduling_parameters(attitude(records), records["omega_B"])
    figure, time = _new_figure((9.0, 7.2), f"Scheduling parameters against Table II: {law}"), _time(records)
    grid = figure.subplots(4, 2, sharex=True)
    # Trigonometric parameters on the left, rates on the right, below the legend.
    places = [*grid[:, 0], *grid[1:, 1]]
    for axes, parameter, values in zip(places, PARAMETERS, rho.T, strict=True):
        axes.plot(time, values, color=_colour(law), linewidth=1.0)
        for bound in (parameter.low, parameter.high):
            axes.axhline(bound, color="#d55e00", linestyle="--", linewidth=1.0)
        margin = 0.12 * (parameter.high - parameter.low)
        axes.set_ylim(min(parameter.low, values.min()) - margin, max(parameter.high, values.max()) + margin)
        axes.set_xlim(0.0, _end_of(records))
        _style_axes(axes, f"{parameter.label} = {parameter.meaning}")
    grid[0, 1].axis("off")
    lines = [Line2D([], [], color=_colour(law)), Line2D([], [], color="#d55e00", linestyle="--")]
    grid[0, 1].legend(lines, [law, "bounds of Table II"], loc="center", frameon=False)
    for axes in grid[3]:
        axes.set_xlabel("time [s]")
    save_figure(figure, path)


def save_singular_values(
    frequency: Array,
    curves: Mapping[str, Array],
    level: float,
    title: str,
    path: Path,
    transfers: Sequence[WeightedTransfer] = (),
) -> None:
    """Draw singular values (n, k) [dB] over `frequency` (n,) [rad/s] by name, and the bound of "w to z".

    Each transfer has a panel. Values that stay below 1e-6 of the transfer's largest are rounding, and left out. In
    rows below stand `transfers` without their weights, dashed the bounds that level and weights set. A paper's column
    has no room for them.
    """
    columns, transfers = len(curves), () if is_paper() else transfers
    rows = 1 + math.ceil(len(transfers) / columns)
    figure = _new_figure((4.2 * columns + 0.4, 3.9 * rows + 0.3), title)
    drawn = panels(figure, rows, columns)
    for axes, (name, values), colour in zip(drawn, curves.items(), _CURVES, strict=False):
        real = values[:, np.max(values, axis=0) > _ROUNDING * np.max(values)]
        lines = axes.semilogx(frequency, _decibels(real), color=colour, linewidth=1.3)
        peak = float(np.max(real))
        lines[0].set_label(f"{name}, peak {peak:.2f}" if name[0] in "ST" else name)
        bound, label = (level, f"γ = {level:.4g}") if name == "w to z" else (1.0, "0 dB")
        axes.axhline(20.0 * math.log10(bound), color="#d55e00", linestyle="--", linewidth=1.0, label=label)
        _limit_floor(axes, 20.0 * math.log10(_GAINS[0]))
        _style_axes(axes, "singular values [dB]", x_label="frequency [rad/s]")
        axes.set_xlim(frequency[0], frequency[-1])
        axes.legend(frameon=False, fontsize=font_size(9), loc="lower left" if name == "w to z" else "best")
    for axes, transfer in zip(drawn[columns:], transfers, strict=False):
        for axis, gains, bounds, colour in zip(AXES, transfer.gains.T, transfer.bounds.T, _AXIS_COLOURS, strict=True):
            axes.semilogx(frequency, _decibels(gains), color=colour, linewidth=1.3, label=axis)
            axes.semilogx(frequency, _decibels(bounds), color=colour, linestyle="--", linewidth=1.0)
        label = "gain [dB re ({})/({})]".format(*transfer.units)
        _style_axes(axes, label, f"{transfer.cause} to {transfer.effect}", "frequency [rad/s]")
        axes.set_ylim(bottom=float(np.max(_decibels(transfer.gains))) - _MOST_DB)
        axes.set_xlim(frequency[0], frequency[-1])
        axes.legend(title="dashed: γ over weights", frameon=False, fontsize=font_size(8), title_fontsize=font_size(8))
    for axes in drawn[columns + len(transfers) :]:
        axes.axis("off")
    save_figure(figure, path)


def save_trade_off(limits: ErrorLimits, placed: Places, flown: Mapping[str, Metrics], path: Path) -> None:
    """Draw error against sensitivity peak: the limits, and each law as predicted (ring) and as `flown` (disc).

    The left panel shows all laws, the right panel those near the limit.
    """
    places = {name: place for name, place in placed.items() if place is not None}
    figure = _new_figure((11.0, 5.6), f"Least attitude error against robustness: {limits.scenario}")
    whole, near = panels(figure, 1, 2)
    for axes in (whole, near):
        for curve, shade in zip(limits.curves, _SHADES, strict=False):
            axes.plot(curve.Ms, curve.rmse_deg, color=shade, label=f"least of linear laws, slew {curve.slew:g} N m/s")
        label = f"least of all gyro-only laws, slew {limits.slew:g} N m/s"
        axes.axhline(limits.gyro_deg, color=_SHADES[1], linestyle="--", label=label)
        for law, place in places.items():
            ends = [place.rmse_deg, flown[law].rmse_deg]
            axes.plot([place.Ms, place.Ms], ends, color=_colour(law), linewidth=0.8)
            axes.plot(place.Ms, ends[0], "o", color=_colour(law), fillstyle="none")
            axes.plot(place.Ms, ends[1], "o", color=_colour(law), label=f"{law}, slew {place.slew:.3g} N m/s")
        _style_axes(axes, "RMSE, three axes [deg]")
        axes.set_xlabel("sensitivity peak Ms, the worst axis [-]")
    whole.set_yscale("log")
    near.set_xlim(1.1, 2.0)
    least = min([limits.gyro_any_slew_deg, *(flown[law].rmse_deg for law in places)])
    near.set_ylim(0.9 * least, 3.0 * limits.gyro_any_slew_deg)
    known = f"with state and air known exactly: {limits.clairvoyant_deg:.2g} deg"
    near.text(0.98, 0.95, known, transform=near.transAxes, ha="right", fontsize=font_size(9), color=_INK)
    handles, labels = whole.get_legend_handles_labels()
    handles.append(Line2D([], [], color=_INK, marker="o", fillstyle="none", linewidth=0.0))
    labels.append("ring: predicted average over many flights; disc: flown")
    figure.legend(
        handles, labels, loc="outside lower center", ncols=1 if is_paper() else 3, frameon=False, fontsize=font_size(9)
    )
    save_figure(figure, path)


def save_tuning(tuning: Tuning, curves: tuple[Sequence[TradeOff], Sequence[TradeOff]], path: Path) -> None:
    """Draw the error of a tuned law beside the least of linear laws, over the slew and over the sensitivity peak."""
    figure = _new_figure((11.0, 4.6), f"{tuning.law.name}: {tuning.scenario}")
    over_slew, over_peak = panels(figure, 1, 2, sharey=True)
    for axes, points, value, own, label, title in (
        (over_slew, curves[0], "slew", tuning.slew, "torque slew [N m/s]", f"at Ms {tuning.Ms:.2f}"),
        (over_peak, curves[1], "sensitivity_peak", tuning.Ms, "Ms, the worst axis [-]", f"at {tuning.slew:.3g} N m/s"),
    ):
        xs, ys = [getattr(point, value) for point in points], [math.degrees(point.rmse) for point in points]
        axes.plot(xs, ys, color=_SHADES[1], marker=".", label="least of linear gyro-only laws")
        axes.plot(own, math.degrees(tuning.rmse), "o", color=_colour(str(tuning.kind)), label=tuning.law.name)
        _style_axes(axes, "RMSE, three axes [deg]", title, label)
    over_slew.legend(frameon=False, fontsize=font_size(9))
    save_figure(figure, path)


def save_comparison(title: str, rows: Sequence[ComparisonRow], path: Path) -> None:
    """Draw error by an autopilot's own estimate over torque slew: of each row as predicted (ring) and flown (disc).

    What has no such estimate is not drawn beside what has; where nothing has one, it is the true error. If the scenario
    has phases, the error in each over that of the first stands beside it.
    """
    has_phases = len(rows) > 1 and bool(rows[0].phases) and not rows[0].by_scenario  # of several there are too many
    figure = _new_figure((14.0, max(5.0, 0.5 * len(rows[0].phases))) if has_phases else (8.0, 5.0), title)
    axes, *others = panels(figure, 1, 2 if has_phases else 1)
    _draw_prices(axes, rows)
    for each in others:
        _draw_phases(each, rows)
    save_figure(figure, path)


def _draw_prices(axes: Axes, rows: Sequence[ComparisonRow]) -> None:
    """Draw error over torque slew."""
    has_own = any(row.own_rmse_deg is not None for row in rows)
    label = "RMSE by its own estimate [deg]" if has_own else "RMSE, means removed [deg]"
    legend = "ring: by the model, disc: flown" if has_own else "flown"
    for index, row in enumerate(rows):
        if (error := row.own_rmse_deg if has_own else row.steady_rmse_deg) is None:
            continue
        slew, colour = row.torque_slew_rms, _CURVES[index % len(_CURVES)]
        axes.plot(slew, error, "o", color=colour, label=row.name)
        axes.annotate(f"  {row.name}", (slew, error), fontsize=font_size(8), color=_INK)
        if row.predicted_slew is not None and row.predicted_own_rmse_deg is not None:
            axes.plot([row.predicted_slew, slew], [row.predicted_own_rmse_deg, error], color=colour, linewidth=0.8)
            axes.plot(row.predicted_slew, row.predicted_own_rmse_deg, "o", color=colour, fillstyle="none", markersize=9)
    _style_axes(axes, label, legend, "torque slew [N m/s]")
    axes.margins(x=0.2)  # for the names
    _label_logarithmic(axes)


def _label_logarithmic(axes: Axes) -> None:
    """Make both axes logarithmic, with as many labels as have room."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        axis.set_major_formatter("{x:g}")
        shown = "25" if high > 10.0 * low else "23456789" if high > 2.0 * low else "123456789"  # all would overlap
        axis.set_minor_formatter(partial(_label_minor, shown))


def _draw_phases(axes: Axes, rows: Sequence[ComparisonRow]) -> None:
    """Draw the error in each phase over that of the first row, with its interval if it has one; the first on top."""
    for j, row in enumerate(rows[1:], 1):
        colour = _CURVES[j % len(_CURVES)]
        told = [(k, phase.rmse_ratio) for k, phase in enumerate(row.phases) if phase.rmse_ratio is not None]
        for k, ratio in told:
            y = k + 0.6 * (j / len(rows) - 0.5)
            axes.plot(ratio.value, y, "o", color=colour)
            if math.isfinite(ratio.high):
                axes.plot([ratio.low, ratio.high], [y, y], color=colour, linewidth=0.8)
    axes.axvline(1.0, color=_INK, linewidth=0.8)
    _style_axes(axes, "", "by phase: intervals hold one by one", f"RMSE over that of {rows[0].name} [-]")
    axes.set_yticks(range(len(rows[0].phases)), [fill(each.name, 32) for each in rows[0].phases], fontsize=font_size(8))
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(partial(_label_minor, "25"))


def _label_minor(digits: str, x: float, _: int) -> str:
    """Return the label of a place of a logarithmic axis if its leading digit is among `digits`."""
    return f"{x:g}" if f"{x:.0e}"[0] in digits else ""


def save_analysis(
    analysis: Analysis, robustness: Sequence[RobustnessOverFrequency], path: Path, *, chosen: Sequence[str] = ()
) -> None:
    """Write the figure of `draw_analysis`."""
    save_figure(draw_analysis(analysis, robustness, chosen=chosen), path)


PANELS = ("loop", "sensitivity", "phase", "mu", "spreads", "step", "torque", "gust")
"""Panels of an analysis."""
_PAPER_PANELS = ("loop", "sensitivity", "gust")  # as many as a column holds beside text


def draw_analysis(
    analysis: Analysis, robustness: Sequence[RobustnessOverFrequency] = (), *, chosen: Sequence[str] = ()
) -> Figure:
    """Draw the `chosen` of `PANELS`: Bode plot and sensitivities of a torque law, its flights in a step and the gusts.

    Without a choice all are drawn, in a paper three. With the `robustness` of roll, pitch and yaw two panels show mu
    and the sensitivity over the spreads.

    Raises
    ------
    ConfigError
        If a chosen panel is unknown, or the law has none.
    """
    known = _analysis_panels(analysis, robustness)
    names = _choose_panels(known, chosen, analysis.law.name)
    columns = len(names) if len(names) < 4 else 2
    rows = -(-len(names) // columns)
    size = (3.7 * columns, 3.4) if rows == 1 else (11.0, 2.7 * rows)
    figure = _new_figure(size, f"{analysis.law.name}: {analysis.scenario.name}")
    drawn = panels(figure, rows, columns)
    for axes, name in zip(drawn, names, strict=False):
        known[name](axes)
    for axes in drawn[len(names) :]:
        axes.remove()
    return figure


def _choose_panels(known: Iterable[str], chosen: Sequence[str], law: str) -> Sequence[str]:
    """Return the chosen of the `known` panels; those of the look if none is."""
    if unknown := [name for name in chosen if name not in PANELS]:
        raise ConfigError(f"no panel named '{unknown[0]}': known are {', '.join(PANELS)}")
    if absent := [name for name in chosen if name not in known]:
        raise ConfigError(f"law '{law}' has no panel '{absent[0]}', only {', '.join(known)}")
    return chosen or [name for name in known if not is_paper() or name in _PAPER_PANELS] or [*known]


def _analysis_panels(
    analysis: Analysis, robustness: Sequence[RobustnessOverFrequency]
) -> dict[str, Callable[[Axes], None]]:
    """Return what draws each panel that there is."""
    hover, stepped, flown = analysis.hover, analysis.step_records, analysis.records
    height = ", ".join(f"{value:g}" for value in analysis.step_moment)
    found: dict[str, Callable[[Axes], None]] = {}
    if len(hover.loop):
        found |= {"loop": partial(_draw_gain, hover), "sensitivity": partial(_draw_sensitivities, hover)}
        found["phase"] = partial(_draw_phase, hover)
        if robustness:
            found |= {"mu": partial(_draw_mu, robustness), "spreads": partial(_draw_spreads, robustness)}
    for name, records, values, label, title in (
        ("step", stepped, np.degrees(attitude(stepped)), "angles [deg]", f"moment step, {height} N m"),
        ("torque", flown, flown["torque_command_B"], "torque [N m]", f"flown: {analysis.scenario.name}"),
        ("gust", flown, np.degrees(attitude(flown)), "angles [deg]", f"flown: {analysis.scenario.name}"),
    ):
        found[name] = partial(_draw_flown, _time(records), values, label, title)
    return found


def draw_distributions(campaign: str, values: Mapping[str, Mapping[str, Array]]) -> Figure:
    """Draw, in a panel for each figure [its unit], the share of the cases at or below a value, for each law."""
    figure = _new_figure((5.0 * len(values), 3.6), campaign)
    for axes, (label, laws) in zip(panels(figure, 1, len(values)), values.items(), strict=True):
        colours = law_colours(laws)
        for law, cases in laws.items():
            known = np.sort(cases[np.isfinite(cases)])
            shares = 100.0 * np.arange(1, len(known) + 1) / max(len(known), 1)
            axes.step(known, shares, where="post", color=colours[law], label=law)
        _style_axes(axes, "share of the cases [%]", "", label)
    figure.axes[0].legend(frameon=False, fontsize=font_size(9))
    return figure


def _draw_flown(time: Array, values: Array, label: str, title: str, axes: Axes) -> None:
    """Draw three axes (n, 3) over time [s]; that which changes least lies on top, as others would hide it."""
    order = np.argsort(np.argsort(-np.nansum(np.abs(np.diff(values, axis=0)), axis=0)))
    for column, axis, colour, place in zip(values.T, AXES, _AXIS_COLOURS, order.tolist(), strict=True):
        axes.plot(
            time, column, color=colour, linewidth=0.6 if is_paper() else 1.0, label=axis, zorder=2.0 + 0.1 * place
        )
    _finish_panel(axes, label, title, "time [s]")


def _draw_mu(robustness: Sequence[RobustnessOverFrequency], axes: Axes) -> None:
    """Draw mu as steps that are proved on each band of frequency, and below them, dotted, what members tried attain."""
    for axis, found, colour in zip(AXES, robustness, _AXIS_COLOURS, strict=True):
        tried = np.where(found.mu_found > 0.0, found.mu_found, np.nan)
        _draw_bands(axes, found, found.mu_proved, tried, axis, colour)
    floor = robustness[0].mu_floor
    label = f"{1.0 / floor:.2g} times the spreads: search ends"
    axes.axhline(floor, color=_INK, linestyle="--", linewidth=0.8, label=label)
    axes.set_ylim(bottom=0.0)
    _finish_panel(axes, "mu [-]", f"mu, {_SPREADS}: steps proved, dots sampled", "frequency [rad/s]")


def _draw_spreads(robustness: Sequence[RobustnessOverFrequency], axes: Axes) -> None:
    """Draw the sensitivity over the spreads: proved steps, and dotted what members tried attain."""
    for axis, found, colour in zip(AXES, robustness, _AXIS_COLOURS, strict=True):
        _draw_bands(axes, found, _decibels(found.S_proved), _decibels(found.S_found), axis, colour)
    _finish_panel(axes, "|S| [dB]", f"|S|, {_SPREADS}: steps proved, dots sampled", "frequency [rad/s]")
    _limit_floor(axes, _LEAST_SENSITIVITY_DB)


def _draw_bands(
    axes: Axes, found: RobustnessOverFrequency, proved: Array, sampled: Array, label: str, colour: str
) -> None:
    steps = np.where(np.isfinite(proved), proved, np.nan)
    axes.step(found.omega, np.append(steps, steps[-1]), where="post", color=colour, linewidth=1.2, label=label)
    middle = np.sqrt(found.omega[1:] * found.omega[:-1])
    axes.plot(middle, sampled, color=colour, linestyle=":", marker=".", markersize=3.0, linewidth=0.9)
    axes.set_xscale("log")


def _draw_gain(hover: HoverLoop, axes: Axes) -> None:
    """Draw the gain of the loop at the plant's input axis by axis [dB], with gain margins and crossovers."""
    for i, (axis, values, colour) in enumerate(zip(AXES, hover.loop.T, _AXIS_COLOURS, strict=True)):
        label = axis
        if hover.margins is not None:
            label = f"{axis}: GM {20.0 * math.log10(hover.margins.input[i].gain_margin):.1f} dB"
        axes.semilogx(hover.omega, _decibels(np.abs(values)), color=colour, linewidth=1.2, label=label)
    _mark_crossovers(hover, axes)
    axes.axhline(0.0, color=_INK, linestyle="--", linewidth=0.8)
    _finish_panel(axes, "|L| [dB]", "loop at the plant's input", "frequency [rad/s]")
    _limit_floor(axes, 20.0 * math.log10(_GAINS[0]))


def _draw_phase(hover: HoverLoop, axes: Axes) -> None:
    """Draw the phase of the loop at the plant's input axis by axis [deg], with phase margins and crossovers."""
    for i, (axis, values, colour) in enumerate(zip(AXES, hover.loop.T, _AXIS_COLOURS, strict=True)):
        angles = np.degrees(np.unwrap(np.angle(values)))
        turns = 360.0 * np.ceil(angles[0] / 360.0)
        label = axis
        if hover.margins is not None:
            margins = hover.margins.input[i]
            at = "" if is_paper() else f" deg at {margins.crossover:.3g} rad/s"
            label = f"{axis}: PM {math.degrees(margins.phase_margin):.0f}{at or '°'}"
        axes.semilogx(hover.omega, angles - turns, color=colour, linewidth=1.2, label=label)
    _mark_crossovers(hover, axes)
    axes.axhline(-180.0, color=_INK, linestyle="--", linewidth=0.8)
    _finish_panel(axes, "arg L [deg]", "loop at the plant's input", "frequency [rad/s]")


def _mark_crossovers(hover: HoverLoop, axes: Axes) -> None:
    for margins, colour in zip(hover.margins.input if hover.margins else (), _AXIS_COLOURS, strict=False):
        if 0.0 < margins.crossover < math.inf:
            axes.axvline(margins.crossover, color=colour, linestyle=":", linewidth=0.9)


def _draw_sensitivities(hover: HoverLoop, axes: Axes) -> None:
    """Draw the largest singular values of S and T at the plant's input [dB], with a dot at each peak."""
    for (name, values), colour in zip(hover.sensitivities.items(), _AXIS_COLOURS, strict=False):
        peak, gains = int(np.argmax(values)), _decibels(values)
        label = f"{name}, peak {values[peak]:.2f}"
        axes.semilogx(hover.omega, gains, color=colour, linewidth=1.2, label=label)
        axes.semilogx(hover.omega[peak], gains[peak], "o", color=colour)
    _finish_panel(axes, "singular value [dB]", "sensitivities at the plant's input", "frequency [rad/s]")
    _limit_floor(axes, _LEAST_SENSITIVITY_DB)


def _finish_panel(axes: Axes, label: str, title: str, x_label: str) -> None:
    """Write labels and the legend: in a paper above the panel, in place of its title, which the caption has."""
    _style_axes(axes, label, "" if is_paper() else title, x_label)
    if is_paper():
        above: dict[str, Any] = {"bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.1, "handlelength": 1.0}
        axes.legend(frameon=False, fontsize=6.0, loc="lower left", ncols=3, columnspacing=0.8, **above)
    else:
        axes.legend(frameon=False, fontsize=font_size(8), loc="lower left" if "frequency" in x_label else "best")


def _draw_stacked(
    flights: Flights,
    values: Callable[[Records], Array],
    labels: tuple[str, ...],
    title: str,
    *,
    closer: bool = False,
) -> Figure:
    """Draw three axes below each other; of more than `_MOST_TRACES` flights the rms of each second, on a log axis.

    With `closer`, a second column then shows the flights of least rms as they are, on a scale of their own.
    """
    many = len(flights) > _MOST_TRACES
    curves = {law: values(records) for law, records in flights.items()}
    least = sorted(curves, key=lambda law: float(np.mean(curves[law] ** 2)))[:_MOST_TRACES] if many and closer else []
    columns = 1 + bool(least)
    figure = _new_figure((8.0 if columns == 1 else 13.0, 6.4), title)
    rows = panels(figure, 3, columns, sharex=True)
    _draw_column(rows[::columns], flights, curves, labels, is_rms=many)
    if least:
        _draw_column(rows[1::2], {law: flights[law] for law in least}, curves, labels, is_rms=False)
        rows[1].set_title(f"the {len(least)} of least rms, as flown", fontsize=font_size(10), color=_INK)
    if any(flights):
        lines = [Line2D([], [], color=colour, linewidth=2.0) for colour in law_colours(flights).values()]
        figure.legend(lines, list(flights), loc="outside lower center", ncols=legend_columns(), frameon=False)
    return figure


def _draw_column(
    rows: Sequence[Axes], flights: Flights, curves: Mapping[str, Array], labels: tuple[str, ...], *, is_rms: bool
) -> None:
    colours = law_colours(flights)
    # The most agitated curve is drawn first, as it would hide the others.
    for law in sorted(flights, key=lambda law: -float(np.sum(np.abs(np.diff(curves[law], axis=0))))):
        time, values = _time(flights[law]), curves[law]
        if is_rms:
            time, values = _rms_by_second(time, values)
        for axes, column in zip(rows, values.T, strict=True):
            axes.plot(time, column, color=colours[law], linewidth=1.0, label=law)
    for axes, label in zip(rows, labels, strict=True):
        _style_axes(axes, label)
        if is_rms:
            _style_rms(axes, label)
    rows[-1].set_xlabel("time [s]")
    rows[-1].set_xlim(0.0, max(_end_of(records) for records in flights.values()))


def _style_rms(axes: Axes, label: str) -> None:
    """Make the axis of an rms logarithmic, with plain numbers."""
    axes.set_ylabel(f"{label}\nrms of 1 s")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(_PlainLogFormatter(minor_thresholds=(2.0, 0.6)))
    axes.yaxis.set_minor_formatter(_PlainLogFormatter(minor_thresholds=(2.0, 0.6)))


class _PlainLogFormatter(LogFormatter):
    """Numbers as 0.02, not 2e-02, where `LogFormatter` writes any."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def _rms_by_second(time: Array, columns: Array) -> tuple[Array, Array]:
    """Return the middle of each begun second (m,) [s] and the rms (m, k) of `columns` (n, k) in it."""
    second = np.floor(time + 1e-9).astype(int)
    starts = np.flatnonzero(np.diff(second, prepend=second[0] - 1))
    counts = np.diff(np.append(starts, len(time)))[:, np.newaxis]
    rms = np.sqrt(np.add.reduceat(columns * columns, starts, axis=0) / counts)
    return second[starts] + 0.5, np.where(rms > 0.0, rms, np.nan)


def _decibels(gains: Array) -> Array:
    """Return gains in dB; 0 and smaller gains than drawn lie below the axis' end."""
    return np.asarray(20.0 * np.log10(np.clip(gains, 0.1 * _GAINS[0], _GAINS[1])))


def _limit_floor(axes: Axes, least: float) -> None:
    """Cut an axis [dB] below the `least` drawn gain [dB], and where the loop's gain is large whatever it is."""
    low, high = axes.get_ylim()
    axes.set_ylim(max(low, least), min(high, _MOST_DB))


def _new_figure(size: tuple[float, float], title: str) -> Figure:
    return new_figure(size, title, colour=_INK)


def _style_axes(axes: Axes, label: str, title: str = "", x_label: str = "") -> None:
    axes.set_title(title, fontsize=font_size(10), color=_INK)
    axes.set_xlabel(x_label)
    axes.set_ylabel(label)
    axes.grid(visible=True, color=_GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _colour(law: str) -> str:
    return _COLOURS.get(law, _DEFAULT_COLOUR if law else _CURVES[0])


def law_colours(laws: Iterable[str]) -> dict[str, str]:
    """Return the colour of each law in one figure: laws of the user's own get those that no other has."""
    names = list(laws)
    found = {law: _COLOURS[law] for law in names if law in _COLOURS}
    for law in names:
        if law not in found:
            free = (_colour(law), _DEFAULT_COLOUR, *_COLOURS.values())
            found[law] = next((each for each in free if each not in found.values()), _colour(law))
    return {law: found[law] for law in names}


def _time(records: Records) -> Array:
    return np.asarray(records["time_us"] * 1e-6)


def _end_of(records: Records) -> float:
    """Return the end of the last sample's step [s], so that an axis has its last tick."""
    time = _time(records)
    return float(time[-1] + (time[-1] - time[0]) / max(len(time) - 1, 1))
