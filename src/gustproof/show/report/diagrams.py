"""Block diagrams of the design problem and of its LFT."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyBboxPatch

from gustproof.airframe.lpv import PARAMETERS
from gustproof.robust.uncertain.interconnection import Interconnection
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.show.report.figure_style import save_figure
from gustproof.show.report.laid_out import LaidOutFigure

_INK, _FILL, _ACCENT = "#222222", "#eef3f8", "#fdf0e6"
_WIDTH, _HEIGHT, _RADIUS = 0.72, 0.36, 0.2
"""Half width and half height of a block, radius of a sum."""
_PORT, _BEND = 0.16, 0.75
"""Distance between two ports of a block, and from a block to the bends of the wires that enter it."""
_INPUT_X, _OUTPUT_X = 0.8, 14.2
_PLACES = {
    "K": (0.0, 2.0),
    "W_u": (3.0, 3.0), "actuators": (3.0, 1.0),
    "W_d": (3.0, 0.0), "W_n": (3.0, -1.0), "W_r": (3.0, -2.0), "W_l": (3.0, -3.0),
    "moment": (5.3, 1.0), "airframe": (7.8, 1.0), "rate_loop": (7.8, 1.0), "W_m": (7.8, 2.0),
    "gyro": (9.7, -1.0), "error": (10.5, 1.0), "W_e": (12.2, 1.0),
    "gravity": (11.6, 0.0), "level": (13.2, 0.0),
}  # fmt: skip
"""Centre of each block, by its name, and of each sum, by the name of its output."""

Point = tuple[float, float]


class Wire(NamedTuple):
    """Signal drawn from its source to one of its readers."""

    signal: str
    """Name of the signal."""
    points: tuple[Point, ...]
    """Corners, from the source to the tip of the arrow."""
    sign: int = 1
    """Sign of the signal at a sum."""


def save_interconnection(problem: Interconnection, title: str, path: Path) -> None:
    """Draw an attitude design problem with its controller.

    Raises
    ------
    ValueError
        If a block or sum is none of an attitude design problem.
    """
    boxes, sums = place_nodes(problem)
    wires = route_wires(problem)
    labels = {signal.name: signal.label for signal in problem.signals}
    figure = LaidOutFigure()
    axes = figure.subplots()
    axes.set_aspect("equal")
    axes.axis("off")
    for label, centre in boxes.items():
        _draw_box(axes, *centre, (_WIDTH, _HEIGHT), _ACCENT if label == "$K$" else _FILL)
        axes.text(*centre, label, ha="center", va="center", fontsize=10, color=_INK, zorder=4)
    for centre in sums:
        axes.add_patch(Circle(centre, _RADIUS, facecolor="white", edgecolor=_INK, linewidth=1.2, zorder=3))
        axes.text(*centre, "+", ha="center", va="center", fontsize=10, color=_INK, zorder=4)
    for wire in wires:
        _draw_wire(axes, wire.points)
        if wire.sign < 0:
            x, y = wire.points[-1]
            axes.text(x + 0.1, y - 0.04, "−", ha="left", va="top", fontsize=10, color=_INK)
    for signal, group in groupby(wires, key=lambda wire: wire.signal):
        _draw_signal(axes, labels[signal], [wire.points for wire in group], signal in problem.w, signal in problem.z)
    corners = [point for wire in wires for point in wire.points]
    left, right = min(x for x, _ in corners) - 0.3, max(x for x, _ in corners) + 0.8
    low, high = min(y for _, y in corners) - 0.2, max(y for _, y in corners) + 0.7
    axes.set_xlim(left, right)
    axes.set_ylim(low, high)
    figure.set_size_inches(0.62 * (right - left), 0.62 * (high - low) + 0.5)
    figure.suptitle(title, fontsize=12, color=_INK)
    save_figure(figure, path)


def place_nodes(problem: Interconnection) -> tuple[dict[str, Point], list[Point]]:
    """Return the centre of each box, by its label, and of each sum.

    Raises
    ------
    ValueError
        If a block or sum has no place.
    """
    names = [*(block.name for block in problem.blocks), *(junction.output for junction in problem.sums)]
    if unknown := [name for name in names if name not in _PLACES]:
        raise ValueError(f"'{unknown[0]}' has no place in the diagram: only attitude design problems are drawn")
    boxes = {"$K$": _PLACES["K"]} | {block.label: _PLACES[block.name] for block in problem.blocks}
    return boxes, [_PLACES[junction.output] for junction in problem.sums]


def route_wires(problem: Interconnection) -> list[Wire]:
    """Return a wire from each signal to each of its readers; the wires of one signal follow each other."""
    sources = dict(_iter_sources(problem))
    wires = []
    for block in problem.blocks:
        x, y = _PLACES[block.name]
        for port, name in enumerate(block.inputs):
            end, bend = (x - _WIDTH, y - _PORT * port), x - _WIDTH - _BEND + 0.2 * port
            x0, y0 = sources[name]
            bends = () if y0 == end[1] else ((bend, y0), (bend, end[1]))
            wires.append(Wire(name, ((x0, y0), *bends, end)))
    for junction in problem.sums:
        x, y = _PLACES[junction.output]
        for sign, name in junction.terms:
            x0, y0 = sources[name]
            # Straight in from the left, or around one corner from above or below.
            edge = y - _RADIUS if y0 < y else y + _RADIUS
            ends = ((x - _RADIUS, y),) if y0 == y else ((x, y0), (x, edge))
            wires.append(Wire(name, ((x0, y0), *ends), sign))
    wires += [Wire(name, (sources[name], (_OUTPUT_X, sources[name][1]))) for name in problem.z]
    wires += _route_feedback(problem.y, sources, low=min(y for wire in wires for _, y in wire.points) - 0.6)
    return sorted(wires, key=lambda wire: wire.signal)


def _route_feedback(names: Sequence[str], sources: Mapping[str, Point], *, low: float) -> Iterator[Wire]:
    """Yield the wires of the measurements, back to the left below everything else."""
    x1, y1 = _PLACES["K"][0] - _WIDTH, _PLACES["K"][1]
    for i, name in enumerate(sorted(names, key=lambda name: sources[name])):
        x0, y0 = sources[name]
        right, left, down, entry = x0 + 0.5, x1 - 0.5 - 0.25 * i, low - 0.4 * i, y1 + _PORT * i
        yield Wire(name, ((x0, y0), (right, y0), (right, down), (left, down), (left, entry), (x1, entry)))


def _iter_sources(problem: Interconnection) -> Iterator[tuple[str, Point]]:
    """Yield each signal with the point where its wires begin; an exogenous one begins beside its first reader."""
    for name in problem.u:
        yield name, (_PLACES["K"][0] + _WIDTH, _PLACES["K"][1])
    for block in problem.blocks:
        x, y = _PLACES[block.name]
        yield from ((name, (_INPUT_X, y)) for name in block.inputs if name in problem.w)
        yield from ((name, (x + _WIDTH, y - _PORT * port)) for port, name in enumerate(block.outputs))
    for junction in problem.sums:
        x, y = _PLACES[junction.output]
        yield junction.output, (x + _RADIUS, y)


def _draw_signal(axes: Axes, label: str, wires: Sequence[tuple[Point, ...]], is_input: bool, is_output: bool) -> None:
    """Write a signal's label beside its source, or at the end of the diagram, and mark its branches with dots."""
    x, y = wires[0][0]
    if is_output:
        axes.text(_OUTPUT_X + 0.3, y, label, fontsize=10, color=_INK, ha="center", va="center")
    elif is_input:
        axes.text(x - 0.3, y, label, fontsize=10, color=_INK, ha="center", va="center")
    else:
        # Every first port is at a whole height: labels of the others go below their wires.
        height, side = (y + 0.07, "bottom") if y == round(y) else (y - 0.08, "top")
        axes.text(x + 0.12, height, label, fontsize=9, color=_INK, ha="left", va=side)
    ends = [wire[1][0] for wire in wires]
    for end in {end for end in ends if end < max(ends) or ends.count(end) > 1}:
        axes.plot(end, y, ".", color=_INK, markersize=6)


def _draw_wire(axes: Axes, points: Sequence[Point]) -> None:
    axes.plot(*zip(*points, strict=True), color=_INK, linewidth=1.1, solid_joinstyle="round")
    _draw_arrow(axes, points[-2], points[-1])


def save_lft(problem: Interconnection, dynamics: Uncertain, title: str, path: Path) -> None:
    """Draw the LFT whose slice at hover is `problem`: Delta of `dynamics`, generalised plant, controller."""
    figure = LaidOutFigure(figsize=(7.6, 5.4))
    axes = figure.subplots()
    axes.set_aspect("equal")
    axes.axis("off")
    labels, repeats = {each.name: each.label for each in PARAMETERS}, {b.name: b.shape[0] for b in dynamics.blocks}
    blocks = ", ".join(f"{labels[name]}$I_{{{n}}}$" if n > 1 else labels[name] for name, n in repeats.items())
    for label, y, half, fill in (
        (f"$\\Delta(\\rho)$\n{blocks}", 2.2, (2.2, 0.55), _ACCENT),
        ("$P$", 0.0, (1.5, 0.75), _FILL),
        ("$K$", -2.0, (0.9, 0.45), _ACCENT),
    ):
        _draw_box(axes, 0.0, y, half, fill)
        axes.text(0.0, y, label, ha="center", va="center", fontsize=11, color=_INK, zorder=4)
    known = {signal.name: f"{signal.label} ({signal.width})" for signal in problem.signals}
    w, u, z, y_ = (", ".join(known[name] for name in names) for names in (problem.w, problem.u, problem.z, problem.y))
    _draw_around(axes, (2.2, 2.2), (1.5, 0.45), r"$w_\Delta$", 1.0)
    _draw_around(axes, (-1.5, 0.45), (-2.2, 2.2), r"$z_\Delta$", -1.0)
    _draw_around(axes, (0.9, -2.0), (1.5, -0.45), u, 1.0)
    _draw_around(axes, (-1.5, -0.45), (-0.9, -2.0), y_, -1.0)
    for start, signals in ((4.3, w), (-1.5, z)):
        _draw_arrow(axes, (start, 0.0), (start - 2.8, 0.0))
        axes.text(start - 1.4, 0.1, signals, ha="center", va="bottom", fontsize=10, color=_INK)
    axes.set_xlim(-4.6, 4.6)
    axes.set_ylim(-2.7, 3.0)
    figure.suptitle(title, fontsize=12, color=_INK)
    save_figure(figure, path)


def _draw_box(axes: Axes, x: float, y: float, half: tuple[float, float], fill: str) -> None:
    corner, style = (x - half[0], y - half[1]), "round,pad=0,rounding_size=0.06"
    box = FancyBboxPatch(corner, 2.0 * half[0], 2.0 * half[1], boxstyle=style, facecolor=fill, edgecolor=_INK, zorder=3)
    box.set_linewidth(1.2)
    axes.add_patch(box)


def _draw_arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    style = {"arrowstyle": "-|>", "color": _INK, "linewidth": 1.1, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 11}
    axes.annotate("", xy=end, xytext=start, arrowprops=style)


def _draw_around(axes: Axes, start: tuple[float, float], end: tuple[float, float], label: str, side: float) -> None:
    """Draw a wire from one box to another around one side: +1 right, -1 left."""
    x = side * 3.0
    points = [start, (x, start[1]), (x, end[1]), end]
    _draw_wire(axes, points)
    text = "left" if side > 0.0 else "right"
    axes.text(x + 0.1 * side, (start[1] + end[1]) / 2.0, label, ha=text, va="center", fontsize=10, color=_INK)
