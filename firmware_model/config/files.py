"""Read a TOML or JSON file into a validated dataclass and report all its errors at once; write TOML.

Files may come from anywhere: only regular files are read, with limits on size, number of keys and depth.
"""

import errno
import json
import re
import stat
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import IO, Annotated, Any, TypeVar, cast

from pydantic import AfterValidator, TypeAdapter, ValidationError
from pydantic_core import from_json, to_jsonable_python

from firmware_model.config.toml_lines import find_line
from firmware_model.config.validation import did_you_mean, list_errors, sanitize_line
from firmware_model.config.whole_file import whole_file
from firmware_model.errors import ConfigError, ConfigErrors

Parsed = TypeVar("Parsed")
MIB = 1 << 20
TEXT = 16 * MIB
"""[bytes] limit of a JSON or CSV file; a hostile one of this size takes less than a gigabyte of memory."""
_TOML = 2 * MIB  # [bytes] the parser takes seconds for this much
_LONG_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){32}""")  # the parser's time grows with its square
_MARK = b"\xef\xbb\xbf"  # byte order mark of UTF-8
_KEYS = 50_000  # of a document: each unknown key is an error and takes a kilobyte until it is reported
_HEAD = 16  # [bytes] that tell kinds apart
_LONGEST_NAME = 100  # [bytes] two names, a seed and a suffix make a file name


PARAMETER_SUFFIXES = (".params", ".param", ".parm")
"""Ends of the names of parameter files."""
_KINDS = {  # a key that each kind needs and no other has
    "vehicle": ("inertia_B", "a vehicle file: give it as --vehicle"),
    "scenario": ("duration_s", "a scenario file: give it as the scenario, --scenario or --air"),
    "design": ("W_e", "a design file: it is for gustproof design"),
}
_SUFFIXES = {  # of files of other kinds, by what takes them
    **dict.fromkeys((".json", ".mat"), "a law is given as --law"),
    **dict.fromkeys(PARAMETER_SUFFIXES, "parameters are given as --law or --params, or to judge"),
    **dict.fromkeys((".ulg", ".bin", ".log", ".csv"), "gustproof identify makes a vehicle of a flight log"),
    ".parquet": "a campaign's table is for gustproof report",
}
_LAW = "a law: give it as --law"
_LOG = "a flight log: gustproof report shows it, identify makes a vehicle of it"
_RECORDING = "a recorded flight: give its folder to gustproof report or replay"
_BEGINS = {  # of files that are no text
    b"ULog": _LOG,
    b"\xa3\x95": _LOG,
    b"\x89MCAP0": _RECORDING,
    b"PAR1": "a campaign's table: gustproof report shows it",
    b"MATLAB 5.0": _LAW,
    b"<!DOCTYPE": "a page for a browser",
}
_FORMATS = {
    "gustproof-law-": _LAW,
    "gustproof-certificate-": "a certificate: gustproof certify check reads it",
}
_HINTS = {("law", ".mat"): "gustproof export FILE.mat --law FILE.json makes one of it"}  # where only a law file will do


def checked_name(name: str) -> str:
    """Return the name of a scenario, law or vehicle if it can be part of a file name and of a printed line.

    Raises
    ------
    ValueError
        If it is empty, too long, begins with a dot, or has an unprintable character, a slash, a backslash or a dollar
        sign. A dollar sign starts a formula in figures.
    """
    if not (isinstance(name, str) and name.isprintable() and name.strip() and len(name.encode()) <= _LONGEST_NAME):
        raise ValueError(f"a name has 1 to {_LONGEST_NAME} bytes of printable characters")
    if name.startswith(".") or set("/\\$") & set(name):
        raise ValueError("a name begins with no dot and has no slash, backslash or dollar sign")
    return name


Name = Annotated[str, AfterValidator(checked_name)]


def open_regular(path: Path) -> IO[bytes]:
    """Open a regular file to read. Folders are rejected, and devices and pipes, which may have no end.

    Raises
    ------
    OSError
        If there is no such file, or it can't be read.
    """
    try:
        mode = path.stat().st_mode
    except ValueError:  # a character that no path can have
        raise FileNotFoundError(errno.ENOENT, "No such file", str(path)) from None
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "Is a directory", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "is a device or a pipe, must be a file", str(path))
    return path.open("rb")


def read_bytes(path: Path, at_most: int) -> bytes:
    """Return the content of a regular file of at most `at_most` bytes.

    Raises
    ------
    OSError
        If there is none, it can't be read, or it is larger.
    """
    with open_regular(path) as file:
        content = file.read(at_most + 1)
    if len(content) > at_most:
        raise OSError(errno.EFBIG, f"is larger than {at_most / MIB:g} MiB", str(path))
    return content


def read_text(path: Path, at_most: int = TEXT, *, marked: bool = False) -> str:
    """Return the text of a regular file of at most `at_most` bytes; `marked` allows a byte order mark before it.

    Raises
    ------
    OSError
        If there is none, it can't be read, or it is larger.
    ValueError
        If it is not UTF-8, or begins with a byte order mark.
    """
    content = read_bytes(path, at_most)
    if marked:
        content = content.removeprefix(_MARK)
    if content.startswith(_MARK):
        raise ValueError("it begins with a byte order mark: save it as UTF-8 without one")
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ValueError(f"byte 0x{content[error.start]:02x} in line {line} is not UTF-8: save it as UTF-8") from None


def parse_json(text: str | bytes) -> Any:
    """Parse JSON: numbers exact to the bit, no incomplete surrogate pairs, nesting at most 200 deep.

    Raises
    ------
    ValueError
        If it is not JSON, has too many keys, or an integer beyond the range of a float.
    """
    return _check_bounds(from_json(text))


def _check_bounds(value: Any) -> Any:
    """Return a document; reject too many keys and too large integers."""
    waiting, keys = [value], 0
    while waiting:
        item = waiting.pop()
        if isinstance(item, dict):
            keys += len(item)
            waiting.extend(filter(None, item.values()))  # what is empty or 0 is within every bound
        elif isinstance(item, list):
            waiting.extend(filter(None, item))
        elif isinstance(item, int) and item.bit_length() > 1024:
            raise ValueError("an integer is beyond 1.8e308")
        if keys > _KEYS:
            raise ValueError(f"it has more than {_KEYS:,} keys")
    return value


def read_document(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file, not validated.

    Raises
    ------
    ConfigError
        If there is no such file, it is not TOML, or it is empty.
    """
    try:
        text = read_text(path, _TOML)
        if _LONG_KEY.search(text):
            raise ValueError("a key has more than 32 parts")
        document: dict[str, Any] = _check_bounds(tomllib.loads(text))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not TOML: {sanitize_line(str(error))}") from None
    if not document:
        raise ConfigError(f"{path}: is empty")
    return document


def list_shipped(folder: Path, suffix: str = ".toml") -> tuple[str, ...]:
    """Return the names of the files shipped in `folder`."""
    return tuple(sorted(path.stem for path in folder.glob(f"*{suffix}")))


def read_toml(
    kind: type[Parsed],
    name_or_path: str | Path,
    folder: Path,
    complete: Callable[[dict[str, Any], Path], dict[str, Any]] = lambda document, _: document,
) -> Parsed:
    """Read `name_or_path`, a file or the name of one shipped in `folder`, as a `kind`.

    `complete` takes the document and its path and fills in the content of other files.

    Raises
    ------
    ConfigError
        If there is no such file, it is not TOML, or a key or value is not allowed.
    """
    path = shipped_path(kind.__name__.lower(), name_or_path, folder)
    content = read_document(path)
    _refuse_other_kind(kind.__name__.lower(), content, path)
    document = {"name": path.stem, **complete(content, path)}
    return validate(kind, document, str(path), lambda key: find_line(read_text(path, _TOML), key))


def _refuse_other_kind(kind: str, document: Mapping[str, Any], path: Path) -> None:
    """Refuse a file that has the key of another kind and not that of its own: each of its keys would be an error."""
    if _KINDS.get(kind, ("",))[0] in document:
        return
    if what := _find_kind_of_document(document):
        raise ConfigError(f"{path}: is {what}")


def _find_kind_of_document(document: Mapping[str, Any]) -> str:
    """Return what a TOML file is by its keys; empty if unknown."""
    return next((what for key, what in _KINDS.values() if key in document), "")


def tell_kind(path: Path) -> str:
    """Return what a file or folder is that stands where none of its kind belongs, after a semicolon; empty if unknown.

    It is told by what is in it. A file that can't be read is of no kind.
    """
    try:
        what = _find_kind_of_folder(path) if path.is_dir() else _find_kind(path)
    except (ConfigError, OSError, ValueError):
        return ""
    return what and f"; it is {what}"


def _find_kind_of_folder(path: Path) -> str:
    if (path / "facts.json").exists():
        return "a law as tables: give it as --law"
    patterns = "*.journal", "*.mcap", "*/*.mcap"  # no deeper: it may be a whole disk
    return _RECORDING if any(next(path.glob(pattern), None) for pattern in patterns) else "a folder"


def _find_kind(path: Path) -> str:
    with open_regular(path) as file:
        head = file.read(_HEAD)
    if found := [what for begin, what in _BEGINS.items() if head.startswith(begin)]:
        return found[0]
    if path.suffix.lower() in PARAMETER_SUFFIXES:
        return "a parameter file: give it as --law or --params, or to judge"
    if head.startswith(b"{"):
        document = parse_json(read_text(path))
        told = str(document.get("format", "")) if isinstance(document, dict) else ""
        return next((what for begin, what in _FORMATS.items() if told.startswith(begin)), "")
    if path.suffix == ".toml":
        return _find_kind_of_document(read_document(path))
    return ""


def shipped_path(kind: str, name_or_path: str | Path, folder: Path, suffix: str = ".toml") -> Path:
    """Return the path of a file, or of the one of that name shipped in `folder`; `kind` names it in errors.

    Raises
    ------
    ConfigError
        If none of that name is shipped.
    """
    path = Path(name_or_path)
    if path.suffix == suffix:
        return path
    if path.exists() and path.suffix != suffix and ("/" in str(name_or_path) or path.suffix):
        hint = _HINTS.get((kind, path.suffix.lower()), _SUFFIXES.get(path.suffix.lower(), ""))
        told = tell_kind(path) if (kind, path.suffix.lower()) not in _HINTS else ""
        raise ConfigError(f"{path}: is no {kind}, which is a {suffix} file or a name{told or (hint and f'; {hint}')}")
    if str(name_or_path) not in (shipped := list_shipped(folder, suffix)):
        name, near = sanitize_line(str(name_or_path)), did_you_mean(str(name_or_path), shipped)
        instead = f"{near} Or" if near else ":"
        listed = f"a name that `gustproof {kind} list` shows{tell_kind(path)}"
        raise ConfigError(f"no {kind} named '{name}'{instead} give a {suffix} file, or {listed}")
    return folder / f"{name_or_path}{suffix}"


def read_json(kind: type[Parsed], name: str) -> Parsed | None:
    """Return the content of a .json file, as other processes of the project write it; `None` for another suffix.

    Raises
    ------
    ConfigError
        If there is no such file, it is not JSON, or a key or value is not allowed.
    """
    path = Path(name)
    if path.suffix != ".json":
        return None
    try:
        return validate(kind, parse_json(read_text(path)), name)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: not JSON: {sanitize_line(str(error))}") from None


def validate(
    kind: type[Parsed],
    document: dict[str, Any],
    source: str,
    line_of: Callable[[Sequence[int | str]], int | None] = lambda _: None,
) -> Parsed:
    """Return `document` as a validated `kind`; `line_of` gives the line where a key stands, for errors.

    Raises
    ------
    ConfigErrors
        If keys or values are not allowed; it names `source` and holds all errors.
    """
    try:
        parsed: Parsed = _type_adapter(cast(Any, kind)).validate_python(document)
    except ValidationError as error:
        raise ConfigErrors(source, list_errors(kind, error.errors(), line_of)) from None
    return parsed


@cache
def _type_adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, whole or not at all; see `whole_file`.

    Raises
    ------
    OSError
        If the file can't be written; the error names it.
    """
    with whole_file(path) as file:
        file.write(text.encode())


def write_toml(value: Any, path: Path) -> None:
    """Write a validated dataclass as TOML; `read_toml` reads it back equal, every number to the bit."""
    write_text(path, "\n".join(_toml_lines(to_jsonable_python(value), "")) + "\n")


def _toml_lines(table: Mapping[str, Any], path: str) -> Iterator[str]:
    """Yield a table's own keys, then its sub-tables with headers; `None` and empty lists are omitted."""
    below = {key: value for key, value in table.items() if isinstance(value, dict) or _is_tables(value)}
    for key, value in table.items():
        if key not in below and value is not None and value != []:
            # JSON numbers, strings and lists of numbers are TOML, except for DEL, which only JSON allows unescaped.
            yield f"{key} = {json.dumps(value, ensure_ascii=False, allow_nan=False)}".replace("\x7f", "\\u007f")
    for key, value in below.items():
        header = f"[[{path}{key}]]" if _is_tables(value) else f"[{path}{key}]"
        for item in value if _is_tables(value) else [value]:
            yield from ("", header, *_toml_lines(item, f"{path}{key}."))


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)
