"""Keep machine code between processes, in files that nobody else can write and no damage can pass through.

To load machine code is to run it, and numba unpickles its files unseen. Here a file counts only if this user or root
owns it, no one else may write it, and it holds the SHA-256 of its name and content. Any other file is as good as none:
the code is compiled again. A power loss, a full disk, another version and another user are all the same case.
"""

import hashlib
import os
import pickle
import stat
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from numba.core import caching

_DIGEST = 32  # [bytes] of SHA-256
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_OPEN = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)  # a pipe must not block


class KeptCode(NamedTuple):
    """Place and state of the machine code of an entry point."""

    folder: Path
    """Folder of its files."""
    warm: bool
    """True if code of these sources is there."""
    temporary: bool
    """True if the folder is a temporary one: no lasting one is writable."""


class CodeCache(caching.FunctionCache):  # type: ignore[misc]  # numba has no types
    """Machine code of one entry point; `None` and nothing else if a file of it can't be used."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        base = f"{self._impl.filename_base}.sealed"  # no file of numba's own has that name
        self._cache_file = _CodeFile(self._cache_path, base, self._impl.locator.get_source_stamp())
        _CACHES.append(self)

    def set_stamp(self, stamp: object) -> None:
        """Let code count only if it was made of sources with this stamp."""
        self._cache_file._source_stamp = stamp

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code for a signature; `None` if there is none, whatever is wrong with it.

        numba would first load all that a compiler can need, which takes longer than all other work of a start. It does
        so again before it compiles.
        """
        try:
            return self._load_overload(sig, target_context)
        except Exception:  # unpickled objects raise anything; what can't be loaded is compiled
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code for a signature, if the disk takes it."""
        try:
            super().save_overload(sig, data)
        except OSError:
            return

    @property
    def kept(self) -> KeptCode:
        """Place and state of the code."""
        temporary = isinstance(self._impl.locator, _TemporaryFolder)
        return KeptCode(Path(self._cache_path), bool(self._cache_file._load_index()), temporary)

    def find_damaged(self) -> list[Path]:
        """Return the files that are there and can't be used."""
        return self._cache_file.find_damaged()


_CACHES: list[CodeCache] = []


def find_damaged() -> list[Path]:
    """Return the files of the entry points of this process that are there and can't be used."""
    return [path for cache in _CACHES for path in cache.find_damaged()]


class _CodeFile(caching.IndexDataCacheFile):  # type: ignore[misc]
    """Index and data of an entry point, each sealed by `_seal`."""

    def load(self, key: Any) -> Any:
        name = self._load_index().get(key)
        content = None if name is None else _read_sealed(Path(self._data_path(name)))
        return None if content is None else pickle.loads(content)

    def _load_index(self) -> dict[Any, str]:
        content = _read_sealed(Path(self._index_path))
        if content is None or content[:_DIGEST] != self._made_of():
            return {}
        try:
            overloads: dict[Any, str] = pickle.loads(content[_DIGEST:])
        except Exception:  # of classes that another package has renamed
            return {}
        return overloads

    def _save_index(self, overloads: dict[Any, str]) -> None:
        _write_sealed(Path(self._index_path), self._made_of() + self._dump(overloads))

    def _save_data(self, name: str, data: Any) -> None:
        _write_sealed(Path(self._data_path(name)), self._dump(data))

    def _made_of(self) -> bytes:
        """Return the SHA-256 of the sources' stamp and numba's version."""
        return hashlib.sha256(repr((self._version, self._source_stamp)).encode()).digest()

    def find_damaged(self) -> list[Path]:
        files = [Path(self._index_path), *(Path(self._data_path(name)) for name in self._load_index().values())]
        return [path for path in files if path.exists() and _read_sealed(path) is None]


def _seal(name: str, content: bytes) -> bytes:
    """Return the SHA-256 of a file's name and content: none can be damaged, nor stand for another."""
    return hashlib.sha256(name.encode() + b"\0" + content).digest()


def _write_sealed(path: Path, content: bytes) -> None:
    """Write a file that its owner alone can read and write, and rename it into place."""
    descriptor, unfinished = tempfile.mkstemp(dir=path.parent, prefix=f"{path.name}.")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(_seal(path.name, content) + content)
        Path(unfinished).replace(path)
    except BaseException:
        Path(unfinished).unlink(missing_ok=True)
        raise


def _read_sealed(path: Path) -> bytes | None:
    """Return the content of a file; `None` if it is not there, others can have written it, or it is damaged."""
    try:
        with os.fdopen(os.open(path, _OPEN), "rb") as file:
            about = os.fstat(file.fileno())
            if not (stat.S_ISREG(about.st_mode) and _is_ours(about)):
                return None
            whole = file.read()
    except OSError:
        return None
    content = whole[_DIGEST:]
    return content if whole[:_DIGEST] == _seal(path.name, content) else None


def _is_ours(about: os.stat_result) -> bool:
    """Return whether only this user, or root, can have written what `about` is of, where the system tells."""
    return os.name == "nt" or (about.st_uid in (os.geteuid(), 0) and not about.st_mode & _OTHERS_WRITE)


class _TemporaryFolder(caching.UserWideCacheLocator):  # type: ignore[misc]
    """A folder of this user for temporary files, for an installation and a home that can't be written."""

    def __init__(self, function: Any, file: str) -> None:
        super().__init__(function, file)
        user = os.geteuid() if os.name != "nt" else 0
        self._top = Path(tempfile.gettempdir(), f"gustproof-{user}")
        self._cache_path = str(self._top / self.get_suitable_cache_subpath(file))

    def ensure_cache_path(self) -> None:
        """Make the folder.

        Raises
        ------
        OSError
            If it can't be made, or is another user's. If it would be in the current folder, where files may come from
            anywhere: Python's last resort for temporary ones.
        """
        if self._top.parent == Path.cwd():
            raise PermissionError(self._top)
        self._top.mkdir(mode=0o700, exist_ok=True)
        about = self._top.lstat()
        if not (stat.S_ISDIR(about.st_mode) and _is_ours(about)):
            raise PermissionError(self._top)
        super().ensure_cache_path()


class _Places(caching.CompileResultCacheImpl):  # type: ignore[misc]
    """Folders in the order of preference: NUMBA_CACHE_DIR, beside the source, of the user, a temporary one."""

    _locator_classes = (
        caching.UserProvidedCacheLocator,
        caching.InTreeCacheLocator,
        caching.UserWideCacheLocator,
        _TemporaryFolder,
    )


CodeCache._impl_class = _Places
