"""A user's own controller, named as on the command line."""

import hashlib
import re
import shlex
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from firmware_model.config.validation import sanitize_line
from firmware_model.errors import ConfigError
from gustproof.law.form import Law

PROGRAM_PREFIX = "exec:"
_LIBRARIES = (".so", ".dylib", ".dll")
_SOURCES = "FILE.py:MAKER, PACKAGE.MODULE:MAKER, LIBRARY.so or 'exec: COMMAND'"


class ControllerKind(Enum):
    """Ways in which a controller is brought."""

    PYTHON = "python"
    """Function that makes the controller object, as `my_mpc.py:make` or `package.module:make`."""
    LIBRARY = "library"
    """C library with the functions that `export -o law.c` writes, as `law.so`."""
    PROGRAM = "program"
    """Command of a program that speaks MAVLink, as `exec: node mine.mjs`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UserController:
    """A controller that is no law file.

    Examples
    --------
    >>> from gustproof import UserController, parse_controller
    >>> isinstance(parse_controller("exec: node mine.mjs"), UserController)
    True
    """

    kind: ControllerKind
    """Way in which it is brought."""
    source: str
    """Text that names it on the command line."""
    name: str
    """Name in texts and files."""
    digest: str
    """SHA-256 of its file; empty for a program."""
    given: bool = field(default=True, compare=False)
    """True if its user named it. One that a bag or table names is never loaded or started, see `confirm_controller`."""

    def to_dict(self) -> dict[str, Any]:
        """Return the controller as JSON values, input of `parse_controller_metadata`."""
        return {"kind": self.kind.value, "source": self.source, "name": self.name, "digest": self.digest}

    def check_given(self, where: object = "") -> None:
        """Refuse to load or start a controller that its user did not name; the text begins with `where`.

        Raises
        ------
        ConfigError
            If only a file names it. The text says what to type.
        """
        if not self.given:
            line = f"--controller {shlex.quote(self.source)}"
            raise refuse_named(where, "a controller that runs code of its own", line)


def refuse_named(where: object, program: str, line: str) -> ConfigError:
    """Return the refusal of a program that only a file names, found at `where` if known, with what to type for it."""
    flown = f"{where}: flown by" if where else "a file names"
    return ConfigError(f"{flown} {program}; if you trust it, add: {line}")


Controller = Law | UserController
"""Whatever computes the commands of a flight here."""


def parse_controller(source: str) -> UserController:
    """Return the controller that a text names.

    Raises
    ------
    ConfigError
        If the text names no entry, or its file can't be read.

    Examples
    --------
    >>> from gustproof import parse_controller
    >>> parse_controller("exec: node mine.mjs").name
    'mine'
    """
    if source.startswith(PROGRAM_PREFIX):
        return UserController(
            kind=ControllerKind.PROGRAM, source=source, name=_program_name(split_command(source)), digest=""
        )
    if source.endswith(_LIBRARIES):
        return UserController(
            kind=ControllerKind.LIBRARY, source=source, name=Path(source).stem, digest=_digest(source, source)
        )
    place, _, maker = source.rpartition(":")
    if not maker.isidentifier():
        raise ConfigError(f"controller '{source}': is none of {_SOURCES}")
    file = place if place.endswith(".py") else _find_module(source, place)
    name = Path(file).stem if maker == "make" else f"{Path(file).stem}-{maker}"
    return UserController(kind=ControllerKind.PYTHON, source=source, name=name, digest=_digest(source, file))


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


def parse_controller_metadata(document: Any, where: object) -> UserController:
    """Return the controller that `UserController.to_dict` has written, whatever has become of its file.

    It tells what flew and can't fly: the document may come from anywhere, see `confirm_controller`.

    Raises
    ------
    ConfigError
        If the document describes no entry; the text begins with `where`.
    """
    try:
        source, name, digest = (str(document[key]) for key in ("source", "name", "digest"))
        return UserController(
            kind=ControllerKind(document["kind"]), source=source, name=name, digest=digest, given=False
        )
    except (KeyError, TypeError, ValueError):
        raise ConfigError(f"{where}: does not say which controller flew") from None


def confirm_controller(flown: UserController, source: str | None, where: object) -> UserController:
    """Return the controller that a user names to fly `flown` again.

    A program must have the same command. A file may lie elsewhere, and must have the same SHA-256 and maker.

    Raises
    ------
    ConfigError
        If none is named, or it is another one; the text begins with `where`.
    """
    if source is None:
        flown.check_given(where)
        return flown
    entry = parse_controller(source)
    if entry.kind is not flown.kind or _call_of(entry) != _call_of(flown):
        raise ConfigError(f"{where}: flown by controller '{flown.source}', not '{source}'")
    if entry.digest != flown.digest:
        changed = f"has changed since: its SHA-256 is not {flown.digest[:16]}…"
        raise ConfigError(f"{where}: controller '{source}' {changed}")
    return replace(entry, name=flown.name)


def _call_of(entry: UserController) -> object:
    """Return what of a user's controller its digest does not cover: the words of a program, or a maker's name."""
    if entry.kind is ControllerKind.PROGRAM:
        return split_command(entry.source)
    return entry.source.rpartition(":")[2] if entry.kind is ControllerKind.PYTHON else None


def _find_module(source: str, module: str) -> str:
    """Return the file of a module that can be imported; the current folder comes last, and only if it is needed."""
    if not re.fullmatch(r"[^\W\d]\w*(\.[^\W\d]\w*)*", module):
        raise ConfigError(f"controller '{source}': is none of {_SOURCES}")
    top, here = module.partition(".")[0], str(Path.cwd())
    try:
        if find_spec(top) is None and PathFinder.find_spec(top, [here]):
            sys.path.append(here)
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
