"""Attitude errors of a real autopilot as it sees them itself, beside the true ones.

An autopilot steers its own estimate to its own set-point. So its loops are judged by the error that it sees, and its
estimator by the difference to the truth. A heading error of its compass stands in the true error as a mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_model.numerics.rotations import euler_angles
from firmware_model.types import Vector
from gustproof.types import Array, Records


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorView:
    """Root mean squares over the three axes, at the times at which the autopilot reported its attitude."""

    estimate_rmse_deg: float
    """[deg] estimated minus true attitude."""
    estimate_steady_deg: float
    """[deg] the same with each axis' mean removed."""
    control_rmse_deg: float
    """[deg] estimated attitude minus the autopilot's set-point: the error that its loops see."""
    true_control_rmse_deg: float
    """[deg] true attitude minus the autopilot's set-point."""
    true_control_steady_deg: float
    """[deg] the same with each axis' mean removed."""
    estimate_axes_deg: tuple[float, float, float]
    """[deg] root mean square of estimated minus true roll, pitch, yaw."""


def compare_estimates(records: Records, estimates: Records) -> EstimatorView | None:
    """Return the errors of `estimates` (m,) beside journal `records` (n,); `None` without two of them in the flight."""
    if not len(records):
        return None
    rows = np.searchsorted(records["time_us"], estimates["time_us"])
    inside = (rows < len(records)) & np.isfinite(estimates["setpoint_q_NB"]).all(axis=1)
    estimates, rows = estimates[inside], rows[inside]
    if len(rows) < 2:
        return None
    true, estimated, wanted = (
        euler_angles(q_NB) for q_NB in (records["q_NB"][rows], estimates["q_NB"], estimates["setpoint_q_NB"])
    )
    estimate, true_control = _differences(estimated, true), _differences(true, wanted)
    roll, pitch, yaw = np.degrees(np.sqrt(np.mean(estimate**2, axis=0))).tolist()
    return EstimatorView(
        estimate_rmse_deg=_rms(estimate),
        estimate_steady_deg=_rms(estimate - estimate.mean(axis=0)),
        control_rmse_deg=_rms(_differences(estimated, wanted)),
        true_control_rmse_deg=_rms(true_control),
        true_control_steady_deg=_rms(true_control - true_control.mean(axis=0)),
        estimate_axes_deg=(roll, pitch, yaw),
    )


def steady_rmse_deg(records: Records, references: Sequence[tuple[int, Vector]] = ()) -> float:
    """Return the rms [deg] of a flight's attitude error (n,), with each axis' mean removed.

    `references` are those of a scenario: stamp [us] of the first sample, and roll, pitch, yaw [rad].
    """
    wanted = np.zeros((len(records), 3))
    for time_us, euler in references:
        wanted[records["time_us"] >= time_us] = euler
    errors = _differences(euler_angles(records["q_NB"]), wanted)
    return _rms(errors - errors.mean(axis=0))


def _differences(a: Array, b: Array) -> Array:
    """Return the differences of angles (n, 3) [rad], each within half a turn."""
    return np.asarray((a - b + np.pi) % (2.0 * np.pi) - np.pi)


def _rms(angles: Array) -> float:
    return float(np.degrees(np.sqrt(np.mean(angles**2))))
