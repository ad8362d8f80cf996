"""Shipped layouts, in which other viewers open our bags."""

from importlib.resources import files
from pathlib import Path

from firmware_model.config.whole_file import write_files

LAYOUTS = {".json": "foxglove.json", ".xml": "plotjuggler.xml"}
"""Layout by the suffix of its file: of Foxglove, of PlotJuggler."""


def read_layout(suffix: str) -> str:
    """Return the layout whose file ends in `suffix`, one of `LAYOUTS`."""
    return (files("gustproof.flight.recording") / "layouts" / LAYOUTS[suffix]).read_text(encoding="utf-8")


def save_layout(path: Path) -> None:
    """Write the layout for the viewer that reads files with the suffix of `path`."""
    write_files({path: read_layout(path.suffix)})
