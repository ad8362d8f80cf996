"""Write files and folders whole: a full disk, an interruption or another process never leaves half of one.

What is written stands beside its place under a hidden, unique name until it is complete. No link is followed.
"""

import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from pathlib import Path
from stat import S_IMODE
from typing import IO

from firmware_model.errors import ConfigError, naming

UNFINISHED_PREFIX = ".gustproof-"
"""Start of the name of what is unfinished; a killed writer leaves it behind."""
OVERWRITES: ContextVar[bool] = ContextVar("OVERWRITES", default=True)
"""True if files that exist may be written over; a command line refuses that, unless it is asked for."""
_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


@contextmanager
def whole_file(path: Path, *, overwrite: bool | None = None) -> Iterator[IO[bytes]]:
    """Yield a new binary file, which takes the place of `path` at the end, synced to disk; on an error nothing changes.

    An existing file is replaced, and its mode kept, only with `overwrite`; `OVERWRITES` is the default.

    Raises
    ------
    OSError
        If it exists and is not to be replaced, or can't be written; the error names `path`.
    """
    unfinished = _beside(path)
    with _naming(path, unfinished):
        try:
            with open(os.open(unfinished, _NEW_FILE, 0o666), "wb") as file:  # noqa: PTH123
                yield file
                file.flush()
                os.fsync(file.fileno())
            _put_file(unfinished, path, overwrite=OVERWRITES.get() if overwrite is None else overwrite)
        except BaseException:
            unfinished.unlink(missing_ok=True)
            raise


def write_files(texts: Mapping[Path, str]) -> None:
    """Write texts as UTF-8 to files that belong together; none takes its place before all are complete.

    Raises
    ------
    OSError
        If one exists and is not to be replaced, or can't be written; the error names it.
    """
    with ExitStack() as stack:
        for path, text in texts.items():
            file = stack.enter_context(whole_file(path))
            with naming(path):  # the stack would name the last file
                file.write(text.encode())
                file.flush()


def write_folder(path: Path, contents: Mapping[str, str | bytes]) -> None:
    """Write texts as UTF-8, and bytes, to a new folder; their keys are the paths inside it.

    With `OVERWRITES` it also replaces a folder, if that has no other files.

    Raises
    ------
    ConfigError
        If the folder exists, and is not to be replaced or has other files.
    OSError
        If it can't be written; the error names it.
    """
    check_folder(path, contents)
    unfinished = _beside(path)
    with _naming(path, unfinished):
        try:
            unfinished.mkdir()
            for name, content in contents.items():
                (unfinished / name).parent.mkdir(parents=True, exist_ok=True)
                (unfinished / name).write_bytes(content.encode() if isinstance(content, str) else content)
            _put_folder(unfinished, path)
        except BaseException:
            shutil.rmtree(unfinished, ignore_errors=True)
            raise


def check_folder(path: Path, names: Iterable[str] | None = None) -> None:
    """Refuse a folder with files; with `OVERWRITES` only one with others than `names`, or than none known yet.

    Raises
    ------
    ConfigError
        If it is refused; an empty folder is not.
    """
    if not os.path.lexists(path):
        return
    if path.is_symlink() or not path.is_dir():
        raise ConfigError(f"{path}: exists already, and is no folder")
    found = [file.relative_to(path).as_posix() for file in path.rglob("*") if not file.is_dir() or file.is_symlink()]
    if found and not OVERWRITES.get():
        raise ConfigError(f"{path}: exists already; --force overwrites it")
    if names is not None and (others := sorted(set(found) - set(names))):
        raise ConfigError(f"{path}: holds other files, such as {others[0]}; no folder with them is overwritten")


@contextmanager
def _naming(path: Path, unfinished: Path) -> Iterator[None]:
    """Name `path` in an OSError that names no file, or what is unfinished; another file's name stays."""
    try:
        yield
    except OSError as error:
        named = None if error.filename is None else os.fsdecode(error.filename)
        other = named is not None and not named.startswith(str(unfinished))
        raise OSError(error.errno, error.strerror or str(error), named if other else str(path)) from None


def _beside(path: Path) -> Path:
    return path.with_name(f"{UNFINISHED_PREFIX}{os.urandom(8).hex()}")


def _put_file(unfinished: Path, path: Path, *, overwrite: bool) -> None:
    if overwrite:
        if path.is_file() and not path.is_symlink():
            unfinished.chmod(S_IMODE(path.stat().st_mode))
        unfinished.replace(path)
        return
    try:
        os.link(unfinished, path)  # fails where a file came meanwhile, which a test before could not tell
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        if os.path.lexists(path):
            raise FileExistsError(17, "File exists") from None
        unfinished.replace(path)
        return
    unfinished.unlink()


def _put_folder(unfinished: Path, path: Path) -> None:
    if not (path.is_dir() and any(path.iterdir())):
        unfinished.rename(path)  # an empty folder gives way
        return
    old = _beside(path)
    path.rename(old)
    try:
        unfinished.rename(path)
    except BaseException:
        old.rename(path)
        raise
    shutil.rmtree(old)
