"""Results of a flight's requirements, with their margins."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.numerics.compiled import compiled, kernel
from firmware_model.numerics.soa import Lane, get_vector, single
from firmware_model.recording.journal import POSITION, record_blocks
from firmware_model.types import AXES
from gustproof.flight.scoring.metrics import TALLY_SIZE, Tally, as_rows, command_limit, maximum, tally_kernel
from gustproof.law.references import references
from gustproof.robust.shown import Shown
from gustproof.types import Array, Records

_LABELS = {
    Metric.PEAK: ("peak", "deg"),
    Metric.RMSE: ("RMSE", "deg"),
    Metric.SETTLING: ("settling", "s"),
    Metric.OVERSHOOT: ("overshoot", "%"),
    Metric.RECOVERY: ("recovery", "s"),
    Metric.TORQUE_RMS: ("torque rms", "N m"),
    Metric.TORQUE_PEAK: ("torque peak", "N m"),
    Metric.TORQUE_SLEW: ("torque slew rms", "N m/s"),
    Metric.SATURATED: ("torque saturated", "s"),
    Metric.RHO: ("envelope used", "-"),
    Metric.DRIFT: ("drift", "m"),
}
"""Name and unit of each metric."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class RequirementResult(Shown):
    """Result of one requirement.

    Examples
    --------
    >>> from gustproof import fly_direct, judge, load_law, load_scenario, load_vehicle
    >>> vehicle, scenario = load_vehicle("paper"), load_scenario("gust-roll")
    >>> results = judge(fly_direct(scenario, load_law("flagship"), vehicle=vehicle), scenario, vehicle)
    >>> all(result.margin >= 0.0 for result in results)
    True
    """

    requirement: Requirement
    """Metric, window and limits."""
    value: float
    """[unit of the metric] measured value; NaN if the window was not flown to its end."""
    judged: bool
    """True if the window was flown to its end."""

    @property
    def margin(self) -> float:
        """[unit of the metric] distance from the value to the nearer limit; negative beyond it, NaN if the value is."""
        limits = self.requirement
        below = math.inf if limits.at_most is None else limits.at_most - self.value
        above = math.inf if limits.at_least is None else self.value - limits.at_least
        return math.nan if math.isnan(self.value) else min(below, above)

    @property
    def is_met(self) -> bool:
        """True if the value is between the limits."""
        return self.margin >= 0.0

    def lines(self) -> list[str]:
        """Return value, limits and result."""
        limits, result = requirement_limits(self.requirement), "met" if self.is_met else "NOT met"
        return [f"{requirement_label(self.requirement)} {self.value:.3g}, {limits}: {result}"]

    def to_dict(self) -> dict[str, Any]:
        """Return the result as JSON; NaN and infinite numbers become null."""
        figures = {"value": self.value, "margin": self.margin}
        finite = {name: figure if math.isfinite(figure) else None for name, figure in figures.items()}
        return {**to_jsonable_python(self.requirement), **finite, "judged": self.judged, "held": self.is_met}


# A rule states a requirement's measurement: metric; first axis and one after the last; first sample and one after the
# last; half the band's width [deg] (NaN without one); reference before the window and at its end [deg].
_KIND, _AXIS, _AXES_END, _FROM, _UNTIL, _WITHIN, _BEFORE, _AFTER, _RULE_SIZE = range(9)
_METRICS = tuple(Metric)
_PEAK, _RMSE, _SETTLING = map(_METRICS.index, (Metric.PEAK, Metric.RMSE, Metric.SETTLING))
_OVERSHOOT, _RECOVERY, _SATURATED = map(_METRICS.index, (Metric.OVERSHOOT, Metric.RECOVERY, Metric.SATURATED))
_TORQUE_RMS, _TORQUE_PEAK, _SLEW = map(_METRICS.index, (Metric.TORQUE_RMS, Metric.TORQUE_PEAK, Metric.TORQUE_SLEW))
_RHO, _DRIFT = map(_METRICS.index, (Metric.RHO, Metric.DRIFT))
_ROLL, _L, _SLEW_L, _SHARE = (Tally._fields.index(name) for name in ("roll", "L", "slew_L", "share"))

# A reading is a measurement so far: a sum or an extreme; first and last sample that counted, or -1; position at the
# start of the window [m] N.
READING_SIZE = 6
"""Numbers in a reading."""
_FIRST, _LAST, _ORIGIN = 1, 2, 3


def requirement_label(requirement: Requirement) -> str:
    """Return the name of a requirement's measurement, with unit, axis and band."""
    return f"{requirement_name(requirement)} [{requirement_unit(requirement)}]"


def requirement_name(requirement: Requirement) -> str:
    """Return the name of a requirement's measurement, with axis and band."""
    axis = "" if requirement.axis is None else f", {requirement.axis}"
    band = "" if requirement.within_deg is None else f" within {requirement.within_deg:g} deg"
    if requirement.metric is Metric.RECOVERY:
        return f"{requirement.axis or 'attitude'} back{band}"
    return f"{_LABELS[requirement.metric][0]}{axis}{band}"


def requirement_unit(requirement: Requirement) -> str:
    """Return the unit of a requirement's measurement."""
    return _LABELS[requirement.metric][1]


def requirement_window(requirement: Requirement) -> str:
    """Return the window [s] of a requirement as text."""
    return f"{requirement.from_s:g} .. {'end' if requirement.to_s is None else f'{requirement.to_s:g}'}"


def requirement_limits(requirement: Requirement) -> str:
    """Return the limits of a requirement as text."""
    limits = (("≥", requirement.at_least), ("≤", requirement.at_most))
    return " ".join(f"{sign} {limit:g}" for sign, limit in limits if limit is not None)


def judge(
    records: Records, scenario: Scenario, vehicle: Vehicle, *, law: object = None
) -> tuple[RequirementResult, ...]:
    """Return the result of each requirement of `scenario` in a flight's journal `records` (n,), flown by `law`.

    Examples
    --------
    >>> from gustproof import fly_direct, judge, load_law, load_scenario, load_vehicle
    >>> vehicle, scenario = load_vehicle("paper"), load_scenario("gust-roll")
    >>> for result in judge(fly_direct(scenario, load_law("flagship"), vehicle=vehicle), scenario, vehicle):
    ...     print(result.requirement.metric.value, round(result.margin, 2))
    peak_deg 0.61
    recovery_s 1.09
    saturated_s 0.0
    """
    readings, limit, tally = initial_readings(scenario, 1), command_limit(vehicle, law), np.zeros(TALLY_SIZE)
    stated, done = rules(scenario), 0
    for block in record_blocks(records[: scenario.samples]):
        reference = references(scenario, done, done + len(block))
        _read(as_rows(block), done, stated, limit, reference, scenario.dt, tally, readings)
        done += len(block)
    (results,) = results_from_readings(scenario, readings, len(records))
    return results


def rules(scenario: Scenario) -> Array:
    """Return the rules (n, 8) of a scenario's requirements."""
    return np.array([_rule(scenario, requirement) for requirement in scenario.require]).reshape(-1, _RULE_SIZE)


def reads_share(scenario: Scenario) -> bool:
    """Return whether a requirement reads the used share of the envelope from later than the first sample on."""
    return any(
        requirement.metric is Metric.RHO and scenario.window(requirement)[0] > 0 for requirement in scenario.require
    )


def initial_readings(scenario: Scenario, width: int) -> Array:
    """Return the initial readings (n, READING_SIZE, width) of a scenario, a column for each flight."""
    reading = np.array([[0.0], [-1.0], [-1.0], [0.0], [0.0], [0.0]])
    return np.tile(reading, (len(scenario.require), 1, width))


def results_from_readings(scenario: Scenario, readings: Array, samples: int) -> Iterator[tuple[RequirementResult, ...]]:
    """Yield the results of each flight after `samples` samples, from the readings (n, READING_SIZE, width)."""
    windows = [scenario.window(requirement) for requirement in scenario.require]
    flown, dt = [end <= samples for _, end in windows], scenario.dt
    values = np.full((len(windows), readings.shape[2]), np.nan)
    for row, requirement, window, whole, reading in zip(
        values, scenario.require, windows, flown, readings, strict=True
    ):
        if whole:
            row[:] = _values(requirement, window, reading, dt)
    for flight in values.T.tolist():
        yield tuple(
            RequirementResult(requirement=requirement, value=value, judged=whole)
            for requirement, value, whole in zip(scenario.require, flight, flown, strict=True)
        )


def verdict(result: RequirementResult) -> tuple[str, str]:
    """Return a result in a word or two, and its colour."""
    if not result.judged:
        return "not judged", "yellow"
    return ("held", "green") if result.is_met else ("FAILED", "red")


def _rule(scenario: Scenario, requirement: Requirement) -> tuple[float, ...]:
    begin, end = scenario.window(requirement)
    low, high = _axes(requirement)
    before, after = scenario.reference_at(begin - 1), scenario.reference_at(end - 1)
    within = math.nan if requirement.within_deg is None else requirement.within_deg
    metric = _METRICS.index(requirement.metric)
    return metric, low, high, begin, end, within, math.degrees(before[low]), math.degrees(after[low])


def _axes(requirement: Requirement) -> tuple[int, int]:
    axis = None if requirement.axis is None else AXES.index(requirement.axis)
    return (0, 3) if axis is None else (axis, axis + 1)


def _values(requirement: Requirement, window: tuple[int, int], reading: Array, dt: float) -> Array:
    """Return the values (width,) [unit of the metric] of flights in a `window` [samples] that was flown to its end."""
    (begin, end), (low, high) = window, _axes(requirement)
    value: Array = reading[0]
    first: Array = reading[_FIRST]
    last: Array = reading[_LAST]
    match requirement.metric:
        case Metric.RMSE | Metric.TORQUE_RMS:
            return np.sqrt(value / ((end - begin) * (high - low)))
        case Metric.TORQUE_SLEW:
            return np.sqrt(value / ((end - begin - 1) * (high - low)))
        case Metric.SETTLING | Metric.RECOVERY:
            since = begin if requirement.metric is Metric.SETTLING else first
            lasted = np.where(last == end - 1, np.inf, (last + 1.0 - since) * dt)
            return np.where(last < 0.0, 0.0, lasted)
        case Metric.OVERSHOOT:
            return 100.0 * value
        case Metric.SATURATED:
            return value * dt
    return value


@compiled
def _read(
    rows: Array, first: int, rules: Array, limit: Array, reference: Array, dt: float, tally: Array, readings: Array
) -> None:
    tallies, limits = tally.reshape(TALLY_SIZE, 1), limit.reshape(3, 1)
    for k in range(rows.shape[0]):
        tally_kernel(single(tally), first + k, single(limit), single(rows[k]), dt)
        read_kernel(rules, readings, first + k, reference[k], tallies, rows[k], limits)


@kernel
def read_kernel(
    rules: Array, readings: Array, sample: int, reference: Array, tallies: Array, records: Array, limits: Array
) -> None:
    """Update the readings (n, READING_SIZE, width) of all flights with a sample.

    Each flight has its tally (TALLY_SIZE, width), record, flat, and torque limits (3, width) [N*m]. Rules and the
    reference (3,) [rad] are common to all flights, so branches stand outside of the loops over flights.
    """
    for i in range(rules.shape[0]):
        metric = int(rules[i, _KIND])
        if not rules[i, _FROM] <= sample < rules[i, _UNTIL]:
            continue
        if metric == _OVERSHOOT:
            _read_overshoot(rules, i, readings, tallies)
        elif metric == _RHO:
            for w in range(tallies.shape[1]):
                readings[i, 0, w] = maximum(readings[i, 0, w], tallies[_SHARE, w])
        elif metric == _SATURATED:
            _read_saturated(rules, i, readings, tallies, limits)
        elif metric == _DRIFT:
            _read_drift(readings, i, records, sample == rules[i, _FROM])
        else:
            for axis in range(int(rules[i, _AXIS]), int(rules[i, _AXES_END])):
                _read_axis(metric, rules, i, readings, sample, axis, math.degrees(reference[axis]), tallies)


@kernel
def _read_axis(
    metric: int, rules: Array, i: int, readings: Array, sample: int, axis: int, reference: float, tallies: Array
) -> None:
    angle, torque, slew = np.uint64(_ROLL + axis), np.uint64(_L + axis), np.uint64(_SLEW_L + axis)
    width = tallies.shape[1]
    if metric == _PEAK:
        for w in range(width):
            readings[i, 0, w] = maximum(readings[i, 0, w], abs(tallies[angle, w] - reference))
    elif metric == _RMSE:
        for w in range(width):
            readings[i, 0, w] += (tallies[angle, w] - reference) * (tallies[angle, w] - reference)
    elif metric == _TORQUE_PEAK:
        for w in range(width):
            readings[i, 0, w] = maximum(readings[i, 0, w], abs(tallies[torque, w]))
    elif metric == _TORQUE_RMS:
        for w in range(width):
            readings[i, 0, w] += tallies[torque, w] * tallies[torque, w]
    elif metric == _SLEW and sample > rules[i, _FROM]:
        for w in range(width):
            readings[i, 0, w] += tallies[slew, w] * tallies[slew, w]
    elif metric in (_SETTLING, _RECOVERY):
        within, now = rules[i, _WITHIN], float(sample)
        for w in range(width):
            outside, first = abs(tallies[angle, w] - reference) > within, readings[i, _FIRST, w]
            readings[i, _FIRST, w] = now if outside & (first < 0.0) else first
            readings[i, _LAST, w] = now if outside else readings[i, _LAST, w]


@kernel
def _read_saturated(rules: Array, i: int, readings: Array, tallies: Array, limits: Array) -> None:
    """Count a sample once if the torque is at its limit on any axis."""
    a, c = np.uint64(rules[i, _AXIS]), np.uint64(rules[i, _AXES_END] - 1.0)
    b = np.uint64(0.5 * (rules[i, _AXIS] + rules[i, _AXES_END] - 1.0))
    at, bt, ct = np.uint64(_L) + a, np.uint64(_L) + b, np.uint64(_L) + c
    for w in range(tallies.shape[1]):
        counts = (
            (abs(tallies[at, w]) >= limits[a, w])
            | (abs(tallies[bt, w]) >= limits[b, w])
            | (abs(tallies[ct, w]) >= limits[c, w])
        )
        readings[i, 0, w] += 1.0 if counts else 0.0


@kernel
def _read_overshoot(rules: Array, i: int, readings: Array, tallies: Array) -> None:
    before, after, angle = rules[i, _BEFORE], rules[i, _AFTER], np.uint64(_ROLL + rules[i, _AXIS])
    for w in range(tallies.shape[1]):
        readings[i, 0, w] = maximum(readings[i, 0, w], (tallies[angle, w] - after) / (after - before))


@kernel
def _read_drift(readings: Array, i: int, records: Array, begins: bool) -> None:
    width = readings.shape[2]
    for w in range(width):
        position = get_vector(Lane(records, width, w), POSITION)
        if begins:
            for axis in range(3):
                readings[i, _ORIGIN + axis, w] = position[axis]
        north, east = position[0] - readings[i, _ORIGIN, w], position[1] - readings[i, _ORIGIN + 1, w]
        down = position[2] - readings[i, _ORIGIN + 2, w]
        drift = math.sqrt(north * north + east * east + down * down)
        readings[i, 0, w] = maximum(readings[i, 0, w], drift)
