"""Tables and text on the results, as `rich` shows them on a terminal or writes them to a file."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from firmware_model.config.validation import printable
from gustproof.scoring.metrics import Metrics
from gustproof.scoring.requirements import (
    RequirementResult,
    requirement_label,
    requirement_limits,
    requirement_window,
    verdict,
)

Renderable = RenderableType
_WIDTH = 118
_PLAIN: dict[str, Any] = {"highlight": False, "markup": False}  # a unit in brackets is no markup
FIGURES = {
    "peak_deg": ("peak", "deg"),
    "rmse_deg": ("RMSE", "deg"),
    "peak_roll_deg": ("peak, roll", "deg"),
    "peak_pitch_deg": ("peak, pitch", "deg"),
    "peak_yaw_deg": ("peak, yaw", "deg"),
    "rmse_roll_deg": ("RMSE, roll", "deg"),
    "rmse_pitch_deg": ("RMSE, pitch", "deg"),
    "rmse_yaw_deg": ("RMSE, yaw", "deg"),
    "torque_rms_nm": ("torque rms", "N m"),
    "torque_peak_nm": ("torque peak", "N m"),
    "torque_slew_rms": ("torque slew rms", "N m/s"),
    "saturated_s": ("at a torque limit", "s"),
    "rho_in_bounds": ("ρ within Table II", ""),
    "realtime_factor": ("times real time", ""),
}

_TIMING_TEXT = (
    "deadlines missed {missed}, set-points held {held}; samples late by {late_p50_us} us in the median, "
    "{late_p99_us} us in 99 %, {late_worst_us} us at worst"
)
_SAMPLES = "{late_samples} samples late at the law, {missed_samples} missed"


def show(document: Renderable) -> None:
    """Print on stdout."""
    terminal = Console(**_PLAIN)
    (terminal if terminal.is_terminal else Console(width=_WIDTH, **_PLAIN)).print(_Printable(document))


class _Printable:
    """A document without what a terminal may obey: words in it may come from anywhere."""

    def __init__(self, document: Renderable) -> None:
        self._document = document

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        for text, style, control in console.render(self._document, options):
            yield Segment(printable(text, keep="\n"), style, control)


def save_text(document: Renderable, path: Path) -> None:
    """Write as plain text."""
    with path.open("w", encoding="utf-8") as stream:
        Console(file=stream, width=_WIDTH, color_system=None, **_PLAIN).print(document)


def render_flight(
    title: str,
    metrics: Metrics | None,
    bag: Path | None,
    requirements: Sequence[RequirementResult] = (),
    pace: Mapping[str, Any] | None = None,
    warnings: Sequence[str] = (),
) -> Renderable:
    """Return the figures of one flight, what to know of them, what it had to keep, deadlines, and its recording."""
    # As the title of so narrow a table, a long line would be broken into many.
    parts: list[RenderableType] = [Text(title, style="bold")]
    if metrics:
        parts.append(figures_table("", {"": metrics}))
    if requirements:
        parts.append(requirements_table(requirements))
    if pace:
        parts.extend(map(Text, pace_lines(pace)))
    parts += [Text(f"warning: {line}", style="yellow") for line in warnings]
    return Group(*parts, Text(f"recorded in {bag}" if bag else "nothing was flown, nothing is recorded"))


def pace_lines(pace: Mapping[str, Any]) -> Iterable[str]:
    """Yield how well a flight in real time kept its deadlines, and what its law got late, if it lived to tell."""
    yield _TIMING_TEXT.format_map(pace)
    if "late_samples" in pace:
        yield _SAMPLES.format_map(pace)


def requirements_table(requirements: Iterable[RequirementResult]) -> Table:
    """Return which requirements held, and by what margin."""
    table = Table("required", "from .. to [s]", title="What had to hold")
    for column in ("limit", "flown", "margin", ""):
        table.add_column(column, justify="right")
    for result in requirements:
        required = result.requirement
        table.add_row(
            requirement_label(required), requirement_window(required), requirement_limits(required),
            *map(_format_figure, (result.value, result.margin)),
            Text(*verdict(result)),
        )  # fmt: skip
    return table


def _format_figure(value: float) -> str:
    return "not flown" if math.isnan(value) else format_number(value)


def figures_table(title: str, flights: Mapping[str, Metrics]) -> Table:
    """Return the figures of flights side by side, by name; one without a name has no head."""
    table = Table("", *flights, "", title=title or None, show_header=any(flights))
    for label, cells, unit in figure_rows(flights):
        table.add_row(label, *cells, unit)
    return table


def figure_rows(flights: Mapping[str, Metrics]) -> list[tuple[str, tuple[str, ...], str]]:
    """Return name, a text a flight, and unit of each figure; how fast it was flown only if that is known."""
    rows = []
    for key, (label, unit) in FIGURES.items():
        values = [getattr(metrics, key) for metrics in flights.values()]
        if values and not (key == "realtime_factor" and not any(values)):
            rows.append((label, tuple(map(format_number, values)), unit))
    return rows


def format_number(value: float | bool) -> str:
    """Return a figure with three digits after the point, or one from 10 on; a truth value as yes or no."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not math.isfinite(value):
        return "-"
    return f"{value:.3f}" if abs(value) < 10.0 else f"{value:.1f}"
