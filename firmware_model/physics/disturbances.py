"""Evaluate the tables of wind and moment at a time, in one form for all formulas and another for replays.

A wave is a row of `WAVE` numbers: kind, target, vector at the peak (3) [m/s] or [N*m], start and stop [s], and two
parameters of the kind:

    STEP                1
    RAMP                min(s / a, 1)                       a [s] rise
    ONE_MINUS_COSINE    (1 - cos(2 pi s / a)) / 2, s < a    a [s] length
    SINE                sin(a s + b)                        a [rad/s], b [rad]
    SQUARE              sign(sin(a s + b))
    SWEEP               sin((a + b s / 2) s)                a [rad/s], b [rad/s^2]

with s the time since the start. Targets are `TARGETS` groups of three columns: gust B, gust N, moment B, moment N.
A replay has a row of these columns for each sample.
"""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from firmware_model.config import waveforms
from firmware_model.config.scenario import Scenario
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.elementary import sin_cos
from firmware_model.types import Vector

Array = NDArray[np.float64]
Disturbance = tuple[Vector, Vector, Vector, Vector]
_Formula = waveforms.Gust | waveforms.DirectMoment
STEP, RAMP, ONE_MINUS_COSINE, SINE, SQUARE, SWEEP = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0
"""Kinds of waves."""
GUST_B, GUST_N, MOMENT_B, MOMENT_N = 0, 1, 2, 3
"""Targets."""
WAVE, TARGETS = 9, 4
_HALF_US = 0.5e-6  # [s] tolerance: stamps are whole microseconds, rounded seconds are not


def make_waves(scenario: Scenario) -> Array:
    """Return the waves (n, WAVE) of a scenario's formulas, in its order."""
    rows = [_make_wave(item) for item in _list_tables(scenario) if isinstance(item, _Formula)]
    return np.array(rows, dtype=np.float64).reshape(-1, WAVE)


def make_replay(scenario: Scenario) -> Array:
    """Return the replay at each sample (samples, 3 * TARGETS); (0, 3 * TARGETS) without replays."""
    replays = [item for item in _list_tables(scenario) if isinstance(item, waveforms.Replay)]
    table = np.zeros((scenario.samples if replays else 0, 3 * TARGETS))
    time = np.arange(len(table)) * scenario.sample_us * 1e-6
    for item in replays:
        rows = np.array(item.rows)
        stop = math.inf if item.stop_s is None else item.stop_s - item.start_s
        since = time - item.start_s
        acts = (since >= max(rows[0, 0], 0.0) - _HALF_US) & (since < min(stop - _HALF_US, rows[-1, 0] + _HALF_US))
        at = 3 * _target_index(item.frame == "ned", moment=isinstance(item, waveforms.MomentReplay))
        for i in range(3):
            table[acts, at + i] += np.interp(since[acts], rows[:, 0], rows[:, 1 + i])
    return table


def _list_tables(scenario: Scenario) -> Iterable[waveforms.Wind | waveforms.Moment]:
    return (*scenario.wind, *scenario.moment)


def _target_index(is_earth_frame: bool, *, moment: bool) -> int:
    return 2 * moment + is_earth_frame


def _make_wave(item: _Formula) -> tuple[float, ...]:
    kind, a, b = _shape_params(item)
    stop = math.inf if item.stop_s is None else item.stop_s
    target = _target_index(item.is_earth_frame, moment=isinstance(item, waveforms.DirectMoment))
    return (kind, target, *item.vector, item.start_s, stop, a, b)


def _shape_params(item: _Formula) -> tuple[float, float, float]:
    match item:
        case waveforms.Step():
            return STEP, 0.0, 0.0
        case waveforms.Ramp():
            return RAMP, item.rise_s, 0.0
        case waveforms.OneMinusCosine():
            return ONE_MINUS_COSINE, item.length_s, 0.0
        case waveforms.Sine():
            return SINE, item.rate_rad_s, item.phase_rad
        case waveforms.Square():
            return SQUARE, item.rate_rad_s, item.phase_rad
        case waveforms.Sweep():
            slope = (item.rate_to_rad_s - item.rate_from_rad_s) / (item.stop_s - item.start_s)
            return SWEEP, item.rate_from_rad_s, slope
    raise TypeError(f"{type(item).__name__} is no wave")


@kernel
def wave_value(kind: float, since: float, a: float, b: float) -> float:
    """Return a wave [-] at the time `since` [s] its start; `a` and `b` are the parameters of its kind."""
    if kind == STEP:
        return 1.0
    if kind == RAMP:
        return min(max(since / a, 0.0), 1.0)
    if kind == ONE_MINUS_COSINE:
        phase = since / a
        if not 0.0 < phase < 1.0:
            return 0.0
        _, cosine = sin_cos(2.0 * math.pi * phase)
        return 0.5 * (1.0 - cosine)
    if kind == SWEEP:
        sine, _ = sin_cos((a + 0.5 * b * since) * since)
        return sine
    sine, _ = sin_cos(a * since + b)
    if kind == SQUARE:
        return 1.0 if sine >= 0.0 else -1.0
    return sine


@kernel
def disturbance(waves: Array, replay: Array, sample: int, time: float) -> Disturbance:
    """Return the tables' gust [m/s] B, gust N, moment [N*m] B and moment N at a sample at `time` [s]."""
    u, v, w = 0.0, 0.0, 0.0
    north, east, down = 0.0, 0.0, 0.0
    L, M, N = 0.0, 0.0, 0.0
    M_north, M_east, M_down = 0.0, 0.0, 0.0
    if sample < replay.shape[0]:
        now = replay[sample]
        u, v, w, north, east, down = now[0], now[1], now[2], now[3], now[4], now[5]
        L, M, N, M_north, M_east, M_down = now[6], now[7], now[8], now[9], now[10], now[11]
    for i in range(waves.shape[0]):
        row = waves[i]
        if row[5] <= time + _HALF_US < row[6]:
            size = wave_value(row[0], time - row[5], row[7], row[8])
            x, y, z = size * row[2], size * row[3], size * row[4]
            if row[1] == GUST_B:
                u, v, w = u + x, v + y, w + z
            elif row[1] == GUST_N:
                north, east, down = north + x, east + y, down + z
            elif row[1] == MOMENT_B:
                L, M, N = L + x, M + y, N + z
            else:
                M_north, M_east, M_down = M_north + x, M_east + y, M_down + z
    return (u, v, w), (north, east, down), (L, M, N), (M_north, M_east, M_down)
