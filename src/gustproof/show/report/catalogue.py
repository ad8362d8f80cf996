"""Catalogues of what is shipped: laws, vehicles, designs and scenarios as a table, as JSON and as their files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from pydantic_core import to_jsonable_python
from rich.box import SIMPLE
from rich.console import Group
from rich.table import Table
from rich.text import Text

from firmware_model.config.files import list_shipped, read_text, shipped_path
from firmware_model.config.scenario import SCENARIOS, Scenario, load_scenario
from firmware_model.config.validation import printable
from firmware_model.config.vehicle import VEHICLES, Vehicle, load_vehicle
from gustproof.design.designs import DESIGNS, Design, load_design
from gustproof.flight.endpoint import DEFAULT_LAW
from gustproof.law.form import LAWS, Law
from gustproof.law.schedule import schedule_limits
from gustproof.law.write.matrices import read_law
from gustproof.show.report.terminal import Renderable, format_number

_PARTS = ("wind", "moment", "link", "event", "require")


class Catalogue(NamedTuple):
    """Files of one kind that are shipped."""

    kind: str
    """Kind as commands name it."""
    folder: Path
    """Folder that holds them."""
    suffix: str
    """Ending of their names."""
    load: Callable[[str], Any]
    """Reads one, by its name or a file of the user's."""
    summarize: Callable[[Any], dict[str, Any]]
    """Returns its name, its description and the values of the other columns."""
    columns: dict[str, str]
    """Heading of each column beside name and description, by its key."""


def summarize_law(law: Law) -> dict[str, Any]:
    """Return the facts of a law by which it is chosen."""
    return {
        "name": law.name,
        "description": _describe_law(law),
        "vehicle": law.provenance.vehicle,
        "commands": law.output.value,
        "states": law.order,
        "rate_hz": round(1.0 / law.dt, 6),
    }


def _describe_law(law: Law) -> str:
    """Return what a law is, the delay and gain at which it was asked to stay stable, and whether it is the default."""
    asked = law.provenance.parameters
    delay, gain = asked.get("stable_delay_samples"), asked.get("stable_gain")
    kept = f", stable at {delay:g} samples of delay and {gain:g} times the gain" if delay and gain else ""
    return f"{law.provenance.design}{kept}{'; the default' if law.name == DEFAULT_LAW else ''}"


def summarize_vehicle(vehicle: Vehicle) -> dict[str, Any]:
    """Return the facts of a vehicle by which it is chosen."""
    return {
        "name": vehicle.name,
        "description": vehicle.description,
        "mass_kg": vehicle.mass,
        "rotors": len(vehicle.rotors.spin),
    }


def summarize_design(design: Design) -> dict[str, Any]:
    """Return the facts of a design by which it is chosen."""
    return {
        "name": design.name,
        "description": design.description,
        "law": design.law or design.name,
        "vehicle": design.vehicle,
    }


def summarize_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return name, subject and duration of a scenario, and its number of tables of each kind."""
    return {
        "name": scenario.name,
        "description": scenario.description,
        "duration_s": scenario.duration_s,
        "translation": scenario.translation,
        **{part: len(getattr(scenario, part)) for part in _PARTS},
    }


CATALOGUES = {
    each.kind: each
    for each in (
        Catalogue("law", LAWS, ".json", read_law, summarize_law, {"commands": "commands", "states": "states"}),
        Catalogue(
            "vehicle", VEHICLES, ".toml", load_vehicle, summarize_vehicle, {"mass_kg": "[kg]", "rotors": "rotors"}
        ),
        Catalogue("design", DESIGNS, ".toml", load_design, summarize_design, {"law": "law"}),
        Catalogue("scenario", SCENARIOS, ".toml", load_scenario, summarize_scenario, {"duration_s": "[s]"}),
    )
}
"""Catalogue of each kind."""


def summarize_all(catalogue: Catalogue) -> list[dict[str, Any]]:
    """Return the facts of everything in a catalogue."""
    return [catalogue.summarize(catalogue.load(name)) for name in list_shipped(catalogue.folder, catalogue.suffix)]


def catalogue_table(catalogue: Catalogue) -> Table:
    """Return name, description and columns of everything in a catalogue."""
    table = Table(catalogue.kind, "shows" if catalogue.kind == "scenario" else "is", box=SIMPLE, pad_edge=False)
    for heading in catalogue.columns.values():
        table.add_column(heading, justify="right")
    for each in summarize_all(catalogue):
        table.add_row(each["name"], Text(each["description"]), *(_cell(each[key]) for key in catalogue.columns))
    return table


def _cell(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def read_source(catalogue: Catalogue, name: str) -> str:
    """Return the text of a file of a catalogue, or of the user's, without characters that control a terminal.

    Raises
    ------
    ConfigError
        If it is missing or invalid.
    """
    catalogue.load(name)
    return printable(read_text(shipped_path(catalogue.kind, name, catalogue.folder, catalogue.suffix)), keep="\n\r\t")


def to_document(catalogue: Catalogue, name: str) -> Any:
    """Return everything that a file says, its defaults too, for JSON; a law in the form of its file.

    Raises
    ------
    ConfigError
        If it is missing or invalid.
    """
    loaded = catalogue.load(name)
    return loaded.to_dict() if isinstance(loaded, Law) else to_jsonable_python(loaded, inf_nan_mode="null")


def render_law(law: Law) -> Renderable:
    """Return the facts of a law and the numbers that it was made with; its matrices are in its file."""
    facts = Table("", "", show_header=False, box=SIMPLE, pad_edge=False)
    for key, value in summarize_law(law).items():
        facts.add_row(key, Text(_cell(value)))
    facts.add_row("self-scheduled", "yes" if law.is_scheduled else "no")
    if law.schedule is not None:
        limits = [f"{name} to {limit:.3g}" for name, limit in schedule_limits(law.schedule).items()]
        facts.add_row("scheduled on", Text(", ".join(limits)))
    for key, value in law.provenance.parameters.items():
        facts.add_row(key, Text(format_number(value) if isinstance(value, float | bool) else str(value)))
    return Group(facts, Text(f"Margins and limits: gustproof analyse {law.name}"))


def describe_scenario(scenario: Scenario) -> str:
    """Return the duration and the contents of a scenario in one line."""
    counts = [f"{len(getattr(scenario, part))} [[{part}]]" for part in _PARTS if getattr(scenario, part)]
    where = "in free flight" if scenario.free else "on the test stand"
    where += ", its position held" if scenario.holds_place else ""
    return f"{scenario.name}: sound; {', '.join([f'{scenario.duration_s:g} s {where}', *counts])}"
