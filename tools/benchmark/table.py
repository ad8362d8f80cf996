"""Measurements taken in turns, so that a change of the machine's speed affects all of them."""

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
    """Return the times [s] of each action, one of each in every round, after a first round that does not count.

    The default clock is this process' CPU time, which depends least on other work of the machine. An action that waits
    for other processes needs a wall `clock`.
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
    """Rows, ratios, and omissions of a benchmark."""

    def __init__(self, *, quick: bool) -> None:
        self.quick = quick
        self.rows: list[dict[str, Any]] = []
        self.ratios: dict[str, float] = {}
        self.left_out: dict[str, str] = {}

    def row(self, name: str, unit: str, values: list[float], note: str = "") -> float:
        """Record the values of all rounds, and return their median."""
        middle = median(values)
        figures = {"min": min(values), "median": middle, "max": max(values), "rounds": len(values)}
        self.rows.append({"name": name, "unit": unit, **figures, "note": note})
        return middle

    def ratio(self, name: str, values: list[float], target: str, note: str = "") -> None:
        """Record a ratio by its median over the rounds."""
        self.ratios[name] = self.row(name, "-", values, f"target {target}; {note}" if note else f"target {target}")

    def leave_out(self, name: str, why: str) -> None:
        """Record that something could not be measured."""
        self.left_out[name] = why

    def save(self, path: Path, seconds: float) -> None:
        """Write ratios, rows and omissions as JSON."""
        document = {"quick": self.quick, "seconds": seconds, "ratios": self.ratios, "rows": self.rows}
        path.write_text(json.dumps({**document, "left_out": self.left_out}, indent=1) + "\n", encoding="utf-8")

    def show(self, seconds: float) -> None:
        """Print the table."""
        table = Table(title="ratios hold anywhere; the other figures are of this machine, now")
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
