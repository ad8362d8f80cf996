"""Read a CSV with named columns as a log.

The first line that does not begin with `#` names the columns: a quantity and its unit, such as `p_radps` or
`gyro_x (deg/s)`. Capitals, blanks, dots and brackets do not matter. Axes are front, right, down. Empty cells are
samples that were not taken, so signals of different rates can share a table. Semicolons may separate columns, with
commas or points in the numbers.

| signal | columns | units |
|---|---|---|
| time, needed | time, t, timestamp | s, ms, us, ns |
| gyro, needed | p q r, gyro_x …, omega_x … | radps, rad_s, dps, deg_s |
| torque command | roll_cmd pitch_cmd yaw_cmd, torque_x … | none for -1..1, nm |
| motor commands | m1, m2, …, motor1, motor_1 | none for 0..1, pct, us and pwm (1000..2000), u16 |
| accelerometer | acc_x …, ax … | mps2, m_s2, g |
| attitude | roll pitch yaw, phi theta psi | rad, deg |
| its set-point | roll_ref …, roll_sp …, roll_des … | rad, deg |
| in the air | airborne | none for 0 or 1 |
"""

import math
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from firmware_model.config.files import MIB, open_regular
from firmware_model.config.validation import sanitize_line
from gustproof.logs.read.assemble import Draft, Rows, stack
from gustproof.logs.read.flight_log import CommandUnit
from gustproof.logs.read.unit_check import check_rates
from gustproof.types import Array

_HEADER = 64 * 1024  # [bytes] of names
_COLUMNS = 1000
_NUMBERS = 12_000_000  # of the columns that are used: eleven minutes of 18 at 1 kHz
_FEW_DAMAGED = 0.05  # of the rows; of more the first is told
_LARGEST = 256 * MIB
_OFTEN, _OVER = 0.95, 1.5  # a quantile of commands without a unit, and what it may reach
_DEGREE = math.pi / 180.0

_Units = Mapping[str, tuple[float, float]]
_TIMES: _Units = {"s": (1e6, 0.0), "ms": (1e3, 0.0), "us": (1.0, 0.0), "ns": (1e-3, 0.0)}
_RATES: _Units = {
    **dict.fromkeys(("radps", "rad_s", "rad_per_s"), (1.0, 0.0)),
    **dict.fromkeys(("dps", "degps", "deg_s", "deg_per_s"), (_DEGREE, 0.0)),
}
_ANGLES: _Units = {"rad": (1.0, 0.0), "deg": (_DEGREE, 0.0)}
_FORCES: _Units = {**dict.fromkeys(("mps2", "m_s2", "m_s_2"), (1.0, 0.0)), "g": (9.80665, 0.0)}
_SHARES: _Units = {"": (1.0, 0.0)}
_TORQUES: _Units = {"nm": (1.0, 0.0), "n_m": (1.0, 0.0)}
_MOTORS: _Units = {
    "": (1.0, 0.0),
    "pct": (0.01, 0.0),
    **dict.fromkeys(("us", "pwm"), (1e-3, 1000.0)),
    "u16": (1.0 / 65535.0, 0.0),
}
_AXES = ("x", "y", "z")
_ANGLE_NAMES = (("roll", "phi"), ("pitch", "theta"), ("yaw", "psi"))


def _by_axis(*stems: str) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(stem.format(axis) for stem in stems) for axis in _AXES)


def _by_angle(*suffixes: str) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(name + suffix for name in names for suffix in suffixes) for names in _ANGLE_NAMES)


_TORQUE_NAMES = tuple(
    angle + torque
    for angle, torque in zip(_by_angle("_cmd", "_command"), _by_axis("torque_{}", "torque_cmd_{}"), strict=True)
)
_SIGNALS: tuple[tuple[str, tuple[tuple[str, ...], ...], _Units], ...] = (
    (
        "gyro",
        tuple((p, *names) for p, names in zip("pqr", _by_axis("gyro_{}", "gyro{}", "omega_{}"), strict=True)),
        _RATES,
    ),
    ("command", _TORQUE_NAMES, _TORQUES),
    ("command", _TORQUE_NAMES, _SHARES),
    ("accelerometer", _by_axis("acc_{}", "accel_{}", "a{}"), _FORCES),
    ("attitude", _by_angle(""), _ANGLES),
    ("reference", _by_angle("_ref", "_sp", "_setpoint", "_des"), _ANGLES),
)
"""Signal, accepted names of each of its columns, and units."""


class _Column(NamedTuple):
    """A column that is used."""

    place: int
    """Place in the table."""
    scale: float
    """SI unit of a step of the column's numbers."""
    zero: float
    """Number in the column that is zero."""


def read_table(path: Path) -> Draft:
    """Return the signals of a CSV.

    Raises
    ------
    OSError
        If the file can't be read or is too large.
    ValueError
        If a column is missing or has no unit, or a cell is no number.
    """
    with open_regular(path) as file:
        check_size(file)
        names = read_names(file)
        time = _find_time(names)
        signals = _find_signals(names)
        in_air = _find(names, ("airborne", "in_air"), _SHARES)
        used = sorted({time.place, *(column.place for columns, _ in signals.values() for column in columns)})
        if in_air is not None:
            used = sorted({*used, in_air.place})
        numbers, findings = read_numbers(file, len(names), used)

    def rows(columns: Sequence[_Column]) -> Rows:
        place = [used.index(column.place) for column in (time, *columns)]
        given = np.flatnonzero(~np.isnan(numbers[:, place]).any(axis=1))
        chosen = numbers[given][:, place]
        values = stack([(chosen[:, 1 + i] - each.zero) * each.scale for i, each in enumerate(columns)])
        return Rows(position=given, time_us=chosen[:, 0] * time.scale, values=values)

    has_torque = signals.get("command", ((), _SHARES))[1] is _TORQUES
    _check_shares(names, signals, used, numbers)
    gyro = rows(signals["gyro"][0])
    check_rates(gyro.values)
    return Draft(
        source=path.name,
        system="csv",
        names_units=True,
        rows={name: rows(columns) for name, (columns, _) in signals.items()},
        in_air=rows([in_air]) if in_air is not None else None,
        command_unit=CommandUnit.NEWTON_METRES if has_torque else CommandUnit.NORMALISED,
        findings=findings,
    )


def _check_shares(
    names: Sequence[str], signals: Mapping[str, tuple[list[_Column], _Units]], used: Sequence[int], numbers: Array
) -> None:
    """Refuse commands without a unit that reach far beyond the full scale of 1 that they then have."""
    for units, more in ((_SHARES, ("nm",)), (_MOTORS, ("pct", "us", "u16"))):
        columns = [column for found, each in signals.values() if each is units for column in found]
        for column in (column for column in columns if (column.scale, column.zero) == _SHARES[""]):
            values = np.abs(numbers[:, used.index(column.place)])
            most = float(np.nanquantile(values, _OFTEN)) if not np.isnan(values).all() else 0.0
            if most > _OVER:
                name = sanitize_line(names[column.place])
                ways = ", ".join(f"{name}_{unit}" for unit in more)
                raise ValueError(f"column '{name}' has no unit, then 1 is full; it reaches {most:.4g}: name it {ways}")


def check_size(file: IO[bytes]) -> None:
    """Refuse a table that is too large to be read in minutes."""
    if file.seek(0, 2) > _LARGEST:
        raise ValueError(f"is larger than {_LARGEST / MIB:g} MiB")
    file.seek(0)


def read_names(file: IO[bytes]) -> list[str]:
    """Return the names of the columns in their plain form; the file then stands at the first row."""
    line = b"#"
    while line.startswith(b"#"):
        line = file.readline(_HEADER)
        if len(line) == _HEADER:
            raise ValueError(f"a line at its start has more than {_HEADER:,} bytes: not a CSV")
    if b"\0" in line or not line.strip():
        raise ValueError("no line with the names of columns: not a CSV")
    cells = line.decode("utf-8-sig").split("," if b"," in line else ";")
    if len(cells) > _COLUMNS:
        raise ValueError(f"{len(cells):,} columns; at most {_COLUMNS:,} are allowed")
    return [re.sub(r"[^a-z0-9]+", "_", cell.lower()).strip("_") for cell in cells]


def _first_row(file: IO[bytes]) -> bytes:
    """Return the next row, which is read again."""
    place = file.tell()
    row = file.readline(_HEADER)
    file.seek(place)
    return row


def _find(names: Sequence[str], wanted: Sequence[str], units: _Units) -> _Column | None:
    """Return the first column of a name with one of the units."""
    for name in wanted:
        for unit, (scale, zero) in units.items():
            if (full := f"{name}_{unit}".strip("_")) in names:
                return _Column(names.index(full), scale, zero)
    return None


def _find_time(names: Sequence[str]) -> _Column:
    time = _find(names, ("time", "t", "timestamp"), _TIMES)
    if time is not None:
        return time
    if "timestamp" in names and "gyro_x" in names:
        raise ValueError(
            "a column 'timestamp' without a unit: if it is of the Crazyflie's client, name it time_ms, and gyro.x, "
            "-gyro.y, -gyro.z p_dps, q_dps, r_dps"
        )
    if "timestamp" in names:
        raise ValueError("a column 'timestamp' without a unit: if it is of PX4's ulog2csv, give the .ulg")
    raise ValueError("no column time_s (or time_ms, time_us, time_ns)")


def _find_signals(names: Sequence[str]) -> dict[str, tuple[list[_Column], _Units]]:
    """Return the columns of each signal, with the units they were looked for in."""
    found: dict[str, tuple[list[_Column], _Units]] = {}
    for signal, axes, units in _SIGNALS:
        columns = [_find(names, wanted, units) for wanted in axes]
        if signal in found or (not any(columns) and signal != "gyro"):
            continue
        lacks = [wanted for wanted, column in zip(axes, columns, strict=True) if column is None]
        if lacks:
            raise ValueError(_describe_lack(names, signal, lacks[0], units))
        found[signal] = ([column for column in columns if column is not None], units)
    motors = list(_find_motors(names))
    return {**found, "motors": (motors, _MOTORS)} if motors else found


def _find_motors(names: Sequence[str]) -> Iterator[_Column]:
    number = 1
    while column := _find(names, (f"m{number}", f"motor{number}", f"motor_{number}", f"motor_m{number}"), _MOTORS):
        yield column
        number += 1


def _describe_lack(names: Sequence[str], signal: str, wanted: Sequence[str], units: _Units) -> str:
    """Return an error about a column of a signal that is missing, or has no unit."""
    ways = ", ".join(f"{wanted[0]}_{unit}".strip("_") for unit in units)
    without = next((name for name in names if name in wanted), None)
    if without is not None:
        return f"column '{sanitize_line(without)}' does not say its unit: name it one of {ways}"
    return f"{signal}: a column is missing: {ways}"


def read_numbers(file: IO[bytes], columns: int, used: Sequence[int]) -> tuple[Array, list[str]]:
    """Return the numbers (n, len(used)) of the rows that follow, and what was left out; NaN where a cell is empty.

    A few rows that are damaged are left out; of more the first is refused.
    """
    start, row = file.tell(), _first_row(file)
    separator = ";" if b";" in row else ","  # of a country of decimal commas, where semicolons separate
    decimal = "," if separator == ";" and b"," in row else "."
    findings = ["file: semicolons separate its columns"] * (separator == ";")
    numbers, fault = _read_sound(file, columns, used, separator, decimal)
    if fault:
        file.seek(start)
        numbers, count = _read_damaged(file, columns, used, separator.encode(), decimal.encode())
        if count > _FEW_DAMAGED * len(numbers) or len(numbers) == 0:
            raise ValueError(fault)
        findings.append(f"file: {count:,} rows are damaged: left out")
    return numbers, findings


def _read_sound(file: IO[bytes], columns: int, used: Sequence[int], separator: str, decimal: str) -> tuple[Array, str]:
    """Return the numbers of the rows that follow, and an empty text; of a damaged table what is wrong with it."""
    import pyarrow  # the reader converts the wanted columns alone, block by block
    from pyarrow import csv

    names = [str(i) for i in range(columns)]
    wanted = [names[i] for i in used]
    options: dict[str, Any] = {
        "read_options": csv.ReadOptions(column_names=names, use_threads=False),
        "parse_options": csv.ParseOptions(delimiter=separator),
        "convert_options": csv.ConvertOptions(
            decimal_point=decimal, column_types=dict.fromkeys(wanted, pyarrow.float64()), include_columns=wanted
        ),
    }
    blocks, count = [np.empty((0, len(used)))], 0
    try:
        for batch in csv.open_csv(file, **options):
            blocks.append(stack([column.to_numpy(zero_copy_only=False) for column in batch.columns]))
            count += blocks[-1].size
            _check_count(count)
    except pyarrow.ArrowInvalid as error:
        text = str(error).splitlines()[0]
        return blocks[0], re.sub(r"In CSV column #(\d+)", lambda match: f"column {int(match[1]) + 1}", text)
    return np.concatenate(blocks), ""


def _check_count(count: int) -> None:
    if count > _NUMBERS:
        raise ValueError(f"more than {_NUMBERS:,} numbers in the columns that are used: cut it")


def _read_damaged(
    file: IO[bytes], columns: int, used: Sequence[int], separator: bytes, decimal: bytes
) -> tuple[Array, int]:
    """Return the numbers of the rows that are sound, and the number of the others."""
    numbers, damaged = array("d"), 0
    while line := file.readline(_HEADER):
        cells = line.strip().replace(b'"', b"").split(separator)
        try:
            if len(cells) != columns:
                raise ValueError
            numbers.extend([float(cells[i].replace(decimal, b".") or math.nan) for i in used])
        except ValueError:
            damaged += bool(line.strip())
        _check_count(len(numbers))
    return np.frombuffer(numbers).reshape(-1, len(used)), damaged
