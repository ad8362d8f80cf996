"""A league as tables for a terminal, and as rows for other programs."""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gustproof.campaign.intervals import CONFIDENCE
from gustproof.league.classes import Charge, PriceClass
from gustproof.league.entrants import REFERENCE
from gustproof.league.salt import PUBLIC_SALT, commit
from gustproof.league.season import League
from gustproof.report.terminal import Renderable

MOST_LOSSES = 8
"""Cells of loss that are named."""
_RIGHT: dict[str, Any] = {"justify": "right", "no_wrap": True}
_COLUMNS = ("rank", "entry", "class", "class_rank", "score", "low", "high", "box", "failed", "Ms", "slew_share")


def render_league(league: League) -> Renderable:
    """Return the ranking, the cells that the first or the flagship loses, and the commitment, within 80 columns."""
    table = Table(title=f"League: error over that of {REFERENCE}", caption=describe_score(league))
    table.add_column("rank", **_RIGHT)
    table.add_column("entry", overflow="fold")
    table.add_column("class", no_wrap=True)
    for name in ("Ms", "slew", "score", f"{100 * CONFIDENCE:g} %", "box"):
        table.add_column(name, **_RIGHT)
    for i in league.order:
        score, charge = league.standings.ratios[i], worst_charge(league.charges[i])
        table.add_row(
            str(league.standings.ranks[i]),
            league.plan.entrants[i].name,
            f"{league.classes[i].name} {league.class_ranks[i]}",
            format_number(charge.Ms),
            format_number(charge.slew_share),
            format_number(score.value),
            f"{format_number(score.low)}..{format_number(score.high)}",
            format_number(league.boxes[i].ratio),
        )
    return Group(table, Text("\n".join([*describe_losses(league), *describe_failures(league), describe_salt(league)])))


def describe_score(league: League) -> str:
    """Return the meaning of the columns in two sentences."""
    return (
        f"score: geometric mean of {len(league.cells)} cells of {league.plan.runs} flights; box: worst off nominal. "
        "Rank: 1 and the number of entries that are better with confidence."
    )


def describe_class(bounds: PriceClass) -> str:
    """Return the bounds of a price class in words."""
    if math.isinf(bounds.Ms):
        return f"{bounds.name}: no bounds"
    return (
        f"{bounds.name}: Ms ≤ {bounds.Ms:g}, gain margin ≥ {bounds.gain_margin:g}, delay margin ≥ "
        f"{1e3 * bounds.delay_margin:g} ms, slew ≤ {bounds.slew_share:g} of the usual"
    )


def worst_charge(charges: Sequence[Charge]) -> Charge:
    """Return the worst of each figure of a price over the vehicles."""
    return Charge(
        Ms=max(each.Ms for each in charges),
        gain_margin=min(each.gain_margin for each in charges),
        delay_margin=min(each.delay_margin for each in charges),
        slew=max(each.slew for each in charges),
        slew_share=max(each.slew_share for each in charges),
        refused="; ".join(each.refused for each in charges if each.refused),
    )


def watched_entrant(league: League) -> int:
    """Return the number of the entrant whose losses are shown: the flagship, or the first in the ranking."""
    names = [each.name for each in league.plan.entrants]
    return names.index("flagship") if "flagship" in names else league.order[0]


def describe_losses(league: League) -> Iterator[str]:
    """Yield where the watched entrant is beaten within its class, and by whom, the worst first."""
    watched, cells = watched_entrant(league), league.standings.cells
    name, lost = league.plan.entrants[watched].name, league.losses(watched)
    own, of, rest = league.classes[watched].name, len(league.cells), "; not in:" if lost else ""
    yield f"{name} has the least error of its class, {own}, in {of - len(lost)} of {of} cells{rest}"
    for k, best in lost[:MOST_LOSSES]:
        cell, rival = league.cells[k], league.plan.entrants[best].name
        yield f"  {cell.scenario.name}, {cell.vehicle}: {cells[watched, k] / cells[best, k]:.3g} times that of {rival}"
    if len(lost) > MOST_LOSSES:
        yield f"  and {len(lost) - MOST_LOSSES} more, see the page"


def describe_failures(league: League) -> Iterator[str]:
    """Yield each entrant's failed flights, the prices that could not be measured, and the cells without a score."""
    for i in league.order:
        name = league.plan.entrants[i].name
        for k, result in enumerate(league.failures[i]):
            if reasons := [reason for reason in result["failures"] if reason]:
                cell = league.cells[k]
                yield (
                    f"{name}: {len(reasons)} of {len(result['failures'])} flights failed in {cell.scenario.name}, "
                    f"{cell.vehicle}: {reasons[0]}"
                )
        for vehicles, charge in zip(league.plan.vehicles, league.charges[i], strict=True):
            if charge.refused:
                yield f"{name}: no price on {vehicles.nominal.name}: {charge.refused}"
    for cell in league.skipped:
        yield f"not scored: {cell.scenario.name} on {cell.vehicle}, which can't hover with that failure"


def describe_salt(league: League, *, reveal: bool = False) -> str:
    """Return what is known of the seeds."""
    salt = league.plan.salt
    if salt == PUBLIC_SALT:
        return "seeds: public ones, which anybody can fly beforehand; for hidden ones give --draw-salt or --salt"
    shown = f"salt '{salt}', " if reveal else "hidden; "
    return f"seeds: {shown}SHA-256 of the salt {commit(salt)}"


def league_rows(league: League) -> Iterator[tuple[str, ...]]:
    """Yield the ranking as rows of text, the first one with the names of the columns."""
    yield _COLUMNS
    for i in league.order:
        score, charge = league.standings.ratios[i], worst_charge(league.charges[i])
        failed = sum(bool(reason) for result in league.failures[i] for reason in result["failures"])
        yield (
            str(league.standings.ranks[i]),
            league.plan.entrants[i].name,
            league.classes[i].name,
            str(league.class_ranks[i]),
            *(f"{each:.6g}" for each in (*score, league.boxes[i].ratio)),
            str(failed),
            f"{charge.Ms:.6g}",
            f"{charge.slew_share:.6g}",
        )


def write_csv(league: League) -> str:
    """Return the ranking as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(league_rows(league))
    return text.getvalue()


def write_latex(league: League) -> str:
    """Return the ranking as a LaTeX table of the package `booktabs`."""
    head, *rows = ([cell.replace("_", r"\_") for cell in row] for row in league_rows(league))
    lines = [rf"\begin{{tabular}}{{rll{'r' * (len(head) - 3)}}}", r"\toprule", " & ".join(head) + r" \\", r"\midrule"]
    lines += [" & ".join(row) + r" \\" for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def format_number(value: float) -> str:
    """Return a number with three digits; a dash if it is unknown."""
    return f"{value:#.3g}".rstrip(".") if math.isfinite(value) else "–"
