"""Append-only file that stays intact up to its last write if the process or the machine dies."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import IO, Any

from firmware_model.errors import RecordingError

fcntl: Any
try:
    import fcntl
except ImportError:  # not every system has it
    fcntl = None

_SYNC_S = 1.0  # wall time; a power loss costs this much, besides a write in progress


class AppendOnlyFile:
    """New file, locked while it grows. Its own thread syncs it to disk, as that can take long.

    Raises
    ------
    OSError
        If the file exists or can't be created.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = path.open("xb", buffering=0)
        if fcntl is not None:
            fcntl.flock(self._file, fcntl.LOCK_EX)
        self._closing = Event()
        self._sync_thread = Thread(target=self._sync_loop, daemon=True)
        self._sync_thread.start()

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Hand all of `data` to the operating system.

        Raises
        ------
        RecordingError
            If the write fails; earlier writes stay in the file.
        """
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise RecordingError(f"{self._path}: {error.strerror}") from None

    def close(self) -> None:
        """Close the file and release its lock."""
        self._closing.set()
        self._sync_thread.join()
        self._file.close()

    def _sync_loop(self) -> None:
        while not self._closing.wait(_SYNC_S):
            os.fsync(self._file.fileno())


def open_locked(path: Path) -> IO[bytes] | None:
    """Return a file, locked until it is closed or its process ends; `None` if another process holds the lock."""
    file = path.open("ab")
    if fcntl is not None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            return None
    return file


@contextmanager
def locked_folder(folder: Path) -> Iterator[bool]:
    """Lock a folder; yield False if another process holds the lock or has removed the folder.

    Where there are no file locks, or none of folders, it is True.
    """
    if fcntl is None:
        yield True
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except FileNotFoundError:
        yield False
        return
    try:
        yield _lock(descriptor) and folder.is_dir() and os.path.samestat(os.fstat(descriptor), folder.stat())
    finally:
        os.close(descriptor)


def _lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some file systems of networks lock no folders
        return True
    return True


def is_growing(path: Path) -> bool:
    """Return whether a process is writing the file now; always False on systems without file locks."""
    if fcntl is None or not path.is_file():  # opening a pipe would wait for its writer
        return False
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
