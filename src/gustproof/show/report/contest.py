"""Real autopilots and laws side by side: as a table, in Markdown for a review, and as JUnit for a build server."""

import math
from collections.abc import Iterable, Sequence

from rich.table import Table
from rich.text import Text

from gustproof.show.report.junit import JunitTest, render_suites
from gustproof.show.report.terminal import Renderable, format_number
from gustproof.studies.campaign.comparison import ComparisonRow
from gustproof.studies.campaign.paired import ERROR, SMALL, Change

HEADINGS = (
    "RMSE, means removed [deg]",
    "against the first",
    "RMSE [deg]",
    "RMSE as it sees it [deg]",
    "torque slew [N m/s]",
    "flights",
    "speed [x real time]",
)


def render_comparison(title: str, rows: Iterable[ComparisonRow]) -> Renderable:
    """Return the table, a row for each controller."""
    table = Table(title=title, caption=explain())
    table.add_column("", no_wrap=True)
    for heading in HEADINGS:
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(Text(row.name), *_cells(row))
    return table


def explain() -> str:
    """Return how differences are to be read."""
    ends = f"intervals hold with {100.0 * (1.0 - ERROR):g} % at any number of flights"
    return f"Paired flights, geometric mean; {ends}; alike is within {100.0 * SMALL:g} %."


def render_markdown(title: str, rows: Iterable[ComparisonRow]) -> str:
    """Return the table in Markdown."""
    lines = [f"### {title}", "", f"| | {' | '.join(HEADINGS)} |", f"|---|{'---|' * len(HEADINGS)}"]
    lines += [f"| {row.name.replace('|', chr(92) + '|')} | {' | '.join(_cells(row))} |" for row in rows]
    return "\n".join([*lines, "", explain(), ""])


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
    value, low, high = (100.0 * (end - 1.0) for end in row.ratio)
    ends = f" ({low:+.1f} to {high:+.1f})" if math.isfinite(high) else ""
    return f"{value:+.1f} %{ends}, {row.change.value}"


def _cells(row: ComparisonRow) -> list[str]:
    figures = row.rmse_deg, row.own_rmse_deg, row.torque_slew_rms
    told = ["" if figure is None else format_number(figure) for figure in figures]
    speed = "" if row.realtime_factor is None else format_number(row.realtime_factor)
    return [format_number(row.steady_rmse_deg), describe_change(row), *told, str(row.flights), speed]
