"""Where the nodes and wires of a block diagram go: nothing is placed by hand.

Left to right by the longest way from an input; wires that pass a layer have stand-ins there; every node goes to the
mean height of its neighbours.

References
----------
K. Sugiyama, S. Tagawa, M. Toda, Methods for visual understanding of hierarchical system structures, IEEE Transactions
on Systems, Man and Cybernetics 11, 1981.
"""

import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import combinations, pairwise

WIDTH, HEIGHT, RADIUS = 0.72, 0.36, 0.2
"""Half the width and height of a block, radius of a sum."""
_STEP_X, _STEP_Y = 2.9, 1.25
_STARTS, _SWEEPS = 60, 16


class NodeShape(Enum):
    """How a node is drawn."""

    BLOCK = "block"
    """A system."""
    SUM = "sum"
    """A sum of what enters it."""
    TERMINAL = "terminal"
    """A signal that comes from outside or leaves."""
    FEEDBACK = "feedback"
    """The system that closes the loop: what enters it runs back to the left."""
    PASS = "pass"
    """Nothing: the way of a wire past a layer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """One thing with signals in and out."""

    name: str
    """Unique name."""
    label: str
    """What is written in it."""
    shape: NodeShape
    """How it is drawn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wire:
    """One signal from a node to another."""

    source: str
    """Name of the node that it leaves."""
    target: str
    """Name of the node that it enters."""
    label: str = ""
    """What is written beside it."""


@dataclass(slots=True, kw_only=True)
class PlacedNode:
    """Where a node goes."""

    node: Node
    """What goes there."""
    layer: int
    """Number of steps from the left."""
    y: float = 0.0
    """[nodes] height."""

    @property
    def x(self) -> float:
        """Distance from the left."""
        return self.layer * _STEP_X

    @property
    def half_width(self) -> float:
        """Half of what the node covers of its layer."""
        return {NodeShape.SUM: RADIUS, NodeShape.PASS: 0.0, NodeShape.TERMINAL: 0.3}.get(self.node.shape, WIDTH)


def lay_out(
    nodes: Sequence[Node], wires: Sequence[Wire], fed_back: Sequence[str]
) -> tuple[dict[str, PlacedNode], list[tuple[Wire, list[str]]]]:
    """Return where each node goes, and each wire as the chain of nodes and stand-ins that it passes."""
    layers = dict.fromkeys((node.name for node in nodes), 0)
    for _ in nodes:
        for wire in wires:
            layers[wire.target] = max(layers[wire.target], layers[wire.source] + 1)
    if any(layers[wire.target] <= layers[wire.source] for wire in wires):
        raise ValueError("there is a loop that no feedback node closes")
    last = max(layers.values())
    for node in nodes:  # inputs stand beside what they feed, outputs at the right edge
        fed = [layers[wire.target] for wire in wires if wire.source == node.name]
        if node.shape is NodeShape.TERMINAL:
            layers[node.name] = min(fed) - 1 if fed else last
    places = {node.name: PlacedNode(node=node, layer=layers[node.name]) for node in nodes}
    chains = []
    for wire in wires:
        passed = []
        for layer in range(layers[wire.source] + 1, layers[wire.target]):
            # Wires of one source share their stand-ins, so that a signal branches as late as it can.
            name = f"{wire.source}@{layer}"
            places.setdefault(name, PlacedNode(node=Node(name=name, label="", shape=NodeShape.PASS), layer=layer))
            passed.append(name)
        chains.append((wire, [wire.source, *passed, wire.target]))
    links = sorted({link for _, chain in chains for link in pairwise(chain)})
    _arrange(places, links, fed_back)
    _straighten(places, chains)
    return places, chains


def _arrange(places: dict[str, PlacedNode], links: Sequence[tuple[str, str]], fed_back: Sequence[str]) -> None:
    """Give every node its height: of many orders to start from, the one with the fewest crossings, then least turns.

    What is `fed_back` is wanted low, as its wire runs below everything.
    """
    chance = random.Random(0)  # the same diagram every time
    best: tuple[float, dict[str, float]] | None = None
    for _ in range(_STARTS):
        rows: dict[int, list[str]] = {}
        for name, place in places.items():
            rows.setdefault(place.layer, []).append(name)
        for row in rows.values():
            chance.shuffle(row)
        _relax(places, rows, links)
        cost = 20.0 * _count_crossings(places, links) + sum(abs(places[a].y - places[b].y) for a, b in links)
        for name in fed_back:
            layer = places[name].layer
            cost += 20.0 * sum(p.layer >= layer and p.y < places[name].y for p in places.values())
        if best is None or cost < best[0]:
            best = cost, {name: place.y for name, place in places.items()}
    if best:
        for name, y in best[1].items():
            places[name].y = y


def _relax(places: dict[str, PlacedNode], rows: dict[int, list[str]], links: Sequence[tuple[str, str]]) -> None:
    """Move every node to the mean height of its neighbours, layer after layer, and apart from its row."""
    near: dict[str, list[PlacedNode]] = {name: [] for name in places}
    for a, b in links:
        near[a].append(places[b])
        near[b].append(places[a])
    for row in rows.values():
        for i, name in enumerate(row):
            places[name].y = -i * _STEP_Y
    layers = sorted(rows)
    for sweep in range(_SWEEPS):
        for layer in layers if sweep % 2 == 0 else reversed(layers):
            wanted = {name: sum(p.y for p in near[name]) / len(near[name]) for name in rows[layer] if near[name]}
            row = rows[layer] = sorted(rows[layer], key=lambda name: -wanted.get(name, 0.0))
            heights = [wanted.get(name, 0.0) for name in row]
            middle = sum(heights) / len(heights)
            for i in range(1, len(row)):
                heights[i] = min(heights[i], heights[i - 1] - _STEP_Y)
            shift = middle - sum(heights) / len(heights)
            for name, height in zip(row, heights, strict=True):
                places[name].y = height + shift


def _count_crossings(places: dict[str, PlacedNode], links: Sequence[tuple[str, str]]) -> int:
    return sum(
        places[a].layer == places[c].layer
        and a != c
        and b != d
        and (places[a].y - places[c].y) * (places[b].y - places[d].y) < 0.0
        for (a, b), (c, d) in combinations(links, 2)
    )


def _straighten(places: dict[str, PlacedNode], chains: Sequence[tuple[Wire, list[str]]]) -> None:
    """Draw wires without small turns where nothing stands in the way."""
    entering = Counter(chain[-1] for _, chain in chains)
    for _, chain in sorted(chains, key=lambda item: places[item[1][0]].layer):
        source, *passed, target = (places[name] for name in chain)
        moved = [*passed, target] if entering[chain[-1]] == 1 else passed
        still = [place for place in places.values() if place not in moved]
        layers = {place.layer for place in moved}
        for y in (source.y, target.y):
            if all(abs(place.y - y) > 0.8 for place in still if place.layer in layers):
                for place in moved:
                    place.y = y
                break


def port_heights(
    places: dict[str, PlacedNode], chains: Sequence[tuple[Wire, list[str]]]
) -> dict[tuple[str, str], float]:
    """Return the height at which each link enters its target: side by side, in the order of where they come from."""
    entering: dict[str, set[str]] = {}
    for _, chain in chains:
        for a, b in pairwise(chain):
            entering.setdefault(b, set()).add(a)
    ports = {}
    for target, sources in entering.items():
        ordered = sorted(sources, key=lambda name: places[name].y)
        spread = 0.18 if places[target].node.shape is NodeShape.SUM else 0.36
        for i, name in enumerate(ordered):
            ports[name, target] = places[target].y + spread * (i - (len(ordered) - 1) / 2.0)
    return ports
