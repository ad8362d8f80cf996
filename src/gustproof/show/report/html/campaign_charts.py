"""Charts of a campaign as inline SVG, without a script: distributions of the figures and their causes."""

import math
from collections.abc import Callable, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from gustproof.types import Array

_WIDTH, _HEIGHT = 300.0, 200.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 44.0, 10.0, 22.0, 36.0
_BINS = 48  # most bins of a distribution
_POINTS = 160  # points of an exceedance curve
_MEANS = 16  # most means of a response curve
_DOTS = 400  # most cases of a scatter
_MIN_RUNS = 25  # runs for each mean


class Line(NamedTuple):
    """One curve of a chart."""

    colour: int
    """Index in the palette."""
    x: Array
    """(n,) ascending [unit of the chart's x]."""
    y: Array
    """(n,) [unit of the chart's y]; NaN is not drawn."""


class Axis(NamedTuple):
    """One axis of a chart."""

    low: float
    """[unit of the axis]."""
    high: float
    """[unit of the axis]."""
    logarithmic: bool = False
    """True if the axis is logarithmic."""

    def share(self, value: float) -> float:
        """Return the position of a value on the axis, 0..1."""
        if self.logarithmic:
            low, high, value = math.log10(self.low), math.log10(self.high), math.log10(max(value, self.low))
        else:
            low, high = self.low, self.high
        return (value - low) / (high - low)

    def ticks(self) -> list[float]:
        """Return about four to eight round values on the axis."""
        if self.logarithmic:
            return [10.0**k for k in range(math.ceil(math.log10(self.low)), math.floor(math.log10(self.high)) + 1)]
        step = 10.0 ** math.floor(math.log10((self.high - self.low) / 4.0))
        step *= next(k for k in (5.0, 2.0, 1.0) if (self.high - self.low) / (k * step) >= 4.0 or k == 1.0)
        return [step * k for k in range(math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9) + 1)]


def draw_distributions(label: str, values: Sequence[Array]) -> str:
    """Return the histogram of each law's runs, one array a law, in bins common to all laws."""
    found = [each[np.isfinite(each)] for each in values]
    low, high = _value_range(found)
    bins = min(math.ceil(2.0 * math.sqrt(max(map(len, found)))), _BINS)
    edges = np.linspace(low, high, max(bins, 1) + 1)
    lines = []
    for colour, each in enumerate(found):
        shares = np.histogram(each, edges)[0] / max(len(each), 1) * 100.0
        lines.append(Line(colour, np.repeat(edges, 2), np.concatenate([[0.0], np.repeat(shares, 2), [0.0]])))
    top = max((float(np.max(line.y)) for line in lines), default=0.0) or 1.0
    return draw_chart(label, "share of the runs [%]", lines, Axis(low, high), Axis(0.0, 1.05 * top))


def draw_exceedances(label: str, values: Sequence[Array]) -> str:
    """Return the share of each law's runs above a value, down to the single worst run."""
    found = [each[np.isfinite(each)] for each in values]
    low, high = _value_range(found)
    lines = []
    for colour, each in enumerate(found):
        ordered, n = np.sort(each), len(each)
        picks = np.unique(np.round(n - n ** np.linspace(1.0, 0.0, _POINTS)).astype(np.intp)) if n else np.zeros(0, int)
        lines.append(Line(colour, ordered[picks], (n - picks) / max(n, 1) * 100.0))
    least = min(100.0 / max(len(each), 2) for each in found)
    return draw_chart(label, "share of the runs above it [%]", lines, Axis(low, high), Axis(least, 100.0, True))


def draw_responses(
    label: str, drawn: str, values: Sequence[Array], delta: Array, value: Callable[[float], float]
) -> str:
    """Return each law's mean of a figure over the sections of a dispersion's range; `delta` (cases,) is normalised.

    The chart is empty if there are too few cases for two means.
    """
    means = min(len(delta) // _MIN_RUNS, _MEANS)
    if means < 2:
        return ""
    edges = np.linspace(-1.0, 1.0, means + 1)
    middle = np.array([value(float(each)) for each in 0.5 * (edges[1:] + edges[:-1])])
    part = np.clip(np.searchsorted(edges, delta, side="right") - 1, 0, means - 1)
    lines = []
    for colour, each in enumerate(values):
        there = np.isfinite(each)
        counts = np.bincount(part[there], minlength=means)
        sums = np.bincount(part[there], weights=each[there], minlength=means)
        lines.append(Line(colour, middle, np.where(counts > 0, sums / np.maximum(counts, 1), math.nan)))
    low, high = _value_range([line.y[np.isfinite(line.y)] for line in lines])
    return draw_chart(
        drawn, label, lines, Axis(value(-1.0), value(1.0)), Axis(min(low, 0.0), high * 1.05 if high else 1.0)
    )


def draw_scatter(label: str, drawn: str, values: Sequence[Array], delta: Array, value: Callable[[float], float]) -> str:
    """Return a figure of each case, one array (n,) a law, against a quantity drawn at `delta` (n,) of its spread.

    Of very many cases the first `_DOTS` are shown.
    """
    shown = slice(0, _DOTS)
    place = np.array([value(each) for each in delta[shown]])
    dots = [Line(colour, place, each[shown]) for colour, each in enumerate(values)]
    low, high = _value_range([line.y[np.isfinite(line.y)] for line in dots])
    x, y = Axis(value(-1.0), value(1.0)), Axis(min(low, 0.0), high * 1.05 if high else 1.0)
    return draw_chart(drawn, label, [], x, y, dots=dots)


def draw_chart(
    x_label: str, y_label: str, lines: Sequence[Line], x: Axis, y: Axis, *, dots: Sequence[Line] = ()
) -> str:
    """Return a chart of lines, or of `dots`, as SVG in the colours of the page."""
    width, height = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM

    def place(at_x: float, at_y: float) -> str:
        return f"{_LEFT + width * x.share(at_x):.1f},{_TOP + height * (1.0 - y.share(at_y)):.1f}"

    parts = []
    for value in y.ticks():
        at = _TOP + height * (1.0 - y.share(value))
        parts.append(f'<path class="grid" d="M{_LEFT},{at:.1f}h{width}"/>')
        parts.append(f'<text class="y" x="{_LEFT - 5}" y="{at:.1f}">{_format_number(value)}</text>')
    for value in x.ticks():
        at = _LEFT + width * x.share(value)
        parts.append(f'<path class="grid" d="M{at:.1f},{_TOP}v{height}"/>')
        parts.append(f'<text class="x" x="{at:.1f}" y="{_HEIGHT - _BOTTOM + 14}">{_format_number(value)}</text>')
    for line in lines:
        there = np.isfinite(line.y)
        points = " ".join(map(place, line.x[there].tolist(), line.y[there].tolist()))
        parts.append(f'<polyline style="stroke: var(--c{line.colour % 7})" points="{points}"/>')
    for line in dots:
        there = np.isfinite(line.y)
        marks = "".join(
            f"M{place(*each)}h0" for each in zip(line.x[there].tolist(), line.y[there].tolist(), strict=True)
        )
        parts.append(f'<path class="dots" style="stroke: var(--c{line.colour % 7})" d="{marks}"/>')
    middle = _LEFT + width / 2.0
    parts.append(f'<text x="{_LEFT}" y="14">{escape(y_label)}</text>')
    parts.append(f'<text class="x" x="{middle}" y="{_HEIGHT - 5}">{escape(x_label)}</text>')
    name = escape(f"{y_label} against {x_label}", quote=True)
    body = "".join(parts)
    return f'<svg class="plot" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{name}">{body}</svg>'


def _value_range(values: Sequence[Array]) -> tuple[float, float]:
    """Return the least and the largest of all values, widened if they are equal."""
    there = [each for each in values if len(each)]
    low, high = (min(map(np.min, there)), max(map(np.max, there))) if there else (0.0, 0.0)
    return (float(low), float(high)) if high > low else (float(low) - 0.5, float(high) + 0.5)


def _format_number(value: float) -> str:
    return f"{value:.6g}".replace("-", "−").replace("e−0", "e−")
