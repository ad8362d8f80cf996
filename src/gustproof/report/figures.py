"""Time histories, loops and trade-offs as PNG. A law keeps its colour in every figure."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gustproof.analysis.analyse import Analysis
from gustproof.analysis.hover_loop import HoverLoop
from gustproof.analysis.placement import ErrorLimits, Places
from gustproof.model.lpv import PARAMETERS, scheduling_parameters
from gustproof.performance.tradeoff import TradeOff
from gustproof.report.diagrams import save_figure
from gustproof.scoring.metrics import Metrics, attitude
from gustproof.synthesis.tune import Tuning
from gustproof.types import Array, Records

Flights = Mapping[str, Records]

# Okabe and Ito's palette: colour-blind readers can tell it apart, also on grey paper.
_COLOURS = {
    "pid-default": "#999999",
    "hinf-d1": "#0072b2",
    "hinf-d1-noise": "#56b4e9",
    "hinf-d2": "#009e73",
    "pid-fair": "#d55e00",
    "hinf-scheduled": "#000000",
    "hinf-rates": "#cc79a7",
    "indi": "#8c510a",
    "flagship": "#882255",
    "flagship-robust": "#aa4499",
    "aided": "#117733",
}
_DEFAULT_COLOUR = "#e69f00"
_SHADES = ("#c9b8e8", "#7b5cc4", "#3d1f8f")  # of limits: darker for more slew
_INK, _GRID = "#333333", "#dddddd"
_AXES = ("roll", "pitch", "yaw")
_AXIS_COLOURS = ("#0072b2", "#d55e00", "#009e73")
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
        tuple(f"{axis} torque [N m]" for axis in _AXES),
        lambda records: records["torque_command_B"],
    ),
}
"""Title, axes and values (n, 3) of each kind of time history."""


def save_moments(records: Records, path: Path) -> None:
    """Draw the disturbance moments of one flight."""
    labels = tuple(f"{axis} moment [N m]" for axis in _AXES)
    _draw_stacked({"": records}, lambda r: r["moment_B"], labels, "Disturbance moments", path)


def save_histories(kind: str, flights: Flights, title: str, path: Path) -> None:
    """Draw one of `HISTORIES` of several laws in the same air."""
    heading, labels, values = HISTORIES[kind]
    _draw_stacked(flights, values, labels, f"{heading}: {title}", path)


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
        axes.set_xlim(0.0, time[-1])
        _style_axes(axes, f"{parameter.label} = {parameter.meaning}")
    grid[0, 1].axis("off")
    lines = [Line2D([], [], color=_colour(law)), Line2D([], [], color="#d55e00", linestyle="--")]
    grid[0, 1].legend(lines, [law, "bounds of Table II"], loc="center", frameon=False)
    for axes in grid[3]:
        axes.set_xlabel("time [s]")
    save_figure(figure, path)


def save_singular_values(frequency: Array, curves: Mapping[str, Array], level: float, title: str, path: Path) -> None:
    """Draw singular values (n, k) over `frequency` (n,) [rad/s] by name, and their bound. Zeros are left out."""
    figure = _new_figure((7.5, 4.8), title)
    axes = figure.subplots()
    colours = ("#0072b2", "#009e73", "#cc79a7", _DEFAULT_COLOUR)
    for (name, values), colour in zip(curves.items(), colours, strict=False):
        real = values[:, np.max(values, axis=0) > _ROUNDING * np.max(values)]
        lines = axes.loglog(frequency, _clip_gains(real), color=colour, linewidth=1.3)
        lines[0].set_label(name)
    _limit_floor(axes)
    axes.axhline(level, color="#d55e00", linestyle="--", label=f"γ = {level:.4g}")
    _style_axes(axes, "singular values [-]")
    axes.grid(visible=True, which="minor", color=_GRID, linewidth=0.3)
    axes.set_xlabel("frequency [rad/s]")
    axes.set_xlim(frequency[0], frequency[-1])
    axes.legend(frameon=False, fontsize=9)
    save_figure(figure, path)


def save_trade_off(limits: ErrorLimits, placed: Places, flown: Mapping[str, Metrics], path: Path) -> None:
    """Draw error against sensitivity peak: the limits, and each law as predicted (ring) and as `flown` (disc).

    The left panel shows all laws, the right panel those near the limit.
    """
    places = {name: place for name, place in placed.items() if place is not None}
    figure = _new_figure((11.0, 5.6), f"Least attitude error against robustness: {limits.scenario}")
    whole, near = figure.subplots(1, 2)
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
    near.text(0.98, 0.95, known, transform=near.transAxes, ha="right", fontsize=9, color=_INK)
    handles, labels = whole.get_legend_handles_labels()
    handles.append(Line2D([], [], color=_INK, marker="o", fillstyle="none", linewidth=0.0))
    labels.append("ring: predicted average over many flights; disc: flown")
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    save_figure(figure, path)


def save_tuning(tuning: Tuning, curves: tuple[Sequence[TradeOff], Sequence[TradeOff]], path: Path) -> None:
    """Draw the error of a tuned law beside the least of linear laws, over the slew and over the sensitivity peak."""
    figure = _new_figure((11.0, 4.6), f"{tuning.law.name}: {tuning.scenario}")
    over_slew, over_peak = figure.subplots(1, 2, sharey=True)
    for axes, points, value, own, label, title in (
        (over_slew, curves[0], "slew", tuning.slew, "torque slew [N m/s]", f"at Ms {tuning.Ms:.2f}"),
        (over_peak, curves[1], "sensitivity_peak", tuning.Ms, "Ms, the worst axis [-]", f"at {tuning.slew:.3g} N m/s"),
    ):
        xs, ys = [getattr(point, value) for point in points], [math.degrees(point.rmse) for point in points]
        axes.plot(xs, ys, color=_SHADES[1], marker=".", label="least of linear gyro-only laws")
        axes.plot(own, math.degrees(tuning.rmse), "o", color=_colour(str(tuning.kind)), label=tuning.law.name)
        _style_axes(axes, "RMSE, three axes [deg]", title, label)
    over_slew.legend(frameon=False, fontsize=9)
    save_figure(figure, path)


def save_analysis(analysis: Analysis, path: Path) -> None:
    """Draw Bode plot, sensitivities, and the flights through a moment step and through the scenario."""
    figure = _new_figure((11.0, 8.0), f"{analysis.law.name}: {analysis.scenario.name}")
    ((gain, S), (phase, step), (torque, air)) = figure.subplots(3, 2)
    if len(analysis.hover.loop):
        _draw_loop(analysis.hover, gain, phase, S)
    else:
        for axes in (gain, phase, S):
            axes.text(0.5, 0.5, "no torque loop: it commands rates", transform=axes.transAxes, ha="center", color=_INK)
    height = ", ".join(f"{value:g}" for value in analysis.step_moment)
    stepped, flown = analysis.step_records, analysis.records
    for axes, records, values, label, title in (
        (step, stepped, np.degrees(attitude(stepped)), "angles [deg]", f"moment step, {height} N m"),
        (air, flown, np.degrees(attitude(flown)), "angles [deg]", "flown"),
        (torque, flown, flown["torque_command_B"], "torque command [N m]", "flown"),
    ):
        for column, axis, colour in zip(values.T, _AXES, _AXIS_COLOURS, strict=True):
            axes.plot(_time(records), column, color=colour, linewidth=1.0, label=axis)
        _style_axes(axes, label, title, "time [s]")
    for axes, label, title in (
        (gain, "|L| [-]", "loop at the plant's input"),
        (phase, "arg L [deg]", "loop at the plant's input"),
        (S, "singular value [-]", "sensitivity at the plant's input"),
    ):
        _style_axes(axes, label, title, "frequency [rad/s]")
    for axes in (gain, S, step):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(frameon=False, fontsize=8)
    save_figure(figure, path)


def _draw_loop(hover: HoverLoop, gain: Axes, phase: Axes, S: Axes) -> None:
    """Draw gain and phase of the loop at the plant's input axis by axis, and the sensitivities."""
    for axis, values, colour in zip(_AXES, hover.loop.T, _AXIS_COLOURS, strict=True):
        gain.loglog(hover.omega, _clip_gains(np.abs(values)), color=colour, linewidth=1.2, label=axis)
        angles = np.degrees(np.unwrap(np.angle(values)))
        phase.semilogx(hover.omega, angles - 360.0 * np.ceil(angles[0] / 360.0), color=colour, linewidth=1.2)
    gain.axhline(1.0, color=_INK, linestyle="--", linewidth=0.8)
    for (name, values), colour in zip(hover.sensitivities.items(), _AXIS_COLOURS, strict=False):
        S.loglog(hover.omega, _clip_gains(values), color=colour, linewidth=1.2, label=f"largest of {name}")
    for axes in (gain, S):
        _limit_floor(axes)


def _draw_stacked(
    flights: Flights, values: Callable[[Records], Array], labels: tuple[str, ...], title: str, path: Path
) -> None:
    figure = _new_figure((8.0, 6.4), title)
    rows = figure.subplots(3, 1, sharex=True)
    curves = {law: values(records) for law, records in flights.items()}
    # The most agitated curve is drawn first, as it would hide the others.
    for law in sorted(flights, key=lambda law: -float(np.sum(np.abs(np.diff(curves[law], axis=0))))):
        time, columns = _time(flights[law]), curves[law]
        for i, axes in enumerate(rows):
            axes.plot(time, columns[:, i], color=_colour(law), linewidth=1.0, label=law)
    for axes, label in zip(rows, labels, strict=True):
        _style_axes(axes, label)
    rows[-1].set_xlabel("time [s]")
    rows[-1].set_xlim(0.0, max(_time(records)[-1] for records in flights.values()))
    if any(flights):
        lines = [Line2D([], [], color=_colour(law), linewidth=2.0) for law in flights]
        figure.legend(lines, list(flights), loc="outside lower center", ncols=6, frameon=False)
    save_figure(figure, path)


def _clip_gains(gains: Array) -> Array:
    """Return gains for a logarithmic axis: 0 and smaller gains than drawn lie below its end."""
    least, most = _GAINS
    return np.clip(gains, 0.1 * least, most)


def _limit_floor(axes: Axes) -> None:
    """Cut a logarithmic axis below the least drawn gain."""
    axes.set_ylim(bottom=max(axes.get_ylim()[0], _GAINS[0]))


def _new_figure(size: tuple[float, float], title: str) -> Figure:
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(title, fontsize=12, color=_INK)
    return figure


def _style_axes(axes: Axes, label: str, title: str = "", x_label: str = "") -> None:
    axes.set_title(title, fontsize=10, color=_INK)
    axes.set_xlabel(x_label)
    axes.set_ylabel(label)
    axes.grid(visible=True, color=_GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _colour(law: str) -> Any:
    return _COLOURS.get(law, _DEFAULT_COLOUR if law else "#0072b2")


def _time(records: Records) -> Array:
    return np.asarray(records["time_us"] * 1e-6)
