"""Results as tables and text, for a terminal or a text file."""

import math
from collections.abc import Iterable, Iterator, Mapping
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from firmware_model.config.files import write_text
from firmware_model.config.validation import printable
from gustproof.flight.scoring.estimator_view import EstimatorView
from gustproof.flight.scoring.metrics import FIGURE_UNITS, Metrics
from gustproof.flight.scoring.requirements import (
    RequirementResult,
    requirement_label,
    requirement_limits,
    requirement_window,
    verdict,
)
from gustproof.logs.read.flight_log import ABSENT

if TYPE_CHECKING:
    from gustproof.flight.routes.flight import Flight

Renderable = RenderableType
_WIDTH = 118
_PLAIN: dict[str, Any] = {"highlight": False, "markup": False}  # units stand in brackets
_LABELS = {
    "peak_deg": "peak",
    "peak_settled_deg": "peak, first 2 s left out",
    "rmse_deg": "RMSE",
    "peak_roll_deg": "peak, roll",
    "peak_pitch_deg": "peak, pitch",
    "peak_yaw_deg": "peak, yaw",
    "rmse_roll_deg": "RMSE, roll",
    "rmse_pitch_deg": "RMSE, pitch",
    "rmse_yaw_deg": "RMSE, yaw",
    "torque_rms_nm": "torque rms",
    "torque_peak_nm": "torque peak",
    "torque_slew_rms": "torque slew rms",
    "saturated_s": "torque saturated",
    "rho_in_bounds": "rates within the proofs' 1.5 rad/s",
    "realtime_factor": "speed",
}
_SPEED = {"realtime_factor": "x real time"}  # no unit of a figure that repeats
FIGURES = {name: (label, _SPEED.get(name, FIGURE_UNITS[name])) for name, label in _LABELS.items()}
"""Label and unit of each figure."""

_TIMING_TEXT = (
    "timing: missed deadlines {missed}, repeated set-points {held}; lateness median {late_p50_us} us, "
    "p99 {late_p99_us} us, max {late_worst_us} us"
)
_SAMPLES = "samples at the law: {late_samples} late, {missed_samples} missed"


def show(document: Renderable) -> None:
    """Print on stdout."""
    terminal = Console(**_PLAIN)
    (terminal if terminal.is_terminal else Console(width=_WIDTH, **_PLAIN)).print(_Printable(document))


class _Printable:
    """Document without control characters: its text may come from foreign files."""

    def __init__(self, document: Renderable) -> None:
        self._document = document

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        for text, style, control in console.render(self._document, options):
            yield Segment(printable(text, keep="\n"), style, control)


def save_text(document: Renderable, path: Path) -> None:
    """Write a document as plain text."""
    stream = StringIO()
    Console(file=stream, width=_WIDTH, color_system=None, **_PLAIN).print(document)
    write_text(path, stream.getvalue())


def render_flight(flight: "Flight") -> Renderable:
    """Return figures, requirements, timing, warnings and the bag of one flight, and a real autopilot's own view."""
    # The title of a table would be broken to its narrow width.
    parts: list[RenderableType] = [Text(flight.message, style="bold")]
    if flight.metrics:
        parts.append(figures_table("", {"": flight.metrics}))
    if flight.estimator_view:
        parts.extend(map(Text, estimator_view_lines(flight.estimator_view)))
    if flight.requirements:
        parts.append(requirements_table(flight.requirements))
    if flight.timing:
        parts.extend(map(Text, timing_lines(flight.timing)))
    parts += warning_lines(flight.warnings)
    return Group(*parts, Text(f"recorded in {flight.bag}" if flight.bag else "no samples were flown or recorded"))


def warning_lines(lines: Iterable[str]) -> list[Text]:
    """Return warnings, a line each; what a log may do without is none."""
    return [Text(line) if line.startswith(ABSENT) else Text(f"warning: {line}", style="yellow") for line in lines]


def estimator_view_lines(view: EstimatorView) -> Iterable[str]:
    """Yield the errors of a real autopilot's attitude, as it sees them and in truth."""
    roll, pitch, yaw = map(format_number, view.estimate_axes_deg)
    yield (
        f"against its set-point: RMSE {format_number(view.control_rmse_deg)} deg by its own attitude, "
        f"{format_number(view.true_control_rmse_deg)} in truth, {format_number(view.true_control_steady_deg)} "
        "with each axis' mean removed"
    )
    yield (
        f"its attitude is wrong by RMSE {format_number(view.estimate_rmse_deg)} deg (roll {roll}, pitch {pitch}, "
        f"yaw {yaw}), {format_number(view.estimate_steady_deg)} with each axis' mean removed"
    )
    if wind := view.wind:
        told, true = (", ".join(map(format_number, pair)) for pair in (wind.told_mps, wind.true_mps))
        yield (
            f"its wind: {told} m/s to north and east in the mean, {true} in truth; wrong by RMSE "
            f"{format_number(wind.rmse_mps)} m/s, where the air's own gusts have {format_number(wind.air_rms_mps)}"
        )


def timing_lines(timing: Mapping[str, Any]) -> Iterable[str]:
    """Yield the timing of a flight in real time, and the late samples at its law if the controller reported them."""
    yield _TIMING_TEXT.format_map(timing)
    if "late_samples" in timing:
        yield _SAMPLES.format_map(timing)


def requirements_table(requirements: Iterable[RequirementResult]) -> Table:
    """Return the requirements with values, margins and verdicts."""
    table = Table("requirement", "from .. to [s]", title="Requirements")
    for column in ("limit", "flown", "margin", ""):
        table.add_column(column, justify="right")
    for result in requirements:
        required = result.requirement
        table.add_row(
            requirement_label(required),
            requirement_window(required),
            requirement_limits(required),
            *("not flown" if math.isnan(x) else format_number(x) for x in (result.value, result.margin)),
            Text(*verdict(result)),
        )
    return table


def figures_table(title: str, flights: Mapping[str, Metrics]) -> Table:
    """Return the figures of flights side by side, by name; a single flight without a name has no heading."""
    table = Table("", *flights, "", title=title or None, show_header=any(flights))
    for label, cells, unit in figure_rows(flights):
        table.add_row(label, *cells, unit)
    return table


def figure_rows(flights: Mapping[str, Metrics]) -> list[tuple[str, tuple[str, ...], str]]:
    """Return label, a text for each flight, and unit of each figure; the speed only if it is known.

    The peak after the start-up step is left out where it is the peak.
    """
    rows = []
    for key, (label, unit) in FIGURES.items():
        values = [getattr(metrics, key) for metrics in flights.values()]
        told = key == "peak_settled_deg" and values == [metrics.peak_deg for metrics in flights.values()]
        if values and not told and not (key == "realtime_factor" and not any(values)):
            rows.append((label, tuple(map(format_number, values)), unit))
    return rows


def format_number(value: float | bool) -> str:
    """Return a figure with three digits after the point, with one from 10 on; a truth value as yes or no."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not math.isfinite(value):
        return "-"
    return f"{value:.3f}" if abs(value) < 10.0 else f"{value:.1f}"
