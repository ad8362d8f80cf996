"""Errors of a real autopilot's attitude and wind as it sees them itself, beside the true ones.

An autopilot steers its own estimate to its own set-point. So its loops are judged by the error that it sees, and its
estimator by the difference to the truth. A heading error of its compass stands in the true error as a mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_model.numerics.rotations import euler_angles, rotate_rows
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
    wind: "WindView | None" = None
    """The wind that it estimates; `None` if it tells none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WindView:
    """Wind that an autopilot estimates, beside the true velocity of the air at the vehicle; level, blowing toward."""

    told_mps: tuple[float, float]
    """[m/s] mean estimate, north and east."""
    true_mps: tuple[float, float]
    """[m/s] mean of the true air at the same times, north and east."""
    rmse_mps: float
    """[m/s] root mean square of the length of the estimate minus the true air."""
    mean_error_mps: float
    """[m/s] length of the mean of the estimate minus the true air."""
    air_rms_mps: float
    """[m/s] root mean square of the length of the true air minus its mean: gusts that a slow estimate misses."""


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
        wind=_compare_winds(records[rows], estimates),
    )


def _compare_winds(records: Records, estimates: Records) -> WindView | None:
    """Return the errors of the winds that `estimates` (m,) tell beside `records` (m,) of the same times, if any."""
    told = np.isfinite(estimates["told_wind_N"][:, :2]).all(axis=1)
    if not told.any():
        return None
    records, wind = records[told], estimates["told_wind_N"][told, :2]
    air = (records["wind_N"] + rotate_rows(records["q_NB"], records["gust_B"]))[:, :2]
    error, gusts = wind - air, air - air.mean(axis=0)
    told_north, told_east = wind.mean(axis=0).tolist()
    north, east = air.mean(axis=0).tolist()
    return WindView(
        told_mps=(told_north, told_east),
        true_mps=(north, east),
        rmse_mps=_rms_length(error),
        mean_error_mps=float(np.linalg.norm(error.mean(axis=0))),
        air_rms_mps=_rms_length(gusts),
    )


def steady_rmse_deg(records: Records, references: Sequence[tuple[int, Vector]] = ()) -> float:
    """Return the rms [deg] of a flight's attitude error (n,), with each axis' mean removed.

    `references` are those of a scenario: stamp [us] of the first sample, and roll, pitch, yaw [rad].
    """
    errors = attitude_errors(records, references)
    return _rms(errors - errors.mean(axis=0))


def attitude_errors(records: Records, references: Sequence[tuple[int, Vector]] = ()) -> Array:
    """Return the true attitude minus the reference (n, 3) [rad], each within half a turn; arguments as above."""
    wanted = np.zeros((len(records), 3))
    for time_us, euler in references:
        wanted[records["time_us"] >= time_us] = euler
    return _differences(euler_angles(records["q_NB"]), wanted)


def _differences(a: Array, b: Array) -> Array:
    """Return the differences of angles (n, 3) [rad], each within half a turn."""
    return np.asarray((a - b + np.pi) % (2.0 * np.pi) - np.pi)


def _rms(angles: Array) -> float:
    return float(np.degrees(np.sqrt(np.mean(angles**2))))


def _rms_length(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
