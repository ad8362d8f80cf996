"""The design problem and its LFT as figures, drawn from the labelled objects that the plant is made from."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch

from firmware_model.config.files import naming
from gustproof.model.generalized import LftStructure
from gustproof.model.interconnection import Interconnection, Signal
from gustproof.report.layout import HEIGHT, RADIUS, WIDTH, Node, NodeShape, PlacedNode, Wire, lay_out, port_heights

_INK, _FILL, _ACCENT = "#222222", "#eef3f8", "#fdf0e6"


def save_interconnection(problem: Interconnection, title: str, path: Path) -> None:
    """Draw a design problem with its controller.

    Raises
    ------
    ValueError
        If there is a loop that the controller does not close.
    """
    nodes, wires = _build_graph(problem)
    shapes = {node.name: node.shape for node in nodes}
    backward = [wire for wire in wires if shapes[wire.target] is NodeShape.FEEDBACK]
    forward = [wire for wire in wires if shapes[wire.target] is not NodeShape.FEEDBACK]
    places, chains = lay_out(nodes, forward, [wire.source for wire in backward])
    figure = Figure(layout="constrained")
    axes = figure.subplots()
    axes.set_aspect("equal")
    axes.axis("off")
    _draw_forward(axes, places, chains)
    lowest = _draw_backward(axes, places, backward)
    for place in places.values():
        _draw_node(axes, place)
    left = -WIDTH - 0.9
    right, top = max(place.x for place in places.values()) + 0.8, max(place.y for place in places.values()) + 0.7
    axes.set_xlim(left, right)
    axes.set_ylim(lowest - 0.2, top)
    figure.set_size_inches(0.62 * (right - left), 0.62 * (top - lowest) + 0.5)
    figure.suptitle(title, fontsize=12, color=_INK)
    save_figure(figure, path)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as its file's suffix says."""
    with naming(path):
        figure.savefig(path, dpi=150)


def _build_graph(problem: Interconnection) -> tuple[list[Node], list[Wire]]:
    """Return the diagram as nodes and wires; a signal is drawn from its maker to each of its readers."""
    labels = {signal.name: signal.label for signal in problem.signals}
    nodes = [Node(name="K", label="$K$", shape=NodeShape.FEEDBACK)]
    nodes += [Node(name=block.name, label=block.label, shape=NodeShape.BLOCK) for block in problem.blocks]
    nodes += [Node(name=f"+{junction.output}", label="+", shape=NodeShape.SUM) for junction in problem.sums]
    nodes += [Node(name=f":{name}", label=labels[name], shape=NodeShape.TERMINAL) for name in (*problem.w, *problem.z)]
    makers = {name: f":{name}" for name in problem.w} | dict.fromkeys(problem.u, "K")
    makers |= {name: block.name for block in problem.blocks for name in block.outputs}
    makers |= {junction.output: f"+{junction.output}" for junction in problem.sums}
    readers = [(name, block.name, "") for block in problem.blocks for name in block.inputs]
    readers += [(name, f"+{s.output}", "−" if sign < 0 else "") for s in problem.sums for sign, name in s.terms]
    readers += [(name, "K", "") for name in problem.y]
    wires = [
        Wire(source=makers[name], target=reader, label=sign + ("" if name in problem.w else labels[name]))
        for name, reader, sign in readers
    ]
    wires += [Wire(source=makers[name], target=f":{name}") for name in problem.z]
    return nodes, wires


def _draw_forward(axes: Axes, places: dict[str, PlacedNode], chains: Sequence[tuple[Wire, list[str]]]) -> None:
    ports = port_heights(places, chains)
    leaving = Counter(a for a, _ in {link for _, chain in chains for link in pairwise(chain)})
    for wire, chain in chains:
        for a, b in pairwise(chain):
            start, end = places[a], places[b]
            x0, x1 = start.x + start.half_width, end.x - end.half_width
            y0, y1 = start.y, ports[a, b]
            bend = _bend_x(places, start)
            points = [(x0, y0), (bend, y0), (bend, y1), (x1, y1)]
            axes.plot(*zip(*points, strict=True), color=_INK, linewidth=1.1, solid_joinstyle="round")
            if b == wire.target:
                _draw_arrow(axes, (bend, y1), (x1, y1))
            if y0 != y1 and leaving[a] > 1:
                axes.plot(bend, y0, ".", color=_INK, markersize=6)
        target, entry = places[wire.target], ports[chain[-2], wire.target]
        below = entry < target.y
        x, y = target.x - target.half_width - 0.24, entry + (-0.07 if below else 0.07)
        axes.text(x, y, wire.label, fontsize=9, color=_INK, ha="right", va="top" if below else "bottom")


def _bend_x(places: dict[str, PlacedNode], start: PlacedNode) -> float:
    """Return where the wires that leave `start` turn: each node of a layer has its own track."""
    row = sorted((place for place in places.values() if place.layer == start.layer), key=lambda place: place.y)
    return start.x + WIDTH + 0.2 + 0.5 * row.index(start) / len(row)


def _draw_backward(axes: Axes, places: dict[str, PlacedNode], wires: Sequence[Wire]) -> float:
    """Draw what runs back to the left, below everything else; return the lowest height used."""
    lowest = min(place.y for place in places.values()) - 0.6
    for i, wire in enumerate(wires):
        source, target = places[wire.source], places[wire.target]
        x0, x1 = source.x + source.half_width, target.x - target.half_width
        y1 = target.y + 0.3 * ((len(wires) - 1) / 2.0 - i)
        right, left = x0 + 0.5, x1 - 0.7 + 0.25 * (len(wires) - 1 - i)
        lowest -= 0.4
        points = [(x0, source.y), (right, source.y), (right, lowest), (left, lowest), (left, y1), (x1, y1)]
        axes.plot(*zip(*points, strict=True), color=_INK, linewidth=1.1, solid_joinstyle="round")
        _draw_arrow(axes, (left, y1), (x1, y1))
        axes.text((x0 + x1) / 2.0, lowest + 0.08, wire.label, fontsize=9, color=_INK, ha="center", va="bottom")
    return lowest


def _draw_node(axes: Axes, place: PlacedNode) -> None:
    node, x, y = place.node, place.x, place.y
    if node.shape in (NodeShape.BLOCK, NodeShape.FEEDBACK):
        fill = _FILL if node.shape is NodeShape.BLOCK else _ACCENT
        _draw_box(axes, x, y, (WIDTH, HEIGHT), fill)
    elif node.shape is NodeShape.SUM:
        axes.add_patch(Circle((x, y), RADIUS, facecolor="white", edgecolor=_INK, linewidth=1.2, zorder=3))
    if node.shape is not NodeShape.PASS:
        axes.text(x, y, node.label, ha="center", va="center", fontsize=10, color=_INK, zorder=4)


def _draw_box(axes: Axes, x: float, y: float, half: tuple[float, float], fill: str) -> None:
    box = FancyBboxPatch(
        (x - half[0], y - half[1]), 2.0 * half[0], 2.0 * half[1], boxstyle="round,pad=0,rounding_size=0.06",
        facecolor=fill, edgecolor=_INK, linewidth=1.2, zorder=3,
    )  # fmt: skip
    axes.add_patch(box)


def _draw_arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    style = {"arrowstyle": "-|>", "color": _INK, "linewidth": 1.1, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 11}
    axes.annotate("", xy=end, xytext=start, arrowprops=style)


def save_lft(structure: LftStructure, title: str, path: Path) -> None:
    """Draw the closed LFT: Delta of the parameters above, the generalised plant between, the controller below."""
    figure = Figure(figsize=(7.6, 5.4), layout="constrained")
    axes = figure.subplots()
    axes.set_aspect("equal")
    axes.axis("off")
    blocks = ", ".join(f"{label}$I_{{{repeats}}}$" if repeats > 1 else label for label, repeats in structure.parameters)
    delta = f"{structure.delta_label}\n{blocks}"
    for label, y, half, fill in (
        (delta, 2.2, (2.2, 0.55), _ACCENT),
        (structure.plant_label, 0.0, (1.5, 0.75), _FILL),
        (structure.controller_label, -2.0, (0.9, 0.45), _ACCENT),
    ):
        _draw_box(axes, 0.0, y, half, fill)
        axes.text(0.0, y, label, ha="center", va="center", fontsize=11, color=_INK, zorder=4)
    made, read = structure.delta_signals
    _draw_around(axes, (2.2, 2.2), (1.5, 0.45), made, 1.0)
    _draw_around(axes, (-1.5, 0.45), (-2.2, 2.2), read, -1.0)
    _draw_around(axes, (0.9, -2.0), (1.5, -0.45), _list_signals(structure.u), 1.0)
    _draw_around(axes, (-1.5, -0.45), (-0.9, -2.0), _list_signals(structure.y), -1.0)
    for start, signals in ((4.3, structure.w), (-1.5, structure.z)):
        _draw_arrow(axes, (start, 0.0), (start - 2.8, 0.0))
        axes.text(start - 1.4, 0.1, _list_signals(signals), ha="center", va="bottom", fontsize=10, color=_INK)
    axes.set_xlim(-4.6, 4.6)
    axes.set_ylim(-2.7, 3.0)
    figure.suptitle(title, fontsize=12, color=_INK)
    save_figure(figure, path)


def _draw_around(axes: Axes, start: tuple[float, float], end: tuple[float, float], label: str, side: float) -> None:
    """Draw a wire from one box to another around the side: +1 right, -1 left."""
    x = side * 3.0
    points = [start, (x, start[1]), (x, end[1]), end]
    axes.plot(*zip(*points, strict=True), color=_INK, linewidth=1.1, solid_joinstyle="round")
    _draw_arrow(axes, (x, end[1]), end)
    text = "left" if side > 0.0 else "right"
    axes.text(x + 0.1 * side, (start[1] + end[1]) / 2.0, label, ha=text, va="center", fontsize=10, color=_INK)


def _list_signals(signals: Sequence[Signal]) -> str:
    return ", ".join(f"{signal.label} ({signal.width})" for signal in signals)
