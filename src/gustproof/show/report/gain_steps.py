"""Steps from flown gains to those of a tuning, as text and as a document of JSON."""

import math
from collections.abc import Sequence
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from firmware_model.types import Vector
from gustproof.show.report.terminal import Renderable
from gustproof.studies.rate.flight_error import LEAST_HZ
from gustproof.studies.rate.judge import SAME
from gustproof.studies.rate.tuning_steps import MOST_GAIN, TuningStep
from gustproof.types import finite_or_none

_FEEL = (
    "After each step hover and stop hard: a rising tone, twitching or warm motors tell too much. Then go back a step, "
    "else start from the log of that flight."
)


def render_steps(steps: Sequence[TuningStep], at: int) -> Renderable:
    """Return the figures of each step, then each parameter now, in the step `at` that is written, and at the end."""
    in_flight = steps[0].flight_rmse is not None
    title = f"Steps, with the error in this flight above {LEAST_HZ:g} Hz" if in_flight else "Steps"
    title += _price(steps[0], steps[at], at)
    figures = Table("step", "error [deg]", "slew [N m/s]", "Ms", "over spreads", "gain up", "delay [ms]", title=title)
    for number, step in enumerate(steps):
        tuning, margins = step.tuning, step.margins
        figures.add_row(
            str(number) if number else "now",
            _cells(step.flight_rmse) if step.flight_rmse else _cell(math.degrees(tuning.rmse)),
            *(_cell(value) for value in (tuning.slew, tuning.Ms, tuning.corner_Ms)),
            *(("-", "-") if margins is None else (_cell(margins.gain_margin), _cell(1e3 * margins.delay_margin))),
        )
    now, first, last = ({**each.parameters, **each.notches} for each in (steps[at].tuning for at in (0, at, -1)))
    values = Table(
        "parameter", "now", f"step {at}", f"step {len(steps) - 1}", title=f"At most {MOST_GAIN:g} times a step"
    )
    for name in last:
        values.add_row(name, *(_cell(each.get(name, math.inf)) for each in (now, first, last)))
    return Group(figures, values, Text(_FEEL))


def steps_document(steps: Sequence[TuningStep]) -> list[dict[str, Any]]:
    """Return the steps as JSON values, the flown gains first; numbers that are not finite are `None`."""
    return [
        {
            "parameters": step.tuning.parameters,
            "true_rmse_deg": finite_or_none(math.degrees(step.tuning.rmse)),
            "flight_rmse_deg": None if step.flight_rmse is None else [math.degrees(each) for each in step.flight_rmse],
            "slew": finite_or_none(step.tuning.slew),
            "Ms": finite_or_none(step.tuning.Ms),
            "Ms_over_spreads": finite_or_none(step.tuning.corner_Ms),
            "gain_margin": None if step.margins is None else finite_or_none(step.margins.gain_margin),
            "delay_margin_s": None if step.margins is None else finite_or_none(step.margins.delay_margin),
        }
        for step in steps
    ]


def _price(now: TuningStep, step: TuningStep, at: int) -> str:
    """Return which figures of the gains that fly the step `at` makes worse, in words; none where those are unstable."""
    if now.margins is None or step.margins is None:
        return ""
    figures = [
        ("Ms", now.tuning.Ms, step.tuning.Ms, ""),
        ("slew", now.tuning.slew, step.tuning.slew, ""),
        ("gain up", -now.margins.gain_margin, -step.margins.gain_margin, ""),
        ("delay", -1e3 * now.margins.delay_margin, -1e3 * step.margins.delay_margin, " ms"),
    ]
    worse = [
        f"{name} {abs(old):.3g} to {abs(new):.3g}{unit}"
        for name, old, new, unit in figures
        if new > old + SAME * abs(old)
    ]
    return f"; step {at} costs {', '.join(worse) or 'no margin'}"


def _cells(angles: Vector) -> str:
    """Return angles [rad] of roll, pitch and yaw in degrees."""
    return ", ".join(f"{math.degrees(each):.3g}" for each in angles)


def _cell(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "unstable"
