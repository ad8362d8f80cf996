"""One HTML file on the wind that a vehicle stands: limit, directions, gusts, map, and flights on both sides of it."""

import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from firmware_model.config.files import write_text
from firmware_model.config.vehicle import Vehicle
from gustproof.law.form import Law
from gustproof.show.report.html.charts import Chart, ChartGroup, ChartKind, Curve, CurveStyle
from gustproof.show.report.html.judgement_page import fly_run
from gustproof.show.report.html.marks import Mark
from gustproof.show.report.html.markup import render_table
from gustproof.show.report.html.page import render_page
from gustproof.show.report.html.polar import PolarCurve, render_polar
from gustproof.show.report.wind_lines import describe_limit, title
from gustproof.studies.wind_limit.wind_limit import DIRECTIONS, WindLimit


def write_wind_page(found: WindLimit, vehicle: Vehicle, law: Law, path: Path) -> None:
    """Write the page; the same limit gives the same bytes."""
    run = fly_run("in this wind", law, found.shown_flight, vehicle, seed=1)
    page = render_page([run], title=f"Wind limit: {title(found)}", intro=_render_limit(found), first=[*_charts(found)])
    write_text(path, page)


def _render_limit(found: WindLimit) -> str:
    lines = "".join(f"<li>{escape(line)}</li>" for line in describe_limit(found))
    plots = f'<div class="forests">{_render_around(found)}{_render_map(found)}</div>'
    return f'<section id="verdict"><h2>{escape(title(found))}</h2><ul>{lines}</ul>{plots}</section>'


def _render_around(found: WindLimit) -> str:
    """Return the winds and gusts that fail over their directions, and what they are."""
    level = zip(DIRECTIONS, found.gusts[: len(DIRECTIONS)], strict=True)
    least = [(bearing, gust.speed) for bearing, gust in level]
    gusts = PolarCurve("least single 1-cos gust that fails, in calm air", 1, least)
    winds = PolarCurve("mean wind with its turbulence in which half of the flights fail", 0, found.halves)
    curves = [*([winds] if found.halves else []), *([gusts] if any(math.isfinite(each) for _, each in least) else [])]
    return render_polar("Wind that fails, by where it comes from [m/s]", curves, unit="m/s")


def _render_map(found: WindLimit) -> str:
    """Return the share of failures over mean wind and turbulence as a table, shaded."""
    if not found.grid:
        return ""
    turbulences = sorted({turbulence for _, turbulence, _ in found.grid})
    means = sorted({mean for mean, _, _ in found.grid})
    share = {(mean, turbulence): each for mean, turbulence, each in found.grid}
    rows = [
        [f"{mean:.1f}", *(_shade(share[mean, turbulence]) for turbulence in turbulences)] for mean in reversed(means)
    ]
    head = ["mean wind", *(f"{each:.1f}" for each in turbulences)]
    note = (
        "Share of flights that fail, [%], 32 in each cell. Rows are mean winds, columns turbulence, both as speeds "
        "at 20 ft [m/s]. The wind's own turbulence is"
    )
    heading = f"<h3>Mean wind against turbulence</h3><p class='note'>{note} on the diagonal.</p>"
    return f"<div>{heading}{render_table(head, rows)}</div>"


def _shade(share: float) -> str:
    return f'<span class="heat" style="--shade: var(--c1); --depth: {60.0 * share:.0f}%">{100.0 * share:.0f}</span>'


def _charts(found: WindLimit) -> Iterator[ChartGroup]:
    limit = found.turbulence
    trials = [(trial.speed, 100.0 * trial.probability) for trial in limit.trials]
    marks = (Mark(label=f"risk {100.0 * found.risk:g} %", y=100.0 * found.risk),)
    probability = _chart("flights that fail [%]", "wind at 20 ft [m/s]", trials, marks)
    loads = [*found.directions, (360.0, found.directions[0][1])]
    around = _chart("largest figure over its limit [-]", "wind from [deg]", loads, ())
    note = f"Directions are weighed at {found.direction_speed:.3g} m/s, by the median flight. The vehicle heads north."
    yield ChartGroup(title="Wind", charts=(probability, *((around,) if found.holds_place else ())), note=note)
    lengths = [(gust.length_s, gust.speed) for gust in found.lengths if math.isfinite(gust.speed)]
    if lengths:
        source = found.lengths[0].source
        least = _chart("least gust that fails [m/s]", "length of the gust [s]", lengths, ())
        yield ChartGroup(title=f"1-cos gusts from {source}", charts=(least,), note="In calm air, without turbulence.")


def _chart(name: str, x_label: str, points: Sequence[tuple[float, float]], marks: tuple[Mark, ...]) -> Chart:
    x, y = np.array(points).T
    curve = Curve(label=name, colour=0, x=x, y=y, style=CurveStyle.SOLID)
    return Chart(title=name, x_label=x_label, kind=ChartKind.LINEAR, curves=(curve,), marks=marks)
