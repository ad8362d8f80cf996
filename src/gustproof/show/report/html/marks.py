"""Lines and bands behind the time histories: requirements, limits of the vehicle, gusts, faults and events."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from math import degrees, inf
from typing import Any

from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.scenario import Scenario
from firmware_model.config.timeline import timeline
from firmware_model.types import AXES
from gustproof.show.report.html.runs import ReportRun


class History(Enum):
    """Group of time histories; the value is its title."""

    ATTITUDE = "Attitude"
    RATES = "Body rates"
    COMMANDED_RATES = "Commanded rates"
    COMMANDED_TORQUE = "Commanded torque"
    ACTUATOR_TORQUE = "Torque of the actuators"
    SATURATION = "Saturation"
    GUST = "Gust, blowing toward"
    ANGULAR_GUST = "Angular gust"
    MEAN_WIND = "Mean wind, blowing toward"
    MOMENT = "Disturbance torque"
    THRUST = "Thrust of the rotors"
    POSITION = "Position"
    VELOCITY = "Velocity"
    LINK = "Link"
    AUTOPILOT = "Autopilot"


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """Straight line behind the curves: a limit, a crossover or a bound. It never widens the axes."""

    label: str
    """Text beside it."""
    x: tuple[float, float] | None = None
    """Start and end [unit of the chart's x]; equal for a line upward, or a dot at `y`; `None` for the whole width."""
    y: float | None = None
    """Height [unit of the chart's y]; `None` for a line upward."""
    colour: int | None = None
    """Index in the palette; `None` is the colour of limits."""


def limit_marks(runs: Sequence[ReportRun], history: History, k: int) -> tuple[Mark, ...]:
    """Return the limits in chart `k` of a group of time histories, each once."""
    found: dict[Mark, None] = {}
    for run in runs:
        found.update(dict.fromkeys(_marks(run, history, k)))
    return tuple(found)


def _marks(run: ReportRun, history: History, k: int) -> Iterator[Mark]:
    if history in (History.COMMANDED_TORQUE, History.ACTUATOR_TORQUE):
        limit = run.vehicle.torque_limit[k]
        yield from (Mark(label=f"torque limit {limit:g}", y=sign * limit) for sign in (1.0, -1.0))
    if history is History.SATURATION:
        yield Mark(label="torque limit", y=1.0)
    marks = {History.ATTITUDE: _attitude_marks, History.COMMANDED_TORQUE: _torque_marks}.get(history)
    for required in run.scenario.require if marks else ():
        if marks and required.axis in (None, AXES[k]):
            yield from marks(run.scenario, required, k)


def _torque_marks(scenario: Scenario, required: Requirement, _: int) -> Iterator[Mark]:
    """Yield the peak of a torque's requirement [N*m], on both sides of 0."""
    if required.metric is Metric.TORQUE_PEAK and required.at_most is not None:
        window, label = _window(scenario, required), f"peak ≤ {required.at_most:g}"
        yield from (Mark(label=label, x=window, y=sign * required.at_most) for sign in (1.0, -1.0))


def _attitude_marks(scenario: Scenario, required: Requirement, axis: int) -> Iterator[Mark]:
    """Yield the peak or the band of an angle's requirement [deg], on both sides of the reference."""
    if required.metric is Metric.PEAK and required.at_most is not None:
        label, half = f"peak ≤ {required.at_most:g}", required.at_most
    elif required.within_deg is not None:
        label, half = f"{required.metric.value.split('_')[0]} within {required.within_deg:g}", required.within_deg
    else:
        return
    begin, end = _window(scenario, required)
    steps = [(-inf, 0.0), *((stamp * 1e-6, degrees(angles[axis])) for stamp, angles in scenario.references), (inf, 0.0)]
    for (from_s, angle), (to_s, _) in pairwise(steps):
        if max(begin, from_s) < min(end, to_s):
            span = (max(begin, from_s), min(end, to_s))
            yield from (Mark(label=label, x=span, y=angle + sign * half) for sign in (1.0, -1.0))


def _window(scenario: Scenario, required: Requirement) -> tuple[float, float]:
    return required.from_s, scenario.duration_s if required.to_s is None else required.to_s


def time_bands(runs: Sequence[ReportRun]) -> list[dict[str, Any]]:
    """Return what happens in the flights as bands for the page; those that not all scenarios share are named."""
    scenarios = list({run.scenario.name: run.scenario for run in runs}.values())
    spans = [timeline(scenario) for scenario in scenarios]
    bands = []
    for scenario, own in zip(scenarios, spans, strict=True):
        for span in own:
            shared = all(span in others for others in spans)
            if shared and scenario is not scenarios[0]:
                continue
            text = span.text if shared else f"{scenario.name}: {span.text}"
            bands.append({"from": span.from_s, "to": span.to_s, "kind": span.kind, "text": text})
    return bands
