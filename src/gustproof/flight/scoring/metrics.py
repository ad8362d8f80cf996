"""The one record of figures of every flight, and its measurement."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.numerics.compiled import compiled, kernel
from firmware_model.numerics.elementary import sin_cos
from firmware_model.numerics.rotations import euler_angles, euler_sides, to_euler
from firmware_model.numerics.soa import Lane, get, get_vector, loader, put_vector, single, storer
from firmware_model.recording.journal import OMEGA, Q_NB, TORQUE_COMMAND, record_blocks
from firmware_model.types import Quaternion, Vector
from gustproof.airframe.lpv import RATE_BOUND
from gustproof.law.form import Law, Output
from gustproof.robust.shown import Shown
from gustproof.types import Array, Records

SETTLED_S = 2.0
"""[s] time by which the step at the start, from rest to full wind, has settled; a shorter flight has no such time."""
_ROUNDING = 1e-6
"""[-] of a command by float32, as messages carry it."""
_TWO_PI, _DEGREES = 2.0 * math.pi, 180.0 / math.pi


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Metrics(Shown):
    """Figures of one flight, or medians over seeds; over all three axes unless one is named.

    Examples
    --------
    >>> from gustproof import fly_direct, load_law, load_scenario, load_vehicle, measure
    >>> vehicle, scenario = load_vehicle("paper"), load_scenario("gust-roll")
    >>> figures = measure(fly_direct(scenario, load_law("hinf-d1"), vehicle=vehicle), vehicle, scenario)
    >>> figures.peak_roll_deg > figures.peak_pitch_deg
    True
    """

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
    peak_settled_deg: float
    """[deg] as `peak_deg`, from `SETTLED_S` on: a flight begins at rest in full wind, a step of the moment."""
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
    """[N*m/s] rms of the commanded torque's change from sample to sample over the sample time."""
    saturated_s: float
    """[s] time with a commanded torque at its limit on any axis: the vehicle's, or a smaller one of the law's own."""
    rho_in_bounds: bool
    """True if rho stayed inside the paper's Table II: rates within 1.5 rad/s, roll and pitch within 90 deg."""
    realtime_factor: float
    """[-] simulated time over wall time, the only figure that does not repeat; 0 if unknown."""

    def lines(self) -> list[str]:
        """Return the figures, three digits each."""
        roll, pitch, yaw = self.peak_roll_deg, self.peak_pitch_deg, self.peak_yaw_deg
        return [
            "figures of a flight",
            f"RMSE: {self.rmse_deg:.3g} deg"
            f" (roll {self.rmse_roll_deg:.3g}, pitch {self.rmse_pitch_deg:.3g}, yaw {self.rmse_yaw_deg:.3g})",
            f"peak: {self.peak_deg:.3g} deg (roll {roll:.3g}, pitch {pitch:.3g}, yaw {yaw:.3g})",
            f"torque: rms {self.torque_rms_nm:.3g} N m, peak {self.torque_peak_nm:.3g} N m, "
            f"slew rms {self.torque_slew_rms:.3g} N m/s, at a limit for {self.saturated_s:.3g} s",
        ]


_UNIT_ENDINGS = {"_deg": "deg", "_nm": "N m", "_slew_rms": "N m/s", "_s": "s"}
FIGURE_UNITS = {
    field.name: next((unit for ending, unit in _UNIT_ENDINGS.items() if field.name.endswith(ending)), "")
    for field in fields(Metrics)
}
"""Unit of each figure of `Metrics`; empty without one."""


class Tally(NamedTuple):
    """Running figures of a flight: the values at a sample, then sums and extremes so far."""

    phi: float  # [rad] as `to_euler` returns it
    theta: float
    psi: float
    phi_wraps: float  # [rad] full turns so far
    psi_wraps: float
    roll: float  # [deg] with full turns
    pitch: float
    yaw: float
    L: float  # [N*m] B, commanded
    M: float
    N: float
    slew_L: float  # [N*m/s] B, since the previous sample
    slew_M: float
    slew_N: float
    share: float  # [-] of the envelope of Table II, see `_share`
    peak_roll: float  # [deg]
    peak_pitch: float
    peak_yaw: float
    peak_settled: float  # [deg]
    square_roll: float  # [deg^2] sum
    square_pitch: float
    square_yaw: float
    peak_torque: float  # [N*m]
    square_torque: float  # [N^2*m^2] sum
    square_slew: float  # [N^2*m^2/s^2] sum
    saturated: float  # [samples]
    peak_share: float  # [-]


TALLY_SIZE, PEAK_SHARE = len(Tally._fields), Tally._fields.index("peak_share")
"""Numbers in a tally, and the place of one."""
load_tally, store_tally = loader(Tally), storer(Tally)


@kernel
def maximum(a: float, b: float) -> float:
    """Return the larger number; NaN if either is."""
    return a if a > b or a != a else b


@kernel
def _unwrap(turns: float, before: float, now: float) -> float:
    step = now - before
    return turns - _TWO_PI if step > 0.5 * _TWO_PI else (turns + _TWO_PI if step < -0.5 * _TWO_PI else turns)


@kernel
def angle_share(angle: float) -> float:
    """Return the used share of the envelope by roll or pitch [rad]: 0 at hover, 1 at the bound of Table II."""
    sine, cosine = sin_cos(angle)
    return maximum(abs(sine), 1.0 - cosine)


@kernel
def _share(roll: float, pitch: float, omega_B: Vector) -> float:
    """Return the used share of the envelope by roll, pitch and rates [rad/s], the largest of them."""
    return maximum(maximum(roll, pitch), _maximum_of((abs(omega_B[0]), abs(omega_B[1]), abs(omega_B[2]))) / RATE_BOUND)


@kernel
def _maximum_of(v: Vector) -> float:
    return maximum(maximum(v[0], v[1]), v[2])


@kernel
def _squared_norm(v: Vector) -> float:
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]


@kernel
def _update_tally(
    x: Tally, first: bool, settled: bool, limit: Vector, E: Vector, share: float, torque: Vector, dt: float
) -> Tally:
    """Return the tally after a sample of attitude [rad], used share, commanded torque [N*m] and its `limit`."""
    phi, theta, psi = E
    phi_wraps = 0.0 if first else _unwrap(x.phi_wraps, x.phi, phi)
    psi_wraps = 0.0 if first else _unwrap(x.psi_wraps, x.psi, psi)
    roll, pitch, yaw = _DEGREES * (phi + phi_wraps), _DEGREES * theta, _DEGREES * (psi + psi_wraps)
    size = (abs(torque[0]), abs(torque[1]), abs(torque[2]))
    rate = 0.0 if first else 1.0 / dt
    slew = rate * (torque[0] - x.L), rate * (torque[1] - x.M), rate * (torque[2] - x.N)
    largest = _maximum_of((abs(roll), abs(pitch), abs(yaw)))
    saturated = (size[0] >= limit[0]) | (size[1] >= limit[1]) | (size[2] >= limit[2])
    return Tally(
        phi, theta, psi, phi_wraps, psi_wraps, roll, pitch, yaw, torque[0], torque[1], torque[2],
        slew[0], slew[1], slew[2], share,
        maximum(x.peak_roll, abs(roll)), maximum(x.peak_pitch, abs(pitch)), maximum(x.peak_yaw, abs(yaw)),
        maximum(x.peak_settled, largest) if settled else x.peak_settled,
        x.square_roll + roll * roll, x.square_pitch + pitch * pitch, x.square_yaw + yaw * yaw,
        maximum(x.peak_torque, _maximum_of(size)),
        x.square_torque + _squared_norm(size), x.square_slew + _squared_norm(slew),
        x.saturated + (1.0 if saturated else 0.0), maximum(x.peak_share, share),
    )  # fmt: skip


@kernel
def tally_kernel(tally: Lane, sample: int, limit: Lane, record: Lane, dt: float) -> None:
    """Update a tally with the journal record of a sample; the first one begins anew."""
    phi, theta, psi = to_euler(_get_attitude(record))
    _tally_angles(tally, sample, limit, record, dt, (phi, theta, psi), (angle_share(phi), angle_share(theta)))


@kernel
def begin_tally(record: Lane, work: Lane) -> None:
    """Write six rows: what `arctan2` makes phi, theta, psi of.

    `end_tally` follows, and does the same as `tally_kernel` with them.
    """
    sines, cosines = euler_sides(_get_attitude(record))
    put_vector(work, 0, sines)
    put_vector(work, 3, cosines)


@kernel
def end_tally(tally: Lane, sample: int, limit: Lane, record: Lane, dt: float, work: Lane) -> None:
    """Update a tally; `work` holds phi, theta, psi, and the `angle_share` of the first two."""
    _tally_angles(tally, sample, limit, record, dt, get_vector(work, 0), (get(work, 3), get(work, 4)))


@kernel
def _tally_angles(
    tally: Lane, sample: int, limit: Lane, record: Lane, dt: float, E: Vector, shares: tuple[float, float]
) -> None:
    share, torque = _share(shares[0], shares[1], get_vector(record, OMEGA)), get_vector(record, TORQUE_COMMAND)
    x, settled = load_tally(tally, 0), (sample + 0.5) * dt > SETTLED_S
    store_tally(tally, 0, _update_tally(x, sample == 0, settled, get_vector(limit, 0), E, share, torque, dt))


@kernel
def _get_attitude(record: Lane) -> Quaternion:
    return get(record, Q_NB), get(record, Q_NB + 1), get(record, Q_NB + 2), get(record, Q_NB + 3)


@compiled
def _tally(rows: Array, first: int, limit: Array, dt: float, tally: Array) -> None:
    for k in range(rows.shape[0]):
        tally_kernel(single(tally), first + k, single(limit), single(rows[k]), dt)


def command_limit(vehicle: Vehicle, law: object) -> Array:
    """Return the torque (3,) [N*m] at which a command is at its limit, the vehicle's or a smaller one of the law's own.

    What is no law that commands torque has none of its own.
    """
    limit = np.array(vehicle.torque_limit)
    if not isinstance(law, Law) or law.output is not Output.TORQUE:
        return limit
    own = (1.0 - _ROUNDING) * law.limits
    return np.where(own < (1.0 - 2.0 * _ROUNDING) * limit, own, limit)


def measure(
    records: Records, vehicle: Vehicle, scenario: Scenario, realtime_factor: float = 0.0, *, law: object = None
) -> Metrics:
    """Return the figures of one flight from its journal `records` (n,).

    `realtime_factor` is kept as given: records do not tell it, nor the limits of the `law` in control.

    Raises
    ------
    ValueError
        If there are fewer than two records: a change from sample to sample needs two.

    Examples
    --------
    >>> from gustproof import fly_direct, load_law, load_scenario, load_vehicle, measure
    >>> vehicle, scenario = load_vehicle("paper"), load_scenario("gust-roll")
    >>> records = fly_direct(scenario, load_law("hinf-d1"), vehicle=vehicle)
    >>> f"{measure(records, vehicle, scenario).peak_deg:.1f} deg"
    '3.3 deg'
    """
    if len(records) < 2:
        raise ValueError(f"{len(records)} records, at least 2 are needed")
    tally, limit, done = np.zeros(TALLY_SIZE), command_limit(vehicle, law), 0
    for block in record_blocks(records):
        _tally(as_rows(block), done, limit, scenario.dt, tally)
        done += len(block)
    return metrics_from_tally(Tally._make(tally.tolist()), len(records), scenario.dt, realtime_factor)


def as_rows(records: Records) -> Array:
    """Return journal records (n,) as plain numbers (n, numbers), in the journal's order; a view where that can be.

    numpy copies records field by field, which takes half as long as to fly them.
    """
    rows = np.ascontiguousarray(records).view(np.float64).reshape(len(records), records.dtype.itemsize // 8)
    return np.require(rows, requirements="W")  # kernels are compiled for arrays that can be written


def metrics_from_tally(tally: Tally, samples: int, dt: float, realtime_factor: float) -> Metrics:
    """Return the figures of a flight of two or more samples, `dt` [s] apart, from its tally."""
    peak = _maximum_of((tally.peak_roll, tally.peak_pitch, tally.peak_yaw))
    squares = tally.square_roll + tally.square_pitch + tally.square_yaw
    return Metrics(
        peak_deg=peak,
        rmse_deg=math.sqrt(squares / (3 * samples)),
        peak_roll_deg=tally.peak_roll,
        peak_pitch_deg=tally.peak_pitch,
        peak_yaw_deg=tally.peak_yaw,
        peak_settled_deg=tally.peak_settled if samples * dt > SETTLED_S else peak,
        rmse_roll_deg=math.sqrt(tally.square_roll / samples),
        rmse_pitch_deg=math.sqrt(tally.square_pitch / samples),
        rmse_yaw_deg=math.sqrt(tally.square_yaw / samples),
        torque_rms_nm=math.sqrt(tally.square_torque / (3 * samples)),
        torque_peak_nm=tally.peak_torque,
        torque_slew_rms=math.sqrt(tally.square_slew / (3 * (samples - 1))),
        saturated_s=tally.saturated * dt,
        rho_in_bounds=tally.peak_share <= 1.0,
        realtime_factor=realtime_factor,
    )


def median_metrics(flights: Sequence[Metrics]) -> Metrics:
    """Return each figure's median over `flights`; rho is in bounds if it is in all of them.

    Examples
    --------
    >>> from gustproof import fly_direct, load_law, load_scenario, load_vehicle, measure, median_metrics
    >>> vehicle, scenario, law = load_vehicle("paper"), load_scenario("paper-turbulence"), load_law("hinf-d1")
    >>> flights = (fly_direct(scenario, law, vehicle=vehicle, seed=seed) for seed in (1, 2, 3))
    >>> figures = median_metrics([measure(records, vehicle, scenario) for records in flights])
    >>> f"{figures.rmse_deg:.2f} deg"
    '2.17 deg'
    """
    medians: dict[str, Any] = {
        field.name: median(getattr(flight, field.name) for flight in flights) for field in fields(Metrics)
    }
    return Metrics(**{**medians, "rho_in_bounds": all(flight.rho_in_bounds for flight in flights)})


def attitude(records: Records) -> Array:
    """Return phi, theta, psi (n, 3) [rad]; roll and yaw continue beyond pi, so full turns count."""
    return np.unwrap(euler_angles(records["q_NB"]), axis=0)


def peak_rate(records: Records) -> float:
    """Return the largest magnitude [rad/s] of p, q, r, to compare with the bounds of rho_5, rho_6, rho_7."""
    return float(np.max(np.abs(records["omega_B"])))
