"""An entry: a controller that its user brings, named as on the command line."""

import hashlib
import re
import shlex
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from firmware_model.config.validation import sanitize_line
from firmware_model.errors import ConfigError
from gustproof.law.form import Law

PROGRAM_PREFIX = "exec:"
_LIBRARIES = (".so", ".dylib", ".dll")
_SOURCES = "FILE.py:MAKER, PACKAGE.MODULE:MAKER, LIBRARY.so or 'exec: COMMAND'"


class EntryKind(Enum):
    """Ways in which a controller is brought."""

    PYTHON = "python"
    """Function that makes the controller object, as `my_mpc.py:make` or `package.module:make`."""
    LIBRARY = "library"
    """C library with the functions that `export --c` writes, as `law.so`."""
    PROGRAM = "program"
    """Command of a program that speaks MAVLink, as `exec: node mine.mjs`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A controller that is no law file.

    Examples
    --------
    >>> from gustproof import Entry, parse_entry
    >>> isinstance(parse_entry("exec: node mine.mjs"), Entry)
    True
    """

    kind: EntryKind
    """Way in which it is brought."""
    source: str
    """Text that names it on the command line."""
    name: str
    """Name in texts and files."""
    digest: str
    """SHA-256 of its file; empty for a program."""

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as JSON values, input of `find_entry`."""
        return {"kind": self.kind.value, "source": self.source, "name": self.name, "digest": self.digest}


Pilot = Law | Entry
"""Whatever computes the commands of a flight here."""


def parse_entry(source: str) -> Entry:
    """Return the entry that a text names.

    Raises
    ------
    ConfigError
        If the text names no entry, or its file can't be read.

    Examples
    --------
    >>> from gustproof import parse_entry
    >>> parse_entry("exec: node mine.mjs").name
    'mine'
    """
    if source.startswith(PROGRAM_PREFIX):
        return Entry(kind=EntryKind.PROGRAM, source=source, name=_program_name(split_command(source)), digest="")
    if source.endswith(_LIBRARIES):
        return Entry(kind=EntryKind.LIBRARY, source=source, name=Path(source).stem, digest=_digest(source, source))
    place, _, maker = source.rpartition(":")
    if not maker.isidentifier():
        raise ConfigError(f"controller '{source}': is none of {_SOURCES}")
    file = place if place.endswith(".py") else _find_module(source, place)
    name = Path(file).stem if maker == "make" else f"{Path(file).stem}-{maker}"
    return Entry(kind=EntryKind.PYTHON, source=source, name=name, digest=_digest(source, file))


def split_command(source: str) -> list[str]:
    """Return the words of a program's command, as a shell would split them; no shell is used.

    Raises
    ------
    ConfigError
        If a quote is left open, or there is no word.
    """
    try:
        words = shlex.split(source.removeprefix(PROGRAM_PREFIX))
    except ValueError as error:
        raise ConfigError(f"controller '{source}': {error}") from None
    if not words:
        raise ConfigError(f"controller '{source}': names no command")
    return words


def find_program(source: str) -> list[str]:
    """Return the words of a program's command.

    Raises
    ------
    ConfigError
        If the command is wrong, or its program is not there.
    """
    words = split_command(source)
    if shutil.which(words[0]) is None:
        raise ConfigError(f"controller '{source}': there is no program '{words[0]}'")
    return words


def _program_name(words: Sequence[str]) -> str:
    """Return a name for a program: of the first script among its words, or of itself."""
    scripts = (Path(word) for word in words[1:] if re.fullmatch(r"[^-].*\.[A-Za-z]\w*", word))
    return next(scripts, Path(words[0])).stem


def parse_entry_metadata(document: Any, where: object) -> Entry:
    """Return the entry that `Entry.to_dict` has written, whatever has become of its file.

    Raises
    ------
    ConfigError
        If the document describes no entry; the text begins with `where`.
    """
    try:
        source, name, digest = (str(document[key]) for key in ("source", "name", "digest"))
        return Entry(kind=EntryKind(document["kind"]), source=source, name=name, digest=digest)
    except (KeyError, TypeError, ValueError):
        raise ConfigError(f"{where}: does not say which controller flew") from None


def find_entry(document: Any, where: object) -> Entry:
    """Return the entry that `Entry.to_dict` has written, if its file is still the same.

    Raises
    ------
    ConfigError
        If the document describes no entry, or the file has gone or changed; the text begins with `where`.
    """
    told = parse_entry_metadata(document, where)
    entry = parse_entry(told.source)
    if entry.digest != told.digest:
        changed = f"has changed since: its SHA-256 is not {told.digest[:16]}…"
        raise ConfigError(f"{where}: controller '{told.source}' {changed}")
    return entry


def _find_module(source: str, module: str) -> str:
    """Return the file of a module that can be imported."""
    if not re.fullmatch(r"[^\W\d]\w*(\.[^\W\d]\w*)*", module):
        raise ConfigError(f"controller '{source}': is none of {_SOURCES}")
    try:
        spec = find_spec(module)
    except Exception as error:  # the packages above it are imported, which can raise anything
        raise ConfigError(sanitize_line(f"controller '{source}': {type(error).__name__}: {error}")) from None
    if spec is None or not spec.has_location or spec.origin is None:
        raise ConfigError(f"controller '{source}': no module named '{module}'")
    return spec.origin


def _digest(source: str, file: str) -> str:
    try:
        return hashlib.sha256(Path(file).read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(f"controller '{source}': {error.strerror}") from None
