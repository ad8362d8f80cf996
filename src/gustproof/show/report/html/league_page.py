"""One HTML file on a league, which needs neither a network nor a script."""

import math
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from firmware_model.config.files import write_text
from gustproof.show.report.html.forest import ForestRow, render_forest
from gustproof.show.report.html.markup import fill_page, read_asset, render_chip, render_table
from gustproof.show.report.league import describe_failures, format_interval, format_number
from gustproof.studies.campaign.intervals import CONFIDENCE
from gustproof.studies.league.course import WORST_DEG
from gustproof.studies.league.entries import REFERENCE
from gustproof.studies.league.ranking import CLASSES, CLIP, TOLERANCE
from gustproof.studies.league.study import League
from gustproof.version import __version__


def write_league_page(league: League, output: Path) -> None:
    """Write the page on a league; the same league gives the same bytes."""
    write_text(output, render_league_page(league))


def render_league_page(league: League) -> str:
    """Return the page as HTML."""
    plan, names = league.plan, ", ".join(each.nominal.name for each in league.plan.vehicles)
    about = f"{len(plan.entries)} entries, {len(plan.scenarios)} scenarios, vehicles {names}: {len(league.cells)}"
    parts = {
        "title": "League of gust rejection",
        "policy": "style-src 'unsafe-inline'; img-src data:",
        "styles": read_asset("page.css") + read_asset("league.css"),
        "about": f"<p>{escape(f'{about} cells of {plan.runs} flights, seed {plan.seed}.')}</p>",
        "ranking": _render_ranking(league),
        "points": _render_points(league),
        "cells": _render_cells(league),
        "pairs": _render_pairs(league),
        "footer": f"Flown and drawn by gustproof {escape(__version__)}.",
    }
    return fill_page("league.html", parts)


def _render_ranking(league: League) -> str:
    rows, marks = [], []
    for i in league.order:
        (rank, within), score = league.ranks[i], league.standings.ratios[i]
        text, name = format_interval(score), league.plan.entries[i].name
        rows.append([_render_entry(league, i), f"{rank}", f"{league.classes[i]}, {within}", escape(text)])
        is_first = i == league.order[0]
        marks.append(ForestRow(i, name, ((score, "disc"),), format_number(score.value), f"score {text}", is_first))
    note = (
        f"Score: a flight's error is the rms of Euler angles minus reference. Its ratio to that of {REFERENCE} in the "
        f"same seed counts within a factor of {CLIP:g}; a flight that fails, diverges or errs by {WORST_DEG:g} deg "
        f"counts as {WORST_DEG:g} deg. The score is the geometric mean over flights and cells, with its "
        f"{100 * CONFIDENCE:g} % interval by the scatter of the seeds. Rank: 1 and the number of entries that are "
        f"better with confidence. Dashed line: the error of {REFERENCE}."
    )
    head = ["entry", "rank", "class, rank in it", "score"]
    return render_forest("Scores", marks, unit_line=True) + _note(note) + render_table(head, rows)


def _render_points(league: League) -> str:
    rows = []
    for i in league.order:
        for first, (vehicles, point) in enumerate(zip(league.plan.vehicles, league.points[i], strict=True)):
            figures = (point.Ms, point.gain_margin, 1e3 * point.delay_margin, point.slew_share)
            named = ("", "") if first else (_render_entry(league, i), league.classes[i])
            cells = (vehicles.nominal.name, *map(format_number, figures), point.refused)
            rows.append([*named, *map(escape, cells)])
    bounds = "; ".join(
        f"{name}: Ms ≤ {each.Ms:g}, gain margin ≥ {each.gain_margin:g}, delay margin ≥ {1e3 * each.delay_margin:g} ms, "
        f"slew ≤ {each.slew_share:g}"
        for name, each in CLASSES.items()
        if math.isfinite(each.Ms)
    )
    note = (
        "Measured on the entry: its response to sines on the test stand, and its torque slew in the turbulence of the "
        "tuning, over 6 times the rms gust moment over the actuator lag. A class has bounds on every vehicle, within "
        f"{TOLERANCE:.0%}, the experiment's accuracy. {bounds}; open: none."
    )
    return _note(note) + render_table(["entry", "class", "vehicle", "Ms", "gain", "delay [ms]", "slew", ""], rows)


def _render_cells(league: League) -> str:
    ratios, rows = league.standings.cells, []
    for k, cell in enumerate(league.cells):
        best = int(np.argmin(ratios[:, k]))
        shades = [_render_ratio(float(ratios[i, k]), best=i == best) for i in league.order]
        mean = format_number(float(league.reference_deg[k].mean()))
        rows.append([escape(cell.scenario.name), escape(cell.vehicles.nominal.name), mean, *shades])
    heads = ["scenario", "vehicle", f"{REFERENCE} [deg]", *_names(league, league.order)]
    lost = "".join(f"<p>{escape(line)}</p>" for line in describe_failures(league))
    described = "".join(f"<li>{escape(f'{each.name}: {each.description}')}</li>" for each in league.plan.scenarios)
    note = (
        f"Error over that of {REFERENCE} in each cell; the least is underlined. Winds are in strengths for paper. "
        "Other vehicles fly in gusts of the same angular acceleration in roll, and under kicks of the same share of "
        "their torque limits. Below: what failed."
    )
    return _note(note) + render_table(heads, rows) + lost + f"<ul>{described}</ul>"


def _render_ratio(ratio: float, *, best: bool) -> str:
    depth = min(abs(math.log(ratio)) / math.log(CLIP), 1.0) ** 0.5
    return _shade(f"{ratio:.2f}", 55 * depth, is_less=ratio < 1.0, kind="heat best" if best else "heat")


def _render_pairs(league: League) -> str:
    order, rows = league.order, []
    for i in order:
        cells = []
        for j in order:
            pair = league.standings.pairs[i][j]
            described = escape(format_interval(pair)) if i != j else ""
            is_told_apart = pair.high < 1.0 or pair.low > 1.0
            cells.append(_shade(described, 25, is_less=pair.high < 1.0) if is_told_apart else described)
        rows.append([_render_entry(league, i), *cells])
    note = (
        f"Error of the row's entry over the column's, geometric mean, with its {100 * CONFIDENCE:g} % interval from "
        "the same flights of both. Without shade the interval holds 1: the two can't be told apart."
    )
    return _note(note) + render_table(["", *_names(league, order)], rows)


def _shade(text: str, depth: float, *, is_less: bool, kind: str = "heat") -> str:
    style = f"--shade: var({'--c2' if is_less else '--c1'}); --depth: {depth:.0f}%"
    return f'<span class="{kind}" style="{style}">{text}</span>'


def _names(league: League, order: Sequence[int]) -> list[str]:
    return [_render_entry(league, i) for i in order]


def _render_entry(league: League, i: int) -> str:
    return render_chip(i, league.plan.entries[i].name)


def _note(text: str) -> str:
    return f"<p class='note'>{escape(text)}</p>"
