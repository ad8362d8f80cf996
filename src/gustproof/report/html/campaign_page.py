"""One HTML file on a campaign: it asks nobody for anything, opens without a network, and needs no script."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

import numpy as np

from gustproof import __version__
from gustproof.campaign.intervals import LEVEL, Estimate, Importance
from gustproof.campaign.reader import opened, read_column, read_note
from gustproof.campaign.statistics import COMPARED, Findings, LawFindings, findings
from gustproof.campaign.worker import FIGURES as FLOWN
from gustproof.campaign.worker import delta_column
from gustproof.recording.folder import write_whole
from gustproof.report.campaign import duel_lines, headline, number, share_text
from gustproof.report.html.campaign_charts import distributions, exceedances, responses
from gustproof.report.html.markup import table
from gustproof.report.terminal import FIGURES
from gustproof.scoring.requirements import requirement_label, requirement_limits

_ASSETS = files("gustproof.report") / "assets"
_COLUMNS = ("mean", "median", "95 % below", "99 % below")
_EXPLAINED = "rmse_deg"


def write_campaign_report(path: Path, output: Path) -> None:
    """Write the page on the campaign in a file; the same campaign gives the same bytes."""
    write_whole(output, campaign_page(path))


def campaign_page(path: Path) -> str:
    """Return the page as HTML.

    Raises
    ------
    ConfigError
        If it is not a campaign's file.
    """
    found = findings(path)
    flown = read_note(path)["versions"]["gustproof"]
    parts = {
        "title": escape(f"{found.campaign.scenario.name}: {', '.join(law.law for law in found.laws)}"),
        "styles": (_ASSETS / "page.css").read_text(encoding="utf-8"),
        "about": f"<p>{escape(found.campaign.scenario.description)}</p><p>{escape(headline(found.campaign))}</p>"
        + "".join(f"<p class='bad'>{escape(line)}</p>" for line in found.warnings),
        "figures": _figures(found),
        "requirements": _requirements(found),
        "legend": _legend(found),
        "distributions": _distributions(found),
        "dispersions": _dispersions(found),
        "worst": _worst(found),
        "footer": f"Flown by gustproof {escape(flown)}, drawn by gustproof {__version__}.",
    }
    template = (_ASSETS / "campaign.html").read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


def _figures(found: Findings) -> str:
    rows = []
    for name in FLOWN:
        label = _label(name)
        for first, law in enumerate(found.laws):
            figure = law.figures[name]
            estimates = (figure.mean, *figure.quantiles.values())
            worst = number(figure.worst[0].value) if figure.worst else "–"
            rows.append(["" if first else escape(label), _law(found, law), *map(_estimate, estimates), worst])
    duels = "".join(f"<p>{escape(line)}</p>" for line in duel_lines(found))
    note = (
        f"<p class='note'>Behind each figure: where the true one is, {100.0 * LEVEL:g} % sure: Student's t for means, "
        "order statistics for quantiles, Clopper and Pearson for shares.</p>"
    )
    return note + table(["", "law", *_COLUMNS, "worst"], rows) + duels


def _requirements(found: Findings) -> str:
    rows = []
    for law in found.laws:
        for each in law.passed:
            last = f"{number(each.worst[0].value)} in run {each.worst[0].run}" if each.worst else "–"
            required = each.requirement
            rows.append([_law(found, law), requirement_label(required), requirement_limits(required),
                         _share(each.rate), escape(last)])  # fmt: skip
        rows.append([_law(found, law), "all of them, and flown to the end", "", _share(law.all_held), ""])
    return table(["law", "required", "limit", "runs that kept it", "worst"], rows)


def _distributions(found: Findings) -> str:
    file, charts, alike = opened(found.table), list[str](), list[str]()
    for name in FLOWN:
        values, label = read_column(file, name, found.campaign), _label(name)
        least, largest = np.nanmin(values, initial=math.inf), np.nanmax(values, initial=-math.inf)
        if least < largest:
            charts += [distributions(label, list(values)), exceedances(label, list(values))]
        elif least == largest:
            alike.append(f"<p>{escape(label)}: {number(float(least))} in every run.</p>")
    return _group("How the runs are spread, and how many exceed a value", charts) + "".join(alike)


def _dispersions(found: Findings) -> str:
    if not found.campaign.spreads:
        return "<p>Nothing was drawn but gusts and noise.</p>"
    file, charts = opened(found.table), []
    values, label = list(read_column(file, _EXPLAINED, found.campaign)), _label(_EXPLAINED)
    for name, spread in found.campaign.spreads.items():
        delta = read_column(file, delta_column(name), found.campaign)[0]
        charts.append(responses(label, name, values, delta, spread.value))
    note = (
        "<p class='note'>Share of a figure's variance that each explains by itself (first-order Sobol' index by "
        "binning), and the rank correlation (Spearman); what chance alone may do is called not seen. The rest is gusts "
        "and noise, drawn anew for each case, and what acts together. Units are those of the vehicle file.</p>"
    )
    return note + _importance(found) + _group(f"mean {label} against each", charts)


def _importance(found: Findings) -> str:
    heads = [
        "drawn",
        "from .. to",
        *(f"{_law(found, law)} {escape(_label(n))}" for n in COMPARED for law in found.laws),
    ]
    rows = []
    for name, spread in found.campaign.spreads.items():
        cells = [_bar(law.figures[figure].importance.get(name)) for figure in COMPARED for law in found.laws]
        drawn = f'<span class="interval">{spread.low:g} .. {spread.high:g}</span>'
        rows.append([escape(name), drawn, *cells])
    return table(heads, rows)


def _bar(importance: Importance | None) -> str:
    if importance is None:
        return "too few runs"
    if importance.first_order <= importance.noise:
        return f'<span class="interval">not seen, {importance.rank_correlation:+.2f}</span>'
    share = 100.0 * importance.first_order
    bar = f'<span class="share" style="width: {0.6 * share:.1f}px"></span>'
    return f"{bar}{share:.0f} %, {importance.rank_correlation:+.2f}"


def _worst(found: Findings) -> str:
    rows = []
    for law in found.laws:
        rows += [[_law(found, law), escape(what), value, _command(found, run)] for what, value, run in _stands_out(law)]
    return table(["law", "", "", "again, over UDP, to the same bits"], rows)


def _stands_out(law: LawFindings) -> Iterator[tuple[str, str, int]]:
    """Yield what is remarkable of a run of the law, its value, and its number."""
    for failure in law.failures:
        yield f"left no figures: {failure.reason}", "", failure.run
    for name in COMPARED:
        for each in law.figures[name].worst:
            yield _label(name), number(each.value), each.run
    for passed in law.passed:
        label = requirement_label(passed.requirement)
        for each in passed.worst[:1]:
            yield f"required: {label} {requirement_limits(passed.requirement)}", number(each.value), each.run


def _command(found: Findings, run: int) -> str:
    return f"<code>gustproof fly --run {escape(str(found.table))}:{run}</code>"


def _group(title: str, charts: Sequence[str]) -> str:
    cells = "".join(f'<div class="chart">{each}</div>' for each in charts if each)
    return cells and f'<article class="group"><h3>{escape(title)}</h3><div class="charts of4">{cells}</div></article>'


def _legend(found: Findings) -> str:
    return f'<p class="legend">{"".join(f"<span>{_law(found, law)}</span>" for law in found.laws)}</p>'


def _law(found: Findings, law: LawFindings) -> str:
    colour = found.laws.index(law) % 7
    return f'<i class="chip" style="--chip: var(--c{colour})"></i>{escape(law.law)}'


def _label(name: str) -> str:
    label, unit = FIGURES[name]
    return f"{label} [{unit}]"


def _estimate(estimate: Estimate) -> str:
    return f"{number(estimate.value)} {_interval(map(number, estimate[1:]))}"


def _share(estimate: Estimate) -> str:
    value, interval = share_text(estimate)
    return f"{value} {_interval(interval.split(' .. '))}"


def _interval(ends: Iterable[str]) -> str:
    return f'<span class="interval">{" .. ".join(ends)}</span>'
