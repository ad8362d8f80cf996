"""Attitude in real wind: fit on calm air and one wind speed, predict others, and compare with what was measured.

    python -P -m gustproof.guide.examples.real_wind FOLDER

The folder holds flights in a wind tunnel as CSV files, `VEHICLE_TRAJECTORY_CONTROLLER_CONDITION.csv`, such as those
of Neural-Fly (github.com/aerorobotics/neural-fly, `data/experiment`: personal and educational use). Columns are t [s],
q and q_sp: measured and commanded attitude as [x, y, z, w].

Each angle y answers its set-point u and the wind by A(q) y = B(q) u + e, with white e. All controllers share the
autopilot's attitude loop, so they share A and B. The variance of e is v_0 + k V^2 at a wind speed V: gusts grow with
the mean wind, as in MIL-F-8785C. Both numbers come from calm air and the weakest wind. At other speeds the set-points
of the flight are taken as given, and only they: the error of the angle, and its rate, are predicted.

References
----------
M. O'Connell and others, Neural-Fly enables rapid learning for agile flight in strong winds, Science Robotics 7, 2022.
"""

import csv
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfiltfilt

Array = NDArray[np.float64]
WIND = {"nowind": 0.0, "35wind": 4.2, "70wind": 8.5, "70p20sint": (8.5**2 + 0.5 * 2.4**2) ** 0.5, "100wind": 12.1}
"""[m/s] wind by condition, rms where it swings; its square is what counts."""
BANDS = {"all": (), "rate": (), ".1 to .5 Hz": (0.1, 0.5), ".5 to 2 Hz": (0.5, 2.0), "2 to 8 Hz": (2.0, 8.0)}
"""[Hz] bands of the error whose rms is compared; all of it, and its rate."""
AXES = ("roll", "pitch", "yaw")
_PAST, _DELAYED, _SETTLE = 10, 14, 100  # polynomials' lengths, samples left out at the start
_TRAINED = 2  # conditions that are fitted, the calmest
_BLOCK_S, _DRAWS = 5.0, 500


class WindTunnelFlight(NamedTuple):
    """One flight."""

    controller: str
    """Name of the position controller."""
    wind: float
    """[m/s]."""
    dt: float
    """[s] between samples."""
    angles: Array
    """(n, 3) [rad] roll, pitch and yaw about their means."""
    asked: Array
    """(n, 3) [rad] their set-points about their means."""


class Comparison(NamedTuple):
    """Error of one angle in one flight."""

    flight: WindTunnelFlight
    """The flight."""
    axis: int
    """0 roll, 1 pitch, 2 yaw."""
    band: str
    """Name of a band."""
    predicted: float
    """[rad] rms, of the rate [rad/s]."""
    measured: float
    """[rad] rms, of the rate [rad/s]."""
    interval: tuple[float, float]
    """[rad], or [rad/s], 95 % of the measured one, from blocks of the flight."""


def load_flights(folder: Path) -> list[WindTunnelFlight]:
    """Return the flights of a folder; files without all columns are left out, and named."""
    found = list[WindTunnelFlight]()
    for path in sorted(folder.glob("*_*_*_*.csv")):
        _, _, controller, condition = path.stem.split("_", 3)
        try:
            with path.open(newline="") as file:
                rows = list(csv.DictReader(file))
            time = np.array([float(row["t"]) for row in rows])
            angles, asked = (_angles(np.array([json.loads(row[name]) for row in rows])) for name in ("q", "q_sp"))
            wind = WIND[condition]
        except (KeyError, TypeError, ValueError):
            sys.stderr.write(f"{path.name}: left out: not of this form\n")
            continue
        dt = float(np.median(np.diff(time)))
        found.append(WindTunnelFlight(controller, wind, dt, angles - angles.mean(0), asked - asked.mean(0)))
    return found


def compare(flights: Sequence[WindTunnelFlight]) -> list[Comparison]:
    """Return predicted and measured errors of all flights in winds that were not fitted."""
    winds = sorted({flight.wind for flight in flights})
    trained = [flight for flight in flights if flight.wind in winds[:_TRAINED]]
    found = list[Comparison]()
    for axis in range(3):
        A, B = _fit(trained, axis)
        v_0, v_1 = (_noise([f for f in trained if f.wind == wind], axis, A, B) for wind in winds[:_TRAINED])
        growth = max(v_1 - v_0, 0.0) / winds[1] ** 2
        kernel = lfilter([1.0], A, np.eye(1, 3000)[0])  # from e to the angle
        for flight in flights:
            if flight.wind not in winds[:_TRAINED]:
                found += _compare(flight, axis, A, B, kernel * (v_0 + growth * flight.wind**2) ** 0.5)
    return found


def _compare(flight: WindTunnelFlight, axis: int, A: Array, B: Array, kernel: Array) -> Iterable[Comparison]:
    """Yield the comparison of each band; `kernel` [rad] is the answer of the angle to wind."""
    asked, angle = flight.asked[:, axis], flight.angles[:, axis]
    followed, error = lfilter(B, A, asked) - asked, angle - asked
    for name in BANDS:
        by_command, by_wind, flown = (
            _filter(x, name, flight.dt)[_SETTLE:] for x in (followed, np.pad(kernel, 3000), error)
        )
        predicted = float(np.sqrt(np.var(by_command) + np.sum(by_wind**2)))
        yield Comparison(flight, axis, name, predicted, float(np.std(flown)), _interval(flown, flight.dt))


def _fit(flights: Sequence[WindTunnelFlight], axis: int) -> tuple[Array, Array]:
    """Return A and B of least squares over all flights."""
    rows, values = zip(*(_regressors(flight, axis) for flight in flights), strict=True)
    theta = np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=None)[0]
    return np.concatenate([[1.0], -theta[:_PAST]]), theta[_PAST:]


def _noise(flights: Sequence[WindTunnelFlight], axis: int, A: Array, B: Array) -> float:
    """Return the variance of e [rad^2]."""
    theta = np.concatenate([-A[1:], B])
    return float(np.mean([np.mean((y - X @ theta) ** 2) for X, y in (_regressors(each, axis) for each in flights)]))


def _regressors(flight: WindTunnelFlight, axis: int) -> tuple[Array, Array]:
    """Return the regressors (n, k) of an angle, past values and set-points, and its values (n,)."""
    y, u = flight.angles[:, axis], flight.asked[:, axis]
    first = max(_PAST, _DELAYED - 1)
    past = [y[first - k : len(y) - k] for k in range(1, _PAST + 1)]
    return np.column_stack([*past, *(u[first - k : len(u) - k] for k in range(_DELAYED))]), y[first:]


def _filter(values: Array, name: str, dt: float) -> Array:
    """Return the part of an error in a band, or its rate."""
    if name == "rate":
        return np.asarray(np.gradient(values, dt))
    band = BANDS[name]
    return np.asarray(sosfiltfilt(butter(2, band, "band", fs=1.0 / dt, output="sos"), values)) if band else values


def _interval(values: Array, dt: float) -> tuple[float, float]:
    """Return the 95 % interval of an rms from blocks that are drawn again."""
    size = round(_BLOCK_S / dt)
    blocks = np.array([np.mean(values[at : at + size] ** 2) for at in range(0, len(values) - size + 1, size)])
    draws = np.random.default_rng(1).choice(blocks, (_DRAWS, len(blocks))).mean(axis=1)
    low, high = np.sqrt(np.quantile(draws, (0.025, 0.975)))
    return float(low), float(high)


def _angles(q: Array) -> Array:
    """Return roll, pitch and yaw [rad] (n, 3) of attitudes [x, y, z, w]."""
    x, y, z, w = q.T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.unwrap(np.column_stack([roll, pitch, yaw]), axis=0)


def main(folder: str) -> None:
    """Print the table of a folder's flights, and the median misses."""
    found = compare(load_flights(Path(folder)))
    for each in found:
        if each.band == "all":
            low, high, predicted, measured = np.degrees((*each.interval, each.predicted, each.measured))
            name = f"{each.flight.controller:9s} {each.flight.wind:5.1f} m/s {AXES[each.axis]:5s}"
            ends = f"({low:.2f} to {high:.2f}) deg {100.0 * (predicted / measured - 1.0):+5.0f} %"
            sys.stdout.write(f"{name} predicted {predicted:5.2f} measured {measured:5.2f} {ends}\n")
    for group in (lambda each: each.flight.controller), (lambda each: AXES[each.axis]), (lambda each: each.band):
        for name in dict.fromkeys(map(group, found)):
            misses = [abs(each.predicted / each.measured - 1.0) for each in found if group(each) == name]
            sys.stdout.write(f"{name}: median miss {100.0 * float(np.median(misses)):.0f} % of {len(misses)}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
