"""Results of a campaign as text."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gustproof.flight.scoring.requirements import requirement_label, requirement_limits
from gustproof.show.report.terminal import FIGURES, Renderable
from gustproof.studies.campaign.intervals import CONFIDENCE, FEWEST_RUNS, IntervalEstimate
from gustproof.studies.campaign.plan import Campaign
from gustproof.studies.campaign.rare import ENSEMBLES, RareEstimate
from gustproof.studies.campaign.statistics import CampaignStatistics, LawStatistics, WorstRun

TERMINAL_FIGURES = ("rmse_deg", "peak_deg", "torque_rms_nm", "torque_slew_rms", "saturated_s")
"""Figures that fit on a terminal. The table, the JSON and the page hold all of them."""
_RIGHT: dict[str, Any] = {"justify": "right", "overflow": "fold"}
_FIRST: dict[str, Any] = {"overflow": "fold", "min_width": 16}  # characters of a law's name
_WIDE = {**_RIGHT, "min_width": 18}  # characters of an interval
_NARROW: dict[str, Any] = {"justify": "right", "no_wrap": True}
IMPORTANCE_FIGURE = "rmse_deg"
"""Figure whose dependence on the dispersions is shown."""
SCATTERED_FIGURE = "peak_deg"
"""Figure whose cases are drawn one by one."""


def render_campaign(found: CampaignStatistics) -> Renderable:
    """Return figures with confidence, pass rates, importances, comparisons, and how to fly a run again."""
    caption = (
        f"Below each value: its {100.0 * CONFIDENCE:g} % confidence interval; ≥: so few runs bound it from below only"
    )
    columns = {"law, figure": _FIRST, "median": _WIDE, "95th percentile": _WIDE, "worst": _NARROW, "run": _NARROW}
    parts: list[Renderable] = [_law_table(found, describe_campaign(found.campaign), columns, _figure_rows, caption)]
    if found.campaign.scenario.require:
        title = "Requirements, and the share of runs that met them"
        columns = {"law, requirement": _FIRST, "limit": _RIGHT, "met": _WIDE, "worst": _NARROW, "run": _NARROW}
        parts.append(_law_table(found, title, columns, _requirement_rows))
    certified = [
        law.figures[IMPORTANCE_FIGURE].importance.get(name) for law in found.laws for name in found.campaign.spreads
    ]
    if certified and not any(certified):
        parts.append(Text(f"causes: not estimated, they need {FEWEST_RUNS} runs of each law or more"))
    elif certified:
        caption = (
            "Share of the variance explained by each quantity alone (Sobol' index by binning), rank correlation ρ; "
            "remainder: gusts and noise of each run, and interactions"
        )
        columns = {"law, quantity": _FIRST, "from .. to": {"overflow": "fold"}, "explains": _RIGHT}
        rows = partial(_importance_rows, found.campaign)
        parts.append(_law_table(found, f"Causes of {FIGURES[IMPORTANCE_FIGURE][0]}", columns, rows, caption))
    warned = (f"warning: {line}" for line in found.warnings)
    worst = found.laws[0].figures[IMPORTANCE_FIGURE].worst
    run = worst[0].run if worst else 0
    hint = f"all runs are in {found.table}; fly one again over UDP: gustproof campaign rerun {found.table}:{run}"
    return Group(*parts, Text("\n".join([*format_comparisons(found), *_format_failures(found), *warned, hint])))


def render_rare(found: RareEstimate, campaign: Campaign) -> Renderable:
    """Return the probability of a rare event, the flights that it took, and the worst flight."""
    p, low, high = found.probability
    interval = f"{100.0 * CONFIDENCE:g} %: {low:.2g} .. {high:.2g}"
    lines = [
        describe_campaign(campaign),
        f"{found.event.text} in one flight with probability {p:.3g} ({interval}), sampled, not proved",
        f"{found.flights:,} flights in {len(found.levels)} levels and {ENSEMBLES} independent ensembles",
    ]
    if math.isfinite(found.plain_flights):
        lines.append(f"plain flights for an interval as wide: {found.plain_flights:.2g}")
    if not found.hits:
        lines.append("no flight was above the limit")
    else:
        worst, unit = found.hits[0], FIGURES[found.event.figure][1]
        turned = f"seed {worst.seed}, turned {len(worst.turns)} times"
        lines.append(f"worst flight found: {format_value(worst.value)} {unit} ({turned})")
    return Text("\n".join(lines))


def describe_campaign(campaign: Campaign) -> str:
    """Return scenario, vehicle, laws and dispersions in a line."""
    drawn = ", ".join(_drawn_in_words(campaign.spreads))
    laws = ", ".join(law.name for law in campaign.laws)
    vehicle, how = campaign.vehicles.document["name"], f"{campaign.sampling.value}, seed {campaign.seed}"
    cases = (
        f"{campaign.scenario.name}, vehicle {vehicle}: {campaign.cases:,} case{'s' * (campaign.cases != 1)} with {laws}"
    )
    return f"{cases}; each case draws ({how}): {drawn}"


def _drawn_in_words(spreads: Iterable[str]) -> Iterator[str]:
    """Yield names of what is drawn as words, the three axes of one quantity together."""
    axes = Counter(re.sub(r"\.[xyz]$", "", name) for name in spreads)
    for name, count in axes.items():
        words = re.sub(r"[_.]", " ", re.sub(r"_B$", "", name))
        yield f"{words} ({count} axes)" if count > 1 else words


def format_estimate(estimate: IntervalEstimate) -> tuple[str, str]:
    """Return a figure and its interval; one without an upper end as the bound that it is."""
    if math.isfinite(estimate.low) and estimate.high == math.inf:
        return format_value(estimate.value), f"≥ {format_value(estimate.low)}"
    return format_value(estimate.value), f"{format_value(estimate.low)} .. {format_value(estimate.high)}"


def format_share(estimate: IntervalEstimate) -> tuple[str, str]:
    """Return a share in percent and its interval."""
    value, low, high = map(_format_percent, estimate)
    return f"{value} %", f"{low} .. {high}"


def _format_percent(share: float) -> str:
    """Return a share in percent with two digits of what is left to 0 or 100: only all is 100, only none 0."""
    left = 100.0 * min(share, 1.0 - share)
    if not left > 0.0:
        return f"{100.0 * share:.4g}"
    return f"{100.0 * share:.{max(0, 1 - math.floor(math.log10(left)))}f}"


def format_value(value: float) -> str:
    """Return a figure with three digits, a large one as a whole number; a dash if it is unknown."""
    if not math.isfinite(value):
        return "∞" if value > 0.0 else "–"
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def format_comparisons(found: CampaignStatistics) -> Iterator[str]:
    """Yield a line for each pair of laws and figure: by how much one is lower on average, and in how many cases."""
    for duel in found.duels:
        label, unit = FIGURES[duel.figure]
        mean, low, high = duel.difference
        if math.isfinite(low) and math.isfinite(high):
            value, interval = format_share(duel.lower)
            beside = f"{_beside(duel.other, duel.difference, unit)}, lower in {value} ({interval}) of the cases"
        else:
            beside = f"{'lower' if mean < 0.0 else 'not lower'} than {duel.other} in the one case: that is no average"
        yield f"{label}: {duel.law} is {beside}"


def _beside(other: str, difference: IntervalEstimate, unit: str) -> str:
    """Return a law's average beside that of an `other`, with the interval of their difference."""
    mean, low, high = difference
    if mean == 0.0 == low == high:
        return f"the same as {other} in every case"
    if not low * high > 0.0:
        return f"not told apart from {other} on average ({format_value(low)} .. {format_value(high)} {unit})"
    least, most = sorted(map(abs, (low, high)))
    by = f"{format_value(abs(mean))} {unit} ({format_value(least)} .. {format_value(most)})"
    return f"{'lower' if mean < 0.0 else 'higher'} than {other} by {by} on average"


def _law_table(
    found: CampaignStatistics,
    title: str,
    columns: Mapping[str, dict[str, Any]],
    rows: Callable[[LawStatistics], Iterable[tuple[str, ...]]],
    caption: str | None = None,
) -> Table:
    """Return a table whose first column holds each law and, below it, its rows; it fits 80 columns."""
    table = Table(title=title, caption=caption)
    for name, style in columns.items():
        table.add_column(name, **style)
    for law in found.laws:
        table.add_row(Text(law.law, style="bold"))
        for row in rows(law):
            table.add_row(*row)
        table.add_section()
    return table


def _figure_rows(law: LawStatistics) -> Iterator[tuple[str, ...]]:
    for name in TERMINAL_FIGURES:
        (label, unit), figure = FIGURES[name], law.figures[name]
        quantiles = (format_estimate(figure.quantiles[each]) for each in ("median", "p95"))
        yield f"{label} [{unit}]", *map(_two_lines, quantiles), *_worst_cells(figure.worst)


def _requirement_rows(law: LawStatistics) -> Iterator[tuple[str, ...]]:
    for each in law.passed:
        texts = requirement_label(each.requirement), requirement_limits(each.requirement)
        yield *texts, _one_cell(format_share(each.rate)), *_worst_cells(each.worst)
    yield "all requirements", "", _one_cell(format_share(law.all_held))


def _importance_rows(campaign: Campaign, law: LawStatistics) -> Iterator[tuple[str, ...]]:
    for name, spread in campaign.spreads.items():
        explained = format_importance(law.figures[IMPORTANCE_FIGURE].importance.get(name))
        yield name, f"{spread.low:g} .. {spread.high:g}", explained


def _worst_cells(worst: Sequence[WorstRun]) -> tuple[str, str]:
    return (format_value(worst[0].value), str(worst[0].run)) if worst else ("", "")


def _one_cell(estimate: tuple[str, str]) -> str:
    """Return a figure and its interval, without spaces in the interval, so that it stays on one line."""
    value, interval = estimate
    return f"{value} {interval.replace(' .. ', '..')}"


def _two_lines(estimate: tuple[str, str]) -> str:
    """Return a figure above its interval: side by side they would break now and then on 80 columns."""
    value, interval = estimate
    return f"{value}\n{interval.replace(' .. ', '..')}"


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
