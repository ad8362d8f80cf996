"""Tables of the page: flights, figures, requirements, margins."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import Any

from firmware_model.types import AXES
from gustproof.design.derive import margins_to_dict
from gustproof.flight.controllers.user_controller import UserController
from gustproof.flight.scoring.requirements import (
    RequirementResult,
    requirement_label,
    requirement_limits,
    requirement_window,
)
from gustproof.law.form import Law
from gustproof.show.report.html.loops import ReportLaw
from gustproof.show.report.html.markup import render_chip, render_table, render_tile_line, render_tiles
from gustproof.show.report.html.runs import ReportRun
from gustproof.show.report.laws import MARGINS, format_margin, format_poles
from gustproof.show.report.terminal import FIGURES, figure_rows, format_number
from gustproof.studies.rate.analyse import pole_pairs

_OWN_VIEW = {
    "control_rmse_deg": "RMSE against its set-point, as the autopilot sees it",
    "true_control_rmse_deg": "RMSE against its set-point, in truth",
    "true_control_steady_deg": "the same with each axis' mean removed",
    "estimate_rmse_deg": "RMSE of the autopilot's own attitude",
    "estimate_steady_deg": "the same, with each axis' mean removed",
}
_OWN_WIND = {
    "rmse_mps": "RMSE of the autopilot's own wind",
    "mean_error_mps": "the same, of its mean",
    "air_rms_mps": "RMS of the air's gusts about their mean",
}
_PACE = {
    "missed": "missed deadlines",
    "held": "repeated set-points",
    "stalled": "stalls of the set-points",
    "late_samples": "samples late at the law",
    "missed_samples": "samples missed by the law",
}


_TILES = (("RMSE", "rmse_deg"), ("Peak", "peak_deg"), ("Torque slew rms", "torque_slew_rms"))


def render_headline(runs: Sequence[ReportRun]) -> str:
    """Return the headline figures: a tile each, a line for each flight, with its ratio to the first.

    Only flights of one scenario, vehicle and seed are compared, and only those to the end can be best.
    """
    own = [(run.scenario, run.vehicle, run.seed) for run in runs]
    is_fair = all(each == own[0] for each in own)
    tiles = [_figure_tile(runs, heading, name, is_fair=is_fair) for heading, name in _TILES]
    if any(run.requirements for run in runs):
        tiles.append(("Requirements", [_requirements_line(i, run) for i, run in enumerate(runs)]))
    return render_tiles(tiles)


def _figure_tile(runs: Sequence[ReportRun], heading: str, name: str, *, is_fair: bool) -> tuple[str, list[str]]:
    values = [getattr(run.metrics, name, math.nan) for run in runs]
    whole = {v for v, run in zip(values, runs, strict=True) if run.has_expected_outcome and math.isfinite(v)}
    best = min(whole) if is_fair and len(whole) > 1 else math.nan
    lines = []
    for i, (run, value) in enumerate(zip(runs, values, strict=True)):
        ratio = f"{value / values[0]:.2g} ×" if i and is_fair and values[0] > 0.0 else ""
        lines.append(render_tile_line(i, run.label, _format_value(value), ratio, is_best=value == best))
    return f"{heading} <small>{escape(FIGURES[name][1] + _beside(runs, is_fair=is_fair))}</small>", lines


def _beside(runs: Sequence[ReportRun], *, is_fair: bool) -> str:
    """Return what the small numbers of a tile are, if there are any."""
    return f"; beside: times {runs[0].label}" if len(runs) > 1 and is_fair else ""


def _requirements_line(i: int, run: ReportRun) -> str:
    held, judged = (sum(getattr(each, name) for each in run.requirements) for name in ("is_met", "judged"))
    total = len(run.requirements)
    mark = "bad" if held < judged else "good" if 0 < held == total else "interval"
    text = f"{held} of {total} held" if total else "none"
    if judged < total:  # cut off
        text = f"{held} of {judged} held, {total - judged} not judged" if judged else "not judged"
    return f'<li>{render_chip(i, run.label)}<strong class="{mark}">{text}</strong></li>'


def render_flights(runs: Sequence[ReportRun]) -> str:
    """Return laws, flights and figures, one column for each flight; rows without content are left out."""
    head = ["", *(render_chip(i, run.label) for i, run in enumerate(runs))]
    shown = [*_facts(runs), *_figures(runs)]
    return render_table(head, [[escape(name), *map(escape, cells)] for name, cells in shown if any(cells)])


def _facts(runs: Sequence[ReportRun]) -> list[tuple[str, list[str]]]:
    return [
        ("law", [_describe_law(run.law) for run in runs]),
        ("made by", [run.law.provenance.design if run.law else "" for run in runs]),
        ("controller", list(_sources(runs))),
        ("autopilot", [_describe_autopilot(run.autopilot) for run in runs]),
        ("scenario", [run.scenario.name for run in runs]),
        ("vehicle", [run.vehicle.name for run in runs]),
        ("seed", [str(run.seed) for run in runs]),
        ("outcome", [run.outcome.name.lower() for run in runs]),
        ("flown", [f"{len(run.records) * run.scenario.dt:g} s of {run.scenario.duration_s:g} s" for run in runs]),
        ("warning", ["; ".join(run.warnings) for run in runs]),
    ]


def _sources(runs: Sequence[ReportRun]) -> Iterator[str]:
    for run in runs:
        yield run.controller.source if isinstance(run.controller, UserController) else ""


def _describe_law(law: Law | None) -> str:
    return "" if law is None else f"{law.name}, {law.order} states"


def _describe_autopilot(facts: Mapping[str, Any] | None) -> str:
    if facts is None:
        return ""
    flown, law = facts.get("flown", {}), facts.get("law")
    said = f"{flown.get('program', facts['autopilot'])} {flown.get('version', '')}".strip()
    return f"{said}, law '{law}' inside" if law else said


def _own_views(runs: Sequence[ReportRun]) -> Iterator[tuple[str, Sequence[str]]]:
    for name, label in _OWN_VIEW.items():
        values = [getattr(run.estimator_view, name, math.nan) for run in runs]
        yield f"{label} [deg]", ["" if math.isnan(value) else format_number(value) for value in values]
    winds = [run.estimator_view.wind if run.estimator_view else None for run in runs]
    for name, label in _OWN_WIND.items():
        yield f"{label} [m/s]", ["" if wind is None else format_number(getattr(wind, name)) for wind in winds]


def _figures(runs: Sequence[ReportRun]) -> Iterator[tuple[str, Sequence[str]]]:
    measured = {str(i): run.metrics for i, run in enumerate(runs) if run.metrics}
    for label, cells, unit in figure_rows(measured):
        by_run = dict(zip(measured, cells, strict=True))
        yield f"{label} [{unit}]" if unit else label, [by_run.get(str(i), "") for i in range(len(runs))]
    yield from _own_views(runs)
    for name, label in _PACE.items():
        yield label, [str((run.timing or {}).get(name, "")) for run in runs]


def render_requirements(runs: Sequence[ReportRun]) -> str:
    """Return the requirements, a row each, with value and margin of each flight; empty without requirements."""
    found: dict[tuple[str, str, str], dict[int, str]] = {}
    for i, run in enumerate(runs):
        for result in run.requirements:
            required = result.requirement
            key = requirement_label(required), requirement_window(required), requirement_limits(required)
            found.setdefault(key, {})[i] = _render_result(result)
    head = ["requirement", "from .. to [s]", "limit", *(render_chip(i, run.label) for i, run in enumerate(runs))]
    rows = [[*map(escape, key), *(cells.get(i, "") for i in range(len(runs)))] for key, cells in found.items()]
    return f"<h3>Requirements: flown, and margin</h3>{render_table(head, rows)}" if rows else ""


def _render_result(result: RequirementResult) -> str:
    mark = "good" if result.is_met else "bad" if result.judged else "interval"
    held = f"{'held' if result.is_met else 'not held'}, {_format_value(result.margin)}"
    return f'{_format_value(result.value)} <span class="{mark}">{held if result.judged else "not judged"}</span>'


def _format_value(value: float) -> str:
    """Return a value with three digits; a large one as a whole number."""
    if not math.isfinite(value):
        return "not flown" if math.isnan(value) else "∞"
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def render_margins(laws: Iterable[ReportLaw]) -> str:
    """Return the margins at the plant's input, one row for each axis, and the poles of each law."""
    heads = ["law", "axis", *(name.replace("\n", " ") for name in MARGINS.values()), "disk [-]"]
    rows, poles = [], []
    for law in laws:
        written = format_poles(pole_pairs(law.hover.law_poles))
        poles.append(f"<p>Poles of {escape(law.label)} [rad/s]: {escape(written)}</p>")
        if law.hover.margins is None:
            reason = "no torque loop or an unstable one: no margins"
            rows.append([escape(law.label), reason, *[""] * (len(heads) - 2)])
            continue
        figures = margins_to_dict(law.hover.margins)["input"]
        for axis in AXES:
            cells = [format_margin(figures[axis][name]) for name in MARGINS]
            first = axis == "roll"
            disk = format_margin(figures["disk_margin"]) if first else ""
            rows.append([escape(law.label) if first else "", axis, *cells, disk])
    return render_table([escape(head) for head in heads], rows) + "".join(poles)
