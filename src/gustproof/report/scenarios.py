"""Scenarios as a line, a table and JSON."""

from collections.abc import Iterable
from typing import Any

from rich.box import SIMPLE
from rich.table import Table
from rich.text import Text

from firmware_model.config.scenario import Scenario

_PARTS = ("wind", "moment", "link", "event", "require")


def scenarios_table(scenarios: Iterable[Scenario]) -> Table:
    """Return the subject and the duration of each scenario."""
    table = Table("scenario", "shows", box=SIMPLE, padding=(0, 1), pad_edge=False)
    table.add_column("[s]", justify="right")
    for each in scenarios:
        table.add_row(each.name, Text(each.description), f"{each.duration_s:g}")
    return table


def summarize_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return name, subject and duration of a scenario for JSON, and its number of tables of each kind."""
    return {
        "name": scenario.name,
        "description": scenario.description,
        "duration_s": scenario.duration_s,
        "translation": scenario.translation,
        **{part: len(getattr(scenario, part)) for part in _PARTS},
    }


def describe_scenario(scenario: Scenario) -> str:
    """Return the duration and the contents of a scenario in one line."""
    counts = [f"{len(getattr(scenario, part))} [[{part}]]" for part in _PARTS if getattr(scenario, part)]
    where = "in free flight" if scenario.free else "on the test stand"
    return f"{scenario.name}: sound; {', '.join([f'{scenario.duration_s:g} s {where}', *counts])}"
