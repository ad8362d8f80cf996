"""A polar plot: values over bearings, north up, as SVG in the look of the other figures."""

import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

from gustproof.show.report.html.markup import chip_style

_RADIUS, _MARGIN = 150.0, 44.0
_STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_RINGS = 5
_SIDES = ("front", "right", "back", "left")


class PolarCurve(NamedTuple):
    """Values over bearings."""

    label: str
    """Name."""
    colour: int
    """Index in the palette."""
    points: Sequence[tuple[float, float]]
    """Bearing [deg] and value, rising around the circle; a value that is not finite is left out."""


def render_polar(heading: str, curves: Sequence[PolarCurve], *, unit: str) -> str:
    """Return the plot; nothing if no value is finite."""
    values = [value for curve in curves for _, value in curve.points if math.isfinite(value)]
    if not values:
        return ""
    step = next((each for each in _STEPS if each * _RINGS >= max(values)), _STEPS[-1])
    rings = math.ceil(max(values) / step)
    scale = _RADIUS / (rings * step)
    lines = "".join(_render_curve(curve, scale) for curve in curves)
    spoken = "; ".join(_speak(curve, unit) for curve in curves)
    size = 2.0 * (_RADIUS + _MARGIN)
    box = f"{-size / 2:g} {-size / 2:g} {size:g} {size:g}"
    drawn = _render_ground(rings, step, scale) + lines
    svg = f'<svg viewBox="{box}" role="img" aria-label="{escape(spoken)}">{drawn}</svg>'
    keys = "".join(
        f'<li><span class="chip" style="{chip_style(curve.colour)}"></span>{escape(curve.label)}</li>'
        for curve in curves
    )
    return f'<div class="polar"><h3>{escape(heading)}</h3>{svg}<ul>{keys}</ul></div>'


def _render_ground(rings: int, step: float, scale: float) -> str:
    """Return rings with their values, spokes, and the names of the sides."""
    circles = "".join(
        f'<circle class="grid" r="{scale * step * k:.1f}"/>'
        f'<text class="ring" x="{0.38 * scale * step * k:.1f}" y="{-0.92 * scale * step * k:.1f}">{step * k:g}</text>'
        for k in range(1, rings + 1)
    )
    ends = (_place(45.0 * k, _RADIUS) for k in range(8))
    spokes = "".join(f'<line class="grid" x1="{x:.1f}" y1="{y:.1f}"/>' for x, y in ends)
    return circles + spokes + "".join(_render_name(90.0 * k, name) for k, name in enumerate(_SIDES))


def _place(bearing: float, radius: float) -> tuple[float, float]:
    """Return x and y of a bearing [deg] at a radius, north up."""
    angle = math.radians(bearing)
    return radius * math.sin(angle), -radius * math.cos(angle)


def _render_name(bearing: float, name: str) -> str:
    x, y = _place(bearing, _RADIUS + 22.0)
    return f'<text x="{x:.1f}" y="{y:.1f}">{name}</text>'


def _render_curve(curve: PolarCurve, scale: float) -> str:
    shown = [_place(bearing, scale * value) for bearing, value in curve.points if math.isfinite(value)]
    corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in shown)
    dots = "".join(f'<circle class="dot" cx="{x:.1f}" cy="{y:.1f}" r="3.5"/>' for x, y in shown)
    line = "polygon" if len(shown) == len(curve.points) else "polyline"
    return f'<g style="--line: var(--c{curve.colour % 7})"><{line} points="{corners}"/>{dots}</g>'


def _speak(curve: PolarCurve, unit: str) -> str:
    values = ", ".join(f"{value:.3g} from {bearing:g} deg" for bearing, value in curve.points if math.isfinite(value))
    return f"{curve.label} [{unit}]: {values}"
