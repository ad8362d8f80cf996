"""What came of a campaign, as text."""

import math
from collections.abc import Iterator, Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gustproof.campaign.confidence import LEVEL, Estimate
from gustproof.campaign.findings import Findings
from gustproof.campaign.plan import Campaign
from gustproof.report.document import FIGURES, Document
from gustproof.requirements import requirement_label, requirement_limits

SHOWN = ("rmse_deg", "peak_deg", "torque_rms_nm", "torque_slew_rms", "saturated_s")
"""Figures that a terminal has room for; the others stand in the table, in the JSON and on the page."""
EXPLAINED = "rmse_deg"
"""Figure whose dispersions are told there."""


def campaign_document(found: Findings) -> Document:
    """Return figures with confidence, pass rates, what matters, who is better, and how to fly a run again."""
    parts: list[Document] = [_figures(found)]
    if found.campaign.scenario.require:
        parts.append(_passed(found))
    if found.campaign.spreads:
        parts.append(_importance(found))
    lines = [*duel_lines(found), *_failures(found), _last_line(found)]
    return Group(*parts, Text("\n".join(lines)))


def headline(campaign: Campaign) -> str:
    """Return what was flown, in a line."""
    drawn = ", ".join(campaign.spreads)
    laws = ", ".join(law.name for law in campaign.laws)
    vehicle, how = campaign.vehicles.document["name"], f"{campaign.sampling.value}, seed {campaign.seed}"
    return f"{campaign.scenario.name}, vehicle {vehicle}: {campaign.cases:,} cases with {laws}; drawn {how}: {drawn}"


def estimate_text(estimate: Estimate) -> tuple[str, str]:
    """Return a figure, and its interval."""
    return number(estimate.value), f"{number(estimate.low)} .. {number(estimate.high)}"


def share_text(estimate: Estimate) -> tuple[str, str]:
    """Return a share in percent, and its interval."""
    value, low, high = (f"{100.0 * each:.4g}" for each in estimate)
    return f"{value} %", f"{low} .. {high}"


def number(value: float) -> str:
    """Return four digits of a figure; a dash if the runs do not say it."""
    return f"{value:.4g}" if math.isfinite(value) else "∞" if value > 0.0 else "–"


def duel_lines(found: Findings) -> Iterator[str]:
    """Yield which of two laws is better how often."""
    for duel in found.duels:
        label, (value, interval) = FIGURES[duel.figure][0], share_text(duel.lower)
        yield f"{label}: {duel.law} is below {duel.other} in {value} ({interval}) of the cases"


def _figures(found: Findings) -> Table:
    level = f"{100.0 * LEVEL:g} %"
    table = Table("law", "", title=headline(found.campaign), caption=f"Behind each figure: where it is, {level} sure.")
    for column in ("median", "", "95 % below", "", "worst", "run"):
        table.add_column(column, justify="right", no_wrap=True)
    for law in found.laws:
        for first, name in enumerate(SHOWN):
            label, unit = FIGURES[name]
            figure = law.figures[name]
            worst = figure.worst[0] if figure.worst else None
            quantiles = (*estimate_text(figure.quantiles["median"]), *estimate_text(figure.quantiles["p95"]))
            last = ("", "") if worst is None else (number(worst.value), str(worst.run))
            table.add_row("" if first else law.law, f"{label} [{unit}]", *quantiles, *last)
    return table


def _passed(found: Findings) -> Table:
    table = Table("law", "required", title="What had to hold, and in how many runs it did")
    for column in ("limit", "held", "", "worst", "run"):
        table.add_column(column, justify="right")
    for law in found.laws:
        for first, each in enumerate(law.passed):
            last = (number(each.worst[0].value), str(each.worst[0].run)) if each.worst else ("", "")
            table.add_row(
                "" if first else law.law, requirement_label(each.requirement), requirement_limits(each.requirement),
                *share_text(each.rate), *last,
            )  # fmt: skip
        table.add_row("" if law.passed else law.law, "all of them", "", *share_text(law.all_held), "", "")
    return table


def _importance(found: Findings) -> Table:
    label = FIGURES[EXPLAINED][0]
    table = Table(
        "drawn", "from .. to", title=f"What {label} depends on",
        caption="Share of its variance that each explains by itself (Sobol' index by binning), rank correlation;\n"
        "the rest: gusts and noise, drawn anew for each case, and what acts together.",
    )  # fmt: skip
    for law in found.laws:
        table.add_column(law.law, justify="right")
    for name, spread in found.campaign.spreads.items():
        cells = [importance_text(law.figures[EXPLAINED].importance.get(name)) for law in found.laws]
        table.add_row(name, f"{spread.low:g} .. {spread.high:g}", *cells)
    return table


def importance_text(importance: Sequence[float] | None) -> str:
    """Return what a dispersion does to a figure; what chance alone may do is called not seen."""
    if importance is None:
        return "too few runs"
    correlation, first_order, noise = importance
    seen = f"{100.0 * first_order:.0f} %" if first_order > noise else "not seen"
    return f"{seen}, {correlation:+.2f}"


def _failures(found: Findings) -> Iterator[str]:
    for law in found.laws:
        if law.failed:
            shown = "; ".join(f"run {failure.run}: {failure.reason}" for failure in law.failures)
            yield f"{law.law}: {law.failed} run{'s' if law.failed > 1 else ''} left no figures: {shown}"


def _last_line(found: Findings) -> str:
    worst = found.laws[0].figures[EXPLAINED].worst
    run = worst[0].run if worst else 0
    return f"all runs are in {found.table}; any of them again, over UDP: gustproof fly --run {found.table}:{run}"
