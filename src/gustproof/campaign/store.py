"""Where a campaign's runs are kept: parts in a folder beside the output while it is flown, one Parquet file at its end.

Nothing half-written is ever read: a part, and the file, come to their names whole. What was flown before Ctrl-C, a kill
or a power loss is not flown again. Parts are in Arrow's own format, written in a fifth of the time that Parquet takes.
"""

import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import pyarrow as pa
import pyarrow.parquet as pq

from firmware_model.config.files import parse_json, read_text
from firmware_model.errors import ConfigError
from firmware_model.recording.durable_file import open_locked
from gustproof.campaign.plan import Campaign
from gustproof.campaign.worker import Chunk, schema
from gustproof.errors import FlightError

ROW_GROUP = 16_384
"""Rows of the file that are written at once: what its memory is bounded by."""
METADATA_KEY = "gustproof"
"""Key of the campaign in the file's metadata, as JSON."""
_PART = re.compile(r"(\d+)-(\d+)\.arrow")
_DICTIONARY_COLUMNS = ["law", "failure"]  # columns in which few values come often; numbers seldom repeat


class Store:
    """Parts of one campaign, held by one process at a time.

    Raises
    ------
    ConfigError
        If the output's folder is not there, its parts are of another campaign, or another process flies this one.
    """

    def __init__(self, output: Path, campaign: Campaign) -> None:
        self._output, self._campaign = output, campaign
        self.folder = output.with_name(f"{output.name}.parts")
        """Folder of the parts."""
        if not output.parent.is_dir():
            raise ConfigError(f"{output.parent}: no such folder")
        self.folder.mkdir(exist_ok=True)
        self._lock = open_locked(self.folder / "lock")
        if self._lock is None:
            raise ConfigError(f"{output}: another process is flying this campaign")
        self._parts: dict[int, tuple[int, Path]] = {}

    def __enter__(self) -> Self:
        try:
            self._check_metadata()
            self._find_parts()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def _close(self) -> None:
        if self._lock is not None:
            self._lock.close()

    @property
    def flown(self) -> int:
        """Number of runs in the parts."""
        return sum(count for count, _ in self._parts.values())

    def missing(self) -> list[Chunk]:
        """Return the runs that are in no part, in stretches of one law each."""
        gaps, at = [], 0
        for first, (count, _) in [*sorted(self._parts.items()), (self._campaign.runs, (0, Path()))]:
            while at < first:
                end = min(first, (at // self._campaign.cases + 1) * self._campaign.cases)
                gaps.append(Chunk(at, end - at))
                at = end
            at = first + count
        return gaps

    def add(self, stretch: Chunk, table: Any) -> None:
        """Keep the rows of a stretch of runs."""
        path = self.folder / f"{stretch.first:012d}-{stretch.runs}.arrow"

        def write(file: Any) -> None:
            with pa.ipc.new_file(file, table.schema) as writer:
                writer.write_table(table)

        _write_atomic(path, write)
        self._parts[stretch.first] = (stretch.runs, path)

    def finish(self) -> None:
        """Write all rows, in the order of the runs, as one file, and remove the parts.

        The bytes do not depend on how the runs were cut into parts.
        """
        if self.missing():
            raise FlightError(f"{self._output}: not all runs are there")

        def write(file: Any) -> None:
            kinds = schema(self._campaign).with_metadata({METADATA_KEY: json.dumps(self._campaign.note())})
            with pq.ParquetWriter(file, kinds, compression="zstd", use_dictionary=_DICTIONARY_COLUMNS) as writer:
                for rows in self._row_groups():
                    writer.write_table(rows, row_group_size=ROW_GROUP)

        _write_atomic(self._output, write)
        self._close()
        shutil.rmtree(self.folder)

    def _row_groups(self) -> Iterator[Any]:
        """Yield all rows in stretches of `ROW_GROUP`; the last one may be shorter."""
        waiting: list[Any] = []
        for _, (_, path) in sorted(self._parts.items()):
            waiting.append(_read(path))
            while sum(table.num_rows for table in waiting) >= ROW_GROUP:
                joined = pa.concat_tables(waiting).combine_chunks()
                yield joined.slice(0, ROW_GROUP).combine_chunks()
                waiting = [joined.slice(ROW_GROUP)]
        if waiting and (rest := pa.concat_tables(waiting)).num_rows:
            yield rest.combine_chunks()

    def _check_metadata(self) -> None:
        path, note = self.folder / "campaign.json", self._campaign.note()
        text = json.dumps(note, sort_keys=True)
        if not path.exists():
            _write_atomic(path, lambda file: file.write(text.encode()))
            return
        try:
            theirs = parse_json(read_text(path))
        except (OSError, ValueError):
            theirs = {}
        check_same_campaign(theirs, json.loads(text), f"{self.folder}: holds parts of another campaign")

    def _find_parts(self) -> None:
        for path in sorted(self.folder.iterdir()):
            if path.suffix == ".tmp":
                path.unlink()
            elif named := _PART.fullmatch(path.name):
                first, count = map(int, named.groups())
                if _count_rows(path) == count:
                    self._parts[first] = (count, path)
                else:  # what a lost disk cache leaves
                    path.unlink()


def check_same_campaign(theirs: dict[str, Any], ours: dict[str, Any], complaint: str) -> None:
    """Refuse a campaign that is not the one asked for.

    Raises
    ------
    ConfigError
        If they differ; says in what.
    """
    keys = [key for key in ours if theirs.get(key) != ours[key]]
    if keys:
        raise ConfigError(
            f"{complaint}: {', '.join(keys)} differ{'s' if len(keys) == 1 else ''}; give another -o, or remove it"
        )


def _read(path: Path) -> Any:
    alone = pa.ipc.IpcReadOptions(use_threads=False)  # to wake others takes longer than to read
    return pa.ipc.open_file(str(path), options=alone).read_all()


def _count_rows(path: Path) -> int:
    try:
        return int(_read(path).num_rows)
    except (pa.ArrowInvalid, OSError):
        return -1


def _write_atomic(path: Path, write: Any) -> None:
    """Let `write` fill a file that comes to its name when it is on the disk."""
    unfinished = path.with_name(f"{path.name}.tmp")
    try:
        with unfinished.open("wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError as error:
        raise FlightError(f"{path}: {error.strerror or error}; what was flown before stays") from None
