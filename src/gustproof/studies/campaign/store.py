"""Storage of a campaign's runs: parts in a folder beside the output during the flights, then one Parquet file.

Parts and file are renamed into place when complete, so nothing half-written is ever read. Runs finished before Ctrl-C,
a kill or a power loss are not flown again. Parts are Arrow files, written in a fifth of the time of Parquet.
"""

import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple, Self

import pyarrow as pa
import pyarrow.parquet as pq

from firmware_model.config.files import parse_json, read_text
from firmware_model.config.whole_file import UNFINISHED_PREFIX, whole_file
from firmware_model.errors import ConfigError
from firmware_model.recording.durable_file import open_locked
from gustproof.errors import FlightError
from gustproof.studies.campaign.plan import Campaign
from gustproof.studies.campaign.worker import Chunk, schema

ROW_GROUP = 16_384
"""Rows written to the file at once; bounds the memory."""
METADATA_KEY = "gustproof"
"""Key of the campaign (JSON) in the file's metadata."""
_PART = re.compile(r"(\d+)-(\d+)\.arrow")
_DICTIONARY_COLUMNS = ["law", "failure"]  # columns with few distinct values


class Shard(NamedTuple):
    """One of several shares of a campaign's cases, each flown by a process of its own, maybe on another machine."""

    number: int
    """Its number, from 1."""
    of: int
    """Number of all."""

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    def cases(self, cases: int) -> tuple[int, int]:
        """Return the first of its cases and the one after its last."""
        return cases * (self.number - 1) // self.of, cases * self.number // self.of


class Store:
    """Parts of one campaign, locked by one process at a time, or by one for each `shard`.

    Raises
    ------
    ConfigError
        If the output's folder is missing, its parts belong to another campaign, or another process flies this one.
    """

    def __init__(self, output: Path, campaign: Campaign, shard: Shard | None = None) -> None:
        self._output, self._campaign, self._shard = output, campaign, shard
        self.folder = parts_folder(output)
        """Folder of the parts."""
        if not output.parent.is_dir():
            raise ConfigError(f"{output.parent}: no such folder")
        self.folder.mkdir(exist_ok=True)
        own = "lock" if shard is None else f"lock-{shard.number}-{shard.of}"
        self._lock = open_locked(self.folder / own)
        if self._lock is None or any(map(_is_locked, self._other_locks(own))):
            self._close()
            raise ConfigError(f"{output}: another process is flying {f'shard {shard}' if shard else 'this campaign'}")
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

    def _other_locks(self, own: str) -> list[Path]:
        """Return the locks of processes that may not run beside this one: other shards may beside a shard."""
        names = "lock" if self._shard else "lock*"
        return [path for path in self.folder.glob(names) if path.name != own]

    def holds(self, first: int) -> bool:
        """Return whether a part begins with a run."""
        return first in self._parts

    def missing_chunks(self) -> list[Chunk]:
        """Return the runs of this shard that are in no part, in chunks of one law each."""
        cases = self._campaign.cases
        low, high = self._shard.cases(cases) if self._shard else (0, cases)
        within = ((max(first, law + low), min(first + runs, law + high)) for law, first, runs in self._gaps())
        return [Chunk(first, end - first) for first, end in within if first < end]

    def _gaps(self) -> Iterator[tuple[int, int, int]]:
        """Yield the runs that are in no part: the first run of their law, their first, and their number."""
        at = 0
        for first, (count, _) in [*sorted(self._parts.items()), (self._campaign.runs, (0, Path()))]:
            while at < first:
                law = at // self._campaign.cases * self._campaign.cases
                end = min(first, law + self._campaign.cases)
                yield law, at, end - at
                at = end
            at = first + count

    def add(self, chunk: Chunk, table: Any) -> None:
        """Store the rows of a chunk of runs."""
        path = self.folder / f"{chunk.first:012d}-{chunk.runs}.arrow"

        def write(file: Any) -> None:
            with pa.ipc.new_file(file, table.schema) as writer:
                writer.write_table(table)

        _write_whole(path, write)
        self._parts[chunk.first] = (chunk.runs, path)

    def finish(self) -> None:
        """Write all rows as one file, in the order of the runs, and remove the parts.

        The bytes do not depend on the division into parts.
        """
        if self.missing_chunks():
            raise FlightError(f"{self._output}: runs are missing")

        def write(file: Any) -> None:
            kinds = schema(self._campaign).with_metadata({METADATA_KEY: json.dumps(self._campaign.metadata())})
            options: dict[str, Any] = {"compression": "zstd", "use_dictionary": _DICTIONARY_COLUMNS}
            with pq.ParquetWriter(file, kinds, **options, write_page_checksum=True) as writer:
                for rows in self._row_groups():
                    writer.write_table(rows, row_group_size=ROW_GROUP)

        _write_whole(self._output, write)
        self._close()
        shutil.rmtree(self.folder)

    def _row_groups(self) -> Iterator[Any]:
        """Yield all rows in tables of `ROW_GROUP` rows; the last one may be shorter."""
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
        path = self.folder / "campaign.json"
        text = json.dumps(self._campaign.metadata(), sort_keys=True)
        held = self._shard is not None or any(_PART.fullmatch(each.name) for each in self.folder.iterdir())
        if not (path.exists() and held):
            _write_whole(path, lambda file: file.write(text.encode()))
            return
        try:
            theirs = parse_json(read_text(path))
        except (OSError, ValueError):
            theirs = {}
        check_same_campaign(theirs, json.loads(text), f"{self.folder}: holds parts of another campaign")

    def _find_parts(self) -> None:
        for path in sorted(self.folder.iterdir()):
            if path.name.startswith(UNFINISHED_PREFIX):
                if self._shard is None:  # else another shard's, which is being written
                    path.unlink()
            elif named := _PART.fullmatch(path.name):
                first, count = map(int, named.groups())
                if _count_rows(path) == count:
                    self._parts[first] = (count, path)
                else:  # truncated by a lost disk cache
                    path.unlink()


def _is_locked(path: Path) -> bool:
    """Return whether another process holds a lock."""
    if (lock := open_locked(path)) is None:
        return True
    lock.close()
    return False


def parts_folder(output: Path) -> Path:
    """Return the folder in which finished runs wait for the others of a campaign."""
    return output.with_name(f"{output.name}.parts")


def check_same_campaign(theirs: dict[str, Any], ours: dict[str, Any], complaint: str) -> None:
    """Check that two campaigns' metadata agree.

    Raises
    ------
    ConfigError
        If they differ; the text begins with `complaint` and names the keys.
    """
    keys = [key for key in ours if theirs.get(key) != ours[key]]
    if keys:
        was = [f"{key} was {theirs[key]}" if isinstance(theirs.get(key), int) else f"{key} differs" for key in keys]
        raise ConfigError(f"{complaint}: {', '.join(was)}; give another -o, or remove it")


def _read(path: Path) -> Any:
    options = pa.ipc.IpcReadOptions(use_threads=False)  # to wake threads takes longer than to read
    return pa.ipc.open_file(str(path), options=options).read_all()


def _count_rows(path: Path) -> int:
    try:
        return int(_read(path).num_rows)
    except (pa.ArrowInvalid, OSError):
        return -1


def _write_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file with `write`, in place of any that is there."""
    try:
        with whole_file(path, overwrite=True) as file:
            write(file)
    except OSError as error:
        raise FlightError(f"{path}: {error.strerror or error}; finished runs stay") from None
