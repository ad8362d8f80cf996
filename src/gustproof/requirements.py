"""Whether a flight kept what its scenario requires, and by what margin."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from firmware_model.compiled import compiled, kernel
from firmware_model.journal import POSITION
from firmware_model.requirement import AXES, Metric, Requirement
from firmware_model.rows import Column, alone, get, get_vector, put, put_vector
from firmware_model.scenario import Scenario
from firmware_model.vehicle import Vehicle
from gustproof.closed_loop import references
from gustproof.metrics import TALLY, Records, Tally, as_rows, largest, tally_kernel

Array = NDArray[np.float64]
_LABELS = {
    Metric.PEAK: ("peak", "deg"),
    Metric.RMSE: ("RMSE", "deg"),
    Metric.SETTLING: ("settling", "s"),
    Metric.OVERSHOOT: ("overshoot", "%"),
    Metric.RECOVERY: ("recovery", "s"),
    Metric.TORQUE_RMS: ("torque rms", "N m"),
    Metric.TORQUE_PEAK: ("torque peak", "N m"),
    Metric.TORQUE_SLEW: ("torque slew rms", "N m/s"),
    Metric.SATURATED: ("at a torque limit", "s"),
    Metric.RHO: ("ρ, share of Table II", "-"),
    Metric.DRIFT: ("drift", "m"),
}
"""What a metric is called, and its unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RequirementResult:
    """What became of one requirement."""

    requirement: Requirement
    """What had to hold."""
    value: float
    """[unit of the metric] what was flown; NaN if the window was not flown to its end."""

    @property
    def margin(self) -> float:
        """[unit of the metric] from the value to the nearer limit; negative beyond it, NaN with the value."""
        limits = self.requirement
        below = math.inf if limits.at_most is None else limits.at_most - self.value
        above = math.inf if limits.at_least is None else self.value - limits.at_least
        return math.nan if math.isnan(self.value) else min(below, above)

    @property
    def held(self) -> bool:
        """Whether the value is between the limits."""
        return self.margin >= 0.0

    def document(self) -> dict[str, Any]:
        """Return the result as JSON has it; what is not a number, or without bound, is null."""
        figures = {"value": self.value, "margin": self.margin}
        told = {name: figure if math.isfinite(figure) else None for name, figure in figures.items()}
        return {**to_jsonable_python(self.requirement), **told, "held": self.held}


# A rule says what a requirement measures: metric, first axis and the one after the last, first sample and the one after
# the last, half the band's width [deg] (NaN without one), reference before the window and at its end [deg].
_RULE = 8
_METRICS = tuple(Metric)
_PEAK, _RMSE, _SETTLING, _OVERSHOOT, _RECOVERY = (
    _METRICS.index(metric) for metric in (Metric.PEAK, Metric.RMSE, Metric.SETTLING, Metric.OVERSHOOT, Metric.RECOVERY)
)
_TORQUE_RMS, _TORQUE_PEAK, _SLEW, _SATURATED, _RHO, _DRIFT = (
    _METRICS.index(metric)
    for metric in (
        Metric.TORQUE_RMS, Metric.TORQUE_PEAK, Metric.TORQUE_SLEW, Metric.SATURATED, Metric.RHO, Metric.DRIFT
    )
)  # fmt: skip
_ROLL, _L, _SLEW_L, _SHARE = (Tally._fields.index(name) for name in ("roll", "L", "slew_L", "share"))

# A reading is what has been measured so far: a sum or an extreme, first and last sample that counted or -1, and where
# the vehicle was at the window's begin [m] N.
READING = 6
"""Numbers in a reading."""
_FIRST, _LAST, _BEGAN = 1, 2, 3


def requirement_label(requirement: Requirement) -> str:
    """Return what is measured, with its unit, axis and band."""
    label, unit = _LABELS[requirement.metric]
    axis = "" if requirement.axis is None else f", {requirement.axis}"
    band = "" if requirement.within_deg is None else f" within {requirement.within_deg:g} deg"
    return f"{label}{axis}{band} [{unit}]"


def requirement_window(requirement: Requirement) -> str:
    """Return from when to when [s] it must hold."""
    return f"{requirement.from_s:g} .. {'end' if requirement.to_s is None else f'{requirement.to_s:g}'}"


def requirement_limits(requirement: Requirement) -> str:
    """Return between which limits it must lie."""
    told = (("≥", requirement.at_least), ("≤", requirement.at_most))
    return " ".join(f"{sign} {limit:g}" for sign, limit in told if limit is not None)


def judge(records: Records, scenario: Scenario, vehicle: Vehicle) -> tuple[RequirementResult, ...]:
    """Return what became of each requirement of `scenario` in a flight, (n,) of `firmware_model.journal.RECORD`."""
    readings, limit = no_readings(scenario, 1), np.array(vehicle.torque_limit)
    _read(
        as_rows(records[: scenario.samples]),
        rules(scenario),
        limit,
        np.degrees(references(scenario)),
        scenario.dt,
        readings,
    )
    return judged(scenario, readings, len(records))


def rules(scenario: Scenario) -> Array:
    """Return the rules (n, 8) of a scenario's requirements."""
    return np.array([_rule(scenario, requirement) for requirement in scenario.require]).reshape(-1, _RULE)


def no_readings(scenario: Scenario, width: int) -> Array:
    """Return readings (n, READING * width), each a column of its flight, before a flight of a scenario begins."""
    reading = np.array([0.0, -1.0, -1.0, 0.0, 0.0, 0.0])
    return np.tile(np.repeat(reading, width), (len(scenario.require), 1))


def judged(scenario: Scenario, readings: Array, samples: int) -> tuple[RequirementResult, ...]:
    """Return what became of each requirement in a flight of so many samples, from its readings (n, READING)."""
    return tuple(
        RequirementResult(requirement=requirement, value=_value(scenario, requirement, reading, samples))
        for requirement, reading in zip(scenario.require, readings.tolist(), strict=True)
    )


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


def _value(scenario: Scenario, requirement: Requirement, reading: list[float], samples: int) -> float:
    """Return what was flown [unit of the metric]; NaN if the window was not flown to its end."""
    (begin, end), (low, high) = scenario.window(requirement), _axes(requirement)
    value, first, last = reading[0], reading[_FIRST], reading[_LAST]
    if end > samples:
        return math.nan
    match requirement.metric:
        case Metric.RMSE | Metric.TORQUE_RMS:
            return math.sqrt(value / ((end - begin) * (high - low)))
        case Metric.TORQUE_SLEW:
            return math.sqrt(value / ((end - begin - 1) * (high - low)))
        case Metric.SETTLING | Metric.RECOVERY if last < 0.0:
            return 0.0
        case Metric.SETTLING | Metric.RECOVERY if last == end - 1:
            return math.inf
        case Metric.SETTLING:
            return (last + 1.0 - begin) * scenario.dt
        case Metric.RECOVERY:
            return (last + 1.0 - first) * scenario.dt
        case Metric.OVERSHOOT:
            return 100.0 * value
        case Metric.SATURATED:
            return value * scenario.dt
    return value


@compiled
def _read(rows: Array, rules: Array, limit: Array, reference: Array, dt: float, readings: Array) -> None:
    tally = np.zeros(TALLY)
    for k in range(rows.shape[0]):
        tally_kernel(alone(tally), k == 0, alone(limit), alone(rows[k]), dt)
        read_kernel(rules, readings, k, reference[k], tally, rows[k], limit, 1)


@kernel
def read_kernel(rules: Array, readings: Array, sample: int, reference: Array, tallies: Array, records: Array,
                limits: Array, width: int) -> None:  # fmt: skip
    """Move all readings of `width` flights on by a sample: the reference (3,) [deg], tallies, records, torque limits.

    What a rule says is the same for all flights: branches stand outside of the loops over them.
    """
    for i in range(rules.shape[0]):
        rule, reading = rules[i], readings[i]
        metric = int(rule[0])
        if not rule[3] <= sample < rule[4]:
            continue
        if metric == _OVERSHOOT:
            _read_overshoot(rule, reading, tallies, width)
        elif metric == _RHO:
            for w in range(width):
                reading[w] = largest(reading[w], tallies[_SHARE * width + w])
        elif metric == _DRIFT:
            for w in range(width):
                _read_drift(Column(reading, width, w), Column(records, width, w), sample == rule[3])
        else:
            for axis in range(int(rule[1]), int(rule[2])):
                _read_axis(metric, rule, reading, sample, axis, reference[axis], tallies, limits, width)


@kernel
def _read_axis(metric: int, rule: Array, reading: Array, sample: int, axis: int, reference: float, tallies: Array,
               limits: Array, width: int) -> None:  # fmt: skip
    angle, torque = (_ROLL + axis) * width, (_L + axis) * width
    if metric == _PEAK:
        for w in range(width):
            reading[w] = largest(reading[w], abs(tallies[angle + w] - reference))
    elif metric == _RMSE:
        for w in range(width):
            reading[w] += (tallies[angle + w] - reference) * (tallies[angle + w] - reference)
    elif metric == _TORQUE_PEAK:
        for w in range(width):
            reading[w] = largest(reading[w], abs(tallies[torque + w]))
    elif metric == _TORQUE_RMS:
        for w in range(width):
            reading[w] += tallies[torque + w] * tallies[torque + w]
    elif metric == _SATURATED:
        for w in range(width):
            counts = (abs(tallies[torque + w]) >= limits[axis * width + w]) & (reading[_LAST * width + w] != sample)
            reading[w] += 1.0 if counts else 0.0
            _note(reading, counts, sample, width, w)
    elif metric == _SLEW and sample > rule[3]:
        for w in range(width):
            slew = tallies[(_SLEW_L + axis) * width + w]
            reading[w] += slew * slew
    elif metric in (_SETTLING, _RECOVERY):
        for w in range(width):
            _note(reading, abs(tallies[angle + w] - reference) > rule[5], sample, width, w)


@kernel
def _read_overshoot(rule: Array, reading: Array, tallies: Array, width: int) -> None:
    before, after = rule[6], rule[7]
    for w in range(width):
        angle = tallies[(_ROLL + int(rule[1])) * width + w]
        reading[w] = largest(reading[w], (angle - after) / (after - before))


@kernel
def _note(reading: Array, counts: bool, sample: int, width: int, w: int) -> None:
    first, last = reading[_FIRST * width + w], reading[_LAST * width + w]
    reading[_FIRST * width + w] = sample if counts & (first < 0.0) else first
    reading[_LAST * width + w] = sample if counts else last


@kernel
def _read_drift(reading: Column, record: Column, begins: bool) -> None:
    place = get_vector(record, POSITION)
    if begins:
        put_vector(reading, _BEGAN, place)
    began = get_vector(reading, _BEGAN)
    north, east, down = place[0] - began[0], place[1] - began[1], place[2] - began[2]
    put(reading, 0, largest(get(reading, 0), math.sqrt(north * north + east * east + down * down)))
