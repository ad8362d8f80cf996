"""Read a TOML file into a checked dataclass, every mistake reported at once in one clear line; write it again."""

import json
import tomllib
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_jsonable_python

from firmware_model.errors import ConfigError
from firmware_model.mistakes import one_line, told

Parsed = TypeVar("Parsed")


def shipped(folder: Path) -> tuple[str, ...]:
    """Return the names of the files shipped in `folder`."""
    return tuple(sorted(path.stem for path in folder.glob("*.toml")))


def read_toml(
    kind: type[Parsed],
    name_or_path: str | Path,
    folder: Path,
    complete: Callable[[dict[str, Any], Path], dict[str, Any]] = lambda document, _: document,
) -> Parsed:
    """Read `name_or_path`, a file or the name of one shipped in `folder`, as a `kind`.

    `complete` is given the document and its path, and returns it with what stands in other files.

    Raises
    ------
    ConfigError
        If there is no such file, it is not TOML, or a key or value is not allowed.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = folder / f"{name_or_path}.toml"
        if str(name_or_path) not in shipped(folder):
            known = ", ".join(shipped(folder))
            raise ConfigError(f"no {kind.__name__.lower()} named '{name_or_path}': give a .toml file or one of {known}")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not TOML: {one_line(str(error))}") from None
    return parse(kind, {"name": path.stem, **complete(document, path)}, str(path))


def read_json(kind: type[Parsed], name: str) -> Parsed | None:
    """Return the content of a .json file, as another process of the project writes it; `None` if it is none.

    Raises
    ------
    ConfigError
        If there is no such file, it is not JSON, or a key or value is not allowed.
    """
    path = Path(name)
    if path.suffix != ".json":
        return None
    try:
        return parse(kind, json.loads(path.read_text(encoding="utf-8")), name)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not JSON: {one_line(str(error))}") from None


def parse(kind: type[Parsed], document: dict[str, Any], source: str) -> Parsed:
    """Return `document` as a checked `kind`; `source` stands in front of each mistake."""
    try:
        parsed: Parsed = _adapter(cast(Any, kind)).validate_python(document)
    except ValidationError as error:
        raise ConfigError(f"{source}: {told(kind, error.errors())}") from None
    return parsed


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def write_toml(value: Any, path: Path) -> None:
    """Write a checked dataclass as a TOML file that `read_toml` reads back equal, every number to the bit."""
    path.write_text("\n".join(_toml_lines(to_jsonable_python(value), "")) + "\n", encoding="utf-8")


def _toml_lines(table: Mapping[str, Any], path: str) -> Iterator[str]:
    """Yield a table's own keys, then its tables below their headers; what is `None` or empty is left out."""
    below = {key: value for key, value in table.items() if isinstance(value, dict) or _is_tables(value)}
    for key, value in table.items():
        if key not in below and value is not None and value != []:
            # A JSON number, string or list of numbers is TOML too, but for the one control character JSON allows.
            yield f"{key} = {json.dumps(value, ensure_ascii=False, allow_nan=False)}".replace("\x7f", "\\u007f")
    for key, value in below.items():
        header = f"[[{path}{key}]]" if _is_tables(value) else f"[{path}{key}]"
        for item in value if _is_tables(value) else [value]:
            yield from ("", header, *_toml_lines(item, f"{path}{key}."))


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)
