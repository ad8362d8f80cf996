"""Hold a log's numbers against each other: a wrong unit, or axes of another frame, contradict what else is logged."""

from collections.abc import Iterator, Mapping

import numpy as np

from firmware_model.types import AXES
from gustproof.logs.read.flight_log import LogSignal
from gustproof.types import Array

_WINDOW_S, _STEPS = 0.1, 4  # [s] and samples over which angles are compared: less is noise, and late stamps
_LEAST_RAD, _FEW = 0.01, 20  # rms of their changes, and number of windows, that tell something
_ALIKE, _FACTOR = 0.9, 1.5  # correlation, and ratio beyond which the unit, or the clock, is another one
_GRAVITY = (3.0, 30.0)  # [m/s^2] that an accelerometer shows in the median of a flight
_UP = 5.0  # [m/s^2] of its z axis in the median, beyond which that is up
_RATES_HZ = (1.0, 50_000.0)  # of a gyro's log
_MOST_RAD_S = 75.0  # beyond which one of a hundred samples of no gyro is
_OFTEN = 0.99


def check_units(signals: Mapping[str, LogSignal]) -> Iterator[str]:
    """Yield each contradiction between the signals of a log: a unit, a sign or a clock that can't be right."""
    gyro = signals["gyro"]
    rate = 1.0 / float(np.median(np.diff(gyro.time)))
    if not _RATES_HZ[0] <= rate <= _RATES_HZ[1]:
        yield f"gyro: {rate:.3g} samples a second: is time in another unit?"
    if "attitude" in signals:
        yield from _compare_attitude(gyro, signals["attitude"])
    if "accelerometer" in signals:
        yield from _check_gravity(signals["accelerometer"].values)


def check_rates(rates: Array) -> None:
    """Refuse rates [rad/s] (n, 3) many of which are beyond what a gyro shows: they are in another unit."""
    known = np.abs(rates[np.isfinite(rates).all(axis=1)])
    if len(known) and np.quantile(known, _OFTEN) > _MOST_RAD_S:
        raise ValueError("gyro: beyond 4,000 deg/s, and beyond any gyro: its unit is another one")


def _compare_attitude(gyro: LogSignal, attitude: LogSignal) -> Iterator[str]:
    """Yield how the turn by the gyro differs from that of the attitude, in factor or sign."""
    turns, angles = _turns(gyro, attitude)
    if len(turns) < _FEW:
        return
    power = np.sqrt(np.mean(turns**2, axis=0)), np.sqrt(np.mean(angles**2, axis=0))
    tells = (np.minimum(*power) > 0.0) & (np.maximum(*power) > _LEAST_RAD)
    alike = np.where(tells, np.mean(turns * angles, axis=0) / np.where(tells, power[0] * power[1], 1.0), 0.0)
    ratios = (power[0] / np.where(tells, power[1], 1.0))[np.abs(alike) > _ALIKE]
    if len(ratios) and not 1.0 / _FACTOR < (ratio := float(np.median(ratios))) < _FACTOR:
        yield f"gyro and attitude contradict: {ratio:.3g} times the rate of the angles, one unit is wrong, or time"
    if turned := [
        axis for axis, value in zip(AXES, np.where(power[1] > _LEAST_RAD, alike, 0.0), strict=True) if value < -_ALIKE
    ]:
        yield (
            f"gyro and attitude contradict: {' and '.join(turned)} of opposite sign, where axes are front, right, down"
        )


def _turns(gyro: LogSignal, attitude: LogSignal) -> tuple[Array, Array]:
    """Return the turn (n, 3) [rad] in short windows by the gyro and by the attitude, about the body's axes."""
    time = attitude.time
    step = max(float(np.median(np.diff(time))), float(np.median(np.diff(gyro.time)))) * _STEPS
    ends = np.arange(time[0], time[-1], max(_WINDOW_S, step))
    places = np.unique(np.searchsorted(time, ends))
    time, angles = time[places], attitude.values[places]
    summed = np.cumsum(gyro.values[1:] * np.diff(gyro.time)[:, np.newaxis], axis=0)
    summed = np.concatenate([np.zeros((1, 3)), summed])
    turns = np.diff(np.column_stack([np.interp(time, gyro.time, axis) for axis in summed.T]), axis=0)
    change = np.remainder(np.diff(angles, axis=0) + np.pi, 2.0 * np.pi) - np.pi
    phi, theta = (angles[:-1] + 0.5 * change)[:, :2].T
    dphi, dtheta, dpsi = change.T
    body = np.column_stack(
        [
            dphi - np.sin(theta) * dpsi,
            np.cos(phi) * dtheta + np.sin(phi) * np.cos(theta) * dpsi,
            np.cos(phi) * np.cos(theta) * dpsi - np.sin(phi) * dtheta,
        ]
    )
    size = np.abs(body).max(axis=1)
    usual = (np.diff(time) < 3.0 * max(_WINDOW_S, step)) & (size <= np.quantile(size, _OFTEN) if len(size) else True)
    return turns[usual], body[usual]


def _check_gravity(values: Array) -> Iterator[str]:
    """Yield what a specific force (n, 3) [m/s^2] shows of its unit and its frame."""
    force, down = float(np.median(np.linalg.norm(values, axis=1))), float(np.median(values[:, 2]))
    if force > 0.0 and not _GRAVITY[0] < force < _GRAVITY[1]:
        yield f"accelerometer: {force:.3g} m/s^2 in the median: its unit is another one"
    elif down > _UP:
        yield "accelerometer: its z axis is up in the median, where axes are front, right, down"
