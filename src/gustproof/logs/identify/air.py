"""Disturbance that explains what an identified model leaves of a flight: as a series, as Dryden turbulence, as wind.

References
----------
P. Whittle, The analysis of multiple stationary time series, Journal of the Royal Statistical Society B 15, 1953.
H. E. Rauch, F. Tung, C. T. Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA Journal 3, 1965.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.optimize import Bounds, minimize
from scipy.signal import lfilter, welch

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.waveforms import MAX_ROWS, Dryden
from firmware_model.errors import ConfigError
from firmware_model.physics.dryden import dryden_spectrum
from gustproof.logs.identify.filtered_command import filter_command
from gustproof.logs.identify.identification import Identification
from gustproof.logs.identify.stretches import SETTLING, find_stretches
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.types import Array

ALTITUDE_M = 10.0
"""[m] height of the air model, a scenario's default: a log of torques and rates does not show it."""
_SHORTEST_S = 5.0
_SEGMENT_S = 60.0  # of Welch's method: the air is slow
_BAND_HZ = 30.0  # above it vibration hides the air
_REPLAY_HZ = 50.0
_WORST_LAG_ERROR = 0.005  # [s]
_UNLIKE = 3.0  # airspeed over wind, or wind over airspeed
_SLOWEST, _FASTEST = 1.0, 500.0  # [m/s] airspeed of the search
_AT_BOUND = 1e-3  # relative
_TRUST = 0.7  # [-] standard deviation of the logarithms of airspeed over mean wind, and of the yaw ratio


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grid:
    """One airborne stretch at even times."""

    time: Array
    """(n,) [s]."""
    gyro: Array
    """(n, 3) [rad/s] mean of the samples about each instant; interpolated where there is none."""
    count: Array
    """(n,) number of samples about each instant."""
    drive: Array
    """(n, 3) [rad/s^2] acceleration by the command alone, after delay and lag."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IdentifiedAir:
    """Disturbance of one flight."""

    wind_speed_20ft: float
    """[m/s] mean wind at 20 ft whose turbulence gives the moments of roll and pitch on the vehicle."""
    airspeed: float
    """[m/s] speed at which the frozen field passes."""
    yaw_ratio: float | None
    """[-] `gust_yaw_ratio` of the vehicle, by the moment in yaw; `None` if yaw is not identified."""
    sigma: Array
    """(3,) [rad/s^2] rms of the turbulence's angular acceleration about each axis."""
    length: Array
    """(3,) [m] scale length of the gust behind each axis: across, along, vertical."""
    time: Array
    """(n,) [s] of the longest stretch, from the start of the log, evenly spaced."""
    acceleration: Array
    """(n, 3) [rad/s^2] smoothed disturbance without its mean; 0 about an axis that is not identified."""
    omega: Array
    """(f,) [rad/s] frequencies of the spectra."""
    measured: Array
    """(3, f) [(rad/s^2)^2/(rad/s)] one-sided density of what the model leaves, errors included."""
    fitted: Array
    """(3, f) likewise of the turbulence."""
    noise: Array
    """(3, f) likewise of errors: the gyro's noise, and the model's by its lag."""

    @property
    def doubt(self) -> str:
        """Line that says if the disturbance is unlike turbulence in the mean wind, else empty."""
        pace = self.airspeed / max(self.wind_speed_20ft, 1.0)
        if 1.0 < _UNLIKE * pace < _UNLIKE**2:
            return ""
        unlike = "quicker" if pace > 1.0 else "slower"
        return (
            f"the disturbance is {unlike} than turbulence: in {self.wind_speed_20ft:.2g} m/s of wind, gusts would pass "
            f"at {self.airspeed:.2g} m/s. It may be of motors, or of what the model lacks"
        )


def estimate_air(log: FlightLog, found: Identification, vehicle: Vehicle) -> IdentifiedAir:
    """Fit turbulence to a flight and smooth its disturbance, on the `vehicle` that is identified.

    The mean moment counts as trim, not as air.

    Raises
    ------
    ConfigError
        If neither roll nor pitch is identified, no stretch in the air is long enough, or no wind turns the vehicle. If
        the airspeed ends at a bound of its search.
    """
    log = filter_command(log)
    known = [k for k in range(3) if _force(log, found, k) is not None]
    if found.actuator_lag is None or not {0, 1} & set(known):
        raise ConfigError(f"{log.source}: neither roll nor pitch is identified: nothing tells the air")
    if vehicle.gust_gain == 0.0:
        raise ConfigError(f"vehicle '{vehicle.name}': gust_gain is 0: no wind gives it a moment")
    grids = make_grids(log, found)
    if not grids:
        raise ConfigError(f"{log.source}: no {_SHORTEST_S:g} s in the air without a gap: too short to tell the air")
    steps = [_step(0.0 if axis.damping is None else max(axis.damping.nominal, 0.0), found.dt) for axis in found.axes]
    spectra = _make_spectra(grids, steps, found)
    omega = spectra.omega
    wind, airspeed, yaw_ratio, errors = _fit(spectra, vehicle, known)
    _check_airspeed(log.source, wind, airspeed)
    wide = np.geomspace(1e-4, 1e4, 4000)
    density = turbulence_density(wide, vehicle, airspeed, yaw_ratio)
    variance = np.array([wind**2 * np.trapezoid(each, wide) for each in density])
    model = dryden_spectrum(_dryden(1.0, airspeed), ALTITUDE_M, vehicle.span)
    length = np.array([model.L_v, model.L_u, model.L_w])
    longest = max(grids, key=lambda each: len(each.time))
    smoothed = np.zeros((len(longest.time) - 1, 3))
    for k in known:
        prior = math.sqrt(variance[k]), math.exp(-found.dt * airspeed / float(length[k]))
        smoothed[:, k] = _smooth(longest, k, steps[k], prior, (_noise(found, k) * errors[0, k]) ** 2)
    return IdentifiedAir(
        wind_speed_20ft=wind,
        airspeed=airspeed,
        yaw_ratio=yaw_ratio if 2 in known else None,
        sigma=np.sqrt(variance),
        length=length,
        time=longest.time[:-1] - float(log.gyro.time[0]),
        acceleration=smoothed - smoothed.mean(axis=0),
        omega=omega,
        measured=spectra.measured,
        fitted=wind**2 * turbulence_density(omega, vehicle, airspeed, yaw_ratio),
        noise=spectra.errors(errors),
    )


def make_grids(log: FlightLog, found: Identification) -> list[Grid]:
    """Return the airborne stretches of a log that are long enough, with the sample time of its identification."""
    time, gyro = log.gyro.time, log.gyro.values
    command = log.motors if found.motor_gains is not None else log.command
    grids = []
    for begin, end in () if command is None else find_stretches(log, command):
        if end - begin < _SHORTEST_S:
            continue
        grid = np.asarray(begin + found.dt * np.arange(int((end - begin) / found.dt)), dtype=np.float64)
        cell = np.rint((time - begin) / found.dt)
        inside = (cell >= 0) & (cell < len(grid))
        index = cell[inside].astype(np.int64)
        count = np.bincount(index, minlength=len(grid)).astype(np.float64)
        seen = count > 0.0
        sums = [np.bincount(index, gyro[inside, k], minlength=len(grid)) for k in range(3)]
        mean = np.stack([np.interp(grid, grid[seen], each[seen] / count[seen]) for each in sums], axis=1)
        drive = np.stack([_drive(log, found, k, grid) for k in range(3)], axis=1)
        settled = slice(round(SETTLING / found.dt), None)
        grids.append(Grid(time=grid[settled], gyro=mean[settled], count=count[settled], drive=drive[settled]))
    return grids


def _check_airspeed(source: str, wind: float, airspeed: float) -> None:
    """Refuse an airspeed at a bound of its search, but for the least in little wind: gusts may then pass so slowly."""
    is_slow = wind >= _UNLIKE * _SLOWEST and airspeed / _SLOWEST < 1.0 + _AT_BOUND
    if is_slow or _FASTEST / airspeed < 1.0 + _AT_BOUND:
        said = f"its gusts' airspeed ends at a bound of the search, {airspeed:.3g} m/s, which is no estimate"
        raise ConfigError(f"{source}: its air is not told: {said}")


def turbulence_density(omega: Array, vehicle: Vehicle, airspeed: float, yaw_ratio: float) -> Array:
    """Return the density (3, f) [(rad/s^2)^2/(rad/s)] of the angular acceleration in turbulence of 1 m/s at 20 ft.

    The sum of moments of gusts by `gust_gain` and of angular gusts by damping, MIL-F-8785C, 3.7.1.2, one-sided.
    """
    s = dryden_spectrum(_dryden(1.0, airspeed), ALTITUDE_M, vehicle.span)
    along = _lag_density(omega, s.sigma_u, s.L_u / s.airspeed)
    across, vertical = (
        _lag_density(omega, sigma, tau) * (1.0 + 3.0 * (omega * tau) ** 2) / (2.0 * (1.0 + (omega * tau) ** 2))
        for sigma, tau in ((s.sigma_v, s.L_v / s.airspeed), (s.sigma_w, s.L_w / s.airspeed))
    )
    lag = 4.0 * vehicle.span / (math.pi * s.airspeed)  # [s] of p and q; r has three quarters of it
    slope = (omega / s.airspeed) ** 2
    turning = (
        _lag_density(omega, s.sigma_p, lag),
        vertical * slope / (1.0 + (lag * omega) ** 2),
        across * slope / (1.0 + (0.75 * lag * omega) ** 2),
    )
    gain = vehicle.gust_gain / np.array(vehicle.inertia_B) * (1.0, 1.0, yaw_ratio)
    gusts = np.array([across, along, vertical])
    damping = np.array(vehicle.rate_damping_B)
    return np.asarray(gain[:, None] ** 2 * gusts + damping[:, None] ** 2 * np.array(turning))


def replay_text(air: IdentifiedAir, vehicle: Vehicle) -> str:
    """Return a CSV of the gusts [m/s] B that give the disturbance on the vehicle, for a scenario's `replay`."""
    count = len(air.time)
    size = max(round(count / float(np.ptp(air.time)) / _REPLAY_HZ), 1, -(-count // MAX_ROWS))
    rows = count // size
    time, acceleration = (
        np.reshape(each[: rows * size], (rows, size, -1)).mean(axis=1) for each in (air.time, air.acceleration)
    )
    roll, pitch, yaw = (acceleration * vehicle.inertia_B).T / vehicle.gust_gain
    w = yaw / vehicle.gust_yaw_ratio if vehicle.gust_yaw_ratio else np.zeros(rows)
    lines = (",".join(f"{value:.6g}" for value in row) for row in zip(time[:, 0], -pitch, roll, w, strict=True))
    return "\n".join(("time_s,u_mps,v_mps,w_mps", *lines, ""))


def turbulence_scenario(name: str, air: IdentifiedAir, found: Identification) -> Scenario:
    """Return the scenario of a flight's turbulence and delay: those of the log's command beyond one sample."""
    scenario = Scenario(
        name=name,
        description=f"turbulence of {found.source}, as gustproof identify fits it",
        duration_s=60.0,
        wind=(_dryden(air.wind_speed_20ft, air.airspeed),),
    )
    late = 0.0 if found.delay is None else found.delay.nominal
    return replace(scenario, delay_samples=min(1 + round(late / scenario.dt), 50))


def _dryden(wind_speed_20ft: float, airspeed: float) -> Dryden:
    return Dryden(kind="dryden", wind_speed_20ft_mps=wind_speed_20ft, airspeed_mps=airspeed)


def _lag_density(omega: Array, sigma: float, tau: float) -> Array:
    """Return the one-sided density of noise of rms `sigma` behind a lag of `tau` [s]."""
    return 2.0 * tau / math.pi * sigma**2 / (1.0 + (omega * tau) ** 2)


def _force(log: FlightLog, found: Identification, k: int) -> tuple[LogSignal, Array, int] | None:
    """Return commands (n, m), gains (m,) [rad/s^2] and the power of a command, `None` for an axis not identified."""
    gain = found.axes[k].gain
    if gain is None:
        return None
    if found.motor_gains is not None and log.motors is not None:
        return log.motors, found.motor_gains[k], 2
    return None if log.command is None else (log.command, gain.nominal * np.eye(3)[k], 1)


def _drive(log: FlightLog, found: Identification, k: int, grid: Array) -> Array:
    """Return the acceleration (n,) [rad/s^2] by the command, of the mean over the step that begins at each instant."""
    force = _force(log, found, k)
    if force is None or found.actuator_lag is None:
        return np.zeros(len(grid))
    command, gains, power = force
    late = 0.0 if found.delay is None else found.delay.nominal
    held = command.values[np.maximum(np.searchsorted(command.time, grid - late + 1e-9, side="right") - 1, 0)]
    lag = found.actuator_lag.nominal
    kept = math.exp(-found.dt / lag)
    v, _ = lfilter([0.0, 1.0 - kept], [1.0, -kept], held, axis=0, zi=held[:1] * kept)
    return np.asarray((held + (v - held) * lag / found.dt * (1.0 - kept)) ** power @ gains)


def _step(damping: float, dt: float) -> tuple[float, float]:
    """Return `a` and `b` of `omega+ = a omega + b m`, exact for an acceleration m that is held."""
    a = math.exp(-damping * dt)
    return a, (1.0 - a) / damping if damping else dt


def _leftover(grid: Grid, k: int, step: tuple[float, float]) -> Array:
    """Return the acceleration (n - 1,) that the command leaves unexplained, with the gyro's noise differentiated."""
    a, b = step
    y = grid.gyro[:, k]
    return np.asarray((y[1:] - a * y[:-1]) / b - grid.drive[:-1, k])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Spectra:
    """One-sided densities (3, f) [(rad/s^2)^2/(rad/s)]."""

    omega: Array
    """(f,) [rad/s]."""
    measured: Array
    """(3, f) of what the model leaves."""
    noise: Array
    """(3, f) of the gyro's noise as it is stated."""
    slope: Array
    """(3, f) of the commanded acceleration's derivative: what an error of lag or delay leaves, per s^2."""

    def errors(self, sizes: Array) -> Array:
        """Return the density of errors of `sizes` (2, 3): factor on the gyro's noise, and error of the lag [s]."""
        return np.asarray(sizes[0][:, None] ** 2 * self.noise + sizes[1][:, None] ** 2 * self.slope)


def _noise(found: Identification, k: int) -> float:
    return max(found.axes[k].noise or 0.0, 1e-7)


def _make_spectra(grids: Sequence[Grid], steps: Sequence[tuple[float, float]], found: Identification) -> _Spectra:
    """Return the spectra of all stretches, by Welch's method."""
    dt = found.dt
    size = min(round(_SEGMENT_S / dt), max(len(each.time) for each in grids) - 1)
    used = [each for each in grids if len(each.time) > size]
    total = np.zeros((6, size // 2 + 1))
    for each in used:
        leftover = np.array([_leftover(each, k, steps[k]) for k in range(3)])
        frequency, density = welch(np.vstack([leftover, each.drive[:-1].T]), fs=1.0 / dt, nperseg=size)
        total += density * len(each.time) / math.tau
    kept = (frequency > 0.0) & (frequency < min(_BAND_HZ, 0.4 / dt))
    omega = math.tau * frequency[kept]
    measured, drive = np.split(total[:, kept] / sum(len(each.time) for each in used), 2)
    # A gyro's error n appears as (n+ - a n) / b, see `_step`.
    shape = np.array([np.abs(np.exp(1j * omega * dt) - a) ** 2 / b**2 for a, b in steps])
    noise = np.array([[_noise(found, k) ** 2 / math.tau] for k in range(3)]) * shape
    return _Spectra(omega=omega, measured=np.maximum(measured, 1e-20), noise=noise, slope=omega**2 * drive)


def _fit(spectra: _Spectra, vehicle: Vehicle, known: Sequence[int]) -> tuple[float, float, float, Array]:
    """Return wind [m/s], airspeed [m/s], yaw ratio and sizes of errors (2, 3): the most likely, by Whittle.

    A flight short beside the air's own time tells wind and airspeed by one product only. The rule for hover, that the
    field passes at the mean wind, then parts them: it is a prior here, as is the vehicle's yaw ratio.
    """
    omega, measured = spectra.omega, spectra.measured[known]

    def distance(x: Array) -> float:
        wind, airspeed, yaw_ratio = np.exp(x[:3])
        turbulence = wind**2 * turbulence_density(omega, vehicle, airspeed, yaw_ratio)
        density = (turbulence + spectra.errors(np.exp(x[3:]).reshape(2, 3)))[known]
        prior = (x[1] - max(x[0], 0.0)) ** 2 + (x[2] - math.log(ratio)) ** 2
        return float(np.sum(np.log(density) + measured / density) + 0.5 * prior / _TRUST**2)

    ratio = vehicle.gust_yaw_ratio or 0.3
    limits = [(1e-3, 1e3), (_SLOWEST, _FASTEST), (1e-3, 1e3), *[(0.3, 3.0)] * 3, *[(1e-6, _WORST_LAG_ERROR)] * 3]
    lowest, highest = np.log(limits).T
    found = []
    for airspeed in (3.0, 10.0, 30.0):
        unit, low = turbulence_density(omega, vehicle, airspeed, ratio)[known], omega < 10.0
        wind = math.sqrt(np.sum(measured[:, low]) / np.sum(unit[:, low]))
        start = np.clip(np.log([wind, airspeed, ratio, *[1.0] * 3, *[1e-3] * 3]), lowest, highest)
        found.append(minimize(distance, start, method="L-BFGS-B", bounds=Bounds(lowest, highest)))
    x = np.exp(min(found, key=lambda each: float(each.fun)).x)
    return float(x[0]), float(x[1]), float(x[2]), x[3:].reshape(2, 3)


def _smooth(grid: Grid, k: int, step: tuple[float, float], prior: tuple[float, float], noise_power: float) -> Array:
    """Return the most likely disturbance (n - 1,) [rad/s^2], that of a fixed-interval Kalman smoother.

    `prior` is its rms [rad/s^2] and its correlation from sample to sample, `noise_power` [(rad/s)^2/Hz] that of the
    gyro. The rates are the unknowns of one least-squares problem, whose normal equations have five diagonals.
    """
    (a, b), (sigma, kept) = step, prior
    count = len(grid.time)
    force = grid.drive[:-1, k] + _leftover(grid, k, step).mean()
    rows = np.tile([kept * a / b, -(a + kept) / b, 1.0 / b], (count - 1, 1))
    rows[0] = 0.0, -a / b, 1.0 / b
    target = force - kept * np.concatenate(([0.0], force[:-1]))
    scale = np.full(count - 1, 1.0 / (sigma * math.sqrt(1.0 - kept**2)))
    scale[0] = 1.0 / sigma
    rows, target = rows * scale[:, None], target * scale
    before, at, after = rows.T
    weight = grid.count * 2.0 * np.ptp(grid.time) / (noise_power * grid.count.sum())
    bands, right = np.zeros((3, count)), weight * grid.gyro[:, k]
    bands[2] = weight
    bands[2, :-1] += at**2
    bands[2, 1:] += after**2
    bands[2, :-2] += before[1:] ** 2
    bands[1, 1:] = at * after
    bands[1, 1:-1] += before[1:] * at[1:]
    bands[0, 2:] = before[1:] * after[1:]
    right[:-1] += at * target
    right[1:] += after * target
    right[:-2] += before[1:] * target[1:]
    rate = scipy.linalg.solveh_banded(bands, right)
    return np.asarray((rate[1:] - a * rate[:-1]) / b - force)
