"""Real autopilots and laws side by side: as a table, in Markdown for a review, and as JUnit for a build server."""

import math
from collections.abc import Iterable, Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gustproof.show.report.junit import JunitTest, render_suites
from gustproof.show.report.terminal import Renderable, format_number
from gustproof.studies.campaign.comparison import ComparisonRow, PhaseRow
from gustproof.studies.campaign.intervals import IntervalEstimate
from gustproof.studies.campaign.paired import ERROR, SMALL, Change

HEADINGS = (
    "RMSE, means removed [deg]",
    "against the first",
    "RMSE [deg]",
    "RMSE as it sees it [deg]",
    "as it sees it, against the first",
    "predicted [deg]",
    "torque slew [N m/s]",
    "predicted [N m/s]",
    "Ms",
    "delay margin [ms]",
    "seeds",
    "failed",
    "speed [x real time]",
)
PHASE_HEADINGS = (
    "phase",
    "RMSE, medians removed [deg]",
    "largest error [deg]",
    "torque slew [N m/s]",
    "saturated [s]",
)

_TWICE = 2.0  # [-] a ratio from which per cent have too many digits


def render_comparison(title: str, rows: Sequence[ComparisonRow]) -> Renderable:
    """Return the table, a row for each controller, and one by phases; of a course, one by scenarios in its place."""
    tables = [_render_table(HEADINGS, [[row.name, *_cells(row)] for row in rows], title, explain())]
    if rows[0].by_scenario:
        tables.append(_render_table(*_by_scenario(rows)))
    elif rows[0].phases:
        tables.append(_render_table(PHASE_HEADINGS, _by_phase(rows), "By phase", explain_phases()))
    return Group(*tables)


def _render_table(
    headings: Sequence[str], lines: Sequence[Sequence[str]], title: str | None = None, caption: str | None = None
) -> Table:
    """Return a table without the columns that are empty."""
    table = Table(title=title, caption=caption)
    kept = [k for k in range(1 + len(headings)) if any(line[k] for line in lines)]
    for k in kept:
        table.add_column(headings[k - 1] if k else "", justify="right" if k else "left", no_wrap=k == 0)
    for line in lines:
        table.add_row(*(Text(line[k]) for k in kept))
    return table


def _by_scenario(rows: Sequence[ComparisonRow]) -> tuple[list[str], list[list[str]]]:
    """Return headings and lines of the table of scenarios: the first's error, then the others' over it."""
    names = [f"{rows[0].name} [deg]", *(f"{row.name} [x]" for row in rows[1:])]
    return names, [[name, *(format_number(row.by_scenario[name]) for row in rows)] for name in rows[0].by_scenario]


def explain() -> str:
    """Return how differences are to be read."""
    ends = f"intervals hold with {100.0 * (1.0 - ERROR):g} % at any number of flights"
    return f"Paired flights, geometric mean; {ends}; alike is within {100.0 * SMALL:g} %."


def explain_phases() -> str:
    """Return how figures by phase are to be read."""
    return "Phases describe: each interval holds for itself, and the verdict is that of the whole flight."


def _by_phase(rows: Sequence[ComparisonRow]) -> list[list[str]]:
    """Return the lines of the table of phases: in each, each controller, with its changes from the first."""
    several, count = bool(rows[0].by_scenario), len(rows[0].phases)
    return [[row.name, *_phase_cells(row.phases[k], several, row is rows[0])] for k in range(count) for row in rows]


def _phase_cells(phase: PhaseRow, several: bool, is_first: bool) -> list[str]:
    where = f"{phase.scenario}: {phase.name}" if several else phase.name
    figures = (
        (phase.rmse_deg, phase.rmse_ratio),
        (phase.peak_deg, phase.peak_ratio),
        (phase.torque_slew_rms, phase.slew_ratio),
    )
    told = [
        ", ".join([_cell(figure), *([] if ratio is None else [_describe_ratio(ratio)])]) for figure, ratio in figures
    ]
    more = phase.saturated_more_s
    time = [_cell(phase.saturated_s), *([_describe_more(more)] if more is not None and more.value else [])]
    return [f"{where}, {phase.duration_s:.4g} s" if is_first else "", *told, ", ".join(time)]


def _cell(figure: float | None) -> str:
    return "" if figure is None else format_number(figure)


def _describe_more(more: IntervalEstimate) -> str:
    """Return a difference of times [s] with its interval."""
    ends = f" ({more.low:+.2g} to {more.high:+.2g})" if math.isfinite(more.high) else ""
    return f"{more.value:+.2g}{ends}"


def render_markdown(title: str, rows: Sequence[ComparisonRow]) -> str:
    """Return the tables in Markdown."""
    lines = [f"### {title}", "", *_mark_table(HEADINGS, [[row.name, *_cells(row)] for row in rows]), "", explain(), ""]
    if rows[0].by_scenario:
        lines += [*_mark_table(*_by_scenario(rows)), ""]
    if rows[0].phases:
        lines += ["#### By phase", "", *_mark_table(PHASE_HEADINGS, _by_phase(rows)), "", explain_phases(), ""]
    return "\n".join(lines)


def _mark_table(headings: Sequence[str], lines: Iterable[Iterable[str]]) -> list[str]:
    cells = [["", *headings], ["---"] * (1 + len(headings)), *lines]
    return [f"| {' | '.join(each.replace('|', chr(92) + '|') for each in line)} |" for line in cells]


def render_junit(title: str, rows: Sequence[ComparisonRow]) -> str:
    """Return a test for each controller but the first, which fails if it is worse, as JUnit's XML."""
    first, *others = rows
    named = ((f"{row.name} against {first.name}", row) for row in others)
    tests = [JunitTest(name, describe_change(row), row.change is Change.WORSE, title) for name, row in named]
    return render_suites({title: tests})


def describe_change(row: ComparisonRow) -> str:
    """Return the difference of a controller from the first in words; empty for the first."""
    if row.ratio is None or row.change is None:
        return ""
    return f"{_describe_ratio(row.ratio)}, {row.change.value}"


def _describe_ratio(ratio: IntervalEstimate) -> str:
    """Return a ratio of errors with its interval: as a change in per cent, or in times from twice on."""
    if ratio.value >= _TWICE:
        ends = f" ({ratio.low:.3g} to {ratio.high:.3g})" if math.isfinite(ratio.high) else ""
        return f"{ratio.value:.3g} times{ends}"
    value, low, high = (100.0 * (end - 1.0) for end in ratio)
    ends = f" ({low:+.1f} to {high:+.1f})" if math.isfinite(high) else ""
    return f"{value:+.1f} %{ends}"


def _cells(row: ComparisonRow) -> list[str]:
    margin = None if row.delay_margin_s is None else 1e3 * row.delay_margin_s
    own, slew = row.predicted_own_rmse_deg, row.predicted_slew
    told = [*map(_cell, (row.rmse_deg, row.own_rmse_deg, own, row.torque_slew_rms, slew, row.Ms, margin))]
    told.insert(2, "" if row.own_ratio is None else _describe_ratio(row.own_ratio))
    speed = _cell(row.realtime_factor)
    failed = str(row.failed or "")
    return [format_number(row.steady_rmse_deg), describe_change(row), *told, str(row.seeds), failed, speed]
