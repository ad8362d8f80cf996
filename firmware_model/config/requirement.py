"""Requirements on a flight, `[[require]]`: each a metric over a time window, with its limits.

Attitude counts as its error: Euler angle minus the reference at that time. A requirement fails if its window was not
flown to the end.
"""

from enum import Enum
from typing import Literal, Self

from pydantic import model_validator

from firmware_model.config.fields import Duration, Finite, Positive, Time, strict_dataclass

Axis = Literal["roll", "pitch", "yaw"]


class Metric(Enum):
    """Metric of a flight; the value is its name among the flight's figures, with the unit."""

    PEAK = "peak_deg"
    """[deg] largest magnitude of the error."""
    RMSE = "rmse_deg"
    """[deg] root mean square of the error."""
    SETTLING = "settling_s"
    """[s] from the start of the window until the error stays within `within_deg`; infinite if it never does."""
    OVERSHOOT = "overshoot_percent"
    """[%] excess of the angle over the new reference, relative to the reference's step in the window."""
    RECOVERY = "recovery_s"
    """[s] from the first exit of the error from `within_deg` until it stays inside; infinite if it never does."""
    TORQUE_RMS = "torque_rms_nm"
    """[N*m] root mean square of the commanded torque."""
    TORQUE_PEAK = "torque_peak_nm"
    """[N*m] largest magnitude of the commanded torque."""
    TORQUE_SLEW = "torque_slew_rms"
    """[N*m/s] rms of the commanded torque's change from sample to sample, divided by the sample time."""
    SATURATED = "saturated_s"
    """[s] total time with a commanded torque at the vehicle's limit."""
    RHO = "rho_share"
    """[-] largest share that the scheduling vector uses of its range from hover to the bounds of Table II."""
    DRIFT = "drift_m"
    """[m] largest distance from the position at the start of the window."""


BAND_METRICS = frozenset({Metric.SETTLING, Metric.RECOVERY})
"""Metrics that need a band."""
AXISLESS_METRICS = frozenset({Metric.RHO, Metric.DRIFT})
"""Metrics without an axis."""


@strict_dataclass
class Requirement:
    """Metric and its limits."""

    metric: Metric
    """Metric."""
    axis: Axis | None = None
    """Axis of the metric; all three together by default."""
    from_s: Time = 0.0
    """[s] start of the window."""
    to_s: Duration | None = None
    """[s] end of the window; the end of the flight by default."""
    within_deg: Positive | None = None
    """[deg] half width of the band of settling and recovery."""
    at_most: Finite | None = None
    """[unit of the metric] upper limit."""
    at_least: Finite | None = None
    """[unit of the metric] lower limit."""

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
            raise ValueError("within_deg: settling_s and recovery_s need it, other metrics must not have it")
        if self.axis is not None and self.metric in AXISLESS_METRICS:
            raise ValueError(f"axis: {self.metric.value} has no axis")
        if self.axis is None and self.metric is Metric.OVERSHOOT:
            raise ValueError("axis: overshoot_percent needs an axis: roll, pitch or yaw")
        return self
