"""Whether a flight kept what its scenario requires, and by what margin."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from firmware_model.requirement import AXES, Metric, Requirement
from firmware_model.scenario import Scenario
from firmware_model.vehicle import Vehicle
from gustproof.metrics import Records, attitude
from gustproof.model.lpv import scheduling, share_of_bounds

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


class _Window(NamedTuple):
    """What was flown in a window, along one axis or all."""

    error: Array
    """(n, axes) [deg] Euler angles less their references."""
    reference: Array
    """(n + 1, axes) [deg] from the sample before the window on; level before the flight."""
    records: Records
    """(n,) of the journal."""
    torque: Array
    """(n, axes) [N*m] B, commanded."""
    limit: Array
    """(axes,) [N*m] B, of the actuators."""
    dt: float
    """[s] from sample to sample."""
    within: float
    """[deg] half the band's width; NaN without one."""


def judge(records: Records, scenario: Scenario, vehicle: Vehicle) -> tuple[RequirementResult, ...]:
    """Return what became of each requirement of `scenario` in a flight, (n,) of `firmware_model.journal.RECORD`."""
    if not len(records):
        return tuple(RequirementResult(requirement=requirement, value=math.nan) for requirement in scenario.require)
    reference = np.degrees([scenario.reference_at(sample) for sample in range(-1, len(records))])
    error = np.degrees(attitude(records)) - reference[1:]
    return tuple(
        RequirementResult(
            requirement=requirement, value=_measured(requirement, records, error, reference, scenario, vehicle)
        )
        for requirement in scenario.require
    )


def _measured(
    requirement: Requirement, records: Records, error: Array, reference: Array, scenario: Scenario, vehicle: Vehicle
) -> float:
    begin, end = scenario.window(requirement)
    if end > len(records):
        return math.nan
    axes = slice(None) if requirement.axis is None else [AXES.index(requirement.axis)]
    window = _Window(
        error=error[begin:end, axes],
        reference=reference[begin : end + 1, axes],
        records=records[begin:end],
        torque=records["torque_command_B"][begin:end, axes],
        limit=np.array(vehicle.torque_limit)[axes],
        dt=scenario.dt,
        within=math.nan if requirement.within_deg is None else requirement.within_deg,
    )
    return float(_MEASURES[requirement.metric](window))


def _settling(window: _Window) -> float:
    outside = _outside(window)
    return 0.0 if not len(outside) else _until_back(window, 0, int(outside[-1]))


def _recovery(window: _Window) -> float:
    outside = _outside(window)
    return 0.0 if not len(outside) else _until_back(window, int(outside[0]), int(outside[-1]))


def _outside(window: _Window) -> NDArray[np.intp]:
    return np.flatnonzero(np.any(np.abs(window.error) > window.within, axis=1))


def _until_back(window: _Window, begin: int, last_outside: int) -> float:
    """Return the time [s] from a sample to the first after all that are outside; infinite if the window has none."""
    return math.inf if last_outside == len(window.error) - 1 else (last_outside + 1 - begin) * window.dt


def _overshoot(window: _Window) -> float:
    before, after = window.reference[0, 0], window.reference[-1, 0]
    beyond = (window.error[:, 0] + window.reference[1:, 0] - after) / (after - before)
    return 100.0 * max(float(np.max(beyond)), 0.0)


def _slew(window: _Window) -> float:
    return _rms(np.diff(window.torque, axis=0) / window.dt)


def _saturated(window: _Window) -> float:
    return float(np.count_nonzero(np.any(np.abs(window.torque) >= window.limit, axis=1)) * window.dt)


def _rho_share(window: _Window) -> float:
    return share_of_bounds(scheduling(attitude(window.records), window.records["omega_B"]))


def _drift(window: _Window) -> float:
    position = window.records["position_N"]
    return float(np.max(np.linalg.norm(position - position[0], axis=1)))


def _peak(values: Array) -> float:
    return float(np.max(np.abs(values)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


_MEASURES: dict[Metric, Callable[[_Window], float]] = {
    Metric.PEAK: lambda window: _peak(window.error),
    Metric.RMSE: lambda window: _rms(window.error),
    Metric.SETTLING: _settling,
    Metric.OVERSHOOT: _overshoot,
    Metric.RECOVERY: _recovery,
    Metric.TORQUE_RMS: lambda window: _rms(window.torque),
    Metric.TORQUE_PEAK: lambda window: _peak(window.torque),
    Metric.TORQUE_SLEW: _slew,
    Metric.SATURATED: _saturated,
    Metric.RHO: _rho_share,
    Metric.DRIFT: _drift,
}


def requirement_label(requirement: Requirement) -> str:
    """Return what is measured, with its unit, axis and band."""
    label, unit = _LABELS[requirement.metric]
    axis = "" if requirement.axis is None else f", {requirement.axis}"
    band = "" if requirement.within_deg is None else f" within {requirement.within_deg:g} deg"
    return f"{label}{axis}{band} [{unit}]"


def requirement_limits(requirement: Requirement) -> str:
    """Return between which limits it must lie."""
    told = (("≥", requirement.at_least), ("≤", requirement.at_most))
    return " ".join(f"{sign} {limit:g}" for sign, limit in told if limit is not None)
