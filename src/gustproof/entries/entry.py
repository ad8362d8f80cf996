"""An entry: a controller that its user brings, named as on the command line."""

import hashlib
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from firmware_model.errors import ConfigError
from gustproof.law.form import Law

PROGRAM_PREFIX = "exec:"
_SOURCES = "MODULE.py:MAKER, LIBRARY.so or 'exec: COMMAND'"


class EntryKind(Enum):
    """Ways in which a controller is brought."""

    PYTHON = "python"
    """Function of a Python file that makes the controller object, as `my_mpc.py:make`."""
    LIBRARY = "library"
    """C library with the functions that `export --c` writes, as `law.so`."""
    PROGRAM = "program"
    """Command of a program that speaks MAVLink, as `exec: node mine.mjs`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A controller that is no law file."""

    kind: EntryKind
    """Way in which it is brought."""
    source: str
    """Text that names it on the command line."""
    name: str
    """Name in texts and files."""
    digest: str
    """SHA-256 of its file; empty for a program."""

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as JSON values."""
        return {"kind": self.kind.value, "source": self.source, "name": self.name, "digest": self.digest}


Pilot = Law | Entry
"""Whatever computes the commands of a flight here."""


def parse_entry(source: str) -> Entry:
    """Return the entry that a text names.

    Raises
    ------
    ConfigError
        If the text names no entry, or its file can't be read.
    """
    if source.startswith(PROGRAM_PREFIX):
        words = source.removeprefix(PROGRAM_PREFIX).split()
        if not words:
            raise ConfigError(f"controller '{source}': names no command")
        return Entry(kind=EntryKind.PROGRAM, source=source, name=Path(words[-1]).stem, digest="")
    file, colon, maker = source.rpartition(":")
    if colon and file.endswith(".py") and maker.isidentifier():
        return Entry(kind=EntryKind.PYTHON, source=source, name=Path(file).stem, digest=_digest(source, file))
    if source.endswith((".so", ".dylib", ".dll")):
        return Entry(kind=EntryKind.LIBRARY, source=source, name=Path(source).stem, digest=_digest(source, source))
    raise ConfigError(f"controller '{source}': is none of {_SOURCES}")


def _digest(source: str, file: str) -> str:
    try:
        return hashlib.sha256(Path(file).read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(f"controller '{source}': {error.strerror}") from None
