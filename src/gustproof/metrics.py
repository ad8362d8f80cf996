"""The one record of figures that every flight is judged by, and how it is measured."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_model.rotations import euler_angles
from firmware_model.scenario import Scenario
from firmware_model.vehicle import Vehicle
from gustproof.model.lpv import scheduling, within_bounds

Records = NDArray[np.void]
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Metrics:
    """Figures of one flight, or their medians over seeds; over the three axes at once unless one is named."""

    peak_deg: float
    """[deg] largest magnitude of the Euler angles."""
    rmse_deg: float
    """[deg] root mean square of the Euler angles; the reference is 0."""
    peak_roll_deg: float
    """[deg] largest magnitude of phi."""
    peak_pitch_deg: float
    """[deg] largest magnitude of theta."""
    peak_yaw_deg: float
    """[deg] largest magnitude of psi."""
    rmse_roll_deg: float
    """[deg] root mean square of phi."""
    rmse_pitch_deg: float
    """[deg] root mean square of theta."""
    rmse_yaw_deg: float
    """[deg] root mean square of psi."""
    torque_rms_nm: float
    """[N*m] root mean square of the commanded torque."""
    torque_peak_nm: float
    """[N*m] largest magnitude of the commanded torque."""
    torque_slew_rms: float
    """[N*m/s] rms of the commanded torque's difference from sample to sample over the sample time."""
    saturated_s: float
    """[s] time with a commanded torque at the vehicle's limit, on any axis."""
    rho_in_bounds: bool
    """Whether rho stayed inside Table II: rates within 1.5 rad/s, roll and pitch within 90 deg."""
    realtime_factor: float
    """[-] simulated time over wall time; the only figure that does not repeat."""


def measure(records: Records, vehicle: Vehicle, scenario: Scenario, realtime_factor: float) -> Metrics:
    """Return the figures of one flight from its journal `records`, (n,) of `firmware_model.journal.RECORD`.

    Raises
    ------
    ValueError
        If there are fewer than two records: a change from sample to sample needs both.
    """
    if len(records) < 2:
        raise ValueError(f"{len(records)} records, at least 2 are needed")
    euler = attitude(records)
    angles = np.degrees(euler)
    torque = records["torque_command_B"]
    slew = np.diff(torque, axis=0) / scenario.dt
    peak, rmse = np.max(np.abs(angles), axis=0), np.sqrt(np.mean(angles**2, axis=0))
    saturated = np.any(np.abs(torque) >= np.array(vehicle.torque_limit), axis=1)
    return Metrics(
        peak_deg=float(np.max(peak)),
        rmse_deg=_rms(angles),
        peak_roll_deg=float(peak[0]),
        peak_pitch_deg=float(peak[1]),
        peak_yaw_deg=float(peak[2]),
        rmse_roll_deg=float(rmse[0]),
        rmse_pitch_deg=float(rmse[1]),
        rmse_yaw_deg=float(rmse[2]),
        torque_rms_nm=_rms(torque),
        torque_peak_nm=float(np.max(np.abs(torque))),
        torque_slew_rms=_rms(slew),
        saturated_s=float(np.count_nonzero(saturated) * scenario.dt),
        rho_in_bounds=within_bounds(scheduling(euler, records["omega_B"])),
        realtime_factor=realtime_factor,
    )


def median_metrics(flights: Sequence[Metrics]) -> Metrics:
    """Return each figure's median over `flights`; rho is in bounds if it was in every one of them."""
    medians: dict[str, Any] = {
        field.name: median(getattr(flight, field.name) for flight in flights) for field in fields(Metrics)
    }
    return Metrics(**{**medians, "rho_in_bounds": all(flight.rho_in_bounds for flight in flights)})


def attitude(records: Records) -> Array:
    """Return phi, theta, psi (n, 3) [rad]; roll and yaw go on beyond pi, so that a turn counts as a turn."""
    return np.unwrap(euler_angles(records["q_NB"]), axis=0)


def peak_rate(records: Records) -> float:
    """Return the largest magnitude [rad/s] of p, q, r: what bounds on rho_5, rho_6, rho_7 limit."""
    return float(np.max(np.abs(records["omega_B"])))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
