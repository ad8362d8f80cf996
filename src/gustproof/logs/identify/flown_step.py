"""Step responses of the loops that flew, from set-point to what was flown, of any log with stick input.

A set-point y_d and the answer y of an axis are fitted by

    A(q) y = B(q) y_d + e,

with long polynomials and white e. The answer to the set-point is B / A, however coloured the disturbance is. A rate's
set-point answers the disturbance too, by the outer loop. A plain deconvolution takes that for the response.

References
----------
L. Ljung, System Identification: Theory for the User, 2nd edition, 1999, sections 7.2 and 13.4.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from firmware_model.types import AXES
from gustproof.logs.identify.rates import describe_slow_log
from gustproof.logs.identify.spectra import frequency_response
from gustproof.logs.identify.stretches import NEVER_FLEW, find_stretches, limit_time, sample_time
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.types import Array

COHERENT = 0.6
"""[-] least coherence of set-point and answer in the band that is told."""
_SPACING = 0.008  # [s] least spacing of samples
_MEMORY, _LONGEST = 0.25, 30  # [s] and samples of the polynomials
_BLOCK = 2.0  # [s] of the pieces that are drawn again
_DRAWS, _SEED = 300, 17
_LEAST_BLOCKS = 6
_ENOUGH = 600.0  # [s] of the liveliest pieces of a long flight
_RIDGE = 1e-4  # of the mean power of the regressors
_VAGUE = 0.5  # [-] half-width of the interval, beyond which no response is told
_MISFIT = 2.2  # spread of real errors by that of the draws, as a simulation shows
_BETWEEN = 0.3  # of a sample, in which a set-point may have moved between two that are logged
_DEAD = 1e-6  # [rad/s] or [rad] rms of a set-point that does not move


class Loop(Enum):
    """Loop whose response is told."""

    RATE = "rate"
    """From the rate's set-point to the gyro."""
    ATTITUDE = "attitude"
    """From the attitude's set-point to the attitude."""


SHOWN_S = {Loop.RATE: 0.6, Loop.ATTITUDE: 1.5}
"""[s] length of the response."""
_LEAST_HZ = {Loop.RATE: 40.0, Loop.ATTITUDE: 15.0}  # of signals; PX4's default profile has 50 and 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlownStep:
    """Response of one axis to a step of 1."""

    loop: Loop
    """Loop that answers."""
    axis: int
    """0 roll, 1 pitch, 2 yaw."""
    time: Array
    """(n,) [s] from the step."""
    value: Array
    """(n,) [-]."""
    low: Array
    """(n,) [-] 95 % interval."""
    high: Array
    """(n,) [-]."""
    band: tuple[float, float]
    """[rad/s] frequencies between which the coherence is at least .6."""

    @property
    def peak(self) -> float:
        """Return the largest value [-]."""
        return float(self.value.max())

    @property
    def peak_high(self) -> float:
        """Return the largest value of the interval's upper end [-]."""
        return float(self.high.max())

    def reaches(self, share: float) -> float | None:
        """Return the time [s] at which a share [-] of 1 is reached; `None` if it is not."""
        beyond = np.flatnonzero(self.value >= share)
        if not len(beyond):
            return None
        i = int(beyond[0])
        if i == 0:
            return float(self.time[0])
        return float(np.interp(share, self.value[i - 1 : i + 1], self.time[i - 1 : i + 1]))

    def describe(self) -> str:
        """Return the response in words."""
        half, late = self.reaches(0.5), self.reaches(0.9)
        begins = "never reaches half" if half is None else f"half after {1e3 * half:.0f} ms"
        rises = "never 90 %" if late is None else f"90 % after {1e3 * late:.0f} ms"
        peak = f"peak {self.peak:.2f} (at most {self.peak_high:.2f})"
        band = "coherent from {:.2g} to {:.2g} rad/s".format(*self.band)
        return f"{AXES[self.axis]} {self.loop.value}: {begins}, {rises}, {peak}; {band}"


def flown_steps(log: FlightLog) -> tuple[list[FlownStep], list[str]]:
    """Return the responses that a log tells, and a reason for each that it does not."""
    told, refused = list[FlownStep](), list[str]()
    if log.airborne == ():
        return [], [f"rate and attitude: {NEVER_FLEW}"]
    for loop, reference, answer in (
        (Loop.RATE, log.rate_reference, log.gyro),
        (Loop.ATTITUDE, log.reference, log.attitude),
    ):
        if answer is None or len(answer.time) < 2:
            refused.append(f"{loop.value}: not in this log")
            continue
        if reference is None or len(reference.time) < 2:
            refused.append(f"{loop.value}: no set-points in this log")
            continue
        slow = describe_slow_log(log, {f"{loop.value} set-point": reference, loop.value: answer}, _LEAST_HZ[loop])
        if slow:
            refused.append(f"{loop.value}: {slow}")
            continue
        spacing = max(_SPACING, sample_time(reference), sample_time(answer))
        pieces = list(_pieces(log, reference, answer, spacing, unwrap=loop is Loop.ATTITUDE))
        for axis in range(3):
            found = _respond(loop, axis, pieces, spacing)
            if isinstance(found, str):
                refused.append(f"{AXES[axis]} {loop.value}: {found}")
            else:
                told.append(found)
    return told, refused


def _pieces(
    log: FlightLog, reference: LogSignal, answer: LogSignal, dt: float, *, unwrap: bool
) -> Iterator[tuple[Array, Array]]:
    """Yield set-point and answer (n, 3) at even times of each stretch in the air."""
    width = 2 * max(0, round(0.5 * dt / sample_time(answer) - 0.5)) + 1
    asked, flown = (np.unwrap(each.values, axis=0) if unwrap else each.values for each in (reference, answer))
    flown = uniform_filter1d(flown, width, axis=0, mode="nearest")  # no fast noise folds down
    columns = [
        (signal.time, np.ascontiguousarray(values.T)) for signal, values in ((reference, asked), (answer, flown))
    ]
    for begin, end in limit_time(find_stretches(log, reference), reference, _ENOUGH):
        time = np.arange(begin, end, dt)
        u, y = (np.column_stack([np.interp(time, stamps, each) for each in rows]) for stamps, rows in columns)
        yield u, y


def _respond(loop: Loop, axis: int, pieces: list[tuple[Array, Array]], dt: float) -> FlownStep | str:
    """Return the response of an axis, or the reason why it is not told."""
    series = [(u[:, axis], y[:, axis]) for u, y in pieces]
    if not series or np.sqrt(np.mean(np.concatenate([u - u.mean() for u, _ in series]) ** 2)) < _DEAD:
        return "its set-point does not move"
    order, count = min(_LONGEST, max(4, round(_MEMORY / dt))), 1 + round(SHOWN_S[loop] / dt)
    blocks = _block_sums(series, order, round(_BLOCK / dt))
    if len(blocks) < _LEAST_BLOCKS:
        return f"too short: {_LEAST_BLOCKS * _BLOCK:g} s in the air are needed"
    value, low, high = _with_interval(blocks, order, count)
    reach, band = float(np.quantile(high - low, 0.9)) / 2.0, _band(series, dt)
    if not reach <= _VAGUE or band is None:  # it may be NaN
        known = f"uncertain by {100.0 * reach:.0f} %" if reach < 1.0 else "not known"
        coherent = "" if band else ", as set-point and answer are not coherent"
        return f"the response is {known}{coherent}: move the {AXES[axis]} stick to and fro for 20 s"
    time = np.arange(count, dtype=np.float64) * dt
    return FlownStep(loop=loop, axis=axis, time=time, value=value, low=low, high=high, band=band)


def _with_interval(blocks: list[Array], order: int, count: int) -> tuple[Array, Array, Array]:
    """Return the response (count,) with its 95 % interval, by blocks that are drawn again."""
    value = _step(np.sum(blocks, axis=0), order, count)
    weights = np.random.default_rng(_SEED).multinomial(len(blocks), np.full(len(blocks), 1.0 / len(blocks)), _DRAWS)
    flat = np.reshape(blocks, (len(blocks), -1))
    draws = [_step(sums, order, count) for sums in (weights @ flat).reshape(-1, *blocks[0].shape)]
    ends = _MISFIT * (np.quantile(draws, [0.025, 0.975], axis=0) - value)
    between = _BETWEEN * np.abs(np.gradient(value))
    low, high = np.hypot(np.minimum(ends[0], 0.0), between), np.hypot(np.maximum(ends[1], 0.0), between)
    return value, value - low, value + high


def _block_sums(series: list[tuple[Array, Array]], order: int, size: int) -> list[Array]:
    """Return the products (p + 1, p + 1) of regressors and answer, summed over each block and about its means."""
    sums = []
    for u, y in series:
        rows = np.lib.stride_tricks.sliding_window_view
        past, driven = rows(y, order + 1)[:, ::-1], rows(u, order + 1)[:, ::-1]
        table = np.column_stack([past[:, 1:], driven[:, 1:], past[:, 0]])
        for begin in range(0, len(table) - size + 1, size):
            block = table[begin : begin + size] - table[begin : begin + size].mean(axis=0)
            sums.append(block.T @ block)
    return sums


def _step(sums: Array, order: int, count: int) -> Array:
    """Return the response (count,) to a step, which begins a sample after it."""
    normal, right = sums[:-1, :-1], sums[:-1, -1]
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
    theta = np.linalg.solve(scaled, right / scale) / scale
    driven, own = np.concatenate([[0.0], theta[order:]]), np.concatenate([[1.0], -theta[:order]])
    with np.errstate(over="ignore", invalid="ignore"):  # a draw may be unstable
        return np.asarray(lfilter(driven, own, np.ones(count)))


def _band(series: list[tuple[Array, Array]], dt: float) -> tuple[float, float] | None:
    """Return the frequencies [rad/s] between which set-point and answer are coherent, about the most coherent one."""
    found = frequency_response([(u, y, None) for u, y in series], dt, 0.4 / dt)
    good = found.coherence >= COHERENT
    if not good.any():
        return None
    best = int(np.argmax(found.coherence))
    low = best - int(np.argmin(np.append(good[best::-1], False))) + 1
    high = best + int(np.argmin(np.append(good[best:], False))) - 1
    return float(found.omega[low]), float(found.omega[high])
