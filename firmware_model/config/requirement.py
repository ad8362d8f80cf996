"""What must hold in a flight: the `[[require]]` tables, each a metric over a window of time, and its limits.

Attitude is counted as its error: Euler angle less the reference of that time. A window that was not flown to its end
holds nothing.
"""

from enum import Enum
from typing import Literal, Self, get_args

from pydantic import ConfigDict, model_validator
from pydantic.dataclasses import dataclass

from firmware_model.config.vehicle import Finite, NonNegative, Positive

Axis = Literal["roll", "pitch", "yaw"]
AXES = get_args(Axis)


class Metric(Enum):
    """What is measured; the names are those of the flight's figures, with their units."""

    PEAK = "peak_deg"
    """[deg] largest magnitude of the error."""
    RMSE = "rmse_deg"
    """[deg] root mean square of the error."""
    SETTLING = "settling_s"
    """[s] from the window's begin until the error is within `within_deg` for good; infinite if it never is."""
    OVERSHOOT = "overshoot_percent"
    """[%] of the reference's step in the window, how far the angle goes beyond the new reference."""
    RECOVERY = "recovery_s"
    """[s] from where the error leaves `within_deg` first until it is back for good; infinite if it never is."""
    TORQUE_RMS = "torque_rms_nm"
    """[N*m] root mean square of the commanded torque."""
    TORQUE_PEAK = "torque_peak_nm"
    """[N*m] largest magnitude of the commanded torque."""
    TORQUE_SLEW = "torque_slew_rms"
    """[N*m/s] rms of the commanded torque's difference from sample to sample over the sample time."""
    SATURATED = "saturated_s"
    """[s] time with a commanded torque at the vehicle's limit."""
    RHO = "rho_share"
    """[-] how much of the way from hover to its bounds in Table II the scheduling vector uses: inside up to 1."""
    DRIFT = "drift_m"
    """[m] largest distance from where the vehicle was at the window's begin."""


BAND_METRICS = frozenset({Metric.SETTLING, Metric.RECOVERY})
"""Metrics about a band."""
AXISLESS_METRICS = frozenset({Metric.RHO, Metric.DRIFT})
"""Metrics that are not of an axis."""


@dataclass(frozen=True, slots=True, kw_only=True, config=ConfigDict(extra="forbid"))
class Requirement:
    """One metric and between which limits it must be."""

    metric: Metric
    """What is measured."""
    axis: Axis | None = None
    """Of which axis alone; of all three at once by default."""
    from_s: NonNegative = 0.0
    """[s] begin of the window."""
    to_s: Positive | None = None
    """[s] end of the window; that of the flight by default."""
    within_deg: Positive | None = None
    """[deg] half the width of the band that settling and recovery are about."""
    at_most: Finite | None = None
    """[unit of the metric] limit from above."""
    at_least: Finite | None = None
    """[unit of the metric] limit from below."""

    @model_validator(mode="after")
    def _check_limits(self) -> Self:
        if self.at_most is None and self.at_least is None:
            raise ValueError("give at_most, at_least or both")
        if self.at_most is not None and self.at_least is not None and self.at_least > self.at_most:
            raise ValueError("at_least must not be above at_most")
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError("to_s must be later than from_s")
        return self

    @model_validator(mode="after")
    def _check_metric_keys(self) -> Self:
        if (self.within_deg is None) == (self.metric in BAND_METRICS):
            raise ValueError("within_deg: settling_s and recovery_s need it, the others have no use for it")
        if self.axis is not None and self.metric in AXISLESS_METRICS:
            raise ValueError(f"axis: {self.metric.value} is not of an axis")
        if self.axis is None and self.metric is Metric.OVERSHOOT:
            raise ValueError("axis: overshoot_percent is of one axis: roll, pitch or yaw")
        return self
