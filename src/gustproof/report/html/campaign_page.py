"""One HTML file on a campaign, which needs neither a network nor a script."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape
from itertools import starmap
from pathlib import Path

import numpy as np

from gustproof.campaign.intervals import CONFIDENCE, Importance, IntervalEstimate
from gustproof.campaign.reader import open_table, read_campaign_metadata, read_column
from gustproof.campaign.statistics import (
    COMPARED_FIGURES,
    CampaignStatistics,
    LawComparison,
    LawStatistics,
    compute_statistics,
)
from gustproof.campaign.worker import FIGURES as FLOWN
from gustproof.campaign.worker import delta_column
from gustproof.recording.folder import write_atomic
from gustproof.report.campaign import (
    IMPORTANCE_FIGURE,
    describe_campaign,
    format_estimate,
    format_importance,
    format_share,
    format_value,
)
from gustproof.report.html.campaign_charts import draw_distributions, draw_exceedances, draw_responses
from gustproof.report.html.markup import fill_page, read_asset, render_chip, render_table
from gustproof.report.terminal import FIGURES
from gustproof.scoring.requirements import requirement_label, requirement_limits
from gustproof.version import __version__

_COLUMNS = ("mean", "median", "95th percentile", "99th percentile")


def write_campaign_report(path: Path, output: Path) -> None:
    """Write the page on the campaign in `path`; the same campaign gives the same bytes."""
    write_atomic(output, render_campaign_page(path))


def render_campaign_page(path: Path) -> str:
    """Return the page as HTML.

    Raises
    ------
    ConfigError
        If the file is no campaign's table.
    """
    found = compute_statistics(path)
    flown = read_campaign_metadata(path)["versions"]["gustproof"]
    about = (found.campaign.scenario.description, describe_campaign(found.campaign))
    warned = (f"<p class='bad'>{escape(line)}</p>" for line in found.warnings)
    parts = {
        "title": escape(f"{found.campaign.scenario.name}: {', '.join(law.law for law in found.laws)}"),
        "policy": "style-src 'unsafe-inline'; img-src data:",
        "styles": read_asset("page.css") + read_asset("campaign.css"),
        "about": "".join(f"<p>{escape(line)}</p>" for line in about) + "".join(warned),
        "figures": _render_figures(found),
        "requirements": _render_requirements(found),
        "legend": f'<p class="legend">{"".join(f"<span>{_render_law(found, law)}</span>" for law in found.laws)}</p>',
        "distributions": _render_distributions(found),
        "dispersions": _render_dispersions(found),
        "worst": _render_worst(found),
        "footer": f"Flown by gustproof {escape(flown)}, drawn by gustproof {__version__}.",
    }
    return fill_page("campaign.html", parts)


def _render_figures(found: CampaignStatistics) -> str:
    rows = []
    for name in FLOWN:
        label = _figure_label(name)
        for first, law in enumerate(found.laws):
            figure = law.figures[name]
            estimates = [format_estimate(each) for each in (figure.mean, *figure.quantiles.values())]
            worst = format_value(figure.worst[0].value) if figure.worst else "–"
            cells = starmap(_format_interval, estimates)
            rows.append(["" if first else escape(label), _render_law(found, law), *cells, worst])
    note = (
        f"<p class='note'>Disc: median. Ring: 95th percentile. Bars: {100.0 * CONFIDENCE:g} % confidence intervals. "
        "Methods: Student's t for means, order statistics for quantiles, Clopper and Pearson for shares.</p>"
    )
    forests = "".join(_render_forest(found, name) for name in (*COMPARED_FIGURES, "saturated_s"))
    table = render_table(["", "law", *_COLUMNS, "worst"], rows)
    details = f"<details><summary>All figures with their intervals</summary>{table}</details>"
    return f"{note}<div class='forests'>{forests}</div>{details}{_render_matrices(found)}"


def _render_forest(found: CampaignStatistics, name: str) -> str:
    """Return median and 95th percentile of a figure with their intervals, law by law; nothing if none is known."""
    quantiles = [law.figures[name].quantiles for law in found.laws]
    estimates = [(law, own["median"], own["p95"]) for law, own in zip(found.laws, quantiles, strict=True)]
    known = [x for _, median, p95 in estimates for x in (*median, *p95) if math.isfinite(x)]
    if not known or max(known) == min(known):
        return ""
    low, high = min(0.0, min(known)), 1.04 * max(known)
    best = min((median.value for _, median, _ in estimates if math.isfinite(median.value)), default=math.nan)
    rows = []
    for law, median, p95 in estimates:
        marks = "".join(_render_interval(each, low, high, kind) for each, kind in ((median, "disc"), (p95, "ring")))
        told = f"median {' '.join(format_estimate(median))}, 95th percentile {' '.join(format_estimate(p95))}"
        colour = found.laws.index(law) % 7
        track = f'<span class="track" style="--chip: var(--c{colour})" role="img" aria-label="{told}">{marks}</span>'
        value = f"<b>{format_value(median.value)}</b>" if median.value == best else format_value(median.value)
        rows.append(f"<li>{_render_law(found, law)}{track}<span>{value}</span></li>")
    ends = f"<li class='ends'><span></span><span>{format_value(low)}</span><span>{format_value(high)}</span></li>"
    return f'<div class="forest"><h4>{escape(_figure_label(name))}</h4><ul>{"".join(rows)}{ends}</ul></div>'


def _render_interval(estimate: IntervalEstimate, low: float, high: float, kind: str) -> str:
    if not math.isfinite(estimate.value):
        return ""
    value, begin, end = (100.0 * (x - low) / (high - low) for x in map(_finite(low, high), estimate))
    bar = f'<i class="bar" style="left: {begin:.2f}%; width: {end - begin:.2f}%"></i>'
    return f'{bar}<i class="{kind}" style="left: {value:.2f}%"></i>'


def _finite(low: float, high: float) -> Callable[[float], float]:
    """Return a function that brings an unknown end of an interval to the end of its axis."""
    return lambda x: min(max(x, low), high) if not math.isnan(x) else low


def _render_matrices(found: CampaignStatistics) -> str:
    """Return a matrix of laws for each compared figure: shares above the diagonal, mean differences below."""
    if len(found.laws) < 2:
        return ""
    duels = {(duel.figure, duel.law, duel.other): duel for duel in found.duels}
    tables = []
    for name in COMPARED_FIGURES:
        rows = []
        for law in found.laws:
            cells = [_render_duel(duels, (name, law.law, other.law)) for other in found.laws]
            rows.append([_render_law(found, law), *cells])
        table = render_table(["", *(_render_law(found, law) for law in found.laws)], rows)
        tables.append(f"<div class='matrix'><h4>{escape(_figure_label(name))}</h4>{table}</div>")
    note = (
        "<p class='note'>Law of the row against law of the column in the same cases. Shares: cases in which the row is "
        "below the column. Signed numbers: mean of row less column, in the figure's unit. Muted: intervals.</p>"
    )
    return f"<h3>Law against law</h3>{note}{''.join(tables)}"


def _render_duel(duels: Mapping[tuple[str, str, str], LawComparison], key: tuple[str, str, str]) -> str:
    if duel := duels.get(key):
        shade, depth = "--c2" if duel.lower.value > 0.5 else "--c1", 110.0 * abs(duel.lower.value - 0.5)
        if not math.isfinite(depth):
            return "–"
        text = _format_interval(*format_share(duel.lower))
        effect = f"effect size {format_value(duel.effect)}"
        return f'<span class="heat" title="{effect}" style="--shade: var({shade}); --depth: {depth:.0f}%">{text}</span>'
    if duel := duels.get((key[0], key[2], key[1])):
        value, low, high = (f"{x:+.3g}".replace("-", "−") for x in (-x for x in duel.difference))
        return _format_interval(value, f"{high} .. {low}") if math.isfinite(duel.difference.value) else "–"
    return ""


def _render_requirements(found: CampaignStatistics) -> str:
    rows = []
    for law in found.laws:
        for each in law.passed:
            last = f"{format_value(each.worst[0].value)} in run {each.worst[0].run}" if each.worst else "–"
            texts = (requirement_label(each.requirement), requirement_limits(each.requirement))
            rate = _format_interval(*format_share(each.rate))
            rows.append([_render_law(found, law), *texts, rate, escape(last)])
        rate = _format_interval(*format_share(law.all_held))
        rows.append([_render_law(found, law), "all requirements, and flown to the end", "", rate, ""])
    return render_table(["law", "requirement", "limit", "runs that met it", "worst"], rows)


def _render_distributions(found: CampaignStatistics) -> str:
    file, charts, alike = open_table(found.table), list[str](), list[str]()
    for name in FLOWN:
        values, label = read_column(file, name, found.campaign), _figure_label(name)
        least, largest = np.nanmin(values, initial=math.inf), np.nanmax(values, initial=-math.inf)
        if least < largest:
            charts += [draw_distributions(label, list(values)), draw_exceedances(label, list(values))]
        elif least == largest:
            alike.append(f"<p>{escape(label)}: {format_value(float(least))} in every run.</p>")
    return _render_group("Distributions, and shares of the runs above a value", charts) + "".join(alike)


def _render_dispersions(found: CampaignStatistics) -> str:
    if not found.campaign.spreads:
        return "<p>Only gusts and noise varied.</p>"
    file, charts = open_table(found.table), []
    values, label = list(read_column(file, IMPORTANCE_FIGURE, found.campaign)), _figure_label(IMPORTANCE_FIGURE)
    for name, spread in found.campaign.spreads.items():
        delta = read_column(file, delta_column(name), found.campaign)[0]
        charts.append(draw_responses(label, name, values, delta, spread.value))
    note = (
        "<p class='note'>Share of a figure's variance explained by each quantity alone (first-order Sobol' index by "
        "binning), and rank correlation ρ (Spearman). 'No effect found' means an index within the noise of its "
        "estimate. Remainder: gusts and noise of each run, and interactions. Units are those of the vehicle file.</p>"
    )
    return note + _render_importance(found) + _render_group(f"mean {label} against each", charts)


def _render_importance(found: CampaignStatistics) -> str:
    tables = []
    for figure in COMPARED_FIGURES:
        rows = []
        for name, spread in found.campaign.spreads.items():
            cells = [_render_bar(law.figures[figure].importance.get(name)) for law in found.laws]
            drawn = f'<span class="interval">{spread.low:g} .. {spread.high:g}</span>'
            rows.append([escape(name), drawn, *cells])
        table = render_table(["quantity", "from .. to", *(_render_law(found, law) for law in found.laws)], rows)
        tables.append(f"<h4>{escape(_figure_label(figure))}</h4>{table}")
    return "".join(tables)


def _render_bar(importance: Importance | None) -> str:
    text = format_importance(importance)
    if importance is None or importance.first_order <= importance.noise:
        return f'<span class="interval">{text}</span>'
    return f'<span class="share" style="width: {60.0 * importance.first_order:.1f}px"></span>{text}'


def _render_worst(found: CampaignStatistics) -> str:
    rows, table = [], escape(str(found.table))
    for law in found.laws:
        for what, value, run in _notable_runs(law):
            command = f"<code>gustproof fly --run {table}:{run}</code>"
            rows.append([_render_law(found, law), escape(what), value, command])
    runs = render_table(["law", "", "", "command that repeats it over UDP, with the same bits"], rows)
    return f"<details><summary>{len(rows)} runs, each with its command: one click selects it</summary>{runs}</details>"


def _notable_runs(law: LawStatistics) -> Iterator[tuple[str, str, int]]:
    """Yield the remark, the value and the number of each notable run of a law."""
    for failure in law.failures:
        yield f"no figures: {failure.reason}", "", failure.run
    for name in COMPARED_FIGURES:
        for each in law.figures[name].worst:
            yield _figure_label(name), format_value(each.value), each.run
    for passed in law.passed:
        label = requirement_label(passed.requirement)
        for each in passed.worst[:1] if passed.rate.value < 1.0 else ():
            yield f"requirement: {label} {requirement_limits(passed.requirement)}", format_value(each.value), each.run


def _render_group(title: str, charts: Sequence[str]) -> str:
    cells = "".join(f'<div class="chart">{each}</div>' for each in charts if each)
    return cells and f'<article class="group"><h3>{escape(title)}</h3><div class="charts of4">{cells}</div></article>'


def _render_law(found: CampaignStatistics, law: LawStatistics) -> str:
    return render_chip(found.laws.index(law), law.law)


def _figure_label(name: str) -> str:
    label, unit = FIGURES[name]
    return f"{label} [{unit}]"


def _format_interval(value: str, interval: str) -> str:
    return f'{value} <span class="interval">{interval}</span>'
