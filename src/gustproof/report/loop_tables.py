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
"""Key and heading of each margin of an axis."""


def margins_table(title: str, places: dict[str, Any]) -> Table:
    """Return the margins of `margins_to_dict` by the plant's side and axis."""
    table = Table("plant's", "axis", *MARGINS.values(), "disk\n[-]", title=f"Margins {title}")
    for place, figures in places.items():
        for axis in ("roll", "pitch", "yaw"):
            cells = (format_margin(figures[axis][name]) for name in MARGINS)
            table.add_row(place, axis, *cells, format_margin(figures["disk_margin"]) if axis == "roll" else "")
    return table


def format_margin(value: float | None) -> str:
    """Return a margin as text; `None` is infinite."""
    return "∞" if value is None else f"{value:.3g}"


def format_poles(poles: Iterable[tuple[float, float]]) -> str:
    """Return poles as text, one of each conjugate pair."""
    return ", ".join(f"{re:.4g}" if im == 0.0 else f"{re:.4g} ± {im:.4g}j" for re, im in poles if im >= 0.0)
