"""Read a CSV of Betaflight's blackbox, as `blackbox_decode` or the Blackbox Explorer write it.

Betaflight's axes are front, left, up: pitch and yaw are turned to ours, of gyro and command alike. A command is the sum
of the loop's terms P, I, D and F, in thousandths of the full scale of its mixer. Numbers of the gyro without a unit are
deg/s, as Betaflight logs them since 3.0.

References
----------
Betaflight, `blackbox.c`, `pid.c`, `mixer.c` of 4.5; blackbox-tools, `blackbox_decode.c`.
"""

import math
import re
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from firmware_model.config.files import open_regular
from gustproof.logs.read.assemble import Draft, Rows
from gustproof.logs.read.pulses import output_commands
from gustproof.logs.read.table import check_size, read_names, read_numbers
from gustproof.types import Array

MAGICS = b"loopIteration", b'"loopIteration', b'"Product"'
"""Beginnings of such files."""
_TURNED = np.array([1.0, -1.0, -1.0])
_UNITS = {"": math.pi / 180.0, "_deg_s": math.pi / 180.0, "_rad_s": 1.0}
_GYROS = ("gyrounfilt", "gyroadc")  # the one that is filtered less is first
_TERMS = [[f"axis{term}_{axis}" for term in "pidf"] for axis in range(3)]
_RATE_REFERENCE = [f"setpoint_{axis}" for axis in range(3)]  # deg/s, as the gyro
_MOTOR = re.compile(r"motor_\d")
_FULL_SCALE = 1000.0
_MOST_HEADERS = 1000  # lines of the Explorer before the names


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
        columns = _choose(_skip_headers(file))
        numbers, findings = read_numbers(file, columns.total, columns.used)
    position, time_us = np.arange(len(numbers)), numbers[:, 0]

    def rows(values: Array) -> Rows:
        return Rows(position=position, time_us=time_us, values=values)

    draft = Draft(source=path.name, system="betaflight", rows={}, findings=findings)
    draft.rows["gyro"] = replace(rows(numbers[:, 1:4] * columns.scale * _TURNED), is_raw=columns.is_raw)
    places = np.cumsum([4, *(len(row) for row in columns.terms)])
    if all(columns.terms):
        sums = [numbers[:, begin:end].sum(axis=1) for begin, end in pairwise(places)]
        draft.rows["command"] = rows(np.column_stack(sums) / _FULL_SCALE * _TURNED)
    motors = places[-1] + len(columns.motors)
    if columns.motors:
        draft.rows["motors"] = rows(output_commands(numbers[:, places[-1] : motors]))
    if columns.reference:
        draft.rows["rate_reference"] = rows(np.radians(numbers[:, motors:]) * _TURNED)
    draft.findings.append("axes: Betaflight's pitch and yaw are turned, to front, right and down")
    draft.findings += ["gyro: no unit in the file, taken for deg/s"] * columns.guessed
    return draft


class _Columns(NamedTuple):
    """Columns of a decoded log that are read, by their index in its head."""

    total: int
    """Number of all columns."""
    first: list[int]
    """Time and the three rates."""
    terms: list[list[int]]
    """Terms of each axis."""
    motors: list[int]
    """Motors."""
    reference: list[int]
    """Rates commanded to roll, pitch and yaw; empty if they are not there."""
    is_raw: bool
    """True if the gyro is not filtered."""
    scale: float
    """[rad/s] of a step of the gyro's numbers."""
    guessed: bool
    """True if the file has no unit of them."""

    @property
    def used(self) -> list[int]:
        """All of them, in this order."""
        return [*self.first, *(place for row in self.terms for place in row), *self.motors, *self.reference]


def _skip_headers(file: IO[bytes]) -> list[str]:
    """Return the names of the columns; the file then stands at the first row."""
    for _ in range(_MOST_HEADERS):
        if "loopiteration" in (names := read_names(file)):
            return names
    raise ValueError("a blackbox of Betaflight without names of columns")


def _choose(names: list[str]) -> _Columns:
    known = dict(zip(names, range(len(names)), strict=True))
    gyro, unit = next((each for each in product(_GYROS, _UNITS) if "{}_0{}".format(*each) in known), (_GYROS[-1], ""))
    wanted = ["time_us" if "time_us" in known else "time", *(f"{gyro}_{axis}{unit}" for axis in range(3))]
    if lacks := [name for name in wanted if name not in known]:
        raise ValueError(f"a blackbox of Betaflight without the column {lacks[0]}")
    reference = [known[name] for name in _RATE_REFERENCE if name in known]
    return _Columns(
        total=len(names),
        first=[known[name] for name in wanted],
        terms=[[known[name] for name in row if name in known] for row in _TERMS],
        motors=[known[name] for name in filter(_MOTOR.fullmatch, names)],
        reference=reference * (len(reference) == len(_RATE_REFERENCE)),
        is_raw=gyro == _GYROS[0],
        scale=_UNITS[unit],
        guessed=not unit,
    )
