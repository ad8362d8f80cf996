"""Read the CSV files of `replay` tables."""

import csv
import io
import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any, Literal

from firmware_model.config.files import read_text
from firmware_model.config.validation import sanitize_line
from firmware_model.config.waveforms import MAX_ROWS
from firmware_model.errors import ConfigError

_MAX_LINE = 1000  # characters
_FRAMES: dict[tuple[str, ...], Literal["ned", "body"]] = {
    ("wind", "time_s", "north_mps", "east_mps", "down_mps"): "ned",
    ("wind", "time_s", "u_mps", "v_mps", "w_mps"): "body",
    ("moment", "time_s", "north_nm", "east_nm", "down_nm"): "ned",
    ("moment", "time_s", "L_nm", "M_nm", "N_nm"): "body",
}


def fill_replay_rows(document: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return a scenario's document with the rows and frame of its files in each replay that names one.

    Raises
    ------
    ConfigError
        If a file can't be read, or is not a table of numbers below one of the known headers.
    """
    lists = {key: document[key] for key in ("wind", "moment") if isinstance(document.get(key), list)}
    return {**document, **{key: list(_fill_tables(tables, key, path)) for key, tables in lists.items()}}


def _fill_tables(tables: list[Any], key: str, path: Path) -> Iterator[Any]:
    left = MAX_ROWS  # limit of all tables together
    for i, table in enumerate(tables):
        named = isinstance(table, dict) and table.get("kind") == "replay" and isinstance(table.get("file"), str)
        if not named or "rows" in table:
            yield table
            continue
        file = path.parent / table["file"]
        frame, rows = _read_csv(file, key, f"{path}: {key}.{i}.file: {sanitize_line(table['file'])}", left)
        left -= len(rows)
        if table.get("frame", frame) != frame:
            given = sanitize_line(repr(table["frame"]))
            raise ConfigError(f"{path}: {key}.{i}.frame: the file has columns in '{frame}' (given {given})")
        yield {**table, "frame": frame, "rows": rows}


def _read_csv(file: Path, key: str, source: str, most: int) -> tuple[str, list[list[float]]]:
    try:
        lines = (line for line in csv.reader(_lines(read_text(file))) if line)
        header = tuple(name.strip() for name in next(lines, ()))
        frame = _FRAMES.get((key, *header))
        if frame is None:
            known = " or ".join(",".join(names[1:]) for names in _FRAMES if names[0] == key)
            raise ConfigError(f"{source}: the first line must be {known}")
        rows = [_parse_row(line, f"{source}: row {i}") for i, line in enumerate(islice(lines, most + 1), 1)]
    except OSError as error:
        raise ConfigError(f"{source}: {error.strerror}") from None
    except (ValueError, csv.Error) as error:
        raise ConfigError(f"{source}: not CSV: {sanitize_line(str(error))}") from None
    if len(rows) > most:
        raise ConfigError(f"{source}: a scenario's replay tables have at most {MAX_ROWS:,} rows")
    return frame, rows


def _lines(text: str) -> Iterator[str]:
    for i, line in enumerate(io.StringIO(text, newline=""), 1):
        if len(line) > _MAX_LINE:
            raise ValueError(f"line {i} has more than {_MAX_LINE} characters")
        yield line


def _parse_row(line: list[str], source: str) -> list[float]:
    try:
        numbers = [float(text) for text in line]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{source}: must be four numbers (given {','.join(line)[:60]!r})")
    return numbers
