"""The house fits in the head: few rooms, on few floors, joined by few arrows.

`python tests/project/test_rooms.py` prints rooms, floors and arrows. The vehicle's side counts as one room, and so do
the modules that every room may use; what type checkers alone import is no arrow.
"""

import ast
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2] / "src" / "gustproof"
MOST_ROOMS, MOST_FLOORS, MOST_ARROWS = 14, 11, 70
COMMON, VEHICLE = "errors, types, version", "firmware_model"
DOORS = {"__init__", "__main__"}
"""Modules at the front, which belong to no room."""


def room_of(module: str) -> str:
    """Return the room of a dotted module."""
    package, _, rest = module.partition(".")
    room = rest.partition(".")[0]
    return VEHICLE if package == VEHICLE else COMMON if room in COMMON.split(", ") else room


def imports(tree: ast.AST) -> Iterator[str]:
    """Yield the modules of both packages that a source imports when it runs."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module] if "." in node.module else [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name for name in names if name.startswith(("gustproof.", VEHICLE)))
        yield from imports(node)


def arrows() -> dict[str, set[str]]:
    """Return, for each room, the rooms that it imports."""
    found: dict[str, set[str]] = {}
    for path in ROOT.rglob("*.py"):
        own = room_of(".".join(("gustproof", *path.relative_to(ROOT).with_suffix("").parts)))
        if own not in DOORS:
            modules = imports(ast.parse(path.read_text(encoding="utf-8")))
            found.setdefault(own, set()).update({room_of(module) for module in modules} - {own} - DOORS)
    return found


def floors(graph: dict[str, set[str]]) -> dict[str, int]:
    """Return the floor of each room: one above the highest that it imports. A cycle raises `graphlib.CycleError`."""
    found: dict[str, int] = {}
    for room in TopologicalSorter(graph).static_order():
        found[room] = 1 + max((found[other] for other in graph.get(room, ())), default=0)
    return found


def test_the_house_has_few_rooms_floors_and_arrows() -> None:
    graph = arrows()
    found = floors(graph)
    assert len(found) <= MOST_ROOMS
    assert max(found.values()) <= MOST_FLOORS
    assert sum(map(len, graph.values())) <= MOST_ARROWS


if __name__ == "__main__":
    graph = arrows()
    found = floors(graph)
    count = sum(map(len, graph.values()))
    sys.stdout.write(f"{len(found)} rooms, {max(found.values())} floors, {count} arrows, no cycle\n")
    for room in sorted(found, key=lambda name: (-found[name], name)):
        sys.stdout.write(f"{found[room]:3}  {room}: {', '.join(sorted(graph.get(room, ())))}\n")
