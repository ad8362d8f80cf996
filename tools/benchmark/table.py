"""What is measured, side by side: in turns, so that a machine that changes its speed changes it for all."""

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table

Action = Callable[[], object]


def in_turns(
    actions: Mapping[str, Action], rounds: int, clock: Callable[[], float] = time.process_time
) -> dict[str, list[float]]:
    """Return the times [s] of each action, one of each in every round, after one that does not count.

    They are what this process has used, which other work on the machine changes least; an action that waits for others
    wants the wall's `clock`.
    """
    times: dict[str, list[float]] = {name: [] for name in actions}
    for turn in range(rounds + 1):
        for name, action in actions.items():
            begun = clock()
            action()
            if turn:
                times[name].append(clock() - begun)
    return times


class Bench:
    """Rows, ratios, and what was left out."""

    def __init__(self, *, quick: bool) -> None:
        self.quick = quick
        self.rows: list[dict[str, Any]] = []
        self.ratios: dict[str, float] = {}
        self.left_out: dict[str, str] = {}

    def row(self, name: str, unit: str, values: list[float], note: str = "") -> float:
        """Note what was measured in each round, and return the median."""
        middle = median(values)
        figures = {"min": min(values), "median": middle, "max": max(values), "rounds": len(values)}
        self.rows.append({"name": name, "unit": unit, **figures, "note": note})
        return middle

    def ratio(self, name: str, values: list[float], target: str, note: str = "") -> None:
        """Note a ratio taken in each round; the median counts."""
        self.ratios[name] = self.row(name, "-", values, f"target {target}; {note}" if note else f"target {target}")

    def leave_out(self, name: str, why: str) -> None:
        """Note that something could not be measured."""
        self.left_out[name] = why

    def save(self, path: Path, seconds: float) -> None:
        """Write ratios, rows and what was left out as JSON."""
        document = {"quick": self.quick, "seconds": seconds, "ratios": self.ratios, "rows": self.rows}
        path.write_text(json.dumps({**document, "left_out": self.left_out}, indent=1) + "\n", encoding="utf-8")

    def show(self, seconds: float) -> None:
        """Print the table."""
        table = Table(title="ratios stand for themselves; the other figures are of this machine, now")
        for heading in ("", "median", "min", "max", "unit", ""):
            table.add_column(heading, justify="right" if heading in ("median", "min", "max") else "left")
        for row in self.rows:
            figures = [
                f"{row[name]:.3g}" if row[name] < 1e4 else f"{row[name]:.0f}" for name in ("median", "min", "max")
            ]
            table.add_row(row["name"], *figures, row["unit"], row["note"])
        console = Console(width=150)
        console.print(table)
        for name, why in self.left_out.items():
            console.print(f"left out: {name}: {why}")
        console.print(f"{len(self.rows)} rows, {len(self.left_out)} left out, {seconds:.0f} s")
