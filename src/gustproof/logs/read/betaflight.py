"""Read a CSV of Betaflight's blackbox, as `blackbox_decode` or the Blackbox Explorer write it.

Betaflight's axes are front, left, up: pitch and yaw are turned to ours, of gyro and command alike. A command is the sum
of the loop's terms P, I, D and F, in thousandths of the full scale of its mixer. Numbers of the gyro without a unit are
deg/s, as Betaflight logs them since 3.0, and are held against set-points or sticks. With `blackbox_high_resolution`
they are tenths, as set-points and sticks are: a stick of the throttle then is 10000 to 20000.

References
----------
Betaflight, `blackbox.c`, `pid.c`, `mixer.c` of 4.5; blackbox-tools, `blackbox_decode.c`.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from firmware_model.config.files import open_regular
from gustproof.logs.read.assemble import Draft, Rows
from gustproof.logs.read.flight_log import TAKEN
from gustproof.logs.read.pulses import describe_outputs, output_commands
from gustproof.logs.read.table import check_size, read_names, read_numbers
from gustproof.types import Array

MAGICS = b"loopIteration", b'"loopIteration', b'"Product"'
"""Beginnings of such files."""
_TURNED = np.array([1.0, -1.0, -1.0])
_UNITS = {"": None, "_deg_s": math.pi / 180.0, "_rad_s": 1.0}
_GYROS = ("gyrounfilt", "gyroadc")  # the one that is filtered less is first
_TERMS = [[f"axis{term}_{axis}" for term in "pidf"] for axis in range(3)]
_RATE_REFERENCE = [f"setpoint_{axis}" for axis in range(3)]  # deg/s, as the gyro
_STICKS = [f"rccommand_{axis}" for axis in range(4)]
_MOTOR = re.compile(r"motor_\d")
_FULL_SCALE = 1000.0
_MOST_HEADERS = 1000  # lines of the Explorer before the names
_TENTHS = 10.0  # numbers of high resolution
_HIGHEST_STICK = 3000.0  # of the throttle, 1000 to 2000, but of high resolution
_HIGH_RESOLUTION = "blackbox_high_resolution"
_TIMES = {"time_us": 1.0, "time_s": 1e6, "time": 1.0}
_STEPS_US = (20.0, 1e6)  # [us] between samples of any log
_ALIKE, _NEAR = 0.7, (0.5, 2.0)  # correlation, and slope, of a gyro and its set-points in one unit
_MOST_PER_STICK = 4.0  # [deg/s] of a stick's 500 steps of travel, at the highest rate that there is
_MOST_DPS = 2100.0  # of a gyro of 2000 deg/s
_REMEDY = "decode it with `--unit-rotation deg/s`"


def read_betaflight(path: Path) -> Draft:
    """Return the signals of a log.

    Raises
    ------
    OSError
        If the file can't be read or is too large.
    ValueError
        If a column is missing, or a cell is no number.
    """
    with open_regular(path) as file:
        check_size(file)
        names, headers = _skip_headers(file)
        columns = _choose(names)
        numbers, findings = read_numbers(file, columns.total, columns.used)
    position, time_us = np.arange(len(numbers)), numbers[:, 0] * columns.tick_us
    _check_steps(time_us)
    step = _step_dps(numbers, columns, headers, findings)

    def rows(values: Array) -> Rows:
        return Rows(position=position, time_us=time_us, values=values)

    draft = Draft(source=path.name, system="betaflight", rows={}, findings=findings)
    scale = columns.scale or math.radians(step)
    draft.rows["gyro"] = replace(rows(numbers[:, 1:4] * scale * _TURNED), is_raw=columns.is_raw)
    places = np.cumsum([4, *(len(row) for row in columns.terms)])
    if all(columns.terms):
        sums = [numbers[:, begin:end].sum(axis=1) for begin, end in pairwise(places)]
        draft.rows["command"] = rows(np.column_stack(sums) / _FULL_SCALE * _TURNED)
    if columns.motors:
        outputs = columns.values(numbers, columns.motors)
        draft.rows["motors"] = rows(output_commands(outputs))
        draft.findings.append(describe_outputs(outputs))
    if columns.reference:
        reference = np.radians(columns.values(numbers, columns.reference) * step)
        draft.rows["rate_reference"] = rows(reference * _TURNED)
    draft.findings.append("axes: Betaflight's pitch and yaw are turned, to front, right and down")
    return draft


class _Columns(NamedTuple):
    """Columns of a decoded log that are read, by their index in its head."""

    total: int
    """Number of all columns."""
    first: list[int]
    """Time and the three rates."""
    tick_us: float
    """[us] of a step of the time's numbers."""
    terms: list[list[int]]
    """Terms of each axis."""
    motors: list[int]
    """Motors."""
    reference: list[int]
    """Rates commanded to roll, pitch and yaw; empty if they are not there."""
    sticks: list[int]
    """Sticks of roll, pitch, yaw and throttle; empty if they are not there."""
    is_raw: bool
    """True if the gyro is not filtered."""
    scale: float | None
    """[rad/s] of a step of the gyro's numbers; `None` if the file has no unit of them."""

    @property
    def used(self) -> list[int]:
        """All of them, in this order."""
        return [
            *self.first,
            *(place for row in self.terms for place in row),
            *self.motors,
            *self.reference,
            *self.sticks,
        ]

    def values(self, numbers: Array, columns: Sequence[int]) -> Array:
        """Return the numbers (n, len(columns)) of some columns, of those (n, len(used)) that are read."""
        used = self.used
        return np.ascontiguousarray(numbers[:, [used.index(column) for column in columns]])


def _skip_headers(file: IO[bytes]) -> tuple[list[str], dict[str, str]]:
    """Return the names of the columns, and the headers of the Explorer; the file then stands at the first row."""
    headers = dict[str, str]()
    for _ in range(_MOST_HEADERS):
        if "loopiteration" in (names := read_names(file)):
            break
        headers |= {names[0]: names[1]} if len(names) > 1 else {}
    else:
        raise ValueError("a blackbox of Betaflight without names of columns")
    if "headspeed" in names:
        raise ValueError("a log of Rotorflight, which flies helicopters: only multicopters are identified")
    return names, headers


def _choose(names: list[str]) -> _Columns:
    known = dict(zip(names, range(len(names)), strict=True))
    gyro, unit = next((each for each in product(_GYROS, _UNITS) if "{}_0{}".format(*each) in known), (_GYROS[-1], ""))
    time = next((name for name in _TIMES if name in known), "time")
    wanted = [time, *(f"{gyro}_{axis}{unit}" for axis in range(3))]
    if lacks := [name for name in wanted if name not in known]:
        raise ValueError(f"a blackbox of Betaflight without the column {lacks[0]}")
    reference, sticks = (_present(known, row) for row in (_RATE_REFERENCE, _STICKS))
    return _Columns(
        total=len(names),
        first=[known[name] for name in wanted],
        tick_us=_TIMES[time],
        terms=[_present(known, row) for row in _TERMS],
        motors=[known[name] for name in filter(_MOTOR.fullmatch, names)],
        reference=reference * (len(reference) == len(_RATE_REFERENCE)),
        sticks=sticks * (len(sticks) == len(_STICKS)),
        is_raw=gyro == _GYROS[0],
        scale=_UNITS[unit],
    )


def _present(known: Mapping[str, int], names: Iterable[str]) -> list[int]:
    """Return the places of those of the names that are known."""
    return [known[name] for name in names if name in known]


def _check_steps(time_us: Array) -> None:
    """Refuse stamps that are not in the unit that they are taken for."""
    step = float(np.median(np.diff(time_us))) if len(time_us) > 1 else _STEPS_US[0]
    if not _STEPS_US[0] <= step <= _STEPS_US[1]:
        raise ValueError(f"time: {step:.3g} us between samples: decode it with `--unit-frame-time us`")


def _step_dps(numbers: Array, columns: _Columns, headers: Mapping[str, str], findings: list[str]) -> float:
    """Return a step [deg/s] of set-points, and of a gyro without a unit; tell in `findings` how it is known.

    Raises
    ------
    ValueError
        If the gyro contradicts deg/s.
    """
    sticks = columns.values(numbers, columns.sticks)
    is_fine = headers.get(_HIGH_RESOLUTION) == "1"
    is_fine = is_fine or (sticks.shape[1] > 0 and float(np.nanmedian(sticks[:, -1])) > _HIGHEST_STICK)
    step = 1.0 / _TENTHS if is_fine else 1.0
    findings += [f"file: of high resolution{TAKEN}tenths: gyro, set-points and sticks"] * is_fine
    if columns.scale is not None:
        return step
    gyro = numbers[:, 1:4]
    ends = f"no unit in the file{TAKEN}{'tenths of ' * is_fine}deg/s"
    against = columns.values(numbers, columns.reference)
    if (slope := _slope(gyro, against)) is not None:
        if not _NEAR[0] < slope < _NEAR[1]:
            raise ValueError(f"gyro: no unit in the file, and {slope:.3g} times its set-points: {_REMEDY}")
        findings.append(f"gyro: {ends}, as its set-points are")
        return step
    slope, most = _slope(gyro, sticks[:, :3]), step * float(np.nanmax(np.abs(gyro), initial=0.0))
    if (slope is not None and slope > _MOST_PER_STICK) or most > _MOST_DPS:
        raise ValueError(f"gyro: no unit in the file, up to {most:,.0f}, which are no deg/s: {_REMEDY}")
    findings.append(f"gyro: {ends}, the default of its decoder since Betaflight 3.0; of older logs {_REMEDY}")
    return step


def _slope(gyro: Array, against: Array) -> float | None:
    """Return the slope of a gyro (n, 3) over what it follows (n, 3); `None` if that is not there, or not followed."""
    if against.shape[1] == 0:
        return None
    sound = np.isfinite(gyro).all(axis=1) & np.isfinite(against).all(axis=1)
    moved = against[sound]
    square, both = np.sum(moved**2), np.sum(gyro[sound] * moved)
    scale = math.sqrt(float(square * np.sum(gyro[sound] ** 2)))
    return float(both / square) if scale > 0.0 and both / scale > _ALIKE else None
