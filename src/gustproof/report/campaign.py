"""Results of a campaign as text."""

import math
from collections.abc import Iterator, Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gustproof.campaign.intervals import CONFIDENCE, IntervalEstimate
from gustproof.campaign.plan import Campaign
from gustproof.campaign.statistics import CampaignStatistics
from gustproof.report.terminal import FIGURES, Renderable
from gustproof.scoring.requirements import requirement_label, requirement_limits

TERMINAL_FIGURES = ("rmse_deg", "peak_deg", "torque_rms_nm", "torque_slew_rms", "saturated_s")
"""Figures that fit on a terminal. The table, the JSON and the page hold all of them."""
_NAME, _INTERVAL = 16, 18
"""Least width of a law's name and of an interval [characters]."""
IMPORTANCE_FIGURE = "rmse_deg"
"""Figure whose dependence on the dispersions is shown."""


def render_campaign(found: CampaignStatistics) -> Renderable:
    """Return figures with confidence, pass rates, importances, comparisons, and how to fly a run again."""
    parts: list[Renderable] = [_figures_table(found)]
    if found.campaign.scenario.require:
        parts.append(_requirements_table(found))
    if found.campaign.spreads:
        parts.append(_importance_table(found))
    warned = (f"warning: {line}" for line in found.warnings)
    lines = [*format_comparisons(found), *_format_failures(found), *warned, _rerun_hint(found)]
    return Group(*parts, Text("\n".join(lines)))


def describe_campaign(campaign: Campaign) -> str:
    """Return scenario, vehicle, laws and dispersions in a line."""
    drawn = ", ".join(campaign.spreads)
    laws = ", ".join(law.name for law in campaign.laws)
    vehicle, how = campaign.vehicles.document["name"], f"{campaign.sampling.value}, seed {campaign.seed}"
    return f"{campaign.scenario.name}, vehicle {vehicle}: {campaign.cases:,} cases with {laws}; drawn {how}: {drawn}"


def format_estimate(estimate: IntervalEstimate) -> tuple[str, str]:
    """Return a figure and its interval."""
    return format_value(estimate.value), f"{format_value(estimate.low)} .. {format_value(estimate.high)}"


def format_share(estimate: IntervalEstimate) -> tuple[str, str]:
    """Return a share in percent and its interval."""
    value, low, high = (f"{100.0 * each:.4g}" for each in estimate)
    return f"{value} %", f"{low} .. {high}"


def format_value(value: float) -> str:
    """Return a figure with four digits; a dash if it is unknown."""
    return f"{value:.4g}" if math.isfinite(value) else "∞" if value > 0.0 else "–"


def format_comparisons(found: CampaignStatistics) -> Iterator[str]:
    """Yield a line for each pair of laws and figure: the share of cases in which one law is lower."""
    for duel in found.duels:
        label, (value, interval) = FIGURES[duel.figure][0], format_share(duel.lower)
        yield f"{label}: {duel.law} is below {duel.other} in {value} ({interval}) of the cases"


def _figures_table(found: CampaignStatistics) -> Table:
    level = f"{100.0 * CONFIDENCE:g} %"
    caption = f"Right of each value: its {level} confidence interval"
    table = _table(f"{describe_campaign(found.campaign)}", "law, figure", caption)
    for column in ("median", "95th percentile"):
        table.add_column(column, justify="right", overflow="fold", min_width=_INTERVAL)
    for column in ("worst", "run"):
        table.add_column(column, justify="right", no_wrap=True)
    for law in found.laws:
        table.add_row(Text(law.law, style="bold"))
        for name in TERMINAL_FIGURES:
            label, unit = FIGURES[name]
            figure = law.figures[name]
            worst = figure.worst[0] if figure.worst else None
            quantiles = (format_estimate(figure.quantiles[each]) for each in ("median", "p95"))
            last = ("", "") if worst is None else (format_value(worst.value), str(worst.run))
            table.add_row(f"{label} [{unit}]", *map(_one_cell, quantiles), *last)
        table.add_section()
    return table


def _requirements_table(found: CampaignStatistics) -> Table:
    table = _table("Requirements, and the share of runs that met them", "law, requirement", None)
    table.add_column("limit", justify="right", overflow="fold")
    table.add_column("met", justify="right", overflow="fold", min_width=_INTERVAL)
    for column in ("worst", "run"):
        table.add_column(column, justify="right", no_wrap=True)
    for law in found.laws:
        table.add_row(Text(law.law, style="bold"))
        for each in law.passed:
            last = (format_value(each.worst[0].value), str(each.worst[0].run)) if each.worst else ("", "")
            table.add_row(
                requirement_label(each.requirement),
                requirement_limits(each.requirement),
                _one_cell(format_share(each.rate)),
                *last,
            )
        table.add_row("all requirements", "", _one_cell(format_share(law.all_held)))
        table.add_section()
    return table


def _table(title: str, first: str, caption: str | None) -> Table:
    """Return a table whose first column holds each law and, below it, its rows; it fits 80 columns."""
    table = Table(title=title, caption=caption)
    table.add_column(first, overflow="fold", min_width=_NAME)
    return table


def _one_cell(estimate: tuple[str, str]) -> str:
    """Return a figure and its interval, without spaces in the interval, so that it stays on one line."""
    value, interval = estimate
    return f"{value} {interval.replace(' .. ', '..')}"


def _importance_table(found: CampaignStatistics) -> Table:
    caption = (
        "Share of the variance explained by each quantity alone (Sobol' index by binning), rank correlation ρ; "
        "remainder: gusts and noise of each run, and interactions"
    )
    label = FIGURES[IMPORTANCE_FIGURE][0]
    table = _table(f"Causes of {label}", "law, quantity", caption)
    table.add_column("from .. to", overflow="fold")
    table.add_column("explains", justify="right", overflow="fold")
    for law in found.laws:
        table.add_row(Text(law.law, style="bold"))
        for name, spread in found.campaign.spreads.items():
            explained = format_importance(law.figures[IMPORTANCE_FIGURE].importance.get(name))
            table.add_row(name, f"{spread.low:g} .. {spread.high:g}", explained)
        table.add_section()
    return table


def format_importance(importance: Sequence[float] | None) -> str:
    """Return the importance of a dispersion; an index within the noise of the estimate counts as no effect."""
    if importance is None:
        return "too few runs"
    correlation, first_order, noise = importance
    effect = f"{100.0 * first_order:.0f} %" if first_order > noise else "no effect found"
    return f"{effect} (ρ = {correlation:+.2f})"


def _format_failures(found: CampaignStatistics) -> Iterator[str]:
    for law in found.laws:
        if law.failed:
            reasons = "; ".join(f"run {failure.run}: {failure.reason}" for failure in law.failures)
            yield f"{law.law}: {law.failed} run{'s' if law.failed > 1 else ''} without figures: {reasons}"


def _rerun_hint(found: CampaignStatistics) -> str:
    worst = found.laws[0].figures[IMPORTANCE_FIGURE].worst
    run = worst[0].run if worst else 0
    return f"all runs are in {found.table}; fly one again over UDP: gustproof fly --run {found.table}:{run}"
