"""Margins and poles as tables and text."""

from collections.abc import Iterable
from typing import Any

from rich.table import Table

MARGINS = {
    "crossover_rad_s": "crossover\n[rad/s]",
    "phase_margin_deg": "phase\n[deg]",
    "gain_margin": "gain up\n[-]",
    "gain_reduction_margin": "gain down\n[-]",
    "delay_margin_s": "delay\n[s]",
    "Ms": "Ms\n[-]",
}
"""Name and heading of each margin of an axis."""


def margins_table(title: str, places: dict[str, Any]) -> Table:
    """Return margins, as `margins_document` has them, by the plant's side and axis."""
    table = Table("plant's", "axis", *MARGINS.values(), "disk\n[-]", title=f"Margins {title}")
    for place, figures in places.items():
        for axis in ("roll", "pitch", "yaw"):
            cells = (margin_cell(figures[axis][name]) for name in MARGINS)
            table.add_row(place, axis, *cells, margin_cell(figures["disk_margin"]) if axis == "roll" else "")
    return table


def margin_cell(value: float | None) -> str:
    """Return a margin for people; `None` is infinite."""
    return "∞" if value is None else f"{value:.3g}"


def poles_text(poles: Iterable[tuple[float, float]]) -> str:
    """Return poles, real and imaginary part, one of each pair."""
    return ", ".join(_pole(re, im) for re, im in poles if im >= 0.0)


def _pole(real: float, imaginary: float) -> str:
    return f"{real:.4g}" if imaginary == 0.0 else f"{real:.4g} ± {imaginary:.4g}j"
