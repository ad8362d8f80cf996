"""One HTML file on a campaign, which needs neither a network nor a script."""

import math
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from itertools import combinations, starmap
from pathlib import Path

import numpy as np

from firmware_model.config.files import write_text
from gustproof.flight.scoring.requirements import requirement_label, requirement_limits
from gustproof.show.report.campaign import (
    IMPORTANCE_FIGURE,
    SCATTERED_FIGURE,
    describe_campaign,
    format_estimate,
    format_importance,
    format_share,
    format_value,
)
from gustproof.show.report.html.campaign_charts import (
    draw_distributions,
    draw_exceedances,
    draw_responses,
    draw_scatter,
)
from gustproof.show.report.html.forest import ForestRow, render_forest
from gustproof.show.report.html.markup import (
    chip_style,
    escape_code,
    fill_page,
    read_asset,
    render_chip,
    render_table,
    render_tile_line,
    render_tiles,
    shorten,
)
from gustproof.show.report.terminal import FIGURES
from gustproof.studies.campaign.intervals import CONFIDENCE, FEWEST_RUNS, Importance
from gustproof.studies.campaign.reader import open_table, read_campaign_metadata, read_column
from gustproof.studies.campaign.statistics import (
    COMPARED_FIGURES,
    CampaignStatistics,
    LawComparison,
    LawStatistics,
    compute_statistics,
)
from gustproof.studies.campaign.worker import FIGURES as FLOWN
from gustproof.studies.campaign.worker import delta_column
from gustproof.types import Array
from gustproof.version import __version__

_TILES = (
    ("RMSE, median", "rmse_deg", "median"),
    ("Peak, 95th percentile", "peak_deg", "p95"),
    ("Torque slew, median", "torque_slew_rms", "median"),
)
"""Heading, figure and quantile of each tile."""
_COLUMNS = ("mean", "median", "95th percentile", "99th percentile")


def write_campaign_report(path: Path, output: Path) -> None:
    """Write the page on the campaign in `path`; the same campaign gives the same bytes."""
    write_text(output, render_campaign_page(path))


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
        "title": escape(f"{found.campaign.scenario.name}: {shorten(law.law for law in found.laws)}"),
        "policy": "style-src 'unsafe-inline'; img-src data:",
        "styles": read_asset("page.css") + read_asset("campaign.css"),
        "about": "".join(f"<p>{escape_code(line)}</p>" for line in about) + "".join(warned),
        "tiles": _render_headline(found),
        "figures": _render_figures(found),
        "requirements": _render_requirements(found),
        "legend": f'<p class="legend">{"".join(f"<span>{_render_law(found, law)}</span>" for law in found.laws)}</p>',
        "distributions": _render_distributions(found),
        "dispersions": _render_dispersions(found),
        "worst": _render_worst(found),
        "footer": f"Flown by gustproof {escape(flown)}, drawn by gustproof {__version__}.",
    }
    return fill_page("campaign.html", parts)


def _render_headline(found: CampaignStatistics) -> str:
    """Return median error, high peak, slew and pass rate of each law, with ratios to the first."""
    tiles = []
    for heading, name, quantile in _TILES:
        values = [law.figures[name].quantiles[quantile].value for law in found.laws]
        least, first = min(filter(math.isfinite, values), default=math.nan), values[0]
        lines = [
            render_tile_line(
                i,
                law.law,
                format_value(value),
                f"{value / first:.2g} ×" if i and first > 0.0 and math.isfinite(value) else "",
                is_best=value == least and len(values) > 1,
            )
            for i, (law, value) in enumerate(zip(found.laws, values, strict=True))
        ]
        beside = f"; beside: times {found.laws[0].law}" if len(values) > 1 else ""
        tiles.append((f"{heading} <small>{escape(FIGURES[name][1] + beside)}</small>", lines))
    held = [format_share(law.all_held) for law in found.laws]
    lines = [render_tile_line(i, law.law, *share) for i, (law, share) in enumerate(zip(found.laws, held, strict=True))]
    tiles.append(("All requirements met", lines))
    return render_tiles(tiles)


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
    return f"{note}<div class='forests'>{forests}</div>{details}{_render_matrix(found)}"


def _render_forest(found: CampaignStatistics, name: str) -> str:
    """Return median and 95th percentile of a figure with their intervals, law by law; nothing if none is known."""
    rows, medians = [], [law.figures[name].quantiles["median"] for law in found.laws]
    best = min((median.value for median in medians if math.isfinite(median.value)), default=math.nan)
    for i, (law, median) in enumerate(zip(found.laws, medians, strict=True)):
        p95 = law.figures[name].quantiles["p95"]
        spoken = f"median {' '.join(format_estimate(median))}, 95th percentile {' '.join(format_estimate(p95))}"
        marks = (median, "disc"), (p95, "ring")
        rows.append(ForestRow(i, law.law, marks, format_value(median.value), spoken, median.value == best))
    return render_forest(_figure_label(name), rows)


def _render_matrix(found: CampaignStatistics) -> str:
    """Return one table of the paired differences: a row for each pair of laws, a column for each compared figure."""
    if len(found.laws) < 2:
        return ""
    duels = {(duel.figure, duel.law, duel.other): duel for duel in found.duels}
    rows = []
    for one, other in combinations(found.laws, 2):
        pair = [f"{_render_law(found, one)} less {_render_law(found, other)}"]
        cells = (_render_duel(duels.get((name, one.law, other.law))) for name in COMPARED_FIGURES)
        rows.append([*pair, *cells])
    note = (
        "<p class='note'>Mean of the first law less the second in the same cases, with its interval; below it the "
        "share of the cases in which the first is lower. Green: the first is lower more often.</p>"
    )
    table = render_table(["", *(escape(_figure_label(name)) for name in COMPARED_FIGURES)], rows)
    return f"<h3>Law against law</h3>{note}<div class='matrix'>{table}</div>"


def _render_duel(duel: LawComparison | None) -> str:
    if duel is None or not math.isfinite(duel.difference.value):
        return "–"
    shade, depth = "--c2" if duel.lower.value > 0.5 else "--c1", 110.0 * abs(duel.lower.value - 0.5)
    value, low, high = (f"{x:+.3g}".replace("-", "−") for x in duel.difference)
    known = f"{low} .. {high}" if math.isfinite(duel.difference.low) else "one case"
    text = _format_interval(value, known) + f"<br>{_format_interval(*format_share(duel.lower))}"
    effect = f"effect size {format_value(duel.effect)}"
    return f'<span class="heat" title="{effect}" style="--shade: var({shade}); --depth: {depth:.0f}%">{text}</span>'


def _render_requirements(found: CampaignStatistics) -> str:
    """Return the share of runs that met each requirement, and the worst run, a column for each law."""
    rows: dict[tuple[str, str], list[str]] = {}
    for law in found.laws:
        for each in law.passed:
            key = requirement_label(each.requirement), requirement_limits(each.requirement)
            worst = f"worst {format_value(each.worst[0].value)} in run {each.worst[0].run}" if each.worst else ""
            rows.setdefault(key, []).append(f"{_format_interval(*format_share(each.rate))} {escape(worst)}")
    whole = ["all, and flown to the end", "", *(_format_interval(*format_share(law.all_held)) for law in found.laws)]
    lines = [[*map(escape, key), *cells] for key, cells in rows.items()]
    return render_table(["requirement", "limit", *(_render_law(found, law) for law in found.laws)], [*lines, whole])


def _render_distributions(found: CampaignStatistics) -> str:
    file, charts, alike = open_table(found.table), dict[str, list[str]](), list[str]()
    for name in FLOWN:
        values, label = read_column(file, name, found.campaign), _figure_label(name)
        least, largest = np.nanmin(values, initial=math.inf), np.nanmax(values, initial=-math.inf)
        if least < largest:
            charts[name] = [draw_distributions(label, list(values)), draw_exceedances(label, list(values))]
        elif least == largest:
            alike.append(f"<p>{escape(label)}: {format_value(float(least))} in every run.</p>")
    shown = [name in COMPARED_FIGURES for name in charts]
    return _render_folded("Distributions, and shares of the runs above a value", charts.values(), shown) + "".join(
        alike
    )


def _render_folded(title: str, charts: Iterable[Sequence[str]], shown: Iterable[bool]) -> str:
    """Return a group of charts, and below it those that are not shown at once."""
    parts: dict[bool, list[str]] = {True: [], False: []}
    for drawn, is_shown in zip(charts, shown, strict=True):
        parts[is_shown].extend(filter(None, drawn))
    more = _render_group("", parts[False])
    details = more and f"<details><summary>{len(parts[False])} more charts</summary>{more}</details>"
    return _render_group(title, parts[True]) + details


def _render_dispersions(found: CampaignStatistics) -> str:
    if not found.campaign.spreads:
        return "<p>Only gusts and noise varied.</p>"
    file, charts, strength = open_table(found.table), [], []
    values, label = list(read_column(file, IMPORTANCE_FIGURE, found.campaign)), _figure_label(IMPORTANCE_FIGURE)
    peaks = list(read_column(file, SCATTERED_FIGURE, found.campaign))
    for name, spread in found.campaign.spreads.items():
        delta = read_column(file, delta_column(name), found.campaign)[0]
        # One figure beside all cases, however few: a cause shows itself before its share can be estimated.
        peak = draw_scatter(_figure_label(SCATTERED_FIGURE), name, peaks, delta, spread.value)
        charts.append([peak, draw_responses(label, name, values, delta, spread.value)])
        strength.append(max((_strength(each, delta) for each in peaks), default=0.0))
    note = (
        "<p class='note'>Share of a figure's variance explained by each quantity alone (first-order Sobol' index by "
        "binning), and rank correlation ρ (Spearman). Remainder: gusts and "
        "noise of each run, and interactions. Units are those of the vehicle file.</p>"
    )
    shown = [each >= sorted(strength)[-min(2, len(strength))] for each in strength]
    title = f"{_figure_label(SCATTERED_FIGURE)} of each case, and mean {label}, against what was drawn"
    return _render_folded(title, charts, shown) + note + _render_importance(found)


def _strength(values: Array, delta: Array) -> float:
    """Return the size of the rank correlation of a figure (n,) with a quantity's draws (n,); 0 if there is none."""
    known = np.isfinite(values)
    ranks = [np.argsort(np.argsort(each[known])).astype(float) for each in (values, delta)]
    if len(ranks[0]) < 3 or not all(np.ptp(each[known]) > 0.0 for each in (values, delta)):
        return 0.0
    return float(abs(np.corrcoef(np.array(ranks))[0, 1]))


def _render_importance(found: CampaignStatistics) -> str:
    """Return a table for each figure; below it stand quantities whose effect is not found, or not estimated."""
    tables = []
    for figure in COMPARED_FIGURES:
        rows, without, unknown = [], [], []
        for name, spread in found.campaign.spreads.items():
            known = [law.figures[figure].importance.get(name) for law in found.laws]
            if not any(known):
                unknown.append(name)
                continue
            if not any(map(_has_effect, known)):
                without.append(name)
                continue
            drawn = f'<span class="interval">{spread.low:g} .. {spread.high:g}</span>'
            rows.append([escape(name), drawn, *(_render_bar(i, each) for i, each in enumerate(known))])
        head = ["quantity", "from .. to", *(_render_law(found, law) for law in found.laws)]
        table = render_table(head, rows) if rows else ""
        words = "No effect found, as the index is within the noise of its estimate"
        none = f"<p class='note'>{words}: {escape(', '.join(without))}.</p>" if without else ""
        none += f"<p class='note'>{escape(_tell_unknown(found, figure, unknown))}</p>" if unknown else ""
        tables.append(f"<h3>{escape(_figure_label(figure))}</h3>{table}{none}")
    return "".join(tables)


def _tell_unknown(found: CampaignStatistics, figure: str, names: Sequence[str]) -> str:
    """Return why the effects of quantities on a figure are not estimated."""
    flown = max(law.figures[figure].flown for law in found.laws)
    few = f"it needs {FEWEST_RUNS} runs of a law (have {flown})"
    reason = few if flown < FEWEST_RUNS else "the figure is the same in every run, or the quantity is"
    return f"Not estimated: {', '.join(names)}; {reason}."


def _has_effect(importance: Importance | None) -> bool:
    return importance is not None and importance.first_order > importance.noise


def _render_bar(i: int, importance: Importance | None) -> str:
    text = format_importance(importance)
    if importance is None or not _has_effect(importance):
        return f'<span class="interval">{text}</span>'
    style = f"{chip_style(i)}; width: {60.0 * importance.first_order:.1f}px"
    return f'<span class="share" style="{style}"></span>{text}'


def _render_worst(found: CampaignStatistics) -> str:
    rows, table = [], escape(str(found.table))
    for law in found.laws:
        for what, value, run in _notable_runs(law):
            command = f"<code>gustproof campaign rerun {table}:{run}</code>"
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
    heading = title and f"<h3>{escape(title)}</h3>"
    return cells and f'<article class="group">{heading}<div class="charts of4">{cells}</div></article>'


def _render_law(found: CampaignStatistics, law: LawStatistics) -> str:
    return render_chip(found.laws.index(law), law.law)


def _figure_label(name: str) -> str:
    label, unit = FIGURES[name]
    return f"{label} [{unit}]"


def _format_interval(value: str, interval: str) -> str:
    return f'{value} <span class="interval">{interval}</span>'
