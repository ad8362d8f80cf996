"""One HTML file on a campaign, which needs neither a network nor a script."""

import math
from collections.abc import Iterator, Sequence
from html import escape
from itertools import starmap
from pathlib import Path

import numpy as np

from gustproof.campaign.intervals import CONFIDENCE, Importance
from gustproof.campaign.reader import open_table, read_campaign_metadata, read_column
from gustproof.campaign.statistics import COMPARED_FIGURES, CampaignStatistics, LawStatistics, compute_statistics
from gustproof.campaign.worker import FIGURES as FLOWN
from gustproof.campaign.worker import delta_column
from gustproof.recording.folder import write_atomic
from gustproof.report.campaign import (
    IMPORTANCE_FIGURE,
    describe_campaign,
    format_comparisons,
    format_estimate,
    format_importance,
    format_share,
    format_value,
)
from gustproof.report.html.campaign_charts import draw_distributions, draw_exceedances, draw_responses
from gustproof.report.html.markup import fill_page, read_asset, render_table
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
    duels = "".join(f"<p>{escape(line)}</p>" for line in format_comparisons(found))
    note = (
        f"<p class='note'>Right of each value: its {100.0 * CONFIDENCE:g} % confidence interval. Methods: Student's t "
        "for means, order statistics for quantiles, Clopper and Pearson for shares.</p>"
    )
    return note + render_table(["", "law", *_COLUMNS, "worst"], rows) + duels


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
    columns = [(figure, law) for figure in COMPARED_FIGURES for law in found.laws]
    heads = [f"{_render_law(found, law)} {escape(_figure_label(figure))}" for figure, law in columns]
    rows = []
    for name, spread in found.campaign.spreads.items():
        cells = [_render_bar(law.figures[figure].importance.get(name)) for figure, law in columns]
        drawn = f'<span class="interval">{spread.low:g} .. {spread.high:g}</span>'
        rows.append([escape(name), drawn, *cells])
    return render_table(["quantity", "from .. to", *heads], rows)


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
    return render_table(["law", "", "", "command that repeats it over UDP, with the same bits"], rows)


def _notable_runs(law: LawStatistics) -> Iterator[tuple[str, str, int]]:
    """Yield the remark, the value and the number of each notable run of a law."""
    for failure in law.failures:
        yield f"no figures: {failure.reason}", "", failure.run
    for name in COMPARED_FIGURES:
        for each in law.figures[name].worst:
            yield _figure_label(name), format_value(each.value), each.run
    for passed in law.passed:
        label = requirement_label(passed.requirement)
        for each in passed.worst[:1]:
            yield f"requirement: {label} {requirement_limits(passed.requirement)}", format_value(each.value), each.run


def _render_group(title: str, charts: Sequence[str]) -> str:
    cells = "".join(f'<div class="chart">{each}</div>' for each in charts if each)
    return cells and f'<article class="group"><h3>{escape(title)}</h3><div class="charts of4">{cells}</div></article>'


def _render_law(found: CampaignStatistics, law: LawStatistics) -> str:
    colour = found.laws.index(law) % 7
    return f'<i class="chip" style="--chip: var(--c{colour})"></i>{escape(law.law)}'


def _figure_label(name: str) -> str:
    label, unit = FIGURES[name]
    return f"{label} [{unit}]"


def _format_interval(value: str, interval: str) -> str:
    return f'{value} <span class="interval">{interval}</span>'
