"""Read a campaign's file: its description and its rows."""

from collections.abc import Iterator
from contextlib import contextmanager
from os import SEEK_END
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from firmware_model.config.files import TEXT, open_regular, parse_json, tell_kind
from firmware_model.errors import ConfigError
from gustproof.studies.campaign.plan import Campaign, parse_campaign
from gustproof.studies.campaign.store import METADATA_KEY
from gustproof.types import Array

_MAGIC = b"PAR1"  # at both ends of a Parquet file
_VALUE = 64  # [bytes] largest mean size of a value; a number takes 8


def read_campaign_metadata(path: Path) -> dict[str, Any]:
    """Return the metadata of a campaign's file.

    Raises
    ------
    ConfigError
        If the file is no campaign's table.
    """
    try:
        with open_regular(path) as file:
            begin = file.read(4)
            file.seek(-len(begin), SEEK_END)
            end = file.read(4)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    if not begin:
        raise ConfigError(f"{path}: is empty")
    if begin == _MAGIC != end:
        raise ConfigError(f"{path}: no table of a campaign, or one that is cut short")
    told = "" if begin == _MAGIC else tell_kind(path)
    try:
        about = pq.read_metadata(path)
        metadata: dict[str, Any] = parse_json((about.metadata or {})[METADATA_KEY.encode()])
        groups = [about.row_group(i).total_byte_size for i in range(about.num_row_groups)]
        rows = metadata["runs"] * len(metadata["laws"])
    except (KeyError, OSError, TypeError, ValueError, pa.ArrowException):
        raise ConfigError(f"{path}: no table of a campaign{told}") from None
    if about.num_rows != rows or sum(groups) > _VALUE * rows * about.num_columns + TEXT:
        raise ConfigError(f"{path}: its rows do not match the campaign in its metadata")
    return metadata


def read_campaign(path: Path) -> Campaign:
    """Return the campaign of a file.

    Raises
    ------
    ConfigError
        If the file is no campaign's table.
    """
    return parse_campaign(read_campaign_metadata(path), path)


def read_run(path: Path, run: int) -> dict[str, Any]:
    """Return the row of a run by column; missing values are `None`.

    Raises
    ------
    ConfigError
        If there is no such run.
    """
    with damage_named(path):
        rows = pq.read_table(path, filters=[("run", "=", run)], page_checksum_verification=True).to_pylist()
    if not rows:
        raise ConfigError(f"{path}: no run {run}, they are 0 to {pq.read_metadata(path).num_rows - 1}")
    row: dict[str, Any] = rows[0]
    return row


def open_table(path: Path) -> Any:
    """Open a campaign's file as a `pyarrow.parquet.ParquetFile`, which tells a damaged page as it is read."""
    return _Table(path)


class _Table(pq.ParquetFile):  # type: ignore[misc]
    def __init__(self, path: Path) -> None:
        super().__init__(path, memory_map=True, page_checksum_verification=True)
        self.path = path

    def read(self, *arguments: Any, **options: Any) -> Any:
        with damage_named(self.path):
            return super().read(*arguments, **options)

    def read_row_group(self, *arguments: Any, **options: Any) -> Any:
        with damage_named(self.path):
            return super().read_row_group(*arguments, **options)


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Name a campaign's file in an error of its pages."""
    try:
        yield
    except (OSError, IndexError, ValueError, pa.ArrowException):  # of names in its footer too
        raise ConfigError(f"{path}: it is damaged") from None


def read_column(file: Any, name: str, campaign: Campaign) -> Array:
    """Return a column as numbers (laws, cases), unit by its name or `Metrics`; NaN where a run has no value."""
    with damage_named(file.path):
        column = file.read(columns=[name], use_threads=False).column(0).to_numpy().astype(np.float64)
        values: Array = column.reshape(len(campaign.laws), campaign.cases)
    return values
