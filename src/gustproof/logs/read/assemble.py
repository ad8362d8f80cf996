"""Make a flight log of what a reader found in a file: one clock, plausible numbers, and what is wrong in words."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from firmware_model.numerics.rotations import wrapped_euler_angles
from gustproof.logs.read.flight_log import ABSENT, CommandUnit, FlightLog, LogSignal
from gustproof.logs.read.flown_part import place_notches
from gustproof.logs.read.stamps import PAUSE_US, find_chain, usual_step
from gustproof.logs.read.unit_check import check_units
from gustproof.types import Array

SIGNALS = ("gyro", "command", "motors", "accelerometer", "attitude", "reference", "rate_reference")
"""Signals of a `FlightLog`, by name."""
_LARGEST = {
    **{"gyro": 100.0, "command": 1e6, "motors": 1e3, "accelerometer": 2000.0},
    **{"attitude": 10.0, "reference": 10.0, "rate_reference": 100.0, "notches": 5000.0},
}
"""In the signal's unit; no instrument or set-point of a vehicle that flies is beyond it."""
_STRAYED_US = 1e6  # of a stamp from those of the gyro beside it in the file: loggers buffer less
_PIECE = 16  # samples before or after the longest piece; fewer are wrong stamps
_SPIKE, _STEADY = 20.0, 0.99  # a lone sample further from both neighbours than so many usual steps is damaged
_LEAST_SPIKE = {"gyro": 1.0, "command": 0.2, "motors": 0.2, "accelerometer": 20.0}  # in the signal's unit
_WANTED_RATE = 100.0  # [Hz] below which the loop's lag can't be told from the sampling
TOO_SLOW = f"identification needs {_WANTED_RATE:.0f} Hz or more"
"""End of the finding about a signal of a low rate."""
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
    is_raw: bool = False
    """True for a gyro that is known to be unfiltered."""

    def has_times(self) -> bool:
        """Return whether any sample has a stamp."""
        return bool(np.isfinite(self.time_us).any())

    def take(self, which: NDArray[np.bool_]) -> "Rows":
        """Return the m of n samples for which the mask `which` (n,) is true."""
        if which.all():
            return self
        return replace(self, position=self.position[which], time_us=self.time_us[which], values=self.values[which])


@dataclass(slots=True, kw_only=True, eq=False)
class Draft:
    """All that a reader found in a file."""

    source: str
    """Name of the file."""
    system: str
    """Writer of the log."""
    rows: dict[str, Rows]
    """By name of the signal."""
    names_units: bool = False
    """True if a user named units and axes: ones that contradict each other are refused."""
    in_air: Rows | None = None
    """(n, 1) 1 from a sample on that is in the air, else 0; `None` if the log does not tell."""
    command_unit: CommandUnit = CommandUnit.NORMALISED
    """Unit of the command."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Parameters of the autopilot by name."""
    notches: dict[str, Rows] = field(default_factory=dict)
    """Frequencies of notches that moved, see `FlightLog.notches`."""
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
    beyond any instrument or stand out alone are left out. So are wrong stamps: those off the chain of their signal, see
    `find_chain`, or off the gyro's clock at their place in the file. Each is told in `findings`.

    Raises
    ------
    ValueError
        If there is no gyro, a vector has not three components, or the units that a table names contradict each other.
    """
    findings = list(draft.findings)
    _check_shapes(draft.rows, findings)
    begin, end = longest_piece(draft.rows["gyro"], findings)
    gyro = _sound("gyro", _cut(draft.rows["gyro"], begin, end), findings)
    others = {name: _cut(rows, begin, end) for name, rows in draft.rows.items() if name != "gyro"}
    sound = {name: _sound(name, rows, findings, gyro) for name, rows in others.items()}
    sound = {name: gyro if name == "gyro" else sound[name] for name in draft.rows}
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
    findings += [*_contradictions(draft, signals), *_shortcomings(signals)]
    states = None if draft.in_air is None else _on_clock(_cut(draft.in_air, begin, end), gyro)
    log = FlightLog(
        source=draft.source,
        system=draft.system,
        command_unit=draft.command_unit,
        is_gyro_raw=gyro.is_raw,
        airborne=_airborne(states, signals, start_us, findings),
        parameters=draft.parameters,
        notches=_notches(draft, (begin, end), gyro, start_us, findings),
        findings=tuple(findings),
        **signals,
    )
    return place_notches(log)


def _notches(
    draft: Draft, ends: tuple[int, int], gyro: Rows, start_us: float, findings: list[str]
) -> dict[str, LogSignal]:
    """Return where notches moved to, between two places of the file."""
    found = {}
    for name, rows in draft.notches.items():
        sound = _sound("notches", _cut(rows, *ends), findings, gyro)
        found[name] = LogSignal(time=(sound.time_us - start_us) * 1e-6, values=sound.values)
    return found


def _check_shapes(signals: Mapping[str, Rows], findings: Sequence[str]) -> None:
    if "gyro" not in signals or len(signals["gyro"].time_us) == 0:
        damage = [line for line in findings if line.startswith("file: ")]
        raise ValueError("; ".join(["no gyro in it", *damage]))
    for name, rows in signals.items():
        if name != "motors" and rows.values.shape[1] != 3:
            raise ValueError(f"{name} has {rows.values.shape[1]} components, must have 3")


def _contradictions(draft: Draft, signals: Mapping[str, LogSignal]) -> list[str]:
    """Return what is wrong with units and axes; refuse it of a user's own names, which can be mended."""
    found = list(check_units(signals))
    if found and draft.names_units:
        raise ValueError(found[0])
    return found


def longest_piece(gyro: Rows, findings: list[str]) -> tuple[int, int]:
    """Return first and last place in the file of the longest piece without a reset of the clock."""
    chain = np.flatnonzero(find_chain(gyro.time_us))
    if len(chain) == 0:
        raise ValueError("no gyro with a time in it")
    first, last, count = int(chain[0]), int(chain[-1]), len(gyro.time_us)
    if first + count - 1 - last < _PIECE:
        return -(1 << 62), 1 << 62
    length_s = (gyro.time_us[last] - gyro.time_us[first]) * 1e-6
    share = f"{last - first + 1:,} of {count:,} gyro samples"
    findings.append(f"clock: set anew; the longest piece is kept, {length_s:.1f} s with {share}")
    begin = int(gyro.position[first]) if first else -(1 << 62)
    return begin, int(gyro.position[last]) if last + 1 < count else 1 << 62


def _cut(rows: Rows, begin: int, end: int) -> Rows:
    """Return the rows from place `begin` to `end`, both included."""
    return rows.take((rows.position >= begin) & (rows.position <= end))


def _sound(name: str, rows: Rows, findings: list[str], gyro: Rows | None = None) -> Rows:
    """Return the rows that are plausible, with rising stamps that agree with those of the gyro."""
    largest = np.abs(rows.values).max(axis=1, initial=0.0)
    usable = largest <= _LARGEST[name]  # NaN compares false
    usable[usable] = ~_stand_out(name, rows.values[usable])
    if absurd := len(usable) - int(np.count_nonzero(usable)):
        findings.append(f"{name}: {absurd:,} of {len(usable):,} samples are no plausible numbers: left out")
    rows = rows.take(usable)
    right = np.isfinite(rows.time_us)
    if gyro is not None:
        early, late = _bounds(rows, gyro)
        right &= (rows.time_us >= early) & (rows.time_us <= late)
    right[right] = find_chain(rows.time_us[right])
    if wrong := len(right) - int(np.count_nonzero(right)):
        findings.append(f"{name}: {wrong:,} of {len(right):,} stamps are wrong, out of order or twice: left out")
    return rows.take(right)


def _stand_out(name: str, values: Array) -> NDArray[np.bool_]:
    """Return which of the samples (n, k) stand out alone, far from both neighbours: bits of them were flipped."""
    found = np.zeros(len(values), dtype=np.bool_)
    if name in _LEAST_SPIKE and len(values) > 2:
        steps = np.diff(values, axis=0)
        far = np.maximum(_SPIKE * np.quantile(np.abs(steps), _STEADY, axis=0), _LEAST_SPIKE[name])
        returns = (np.sign(steps[1:]) != np.sign(steps[:-1])) & (np.minimum(abs(steps[1:]), abs(steps[:-1])) > far)
        found[1:-1] = returns.any(axis=1)
    return found


def _bounds(rows: Rows, gyro: Rows) -> tuple[Array, Array]:
    """Return the least and largest time [us] (n,) that rows may have by the gyro's samples beside them in the file."""
    clock = np.concatenate(([-PAUSE_US], gyro.time_us, [PAUSE_US]))
    if len(gyro.time_us):
        clock[[0, -1]] += gyro.time_us[[0, -1]]
    after = np.searchsorted(gyro.position, rows.position)
    return clock[after] - _STRAYED_US, clock[after + 1] + _STRAYED_US


def _on_clock(rows: Rows, gyro: Rows) -> Rows:
    """Return rows all of which count: one with a wrong stamp, or none, gets that of the gyro beside it in the file."""
    early, late = _bounds(rows, gyro)
    right = (rows.time_us >= early) & (rows.time_us <= late)
    time_us = np.where(right, rows.time_us, late - _STRAYED_US)
    return replace(rows, time_us=time_us)


def _shortcomings(signals: dict[str, LogSignal]) -> list[str]:
    """Return what the signals lack, a line each."""
    absent = [name for name in SIGNALS[:-1] if name not in signals]
    lines = [f"{ABSENT}{', '.join(absent)}"] * bool(absent)
    used = "gyro", "command" if "command" in signals else "motors"
    for name, signal in signals.items():
        steps = np.diff(signal.time)
        step = float(np.median(steps))
        if name in used and step * _WANTED_RATE > 1.01:
            lines.append(f"{name}: {1.0 / step:.0f} Hz; {TOO_SLOW}")
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
    """Return start and end [s] of the stretches in the air up to `end`, without short ones and short pauses."""
    flags = np.concatenate(([False], in_air, [False]))
    times = np.append(time, max(end, float(time[-1]) if len(time) else end))
    changes = np.flatnonzero(flags[1:] != flags[:-1])
    merged: list[tuple[float, float]] = []
    for begin, stop in zip(times[changes[::2]].tolist(), times[changes[1::2]].tolist(), strict=True):
        if merged and begin - merged[-1][1] < _SHORTEST_S:
            begin = merged.pop()[0]
        merged.append((max(begin, 0.0), stop))
    ends = [(begin, min(stop, end)) for begin, stop in merged]  # the gyro may end before the states
    return tuple((begin, stop) for begin, stop in ends if stop - begin >= _SHORTEST_S)


def fastest(sources: Sequence[Rows]) -> Rows:
    """Return the first of the sources of a signal that has nearly the highest rate of them all."""
    rates = [1.0 / usual_step(rows.time_us) for rows in sources]
    return next(rows for rows, rate in zip(sources, rates, strict=True) if rate >= _NEARLY * max(rates))


def stack(columns: Sequence[Array]) -> Array:
    """Return columns, (n,) each, as (n, k)."""
    return np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])


def euler_angles(q_NB: Array) -> Array:
    """Return phi, theta, psi (n, 3) [rad] of attitudes (n, 4) B to N, scalar first; NaN for one that is no rotation."""
    norm = np.linalg.norm(q_NB, axis=1, keepdims=True)
    return wrapped_euler_angles(np.divide(q_NB, norm, out=np.full(q_NB.shape, np.nan), where=norm > 0.5))
