"""A league as a table for a terminal, and its lines of text."""

import math
from collections.abc import Iterator
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gustproof.show.report.terminal import Renderable
from gustproof.studies.campaign.intervals import CONFIDENCE, IntervalEstimate
from gustproof.studies.league.entries import REFERENCE
from gustproof.studies.league.study import League

_RIGHT: dict[str, Any] = {"justify": "right", "no_wrap": True}


def render_league(league: League) -> Renderable:
    """Return the ranking and what failed, within 80 columns."""
    mean = f"geometric mean of {len(league.cells)} cells of {league.plan.runs} flights"
    caption = f"score: {mean}; Ms, slew: on the worst vehicle"
    table = Table(title=f"League: error over that of {REFERENCE}", caption=caption)
    table.add_column("rank", **_RIGHT)
    table.add_column("entry", overflow="fold")
    table.add_column("class", no_wrap=True)
    for name in ("Ms", "slew", "score", f"{100 * CONFIDENCE:g} %"):
        table.add_column(name, **_RIGHT)
    for i in league.order:
        (rank, within), score, points = league.ranks[i], league.standings.ratios[i], league.points[i]
        worst = (max(each.Ms for each in points), max(each.slew_share for each in points), score.value)
        interval = f"{format_number(score.low)}..{format_number(score.high)}"
        about = (str(rank), league.plan.entries[i].name, f"{league.classes[i]} {within}")
        table.add_row(*about, *map(format_number, worst), interval)
    return Group(table, Text("\n".join(describe_failures(league))))


def describe_failures(league: League) -> Iterator[str]:
    """Yield each entry's failed flights, operating points that could not be measured, and cells without a score."""
    for i in league.order:
        name = league.plan.entries[i].name
        for cell, reasons in zip(league.cells, league.failures[i], strict=True):
            if reasons:
                yield f"{name}: {len(reasons)} of {league.plan.runs} flights failed in {cell}: {reasons[0]}"
        for vehicles, point in zip(league.plan.vehicles, league.points[i], strict=True):
            if point.refused:
                yield f"{name}: no operating point on {vehicles.nominal.name}: {point.refused}"
    for cell in league.skipped:
        yield f"not scored: {cell}, which can't hover with that failure"


def format_number(value: float) -> str:
    """Return a number with three digits; a dash if it is unknown."""
    return f"{value:#.3g}".rstrip(".") if math.isfinite(value) else "–"


def format_interval(estimate: IntervalEstimate) -> str:
    """Return an estimate and its interval."""
    return f"{format_number(estimate.value)} ({format_number(estimate.low)} .. {format_number(estimate.high)})"
