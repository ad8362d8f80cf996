"""Forest plots: values with their intervals on one axis, row by row, as plain HTML."""

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple

from gustproof.show.report.html.campaign_charts import Axis
from gustproof.show.report.html.markup import chip_style, render_chip
from gustproof.studies.campaign.intervals import IntervalEstimate

_MOST_LINEAR = 10.0
"""[-] largest over least value above which the axis is logarithmic."""


class ForestRow(NamedTuple):
    """One row of a forest plot."""

    colour: int
    """Index in the palette."""
    name: str
    """Name before the marks."""
    marks: tuple[tuple[IntervalEstimate, str], ...]
    """Values with intervals, each drawn as `disc` or `ring`."""
    text: str
    """Value behind the marks."""
    spoken: str
    """Marks in words, for screen readers."""
    is_best: bool = False
    """True if the value is set in bold."""


def render_forest(heading: str, rows: Sequence[ForestRow]) -> str:
    """Return the plot; nothing if no two values differ.

    The axis begins at 0, or is logarithmic if the values span more than a decade. An interval without an end fades.
    """
    values = [x for row in rows for estimate, _ in row.marks for x in estimate if math.isfinite(x)]
    if not values or max(values) == min(values):
        return ""
    axis = _make_axis(values)
    items = "".join(_render_row(row, axis) for row in rows)
    kind = "log" if axis.logarithmic else ""
    ends = f"<li class='ends'><span></span><span>{axis.low:.3g}<i>{kind}</i>{axis.high:.3g}</span></li>"
    return f'<div class="forest"><h3>{escape(heading)}</h3><ul>{items}{ends}</ul></div>'


def _make_axis(values: Iterable[float]) -> Axis:
    low, high = min(values), max(values)
    if low > 0.0 and high > _MOST_LINEAR * low:
        return Axis(low / 1.1, 1.1 * high, logarithmic=True)
    return Axis(min(0.0, low), 1.04 * high if high > 0.0 else 0.0)


def _render_row(row: ForestRow, axis: Axis) -> str:
    marks = "".join(_render_interval(estimate, axis, kind) for estimate, kind in row.marks)
    colour = chip_style(row.colour)
    track = f'<span class="track" style="{colour}" role="img" aria-label="{escape(row.spoken)}">{marks}</span>'
    text = f"<b>{escape(row.text)}</b>" if row.is_best else escape(row.text)
    return f"<li>{render_chip(row.colour, row.name)}{track}<span>{text}</span></li>"


def _render_interval(estimate: IntervalEstimate, axis: Axis, kind: str) -> str:
    if not math.isfinite(estimate.value):
        return ""
    low, high = (x if math.isfinite(x) else end for x, end in zip(estimate[1:], (axis.low, axis.high), strict=True))
    begin, end = (100.0 * axis.share(min(max(x, axis.low), axis.high)) for x in (low, high))
    faded = "" if math.isfinite(estimate.high) else " open"
    bar = f'<i class="interval-bar{faded}" style="left: {begin:.2f}%; width: {end - begin:.2f}%"></i>'
    return bar + _place(axis, estimate.value, kind)


def _place(axis: Axis, value: float, kind: str) -> str:
    return f'<i class="{kind}" style="left: {100.0 * axis.share(value):.2f}%"></i>'
