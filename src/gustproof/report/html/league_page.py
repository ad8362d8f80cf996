"""One HTML file on a league, which needs neither a network nor a script."""

import math
from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path

from gustproof.campaign.intervals import CONFIDENCE, IntervalEstimate
from gustproof.league.classes import CLASSES, TOLERANCE
from gustproof.league.course import BOX_SCENARIO, WORST_DEG
from gustproof.league.entrants import REFERENCE
from gustproof.league.season import League
from gustproof.league.standings import CLIP, DRAWS
from gustproof.recording.folder import write_atomic
from gustproof.report.html.forest import ForestRow, render_forest
from gustproof.report.html.markup import (
    fill_page,
    read_asset,
    render_chip,
    render_table,
    render_tile_line,
    render_tiles,
)
from gustproof.report.league import (
    describe_class,
    describe_failures,
    describe_losses,
    describe_salt,
    format_number,
    watched_entrant,
)
from gustproof.version import __version__

_RULES = (
    "An entry gets each sample's gyro, specific force and reference, and the numbers of the nominal vehicle. It "
    "answers with a command. Nothing else is allowed.",
    "It may not look at the truth: state, gusts, faults, the scenario's name or its seed.",
    "It may not look at other runs: each flight has a fresh object, and a law begins with its states at zero.",
    "It may not read or write files, or use the network or the clock, once it is made.",
    "It may not learn the seeds: they derive from a salt whose SHA-256 is told before and which is published after.",
    "It must repeat to the bit: the same samples give the same commands, on each machine of one kind.",
    "In this process nothing hinders a Python object from cheating. The rules bind who enters: the JSON names each "
    "entry by its SHA-256, and with the published salt anybody can fly it again.",
)
_MOST_LINES = 5
"""Most lines of a tile."""


def write_league_page(league: League, output: Path, *, reveal: bool = False) -> None:
    """Write the page on a league; the same league gives the same bytes."""
    write_atomic(output, render_league_page(league, reveal=reveal))


def render_league_page(league: League, *, reveal: bool = False) -> str:
    """Return the page as HTML, with the salt if it is to be revealed."""
    plan = league.plan
    vehicles = ", ".join(each.nominal.name for each in plan.vehicles)
    about = (
        f"{len(plan.entrants)} entries, {len(plan.scenarios)} scenarios, vehicles {vehicles}: {len(league.cells)} "
        f"cells of {plan.runs} flights.",
        describe_salt(league, reveal=reveal),
    )
    parts = {
        "title": "League of gust rejection",
        "policy": "style-src 'unsafe-inline'; img-src data:",
        "styles": read_asset("page.css") + read_asset("league.css"),
        "about": "".join(f"<p>{escape(line)}</p>" for line in about),
        "ranking": _render_ranking(league),
        "prices": _render_prices(league),
        "cells": _render_cells(league),
        "pairs": _render_pairs(league),
        "rules": "<ul class='rules'>" + "".join(f"<li>{escape(line)}</li>" for line in _RULES) + "</ul>",
        "footer": f"Flown and drawn by gustproof {escape(__version__)}.",
    }
    return fill_page("league.html", parts)


def _render_ranking(league: League) -> str:
    rows = []
    for i in league.order:
        box = league.boxes[i]
        cells = (
            _render_entry(league, i),
            str(league.standings.ranks[i]),
            f"{league.classes[i].name}, {league.class_ranks[i]}",
            _format_interval(league.standings.ratios[i]),
            f"{format_number(box.ratio)} ({box.vehicle}: {box.point})",
        )
        rows.append([cells[0], *map(escape, cells[1:])])
    note = (
        f"Score: a flight's error is the rms of Euler angles minus reference. Its ratio to that of {REFERENCE} in the "
        f"same seed counts within a factor of {CLIP:g}; a flight that fails, diverges or errs by {WORST_DEG:g} deg "
        f"counts as {WORST_DEG:g} deg. The score is the geometric mean over flights, then cells. Right of it: its "
        f"{100 * CONFIDENCE:g} % interval by {DRAWS} bootstrap draws of the seeds. Rank: 1 and the number of entries "
        "that are better with confidence, so entries that can't be told apart share a rank. Box: the worst score in "
        f"{BOX_SCENARIO} at the ends of the vehicle's spreads of inertia and lag, and with one more sample of delay."
    )
    table = render_table(["entry", "rank", "class, rank in it", "score", "box"], rows)
    return f"{_render_headline(league)}{_render_scores(league)}{_note(note)}{table}"


def _render_headline(league: League) -> str:
    """Return the first of the ranking, the first of each class, and the entries that win most cells."""
    names, ratios = [each.name for each in league.plan.entrants], league.standings.ratios
    first = [
        render_tile_line(
            i, names[i], format_number(ratios[i].value), f"rank {league.standings.ranks[i]}", is_best=not k
        )
        for k, i in enumerate(league.order[:_MOST_LINES])
    ]
    tiles = [(f"Score <small>error over that of {REFERENCE}</small>", first)]
    leaders = {league.classes[i].name: i for i in reversed(league.order)}
    known = [(leaders[each.name], each.name) for each in CLASSES if each.name in leaders]
    tiles.append(
        (
            "First in its class",
            [render_tile_line(i, names[i], format_number(ratios[i].value), name) for i, name in known],
        )
    )
    won = Counter(int(best) for best in league.standings.cell_best).most_common(_MOST_LINES)
    cells = len(league.cells)
    tiles.append(("Cells with the least error", [render_tile_line(i, names[i], f"{n}", f"of {cells}") for i, n in won]))
    return render_tiles(tiles)


def _render_scores(league: League) -> str:
    rows = []
    for i in league.order:
        score, box = league.standings.ratios[i], league.boxes[i].ratio
        spoken = f"score {_format_interval(score)}, box {format_number(box)}"
        marks = (score, "disc"), (IntervalEstimate(box, box, box), "ring")
        name = league.plan.entrants[i].name
        rows.append(ForestRow(i, name, marks, format_number(score.value), spoken, i == league.order[0]))
    note = f"Disc: score with its interval. Ring: box. Dashed line: the error of {REFERENCE}."
    return render_forest("Scores", rows, unit_line=True) + _note(note)


def _render_prices(league: League) -> str:
    rows = []
    for i in league.order:
        for first, (vehicles, charge) in enumerate(zip(league.plan.vehicles, league.charges[i], strict=True)):
            figures = (charge.Ms, charge.gain_margin, 1e3 * charge.delay_margin, charge.slew, charge.slew_share)
            named = ("", "") if first else (_render_entry(league, i), league.classes[i].name)
            cells = (*named, vehicles.nominal.name, *map(format_number, figures), charge.refused)
            rows.append([cells[0], *map(escape, cells[1:])])
    bounds = "".join(f"<li>{escape(describe_class(each))}</li>" for each in CLASSES)
    note = (
        "Prices are measured on the entry: by its response to sines on the test stand, and by its torque slew in the "
        f"turbulence of the tuning. Bounds hold on every vehicle, within {TOLERANCE:.0%}, the experiment's accuracy. "
        "The usual slew is 6 times the rms gust moment over the actuator lag."
    )
    heads = ["entry", "class", "vehicle", "Ms [-]", "gain [-]", "delay [ms]", "slew [N m/s]", "of the usual", ""]
    return _note(note) + f"<ul>{bounds}</ul>" + render_table(heads, rows)


def _render_cells(league: League) -> str:
    found, order = league.standings, league.order
    watched = watched_entrant(league)
    rows = []
    for k, cell in enumerate(league.cells):
        shades = [_render_ratio(found.cells[i, k], best=i == found.cell_best[k]) for i in order]
        best = league.plan.entrants[int(found.cell_best[k])].name
        mean = format_number(float(league.reference_deg[k].mean()))
        rows.append([escape(cell.scenario.name), escape(cell.vehicle), mean, escape(best), *shades])
    heads = ["scenario", "vehicle", f"{REFERENCE} [deg]", "least error", *_names(league, order)]
    lost = "".join(f"<p>{escape(line)}</p>" for line in [*describe_losses(league), *describe_failures(league)])
    told = "".join(f"<li>{escape(f'{each.name}: {each.description}')}</li>" for each in league.plan.scenarios)
    note = (
        f"Error over that of {REFERENCE} in each cell; the least is underlined. Winds are in strengths for paper. "
        "Other vehicles fly in gusts of the same angular acceleration in roll, and under kicks of the same share of "
        f"their torque limits. Below: where {league.plan.entrants[watched].name} loses, and what failed."
    )
    return _note(note) + render_table(heads, rows) + lost + f"<ul>{told}</ul>"


def _render_ratio(ratio: float, *, best: bool) -> str:
    depth = min(abs(math.log(ratio)) / math.log(CLIP), 1.0) ** 0.5
    shade = "--c2" if ratio < 1.0 else "--c1"
    mark = "heat best" if best else "heat"
    return f'<span class="{mark}" style="--shade: var({shade}); --depth: {55 * depth:.0f}%">{ratio:.2f}</span>'


def _render_pairs(league: League) -> str:
    order, pairs = league.order, league.standings.pairs
    rows = []
    for i in order:
        cells = ["" if i == j else _render_pair(pairs[i][j]) for j in order]
        rows.append([_render_entry(league, i), *cells])
    note = (
        f"Error of the row's entry over the column's, geometric mean, with its {100 * CONFIDENCE:g} % interval from "
        "the same flights of both. Without shade the interval holds 1: the two can't be told apart."
    )
    return _note(note) + render_table(["", *_names(league, order)], rows)


def _render_pair(pair: IntervalEstimate) -> str:
    if pair.low <= 1.0 <= pair.high:
        return escape(_format_interval(pair))
    shade = "--c2" if pair.high < 1.0 else "--c1"
    return f'<span class="heat" style="--shade: var({shade}); --depth: 25%">{escape(_format_interval(pair))}</span>'


def _names(league: League, order: Sequence[int]) -> list[str]:
    return [_render_entry(league, i) for i in order]


def _render_entry(league: League, i: int) -> str:
    return render_chip(i, league.plan.entrants[i].name)


def _note(text: str) -> str:
    return f"<p class='note'>{escape(text)}</p>"


def _format_interval(estimate: IntervalEstimate) -> str:
    return f"{format_number(estimate.value)} ({format_number(estimate.low)} .. {format_number(estimate.high)})"
