"""A campaign's file, read again: what was flown, and its rows."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from firmware_model.config.files import TEXT, open_regular, parse_json
from firmware_model.errors import ConfigError
from gustproof.campaign.plan import Campaign, parse_campaign
from gustproof.campaign.sampling import Array
from gustproof.campaign.store import METADATA_KEY

_VALUE = 64  # [bytes] that a value takes at most, on average; a number takes 8


def read_campaign_metadata(path: Path) -> dict[str, Any]:
    """Return what a campaign's file says of itself.

    Raises
    ------
    ConfigError
        If it is not a campaign's file.
    """
    try:
        open_regular(path).close()
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    try:
        about = pq.read_metadata(path)
        note: dict[str, Any] = parse_json((about.metadata or {})[METADATA_KEY.encode()])
        groups = [about.row_group(i).total_byte_size for i in range(about.num_row_groups)]
        rows = note["runs"] * len(note["laws"])
    except (KeyError, OSError, TypeError, ValueError, pa.ArrowException):
        raise ConfigError(f"{path}: no table of a campaign") from None
    if about.num_rows != rows or sum(groups) > _VALUE * rows * about.num_columns + TEXT:
        raise ConfigError(f"{path}: its rows are not those of the campaign that it says it is of")
    return note


def read_campaign(path: Path) -> Campaign:
    """Return the campaign that a file's rows are of.

    Raises
    ------
    ConfigError
        If it is not a campaign's file.
    """
    return parse_campaign(read_campaign_metadata(path), path)


def read_run(path: Path, run: int) -> dict[str, Any]:
    """Return the row of a run; what it lacks is `None`.

    Raises
    ------
    ConfigError
        If there is no such run.
    """
    rows = pq.read_table(path, filters=[("run", "=", run)]).to_pylist()
    if not rows:
        raise ConfigError(f"{path}: no run {run}, they are 0 to {pq.read_metadata(path).num_rows - 1}")
    row: dict[str, Any] = rows[0]
    return row


def open_table(path: Path) -> Any:
    """Return the file to read columns from, a `pyarrow.parquet.ParquetFile`."""
    return pq.ParquetFile(path, memory_map=True)


def read_column(file: Any, name: str, campaign: Campaign) -> Array:
    """Return a column as numbers, (laws, cases), units as its name or `Metrics` says; NaN where a run has none."""
    column = file.read(columns=[name], use_threads=False).column(0).to_numpy().astype(np.float64)
    values: Array = column.reshape(len(campaign.laws), campaign.cases)
    return values
