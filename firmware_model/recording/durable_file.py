"""A file that grows while flying, and is whole up to its last write whatever ends the process, or the machine."""

import os
from pathlib import Path
from threading import Event, Thread
from typing import IO, Any

from firmware_model.errors import RecordingError

fcntl: Any
try:
    import fcntl
except ImportError:  # not every system has it
    fcntl = None

_SYNC_S = 1.0  # wall time: what a power loss can take, besides what was being written


class AppendOnlyFile:
    """A new file, locked while it grows; a thread of its own has the disk keep it, as that can take long.

    Raises
    ------
    OSError
        If the file exists or can't be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = path.open("xb", buffering=0)
        if fcntl is not None:
            fcntl.flock(self._file, fcntl.LOCK_EX)
        self._closing = Event()
        self._sync_thread = Thread(target=self._keep, daemon=True)
        self._sync_thread.start()

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Hand all of `data` to the operating system.

        Raises
        ------
        RecordingError
            If it can't be written; what was written before stays.
        """
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise RecordingError(f"{self._path}: {error.strerror}") from None

    def close(self) -> None:
        """Close the file; it may be read by whoever waits for that."""
        self._closing.set()
        self._sync_thread.join()
        self._file.close()

    def _keep(self) -> None:
        while not self._closing.wait(_SYNC_S):
            os.fsync(self._file.fileno())


def open_locked(path: Path) -> IO[bytes] | None:
    """Return a file that is locked until it is closed or its process ends; `None` if another process has it."""
    file = path.open("ab")
    if fcntl is not None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            return None
    return file


def is_growing(path: Path) -> bool:
    """Return whether a process is writing the file at this moment; never where files can't be locked."""
    if fcntl is None or not path.is_file():  # to open a pipe waits for its writer
        return False
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
