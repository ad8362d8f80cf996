"""Stretches of a log that are fit for identification: in the air, without long gaps, averaged to bins."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gustproof.logs.identify.rate_response import Indices, command_response
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.types import Array

BIN = 0.004
"""[s] gyro samples within it are averaged: below 25 Hz, where vehicles turn, that loses nothing."""
SETTLING = 0.35
"""[s] left out at the start of a stretch: the actuators' state is unknown there."""
_GROUND = 1.5  # [s] left out beside take-off and landing: the ground pushes on the vehicle
_PIECE = 10.0  # [s] of the pieces of a long log
LONGEST_GAP = 0.1
"""[s] beyond it a stretch ends."""
SHORTEST = 2.0
"""[s] of a stretch that is used."""
NEVER_FLEW = "never in the air, by its landing detector or motors: --from and --to take a part of it all the same"
"""Said of a log without a flight."""
_ROUND = 1e-9  # [s] of sums


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stretch:
    """Gyro and commands without a gap."""

    command_time: Array
    """(m,) [s]."""
    command: Array
    """(m, k) torque commands or motor commands, and a last column of ones for the trim."""
    gyro_time: Array
    """(n,) [s]."""
    bins: Indices
    """(b,) first gyro sample of each bin."""
    time: Array
    """(b,) [s] mean time of each bin."""
    count: Array
    """(b,) gyro samples in each bin."""
    rate: Array
    """(b, 3) [rad/s] B, mean of each bin."""

    def response(self, channels: list[int], model: Array, *, square: bool) -> Array:
        """Return the binned response (b, k) of the rate to some columns of the command, see `command_response`."""
        command = np.ascontiguousarray(self.command[:, channels])
        out, state, steps = np.empty((len(self.bins), len(channels))), np.empty((2, len(channels))), np.empty((4, 6))
        command_response(self.command_time, command, self.gyro_time, self.bins, model, square, state, steps, out)
        return out


def sample_time(signal: LogSignal) -> float:
    """Return the usual time [s] between two samples."""
    return float(np.median(np.diff(signal.time)))


def find_stretches(log: FlightLog, command: LogSignal) -> list[tuple[float, float]]:
    """Return begin and end [s] of the airborne stretches in which gyro and `command` have no long gap."""
    if log.airborne is None:
        airborne = [(float(log.gyro.time[0]), float(log.gyro.time[-1]))]
    else:
        airborne = [(begin + _GROUND, end - _GROUND) for begin, end in log.airborne]
    found = [part for whole in airborne for part in _split(whole, (log.gyro, command))]
    return [(begin, end) for begin, end in found if end - begin >= SHORTEST]


def limit_time(spans: list[tuple[float, float]], command: LogSignal, enough: float) -> list[tuple[float, float]]:
    """Return `enough` [s] of the liveliest pieces of the spans [s], those in which the command moves most."""
    if sum(end - begin for begin, end in spans) <= enough:
        return spans
    cuts = [np.append(np.arange(begin, end, _PIECE), end) for begin, end in spans]
    pieces = [(float(a), float(b)) for cut in cuts for a, b in pairwise(cut) if b - a >= SHORTEST]
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(command.values, axis=0)).sum(axis=1))])
    activity = [float(np.ptp(np.interp((a, b), command.time, moved))) / (b - a) for a, b in pieces]
    chosen = sorted(np.argsort(activity, kind="stable")[::-1][: round(enough / _PIECE)])
    return [pieces[i] for i in chosen]


def hold_out(spans: list[tuple[float, float]]) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Return the spans [s] to learn from, and every third piece of the time in them, to be predicted.

    A flight often moves one axis after another: one third in a row would show one axis only.
    """
    total = sum(end - begin for begin, end in spans)
    piece = min(max(total / 9.0, SHORTEST), _PIECE)
    parts: tuple[list[tuple[float, float]], list[tuple[float, float]]] = ([], [])
    gone = 0.0
    for begin, end in spans:
        at = begin
        while end - at > _ROUND:
            number = int((gone + at - begin + _ROUND) // piece)
            until = min(end, begin + (number + 1) * piece - gone)
            kept = parts[number % 3 == 2]
            joined = kept and abs(kept[-1][1] - at) < _ROUND and at > begin
            kept.append((kept.pop()[0] if joined else at, until))
            at = until
        gone += end - begin
    learnt, rest = ([part for part in each if part[1] - part[0] >= SHORTEST - _ROUND] for each in parts)
    return learnt, rest


def _split(whole: tuple[float, float], signals: tuple[LogSignal, ...]) -> Iterator[tuple[float, float]]:
    """Yield begin and end [s] of the parts of a stretch in which no signal has a long gap."""
    begin, end = max([whole[0], *(s.time[0] for s in signals)]), min([whole[1], *(s.time[-1] for s in signals)])
    cuts = list[tuple[float, float]]()
    for signal in signals:
        after = np.flatnonzero(np.diff(signal.time) > max(LONGEST_GAP, 3.0 * sample_time(signal)))
        cuts += [
            (signal.time[i], signal.time[i + 1]) for i in after if begin < signal.time[i + 1] and signal.time[i] < end
        ]
    start = begin
    for stop, after_it in [*sorted(cuts), (end, end)]:  # gaps of several signals may overlap
        yield float(start), float(stop)
        start = max(start, after_it)


def cut_stretch(gyro: LogSignal, command: LogSignal, begin: float, end: float) -> Stretch:
    """Return the part of a log from `begin` to `end` [s]."""
    held = _fill_gaps(command, begin, end)
    inside = (gyro.time >= begin + SETTLING) & (gyro.time <= end)
    time, dt = gyro.time[inside], sample_time(gyro)
    width = dt * max(1, round(BIN / dt))
    number = np.floor((time - time[0] + 0.5 * dt) / width)
    bins = np.flatnonzero(np.diff(number, prepend=-1.0)).astype(np.int64)
    count = np.diff(bins, append=len(time)).astype(np.float64)
    return Stretch(
        command_time=held.time,
        command=np.column_stack([held.values, np.ones(len(held.time))]),
        gyro_time=time,
        bins=bins,
        count=count,
        time=np.add.reduceat(time, bins) / count,
        rate=np.add.reduceat(gyro.values[inside], bins, axis=0) / count[:, None],
    )


def _fill_gaps(command: LogSignal, begin: float, end: float) -> LogSignal:
    """Return the commands of a stretch, lost ones interpolated: a hold over a gap is late by half of it."""
    inside = (command.time >= begin) & (command.time <= end)
    time, values, dt = command.time[inside], command.values[inside], sample_time(command)
    lost = np.maximum(np.round(np.diff(time) / dt).astype(int) - 1, 0)
    added = [np.linspace(time[i], time[i + 1], lost[i] + 2)[1:-1] for i in np.flatnonzero(lost)]
    whole = np.sort(np.concatenate([time, *added]))
    filled = np.column_stack([np.interp(whole, time, column) for column in values.T])
    return LogSignal(time=whole, values=filled)
