"""Phases of a flight: what happens in part of a scenario cuts it, and names what follows.

Windows are those of requirements: samples from a time on, up to the next. Phases of one name are measured as one.
"""

import math
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.timeline import Span, timeline
from firmware_model.config.vehicle import Vehicle
from gustproof.flight.scoring.estimator_view import attitude_errors
from gustproof.flight.scoring.metrics import command_limit
from gustproof.types import Array, Records

BEFORE = "before"
"""Name of the phase in which nothing has happened yet."""
_FEWEST = 2  # samples of a window: a change of torque takes two


class FlightPhase(NamedTuple):
    """Part of a flight."""

    name: str
    """Name: all that begins or lasts in it, in the words of the report's bands, or all that ended."""
    windows: tuple[tuple[float, float], ...]
    """[s] start and end of each of its parts, by time."""

    @property
    def duration_s(self) -> float:
        """[s] of all its parts."""
        return sum(end - begin for begin, end in self.windows)


class PhaseFigures(NamedTuple):
    """Figures of a phase, over all three axes."""

    rmse_deg: float
    """[deg] rms of the true attitude error, with the median of each axis over the whole flight removed."""
    peak_deg: float
    """[deg] largest magnitude of that error."""
    torque_slew_rms: float
    """[N*m/s] rms of the commanded torque's change from sample to sample, over the sample time."""
    saturated_s: float
    """[s] time with a commanded torque at the vehicle's limit on any axis."""


def find_phases(scenario: Scenario) -> tuple[FlightPhase, ...]:
    """Return the phases of a scenario by their first time; none if nothing happens in part of it.

    A phase begins where something begins or ends. It is named by all that begins there or still lasts, or else by what
    ended. Of a window shorter than two samples nothing is told.

    Examples
    --------
    >>> from gustproof import load_scenario
    >>> for phase in find_phases(load_scenario("gust-roll")):
    ...     print(phase.windows, phase.name)
    ((0.0, 2.0),) before
    ((2.0, 2.6),) gust to the right 8 m/s, one minus cosine
    ((2.6, 10.0),) after gust to the right 8 m/s, one minus cosine
    """
    spans = timeline(scenario)
    ends = {time for span in spans for time in (span.from_s, span.to_s) if 0.0 < time < scenario.duration_s}
    times = [0.0, *sorted(ends), scenario.duration_s]
    found: dict[str, list[tuple[float, float]]] = {}
    for begin, end in pairwise(times):
        if scenario.sample_at(end) - scenario.sample_at(begin) >= _FEWEST:
            found.setdefault(_name(spans, begin), []).append((begin, end))
    return tuple(FlightPhase(name, tuple(windows)) for name, windows in found.items()) if len(found) > 1 else ()


def _name(spans: Sequence[Span], begin: float) -> str:
    """Return the name of the phase that begins at a time [s]."""
    if acting := [each for each in spans if each.from_s == begin or each.from_s < begin < each.to_s]:
        return _join(acting)
    ended = [each for each in spans if each.to_s == begin]
    return f"after {_join(ended)}" if ended else BEFORE


def _join(spans: Sequence[Span]) -> str:
    """Return the names of spans as one, that of several with their number."""
    counted = Counter(each.text for each in spans)
    return " and ".join(text if count == 1 else f"{count} times {text}" for text, count in counted.items())


def measure_phases(
    records: Records,
    scenario: Scenario,
    vehicle: Vehicle,
    phases: Sequence[FlightPhase],
    until_s: float = math.inf,
    *,
    law: object = None,
) -> tuple[PhaseFigures | None, ...]:
    """Return the figures of each phase in a flight's journal `records` (n,); `None` if it was not flown to its end.

    The `law` may have limits of its own. What was flown `until_s` [s] counts alone: the time at which a flight failed.
    An axis' median is what the heading error of an autopilot's compass leaves throughout; a mean would carry a large
    gust into the calm before it.
    """
    flown = len(records) if math.isinf(until_s) else min(len(records), scenario.sample_at(until_s))
    records = records[:flown]
    errors = np.degrees(attitude_errors(records, scenario.references))
    errors -= np.median(errors, axis=0) if flown else 0.0
    torque = np.asarray(records["torque_command_B"])
    slew = np.diff(torque, axis=0) / scenario.dt
    saturated = (np.abs(torque) >= command_limit(vehicle, law)).any(axis=1)
    windows = [[(scenario.sample_at(begin), scenario.sample_at(end)) for begin, end in each.windows] for each in phases]
    return tuple(
        _measure(each, errors, slew, float(scenario.dt * _pick(saturated, each).sum()))
        if each[-1][1] <= flown
        else None
        for each in windows
    )


def _measure(windows: Sequence[tuple[int, int]], errors: Array, slew: Array, saturated_s: float) -> PhaseFigures:
    inside = _pick(errors, windows)
    changes = _pick(slew, [(begin, end - 1) for begin, end in windows])
    return PhaseFigures(
        math.sqrt(float(np.mean(inside**2))),
        float(np.max(np.abs(inside))),
        math.sqrt(float(np.mean(changes**2))),
        saturated_s,
    )


def _pick(values: Array, windows: Sequence[tuple[int, int]]) -> Array:
    return np.concatenate([values[begin:end] for begin, end in windows])
