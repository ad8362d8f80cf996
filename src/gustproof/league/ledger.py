"""Table of results that only grows: a line for each finished task, synced to disk, addressed by content.

The key of a result is the SHA-256 of everything that it depends on. So a resumed league, one with more entries, and one
with other runs take from the table what is theirs, and nothing else.
"""

import hashlib
import json
import os
from pathlib import Path
from typing import Any, Self

from pydantic_core import to_jsonable_python

from firmware_model.errors import ConfigError
from firmware_model.recording.durable_file import open_locked
from gustproof.errors import FlightError

Result = dict[str, Any]


def content_key(**parts: Any) -> str:
    """Return the key of a result that depends on `parts`, JSON values or records of them."""
    text = json.dumps(to_jsonable_python(parts, inf_nan_mode="constants"), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


class Ledger:
    """Results by key, in a folder that one process at a time holds.

    Raises
    ------
    ConfigError
        If the folder can't be made, or another process holds it.
    """

    def __init__(self, folder: Path) -> None:
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{folder}: {error.strerror}") from None
        self._path = folder / "results.jsonl"
        self._lock = open_locked(folder / "lock")
        if self._lock is None:
            raise ConfigError(f"{folder}: another process flies this league")
        self._results, sound = _read(self._path)
        self._file = self._path.open("ab")
        self._file.truncate(sound)  # a line that a kill tore

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        if self._lock is not None:
            self._lock.close()

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Result:
        return self._results[key]

    def add(self, key: str, result: Result) -> None:
        """Append a result and sync it.

        Raises
        ------
        FlightError
            If the disk is full; finished results stay.
        """
        try:
            self._file.write(json.dumps({"key": key, **result}).encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise FlightError(f"{self._path}: {error.strerror}; finished results stay") from None
        self._results[key] = result


def _read(path: Path) -> tuple[dict[str, Result], int]:
    """Return the results of a file by key, and the length [bytes] of its sound part."""
    results: dict[str, Result] = {}
    sound = 0
    if not path.exists():
        return results, sound
    with path.open("rb") as file:
        for line in file:
            try:
                result: Result = json.loads(line)
                key = result.pop("key")
            except (ValueError, AttributeError, KeyError):
                break
            if not line.endswith(b"\n"):
                break
            results[key] = result
            sound += len(line)
    return results, sound
