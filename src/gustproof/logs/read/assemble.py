"""Make a flight log of what a reader found in a file: one clock, plausible numbers, and what is wrong in words."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gustproof.logs.read.flight_log import CommandUnit, FlightLog, LogSignal
from gustproof.types import Array

SIGNALS = ("gyro", "command", "motors", "accelerometer", "attitude", "reference")
"""Signals of a `FlightLog`, by name."""
_LARGEST = {"gyro": 100.0, "command": 1e6, "motors": 1e3, "accelerometer": 2000.0, "attitude": 10.0, "reference": 10.0}
"""In the signal's unit; no instrument or set-point of a vehicle that flies is beyond it."""
_RESET_US, _PAUSE_US = -1e6, 600e6  # steps of a clock that was set anew
_WANTED_RATE = 100.0  # [Hz] below which the loop's lag can't be told from the sampling
_NEARLY = 0.8  # share of the highest rate
_GAP = 1.5  # share of the usual step
_CLIPPED = 3.0  # [rad/s] below the least range of a gyro, 250 deg/s
_NAMED = 8  # parameters in a line
_MOTORS_RUN = 0.25  # share of the flight's usual motor command
_SHORTEST_S = 0.5  # stretch in the air, and pause that ends one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Samples of one signal as the file has them; clock and numbers are not yet checked."""

    position: NDArray[np.int64]
    """(n,) place in the file, rising, on one scale for all signals."""
    time_us: Array
    """(n,) [us] stamps on the clock of the log."""
    values: Array
    """(n, k) in the unit of the signal in `FlightLog`."""

    def take(self, which: NDArray[np.bool_]) -> "Rows":
        """Return the m of n samples for which the mask `which` (n,) is true."""
        if which.all():
            return self
        return Rows(position=self.position[which], time_us=self.time_us[which], values=self.values[which])


@dataclass(slots=True, kw_only=True, eq=False)
class Draft:
    """All that a reader found in a file."""

    source: str
    """Name of the file."""
    system: str
    """Writer of the log."""
    rows: dict[str, Rows]
    """By name of the signal."""
    in_air: Rows | None = None
    """(n, 1) 1 from a sample on that is in the air, else 0; `None` if the log does not tell."""
    command_unit: CommandUnit = CommandUnit.NORMALISED
    """Unit of the command."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Parameters of the autopilot by name."""
    findings: list[str] = field(default_factory=list)
    """Shortcomings that the reader has seen, a line each."""


class LoggedParameters:
    """Parameters as they are logged: the last value counts."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self._changed: set[str] = set()

    def add(self, name: str, value: float) -> None:
        """Take a value; one that is not finite has no effect."""
        if math.isfinite(value):
            if self.values.get(name, value) != value:
                self._changed.add(name)
            self.values[name] = value

    def findings(self) -> list[str]:
        """Return a line if parameters have changed during the log."""
        names = sorted(self._changed)
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        return [f"parameters: changed in this log, the last value counts: {', '.join(names[:_NAMED])}{more}"] * bool(
            names
        )


def assemble(draft: Draft) -> FlightLog:
    """Return the log with all signals on one rising clock [s] from its start.

    A clock that was set anew splits the log; its longest piece by the gyro is kept. Samples that are not numbers, are
    beyond any instrument or repeat a stamp are left out. Each is told in `findings`.

    Raises
    ------
    ValueError
        If there is no gyro, or a vector has not three components.
    """
    findings = list(draft.findings)
    _check_shapes(draft.rows)
    begin, end = longest_piece(draft.rows["gyro"], findings)
    sound = {name: _sound(name, _cut(rows, begin, end), findings) for name, rows in draft.rows.items()}
    kept = {name: rows for name, rows in sound.items() if len(rows.time_us) > 1 and rows.values.size}
    if "gyro" not in kept:
        raise ValueError("no two gyro samples that can be used")
    start_us = float(min(rows.time_us[0] for rows in kept.values()))
    signals = {
        name: LogSignal(
            time=(rows.time_us - start_us) * 1e-6, values=np.ascontiguousarray(rows.values, dtype=np.float64)
        )
        for name, rows in kept.items()
    }
    findings += _shortcomings(signals)
    states = None if draft.in_air is None else _cut(draft.in_air, begin, end)
    return FlightLog(
        source=draft.source,
        system=draft.system,
        command_unit=draft.command_unit,
        airborne=_airborne(states, signals, start_us, findings),
        parameters=draft.parameters,
        findings=tuple(findings),
        **signals,
    )


def _check_shapes(signals: Mapping[str, Rows]) -> None:
    if "gyro" not in signals or len(signals["gyro"].time_us) == 0:
        raise ValueError("no gyro in it")
    for name, rows in signals.items():
        if name != "motors" and rows.values.shape[1] != 3:
            raise ValueError(f"{name} has {rows.values.shape[1]} components, must have 3")


def longest_piece(gyro: Rows, findings: list[str]) -> tuple[int, int]:
    """Return first and last place in the file of the longest piece without a reset of the clock."""
    finite = np.isfinite(gyro.time_us)
    time_us, position = gyro.time_us[finite], gyro.position[finite]
    if len(time_us) == 0:
        raise ValueError("no gyro with a time in it")
    steps = np.diff(time_us)
    cuts = np.flatnonzero((steps < _RESET_US) | (steps > _PAUSE_US)) + 1
    if len(cuts) == 0:
        return -(1 << 62), 1 << 62
    edges = np.concatenate(([0], cuts, [len(time_us)]))
    longest = int(np.argmax(np.diff(edges)))
    first, last = int(edges[longest]), int(edges[longest + 1]) - 1
    length_s = (time_us[last] - time_us[first]) * 1e-6
    findings.append(
        f"clock: set anew {len(cuts)} times; the longest piece is kept, {length_s:.1f} s with "
        f"{last - first + 1:,} of {len(time_us):,} gyro samples"
    )
    begin = int(position[first]) if first else -(1 << 62)
    return begin, int(position[last]) if last + 1 < len(time_us) else 1 << 62


def _cut(rows: Rows, begin: int, end: int) -> Rows:
    """Return the rows from place `begin` to `end`, both included."""
    return rows.take((rows.position >= begin) & (rows.position <= end))


def _sound(name: str, rows: Rows, findings: list[str]) -> Rows:
    """Return the rows that are plausible, with rising stamps."""
    largest = np.abs(rows.values).max(axis=1, initial=0.0)
    usable = np.isfinite(rows.time_us) & (largest <= _LARGEST[name])  # NaN compares false
    absurd = len(usable) - int(np.count_nonzero(usable))
    if absurd:
        findings.append(f"{name}: {absurd:,} of {len(usable):,} samples are no plausible numbers: left out")
    rows = rows.take(usable)
    latest = np.maximum.accumulate(np.concatenate(([-np.inf], rows.time_us)))[:-1]
    rising = rows.time_us > latest
    if late := len(rising) - int(np.count_nonzero(rising)):
        findings.append(f"{name}: {late:,} of {len(rising):,} samples are out of order or twice: left out")
    return rows.take(rising)


def _shortcomings(signals: dict[str, LogSignal]) -> list[str]:
    """Return what the signals lack, a line each."""
    lines = [f"{name}: none in this log" for name in SIGNALS if name not in signals]
    for name, signal in signals.items():
        steps = np.diff(signal.time)
        step = float(np.median(steps))
        if name in ("gyro", "command", "motors") and step * _WANTED_RATE > 1.01:
            lines.append(f"{name}: {1.0 / step:.0f} Hz; identification needs {_WANTED_RATE:.0f} Hz or more")
        gaps = steps[steps > _GAP * step]
        if name == "gyro" and len(gaps):
            lost = int(np.sum(np.rint(gaps / step) - 1.0))
            lines.append(
                f"gyro: {len(gaps):,} gaps, {lost:,} samples lost ({100.0 * lost / (lost + len(signal.time)):.2g} %), "
                f"longest gap {gaps.max():.3g} s"
            )
    gyro = signals["gyro"].values
    clipped = [axis for axis, values in zip("xyz", gyro.T, strict=True) if _is_clipped(values)]
    if clipped:
        lines.append(f"gyro: clipped at its range of {np.abs(gyro).max():.3g} rad/s, axis {', '.join(clipped)}")
    return lines


def _is_clipped(values: Array) -> bool:
    """Return whether three samples in a row have the same, largest magnitude."""
    magnitude = np.abs(values)
    top = float(magnitude.max())
    at_top = magnitude == top
    return top > _CLIPPED and bool(np.any(at_top[2:] & at_top[1:-1] & at_top[:-2]))


def _airborne(
    states: Rows | None, signals: Mapping[str, LogSignal], start_us: float, findings: list[str]
) -> tuple[tuple[float, float], ...]:
    """Return the stretches in the air [s]: as told, else those in which the motors run, else the whole log."""
    end = float(signals["gyro"].time[-1])
    if states is not None:
        found = _stretches((states.time_us - start_us) * 1e-6, states.values[:, 0] > 0.5, end)
    elif "motors" in signals:
        mean = signals["motors"].values.mean(axis=1)
        found = _stretches(signals["motors"].time, mean > _MOTORS_RUN * np.quantile(mean, 0.9), end)
    else:
        findings.append("airborne: not told, and no motors: the whole log is taken")
        return ((float(signals["gyro"].time[0]), end),)
    if not found:
        findings.append("airborne: never, by this log")
    return found


def _stretches(time: Array, in_air: NDArray[np.bool_], end: float) -> tuple[tuple[float, float], ...]:
    """Return begin and end [s] of the stretches in the air up to `end`, without short ones and short pauses."""
    flags = np.concatenate(([False], in_air, [False]))
    times = np.append(time, max(end, float(time[-1]) if len(time) else end))
    changes = np.flatnonzero(flags[1:] != flags[:-1])
    merged: list[tuple[float, float]] = []
    for begin, stop in zip(times[changes[::2]].tolist(), times[changes[1::2]].tolist(), strict=True):
        if merged and begin - merged[-1][1] < _SHORTEST_S:
            begin = merged.pop()[0]
        merged.append((max(begin, 0.0), stop))
    return tuple((begin, stop) for begin, stop in merged if stop - begin >= _SHORTEST_S)


def fastest(sources: Sequence[Rows]) -> Rows:
    """Return the first of the sources of a signal that has nearly the highest rate of them all."""
    rates = [
        len(rows.time_us) / max(float(np.ptp(rows.time_us)), 1.0) if len(rows.time_us) else 0.0 for rows in sources
    ]
    return next(rows for rows, rate in zip(sources, rates, strict=True) if rate >= _NEARLY * max(rates))


def stack(columns: Sequence[Array]) -> Array:
    """Return columns, (n,) each, as (n, k)."""
    return np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])


def euler_angles(q_NB: Array) -> Array:
    """Return phi, theta, psi (n, 3) [rad] of attitudes (n, 4) B to N, scalar first; NaN for one that is no rotation."""
    norm = np.linalg.norm(q_NB, axis=1, keepdims=True)
    w, x, y, z = np.divide(q_NB, norm, out=np.full(q_NB.shape, np.nan), where=norm > 0.5).T
    phi = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    theta = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    return stack((phi, theta, np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))))
